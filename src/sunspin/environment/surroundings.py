"""What an environment says: directions, light and field at times, each with its error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Surroundings:
    """The surroundings at n times; None is what is not known, an error included.

    `sun_N` (n, 3) unit, direction to the Sun; `lit` (n) the part of the Sun's disc that is seen, 0 to 1; `field_N` (n, 3) T;
    `nadir_N` (n, 3) unit, and `nadir_turn_N` (n, 3) the rate (rad/s) at which it turns in N, None where it stands;
    `earth_radius_rad` (n) of the Earth's disc; `albedo_light_N` (n, 3) in parts of full Sun, from where it comes. Sigmas (n):
    `sun_sigma_rad` and `nadir_sigma_rad` of directions, `field_sigma_T` of the vector, `lit_sigma`, and `albedo_sigma` of the light
    as a vector; that of the disc's radius is less than 1e-3 of it. `field_along_N` (n, 3) T: the part of the field's error that all
    times share, what one sigma along the track changes.
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
    """Anything that gives the surroundings at times in s from a dataset's epoch, in the frame `frame_N`."""

    @property
    def frame_N(self) -> str: ...

    def at(self, t_s: npt.ArrayLike) -> Surroundings: ...
