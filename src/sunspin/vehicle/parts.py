"""The parts of a vehicle: panels, wheels with their friction, legs, hull, antenna, rules. Frozen data.

Vectors are in the vehicle's body axes B, in SI units. What the parts make together is :class:`sunspin.vehicle.Vehicle`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from sunspin.base.errors import VehicleError, sentence
from sunspin.vehicle.portable import Portable

FloatArray = npt.NDArray[np.float64]

UNIT_TOLERANCE = 1e-3
"""Vectors within this of length one count as directions written with few digits and are normalised."""


def frozen_array(value: npt.ArrayLike) -> FloatArray:
    """Return a read-only float64 copy of ``value``."""
    array = np.array(value, dtype=np.float64)
    array.setflags(write=False)
    return array


def direction(value: npt.ArrayLike, key: str) -> FloatArray:
    """Return ``value`` (3) as a read-only unit vector, or raise `VehicleError` if it is not one to three digits."""
    vector = np.array(value, dtype=np.float64)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise VehicleError(sentence(f"{key} must be three finite numbers", got=value))
    length = float(np.linalg.norm(vector))
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise VehicleError(
            sentence(
                f"{key} must be a unit vector, its length is {length:.6g}",
                got=np.array2string(vector, separator=", "),
                do="divide it by its length or correct its components",
            )
        )
    return frozen_array(vector / length)


@dataclass(frozen=True)
class Fact:
    """A number's birth certificate: its value, one-sigma uncertainty (same unit as the value) and source."""

    value: float | tuple[Any, ...]
    sigma: float | tuple[Any, ...] | None = None
    source: str | None = None


@dataclass(frozen=True)
class Panel(Portable):
    """A flat solar panel: outward unit normal in B and its gain, the signal at normal incidence of the Sun.

    The gain is relative (a cell count will do) unless the vehicle's `gain_unit` is "W" or "A".
    """

    name: str
    normal_B: FloatArray
    gain: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "normal_B", direction(self.normal_B, f"normal_B of panel {self.name!r}"))
        if not (np.isfinite(self.gain) and self.gain > 0):
            raise VehicleError(sentence(f"the gain of panel {self.name!r} must be positive", got=self.gain))


@dataclass(frozen=True)
class Friction:
    """Bearing friction, torque on the wheel ``-sign(W) (coulomb + viscous |W|)`` (paper, eq. 5)."""

    coulomb_N_m: float = 0.0
    viscous_N_m_s: float = 0.0

    def __post_init__(self) -> None:
        for key in ("coulomb_N_m", "viscous_N_m_s"):
            value = getattr(self, key)
            if not (np.isfinite(value) and value >= 0):
                raise VehicleError(sentence(f"friction {key} must be zero or positive", got=value))

    @classmethod
    def from_spin_down(cls, c1_rad_s: float, c2_per_s: float, c3_rad_s: float, inertia_kg_m2: float) -> Friction:
        """Friction of a wheel whose measured spin-down follows ``c1 exp(c2 t) + c3`` (paper, section 2.2).

        That curve obeys dW/dt = c2 W - c2 c3, hence coulomb = c2 c3 J and viscous = -c2 J. `c1` only fixes the time at
        which the record begins.
        """
        if c2_per_s >= 0 or c3_rad_s > 0:
            raise VehicleError(
                sentence(
                    "a spin-down c1 exp(c2 t) + c3 needs c2 < 0 and c3 <= 0 to be friction",
                    got=f"c1 = {c1_rad_s}, c2 = {c2_per_s}, c3 = {c3_rad_s}",
                )
            )
        return cls(c2_per_s * c3_rad_s * inertia_kg_m2, -c2_per_s * inertia_kg_m2)


@dataclass(frozen=True)
class Wheel(Portable):
    """A wheel: axis (unit, B), axial inertia J, nominal speed relative to the body, friction, brake; its speed's column if any."""

    name: str
    axis_B: FloatArray
    inertia_kg_m2: float
    speed_rad_s: float = 0.0
    friction: Friction = Friction()
    alternative_frictions: Mapping[str, Friction] = field(default_factory=dict)
    brake_torque_N_m: float | None = None
    speed_column: str | None = None
    speed_scale_rad_s: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis_B", direction(self.axis_B, f"axis_B of wheel {self.name!r}"))
        object.__setattr__(self, "alternative_frictions", MappingProxyType(dict(self.alternative_frictions)))
        if not (np.isfinite(self.inertia_kg_m2) and self.inertia_kg_m2 > 0):
            raise VehicleError(
                sentence(f"inertia_kg_m2 of wheel {self.name!r} must be positive", got=self.inertia_kg_m2)
            )
        if self.brake_torque_N_m is not None and not (
            np.isfinite(self.brake_torque_N_m) and self.brake_torque_N_m > 0
        ):
            raise VehicleError(
                sentence(f"brake_torque_N_m of wheel {self.name!r} must be positive", got=self.brake_torque_N_m)
            )


@dataclass(frozen=True)
class Leg(Portable):
    """A leg: its end, where it can touch the ground, from the vehicle's centre of mass in B (m)."""

    name: str
    tip_B_m: FloatArray

    def __post_init__(self) -> None:
        tip = np.array(self.tip_B_m, dtype=np.float64)
        if tip.shape != (3,) or not np.all(np.isfinite(tip)):
            raise VehicleError(sentence(f"tip_B_m of leg {self.name!r} must be three finite numbers", got=self.tip_B_m))
        object.__setattr__(self, "tip_B_m", frozen_array(tip))


@dataclass(frozen=True)
class HullPart(Portable):
    """A part of the outer shape that can touch the ground: points (n, 3) in m from the centre of mass, B.

    The convex hull of all parts and of the legs' ends is the shape. `panel` names the panel whose corners the points are.
    """

    name: str
    points_B_m: FloatArray
    panel: str | None = None

    def __post_init__(self) -> None:
        points = np.array(self.points_B_m, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0 or not np.all(np.isfinite(points)):
            raise VehicleError(
                sentence(f"points_B_m of hull part {self.name!r} must be points of three finite numbers", got=self.points_B_m)
            )
        object.__setattr__(self, "points_B_m", frozen_array(points))


@dataclass(frozen=True)
class Antenna(Portable):
    """An antenna that serves directions within half of `opening_rad` of its axis (unit, B)."""

    axis_B: FloatArray
    opening_rad: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis_B", direction(self.axis_B, "antenna.axis_B"))
        if not (np.isfinite(self.opening_rad) and 0 < self.opening_rad <= 2 * np.pi):
            raise VehicleError(
                sentence("antenna.opening_rad must be an angle above 0 and at most 2 pi", got=self.opening_rad)
            )


@dataclass(frozen=True)
class SunRule:
    """A rule that forbids a reconstruction: it applies when all named panels are dark (`reason` says why)."""

    all_dark: tuple[str, ...]
    reason: str
