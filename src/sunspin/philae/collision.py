"""After the collision (paper, section 3.3, Fig. 13), and the collision against what is known of it.

The public trajectory of the rebound gives the comet-fixed speed before and after 16:20 and the jump of the velocity, which is
impulse over mass in any frame. Each simulated collision is weighted by how well it explains speed after and jump, and by the
magnetometer's period before.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.base.untrusted import IsolatedRunError, run_isolated
from sunspin.cases import Case, case_names, load_case
from sunspin.landing.outcomes import outcomes
from sunspin.landing.scenario import Scenario
from sunspin.landing.tally import (
    density,
    effective_runs,
    estimate,
    lowest_rz,
    read_explained_share,
    read_facts,
    read_weightings,
    tally,
)
from sunspin.philae.candidates import Candidates, Chain
from sunspin.philae.row import Row, over_candidates, row, share_of_candidates
from sunspin.vehicle.timeline import utc_seconds

RARELY, OFTEN = 0.05, 0.25
"""Shares of the time that count as "rarely" and as "often", which is all that the paper says."""

SIGMA_M_S = 0.02
"""How far (m/s, one sigma) a right collision may be from the kernel's speed and jump: the kernel gives no error; ballistic arcs
through a few imaged points are good to a per cent or so, the rest is allowance for a blow that was no ideal sticking one."""

SIGMA_PERIOD_S = 2.0
"""One sigma of a magnetometer period quoted in whole seconds, for a motion that is no simple rotation."""

KERNEL = ("philae_spk", "LORB_C_G_FIXED_RBD_7_V2_0.BSP")
LARGEST = 1e9
"""km or km/s: what a damaged kernel may well exceed."""

TDB_MINUS_UTC_S = 67.184
"""In November 2014: 35 leap seconds and 32.184 s."""


class AfterCollision(NamedTuple):
    """`runs`: simulated collisions as in section 3.3 of the chosen candidates, the scanned box and the paper's own set ("chosen",
    "box", "recipe"), by strategy of the wheel ("off", "held"). `known`: those of the chosen ones at the kernel's times and speeds,
    weighted (:func:`condition`)."""

    chain: Chain
    runs: dict[str, dict[str, xr.Dataset]]
    known: xr.Dataset


def compute(case: Case, chain: Chain, n: int, seed: int = 0, **options: Any) -> AfterCollision:
    """Simulate collisions: `n` of the chosen candidates, half as many of box and recipe; `options` of `outcomes`."""

    def simulated(of: Candidates, strategy: str, count: int, scenario: Scenario) -> xr.Dataset:
        starts, about = of.dataset(), dict[str, Any](seed=seed, scenario=scenario, **options)
        runs = outcomes(case.vehicle, starts, strategy, max(count, 1), **about)
        return runs.assign_attrs(synthetic=case.telemetry.attrs.get("synthetic", 0))

    paper, real = chain.rebound.scenarios()
    sets = ("chosen", chain.chosen, n), ("box", chain.box, n // 2), ("recipe", chain.recipe, n // 2)
    runs = {
        name: {strategy: simulated(of, strategy, count, paper) for strategy in ("off", "held")}
        for name, of, count in sets
    }
    return AfterCollision(chain, runs, condition(case, simulated(chain.chosen, "off", n, real)))


def rz_range(runs: xr.Dataset) -> tuple[float, float, float]:
    """Lowest and highest r_z that any run reaches, and where the run ends that is lowered least; to a bin."""
    lowest, share = lowest_rz(runs), runs["rz_share"].values
    top = float(runs["rz"].values[np.nonzero(np.nansum(share, axis=0))[0][-1]] + 1 / share.shape[1])
    return float(np.nanmin(lowest)), top, float(np.nanmax(lowest))


def rows(collision: AfterCollision) -> list[Row]:
    """Published figures of section 3.3 beside ours: heights of the Sun after the collision, and the blow itself."""
    chain, runs, known = collision
    case, name, chosen = chain.case, chain.name, chain.chosen
    shares = {of: {s: tally(each) for s, each in sets.items()} for of, sets in runs.items()}
    off, held = shares["chosen"]["off"], shares["chosen"]["held"]
    low_off = {of: rz_range(sets["off"]) for of, sets in runs.items()}
    low_held = {of: rz_range(sets["held"]) for of, sets in runs.items()}
    n = runs["chosen"]["off"].sizes["run"]
    low, high, reaches = low_off["recipe"]
    densities = [density(each)["density"] for each in runs["chosen"].values()]
    areas = [float(each.sum() * 2 / each.size) for each in densities]

    weighted, facts = {line["name"]: line for line in read_weightings(known)}, read_facts(known)
    drawn, kernel = weighted["as drawn"], weighted[f"kernel, sigma {SIGMA_M_S:g} m/s"]
    slowest = facts["speed_after"] / max(np.linalg.norm(leg.tip_B_m) for leg in case.vehicle.legs)
    texts: dict[str, Any] = {"off": off, "held": held, "kernel": kernel, "drawn": drawn}
    texts |= {"mean": chosen.speed_collision.mean(), "runs": n, "reaches": reaches}
    texts |= {"explained": read_explained_share(known), "within": 2 * SIGMA_M_S, "rarely": RARELY}
    texts |= {"often": OFTEN, "period": 2 * np.pi / slowest}
    row_of = partial(row, case, **texts)

    def share(id: str, strategy: str, quantity: str, agrees: bool) -> Row:
        of = {each: tallies[strategy][quantity] for each, tallies in shares.items()}
        shown = row_of(id, of["recipe"].value)
        return share_of_candidates(shown, name, of["chosen"], of["box"], agrees)

    rare = bool(held["rz_time_below_-0.2"].value <= RARELY)
    often = bool(off["rz_time_below_0"].value >= OFTEN)
    whole = row_of("rz_range_wheel_off", [low, high])
    least = row_of("rz_min_wheel_held", low_held["recipe"][0])
    rate = row_of("rate_at_collision", float(chain.recipe.speed_collision.mean()))
    rates = (each.range(each.speed_collision) for each in (chosen, chain.box))
    change = float(np.nanmedian(known["velocity_change"]))
    return [
        over_candidates(whole, name, low_off["chosen"][:2], low_off["box"][:2]),
        over_candidates(least, name, low_held["chosen"][::2], low_held["box"][::2]),
        share("rz_rare_wheel_held", "held", "rz_time_below_-0.2", rare),
        share("rz_often_negative", "off", "rz_time_below_0", often),
        row_of("rz_density_area", areas, chain=name),
        row_of("collision_runs", n, chain=name),
        over_candidates(rate, name, *rates),
        row_of("collision_speed", facts["speed_before"]),
        row_of("path_length", facts["path_length"]),
        row_of("kernel_velocity_change", change, chain=name),
        row_of("romap_period_after", kernel["median_period_after"], chain=name),
    ]


# ---- What is known of the collision ------------------------------------------------------------------------------------------


def condition(case: Case, runs: xr.Dataset, facts: dict[str, float] | None = None) -> xr.Dataset:
    """Weight simulated collisions by the kernel, and by the magnetometer's period before the collision.

    `runs` of :func:`sunspin.landing.outcomes.outcomes` at the kernel's speed before the collision: from another speed those after
    it mean nothing. `facts` of :func:`kernel_facts`; default: those that ship with the case.

    Returns
    -------
    xarray.Dataset
        Of kind "collision". The runs' `velocity_change`, `speed_after`, rates and `leg`, and `weight`, that of the default sigma:
        1 for a collision that gives jump and speed exactly, 0 for a run that failed; `value` and `error` over (weighting,
        quantity), NaN where there is no error; `explained` with `explained_error`, the share of drawn collisions within two sigma
        of both facts; `fact_value (fact)`.
    """
    facts = facts or published_facts(case)
    omega = (runs[f"omega_{when}_B"].values for when in ("before", "after"))
    before, after = (np.linalg.norm(each, axis=1) for each in omega)
    off = np.hypot(*(runs[x].values - facts[x] for x in ("velocity_change", "speed_after")))
    near = estimate(np.where(np.isnan(off), np.nan, off < 2 * SIGMA_M_S))
    with np.errstate(divide="ignore"):
        period, period_after = 2 * np.pi / before, 2 * np.pi / after

    def likelihood(off: np.ndarray) -> np.ndarray:
        """Of what is `off` by so many sigma, 1 where by none; 0 where that is not known."""
        return np.nan_to_num(np.exp(-0.5 * off**2), nan=0.0)

    by_sigma = {sigma: likelihood(off / sigma) for sigma in (0.01, SIGMA_M_S, 0.04)}
    # one reading of three: the magnetometer's period is that of the body rate
    spin = likelihood((period - case.published["romap_period_before"].value) / SIGMA_PERIOD_S)
    weights = {
        "as drawn": np.isfinite(after).astype(float),
        **{f"kernel, sigma {sigma:g} m/s": weight for sigma, weight in by_sigma.items()},
        "13 s before": spin,
        "kernel and 13 s before": by_sigma[SIGMA_M_S] * spin,
    }
    inertia = case.vehicle.require_inertia()
    published_after = float(case.published["romap_period_after"].value)
    agrees = np.abs(period_after - published_after) < 2 * SIGMA_PERIOD_S
    agrees = np.where(np.isnan(period_after), np.nan, agrees)
    rates = {
        "rate_before": before,
        "rate_after": after,
        "spin_after": np.abs(runs["omega_after_B"].values[:, 2]),
        "precession_after": runs["momentum_after"].values / ((inertia[0, 0] + inertia[1, 1]) / 2),
    }
    quantities = ["effective_runs", *rates, "median_period_after", "period_agrees"]
    units = ["1", *(["rad s-1"] * len(rates)), "s", "1"]

    def line(weight: np.ndarray) -> list[tuple[float, float]]:
        """Value and error of each quantity; NaN where it has no error, or nothing has weight."""
        known, median = np.isfinite(period_after) & (weight > 0), np.nan
        if known.any():
            by: dict[str, Any] = {"weights": weight[known], "method": "inverted_cdf"}
            median = np.quantile(period_after[known], 0.5, **by)
        means = [estimate(each, weight) for each in rates.values()]
        effective = effective_runs(weight), np.nan
        return [effective, *means, (median, np.nan), estimate(agrees, weight)]

    table = np.array([line(weight) for weight in weights.values()])
    pure, by = {"units": "1"}, ("weighting", "quantity")
    about = pure | {"long_name": "likelihood under the kernel's speeds"}
    kept = ["velocity_change", "speed_after", "omega_before_B", "omega_after_B", "leg"]
    data = runs[kept].assign(
        weight=("run", by_sigma[SIGMA_M_S], about),
        value=(by, table[..., 0]),
        error=(by, table[..., 1]),
        explained=((), near.value, pure),
        explained_error=((), near.error, pure),
        fact_value=("fact", list(facts.values())),
    )
    data = data.assign_coords(
        weighting=list(weights),
        quantity=quantities,
        unit=("quantity", units),
        fact=list(facts),
        fact_unit=("fact", ["m" if name == "path_length" else "m s-1" for name in facts]),
    )
    sigmas = {"sigma_m_s": SIGMA_M_S, "sigma_period_s": SIGMA_PERIOD_S}
    return data.assign_attrs(kind="collision", period_after_s=published_after, **sigmas)


def published_facts(case: Case) -> dict[str, float]:
    """The kernel's facts as they ship with the case: name without `kernel_` -> value in m/s (m)."""
    facts = case.published.items()
    return {key[7:]: fact.value for key, fact in facts if key.startswith("kernel_")}


