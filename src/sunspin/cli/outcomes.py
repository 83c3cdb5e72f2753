"""`sunspin outcomes`."""

from __future__ import annotations

import click

from sunspin.cli.changes import READING, Command, opened, set_options
from sunspin.cli.common import PATH, shared
from sunspin.cli.values import Parsed, rate, vector, vertical


@click.command(cls=Command)
@click.argument("vehicle")
@click.option(
    "--strategy",
    "strategies",
    multiple=True,
    help="Command to the wheels: off (at the touchdown), held, brake, "
    "after_rest (held until the lander rests) or delay:SECONDS (off that much later); may be given several times. "
    "Default: off and held.",
)
@click.option(
    "--runs", type=click.IntRange(1, 100_000_000), default=100_000, help="Runs per strategy."
)
@click.option(
    "--scan", type=PATH, help="scan.nc of `sunspin scan`: candidates are its near-minimum set."
)
@click.option(
    "--omega-deg-s",
    "omega_B",
    type=Parsed(rate, "X,Y,Z"),
    multiple=True,
    help="A candidate body rate, deg/s. Repeatable.",
)
@click.option(
    "--sun",
    "sun_B",
    type=Parsed(vector, "X,Y,Z"),
    help="Unit vector to the Sun at the candidates' instant, body axes.",
)
@click.option("--lead", type=float, help="From touchdown to the candidates' instant, s.")
@click.option("--before", "before_s", type=float, help="From there to the collision, s.")
@click.option("--after", "after_s", type=float, help="From the collision to the landing, s.")
@click.option("--collision-speed", type=float, help="Speed at the collision, m/s; 0: no collision.")
@click.option("--landing-speed", "landing_speed_m_s", type=float, help="Speed at the landing, m/s.")
@click.option(
    "--vertical",
    type=Parsed(vertical),
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
    type=PATH,
    help="Folder with philae_spk/, from which "
    "--condition reads the kernel (or set SUNSPIN_DATA); without it the facts that come with the case are used.",
)
@set_options("study.lead_s", "collision", short=("friction", "restitution", "damper"), idle=READING)
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
    collision_speed,
    condition,
    data,
    store,
    executor,
    changes,
    seed,
    workers,
    output,
    **known,
) -> None:
    """What a tumbling motion leads to: collision, first contact, antenna, rest, for one or more wheel strategies.

    A built-in case (philae) knows its times, speeds and, as candidates, its published lines. For another vehicle give at
    least --omega-deg-s (or --scan), --sun and --after; a timeline.toml beside the vehicle file gives the times as well. With --out,
    writes outcomes-STRATEGY.nc, strategies.nc and figures.

    \b
    Examples:
      sunspin outcomes philae --runs 20000 --strategy off --strategy held --out landing
      sunspin outcomes vehicle.toml --omega-deg-s 6,0,12 --sun 0,0,1 --after 600 --collision-speed 0 --runs 1000
    """
    from sunspin.landing.scenario import scenario_of, strategy_of
    from sunspin.landing.strategies import compare, compared
    from sunspin.philae.candidates import starts
    from sunspin.philae.collision import against_kernel

    made = opened(vehicle, changes)
    craft, assumed = made.craft, made.assumptions
    wanted = [strategy_of(craft, name) for name in dict.fromkeys(strategies or ("off", "held"))]
    given = known | {
        "lead_s": assumed.study.lead_s if lead is None else lead,
        "wheel_speed_rad_s": wheel_speed,
        "restitution": assumed.collision.restitution,
        "damper": assumed.collision.damper,
    }
    given = {key: value for key, value in given.items() if value is not None}
    if collision_speed is not None:
        given["collision_speed_m_s"] = collision_speed or None
    scenario = scenario_of(vehicle, craft, given)
    candidates, whose = starts(craft, omega_B, scan, factor)
    output.claim()
    table, found = compare(
        craft,
        candidates,
        wanted,
        runs,
        seed,
        scenario,
        store=store,
        workers=workers,
        executor=executor,
        progress=output.progress,
    )
    weighted = against_kernel(craft.name, next(iter(found.values())), data) if condition else None
    tree = made.mark(compared(table, found, weighted))
    about, lines = {"candidates_from": whose}, [f"Candidates: {whose}"]
    output.deliver(tree, made.file, also=about, lines=lines)
