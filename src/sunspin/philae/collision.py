"""The collision against what is known of it: the trajectory kernel's speeds, the magnetometer's periods.

The public trajectory of the rebound gives the comet-fixed speed before and after 16:20 and the jump of the velocity, which is
impulse over mass in any frame. Each simulated collision is weighted by how well it explains speed after and jump.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.landing.tally import Estimate, effective_runs, estimate
from sunspin.telemetry.case import Case
from sunspin.vehicle.timeline import utc_seconds

SIGMA_M_S = 0.02
"""How far (m/s, one sigma) a right collision may be from the kernel's speed and jump: the kernel gives no error; ballistic arcs
through a few imaged points are good to a per cent or so, the rest is allowance for a blow that was no ideal sticking one."""

SIGMAS_M_S = (0.01, 0.02, 0.04)
"""Values of `SIGMA_M_S` whose effect is reported."""

SIGMA_PERIOD_S = 2.0
"""One sigma of a magnetometer period quoted in whole seconds, for a motion that is no simple rotation."""

KERNEL = ("philae_spk", "LORB_C_G_FIXED_RBD_7_V2_0.BSP")
LARGEST = 1e9
"""km or km/s: what a damaged kernel may well exceed."""

J2000_UTC = "2000-01-01T12:00:00"
T = TypeVar("T")

TDB_MINUS_UTC_S = 67.184
"""In November 2014: 35 leap seconds and 32.184 s."""


def published_facts(case: Case) -> dict[str, float]:
    """The kernel's facts as they ship with the case: name without `kernel_` -> value in m/s (m)."""
    return {
        key.removeprefix("kernel_"): fact.value
        for key, fact in case.published.items()
        if key.startswith("kernel_")
    }


def kernel_facts(case: Case, folder: str | Path) -> dict[str, float]:
    """The same facts read from the trajectory kernel.

    Parameters
    ----------
    folder : path
        The data folder (`SUNSPIN_DATA`), which holds philae_spk/LORB_C_G_FIXED_RBD_7_V2_0.BSP.

    Returns
    -------
    dict
        `speed_before`, `speed_after`, `velocity_change`, `speed_before_landing`, `speed_after_landing` in m/s, comet-fixed,
        taken at the second of the event and one second later; `path_length` in m.
    """
    path = Path(folder).joinpath(*KERNEL)
    facts = _read(path, lambda states: _facts(case, states))
    if not all(0 <= value < 1e3 * LARGEST for value in facts.values()):
        raise InputError(
            "the trajectory kernel holds no speeds of this landing",
            do="download it again",
            where=str(path),
        )
    return facts


def states_of(path: Path, tdb_s: Sequence[float]) -> np.ndarray:
    """Positions and velocities (n, 6) of the trajectory kernel, m and m/s over the comet in its axes, at TDB seconds past J2000."""
    return _read(path, lambda states: np.array([states(t) for t in tdb_s]))


def _read(path: Path, asked: Callable[[_KernelStates], T]) -> T:
    """What is asked of a kernel's states; an `InputError` where it cannot be read."""
    try:
        with np.errstate(
            all="ignore"
        ):  # a damaged record may hold any numbers; they are judged by who asks
            return asked(_KernelStates(path))
    except spice_errors() as error:
        short = " ".join(str(error).split()).strip("= ")[:200]
        what = f"the trajectory kernel cannot be read ({short})"
        raise InputError(what, do="download it again", where=str(path)) from None


def _facts(case: Case, states: _KernelStates) -> dict[str, float]:
    begin, collision, landing = (
        tdb_of(case, name) for name in ("first_touchdown", "collision", "second_touchdown")
    )
    before, after = states(collision), states(collision + 1.0)
    down, up = states(landing), states(landing + 1.0)
    path = np.array([states(t)[:3] for t in np.arange(np.ceil(begin), collision, 1.0)])
    return {
        "speed_before": float(np.linalg.norm(before[3:])),
        "speed_after": float(np.linalg.norm(after[3:])),
        "velocity_change": float(np.linalg.norm(after[3:] - before[3:])),
        "speed_before_landing": float(np.linalg.norm(down[3:])),
        "speed_after_landing": float(np.linalg.norm(up[3:])),
        "path_length": float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()),
    }


