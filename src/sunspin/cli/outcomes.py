"""`sunspin outcomes`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from sunspin.cli.changes import READING, Changeable, opened, set_options
from sunspin.cli.common import (
    claim,
    deliver,
    factor_option,
    on_terminal,
    output_options,
    run_options,
    store_option,
)
from sunspin.cli.values import numbers
from sunspin.cli.values import vertical as read_vertical


@click.command(cls=Changeable)
@click.argument("vehicle")
@click.option(
    "--strategy",
    "strategies",
    multiple=True,
    help="What the wheels are told: off (at the touchdown), held, brake, "
    "after_rest (held until the lander rests) or delay:SECONDS (off that much later); may be given several times. "
    "Default: off and held.",
)
@click.option(
    "--runs",
    type=click.IntRange(1, 100_000_000),
    default=100_000,
    show_default=True,
    help="Runs per strategy.",
)
@click.option(
    "--scan",
    type=click.Path(path_type=Path),
    help="scan.nc of `sunspin scan`: candidates are its near-minimum set.",
)
@factor_option
@click.option(
    "--omega",
    multiple=True,
    help="A candidate body rate, rad/s (0.1 rad/s: 5.73 deg/s): x,y,z; may be given several times.",
)
@click.option(
    "--sun", "sun_B", help="Unit vector to the Sun at the candidates' instant, body axes: x,y,z."
)
@click.option(
    "--wheel-speed", help="Wheel speeds then, rad/s, separated by commas; default: the vehicle's."
)
@click.option("--lead", type=float, help="From touchdown to the candidates' instant, s.")
@click.option("--before", type=float, help="From there to the collision, s.")
@click.option("--after", type=float, help="From the collision to the landing, s.")
@click.option("--collision-speed", type=float, help="Speed at the collision, m/s; 0: no collision.")
@click.option("--landing-speed", type=float, help="Speed at the landing, m/s.")
@click.option(
    "--vertical",
    help="The ground's normal at the landing, from body axes at the touchdown: legs_down (any for which "
    "legs were lowest there), any, an angle in degrees about legs-down, or x,y,z.",
)
@click.option(
    "--condition",
    is_flag=True,
    help="Weight the collisions of the first strategy by the trajectory kernel's speeds.",
)
@click.option(
    "--data",
    envvar="SUNSPIN_DATA",
    type=click.Path(path_type=Path),
    help="Folder with philae_spk/, from which "
    "--condition reads the kernel (or set SUNSPIN_DATA); without it the facts that come with the case are used.",
)
@store_option("Folder that keeps what is computed; the same command resumes.")
@click.option(
    "--scheduler", metavar="ADDRESS", help="Run on a Dask cluster: tcp://host:8786 or `local`."
)
@set_options("study.lead_s", "collision", short=("friction", "restitution", "damper"), idle=READING)
@output_options()
@run_options
def outcomes(
    vehicle,
    strategies,
    runs,
    scan,
    factor,
    omega,
    sun_B,
    wheel_speed,
    lead,
    before,
    after,
    collision_speed,
    landing_speed,
    vertical,
    condition,
    data,
    store,
    scheduler,
    sets,
    out,
    as_json,
    quiet,
    seed,
    workers,
    **short,
) -> None:
    """What a tumbling motion leads to: collision, first contact, antenna, rest, for one or more wheel strategies.

    A built-in case (philae) knows its times, speeds and, as candidates, its published lines. For another vehicle give at
    least --omega (or --scan), --sun and --after; a timeline.toml beside the vehicle file gives the times as well. With --out,
    writes outcomes-STRATEGY.nc, strategies.nc and figures.

    \b
    Examples:
      sunspin outcomes philae --runs 20000 --strategy off --strategy held --out landing
      sunspin outcomes vehicle.toml --omega 0.1,0,0.2 --sun 0,0,1 --after 600 --collision-speed 0 --runs 1000
    """
    from sunspin.landing.scenario import scenario_of, strategy_of
    from sunspin.landing.strategies import compare, compared
    from sunspin.philae.starts import against_kernel, starts

    made = opened(vehicle, sets, short, {"wheel_speed": wheel_speed, "lead": lead})
    craft, assumed = made.craft, made.assumptions
    wanted = [strategy_of(craft, name) for name in dict.fromkeys(strategies or ("off", "held"))]
    given = {
        "lead_s": assumed.study.lead_s if lead is None else lead,
        "before_s": before,
        "after_s": after,
        "landing_speed_m_s": landing_speed,
        "wheel_speed_rad_s": numbers(wheel_speed, "--wheel-speed") if wheel_speed else None,
        "sun_B": numbers(sun_B, "--sun", 3) if sun_B else None,
        "vertical": read_vertical(vertical),
        "restitution": assumed.collision.restitution,
        "damper": assumed.collision.damper,
    }
    given = {key: value for key, value in given.items() if value is not None}
    if collision_speed is not None:
        given["collision_speed_m_s"] = collision_speed or None
    scenario = scenario_of(vehicle, craft, given)
    candidates, whose = starts(craft, [numbers(text, "--omega", 3) for text in omega], scan, factor)
    claim(out, "outcomes")
    options: dict[str, Any] = {
        "workers": workers,
        "scheduler": scheduler,
        "progress": on_terminal(quiet),
    }
    table, found = compare(craft, candidates, wanted, runs, seed, scenario, store=store, **options)
    weighted = against_kernel(craft.name, next(iter(found.values())), data) if condition else None
    tree = made.mark(compared(table, found, weighted))
    deliver(
        tree,
        out,
        as_json,
        quiet,
        made.file,
        also={"candidates_from": whose},
        lines=[f"Candidates: {whose}"],
    )
