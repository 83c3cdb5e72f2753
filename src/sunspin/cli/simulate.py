"""`sunspin simulate`."""

from __future__ import annotations

import click

from sunspin.cli.changes import LANDING_KEYS, PANEL_KEYS, Command, load_inputs, set_options
from sunspin.cli.common import POSITIVE, shared
from sunspin.cli.values import BODY_RATE, DIRECTION


@click.command(cls=Command)
@click.argument("vehicle")
@click.option(
    "--omega-deg-s", "omega_B", type=BODY_RATE, required=True, help="Initial body rate, deg/s."
)
@click.option(
    "--sun",
    "sun_B",
    type=DIRECTION,
    required=True,
    help="Initial direction to the Sun, body axes, of any length.",
)
@click.option("--duration", type=float, required=True, help="Duration in s; negative: backward.")
@click.option("--step", type=POSITIVE, default=1.0, help="Output step in s.")
@click.option(
    "--stopped-at",
    "stopped_at_s",
    type=float,
    help="Backward runs: when a wheel that is at rest at the start had stopped, s from the start (negative). "
    "Before, it turned in the direction of its speed in the vehicle file.",
)
@set_options(short=("friction",), idle=(*LANDING_KEYS, *PANEL_KEYS))
@shared("--wheel-speed", "--wheel-mode")
def simulate(
    vehicle, omega_B, sun_B, duration, step, changes, wheel_speed, output, **wheel_options
) -> None:
    """Propagate one motion: body rates, Sun direction, attitude, wheel speeds and when wheels stop.

    With --out, writes trajectory.nc: the motion at the output times and, if the body rotates far in a step, between them.

    \b
    Example:
      sunspin simulate philae --omega-deg-s 6,0,0 --sun 0.1959,0.5690,0.7986 --duration 2760 --out run
    """
    from sunspin.dynamics.curve import with_curve
    from sunspin.dynamics.extent import check_work, output_times
    from sunspin.dynamics.propagate import propagate

    inputs = load_inputs(vehicle, changes)
    craft = inputs.craft
    speeds = wheel_speed or [wheel.speed_rad_s for wheel in craft.wheels]
    t_s = output_times(duration, step)
    check_work(craft, omega_B, speeds, duration)
    output.claim()

    def propagate_to(times):
        """Return the motion at these times (s)."""
        return propagate(craft, omega_B, sun_B, speeds or None, times, **wheel_options)

    result = propagate_to(t_s)
    if output.folder is not None:  # attitudes between the output times, for figures and exports
        result = with_curve(result, craft.require_inertia(), propagate_to)
    output.deliver(result, inputs.file, main="trajectory.nc")