def tdb_of(case: Case, event: str) -> float:
    """TDB seconds past J2000 of an event."""
    moment = case.require_timeline().event(event)
    return utc_seconds(moment.refined_utc or moment.utc, J2000_UTC) + TDB_MINUS_UTC_S


def spice_errors() -> type[Exception]:
    """What SPICE raises on files that are damaged; where it is not installed, nothing that is ever raised."""
    try:
        from spiceypy.utils.exceptions import SpiceyError
    except ImportError:
        return InputError
    return SpiceyError


def _has_spk_summaries(path: Path) -> bool:
    """Whether a file's first record is that of an SPK (NAIF's DAF: 2 doubles and 6 integers in a summary).

    SPICE copies as many as the record says into room for these, so another number ends the process.
    """
    with open(path, "rb") as file:
        record = file.read(1024)
    order = ">" if record[88:96] == b"BIG-IEEE" else "<"
    return (
        record[:7] == b"DAF/SPK"
        and len(record) == 1024
        and struct.unpack(f"{order}ii", record[8:16]) == (2, 6)
    )


class _KernelStates:
    """Position and velocity (6) in m and m/s, in the kernel's own comet-fixed frame, which needs no frame kernel this way."""

    def __init__(self, path: Path) -> None:
        try:
            import spiceypy
        except ImportError:
            raise InputError(
                "reading a trajectory kernel needs spiceypy", do='pip install "sunspin[spice]"'
            ) from None
        if not path.is_file():
            raise InputError(
                "the trajectory kernel is not there",
                do="docs/data.md says where it comes from",
                where=str(path),
            )
        damaged = InputError(
            "the trajectory kernel is damaged", do="download it again", where=str(path)
        )
        if not _has_spk_summaries(path):
            raise damaged
        self.spice = spiceypy
        handle = spiceypy.dafopr(str(path))
        try:
            spiceypy.dafbfs(handle)
            if not spiceypy.daffna():
                raise damaged
            self.summary = spiceypy.dafgs(5)
        finally:
            spiceypy.dafcls(handle)
        self.handle = spiceypy.spklef(str(path))

    def __call__(self, tdb_s: float) -> np.ndarray:
        state = np.array(self.spice.spkpvn(self.handle, self.summary, tdb_s)[1])
        return np.where(np.abs(state) < LARGEST, 1e3 * np.clip(state, -LARGEST, LARGEST), np.nan)

    def __del__(self) -> None:
        if hasattr(self, "handle"):
            self.spice.spkuef(self.handle)


def weights(runs: xr.Dataset, facts: dict[str, float], sigma_m_s: float = SIGMA_M_S) -> np.ndarray:
    """Likelihood (n) of each simulated collision, 1 where it gives the speed after and the jump exactly.

    Runs must start from the speed before, or the speeds mean nothing. Those that failed weigh 0.
    """
    if not sigma_m_s > 0:
        raise InputError("sigma_m_s must be positive", got=sigma_m_s)
    jump = runs["velocity_change"].values - facts["velocity_change"]
    speed = runs["speed_after"].values - facts["speed_after"]
    return np.nan_to_num(np.exp(-0.5 * (jump**2 + speed**2) / sigma_m_s**2), nan=0.0)


def period_weights(rate_rad_s: np.ndarray, period_s: float) -> np.ndarray:
    """Likelihood (n) of rates if the magnetometer's period is that of the body rate, which is one reading of three."""
    with np.errstate(divide="ignore"):
        return np.nan_to_num(
            np.exp(-0.5 * ((2 * np.pi / rate_rad_s - period_s) / SIGMA_PERIOD_S) ** 2), nan=0.0
        )


QUANTITIES = {
    "effective_runs": "1",
    "rate_before": "rad s-1",
    "rate_after": "rad s-1",
    "spin_after": "rad s-1",
    "precession_after": "rad s-1",
    "median_period_after": "s",
    "period_agrees": "1",
}
"""What is said of each weighting -> its unit."""


