"""Philae after the collision, all of it: Fig. 13, what touched first, what other commands to the wheel would have done.

`compute` runs the study on a set of candidate rates; `rows` puts each published figure beside ours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr

from sunspin.landing import strategies as st
from sunspin.landing.outcomes import outcomes
from sunspin.landing.scenario import Scenario, case_scenario, paper_scenario
from sunspin.landing.tally import Estimate, density, lowest_rz, tally
from sunspin.philae import collision as co
from sunspin.philae.candidates import Candidates, Chain
from sunspin.philae.row import NARROWER, Row, over_candidates, published_row, share_of_candidates
from sunspin.telemetry.case import Case
from sunspin.vehicle import HullPart, Vehicle

RUNS = 100_000
HALF_DIGIT = 0.005
"""Half a unit of the last digit of figures printed to two decimals."""

RARELY, OFTEN = 0.05, 0.25
"""Shares of the time that count as "rarely" and as "often", which is all that the paper says."""

SHIFT_M = 0.1
"""Shift of the hull along z whose effect on the first contact is reported: the uncertainty of Philae's hull."""

CONE_DEG = 30.0
"""Half-angle of a narrower distribution of the local vertical, about upright at the touchdown."""


@dataclass(frozen=True)
class Shares:
    """What collisions of one set of candidates lead to: `paper` as in section 3.3, `real` at the kernel's times and speeds.

    Both by strategy ("off", "held"): Datasets of `outcomes`; `paper_tally`, `real_tally`: their tallies.
    """

    paper: dict[str, xr.Dataset]
    real: dict[str, xr.Dataset]

    @cached_property
    def paper_tally(self) -> dict[str, dict[str, Estimate]]:
        return {name: tally(runs) for name, runs in self.paper.items()}

    @cached_property
    def real_tally(self) -> dict[str, dict[str, Estimate]]:
        return {name: tally(runs) for name, runs in self.real.items()}


@dataclass(frozen=True)
class Landing:
    """All results: shares of the chosen candidates, of the scanned box and of the paper's own set; of the chosen ones also the
    collision held against public facts, strategies, the best delay, other assumptions."""

    case: Case
    chain: Chain
    chosen: Shares
    box: Shares
    recipe: Shares
    collision: co.Conditioned
    strategies: xr.Dataset
    strategy_runs: dict[str, xr.Dataset]
    delays: list[st.BestDelay]
    settling: list[dict[str, Any]]
    alternatives: dict[str, dict[str, Estimate]]


