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
from sunspin.landing.tally import (
    Estimate,
    density,
    explained,
    facts_of,
    lowest_rz,
    tally,
    weightings,
)
from sunspin.philae import collision as co
from sunspin.philae.candidates import Candidates, Chain
from sunspin.philae.row import NARROWER, Row, over_candidates, row, share_of_candidates
from sunspin.telemetry.case import Case
from sunspin.vehicle import HullPart, Vehicle

RUNS = 100_000
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
    collision: xr.Dataset
    strategies: xr.Dataset
    strategy_runs: dict[str, xr.Dataset]
    delays: list[xr.Dataset]
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
        workers, progress, executor.
    """
    vehicle, rebound = case.vehicle, chain.rebound
    as_paper, real = paper_scenario(case, rebound), case_scenario(case, rebound)

    def runs(
        of: Candidates, strategy: str, count: int, scenario: Scenario, craft: Vehicle = vehicle
    ) -> xr.Dataset:
        return outcomes(craft, of.dataset(), strategy, count, seed, scenario=scenario, **options)

    def shares(of: Candidates, count: int, true: dict[str, xr.Dataset] | None = None) -> Shares:
        paper = {name: runs(of, name, count, as_paper) for name in ("off", "held")}
        return Shares(
            paper,
            {name: runs(of, name, fifth, real) for name in ("off", "held")}
            if true is None
            else true,
        )

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
            name: tally(runs(chain.chosen, "off", tenth, *assumed))
            for name, assumed in _alternatives(vehicle, real).items()
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
    return replace(
        vehicle,
        hull=tuple(HullPart(p.name, p.points_B_m + [0, 0, dz_m], p.panel) for p in vehicle.hull),
    )


def rows(landing: Landing) -> list[Row]:
    """Published figures of sections 3.3 and 4 beside ours."""
    return [
        *_sun_rows(landing),
        *_collision_rows(landing),
        *_speed_rows(landing),
        *_rest_rows(landing),
    ]


def rz_range(runs: xr.Dataset) -> tuple[float, float, float]:
    """Lowest and highest r_z that any run reaches, and where the run ends that is lowered least; to a bin."""
    lowest, share = lowest_rz(runs), runs["rz_share"].values
    top = float(runs["rz"].values[np.nonzero(np.nansum(share, axis=0))[0][-1]] + 1 / share.shape[1])
    return float(np.nanmin(lowest)), top, float(np.nanmax(lowest))


def _share(
    landing: Landing,
    shown: Row,
    quantity: str,
    strategy: str,
    agrees: bool | None,
    of: str = "paper_tally",
) -> Row:
    """The row with a share over even draws of the chosen candidates and of the scanned box."""
    chosen, box = (
        getattr(shares, of)[strategy][quantity] for shares in (landing.chosen, landing.box)
    )
    return share_of_candidates(shown, landing.chain.name, chosen, box, agrees)


def _sun_rows(landing: Landing) -> list[Row]:
    case, chain, about = landing.case, landing.chain, landing.chain.chosen.about
    off, held = (landing.chosen.paper_tally[name] for name in ("off", "held"))
    recipe = landing.recipe.paper_tally
    low, high, reaches = rz_range(landing.recipe.paper["off"])
    ends = {
        name: rz_range(shares.paper["off"])
        for name, shares in (("chosen", landing.chosen), ("box", landing.box))
    }
    lowest = {
        name: lowest_rz(shares.paper["held"])
        for name, shares in (
            ("chosen", landing.chosen),
            ("box", landing.box),
            ("recipe", landing.recipe),
        )
    }
    span = {
        name: (float(np.nanmin(values)), float(np.nanmax(values)))
        for name, values in lowest.items()
    }
    areas = [
        float(
            density(landing.chosen.paper[name])["density"].sum()
            * 2
            / landing.chosen.paper[name].sizes["rz"]
        )
        for name in ("off", "held")
    ]
    n = landing.chosen.paper["off"].sizes["run"]
    informed = bool(
        ends["chosen"][1] - ends["chosen"][0] < NARROWER * (ends["box"][1] - ends["box"][0])
    )
    rare, often = held["rz_time_below_-0.2"], off["rz_time_below_0"]
    seldom = row(
        case,
        "rz_rare_wheel_held",
        recipe["held"]["rz_time_below_-0.2"].value,
        rarely=RARELY,
        about=about,
        held=held,
    )
    frequent = row(
        case,
        "rz_often_negative",
        recipe["off"]["rz_time_below_0"].value,
        often=OFTEN,
        about=about,
        held=held,
    )
    return [
        row(
            case,
            "rz_range_wheel_off",
            [low, high],
            runs=n,
            reaches=reaches,
            about=about,
            off=off,
            depends="candidates",
            chain=chain.name,
            low=ends["chosen"][0],
            high=ends["chosen"][1],
            prior_low=ends["box"][0],
            prior_high=ends["box"][1],
            informative=informed,
        ),
        over_candidates(
            row(case, "rz_min_wheel_held", span["recipe"][0], about=about, held=held),
            chain.name,
            span["chosen"],
            span["box"],
        ),
        _share(landing, seldom, "rz_time_below_-0.2", "held", bool(rare.value <= RARELY)),
        _share(landing, frequent, "rz_time_below_0", "off", bool(often.value >= OFTEN)),
        row(case, "rz_density_area", areas, chain=chain.name),
        row(case, "collision_runs", n, chain=chain.name),
    ]


def _collision_rows(landing: Landing) -> list[Row]:
    case, found, chain = landing.case, landing.collision, landing.chain
    line, facts = {entry["name"]: entry for entry in weightings(found)}, facts_of(found)
    drawn, kernel = line["as drawn"], line[f"kernel, sigma {co.SIGMA_M_S:g} m/s"]
    slowest = facts["speed_after"] / max(
        float(np.linalg.norm(leg.tip_B_m)) for leg in case.vehicle.legs
    )
    rate = row(
        case,
        "rate_at_collision",
        float(chain.recipe.speed_collision.mean()),
        about=chain.chosen.about,
        mean=chain.chosen.speed_collision.mean(),
    )
    return [
        over_candidates(
            rate,
            chain.name,
            chain.chosen.range(chain.chosen.speed_collision),
            chain.box.range(chain.box.speed_collision),
        ),
        row(case, "collision_speed", facts["speed_before"]),
        row(case, "path_length", facts["path_length"]),
        row(
            case,
            "kernel_velocity_change",
            float(np.nanmedian(found["velocity_change"])),
            chain=chain.name,
            explained=explained(found),
            within=2 * co.SIGMA_M_S,
            kernel=kernel,
            drawn=drawn,
        ),
        row(
            case,
            "romap_period_after",
            kernel["median_period_after"],
            chain=chain.name,
            kernel=kernel,
            drawn=drawn,
            slowest=slowest,
            period=2 * np.pi / slowest,
        ),
    ]


def _speed_rows(landing: Landing) -> list[Row]:
    case, published = landing.case, landing.case.published
    longest = max(float(np.linalg.norm(leg.tip_B_m)) for leg in case.vehicle.legs)
    rate, fast = published["rate_at_collision"].value, published["collision_speed"].value
    off, held = (
        landing.strategies["value"].sel(strategy=s, quantity="leg_tip_speed").item()
        for s in ("off", "held")
    )
    return [
        row(
            case,
            "leg_tip_speed",
            published["landing_speed"].value + longest * rate,
            fast=fast + longest * rate,
            spun=fast + longest * 2 * np.pi / published["romap_period_before"].value,
            off=off,
            held=held,
        ),
        row(case, "landing_speed", facts_of(landing.collision)["speed_before_landing"]),
    ]


def _rest_rows(landing: Landing) -> list[Row]:
    case, table, recipe = landing.case, landing.strategies, landing.recipe.real_tally["off"]
    rest = {entry["way"]: entry for entry in landing.settling}["off"]
    about, delay = landing.chain.chosen.about, landing.delays[0]
    value, good = (
        delay["value"].sel(quantity=delay.attrs["metric"]).values,
        delay["delay_s"].values[delay["as_good"].values],
    )

    def told(strategy: str) -> dict[str, Estimate]:
        of = table.sel(strategy=strategy)
        each = zip(of["quantity"].values, of["value"].values, of["error"].values, strict=True)
        return {str(name): Estimate(float(value), float(error)) for name, value, error in each}

    def share(name: str, quantity: str, **fields: Any) -> Row:
        shown = row(
            case,
            name,
            recipe[quantity].value,
            chain=landing.chain.name,
            about=about,
            off=off,
            held=held,
            **fields,
        )
        return _share(landing, shown, quantity, "off", None, "real_tally")

    off, held = told("off"), told("held")
    spread = ", ".join(
        f"{name} {found['touch_leg'].value:.3f}" for name, found in landing.alternatives.items()
    )
    tip = delay["value"].sel(quantity="leg_tip_speed").values
    return [
        row(
            case,
            "final_friction_torque",
            rest["torque_N_m"],
            speed=case.vehicle.wheels[0].speed_rad_s,
            rest=rest,
        ),
        row(case, "final_foot_force", rest["foot_force_N"], rest=rest),
        row(case, "weight", 3 * rest["weight_per_foot_N"]),
        share("first_contact_panel", "touch_panel", spread=spread),
        share("rest_on_panel", "rest_panel"),
        share("antenna_serves", "antenna_at_rest"),
        row(
            case,
            "best_switch_off_delay",
            delay.attrs["best_s"] / 60,
            chain=landing.chain.name,
            about=about,
            best=value.max(),
            at_once=value[0],
            as_good=", ".join(f"{t / 60:g}" for t in good),
            low=min(good) / 60,
            high=max(good) / 60,
            within=[t / 60 for t in delay.attrs["spread_s"]],
            tip_best=tip[int(np.argmax(value))],
            tip=[tip[0], tip[-1]],
        ),
    ]
