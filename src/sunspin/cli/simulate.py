"""`sunspin simulate`."""

from __future__ import annotations

import click

from sunspin.cli.changes import LANDING, SEEING, Command, opened, set_options
from sunspin.cli.common import POSITIVE, shared
from sunspin.cli.values import Parsed, rate, vector


@click.command(cls=Command)
@click.argument("vehicle")
@click.option(
    "--omega-deg-s",
    "omega_B",
    type=Parsed(rate, "X,Y,Z"),
    required=True,
    help="Body rate at the start, deg/s.",
)
@click.option(
    "--sun",
    "sun_B",
    type=Parsed(vector, "X,Y,Z"),
    required=True,
    help="Unit vector to the Sun at the start, body axes.",
)
@click.option("--duration", type=float, required=True, help="Length in s; negative runs backward.")
@click.option("--step", type=POSITIVE, default=1.0, help="Output step in s.")
@click.option(
    "--stopped-at",
    "stopped_at_s",
    type=float,
    help="When a wheel at rest had stopped, s (to run backward).",
)
@set_options(short=("friction",), idle=(*LANDING, *SEEING))
@shared("--wheel-speed", "--wheel-mode")
def simulate(vehicle, omega_B, sun_B, duration, step, changes, wheel_speed, output, **run) -> None:
    """One trajectory: body rates, the Sun in body axes, wheel speeds, attitude, wheel events.

    With --out, writes trajectory.nc.

    \b
    Example:
      sunspin simulate philae --omega-deg-s 6,0,0 --sun 0.1959,0.5690,0.7986 --duration 2760 --out run
    """
    from sunspin.dynamics.extent import check_work, output_times
    from sunspin.dynamics.propagate import propagate

    made = opened(vehicle, changes)
    craft = made.craft
    speeds = wheel_speed or [wheel.speed_rad_s for wheel in craft.wheels]
    t = output_times(duration, step)
    check_work(craft, omega_B, speeds, duration)
    output.claim()
    result = propagate(craft, omega_B, sun_B, speeds or None, t, **run)
    output.deliver(result, made.file, main="trajectory.nc")
