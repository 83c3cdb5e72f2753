"""The collision's impulse as evidence, beyond the paper: the landing kernel's change of velocity against simulated collisions.

The Sun is the only direction that body and comet axes share, so that the change of velocity gives two numbers: its size and its
angle to the Sun. A third, the angle about the Sun, follows only if the vertical at the first touchdown is taken for the direction
up through the lander's body, within a cone that is stated. Each collision is weighted by how well it gives these numbers; at what
second it came is free, as the lander turned once in seconds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError, sentence
from sunspin.base.tables import read_table
from sunspin.environment.comet import AXES_SIGMA_RAD, comet_from_J2000, velocity_J2000
from sunspin.landing.flight import angle_about
from sunspin.landing.outcomes import outcomes
from sunspin.landing.scenario import case_scenario
from sunspin.landing.tally import effective_runs, estimate
from sunspin.philae.candidates import Chain
from sunspin.philae.collision import KERNEL, SIGMA_M_S, states_of, tdb_of
from sunspin.philae.row import Row, row, share_of_candidates
from sunspin.telemetry.case import Case

SUN = ("philae_spk", "sun_from_67p_20141112.csv")

FREE_S, INSTANTS = 60.0, 8
"""The collision may have come this long before or after its time in the timeline; instants tried."""

CONE_RAD = float(np.radians(30.0))
"""Half angle of the cone about upright in which the vertical at the touchdown lies, for the third number."""

RUNS = 8
"""Collisions as a multiple of those of the landing study: a few in a thousand carry the weight."""

LEAST_RUNS = 25.0
"""Effective collisions below which a weighted mean is not told."""

OFF = (
    "The collision's impulse (beyond the paper) is not used: give --data, or set SUNSPIN_DATA, to a folder with philae_spk/ "
    "(docs/data.md)."
)


@dataclass(frozen=True)
class Seen:
    """The change of velocity: its size (m/s), its angle to the Sun, and about it from the vertical of the touchdown (rad)."""

    change_m_s: float
    to_sun_rad: float
    about_sun_rad: float

    @property
    def direction_sigma_rad(self) -> float:
        """Of its direction in space."""
        return float(np.hypot(SIGMA_M_S / self.change_m_s, AXES_SIGMA_RAD))

    def weights(self, runs: xr.Dataset, numbers: int = 2) -> np.ndarray:
        """Likelihood (n) of simulated collisions by the first of size, angle to the Sun, angle about it; 1 where they are exact."""
        turned = (
            np.remainder(runs["change_about_sun"].values - self.about_sun_rad + np.pi, 2 * np.pi)
            - np.pi
        )
        off = [
            (runs["velocity_change"].values - self.change_m_s) / SIGMA_M_S,
            (runs["change_to_sun"].values - self.to_sun_rad) / self.direction_sigma_rad,
            turned * np.sin(self.to_sun_rad) / self.direction_sigma_rad,
        ]
        return np.nan_to_num(np.exp(-0.5 * np.sum(np.square(off[:numbers]), axis=0)), nan=0.0)


@dataclass(frozen=True)
class Impulse:
    """Simulated collisions `runs` with the rate of their candidate at the touchdown, `speed_touchdown` (n) rad/s, and what was
    seen; weights (n) by two numbers and by three."""

    case: Case
    chain: str
    runs: xr.Dataset
    speed_touchdown: np.ndarray
    seen: Seen

    def rates(self) -> dict[str, np.ndarray]:
        """Angular speeds (n) rad/s, by the row that they make."""
        before, after = (
            np.linalg.norm(self.runs[name].values, axis=1)
            for name in ("omega_before_B", "omega_after_B")
        )
        return {
            "impulse_rate_touchdown": self.speed_touchdown,
            "impulse_rate_before": before,
            "impulse_rate_after": after,
        }


def seen_in(case: Case, folder: str | Path) -> Seen:
    """What the kernel and the Sun's directions in the data folder say.

    Raises
    ------
    InputError
        A file that is missing, damaged, or holds no Sun at the time of the collision.
    """
    path = Path(folder).joinpath(*KERNEL)
    touchdown, before = (tdb_of(case, name) for name in ("first_touchdown", "collision"))
    states = states_of(path, [np.ceil(touchdown), before, before + 1.0])
    sun = sun_J2000(folder, before)
    change = velocity_J2000(before + 1.0, states[2]) - velocity_J2000(before, states[1])
    up = comet_from_J2000(touchdown).T @ states[0][:3]
    size = float(np.linalg.norm(change))
    if not (np.isfinite(size) and size > 0):
        raise InputError(
            sentence(
                "the trajectory kernel holds no collision", do="download it again", where=str(path)
            )
        )
    to_sun, about = (float(x[0]) for x in angle_about(change[None], sun[None], up[None]))
    return Seen(size, to_sun, about)


def sun_J2000(folder: str | Path, tdb_s: float) -> np.ndarray:
    """Direction (3) to the Sun in J2000, from the data folder; an `InputError` where it has none at that time."""
    path = Path(folder).joinpath(*SUN)
    if not path.is_file():
        do = "docs/data.md says where they come from"
        raise InputError(sentence("the Sun's directions are not there", do=do, where=str(path)))
    table = read_table(path)
    try:
        values = table.cells.iloc[:, 1:5].astype(float).to_numpy()
    except ValueError:
        values = np.zeros((0, 4))
    if values.shape[1] < 4 or not len(values) or not values[0, 0] <= tdb_s <= values[-1, 0]:
        what = "the file has no direction of the Sun at the collision"
        raise InputError(sentence(what, do="download it again", where=str(path)))
    sun = np.array([np.interp(tdb_s, values[:, 0], values[:, k]) for k in (1, 2, 3)])
    return sun / np.linalg.norm(sun)


def compute(
    case: Case, chain: Chain, seen: Seen, *, n: int, seed: int = 0, workers: int | None = None
) -> Impulse:
    """Simulate collisions of the chosen candidates, the time of the collision free.

    Nothing after the blow is looked at, so that the flight ends a second later.
    """
    real, motions = case_scenario(case, chain.rebound), chain.chosen.dataset()
    shifts = FREE_S * (2 * (np.arange(INSTANTS) + 0.5) / INSTANTS - 1)
    runs = xr.concat(
        [
            outcomes(
                case.vehicle,
                motions,
                "off",
                max(RUNS * n // INSTANTS, 1),
                seed + 1000 + k,
                workers=workers,
                scenario=replace(
                    real, before_s=real.before_s + float(shift), after_s=1.0, vertical=CONE_RAD
                ),
            )
            for k, shift in enumerate(shifts)
        ],
        "run",
        combine_attrs="drop_conflicts",
    )
    return Impulse(
        case, chain.name, runs, chain.chosen.speed_touchdown[runs["candidate"].values], seen
    )


def rows(found: Impulse) -> list[Row]:
    """Rows beyond the paper: the angle, and angular speeds with and without the impulse."""
    angle = np.degrees(found.runs["change_to_sun"].values)
    low, middle, high = (float(x) for x in np.nanquantile(angle, [0.05, 0.5, 0.95]))
    weights = [found.seen.weights(found.runs, numbers) for numbers in (1, 2, 3)]
    head = row(
        found.case,
        "impulse_to_sun",
        middle,
        published=float(np.degrees(found.seen.to_sun_rad)),
        chain=found.chain,
        low=low,
        high=high,
        seen=found.seen,
        sigma_deg=float(np.degrees(found.seen.direction_sigma_rad)),
        effective=effective_runs(weights[1]),
        drawn=len(angle),
    )
    return [head, *(_rate(found, name, values, weights) for name, values in found.rates().items())]


def _rate(found: Impulse, name: str, values: np.ndarray, weights: list[np.ndarray]) -> Row:
    """A mean rate by two numbers beside that without; `weights` by one number, two and three."""
    without, by_two, effective = (
        estimate(values),
        estimate(values, weights[1]),
        effective_runs(weights[1]),
    )
    known = effective >= LEAST_RUNS
    by_size, by_three = (_words(values, weights[k]) for k in (0, 2))
    shown = row(
        found.case,
        name,
        by_two.value if known else without.value,
        says=("note",) if known else ("note_open",),
        chain=found.chain,
        without=without,
        by_size=by_size,
        by_two=by_two,
        by_three=by_three,
        cone=np.degrees(CONE_RAD),
        effective=effective,
    )
    if not known:
        return replace(shown, informative=False)
    return share_of_candidates(shown, found.chain, by_two, without, None)


def _words(values: np.ndarray, weight: np.ndarray) -> str:
    effective = effective_runs(weight)
    return (
        str(estimate(values, weight))
        if effective >= LEAST_RUNS
        else f"not known from the {effective:.0f} collisions left"
    )


def told(found: Impulse, shown: list[Row]) -> str:
    """What the impulse changes, in a sentence."""
    seen = found.seen
    text = (
        f"The collision's impulse (beyond the paper): the landing kernel's change of velocity is {seen.change_m_s:.3f} m/s, "
        f"{np.degrees(seen.to_sun_rad):.0f} degrees from the Sun"
    )
    moved = [one for one in shown[1:] if one.informative]
    if not moved:
        return f"{text}; it is uninformative: no mean rate of the candidates moves beyond three sampling errors."
    each = ", ".join(
        f"{one.what}: {_middle(one, 'prior_'):.3f} without, {one.ours:.3f} rad/s with it"
        for one in moved
    )
    return f"{text}; weighted by it, {each}."


def _middle(one: Row, which: str) -> float:
    ends: Any = getattr(one, f"{which}low"), getattr(one, f"{which}high")
    return float(np.mean(ends))
