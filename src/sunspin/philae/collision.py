"""After the collision (paper, section 3.3, Fig. 13), and the collision against what is known of it.

The public trajectory of the rebound gives the comet-fixed speed before and after 16:20 and the jump of the velocity, which is
impulse over mass in any frame. Each simulated collision is weighted by how well it explains speed after and jump, and by the
magnetometer's period before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.base.untrusted import Elsewhere, elsewhere
from sunspin.landing.outcomes import outcomes
from sunspin.landing.scenario import Scenario, case_scenario, paper_scenario
from sunspin.landing.tally import (
    Estimate,
    density,
    effective_runs,
    estimate,
    explained,
    facts_of,
    lowest_rz,
    tally,
    weightings,
)
from sunspin.philae.candidates import Candidates, Chain
from sunspin.philae.row import Row, over_candidates, row, share_of_candidates
from sunspin.telemetry.case import Case, case_names, load_case
from sunspin.vehicle.timeline import utc_seconds

RARELY, OFTEN = 0.05, 0.25
"""Shares of the time that count as "rarely" and as "often", which is all that the paper says."""

SIGMA_M_S = 0.02
"""How far (m/s, one sigma) a right collision may be from the kernel's speed and jump: the kernel gives no error; ballistic arcs
through a few imaged points are good to a per cent or so, the rest is allowance for a blow that was no ideal sticking one."""

SIGMAS_M_S = (0.01, 0.02, 0.04)
"""Values of `SIGMA_M_S` whose effect is reported."""

SIGMA_PERIOD_S = 2.0
"""One sigma of a magnetometer period quoted in whole seconds, for a motion that is no simple rotation."""

KERNEL = ("philae_spk", "LORB_C_G_FIXED_RBD_7_V2_0.BSP")
KERNEL_CPU_S = 30
LARGEST = 1e9
"""km or km/s: what a damaged kernel may well exceed."""

J2000_UTC = "2000-01-01T12:00:00"
TDB_MINUS_UTC_S = 67.184
"""In November 2014: 35 leap seconds and 32.184 s."""


@dataclass(frozen=True)
class AfterCollision:
    """`runs`: simulated collisions as in section 3.3 of the chosen candidates, the scanned box and the paper's own set ("chosen",
    "box", "recipe"), by strategy of the wheel ("off", "held"). `known`: those of the chosen ones at the kernel's times and speeds,
    weighted (:func:`condition`)."""

    chain: Chain
    runs: dict[str, dict[str, xr.Dataset]]
    known: xr.Dataset


def compute(case: Case, chain: Chain, n: int, seed: int = 0, **options: Any) -> AfterCollision:
    """Simulate collisions: `n` of the chosen candidates, half as many of box and recipe; `options` of `outcomes`."""

    def simulated(of: Candidates, strategy: str, count: int, scenario: Scenario) -> xr.Dataset:
        starts, count = of.dataset(), max(count, 1)
        return outcomes(case.vehicle, starts, strategy, count, seed, scenario=scenario, **options)

    paper, real = paper_scenario(case, chain.rebound), case_scenario(case, chain.rebound)
    sets = {"chosen": chain.chosen, "box": chain.box, "recipe": chain.recipe}
    runs = {
        name: {
            strategy: simulated(of, strategy, n if name == "chosen" else n // 2, paper)
            for strategy in ("off", "held")
        }
        for name, of in sets.items()
    }
    return AfterCollision(chain, runs, condition(case, simulated(chain.chosen, "off", n, real)))


def rows(collision: AfterCollision) -> list[Row]:
    """Published figures of section 3.3 beside ours."""
    return [*_sun_rows(collision), *_blow_rows(collision)]


def rz_range(runs: xr.Dataset) -> tuple[float, float, float]:
    """Lowest and highest r_z that any run reaches, and where the run ends that is lowered least; to a bin."""
    lowest, share = lowest_rz(runs), runs["rz_share"].values
    top = float(runs["rz"].values[np.nonzero(np.nansum(share, axis=0))[0][-1]] + 1 / share.shape[1])
    return float(np.nanmin(lowest)), top, float(np.nanmax(lowest))


def _sun_rows(collision: AfterCollision) -> list[Row]:
    """Heights of the Sun between collision and second touchdown, wheel off and held."""
    chain, runs = collision.chain, collision.runs
    case, about = chain.case, chain.chosen.about
    shares = {of: {s: tally(each) for s, each in sets.items()} for of, sets in runs.items()}
    off, held = shares["chosen"]["off"], shares["chosen"]["held"]
    ends = {of: rz_range(sets["off"]) for of, sets in runs.items()}
    kept = {of: rz_range(sets["held"]) for of, sets in runs.items()}
    n = runs["chosen"]["off"].sizes["run"]
    low, high, reaches = ends["recipe"]
    whole = row(
        case, "rz_range_wheel_off", [low, high], runs=n, reaches=reaches, about=about, off=off
    )
    least = row(case, "rz_min_wheel_held", kept["recipe"][0], about=about, held=held)

    def share(name: str, strategy: str, quantity: str, agrees: bool, **texts: Any) -> Row:
        chosen, box, recipe = (shares[of][strategy][quantity] for of in ("chosen", "box", "recipe"))
        shown = row(case, name, recipe.value, about=about, held=held, **texts)
        return share_of_candidates(shown, chain.name, chosen, box, agrees)

    rare = bool(held["rz_time_below_-0.2"].value <= RARELY)
    often = bool(off["rz_time_below_0"].value >= OFTEN)
    densities = [density(each)["density"] for each in runs["chosen"].values()]
    areas = [float(each.sum() * 2 / each.size) for each in densities]
    return [
        over_candidates(whole, chain.name, ends["chosen"][:2], ends["box"][:2]),
        over_candidates(least, chain.name, kept["chosen"][::2], kept["box"][::2]),
        share("rz_rare_wheel_held", "held", "rz_time_below_-0.2", rare, rarely=RARELY),
        share("rz_often_negative", "off", "rz_time_below_0", often, often=OFTEN),
        row(case, "rz_density_area", areas, chain=chain.name),
        row(case, "collision_runs", n, chain=chain.name),
    ]


def _blow_rows(collision: AfterCollision) -> list[Row]:
    """The collision itself against the trajectory kernel and the magnetometer."""
    chain, known = collision.chain, collision.known
    case, name, chosen = chain.case, chain.name, chain.chosen
    lines, facts = {line["name"]: line for line in weightings(known)}, facts_of(known)
    drawn, kernel = lines["as drawn"], lines[f"kernel, sigma {SIGMA_M_S:g} m/s"]
    longest = max(float(np.linalg.norm(leg.tip_B_m)) for leg in case.vehicle.legs)
    slowest = facts["speed_after"] / longest
    rate = row(
        case,
        "rate_at_collision",
        float(chain.recipe.speed_collision.mean()),
        about=chosen.about,
        mean=chosen.speed_collision.mean(),
    )
    ours, possible = (c.range(c.speed_collision) for c in (chosen, chain.box))
    return [
        over_candidates(rate, name, ours, possible),
        row(case, "collision_speed", facts["speed_before"]),
        row(case, "path_length", facts["path_length"]),
        row(
            case,
            "kernel_velocity_change",
            float(np.nanmedian(known["velocity_change"])),
            chain=name,
            explained=explained(known),
            within=2 * SIGMA_M_S,
            kernel=kernel,
            drawn=drawn,
        ),
        row(
            case,
            "romap_period_after",
            kernel["median_period_after"],
            chain=name,
            kernel=kernel,
            drawn=drawn,
            slowest=slowest,
            period=2 * np.pi / slowest,
        ),
    ]


# ---- What is known of the collision ------------------------------------------------------------------------------------------


def condition(case: Case, runs: xr.Dataset, facts: dict[str, float] | None = None) -> xr.Dataset:
    """Weight simulated collisions by the kernel, and by the magnetometer's period before the collision.

    Parameters
    ----------
    runs : Dataset
        Of :func:`sunspin.landing.outcomes.outcomes` at the kernel's speed before the collision: from another speed those after
        it mean nothing.
    facts : dict, optional
        Of :func:`kernel_facts`; default: those that ship with the case.

    Returns
    -------
    xarray.Dataset
        Of kind "collision". The runs' `velocity_change`, `speed_after`, rates and `leg`, and `weight`, that of the default sigma:
        1 for a collision that gives jump and speed exactly, 0 for a run that failed; `value` and `error` over (weighting,
        quantity), NaN where there is no error; `explained` with `explained_error`, the share of drawn collisions within two sigma
        of both facts; `fact_value (fact)`.
    """
    facts = facts or published_facts(case)
    before, after = (
        np.linalg.norm(runs[f"omega_{x}_B"].values, axis=1) for x in ("before", "after")
    )
    off = np.hypot(*(runs[x].values - facts[x] for x in ("velocity_change", "speed_after")))
    near = estimate(np.where(np.isnan(off), np.nan, off < 2 * SIGMA_M_S))
    with np.errstate(divide="ignore"):
        period, period_after = 2 * np.pi / before, 2 * np.pi / after
    by_sigma = {sigma: _likelihood(off / sigma) for sigma in SIGMAS_M_S}
    # one reading of three: the magnetometer's period is that of the body rate
    spin = _likelihood((period - case.published["romap_period_before"].value) / SIGMA_PERIOD_S)
    weights = {
        "as drawn": np.isfinite(after).astype(float),
        **{f"kernel, sigma {sigma:g} m/s": weight for sigma, weight in by_sigma.items()},
        "13 s before": spin,
        "kernel and 13 s before": by_sigma[SIGMA_M_S] * spin,
    }
    inertia = case.vehicle.require_inertia()
    precession = runs["momentum_after"].values / ((inertia[0, 0] + inertia[1, 1]) / 2)
    published_after = float(case.published["romap_period_after"].value)
    agrees = np.abs(period_after - published_after) < 2 * SIGMA_PERIOD_S
    agrees = np.where(np.isnan(period_after), np.nan, agrees)

    def median_period(weight: np.ndarray) -> float:
        use = np.isfinite(period_after) & (weight > 0)
        values, shares = period_after[use], weight[use]
        if not use.any():
            return float("nan")
        return float(np.quantile(values, 0.5, weights=shares, method="inverted_cdf"))

    rate = "rad s-1"
    quantities = {
        "effective_runs": ("1", lambda w: Estimate(effective_runs(w), np.nan)),
        "rate_before": (rate, lambda w: estimate(before, w)),
        "rate_after": (rate, lambda w: estimate(after, w)),
        "spin_after": (rate, lambda w: estimate(np.abs(runs["omega_after_B"].values[:, 2]), w)),
        "precession_after": (rate, lambda w: estimate(precession, w)),
        "median_period_after": ("s", lambda w: Estimate(median_period(w), np.nan)),
        "period_agrees": ("1", lambda w: estimate(agrees, w)),
    }
    table = [[mean(weight) for _, mean in quantities.values()] for weight in weights.values()]
    pure, by = {"units": "1"}, ("weighting", "quantity")
    likelihood = pure | {"long_name": "likelihood under the kernel's speeds"}
    return (
        runs[["velocity_change", "speed_after", "omega_before_B", "omega_after_B", "leg"]]
        .assign(
            weight=("run", by_sigma[SIGMA_M_S], likelihood),
            value=(by, [[mean.value for mean in line] for line in table]),
            error=(by, [[mean.error for mean in line] for line in table]),
            explained=((), near.value, pure),
            explained_error=((), near.error, pure),
            fact_value=("fact", list(facts.values())),
        )
        .assign_coords(
            weighting=list(weights),
            quantity=list(quantities),
            unit=("quantity", [unit for unit, _ in quantities.values()]),
            fact=list(facts),
            fact_unit=("fact", ["m" if name == "path_length" else "m s-1" for name in facts]),
        )
        .assign_attrs(
            kind="collision",
            sigma_m_s=SIGMA_M_S,
            sigma_period_s=SIGMA_PERIOD_S,
            period_after_s=published_after,
        )
    )


def _likelihood(off: np.ndarray) -> np.ndarray:
    """Of what is `off` by so many sigma, 1 where by none; 0 where that is not known."""
    return np.nan_to_num(np.exp(-0.5 * off**2), nan=0.0)


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

    Raises
    ------
    InputError
        A kernel that is missing, cannot be read, or holds no speeds of this landing.
    """
    path = Path(folder).joinpath(*KERNEL)
    begin, blow, landing = (
        tdb_of(case, name) for name in ("first_touchdown", "collision", "second_touchdown")
    )
    seconds = np.arange(np.ceil(begin), blow, 1.0)
    states = states_of(path, [blow, blow + 1.0, landing, landing + 1.0, *seconds])
    before, after, down, up = states[:4, 3:]
    facts = {
        "speed_before": before,
        "speed_after": after,
        "velocity_change": after - before,
        "speed_before_landing": down,
        "speed_after_landing": up,
    }
    sizes = {name: float(np.linalg.norm(velocity)) for name, velocity in facts.items()}
    steps = np.diff(states[4:, :3], axis=0)
    sizes["path_length"] = float(np.linalg.norm(steps, axis=1).sum())
    if not all(0 <= value < 1e3 * LARGEST for value in sizes.values()):
        raise InputError(
            "the trajectory kernel holds no speeds of this landing",
            do="download it again",
            where=str(path),
        )
    return sizes


