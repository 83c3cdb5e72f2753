"""Limits of a trajectory that the command line accepts: number of output times, and angle of rotation."""

from __future__ import annotations

import numpy as np

from sunspin.base.errors import InputError
from sunspin.vehicle import Vehicle

MAX_SAMPLES, BYTES_PER_SAMPLE = 2_000_000, 300
"""Most output times of one trajectory, and the memory that each needs while it is computed and written."""

MAX_ANGLE_RAD, SECONDS_PER_RAD = 1e6, 4e-6
"""Largest angle of rotation in a trajectory (a day at 10 rad/s), and computing time of a radian. Beyond, a unit is likely wrong."""


def output_times(duration: float, step: float) -> np.ndarray:
    """Return output times (n), s, from 0 in steps; the last is the duration, also if it is no multiple of the step.

    A negative duration gives negative times. InputError for too many times, or if an argument is not finite.
    """
    if not (np.isfinite(duration) and np.isfinite(step)):
        raise InputError(
            "--duration and --step must be finite", got=f"{duration} s in steps of {step} s"
        )
    if abs(duration) / step > MAX_SAMPLES:
        raise InputError(
            f"{abs(duration) / step:.3g} output times are more than {MAX_SAMPLES:g} and would take some "
            f"{abs(duration) / step * BYTES_PER_SAMPLE / 1e9:.2g} GB of memory",
            got=f"{duration} s in steps of {step} s",
            do="use a larger --step",
        )
    count = int(np.floor(abs(duration) / step + 1e-9))
    t = np.copysign(np.arange(count + 1) * step, duration)
    return np.append(t, duration) if abs(duration) > abs(t[-1]) * (1 + 1e-12) else t


def check_work(vehicle: Vehicle, omega: list[float], speeds: list[float], duration: float) -> None:
    """Raise InputError if a trajectory may rotate farther than `MAX_ANGLE_RAD`, with an estimate of the computing time.

    `omega` (3) and wheel `speeds` at the start in rad/s, `duration` in s.
    """
    tensor = vehicle.require_inertia()
    if len(speeds) != len(vehicle.wheels):
        return  # `propagate` raises an error that explains it
    with np.errstate(all="ignore"):
        # the rate is at most |H| over the smallest moment, also after wheels have given their momentum to the body
        spins = sum(
            (
                wheel.inertia_kg_m2 * s * wheel.axis_B
                for wheel, s in zip(vehicle.wheels, speeds, strict=True)
            ),
            np.zeros(3),
        )
        rate = np.linalg.norm(tensor @ np.array(omega) + spins) / np.linalg.eigvalsh(tensor)[0]
    angle = float(max(rate, np.linalg.norm(omega)) * abs(duration))
    if angle > MAX_ANGLE_RAD:
        raise InputError(
            f"the body turns by up to {angle:.3g} rad in this time, more than {MAX_ANGLE_RAD:g}, which would take some "
            f"{angle * SECONDS_PER_RAD:.2g} s",
            got=f"{duration:g} s at {angle / abs(duration):.3g} rad/s "
            f"({np.degrees(angle / abs(duration)):.3g} deg/s)",
            do="check that rates are in rad/s, or run it in parts from Python (sunspin.propagate)",
        )
