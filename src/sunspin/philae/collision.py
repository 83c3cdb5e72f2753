"""Motion after the collision (paper, section 3.3, Fig. 13), and the collision compared with independent measurements.

The public trajectory of the rebound gives the comet-fixed speed before and after 16:20, and the change of velocity. That change is
impulse over mass in any frame. Each simulated collision gets a likelihood from the speed after it and from the change of velocity.
The magnetometer's rotation period before the collision gives another.
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
from sunspin.philae.candidates import Candidates, CandidateSets
from sunspin.philae.row import Row, judge_range, judge_share, make_row
from sunspin.vehicle.timeline import utc_seconds

RARELY, OFTEN = 0.05, 0.25
"""Shares of the time that count as "rarely" and as "often"; the paper gives only these words."""

SIGMA_M_S = 0.02
"""Standard error (m/s) of the kernel's speed and change of velocity. The kernel gives no error. Ballistic arcs through a few imaged
points are good to a per cent or so; the rest allows for an impact that was no ideal sticking one.
"""

SIGMA_PERIOD_S = 2.0
"""Standard error (s) of a magnetometer period quoted in whole seconds, for a motion that is no simple rotation."""

KERNEL = ("philae_spk", "LORB_C_G_FIXED_RBD_7_V2_0.BSP")
"""Path of the trajectory kernel below the data folder."""
LARGEST_KM = 1e9
"""Largest position (km) or velocity (km/s) that is accepted from a kernel; a damaged one may contain any number."""

TDB_MINUS_UTC_S = 67.184
"""TDB minus UTC in November 2014: 35 leap seconds and 32.184 s."""


class AfterCollision(NamedTuple):
    """Simulated collisions of the candidate motions.

    `runs`: simulations as in section 3.3 by set of candidates ("chosen", "scan_range", "near_minimum") and by wheel strategy
    ("off", "held"), those of the chosen candidates up to the landing. `weighted`: simulations of the chosen candidates at the
    kernel's times and speeds, with the weights of :func:`condition`.
    """

    candidate_sets: CandidateSets
    runs: dict[str, dict[str, xr.Dataset]]
    weighted: xr.Dataset


class RzRange(NamedTuple):
    """Range of r_z over simulated motions, to one bin of their histograms.

    `lowest`, `highest`: extremes over all runs. `highest_minimum`: the largest of the runs' own minima.
    """

    lowest: float
    highest: float
    highest_minimum: float


def compute(
    case: Case, candidate_sets: CandidateSets, n: int, seed: int = 0, **options: Any
) -> AfterCollision:
    """Simulate `n` collisions of the chosen candidates and half as many of the other two sets.

    `options` are passed to :func:`sunspin.landing.outcomes.outcomes`.
    """

    def simulate(
        motions: Candidates, strategy: str, count: int, scenario: Scenario, until: str
    ) -> xr.Dataset:
        """Simulate `count` collisions of a set of candidates; the result says whether the telemetry is synthetic."""
        settings = dict[str, Any](seed=seed, scenario=scenario, until=until, **options)
        runs = outcomes(case.vehicle, motions.dataset(), strategy, max(count, 1), **settings)
        return runs.assign_attrs(synthetic=case.telemetry.attrs.get("synthetic", 0))

    paper, real = candidate_sets.rebound.scenarios()
    # of the sets for comparison only r_z is used
    sets = (
        ("chosen", candidate_sets.chosen, n, "landing"),
        ("scan_range", candidate_sets.scan_range, n // 2, "flight"),
        ("near_minimum", candidate_sets.near_minimum, n // 2, "flight"),
    )
    runs = {
        name: {
            strategy: simulate(motions, strategy, count, paper, until)
            for strategy in ("off", "held")
        }
        for name, motions, count, until in sets
    }
    at_kernel_speeds = simulate(candidate_sets.chosen, "off", n, real, "collision")
    return AfterCollision(candidate_sets, runs, condition(case, at_kernel_speeds))


def rz_range(runs: xr.Dataset) -> RzRange:
    """Return the range of r_z over the simulated `runs`."""
    lowest, share = lowest_rz(runs), runs["rz_share"].values  # share of the time (run, bin)
    highest_bin = np.flatnonzero(np.nansum(share, axis=0))[-1]
    half_bin = 1 / share.shape[1]  # the bins divide the range from -1 to 1
    highest = float(runs["rz"].values[highest_bin] + half_bin)
    return RzRange(float(np.nanmin(lowest)), highest, float(np.nanmax(lowest)))


def rows(collision: AfterCollision) -> list[Row]:
    """Return the published figures of section 3.3 compared with ours: r_z after the collision, and the collision itself."""
    candidate_sets, runs, weighted = collision
    case, source, chosen = candidate_sets.case, candidate_sets.source, candidate_sets.chosen
    # by set of candidates and strategy: shares of the runs in which something happens, and the range of r_z
    shares = {
        of_set: {strategy: tally(data) for strategy, data in by_strategy.items()}
        for of_set, by_strategy in runs.items()
    }
    off, held = shares["chosen"]["off"], shares["chosen"]["held"]
    rz_off = {of_set: rz_range(by_strategy["off"]) for of_set, by_strategy in runs.items()}
    rz_held = {of_set: rz_range(by_strategy["held"]) for of_set, by_strategy in runs.items()}
    n = runs["chosen"]["off"].sizes["run"]
    low, high, highest_minimum = rz_off["near_minimum"]
    densities = [density(data)["density"] for data in runs["chosen"].values()]
    # bins are 2 / size wide
    areas = [float(values.sum() * 2 / values.size) for values in densities]

    by_weighting = {entry["name"]: entry for entry in read_weightings(weighted)}
    facts = read_facts(weighted)
    drawn, kernel = by_weighting["as drawn"], by_weighting[f"kernel, sigma {SIGMA_M_S:g} m/s"]
    # the tip of the longest leg sticks, so the body cannot rotate more slowly than with this rate
    longest_m = max(np.linalg.norm(leg.tip_B_m) for leg in case.vehicle.legs)
    slowest_rad_s = facts["speed_after"] / longest_m
    notes = {
        "rz_range_wheel_off": f"every run reaches {highest_minimum:.2f} or lower; the candidates are below -0.5 for "
        f"{off['rz_time_below_-0.5']} of the time",
        "rz_min_wheel_held": f"lowest r_z of a run; {held['rz_ever_below_-0.5']} of the runs of the candidates go below -0.5",
        "rz_rare_wheel_held": f"share of the time below -0.2; criterion for rarely: at most {RARELY:.0%}",
        "rz_often_negative": f"criterion for often: at least {OFTEN:.0%}; over the candidates with the wheel held "
        f"{held['rz_time_below_0']}",
        "rate_at_collision": f"mean; over the candidates {chosen.speed_collision.mean():.3f}. The published value is nearly what "
        "the wheel alone passes to a body at rest",
        "kernel_velocity_change": f"median at the kernel's speed; {read_explained_share(weighted)} of the runs come within "
        f"{2 * SIGMA_M_S:g} m/s of jump and speed after",
        "romap_period_after": "the magnetometer's period. Ours: median of 2 pi / |omega| of runs weighted by the kernel's speeds, "
        f"{drawn['median_period_after']:.1f} s as drawn; a share {kernel['period_agrees']} is within 4 s. A blow that sticks asks "
        f"for {2 * np.pi / slowest_rad_s:.0f} s or less",
    }
    row_of = partial(make_row, case, notes=notes)

    def share_row(id: str, strategy: str, quantity: str, agrees: bool) -> Row:
        """Return the row of the share of runs, or of time, in which `quantity` happens."""
        by_set = {of_set: tallies[strategy][quantity] for of_set, tallies in shares.items()}
        unjudged = row_of(id, by_set["near_minimum"].value)
        return judge_share(unjudged, source, by_set["chosen"], by_set["scan_range"], agrees)

    rare = bool(held["rz_time_below_-0.2"].value <= RARELY)
    often = bool(off["rz_time_below_0"].value >= OFTEN)
    wheel_off = row_of("rz_range_wheel_off", [low, high])
    wheel_held = row_of("rz_min_wheel_held", rz_held["near_minimum"].lowest)
    rate = row_of("rate_at_collision", float(candidate_sets.near_minimum.speed_collision.mean()))
    rates = (
        motions.range(motions.speed_collision) for motions in (chosen, candidate_sets.scan_range)
    )
    change = float(np.nanmedian(weighted["velocity_change"]))
    # wheel off: the whole range of r_z is compared; held: the range of the runs' own minima
    whole = ((rz.lowest, rz.highest) for rz in (rz_off["chosen"], rz_off["scan_range"]))
    minima = ((rz.lowest, rz.highest_minimum) for rz in (rz_held["chosen"], rz_held["scan_range"]))
    return [
        judge_range(wheel_off, source, *whole),
        judge_range(wheel_held, source, *minima),
        share_row("rz_rare_wheel_held", "held", "rz_time_below_-0.2", rare),
        share_row("rz_often_negative", "off", "rz_time_below_0", often),
        row_of("rz_density_area", areas, chain=source),
        row_of("collision_runs", n, chain=source),
        judge_range(rate, source, *rates),
        row_of("collision_speed", facts["speed_before"]),
        row_of("path_length", facts["path_length"]),
        row_of("kernel_velocity_change", change, chain=source),
        row_of("romap_period_after", kernel["median_period_after"], chain=source),
    ]


# ---- Independent measurements of the collision -------------------------------------------------------------------------------


def condition(case: Case, runs: xr.Dataset, facts: dict[str, float] | None = None) -> xr.Dataset:
    """Weight simulated collisions by the trajectory kernel, and by the magnetometer's period before the collision.

    `runs` are outcomes (:func:`sunspin.landing.outcomes.outcomes`) simulated at the kernel's speed before the collision. From
    another speed the speeds after it could not be compared. `facts` are the kernel's speeds (:func:`kernel_facts`); default: those
    stored with the case.

    Returns
    -------
    xarray.Dataset
        Of kind "collision". Per run: `velocity_change`, `speed_after`, rates, `leg`, and `weight`. The weight is the likelihood
        with the default sigma: 1 if velocity change and speed are exact, 0 for a run that failed. `value` and `error` (weighting,
        quantity): weighted means and their sampling errors, NaN if there is none. `explained`, `explained_error`: share of the
        simulated collisions within two sigma of both facts. `fact_value` (fact): the facts.
    """
    facts = facts or published_facts(case)
    omega = (runs[f"omega_{when}_B"].values for when in ("before", "after"))
    before, after = (np.linalg.norm(rates, axis=1) for rates in omega)
    # distance (m/s) of a run from the kernel in the plane of velocity change and speed after
    error = np.hypot(
        *(runs[name].values - facts[name] for name in ("velocity_change", "speed_after"))
    )
    near = estimate(np.where(np.isnan(error), np.nan, error < 2 * SIGMA_M_S))
    with np.errstate(divide="ignore"):
        period, period_after = 2 * np.pi / before, 2 * np.pi / after

    def likelihood(normalised_error: np.ndarray) -> np.ndarray:
        """Return the Gaussian likelihood of normalised errors, relative to that of zero; 0 for NaN."""
        return np.nan_to_num(np.exp(-0.5 * normalised_error**2), nan=0.0)

    by_sigma = {sigma: likelihood(error / sigma) for sigma in (0.01, SIGMA_M_S, 0.04)}
    # the magnetometer's period may be that of the body rate, of the spin or of the precession; taken here: the body rate
    spin = likelihood((period - case.published["romap_period_before"].value) / SIGMA_PERIOD_S)
    weights = {
        "as drawn": np.isfinite(after).astype(float),
        **{f"kernel, sigma {sigma:g} m/s": weight for sigma, weight in by_sigma.items()},
        "13 s before": spin,
        "kernel and 13 s before": by_sigma[SIGMA_M_S] * spin,
    }
    inertia = case.vehicle.require_inertia()
    published_after = float(case.published["romap_period_after"].value)
    period_agrees = np.abs(period_after - published_after) < 2 * SIGMA_PERIOD_S
    period_agrees = np.where(np.isnan(period_after), np.nan, period_agrees)
    rates = {
        "rate_before": before,
        "rate_after": after,
        "spin_after": np.abs(runs["omega_after_B"].values[:, 2]),
        "precession_after": runs["momentum_after"].values / ((inertia[0, 0] + inertia[1, 1]) / 2),
    }
    quantities = ["effective_runs", *rates, "median_period_after", "period_agrees"]
    units = ["1", *(["rad s-1"] * len(rates)), "s", "1"]

    def weighted_values(weight: np.ndarray) -> list[tuple[float, float]]:
        """Return (value, error) of each quantity under weights (run); NaN if there is no error, or if all weights vanish."""
        usable, median = np.isfinite(period_after) & (weight > 0), np.nan
        if usable.any():
            median = np.quantile(
                period_after[usable], 0.5, weights=weight[usable], method="inverted_cdf"
            )
        means = [estimate(values, weight) for values in rates.values()]
        effective = effective_runs(weight), np.nan
        return [effective, *means, (median, np.nan), estimate(period_agrees, weight)]

    table = np.array([weighted_values(weight) for weight in weights.values()])
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
    """Return the kernel's facts stored with the case by name, without the prefix `kernel_`; m/s, or m for a path."""
    prefix = "kernel_"
    return {
        key.removeprefix(prefix): figure.value
        for key, figure in case.published.items()
        if key.startswith(prefix)
    }


