"""A magnetometer as the only sensor, without an orbit: the direction of the field stands for that of the Sun.

Its direction in space is not known, and turns along the orbit. So the motion is found in axes that follow the field, as it is found
in axes that follow the Sun; how fast those turn is not known and is an error of every rate, about as large as the field turns in a
low orbit. The turn about the field is seen only through the motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
import xarray as xr

from sunspin.estimate.terms.magnetometer import TURN_RATE, without_outliers
from sunspin.estimate.terms.sun_direction import SunDirection
from sunspin.estimate.terms.term import MotionTerm
from sunspin.vehicle import Vehicle
from sunspin.vehicle.sensors import Magnetometer

UNREAD_FIELD = "no field direction: bridged by the dynamics and other sensors"


def reads_directions(vehicle: Vehicle, telemetry: xr.Dataset) -> bool:
    """Whether a magnetometer's readings may be used as directions: the vehicle file states their noise."""
    part = vehicle.sensors.magnetometer
    return "field_B" in telemetry and part is not None and bool(part.noise)


@dataclass(frozen=True)
class FieldDirection(SunDirection):
    """Directions of the field (n, 3) with covariance (n, 3, 3), as a :class:`SunDirection` has those of the Sun."""

    called: ClassVar[str] = "magnetometer"

    @classmethod
    def alone(cls, part: Magnetometer, telemetry: xr.Dataset) -> tuple[Self, np.ndarray]:
        """Those of telemetry, and a sentence for each sample (n)."""
        read = without_outliers(np.asarray(telemetry["field_B"], dtype=np.float64))
        size = np.linalg.norm(read, axis=1, keepdims=True)
        zero = part.matrix * part.zero_sigma
        covariance = (part.noise or np.inf) ** 2 * np.eye(3) + zero @ zero.T
        made = cls.of(read / size, covariance / (size**2)[..., None])
        return made, np.where(made.informs(), "used", UNREAD_FIELD).astype(object)


@dataclass(frozen=True)
class TurningAxes(MotionTerm):
    """Rates are those against axes that follow the field, which turn at a rate that is not known."""

    name: ClassVar[str] = "turning axes"
    called: ClassVar[str] = "turning of the field"

    def hidden_variance(self, dt: np.ndarray) -> float:
        return TURN_RATE**2 / 3
