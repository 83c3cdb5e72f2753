"""`sunspin simulate`."""

from __future__ import annotations

import click
import numpy as np

from sunspin.base.errors import InputError, sentence
from sunspin.cli.changes import LANDING, SEEING, Changeable, once, opened, set_options
from sunspin.cli.common import WHEEL_MODE, claim, deliver, output_options
from sunspin.cli.values import numbers

MAX_SAMPLES, BYTES_PER_SAMPLE = 2_000_000, 300
"""Output times of one trajectory, and what one takes while it is computed and written."""

MAX_ANGLE_RAD, SECONDS_PER_RAD = 1e6, 4e-6
"""How far a trajectory may turn (a day at 10 rad/s), and the time that takes: beyond, a slip of units is likelier than a wish."""


@click.command(cls=Changeable)
@click.argument("vehicle")
@click.option("--omega", required=True, help="Body rate at the start, rad/s: x,y,z.")
@click.option("--sun", "sun_B", required=True, help="Unit vector to the Sun at the start, body axes: x,y,z.")
@click.option("--wheel-speed", help="Wheel speeds, rad/s, separated by commas; default: the vehicle's.")
@click.option("--duration", type=float, required=True, help="Length in s; negative runs backward.")
@click.option("--step", type=click.FloatRange(0, min_open=True), default=1.0, show_default=True, help="Output step in s.")
@click.option("--wheel-mode", type=click.Choice(["coast", "hold", "brake"]), default="coast", show_default=True, help=WHEEL_MODE)
@click.option("--stopped-at", type=float, help="When a wheel at rest had stopped, s (to run backward).")
@set_options(idle=(*LANDING, *SEEING))
@output_options()
def simulate(vehicle, omega, sun_B, wheel_speed, duration, step, wheel_mode, stopped_at, sets, out, as_json, quiet) -> None:
    """One trajectory: body rates, the Sun in body axes, wheel speeds, attitude, wheel events.

    With --out, writes trajectory.nc.

    \b
    Example:
      sunspin simulate philae --omega 0.1,0,0 --sun 0.1959,0.5690,0.7986 --duration 2760 --out run
    """
    from sunspin.dynamics.propagate import propagate

    made = opened(vehicle, sets)
    once(made, wheel_speed=("speed_rad_s", wheel_speed))
    vehicle, craft = made.file, made.craft
    speeds = numbers(wheel_speed, "--wheel-speed") if wheel_speed else [wheel.speed_rad_s for wheel in craft.wheels]
    t = _times(duration, step)
    start = numbers(omega, "--omega", 3), numbers(sun_B, "--sun", 3)
    _check_work(craft, start[0], speeds, duration)
    claim(out, "simulate")
    run = propagate(craft, *start, speeds or None, t, wheel_mode=wheel_mode, stopped_at_s=stopped_at)
    deliver(run, out, as_json, quiet, vehicle, main="trajectory.nc")


def _times(duration: float, step: float) -> np.ndarray:
    """Output times from 0 in steps to the duration, which is the last one whether or not it is a multiple of the step."""
    if not (np.isfinite(duration) and np.isfinite(step)):
        raise InputError(sentence("--duration and --step must be finite", got=f"{duration} s in steps of {step} s"))
    if abs(duration) / step > MAX_SAMPLES:
        raise InputError(
            sentence(
                f"{abs(duration) / step:.3g} output times are more than {MAX_SAMPLES:g} and would take some "
                f"{abs(duration) / step * BYTES_PER_SAMPLE / 1e9:.2g} GB of memory",
                got=f"{duration} s in steps of {step} s", do="use a larger --step",
            )
        )
    count = int(np.floor(abs(duration) / step + 1e-9))
    t = np.copysign(np.arange(count + 1) * step, duration)
    return np.append(t, duration) if abs(duration) > abs(t[-1]) * (1 + 1e-12) else t


def _check_work(craft, omega: list[float], speeds: list[float], duration: float) -> None:
    """Refuse a trajectory that turns unreasonably far, with an estimate of the time."""
    tensor = craft.require_inertia()
    if len(speeds) != len(craft.wheels):
        return  # said better where the trajectory begins
    with np.errstate(all="ignore"):
        spins = sum((wheel.inertia_kg_m2 * s * wheel.axis_B for wheel, s in zip(craft.wheels, speeds, strict=True)), np.zeros(3))
        rate = np.linalg.norm(tensor @ np.array(omega) + spins) / np.linalg.eigvalsh(tensor)[0]
    angle = float(max(rate, np.linalg.norm(omega)) * abs(duration))
    if angle > MAX_ANGLE_RAD:
        raise InputError(
            sentence(
                f"the body turns by up to {angle:.3g} rad in this time, more than {MAX_ANGLE_RAD:g}, which would take some "
                f"{angle * SECONDS_PER_RAD:.2g} s", got=f"{duration:g} s at {angle / abs(duration):.3g} rad/s",
                do="check the units, or run it in parts from Python (sunspin.propagate)",
            )
        )  # fmt: skip