def kernel_facts(case: Case, folder: str | Path) -> dict[str, float]:
    """The same facts read from the trajectory kernel in the data folder (`SUNSPIN_DATA`): sizes in m/s, comet-fixed, taken at the
    second of the event and one second later; `path_length` in m.

    An `InputError` where the kernel is missing, cannot be read, or holds no speeds of this landing.
    """
    path = Path(folder).joinpath(*KERNEL)
    events = "first_touchdown", "collision", "second_touchdown"
    begin, blow, landing = (tdb_of(case, name) for name in events)
    seconds = np.arange(np.ceil(begin), blow, 1.0)
    states = states_of(path, [blow, blow + 1.0, landing, landing + 1.0, *seconds])
    before, after, down, up = states[:4, 3:]
    velocities = {"speed_before": before, "speed_after": after, "velocity_change": after - before}
    velocities |= {"speed_before_landing": down, "speed_after_landing": up}
    sizes = {name: float(np.linalg.norm(velocity)) for name, velocity in velocities.items()}
    steps = np.diff(states[4:, :3], axis=0)
    sizes["path_length"] = float(np.linalg.norm(steps, axis=1).sum())
    if not all(0 <= value < 1e3 * LARGEST for value in sizes.values()):
        what = "the trajectory kernel holds no speeds of this landing"
        raise InputError(what, do="download it again", where=str(path))
    return sizes


