"""Other commands to the wheel (paper, section 4): tip speed, friction, first contact, pose at rest, best delay of switching off."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.cases import Case
from sunspin.landing.outcomes import outcomes
from sunspin.landing.scenario import Scenario
from sunspin.landing.strategies import STRATEGIES, best_delay, compare, wheel_stop_at_rest
from sunspin.landing.tally import Estimate, tally
from sunspin.philae.candidates import Chain
from sunspin.philae.row import Row, judge_share, make_row


class Strategies(NamedTuple):
    """Landings simulated at the kernel's times and speeds.

    `table`, `runs`: comparison of the strategies over the chosen candidates, and the runs of each strategy by name. `off`: tallies
    with the wheel off by set of candidates ("chosen", "scan_range", "near_minimum"). `delay`: search of the best delay of switching
    off. `alternatives`: tally with the wheel off by alternative assumption, in words.
    """

    chain: Chain
    table: xr.Dataset
    runs: dict[str, xr.Dataset]
    off: dict[str, dict[str, Estimate]]
    delay: xr.Dataset
    alternatives: dict[str, dict[str, Estimate]]


def compute(case: Case, chain: Chain, n: int, seed: int = 0, **options: Any) -> Strategies:
    """Compare the strategies on `n` runs each; each delay and each alternative assumption gets half as many.

    `options` are passed to :func:`sunspin.landing.outcomes.outcomes`.
    """
    vehicle, (_, real) = case.vehicle, chain.rebound.scenarios()
    motions, half = chain.chosen.dataset(), max(n // 2, 1)
    table, runs = compare(vehicle, motions, STRATEGIES, n, seed, real, **options)
    table.attrs["synthetic"] = case.telemetry.attrs.get("synthetic", 0)

    def tally_off(starts: xr.Dataset, count: int, scenario: Scenario) -> dict[str, Estimate]:
        """Return the tally of `count` runs with the wheel off."""
        return tally(outcomes(vehicle, starts, "off", count, seed, scenario=scenario, **options))

    sets = {"scan_range": chain.scan_range, "near_minimum": chain.near_minimum}
    by_set = {name: tally_off(motions.dataset(), n, real) for name, motions in sets.items()}
    by_set["chosen"] = tally(runs["off"])
    delay = best_delay(vehicle, motions, n=half, seed=seed, scenario=real, **options)
    # of all assumptions the local vertical is known least
    alternatives = {
        about: tally_off(motions, half, replace(real, vertical=vertical))
        for about, vertical in (
            ("any vertical", "any"),
            ("within 30 degrees of upright", np.radians(30.0)),
        )
    }
    return Strategies(chain, table, runs, by_set, delay, alternatives)


def rows(strategies: Strategies) -> list[Row]:
    """Return the published figures of section 4 compared with ours."""
    chain, off, delay = strategies.chain, strategies.off, strategies.delay
    case, name, chosen = chain.case, chain.name, off["chosen"]
    paper = {key: figure.value for key, figure in case.published.items()}
    held = tally(strategies.runs["held"])
    # the wheel switched off at rest: its torque, and what the feet have to hold
    commands = wheel_stop_at_rest(case.vehicle, paper["gravity"])
    rest = next(command for command in commands if command["way"] == "off")
    shares = strategies.alternatives.items()
    spread = ", ".join(f"{assumed} {share['touch_leg'].value:.3f}" for assumed, share in shares)
    texts = {"off": chosen, "held": held, "rest": rest, "spread": spread}
    row_of = partial(make_row, case, speed=case.vehicle.wheels[0].speed_rad_s, **texts)

    def judge(id: str, quantity: str) -> Row:
        """Return the row of the share of runs in which `quantity` happens with the wheel off."""
        possible, ours = off["scan_range"][quantity], off["near_minimum"][quantity]
        unjudged = row_of(id, ours.value, chain=name)
        return judge_share(unjudged, name, chosen[quantity], possible, None)

    # largest speed of a leg's tip: v + |l| |omega|
    longest = max(float(np.linalg.norm(leg.tip_B_m)) for leg in case.vehicle.legs)
    from_rotation = longest * paper["rate_at_collision"]
    speeds = {"off": chosen["leg_tip_speed"].value, "held": held["leg_tip_speed"].value}
    speeds["fast"] = paper["collision_speed"] + from_rotation
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
        make_row(case, "leg_tip_speed", paper["landing_speed"] + from_rotation, **speeds),
        row_of("landing_speed", paper["kernel_speed_before_landing"]),
        row_of("final_friction_torque", rest["torque_N_m"]),
        row_of("final_foot_force", rest["foot_force_N"]),
        row_of("weight", 3 * rest["weight_per_foot_N"]),
        judge("first_contact_panel", "touch_panel"),
        judge("rest_on_panel", "rest_panel"),
        judge("antenna_serves", "antenna_at_rest"),
        best,
    ]