def kernel_facts(case: Case, folder: str | Path) -> dict[str, float]:
    """Return the facts of `published_facts`, computed from the trajectory kernel in the data folder (`SUNSPIN_DATA`).

    Speeds (m/s) are comet-fixed, at the second of an event and one second later. `path_length` (m) is the length of the path from
    the first touchdown to the collision.

    Raises
    ------
    InputError
        The kernel is missing, cannot be read, or contains no plausible speeds.
    """
    path = Path(folder).joinpath(*KERNEL)
    events = "first_touchdown", "collision", "second_touchdown"
    begin, impact, landing = (event_tdb_s(case, name) for name in events)
    seconds = np.arange(np.ceil(begin), impact, 1.0)
    # four states at the events, then one at each second of the path
    states = read_kernel_states(path, [impact, impact + 1.0, landing, landing + 1.0, *seconds])
    before, after, before_landing, after_landing = states[:4, 3:]  # velocities
    velocities = {"speed_before": before, "speed_after": after, "velocity_change": after - before}
    velocities |= {"speed_before_landing": before_landing, "speed_after_landing": after_landing}
    facts = {name: float(np.linalg.norm(velocity)) for name, velocity in velocities.items()}
    steps = np.diff(states[4:, :3], axis=0)
    facts["path_length"] = float(np.linalg.norm(steps, axis=1).sum())
    if not all(0 <= value < 1e3 * LARGEST_KM for value in facts.values()):
        what = "the trajectory kernel holds no speeds of this landing"
        raise InputError(what, do="download it again", where=str(path))
    return facts


