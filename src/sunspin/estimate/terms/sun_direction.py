"""Directions of the Sun: read by Sun sensors, or given with their covariance."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
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

OTHER = {"sun_sensor": ("sun_sensor_other_B", "sun_sensor_other_cov_B")}
"""Where it has what a reading may mean as well, and the covariances."""

UNREAD = "no Sun direction: bridged by the dynamics and other sensors"


@dataclass(frozen=True)
class SunDirection(SunTerm):
    """Directions (n, 3) with covariance (n, 3, 3) of full rank; NaN: none. `other_B`, `other_covariance`: what a reading may mean
    as well, as likely before the motion is known; of the two the one counts that the motion fits better."""

    name: ClassVar[str] = "sun"
    called: ClassVar[str] = "Sun"
    per_sample: ClassVar[tuple[str, ...]] = (
        "direction_B",
        "covariance",
        "other_B",
        "other_covariance",
    )
    measured: ClassVar[tuple[str, ...]] = per_sample

    direction_B: np.ndarray
    covariance: np.ndarray
    other_B: np.ndarray
    other_covariance: np.ndarray

    @classmethod
    def of(cls, direction_B: np.ndarray, covariance: np.ndarray) -> Self:
        """Directions that mean one thing each."""
        return cls(
            direction_B,
            covariance,
            np.full_like(direction_B, np.nan),
            np.full_like(covariance, np.nan),
        )

    @classmethod
    def read(cls, vehicle: Vehicle, telemetry: xr.Dataset, source: str) -> tuple[Self, np.ndarray]:
        """Those of telemetry, and a sentence for each sample (n)."""
        direction, covariance = (telemetry[name].values for name in COLUMNS[source])
        made = cls.of(direction, _full_rank(direction, covariance))
        if source in OTHER and OTHER[source][0] in telemetry:
            other, spread = (telemetry[name].values for name in OTHER[source])
            made = replace(made, other_B=other, other_covariance=_full_rank(other, spread))
        return made, np.where(made.informs(), "used", UNREAD).astype(object)

    def present(self) -> np.ndarray:
        return np.isfinite(self.covariance[:, 0, 0])

    def informs(self) -> np.ndarray:
        return self.present()

    def points(self) -> np.ndarray:
        return self.present()

    def several(self) -> bool:
        return bool(np.isfinite(self.other_B).any())

    def freedom(self) -> np.ndarray:
        return 2 * self.present()

    def unrelated(self, t_s: np.ndarray) -> float:
        """Under the Student law a direction fills 2 pi times the product of its sigmas; of a sphere, that is."""
        along = np.einsum("ni,nij,nj->n", self.direction_B, self.covariance, self.direction_B)
        across = np.sqrt(np.linalg.det(self.covariance[self.present()]) / along[self.present()])
        return float(np.minimum(np.log(across / 2), 0.0).sum())

    def directions(self, index: int) -> np.ndarray | None:
        sharp = self.present()[index] and np.trace(self.covariance[index]) < 3 * SHARP_RAD**2
        both = np.stack([self.direction_B[index], self.other_B[index]])
        return both[np.isfinite(both[:, 0])] if sharp else None

    def wider(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        more = (drift_rad**2)[:, None, None] * np.eye(3)
        return replace(
            self, covariance=self.covariance + more, other_covariance=self.other_covariance + more
        )

    def coarser(self, factor: float) -> Self:
        return replace(
            self,
            covariance=factor**2 * self.covariance,
            other_covariance=factor**2 * self.other_covariance,
        )

    @cached_property
    def _read(self) -> tuple[np.ndarray, np.ndarray]:
        return _whitened(self.direction_B, self.covariance)

    @cached_property
    def _other(self) -> tuple[np.ndarray, np.ndarray]:
        return _whitened(self.other_B, self.other_covariance)

    def residuals(self, seen: Seen, error: np.ndarray | None = None) -> Iterator[Residual]:
        if not self.present().any():
            return
        value, slope = _off(*self._read, seen.sun_B)
        if (unsure := np.isfinite(self.other_covariance[:, 0, 0])).any():
            other = _off(*(part[unsure] for part in self._other), seen.sun_B[:, unsure])
            better = ((other[0] ** 2).sum(axis=-1) < (value[:, unsure] ** 2).sum(axis=-1))[
                ..., None
            ]
            value[:, unsure] = np.where(better, other[0], value[:, unsure])
            slope[:, unsure] = np.where(better[..., None], other[1], slope[:, unsure])
        yield value, slope


def _whitened(direction: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions (n, 3) and roots (n, 3, 3) of the inverse of their covariances (n, 3, 3); zero where there is none."""
    read = np.isfinite(covariance[:, 0, 0])
    white = np.zeros((len(read), 3, 3))
    white[read] = np.swapaxes(np.linalg.cholesky(np.linalg.inv(covariance[read])), -1, -2)
    return np.where(read[:, None], direction, 0.0), white


def _off(direction: np.ndarray, white: np.ndarray, sun: np.ndarray) -> Residual:
    """Of the Sun (K, n, 3) from directions (n, 3), as `_whitened` gives them."""
    off = sun - direction
    return np.einsum("nij,knj->kni", white, off), white @ cross_matrix(
        sun
    )  # a turn moves the Sun by sun x turn


@dataclass(frozen=True)
class SunReading(Reading):
    """One direction of the Sun in B, seen otherwise than by panels."""

    kind: str = field(default="direction", init=False)

    def predicted(self, sun_B: np.ndarray, omega_B: np.ndarray) -> np.ndarray:
        return sun_B

    def slope(
        self, sun_B: np.ndarray, omega_B: np.ndarray, to_sun: np.ndarray, to_omega: np.ndarray
    ) -> np.ndarray:
        return to_sun


def _full_rank(direction: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    n = direction[:, :, None] * direction[:, None, :]
    along = np.einsum("nij,nij->n", covariance, n)
    add = np.where(along < RADIAL_SIGMA**2, RADIAL_SIGMA**2, 0.0)
    return np.where(
        np.isfinite(direction[:, :1, None]), covariance + add[:, None, None] * n, np.nan
    )
