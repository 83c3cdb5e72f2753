"""What other commands to the wheel would have done (paper, section 4): tip speed, friction, first contact, pose, best delay."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.cases import Case
from sunspin.landing import strategies as st
from sunspin.landing.outcomes import outcomes
from sunspin.landing.scenario import Scenario
from sunspin.landing.tally import Estimate, tally
from sunspin.philae.candidates import Chain
from sunspin.philae.row import Row, row, share_of_candidates


class Strategies(NamedTuple):
    """Landings at the kernel's times and speeds.

    `table`, `runs`: of the chosen candidates, the comparison of the strategies, and the runs of each by its name; `off`: tallies
    with the wheel off of the chosen candidates, the scanned box and the paper's own set; `delay`: search of the best delay of
    switching off; `alternatives`: assumption in words -> tally with the wheel off.
    """

    chain: Chain
    table: xr.Dataset
    runs: dict[str, xr.Dataset]
    off: dict[str, dict[str, Estimate]]
    delay: xr.Dataset
    alternatives: dict[str, dict[str, Estimate]]


def compute(case: Case, chain: Chain, n: int, seed: int = 0, **options: Any) -> Strategies:
    """Compare the strategies on `n` runs each; each delay and each alternative gets half as many; `options` of `outcomes`."""
    vehicle, (_, real) = case.vehicle, chain.rebound.scenarios()
    motions, half = chain.chosen.dataset(), max(n // 2, 1)
    table, runs = st.compare(vehicle, motions, st.STRATEGIES, n, seed, real, **options)
    table.attrs["synthetic"] = case.telemetry.attrs.get("synthetic", 0)

    def off(starts: xr.Dataset, count: int, scenario: Scenario) -> dict[str, Estimate]:
        return tally(outcomes(vehicle, starts, "off", count, seed, scenario=scenario, **options))

    others = {"box": chain.box, "recipe": chain.recipe}
    by_set = {name: off(each.dataset(), n, real) for name, each in others.items()}
    by_set["chosen"] = tally(runs["off"])
    delay = st.best_delay(vehicle, motions, n=half, seed=seed, scenario=real, **options)
    # the vertical is the least known of what is assumed
    alternatives = {
        about: off(motions, half, replace(real, vertical=vertical))
        for about, vertical in (
            ("any vertical", "any"),
            ("within 30 degrees of upright", np.radians(30.0)),
        )
    }
    return Strategies(chain, table, runs, by_set, delay, alternatives)


def rows(strategies: Strategies) -> list[Row]:
    """Published figures of section 4 beside ours."""
    chain, off, delay = strategies.chain, strategies.off, strategies.delay
    case, name, chosen = chain.case, chain.name, off["chosen"]
    paper = {key: figure.value for key, figure in case.published.items()}
    held = tally(strategies.runs["held"])
    # the wheel switched off at rest: its torque, and what the feet have to hold
    ways = st.wheel_stop_at_rest(case.vehicle, paper["gravity"])
    rest = next(way for way in ways if way["way"] == "off")
    shares = strategies.alternatives.items()
    spread = ", ".join(f"{assumed} {share['touch_leg'].value:.3f}" for assumed, share in shares)
    texts = {"off": chosen, "held": held, "rest": rest, "spread": spread}
    row_of = partial(row, case, speed=case.vehicle.wheels[0].speed_rad_s, **texts)

    def share(id: str, quantity: str) -> Row:
        box, recipe = off["box"][quantity], off["recipe"][quantity]
        shown = row_of(id, recipe.value, chain=name)
        return share_of_candidates(shown, name, chosen[quantity], box, None)

    # a leg's tip: v + |l| |omega|
    longest = max(float(np.linalg.norm(leg.tip_B_m)) for leg in case.vehicle.legs)
    turning = longest * paper["rate_at_collision"]
    speeds = {"off": chosen["leg_tip_speed"].value, "held": held["leg_tip_speed"].value}
    speeds["fast"] = paper["collision_speed"] + turning
    speeds["spun"] = paper["collision_speed"] + longest * 2 * np.pi / paper["romap_period_before"]

    # when to switch the wheel off for a landing on the legs
    metric, tips = (
        delay["value"].sel(quantity=quantity).values
        for quantity in (delay.attrs["metric"], "leg_tip_speed")
    )
    good = delay["delay_s"].values[delay["as_good"].values] / 60
    best = row_of(
        "best_switch_off_delay",
        delay.attrs["best_s"] / 60,
        chain=name,
        best=metric.max(),
        at_once=metric[0],
        as_good=", ".join(f"{minutes:g}" for minutes in good),
        low=min(good),
        high=max(good),
        within=[t / 60 for t in delay.attrs["spread_s"]],
        tip_best=tips[int(np.argmax(metric))],
        tip=[tips[0], tips[-1]],
    )
    return [
        row(case, "leg_tip_speed", paper["landing_speed"] + turning, **speeds),
        row_of("landing_speed", paper["kernel_speed_before_landing"]),
        row_of("final_friction_torque", rest["torque_N_m"]),
        row_of("final_foot_force", rest["foot_force_N"]),
        row_of("weight", 3 * rest["weight_per_foot_N"]),
        share("first_contact_panel", "touch_panel"),
        share("rest_on_panel", "rest_panel"),
        share("antenna_serves", "antenna_at_rest"),
        best,
    ]
