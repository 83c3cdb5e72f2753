"""What surrounds the spacecraft, as functions of time: Sun, eclipse, the Earth with its field and its light.

:mod:`sunspin.environment.orbit` knows them by an orbit that others have determined; here are the environments without one. Vectors
are in N, a frame without rotation; which one is said by `frame_N`, here and in the attributes of results with an attitude.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sunspin.base.errors import InputError
from sunspin.environment.frames import SUN_Z_LOCAL
from sunspin.environment.surroundings import Environment, Surroundings

__all__ = ["Circular", "Environment", "Surroundings", "Unknown", "circular", "unknown"]


@dataclass(frozen=True)
class Unknown:
    """Nothing is known but that the Sun stands still: N has its z axis to it."""

    frame_N: str = SUN_Z_LOCAL

    def at(self, t_s: npt.ArrayLike) -> Surroundings:
        return Surroundings(np.tile([0.0, 0.0, 1.0], (np.size(t_s), 1)))


def unknown() -> Environment:
    """The environment of a pass of which only the telemetry is known."""
    return Unknown()


@dataclass(frozen=True)
class Circular:
    """A circular orbit: the nadir turns evenly about the orbit's normal, and the Sun stands still, along z of N."""

    rate_rad_s: float
    normal_N: tuple[float, ...]
    nadir_N: tuple[float, ...]  # at t = 0
    frame_N: str = SUN_Z_LOCAL

    def at(self, t_s: npt.ArrayLike) -> Surroundings:
        angle = self.rate_rad_s * np.atleast_1d(np.asarray(t_s, dtype=np.float64))[:, None]
        begin, normal = np.array(self.nadir_N), np.array(self.normal_N)
        nadir = np.cos(angle) * begin + np.sin(angle) * np.cross(normal, begin)
        turn = np.tile(self.rate_rad_s * normal, (len(angle), 1))
        sun = np.tile([0.0, 0.0, 1.0], (len(angle), 1))
        return Surroundings(sun, nadir_N=nadir, nadir_turn_N=turn)


def circular(
    rate_rad_s: float, normal_N: npt.ArrayLike, nadir_N: npt.ArrayLike = (1.0, 0.0, 0.0)
) -> Environment:
    """A circular orbit at this rate (rad/s) about the direction `normal_N` (3), for tests and first studies.

    `nadir_N` (3): where the nadir is at t = 0; its part along the normal is taken out. The Sun stands still along z of N.
    `InputError` for a rate that is not positive, or directions that leave no nadir.
    """
    normal, nadir = (np.asarray(vector, dtype=np.float64) for vector in (normal_N, nadir_N))
    if any(v.shape != (3,) or not np.isfinite(v).all() for v in (normal, nadir)):
        what = "normal and nadir of an orbit must be three finite numbers each"
        raise InputError(what, got=f"{normal_N}, {nadir_N}")
    if not 0 < rate_rad_s < np.inf:
        raise InputError("the rate of an orbit must be positive, in rad/s", got=rate_rad_s)
    across = np.cross(np.cross(normal, nadir), normal)
    least = 1e-6 * np.linalg.norm(normal) ** 2 * np.linalg.norm(nadir)
    if np.linalg.norm(across) < least or not normal.any():
        raise InputError("the nadir lies along the orbit's normal", do="give a nadir across it")
    normal, nadir = (tuple((v / np.linalg.norm(v)).tolist()) for v in (normal, across))
    return Circular(float(rate_rad_s), normal, nadir)
