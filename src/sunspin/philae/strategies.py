"""What other commands to the wheel would have done (paper, section 4): tip speed, friction, first contact, pose, best delay."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from sunspin.landing import strategies as st
from sunspin.landing.outcomes import outcomes
from sunspin.landing.scenario import case_scenario
from sunspin.landing.tally import Estimate, tally
from sunspin.philae.candidates import Chain
from sunspin.philae.row import Row, row, share_of_candidates
from sunspin.telemetry.case import Case
from sunspin.vehicle import HullPart

SHIFT_M = 0.1
"""Shift of the hull along z whose effect on the first contact is reported: the uncertainty of Philae's hull."""

CONE_DEG = 30.0
"""Half-angle of a narrower distribution of the local vertical, about upright at the touchdown."""


@dataclass(frozen=True)
class Strategies:
    """Landings at the kernel's times and speeds.

    Attributes
    ----------
    table, runs : of the chosen candidates: comparison of the strategies, and the runs of each by its name
    off : tallies with the wheel off of the chosen candidates, the scanned box and the paper's own set
    delay : search of the best delay of switching off
    settling : of `landing.strategies.settling`
    alternatives : assumption in words -> tally with the wheel off
    """

    chain: Chain
    table: xr.Dataset
    runs: dict[str, xr.Dataset]
    off: dict[str, dict[str, Estimate]]
    delay: xr.Dataset
    settling: list[dict[str, Any]]
    alternatives: dict[str, dict[str, Estimate]]


def compute(case: Case, chain: Chain, n: int, seed: int = 0, **options: Any) -> Strategies:
    """Compare the strategies on `n` runs each; each delay and each alternative gets half as many; `options` of `outcomes`."""
    vehicle, real = case.vehicle, case_scenario(case, chain.rebound)
    motions, half = chain.chosen.dataset(), max(n // 2, 1)
    table, runs = st.compare(vehicle, motions, st.STRATEGIES, n, seed, real, **options)
    off = {"chosen": tally(runs["off"])}
    for name, candidates in (("box", chain.box), ("recipe", chain.recipe)):
        starts = candidates.dataset()
        off[name] = tally(outcomes(vehicle, starts, "off", n, seed, scenario=real, **options))
    delay = st.best_delay(vehicle, motions, n=half, seed=seed, scenario=real, **options)
    assumed = {}
    for about, dz_m in (
        (f"body {SHIFT_M:g} m lower", -SHIFT_M),
        (f"body {SHIFT_M:g} m higher", SHIFT_M),
    ):
        hull = tuple(HullPart(p.name, p.points_B_m + [0, 0, dz_m], p.panel) for p in vehicle.hull)
        assumed[about] = replace(vehicle, hull=hull), real
    assumed["any vertical"] = vehicle, replace(real, vertical="any")
    cone = replace(real, vertical=float(np.radians(CONE_DEG)))
    assumed[f"vertical within {CONE_DEG:g} degrees of upright"] = vehicle, cone
    alternatives = {
        about: tally(outcomes(craft, motions, "off", half, seed, scenario=scenario, **options))
        for about, (craft, scenario) in assumed.items()
    }
    settling = st.settling(vehicle, case.published["gravity"].value)
    return Strategies(chain, table, runs, off, delay, settling, alternatives)


def rows(strategies: Strategies) -> list[Row]:
    """Published figures of section 4 beside ours."""
    chain, off = strategies.chain, strategies.off
    case, name, about = chain.case, chain.name, chain.chosen.about
    held = tally(strategies.runs["held"])

    # a leg's tip: v + |l| |omega|
    paper = {key: figure.value for key, figure in case.published.items()}
    longest = max(float(np.linalg.norm(leg.tip_B_m)) for leg in case.vehicle.legs)
    turning = longest * paper["rate_at_collision"]
    tip = row(
        case,
        "leg_tip_speed",
        paper["landing_speed"] + turning,
        fast=paper["collision_speed"] + turning,
        spun=paper["collision_speed"] + longest * 2 * np.pi / paper["romap_period_before"],
        off=off["chosen"]["leg_tip_speed"].value,
        held=held["leg_tip_speed"].value,
    )

    # the wheel switched off at rest: its torque, and what the feet have to hold
    rest = next(way for way in strategies.settling if way["way"] == "off")
    speed = case.vehicle.wheels[0].speed_rad_s

    def share(id: str, quantity: str, **texts: Any) -> Row:
        chosen, box, recipe = (off[of][quantity] for of in ("chosen", "box", "recipe"))
        texts |= {"about": about, "off": off["chosen"], "held": held}
        shown = row(case, id, recipe.value, chain=name, **texts)
        return share_of_candidates(shown, name, chosen, box, None)

    shares = strategies.alternatives.items()
    spread = ", ".join(f"{assumed} {share['touch_leg'].value:.3f}" for assumed, share in shares)

    # when to switch the wheel off for a landing on the legs
    delay = strategies.delay
    metric, tips = (
        delay["value"].sel(quantity=quantity).values
        for quantity in (delay.attrs["metric"], "leg_tip_speed")
    )
    good = delay["delay_s"].values[delay["as_good"].values] / 60
    best = row(
        case,
        "best_switch_off_delay",
        delay.attrs["best_s"] / 60,
        chain=name,
        about=about,
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
        tip,
        row(case, "landing_speed", paper["kernel_speed_before_landing"]),
        row(case, "final_friction_torque", rest["torque_N_m"], speed=speed, rest=rest),
        row(case, "final_foot_force", rest["foot_force_N"], rest=rest),
        row(case, "weight", 3 * rest["weight_per_foot_N"]),
        share("first_contact_panel", "touch_panel", spread=spread),
        share("rest_on_panel", "rest_panel"),
        share("antenna_serves", "antenna_at_rest"),
        best,
    ]
