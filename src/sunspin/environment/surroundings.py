"""Data that an environment gives: directions, light and field at times, each with its error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Surroundings:
    """Surroundings of the spacecraft at n times, in frame N; None for unknown values and errors.

    `sun_N` (n, 3): unit direction to the Sun. `lit` (n): visible fraction of the Sun's disc, 0 to 1. `field_N` (n, 3): magnetic
    field, T. `nadir_N` (n, 3): unit nadir; `nadir_turn_N` (n, 3): its angular velocity (rad/s), None if fixed.
    `earth_radius_rad` (n): angular radius of the Earth. `albedo_light_N` (n, 3): albedo vector in parts of full Sun, towards
    its source.

    Standard deviations (n): `sun_sigma_rad`, `nadir_sigma_rad`, `field_sigma_T` (of the vector), `lit_sigma`, `albedo_sigma`
    (of the vector). The relative error of the Earth's radius is below 1e-3. `field_along_N` (n, 3) T: change of the field for
    one standard deviation along the track, an error that is common to all times.
    """

    sun_N: np.ndarray
    lit: np.ndarray | None = None
    field_N: np.ndarray | None = None
    nadir_N: np.ndarray | None = None
    earth_radius_rad: np.ndarray | None = None
    albedo_light_N: np.ndarray | None = None
    nadir_turn_N: np.ndarray | None = None
    sun_sigma_rad: np.ndarray | None = None
    lit_sigma: np.ndarray | None = None
    field_sigma_T: np.ndarray | None = None
    nadir_sigma_rad: np.ndarray | None = None
    albedo_sigma: np.ndarray | None = None
    field_along_N: np.ndarray | None = None


class Environment(Protocol):
    """An object that gives the surroundings at times in s from a dataset's epoch, in the frame `frame_N`."""

    @property
    def frame_N(self) -> str: ...

    def at(self, t_s: npt.ArrayLike) -> Surroundings: ...
