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
from sunspin.philae.candidates import CandidateSets
from sunspin.philae.row import Row, judge_share, make_row


class Strategies(NamedTuple):
    """Landings simulated at the kernel's times and speeds.

    `table`, `runs`: comparison of the strategies over the chosen candidates, and the runs of each strategy by name. `off`: tallies
    with the wheel off by set of candidates ("chosen", "scan_range", "near_minimum"). `delay`: search of the best delay of switching
    off. `alternatives`: tally with the wheel off by alternative assumption, in words.
    """

    candidate_sets: CandidateSets
    table: xr.Dataset
    runs: dict[str, xr.Dataset]
    off: dict[str, dict[str, Estimate]]
    delay: xr.Dataset
    alternatives: dict[str, dict[str, Estimate]]


def compute(
    case: Case, candidate_sets: CandidateSets, n: int, seed: int = 0, **options: Any
) -> Strategies:
    """Compare the strategies on `n` runs each; each delay and each alternative assumption gets half as many.

    `options` are passed to :func:`sunspin.landing.outcomes.outcomes`.
    """
    # the second scenario has the kernel's times and speeds
    vehicle, (_, real) = case.vehicle, candidate_sets.rebound.scenarios()
    motions, half = candidate_sets.chosen.dataset(), max(n // 2, 1)
    table, runs = compare(vehicle, motions, STRATEGIES, n, seed, real, **options)
    table.attrs["synthetic"] = case.telemetry.attrs.get("synthetic", 0)

    def tally_off(starts: xr.Dataset, count: int, scenario: Scenario) -> dict[str, Estimate]:
        """Return the tally of `count` runs from the motions `starts` with the wheel off."""
        return tally(outcomes(vehicle, starts, "off", count, seed, scenario=scenario, **options))

    other_sets = {
        "scan_range": candidate_sets.scan_range,
        "near_minimum": candidate_sets.near_minimum,
    }
    by_set = {name: tally_off(motions.dataset(), n, real) for name, motions in other_sets.items()}
    by_set["chosen"] = tally(runs["off"])
    delay = best_delay(vehicle, motions, n=half, seed=seed, scenario=real, **options)
    # of all assumptions the local vertical is known least; a number: within this angle (rad) of upright
    alternatives = {
        about: tally_off(motions, half, replace(real, vertical=vertical))
        for about, vertical in (
            ("any vertical", "any"),
            ("within 30 degrees of upright", np.radians(30.0)),
        )
    }
    return Strategies(candidate_sets, table, runs, by_set, delay, alternatives)


def rows(strategies: Strategies) -> list[Row]:
    """Return the published figures of section 4 compared with ours."""
    candidate_sets, off, delay = strategies.candidate_sets, strategies.off, strategies.delay
    case, source, chosen = candidate_sets.case, candidate_sets.source, off["chosen"]
    paper = {key: figure.value for key, figure in case.published.items()}
    held = tally(strategies.runs["held"])
    # the wheel switched off at rest: its torque, and what the feet have to hold
    commands = wheel_stop_at_rest(case.vehicle, paper["gravity"])
    rest = next(command for command in commands if command["way"] == "off")
    shares = strategies.alternatives.items()
    spread = ", ".join(f"{assumed} {share['touch_leg'].value:.3f}" for assumed, share in shares)

    def share_row(id: str, quantity: str) -> Row:
        """Return the row of the share of runs in which `quantity` happens with the wheel off; nothing is judged to agree."""
        unjudged = row_of(id, off["near_minimum"][quantity].value, chain=source)
        return judge_share(unjudged, source, chosen[quantity], off["scan_range"][quantity], None)

    # largest speed of a leg's tip: v + |l| |omega|
    longest = max(float(np.linalg.norm(leg.tip_B_m)) for leg in case.vehicle.legs)
    from_rotation = longest * paper["rate_at_collision"]
    fast = paper["collision_speed"] + from_rotation
    spun = paper["collision_speed"] + longest * 2 * np.pi / paper["romap_period_before"]

    # when to switch the wheel off for a landing on the legs
    metric, tip_speeds = (
        delay["value"].sel(quantity=quantity).values
        for quantity in (delay.attrs["metric"], "leg_tip_speed")
    )
    # delays (min) that are as good as the best one within the sampling error
    good_min = delay["delay_s"].values[delay["as_good"].values] / 60
    as_good = ", ".join(f"{minutes:g}" for minutes in good_min)
    interval: dict[str, Any] = {"low": min(good_min), "high": max(good_min)}
    earliest, latest = (t / 60 for t in delay.attrs["spread_s"])
    notes = {
        "leg_tip_speed": f"v + |l| |omega|; {fast:.3f} with v of section 3.3, {spun:.3f} with a turn in 13 s too; simulated: wheel "
        f"off {chosen['leg_tip_speed'].value:.2f}, held {held['leg_tip_speed'].value:.2f} m/s",
        "final_friction_torque": f"the law of eq. 5 at {case.vehicle.wheels[0].speed_rad_s:g} rad/s; {rest['momentum_N_m_s']:.2f} "
        "N m s is the wheel's angular momentum, probably printed instead",
        "final_foot_force": f"with {rest['weight_per_foot_N']:.3f} N on a foot a coefficient of friction of "
        f"{rest['friction_coefficient']:.3f} holds the lander",
        "first_contact_panel": f"over the candidates, wheel off: panel {chosen['touch_panel']}, bare body {chosen['touch_body']}, "
        f"leg {chosen['touch_leg']} (with another ground's normal: {spread}); held: panel {held['touch_panel']}, leg "
        f"{held['touch_leg']}. The top of the lander did press into the ground (O'Rourke et al., 2020, from images and "
        "magnetometer)",
        "rest_on_panel": f"over the candidates, rolling without speed on flat ground: wheel off: panel {chosen['rest_panel']}, "
        f"legs {chosen['rest_leg']}; held: {held['rest_panel']}, {held['rest_leg']}",
        "antenna_serves": "over the candidates, orbiter anywhere above the horizon of the first touchdown: at rest, wheel off "
        f"{chosen['antenna_at_rest']}, held {held['antenna_at_rest']}; in flight {chosen['antenna_share']} and "
        f"{held['antenna_share']} of the time",
        "best_switch_off_delay": f"probability {metric.max():.3f}, at the touchdown {metric[0]:.3f}; not worse by two errors (the "
        f"interval): {as_good} min; 68 % of resamplings {earliest:g} to {latest:g} min. The fastest leg tip then has "
        f"{tip_speeds[int(np.argmax(metric))]:.2f} m/s, {tip_speeds[0]:.2f} if off at once, {tip_speeds[-1]:.2f} if held nearly to "
        "the end",
    }
    row_of = partial(make_row, case, notes=notes)
    return [
        row_of("leg_tip_speed", paper["landing_speed"] + from_rotation),
        row_of("landing_speed", paper["kernel_speed_before_landing"]),
        row_of("final_friction_torque", rest["torque_N_m"]),
        row_of("final_foot_force", rest["foot_force_N"]),
        row_of("weight", 3 * rest["weight_per_foot_N"]),
        share_row("first_contact_panel", "touch_panel"),
        share_row("rest_on_panel", "rest_panel"),
        share_row("antenna_serves", "antenna_at_rest"),
        row_of("best_switch_off_delay", delay.attrs["best_s"] / 60, chain=source, **interval),
    ]
