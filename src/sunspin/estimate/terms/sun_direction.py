"""Directions of the Sun: read by Sun sensors, or given with their covariance."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import numpy as np
import xarray as xr

from sunspin.estimate.terms.reading import Reading
from sunspin.estimate.terms.term import Residual, Seen, SunTerm
from sunspin.solve.rotations import cross_matrix
from sunspin.vehicle import Vehicle

RADIAL_SIGMA = 0.02
"""Sigma given to a direction along itself, so that its covariance can be inverted; a chord is shorter than its arc."""

SHARP_RAD = 0.15
"""A direction better than this is a point to start from; a worse one is a region."""

COLUMNS = {"sun_sensor": ("sun_sensor_B", "sun_sensor_cov_B"), "directions": ("sun_B", "sun_cov_B")}
"""Where telemetry has the directions of each source, and their covariances."""

UNREAD = "no direction of the Sun: only the motion and other sensors bridge it"


@dataclass(frozen=True)
class SunDirection(SunTerm):
    """Directions (n, 3) with covariance (n, 3, 3) of full rank; NaN: none."""

    name: ClassVar[str] = "sun"
    called: ClassVar[str] = "Sun"
    per_sample: ClassVar[tuple[str, ...]] = ("direction_B", "covariance")

    direction_B: np.ndarray
    covariance: np.ndarray

    @classmethod
    def read(cls, vehicle: Vehicle, telemetry: xr.Dataset, source: str) -> tuple[Self, np.ndarray]:
        """Those of telemetry, and a sentence for each sample (n)."""
        direction, covariance = (telemetry[name].values for name in COLUMNS[source])
        made = cls(direction, _full_rank(direction, covariance))
        return made, np.where(made.informs(), "used", UNREAD).astype(object)

    def present(self) -> np.ndarray:
        return np.isfinite(self.covariance[:, 0, 0])

    def informs(self) -> np.ndarray:
        return self.present()

    def points(self) -> np.ndarray:
        return self.present()

    def freedom(self) -> np.ndarray:
        return 2 * self.present()

    def unrelated(self, t_s: np.ndarray) -> float:
        """Under the Student law a direction fills 2 pi times the product of its sigmas; of a sphere, that is."""
        along = np.einsum("ni,nij,nj->n", self.direction_B, self.covariance, self.direction_B)
        across = np.sqrt(np.linalg.det(self.covariance[self.present()]) / along[self.present()])
        return float(np.minimum(np.log(across / 2), 0.0).sum())

    def directions(self, index: int) -> np.ndarray | None:
        sharp = self.present()[index] and np.trace(self.covariance[index]) < 3 * SHARP_RAD**2
        return self.direction_B[index : index + 1] if sharp else None

    def wider(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        return type(self)(self.direction_B, self.covariance + (drift_rad**2)[:, None, None] * np.eye(3))

    def coarser(self, factor: float) -> Self:
        return replace(self, covariance=factor**2 * self.covariance)

    def residuals(self, seen: Seen, error: np.ndarray | None = None) -> Iterator[Residual]:
        sun, read = seen.sun_B, self.present()
        if read.any():
            white = np.zeros((len(read), 3, 3))
            white[read] = np.swapaxes(np.linalg.cholesky(np.linalg.inv(self.covariance[read])), -1, -2)
            off = sun - np.where(read[:, None], self.direction_B, 0.0)
            yield np.einsum("nij,knj->kni", white, off), white @ cross_matrix(sun)  # a turn moves the Sun by sun x turn


@dataclass(frozen=True)
class SunReading(Reading):
    """One direction of the Sun in B, seen otherwise than by panels."""

    kind: str = field(default="direction", init=False)

    def predicted(self, sun_B: np.ndarray, omega_B: np.ndarray) -> np.ndarray:
        return sun_B

    def slope(self, sun_B: np.ndarray, omega_B: np.ndarray, to_sun: np.ndarray, to_omega: np.ndarray) -> np.ndarray:
        return to_sun


def _full_rank(direction: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    n = direction[:, :, None] * direction[:, None, :]
    along = np.einsum("nij,nij->n", covariance, n)
    add = np.where(along < RADIAL_SIGMA**2, RADIAL_SIGMA**2, 0.0)
    return np.where(np.isfinite(direction[:, :1, None]), covariance + add[:, None, None] * n, np.nan)