def compute(case: Case, chain: Chain, *, n: int = RUNS, seed: int = 0, **options: Any) -> Landing:
    """Run the study.

    Parameters
    ----------
    chain : Chain
        Candidates, box and recipe.
    n : int
        Runs of Fig. 13 and of the collision for the chosen candidates, half as many for the others; strategies get a fifth, each
        delay a tenth.
    options
        workers, progress, scheduler.
    """
    vehicle, as_paper, real = case.vehicle, paper_scenario(case, chain.rebound), case_scenario(case, chain.rebound)

    def runs(of: Candidates, strategy: str, count: int, scenario: Scenario, craft: Vehicle = vehicle) -> xr.Dataset:
        return outcomes(craft, of.dataset(), strategy, count, seed, scenario=scenario, **options)

    def shares(of: Candidates, count: int, true: dict[str, xr.Dataset] | None = None) -> Shares:
        paper = {name: runs(of, name, count, as_paper) for name in ("off", "held")}
        return Shares(paper, {name: runs(of, name, fifth, real) for name in ("off", "held")} if true is None else true)

    half, fifth, tenth = max(n // 2, 1), max(n // 5, 1), max(n // 10, 1)
    motions = chain.chosen.dataset()
    table, by_name = st.compare(vehicle, motions, st.STRATEGIES, fifth, seed, real, **options)
    search = st.best_delay(vehicle, motions, n=tenth, seed=seed, scenario=real, **options)
    return Landing(
        case=case,
        chain=chain,
        chosen=shares(chain.chosen, n, {name: by_name[name] for name in ("off", "held")}),
        box=shares(chain.box, half),
        recipe=shares(chain.recipe, half),
        collision=co.condition(case, runs(chain.chosen, "off", n, real)),
        strategies=table,
        strategy_runs=by_name,
        delays=[search],
        settling=st.settling(vehicle, case.published["gravity"].value),
        alternatives={
            name: tally(runs(chain.chosen, "off", tenth, *assumed)) for name, assumed in _alternatives(vehicle, real).items()
        },
    )


def _alternatives(vehicle: Vehicle, real: Scenario) -> dict[str, tuple[Scenario, Vehicle]]:
    cone = float(np.radians(CONE_DEG))
    return {
        f"body {SHIFT_M:g} m lower": (real, shifted_hull(vehicle, -SHIFT_M)),
        f"body {SHIFT_M:g} m higher": (real, shifted_hull(vehicle, SHIFT_M)),
        "any vertical": (replace(real, vertical="any"), vehicle),
        f"vertical within {CONE_DEG:g} degrees of upright": (replace(real, vertical=cone), vehicle),
    }


def shifted_hull(vehicle: Vehicle, dz_m: float) -> Vehicle:
    """The vehicle with its hull, not its legs, moved along z."""
    return replace(vehicle, hull=tuple(HullPart(p.name, p.points_B_m + [0, 0, dz_m], p.panel) for p in vehicle.hull))


def rows(landing: Landing) -> list[Row]:
    """Published figures of sections 3.3 and 4 beside ours."""
    return [*_sun_rows(landing), *_collision_rows(landing), *_speed_rows(landing), *_rest_rows(landing)]


def _ours(landing: Landing, id: str, what: str, ours: Any, unit: str, note: str, published: Any = "not given as a number") -> Row:
    return Row(
        id, what, published, ours, unit, None, None, note, "paper, sections 3.3 and 4", kind="not_comparable",
        chain=landing.chain.name,
    )  # fmt: skip


def _judged(landing: Landing, id: str, what: str, ours: Any, unit: str, note: str, published: str) -> Row:
    """A row whose published side is a word, to be judged by the criterion in the note."""
    return replace(_ours(landing, id, what, ours, unit, note, published), kind="test")


def rz_range(runs: xr.Dataset) -> tuple[float, float, float]:
    """Lowest and highest r_z that any run reaches, and where the run ends that is lowered least; to a bin."""
    lowest, share = lowest_rz(runs), runs["rz_share"].values
    top = float(runs["rz"].values[np.nonzero(np.nansum(share, axis=0))[0][-1]] + 1 / share.shape[1])
    return float(np.nanmin(lowest)), top, float(np.nanmax(lowest))


def _share(landing: Landing, row: Row, quantity: str, strategy: str, agrees: bool | None, of: str = "paper_tally") -> Row:
    """The row with a share over even draws of the chosen candidates and of the scanned box."""
    chosen, box = (getattr(shares, of)[strategy][quantity] for shares in (landing.chosen, landing.box))
    return share_of_candidates(row, landing.chain.name, chosen, box, agrees)


def _sun_rows(landing: Landing) -> list[Row]:
    case, chain = landing.case, landing.chain
    off, held = (landing.chosen.paper_tally[name] for name in ("off", "held"))
    recipe = landing.recipe.paper_tally
    low, high, reaches = rz_range(landing.recipe.paper["off"])
    ends = {name: rz_range(shares.paper["off"]) for name, shares in (("chosen", landing.chosen), ("box", landing.box))}
    lowest = {
        name: lowest_rz(shares.paper["held"])
        for name, shares in (("chosen", landing.chosen), ("box", landing.box), ("recipe", landing.recipe))
    }
    span = {name: (float(np.nanmin(values)), float(np.nanmax(values))) for name, values in lowest.items()}
    areas = [
        float(density(landing.chosen.paper[name])["density"].sum() * 2 / landing.chosen.paper[name].sizes["rz"])
        for name in ("off", "held")
    ]
    n = landing.chosen.paper["off"].sizes["run"]
    whose = f"ours by the paper's recipe; low and high over {chain.chosen.about}"
    range_off = published_row(
        case, "rz_range_wheel_off", [low, high], None,
        f"{n} runs; the run that is lowered least still reaches {reaches:.2f}; {whose}, where r_z < -0.5 for a share "
        f"{off['rz_time_below_-0.5']} of the time, in {off['rz_ever_below_-0.5']} of the runs",
    )  # fmt: skip
    informed = bool(ends["chosen"][1] - ends["chosen"][0] < NARROWER * (ends["box"][1] - ends["box"][0]))
    rare, often = held["rz_time_below_-0.2"], off["rz_time_below_0"]
    return [
        replace(
            range_off, depends="candidates", chain=chain.name, low=ends["chosen"][0], high=ends["chosen"][1],
            prior_low=ends["box"][0], prior_high=ends["box"][1], informative=informed,
        ),
        over_candidates(
            published_row(
                case, "rz_min_wheel_held", span["recipe"][0], None,
                f"lowest r_z of a run with the wheel held; {whose}: {held['rz_ever_below_-0.5']} of the runs go below -0.5, for "
                f"{held['rz_time_below_-0.5']} of the time",
            ),
            chain.name, span["chosen"], span["box"], HALF_DIGIT,
        ),
        _share(
            landing, _judged(
                landing, "rz_rare_wheel_held", case.published["rz_rare_wheel_held"].what,
                recipe["held"]["rz_time_below_-0.2"].value, "1", "share of the time below -0.2, wheel held; criterion for "
                    f"rarely: at most {RARELY:.0%}; {whose}, in "
                f"{held['rz_ever_below_-0.2']} of whose runs r_z goes there at some time", "rarely below -0.2",
            ), "rz_time_below_-0.2", "held", bool(rare.value <= RARELY),
        ),
        _share(
            landing, _judged(
                landing, "rz_often_negative", "share of the time with r_z < 0 after the collision, wheel off",
                recipe["off"]["rz_time_below_0"].value, "1",
                f"criterion for often: at least {OFTEN:.0%}; {whose}; held {held['rz_time_below_0']}", "often",
            ), "rz_time_below_0", "off", bool(often.value >= OFTEN),
        ),
        Row(
            "rz_density_area", "area under the densities of r_z: wheel off, held", 1.0, areas, "1", 1e-6,
            bool(np.all(np.abs(np.array(areas) - 1) <= 1e-6)), "sum over bins times width", "paper, section 3.3, Fig. 13",
            kind="arithmetic", chain=chain.name,
        ),
        _ours(
            landing, "collision_runs", case.published["collision_runs"].what, n, "1",
            "the first 400 of these are what a study of 400 would have drawn", case.published["collision_runs"].value,
        ),
    ]  # fmt: skip


def _collision_rows(landing: Landing) -> list[Row]:
    case, found, chain = landing.case, landing.collision, landing.chain
    line = {entry["name"]: entry for entry in found.table}
    drawn, kernel = line["as drawn"], line[f"kernel, sigma {co.SIGMA_M_S:g} m/s"]
    period = case.published["romap_period_after"].value
    slowest = found.facts["speed_after"] / max(float(np.linalg.norm(leg.tip_B_m)) for leg in case.vehicle.legs)
    rate = published_row(
        case, "rate_at_collision", float(chain.recipe.speed_collision.mean()), None,
        f"ours: mean by the paper's recipe; low and high: over {chain.chosen.about}, mean "
        f"{chain.chosen.speed_collision.mean():.3f}. "
        "The published figure is nearly what the wheel alone passes to a body at rest",
    )  # fmt: skip
    return [
        over_candidates(
            rate, chain.name, chain.chosen.range(chain.chosen.speed_collision), chain.box.range(chain.box.speed_collision),
            HALF_DIGIT,
        ),
        published_row(
            case, "collision_speed", found.facts["speed_before"], 0.01,
            "ours: comet-fixed speed of the trajectory kernel just before 16:20; the published one "
            "is a path of 650 m over 46 min", kind="arithmetic", chain="none",
        ),
        published_row(
            case, "path_length", found.facts["path_length"], 20.0, "ours: comet-fixed path of the trajectory kernel",
            kind="arithmetic", chain="none",
        ),
        published_row(
            case, "kernel_velocity_change", float(np.nanmedian(found.runs["velocity_change"])), None,
            f"median of collisions drawn at the kernel's speed; {found.explained} of them come within "
            f"{2 * co.SIGMA_M_S:g} m/s of jump "
            f"and speed after together. Weighting by both leaves {kernel['effective_runs']:.0f} of "
            f"{drawn['effective_runs']:.0f} runs' worth", kind="not_comparable", chain=chain.name,
        ),
        published_row(
            case, "romap_period_after", kernel["median_period_after"], None,
            "no figure of the paper: the magnetometer's period. Ours: median of 2 pi / |omega| of runs weighted by the kernel's "
            f"speeds, {drawn['median_period_after']:.1f} s as drawn; "
            f"mean |omega| {kernel['rate_after']} against {drawn['rate_after']} rad/s: the speeds "
            "hardly change the mean. A share "
            f"{kernel['period_agrees']} lies within 4 s of {period:g} s. After a sticking blow the "
            f"leg's end is at rest, so the speed after asks for at least {slowest:.3f} rad/s, a period of "
            f"{2 * np.pi / slowest:.0f} s or less",
            kind="not_comparable", chain=chain.name,
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
            kind="arithmetic", chain="none",
        ),
        published_row(
            case, "landing_speed", landing.collision.facts["speed_before_landing"], 0.01,
            "ours: trajectory kernel just before the second touchdown; section 3.3 has 0.2355 for the same motion",
            kind="arithmetic", chain="none",
        ),
    ]  # fmt: skip


def _rest_rows(landing: Landing) -> list[Row]:
    case, table, recipe = landing.case, landing.strategies, landing.recipe.real_tally["off"]
    rest = {entry["way"]: entry for entry in landing.settling}["off"]

    def p(name: str, strategy: str = "off") -> Estimate:
        at = table.sel(strategy=strategy, quantity=name)
        return Estimate(at["value"].item(), at["error"].item())

    def share(id: str, what: str, quantity: str, note: str) -> Row:
        told = f"ours by the paper's recipe; over {landing.chain.chosen.about}: {note}"
        return _share(landing, _ours(landing, id, what, recipe[quantity].value, "1", told), quantity, "off", None, "real_tally")

    spread = ", ".join(f"{name} {found['touch_leg'].value:.3f}" for name, found in landing.alternatives.items())
    delay = landing.delays[0]
    best, tip = int(np.argmax(delay.value)), delay.table["value"].sel(quantity="leg_tip_speed").values
    return [
        published_row(
            case, "final_friction_torque", rest["torque_N_m"], 0.1,
            f"the law of eq. 5 at {case.vehicle.wheels[0].speed_rad_s:g} rad/s; "
            f"{rest['momentum_N_m_s']:.2f} N m s is the wheel's angular "
            "momentum, which is probably what was printed", kind="arithmetic", chain="none",
        ),
        published_row(
            case, "final_foot_force", rest["foot_force_N"], 0.1,
            f"against a weight of {rest['weight_per_foot_N']:.3f} N per foot: a coefficient of friction of "
            f"{rest['friction_coefficient']:.3f} holds the lander, the argument that it would slide fails",
            kind="arithmetic", chain="none",
        ),
        published_row(case, "weight", 3 * rest["weight_per_foot_N"], 0.005, kind="arithmetic", chain="none"),
        share(
            "first_contact_panel", "probability that a panel touches the ground first at the second touchdown", "touch_panel",
            f"wheel off: panel {p('touch_panel')}, bare body {p('touch_body')}, leg {p('touch_leg')} "
            f"({spread}); held: panel {p('touch_panel', 'held')}, leg {p('touch_leg', 'held')}. The paper asks and gives "
            "no number. The lander's top did press into the ground there (O'Rourke et al., 2020, "
            "from images and magnetometer)",
        ),
        share(
            "rest_on_panel", "probability of coming to rest on a panel", "rest_panel",
            f"rolling without speed on flat ground, wheel off: panel {p('rest_panel')}, legs {p('rest_leg')}; held: "
            f"{p('rest_panel', 'held')}, {p('rest_leg', 'held')}",
        ),
        share(
            "antenna_serves", "probability that the antenna's cone holds the orbiter", "antenna_at_rest",
            f"at rest, wheel off {p('antenna_at_rest')}, held {p('antenna_at_rest', 'held')}; in "
            f"flight {p('antenna_share')} of the time, "
            f"held {p('antenna_share', 'held')}; orbiter anywhere above the horizon of the first touchdown",
        ),
        _ours(
            landing, "best_switch_off_delay", "delay of the switch-off after which a leg most often touches first",
            delay.best_s / 60, "min",
            f"over {landing.chain.chosen.about}: probability {delay.value.max():.3f} against {delay.value[0]:.3f} at the "
            "touchdown; not worse by two errors: "
            f"{', '.join(f'{t / 60:g}' for t in delay.as_good_s)} min; 68 % of resamplings within "
            f"{delay.spread_s[0] / 60:g} to "
            f"{delay.spread_s[1] / 60:g} min. The price: the fastest leg tip has {tip[best]:.2f} m/s "
            f"on average, {tip[0]:.2f} if off at once, "
            f"{tip[-1]:.2f} if the wheel is held nearly to the end", "off at touchdown was flown",
        ),
    ]  # fmt: skip