def read_kernel_states(path: Path, tdb_s: Sequence[float]) -> np.ndarray:
    """Read positions and velocities (n, 6) from the trajectory kernel, in m and m/s relative to the comet in comet-fixed axes.

    Times are TDB seconds past J2000. The kernel is read in another process, because the C library may crash on a damaged file.
    Values beyond `LARGEST_KM` become NaN. Raises `InputError` if the file cannot be read.
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
        output = run_isolated(script, str(path.resolve()), content=times, seconds=30)
    except IsolatedRunError as error:
        what = f"the trajectory kernel cannot be read ({error})"
        raise InputError(what, do="download it again", where=where) from None
    states = np.frombuffer(output, dtype=np.float64).reshape(-1, 6)
    # clipped before the multiplication, as a damaged value may overflow in it
    metres = 1e3 * np.clip(states, -LARGEST_KM, LARGEST_KM)
    return np.where(np.abs(states) < LARGEST_KM, metres, np.nan)


def event_tdb_s(case: Case, event: str) -> float:
    """Return the time of an event in TDB seconds past J2000."""
    moment = case.require_timeline().event(event)
    return utc_seconds(moment.refined_utc or moment.utc, "2000-01-01T12:00:00") + TDB_MINUS_UTC_S


def compare_with_kernel(case_name: str, runs: xr.Dataset, data: Path | None) -> xr.Dataset:
    """Return the weighted collisions (:func:`condition`) of the simulated `runs` of a case.

    The kernel in the folder `data` is used, or else the facts stored with the case. Raises `InputError` if the case has no such
    kernel, or if no run has a collision.
    """
    case = load_case(case_name) if case_name in case_names() else None
    collided = np.isfinite(runs["speed_after"]).any()
    if case is None or "kernel_speed_before" not in case.published or not collided:
        what = "--condition needs collisions of a case with a trajectory kernel"
        raise InputError(what, do="use it with philae")
    has_kernel = data is not None and data.joinpath(*KERNEL).is_file()
    return condition(case, runs, kernel_facts(case, data) if has_kernel else None)
