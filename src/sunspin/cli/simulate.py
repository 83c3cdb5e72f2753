"""`sunspin simulate`."""

from __future__ import annotations

import click

from sunspin.cli.changes import LANDING, SEEING, Changeable, opened, set_options
from sunspin.cli.common import claim, deliver, output_options, wheel_mode_option
from sunspin.cli.values import numbers


@click.command(cls=Changeable)
@click.argument("vehicle")
@click.option(
    "--omega", required=True, help="Body rate at the start, rad/s (0.1 rad/s: 5.73 deg/s): x,y,z."
)
@click.option(
    "--sun", "sun_B", required=True, help="Unit vector to the Sun at the start, body axes: x,y,z."
)
@click.option(
    "--wheel-speed", help="Wheel speeds, rad/s, separated by commas; default: the vehicle's."
)
@click.option("--duration", type=float, required=True, help="Length in s; negative runs backward.")
@click.option(
    "--step",
    type=click.FloatRange(0, min_open=True),
    default=1.0,
    show_default=True,
    help="Output step in s.",
)
@wheel_mode_option()
@click.option(
    "--stopped-at", type=float, help="When a wheel at rest had stopped, s (to run backward)."
)
@set_options(short=("friction",), idle=(*LANDING, *SEEING))
@output_options()
def simulate(
    vehicle,
    omega,
    sun_B,
    wheel_speed,
    duration,
    step,
    wheel_mode,
    stopped_at,
    sets,
    friction,
    out,
    as_json,
    quiet,
) -> None:
    """One trajectory: body rates, the Sun in body axes, wheel speeds, attitude, wheel events.

    With --out, writes trajectory.nc.

    \b
    Example:
      sunspin simulate philae --omega 0.1,0,0 --sun 0.1959,0.5690,0.7986 --duration 2760 --out run
    """
    from sunspin.dynamics.extent import check_work, output_times
    from sunspin.dynamics.propagate import propagate

    made = opened(vehicle, sets, {"friction": friction}, {"wheel_speed": wheel_speed})
    vehicle, craft = made.file, made.craft
    speeds = (
        numbers(wheel_speed, "--wheel-speed")
        if wheel_speed
        else [wheel.speed_rad_s for wheel in craft.wheels]
    )
    t = output_times(duration, step)
    start = numbers(omega, "--omega", 3), numbers(sun_B, "--sun", 3)
    check_work(craft, start[0], speeds, duration)
    claim(out, "simulate")
    run = propagate(
        craft, *start, speeds or None, t, wheel_mode=wheel_mode, stopped_at_s=stopped_at
    )
    deliver(run, out, as_json, quiet, vehicle, main="trajectory.nc")
