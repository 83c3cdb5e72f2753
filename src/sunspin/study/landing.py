"""Philae after the collision, all of it: Fig. 13, what touched first, what other commands to the wheel would have done.

`compute` runs the study on a set of candidate rates; `rows` puts each published figure beside ours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from sunspin.cases import Case
from sunspin.infer.lines import point_at
from sunspin.study import collision as co
from sunspin.study import strategies as st
from sunspin.study.outcomes import outcomes
from sunspin.study.rebound import LINE_RANGE, published_lines
from sunspin.study.row import Row, published_row
from sunspin.study.scenario import Scenario, case_scenario, paper_scenario
from sunspin.study.tally import Estimate, density, lowest_rz, tally
from sunspin.vehicle import HullPart, Vehicle

RUNS = 100_000
LINE_POINTS = 51
"""Candidates on each of the published lines: 0.01 rad/s apart in omega_z."""

SHIFT_M = 0.1
"""Shift of the hull along z whose effect on the first contact is reported: the uncertainty of Philae's hull."""

CONE_DEG = 30.0
"""Half-angle of a narrower distribution of the local vertical, about upright at the touchdown."""


@dataclass(frozen=True)
class Landing:
    """All results. `paper` and `paper_small`: runs by strategy ("off", "held") as in "
    "section 3.3, many and as many as there."""

    case: Case
    paper: dict[str, xr.Dataset]
    paper_small: dict[str, xr.Dataset]
    collision: co.Conditioned
    strategies: xr.Dataset
    strategy_runs: dict[str, xr.Dataset]
    delays: list[st.BestDelay]
    settling: list[dict[str, Any]]
    alternatives: dict[str, dict[str, Estimate]]