def condition(case: Case, runs: xr.Dataset, facts: dict[str, float] | None = None) -> xr.Dataset:
    """Weight simulated collisions by the kernel, and by the magnetometer's period before the collision.

    Parameters
    ----------
    runs : Dataset
        Of :func:`sunspin.landing.outcomes.outcomes` at the kernel's speed before the collision.
    facts : dict, optional
        Of :func:`kernel_facts`; default: those that ship with the case.

    Returns
    -------
    xarray.Dataset
        Of kind "collision". The runs' `velocity_change`, `speed_after`, rates and `leg`, and `weight`, that of the default sigma;
        `value` and `error` over (weighting, quantity), NaN where there is no error; `explained` with `explained_error`, the share
        of drawn collisions within two sigma of both facts; `fact_value (fact)`.
    """
    facts = facts or published_facts(case)
    rate = {
        name: np.linalg.norm(runs[f"omega_{name}_B"].values, axis=1) for name in ("before", "after")
    }
    spin = period_weights(rate["before"], case.published["romap_period_before"].value)
    by_sigma = {sigma: weights(runs, facts, sigma) for sigma in SIGMAS_M_S}
    cases = {"as drawn": np.isfinite(rate["after"]).astype(float)}
    cases |= {f"kernel, sigma {sigma:g} m/s": weight for sigma, weight in by_sigma.items()}
    cases |= {"13 s before": spin, "kernel and 13 s before": by_sigma[SIGMA_M_S] * spin}
    lines = [_line(weight, runs, rate, case) for weight in cases.values()]
    near = np.hypot(
        runs["velocity_change"].values - facts["velocity_change"],
        runs["speed_after"].values - facts["speed_after"],
    )
    explained = estimate(np.where(np.isnan(near), np.nan, near < 2 * SIGMA_M_S))
    pure, by = {"units": "1"}, ("weighting", "quantity")
    return (
        runs[["velocity_change", "speed_after", "omega_before_B", "omega_after_B", "leg"]]
        .assign(
            weight=(
                "run",
                by_sigma[SIGMA_M_S],
                pure | {"long_name": "likelihood under the kernel's speeds"},
            ),
            value=(by, [[line[name].value for name in QUANTITIES] for line in lines]),
            error=(by, [[line[name].error for name in QUANTITIES] for line in lines]),
            explained=((), explained.value, pure),
            explained_error=((), explained.error, pure),
            fact_value=("fact", list(facts.values())),
        )
        .assign_coords(
            weighting=list(cases),
            quantity=list(QUANTITIES),
            unit=("quantity", list(QUANTITIES.values())),
            fact=list(facts),
            fact_unit=("fact", ["m" if name == "path_length" else "m s-1" for name in facts]),
        )
        .assign_attrs(
            kind="collision",
            sigma_m_s=SIGMA_M_S,
            sigma_period_s=SIGMA_PERIOD_S,
            period_after_s=float(case.published["romap_period_after"].value),
        )
    )


def _line(
    weight: np.ndarray, runs: xr.Dataset, rate: dict[str, np.ndarray], case: Case
) -> dict[str, Estimate]:
    inertia = case.vehicle.require_inertia()
    across = (inertia[0, 0] + inertia[1, 1]) / 2
    wanted = case.published["romap_period_after"].value
    period = 2 * np.pi / rate["after"]
    return {
        "effective_runs": Estimate(effective_runs(weight), np.nan),
        "rate_before": estimate(rate["before"], weight),
        "rate_after": estimate(rate["after"], weight),
        "spin_after": estimate(np.abs(runs["omega_after_B"].values[:, 2]), weight),
        "precession_after": estimate(runs["momentum_after"].values / across, weight),
        "median_period_after": Estimate(weighted_median(period, weight), np.nan),
        "period_agrees": estimate(
            np.where(np.isnan(period), np.nan, np.abs(period - wanted) < 2 * SIGMA_PERIOD_S), weight
        ),
    }


def weighted_median(values: np.ndarray, weight: np.ndarray) -> float:
    """The value below and above which lies half of the weight."""
    use = np.isfinite(values) & (weight > 0)
    if not use.any():
        return float("nan")
    order = np.argsort(values[use], kind="stable")
    mass = np.cumsum(weight[use][order])
    return float(values[use][order][np.searchsorted(mass, mass[-1] / 2)])
