"""What surrounds the spacecraft, as functions of time: the Sun, and later orbit, field, Earth and eclipse.

Vectors are in N, a frame without rotation; which one is said by `frame_N`, here and in the attributes of results with an attitude.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from sunspin.environment.frames import SUN_Z_LOCAL

__all__ = ["Environment", "Surroundings", "Unknown", "unknown"]


@dataclass(frozen=True)
class Surroundings:
    """The surroundings at n times; None is what is not known.

    `sun_N` (n, 3) unit, direction to the Sun; `lit` (n) the part of the Sun's disc that is seen, 0 to 1; `field_N` (n, 3) T;
    `nadir_N` (n, 3) unit; `earth_radius_rad` (n) of the Earth's disc; `albedo_light_N` (n, 3) in parts of full Sun.
    """

    sun_N: np.ndarray
    lit: np.ndarray | None = None
    field_N: np.ndarray | None = None
    nadir_N: np.ndarray | None = None
    earth_radius_rad: np.ndarray | None = None
    albedo_light_N: np.ndarray | None = None


class Environment(Protocol):
    """Anything that gives the surroundings at times in s from a dataset's epoch, in the frame `frame_N`."""

    @property
    def frame_N(self) -> str: ...

    def at(self, t_s: npt.ArrayLike) -> Surroundings: ...


@dataclass(frozen=True)
class Unknown:
    """Nothing is known but that the Sun stands still: N has its z axis to it."""

    frame_N: str = SUN_Z_LOCAL

    def at(self, t_s: npt.ArrayLike) -> Surroundings:
        return Surroundings(np.tile([0.0, 0.0, 1.0], (np.size(t_s), 1)))


def unknown() -> Environment:
    """The environment of a pass of which only the telemetry is known."""
    return Unknown()