def states_of(path: Path, tdb_s: Sequence[float]) -> np.ndarray:
    """Positions and velocities (n, 6) of the trajectory kernel, m and m/s over the comet in its axes, at TDB seconds past J2000.

    They are read in another process, as a damaged kernel may end it; NaN beyond `LARGEST`, an `InputError` where there are none.
    """
    where, missing = str(path), "the trajectory kernel is not there"
    if find_spec("spiceypy") is None:
        what, do = "reading a trajectory kernel needs spiceypy", 'pip install "sunspin[spice]"'
        raise InputError(what, do=do)
    if not path.is_file():
        raise InputError(missing, do="docs/data.md says where it comes from", where=where)
    script = Path(__file__).with_name("kernel_states.py")
    times = np.asarray(tdb_s, dtype=np.float64).tobytes()
    try:
        printed = run_isolated(script, str(path.resolve()), content=times, seconds=30)
    except IsolatedRunError as error:
        what = f"the trajectory kernel cannot be read ({error})"
        raise InputError(what, do="download it again", where=where) from None
    states = np.frombuffer(printed, dtype=np.float64).reshape(-1, 6)
    return np.where(np.abs(states) < LARGEST, 1e3 * np.clip(states, -LARGEST, LARGEST), np.nan)


def tdb_of(case: Case, event: str) -> float:
    """TDB seconds past J2000 of an event."""
    moment = case.require_timeline().event(event)
    return utc_seconds(moment.refined_utc or moment.utc, "2000-01-01T12:00:00") + TDB_MINUS_UTC_S


def against_kernel(case_name: str, runs: xr.Dataset, data: Path | None) -> xr.Dataset:
    """The simulated collisions `runs` against the kernel in the folder `data`, or against the facts that come with the case.

    An `InputError` where no such kernel is known for the case, or the runs have no collision.
    """
    case = load_case(case_name) if case_name in case_names() else None
    hit = np.isfinite(runs["speed_after"]).any()
    if case is None or "kernel_speed_before" not in case.published or not hit:
        what = "--condition needs collisions of a case with a trajectory kernel"
        raise InputError(what, do="use it with philae")
    there = data is not None and data.joinpath(*KERNEL).is_file()
    return condition(case, runs, kernel_facts(case, data) if there else None)
