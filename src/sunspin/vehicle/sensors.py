"""What a vehicle carries beside its panels: Sun sensors, a gyro, a magnetometer; and what is known of its disturbances.

All in body axes. Frozen data, read from the vehicle file by :mod:`sunspin.vehicle.file`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class SunSensor:
    """A two-axis Sun sensor: outward normal, its x axis (its y axis is normal cross x), columns, how it reads.

    It sees the Sun where its light exceeds `lit_above` (unit of the column). The Sun's angle from the normal towards x is
    the reading times `x_scale` (rad); likewise y, or nothing where `y_scale` is None: then it is known only that the Sun is
    in view. `x_sigma_rad` and `y_sigma_rad` are one-sigma errors of these angles. A sensor whose y wraps has
    `y_turned_above`: where its light exceeds that, the Sun being near its normal, y is the reading times `y_turned_scale`.
    """

    name: str
    normal_B: np.ndarray
    x_axis_B: np.ndarray
    x_column: str
    y_column: str | None
    light_column: str | None
    lit_above: float
    x_scale: float
    y_scale: float | None
    x_sigma_rad: float
    y_sigma_rad: float
    y_turned_above: float | None = None
    y_turned_scale: float | None = None


@dataclass(frozen=True)
class Gyro:
    """Three gyro columns along the body axes: rate (rad/s) is `scale_rad_s` times (reading less `zero`).

    `noise_rad_s` is that of one sample, `zero_sigma` (3) and `scale_sigma` are shared by all samples of a pass.
    """

    columns: tuple[str, str, str]
    scale_rad_s: float
    zero: np.ndarray
    noise_rad_s: float
    wraps_at: float | None = None
    zero_sigma: np.ndarray = field(default_factory=lambda: np.zeros(3))
    scale_sigma: float = 0.0


@dataclass(frozen=True)
class Magnetometer:
    """Three columns along the body axes, in any unit: field is reading less `zero`.

    `noise` (same unit) is None where the reading may not be used as a direction (zero or axes not known well enough).
    """

    columns: tuple[str, str, str]
    zero: np.ndarray
    noise: float | None
    wraps_at: float | None = None


@dataclass(frozen=True)
class Attitude:
    """Four columns with somebody's attitude as a quaternion: where its scalar stands, which way it turns, its error.

    `rotates`: "N_to_B" if it takes components in the reference frame to components in the body, "B_to_N" for the opposite.
    """

    columns: tuple[str, str, str, str]
    scalar: str
    rotates: str
    sigma_rad: float


@dataclass(frozen=True)
class Disturbance:
    """What turns the vehicle beside its own motion.

    `acceleration_noise` (rad/s^1.5): white angular acceleration; after t seconds a rate has wandered by this times sqrt(t).
    `noise_without_field`: the same where the dipole's torque is not modelled, the field not being measured.
    `dipole` (3): angular acceleration dipole x field, rad/s2 per unit of the magnetometer. `max_rate_rad_s`: no rate is
    faster.
    """

    acceleration_noise: float | None = None
    noise_without_field: float | None = None
    dipole: np.ndarray | None = None
    max_rate_rad_s: float | None = None


@dataclass(frozen=True)
class Clock:
    """How late gyro, magnetometer and attitude of a row are behind its panels and Sun sensors (s), and one sigma of that; with
    zero it is known."""

    late_s: float
    sigma_s: float


@dataclass(frozen=True)
class Sensors:
    """All of these; what is absent is empty or None."""

    sun_sensors: tuple[SunSensor, ...] = ()
    gyro: Gyro | None = None
    attitude: Attitude | None = None
    magnetometer: Magnetometer | None = None
    disturbance: Disturbance = Disturbance()
    clock: Clock | None = None