def compute(case: Case, candidates: Any, *, n: int = RUNS, seed: int = 0, **options: Any) -> Landing:
    """Run the study.

    Parameters
    ----------
    candidates : (m, 3) rad/s
        Rates at the first sample after the touchdown, the near-minimum set of a scan; or a Dataset, see
        :func:`sunspin.study.outcomes.outcomes`.
    n : int
        Runs of Fig. 13 and of the collision; strategies get a fifth, each delay a tenth.
    options
        workers, progress, scheduler.
    """
    vehicle, as_paper, real = case.vehicle, paper_scenario(case), case_scenario(case)
    small = int(case.published["collision_runs"].value)

    def runs(strategy: str, count: int, scenario: Scenario, craft: Vehicle = vehicle) -> xr.Dataset:
        return outcomes(craft, candidates, strategy, count, seed, scenario=scenario, **options)

    paper = {name: runs(name, n, as_paper) for name in ("off", "held")}
    table, by_name = st.compare(vehicle, candidates, st.STRATEGIES, max(n // 5, 1), seed, real, **options)
    tenth = max(n // 10, 1)
    search = st.best_delay(vehicle, candidates, n=tenth, seed=seed, scenario=real, **options)
    return Landing(
        case=case,
        paper=paper,
        paper_small={name: first_runs(found, small) for name, found in paper.items()},
        collision=co.condition(case, runs("off", n, real)),
        strategies=table,
        strategy_runs=by_name,
        delays=[search],
        settling=st.settling(vehicle, case.published["gravity"].value),
        alternatives={name: tally(runs("off", tenth, *assumed)) for name, assumed in _alternatives(vehicle, real).items()},
    )


def _alternatives(vehicle: Vehicle, real: Scenario) -> dict[str, tuple[Scenario, Vehicle]]:
    cone = float(np.radians(CONE_DEG))
    return {
        f"body {SHIFT_M:g} m lower": (real, shifted_hull(vehicle, -SHIFT_M)),
        f"body {SHIFT_M:g} m higher": (real, shifted_hull(vehicle, SHIFT_M)),
        "any vertical": (replace(real, vertical="any"), vehicle),
        f"vertical within {CONE_DEG:g} degrees of upright": (replace(real, vertical=cone), vehicle),
    }


def published_candidates(case: Case) -> np.ndarray:
    """Rates (m, 3) in rad/s along the paper's lines, in equal steps of omega_z over the "
    "range in which they are compared."""
    omega_z = np.linspace(*LINE_RANGE, LINE_POINTS)
    return np.concatenate([point_at(point, direction, 2, omega_z) for point, direction in published_lines(case)])


def first_runs(runs: xr.Dataset, count: int) -> xr.Dataset:
    """The first runs: the same bits as a study of only so many."""
    return runs.isel(run=slice(0, min(count, runs.sizes["run"])))


def shifted_hull(vehicle: Vehicle, dz_m: float) -> Vehicle:
    """The vehicle with its hull, not its legs, moved along z."""
    return replace(vehicle, hull=tuple(HullPart(p.name, p.points_B_m + [0, 0, dz_m], p.panel) for p in vehicle.hull))


def rows(landing: Landing) -> list[Row]:
    """Published figures of sections 3.3 and 4 beside ours."""
    return [*_sun_rows(landing), *_collision_rows(landing), *_speed_rows(landing), *_rest_rows(landing)]


def _ours(case: Case, id: str, what: str, ours: Any, unit: str, note: str, published: Any = "not given as a number") -> Row:
    return Row(id, what, published, ours, unit, None, None, note, "paper, sections 3.3 and 4")


def _sun_rows(landing: Landing) -> list[Row]:
    case, off, held = landing.case, tally(landing.paper["off"]), tally(landing.paper["held"])
    small = tally(landing.paper_small["held"])
    low, high = (float(f(lowest_rz(landing.paper["off"]))) for f in (np.nanmin, np.nanmax))
    share = landing.paper["off"]["rz_share"].values
    top = float(landing.paper["off"]["rz"].values[np.nonzero(np.nansum(share, axis=0))[0][-1]] + 1 / share.shape[1])
    lowest = {name: float(np.nanmin(lowest_rz(found["held"]))) for name, found in (
        ("small", landing.paper_small), ("large", landing.paper))}  # fmt: skip
    areas = [float(density(landing.paper[name])["density"].sum() * 2 / share.shape[1]) for name in ("off", "held")]
    negative = [off["rz_time_below_0"].value, held["rz_time_below_0"].value]
    n = landing.paper["off"].sizes["run"]
    return [
        published_row(
            case, "rz_range_wheel_off", [low, top], 0.03,
            f"{n} runs; the run that is lowered least still reaches {high:.2f}; r_z < -0.5 for a "
            f"share {off['rz_time_below_-0.5']} "
            f"of the time, in {off['rz_ever_below_-0.5']} of the runs; r_z < 0 for "
            f"{off['rz_time_below_0']} of the time",
        ),
        published_row(
            case, "rz_min_wheel_held", lowest["small"], 0.03,
            f"not reproduced: of as many runs as published {small['rz_ever_below_-0.5']} go below -0.5, for "
            f"{small['rz_time_below_-0.5']} of the time; of {n} runs {held['rz_ever_below_-0.5']}, "
            f"the lowest to {lowest['large']:.2f}",
        ),
        _ours(
            case, "rz_rare_wheel_held", case.published["rz_rare_wheel_held"].what, held["rz_time_below_-0.2"].value, "1",
            f"share of the time below -0.2, {held['rz_time_below_-0.2']}; of the runs "
            f"{held['rz_ever_below_-0.2']} go there at "
            "some time: rare in time, not in runs", "rarely below -0.2",
        ),
        _ours(
            case, "rz_often_negative", "share of the time with r_z < 0 after the collision: wheel off, held", negative, "1",
            f"off {off['rz_time_below_0']} of the time, in {off['rz_ever_below_0']} of the runs; held {held['rz_time_below_0']}, "
            f"{held['rz_ever_below_0']}", "often",
        ),
        Row(
            "rz_density_area", "area under the densities of r_z: wheel off, held", 1.0, areas, "1", 1e-6,
            bool(np.all(np.abs(np.array(areas) - 1) <= 1e-6)), "sum over bins times width", "paper, section 3.3, Fig. 13",
        ),
        _ours(
            case, "collision_runs", case.published["collision_runs"].what, n, "1",
            "the first 400 of these are what a study of 400 would have drawn", case.published["collision_runs"].value,
        ),
    ]  # fmt: skip


def _collision_rows(landing: Landing) -> list[Row]:
    case, found = landing.case, landing.collision
    line = {entry["name"]: entry for entry in found.table}
    drawn, kernel = line["as drawn"], line[f"kernel, sigma {co.SIGMA_M_S:g} m/s"]
    paper = tally(landing.paper["off"])
    held = tally(landing.paper["held"])
    period = case.published["romap_period_after"].value
    slowest = found.facts["speed_after"] / max(float(np.linalg.norm(leg.tip_B_m)) for leg in case.vehicle.legs)
    return [
        published_row(
            case, "rate_at_collision", paper["rate_before"].value, 0.05,
            f"mean over the candidates, {paper['rate_before']}; with the wheel held "
            f"{held['rate_before']}. The published figure is "
            "nearly what the wheel alone passes to a body at rest",
        ),
        published_row(
            case, "collision_speed", found.facts["speed_before"], 0.01,
            "ours: comet-fixed speed of the trajectory kernel just before 16:20; the published one "
            "is a path of 650 m over 46 min",
        ),
        published_row(case, "path_length", found.facts["path_length"], 20.0, "ours: comet-fixed path of the trajectory kernel"),
        published_row(
            case, "kernel_velocity_change", float(np.nanmedian(found.runs["velocity_change"])), None,
            f"median of collisions drawn at the kernel's speed; {found.explained} of them come within "
            f"{2 * co.SIGMA_M_S:g} m/s of jump "
            f"and speed after together. Weighting by both leaves {kernel['effective_runs']:.0f} of "
            f"{drawn['effective_runs']:.0f} runs' worth",
        ),
        published_row(
            case, "romap_period_after", kernel["median_period_after"], 2 * co.SIGMA_PERIOD_S,
            "median of 2 pi / |omega| of runs weighted by the kernel's speeds, "
            f"{drawn['median_period_after']:.1f} s as drawn; "
            f"mean |omega| {kernel['rate_after']} against {drawn['rate_after']} rad/s: the speeds "
            "hardly change the mean. A share "
            f"{kernel['period_agrees']} lies within 4 s of {period:g} s. After a sticking blow the "
            "leg's end is at rest, so the "
            f"speed after asks for at least {slowest:.3f} rad/s, a period of {2 * np.pi / slowest:.0f} s or less",
        ),
    ]  # fmt: skip


def _speed_rows(landing: Landing) -> list[Row]:
    case, published = landing.case, landing.case.published
    longest = max(float(np.linalg.norm(leg.tip_B_m)) for leg in case.vehicle.legs)
    speed, rate = published["landing_speed"].value, published["rate_at_collision"].value
    variants = {v: v + longest * rate for v in (speed, published["collision_speed"].value)}
    spun = published["collision_speed"].value + longest * 2 * np.pi / published["romap_period_before"].value
    off, held = (landing.strategies["value"].sel(strategy=s, quantity="leg_tip_speed").item() for s in ("off", "held"))
    return [
        published_row(
            case, "leg_tip_speed", variants[speed], 0.005,
            "v + |l| |omega| with the published v and rate; "
            f"{variants[published['collision_speed'].value]:.3f} with the v of section 3.3, "
            f"{spun:.3f} with a turn per 13 s (magnetometer) as well. Simulated at the second "
            f"touchdown, largest of the legs: {off:.2f} m/s with the wheel off, {held:.2f} held",
        ),
        published_row(
            case, "landing_speed", landing.collision.facts["speed_before_landing"], 0.01,
            "ours: trajectory kernel just before the second touchdown; section 3.3 has 0.2355 for the same motion",
        ),
    ]  # fmt: skip


def _rest_rows(landing: Landing) -> list[Row]:
    case, table = landing.case, landing.strategies
    rest = {entry["way"]: entry for entry in landing.settling}["off"]

    def p(name: str, strategy: str = "off") -> Estimate:
        at = table.sel(strategy=strategy, quantity=name)
        return Estimate(at["value"].item(), at["error"].item())

    spread = ", ".join(f"{name} {found['touch_leg'].value:.3f}" for name, found in landing.alternatives.items())
    delay = landing.delays[0]
    best, tip = int(np.argmax(delay.value)), delay.table["value"].sel(quantity="leg_tip_speed").values
    return [
        published_row(
            case, "final_friction_torque", rest["torque_N_m"], 0.1,
            f"the law of eq. 5 at {case.vehicle.wheels[0].speed_rad_s:g} rad/s; "
            f"{rest['momentum_N_m_s']:.2f} N m s is the wheel's angular "
            "momentum, which is probably what was printed",
        ),
        published_row(
            case, "final_foot_force", rest["foot_force_N"], 0.1,
            f"against a weight of {rest['weight_per_foot_N']:.3f} N per foot: a coefficient of friction of "
            f"{rest['friction_coefficient']:.3f} holds the lander, the argument that it would slide fails",
        ),
        published_row(case, "weight", 3 * rest["weight_per_foot_N"], 0.005),
        _ours(
            case, "first_contact_panel", "probability that a panel touches the ground first at the second touchdown",
            p("touch_panel").value, "1",
            f"wheel off: panel {p('touch_panel')}, bare body {p('touch_body')}, leg {p('touch_leg')} "
            f"({spread}); held: panel "
            f"{p('touch_panel', 'held')}, leg {p('touch_leg', 'held')}. The paper asks and gives "
            "no number. The lander's top did press into the ground there (O'Rourke et al., 2020, "
            "from images and magnetometer)",
        ),
        _ours(
            case, "rest_on_panel", "probability of coming to rest on a panel", p("rest_panel").value, "1",
            f"rolling without speed on flat ground, wheel off: panel {p('rest_panel')}, legs {p('rest_leg')}; held: "
            f"{p('rest_panel', 'held')}, {p('rest_leg', 'held')}",
        ),
        _ours(
            case, "antenna_serves", "probability that the antenna's cone holds the orbiter", p("antenna_at_rest").value, "1",
            f"at rest, wheel off {p('antenna_at_rest')}, held {p('antenna_at_rest', 'held')}; in "
            f"flight {p('antenna_share')} of the time, "
            f"held {p('antenna_share', 'held')}; orbiter anywhere above the horizon of the first touchdown",
        ),
        _ours(
            case, "best_switch_off_delay", "delay of the switch-off after which a leg most often touches first",
            delay.best_s / 60, "min",
            f"probability {delay.value.max():.3f} against {delay.value[0]:.3f} at the touchdown; not "
            "worse by two errors: "
            f"{', '.join(f'{t / 60:g}' for t in delay.as_good_s)} min; 68 % of resamplings within "
            f"{delay.spread_s[0] / 60:g} to "
            f"{delay.spread_s[1] / 60:g} min. The price: the fastest leg tip has {tip[best]:.2f} m/s "
            f"on average, {tip[0]:.2f} if off at once, "
            f"{tip[-1]:.2f} if the wheel is held nearly to the end", "off at touchdown was flown",
        ),
    ]  # fmt: skip
