"""Environment of the spacecraft as a function of time: Sun, eclipse, and the Earth with its field and albedo.

:mod:`sunspin.environment.orbit` computes it for a known orbit; here are the environments without one. Vectors are in N, a
non-rotating frame. `frame_N` says which, here and in the attributes of results with an attitude.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sunspin.base.errors import InputError
from sunspin.environment.frames import SUN_Z_LOCAL
from sunspin.environment.surroundings import Environment, Surroundings

__all__ = ["Circular", "Environment", "Surroundings", "FixedSun", "circular", "unknown"]


@dataclass(frozen=True)
class FixedSun:
    """An environment of which nothing is known but a fixed Sun, along the z axis of N."""

    frame_N: str = SUN_Z_LOCAL

    def at(self, t_s: npt.ArrayLike) -> Surroundings:
        """Return the surroundings at times (n): the Sun along z."""
        return Surroundings(np.tile([0.0, 0.0, 1.0], (np.size(t_s), 1)))


def unknown() -> Environment:
    """Return the environment of a pass without orbit."""
    return FixedSun()


@dataclass(frozen=True)
class Circular:
    """A circular orbit: the nadir rotates at a constant rate about the orbit normal; the Sun is fixed, along z of N.

    `nadir_N` is the nadir at t = 0.
    """

    rate_rad_s: float
    normal_N: tuple[float, ...]
    nadir_N: tuple[float, ...]
    frame_N: str = SUN_Z_LOCAL

    def at(self, t_s: npt.ArrayLike) -> Surroundings:
        """Return the surroundings at times (n) in s."""
        angle = self.rate_rad_s * np.atleast_1d(np.asarray(t_s, dtype=np.float64))[:, None]
        first_nadir, normal = np.array(self.nadir_N), np.array(self.normal_N)
        nadir = np.cos(angle) * first_nadir + np.sin(angle) * np.cross(normal, first_nadir)
        nadir_rate = np.tile(self.rate_rad_s * normal, (len(angle), 1))
        sun = np.tile([0.0, 0.0, 1.0], (len(angle), 1))
        return Surroundings(sun, nadir_N=nadir, nadir_turn_N=nadir_rate)


def circular(
    rate_rad_s: float, normal_N: npt.ArrayLike, nadir_N: npt.ArrayLike = (1.0, 0.0, 0.0)
) -> Environment:
    """Return the environment of a circular orbit with this rate (rad/s) about `normal_N` (3), for tests and first studies.

    `nadir_N` (3): nadir at t = 0, from which the component along the normal is removed. The Sun is fixed along z of N. Raises
    `InputError` if the rate is not positive or the nadir is along the normal.
    """
    normal, nadir = (np.asarray(vector, dtype=np.float64) for vector in (normal_N, nadir_N))
    if any(vector.shape != (3,) or not np.isfinite(vector).all() for vector in (normal, nadir)):
        what = "normal and nadir of an orbit must be three finite numbers each"
        raise InputError(what, got=f"{normal_N}, {nadir_N}")
    if not 0 < rate_rad_s < np.inf:
        raise InputError("the rate of an orbit must be positive, in rad/s", got=rate_rad_s)
    # component of the nadir across the normal, times the square of the normal's length
    across = np.cross(np.cross(normal, nadir), normal)
    shortest = 1e-6 * np.linalg.norm(normal) ** 2 * np.linalg.norm(nadir)  # 1e-6 rad off the normal
    if np.linalg.norm(across) <= shortest:  # also if the normal or the nadir is zero
        raise InputError("the nadir lies along the orbit's normal", do="give a nadir across it")
    unit_normal, unit_nadir = (
        tuple((vector / np.linalg.norm(vector)).tolist()) for vector in (normal, across)
    )
    return Circular(float(rate_rad_s), unit_normal, unit_nadir)
