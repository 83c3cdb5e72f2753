"""How long a trajectory may be: its output times, and how far it may turn."""

from __future__ import annotations

import numpy as np

from sunspin.base.errors import InputError
from sunspin.vehicle import Vehicle

MAX_SAMPLES, BYTES_PER_SAMPLE = 2_000_000, 300
"""Output times of one trajectory, and what one takes while it is computed and written."""

MAX_ANGLE_RAD, SECONDS_PER_RAD = 1e6, 4e-6
"""How far a trajectory may turn (a day at 10 rad/s), and the time that takes: beyond, a slip of units is likelier than a wish."""


def output_times(duration: float, step: float) -> np.ndarray:
    """Output times from 0 in steps to the duration, which is the last one whether or not it is a multiple of the step."""
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
    """Refuse a trajectory that turns unreasonably far, with an estimate of the time."""
    tensor = vehicle.require_inertia()
    if len(speeds) != len(vehicle.wheels):
        return  # said better where the trajectory begins
    with np.errstate(all="ignore"):
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
