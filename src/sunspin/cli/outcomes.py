"""`sunspin outcomes`."""

from __future__ import annotations

import click

from sunspin.cli.changes import TELEMETRY_KEYS, Command, load_inputs, set_options
from sunspin.cli.common import PATH, shared
from sunspin.cli.values import BODY_RATE, DIRECTION, Parsed, parse_vertical


@click.command(cls=Command)
@click.argument("vehicle")
@click.option(
    "--strategy",
    "strategies",
    multiple=True,
    help="Wheel from the touchdown on: off (motor off), held (constant speed), brake, after_rest (held until the lander rests) or "
    "delay:SECONDS (held so long, then off). Repeatable. Default: off and held.",
)
@click.option(
    "--runs", type=click.IntRange(1, 100_000_000), default=100_000, help="Runs per strategy."
)
@click.option(
    "--scan",
    type=PATH,
    help="Candidates: rates that --factor selects in scan.nc of `sunspin scan`.",
)
@click.option(
    "--omega-deg-s",
    "omega_B",
    type=BODY_RATE,
    multiple=True,
    help="Candidate: a possible body rate, deg/s, at --lead. Each run draws one candidate. Repeatable.",
)
@click.option(
    "--sun",
    "sun_B",
    type=DIRECTION,
    help="Direction to the Sun at --lead, body axes, of any length.",
)
@click.option("--lead", type=float, help="Time after touchdown at which candidate rates hold, s.")
@click.option("--before", "before_s", type=float, help="Time from --lead to the collision, s.")
@click.option(
    "--after", "after_s", type=float, help="From the end of --before (collision) to landing, s."
)
@click.option(
    "--collision-speed", "collision_speed_m_s", type=float, help="Speed in m/s; 0: no collision."
)
@click.option(
    "--landing-speed", "landing_speed_m_s", type=float, help="Total speed at the landing, m/s."
)
@click.option(
    "--vertical",
    type=Parsed(parse_vertical),
    help="Ground normal at the landing, in body axes at the touchdown: legs_down (any for which a leg tip is lowest), any, the "
    "largest angle (deg) from upright on the legs, or x,y,z.",
)
@click.option(
    "--condition",
    is_flag=True,
    help="Weight the collisions of the first strategy by their agreement with Philae's trajectory kernel (SPK).",
)
@click.option(
    "--data",
    envvar="SUNSPIN_DATA",
    type=PATH,
    help="Folder with philae_spk/ (SPK for --condition), or set SUNSPIN_DATA. Default: the speeds stored with the case philae.",
)
@set_options(
    "study.lead_s", "collision", short=("friction", "restitution", "damper"), idle=TELEMETRY_KEYS
)
@shared("--wheel-speed", "--factor", "--store", "--scheduler", "--seed", "--workers")
def outcomes(
    vehicle,
    strategies,
    runs,
    scan,
    factor,
    omega_B,
    wheel_speed,
    lead,
    condition,
    data,
    store,
    executor,
    changes,
    seed,
    workers,
    output,
    **scenario_options,
) -> None:
    """Simulate a lander after touchdown (Monte Carlo), by wheel strategy: collision, first contact, rest, orbiter in antenna cone.

    For philae, times, speeds and candidate rates (on four straight lines in the space of rates, from the paper) are built in. For
    another vehicle give at least --omega-deg-s (or --scan), --sun and --after; times may also be in timeline.toml next to its file.
    With --out, writes outcomes-STRATEGY.nc, strategies.nc and figures.

    \b
    Examples:
      sunspin outcomes philae --runs 20000 --strategy off --strategy held --out landing
      sunspin outcomes vehicle.toml --omega-deg-s 6,0,12 --sun 0,0,1 --after 600 --collision-speed 0 --runs 1000
    """
    from sunspin.landing.scenario import build_scenario, parse_strategy
    from sunspin.landing.strategies import compare, comparison_tree
    from sunspin.philae.candidates import select_start_rates
    from sunspin.philae.collision import compare_with_kernel

    inputs = load_inputs(vehicle, changes)
    craft, assumptions = inputs.craft, inputs.assumptions
    names = dict.fromkeys(strategies or ("off", "held"))  # each once, in the order given
    chosen = [parse_strategy(craft, name) for name in names]
    # options that are not given leave the built-in values of the case or the timeline
    scenario_options |= {
        "lead_s": assumptions.study.lead_s if lead is None else lead,
        "wheel_speed_rad_s": wheel_speed,
        "restitution": assumptions.collision.restitution,
        "damper": assumptions.collision.damper,
    }
    given = {key: value for key, value in scenario_options.items() if value is not None}
    if given.get("collision_speed_m_s") == 0:  # on the command line 0 stands for no collision
        given["collision_speed_m_s"] = None
    scenario = build_scenario(vehicle, craft, given)
    candidates, source = select_start_rates(craft, omega_B, scan, factor)
    output.claim()
    execution = {"store": store, "workers": workers, "executor": executor}
    execution["progress"] = output.progress
    table, outcome_of_strategy = compare(
        craft, candidates, chosen, runs, seed, scenario, **execution
    )
    weighted = None
    if condition:
        first_outcome = next(iter(outcome_of_strategy.values()))
        weighted = compare_with_kernel(craft.name, first_outcome, data)
    tree = inputs.record_changes(comparison_tree(table, outcome_of_strategy, weighted))
    also, lines = {"candidates_from": source}, [f"Candidates: {source}"]
    output.deliver(tree, inputs.file, also=also, lines=lines)