def states_of(path: Path, tdb_s: Sequence[float]) -> np.ndarray:
    """Positions and velocities (n, 6) of the trajectory kernel, m and m/s over the comet in its axes, at TDB seconds past J2000.

    They are read in another process, as a damaged kernel may end it; NaN beyond `LARGEST`, an `InputError` where there are none.
    """
    where = str(path)
    if find_spec("spiceypy") is None:
        what, do = "reading a trajectory kernel needs spiceypy", 'pip install "sunspin[spice]"'
        raise InputError(what, do=do)
    if not path.is_file():
        do = "docs/data.md says where it comes from"
        raise InputError("the trajectory kernel is not there", do=do, where=where)
    script = Path(__file__).with_name("kernel_states.py")
    times = np.asarray(tdb_s, dtype=np.float64).tobytes()
    try:
        printed = elsewhere(script, str(path.resolve()), content=times, seconds=KERNEL_CPU_S)
    except Elsewhere as error:
        what = f"the trajectory kernel cannot be read ({error})"
        raise InputError(what, do="download it again", where=where) from None
    states = np.frombuffer(printed, dtype=np.float64).reshape(-1, 6)
    return np.where(np.abs(states) < LARGEST, 1e3 * np.clip(states, -LARGEST, LARGEST), np.nan)


def tdb_of(case: Case, event: str) -> float:
    """TDB seconds past J2000 of an event."""
    moment = case.require_timeline().event(event)
    return utc_seconds(moment.refined_utc or moment.utc, J2000_UTC) + TDB_MINUS_UTC_S


def against_kernel(case_name: str, runs: xr.Dataset, data: Path | None) -> xr.Dataset:
    """The simulated collisions `runs` against the kernel in the folder `data`, or against the facts that come with the case.

    Raises
    ------
    InputError
        No such kernel is known for the case, or the runs have no collision.
    """
    case = load_case(case_name) if case_name in case_names() else None
    if (
        case is None
        or "kernel_speed_before" not in case.published
        or not np.isfinite(runs["speed_after"]).any()
    ):
        raise InputError(
            "--condition needs collisions of a case with a trajectory kernel",
            do="use it with philae",
        )
    there = data if data is not None and data.joinpath(*KERNEL).is_file() else None
    return condition(case, runs, None if there is None else kernel_facts(case, there))
