"""The direction to the Sun in body axes, as a Sun sensor or another program gives it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
import xarray as xr

from sunspin.estimate.model import States
from sunspin.estimate.terms.term import Residual, Starts, Term
from sunspin.solve.rotations import cross_matrix

COLUMNS = {"sun_sensor": ("sun_sensor_B", "sun_sensor_cov_B"), "directions": ("sun_B", "sun_cov_B")}
"""Source of directions -> variables of the telemetry with direction and covariance."""

SECOND_MEANING = {"sun_sensor": ("sun_sensor_other_B", "sun_sensor_other_cov_B")}
"""Source -> variables with the direction that a reading may mean as well."""

RADIAL_SIGMA = 0.02
"""Sigma that is given to a direction's length, about which a covariance says nothing."""

SHARP_RAD = 0.15
"""A direction is a point to start from if its rms sigma is below this."""

UNREAD = "no Sun direction: bridged by the dynamics and other sensors"
"""What becomes of a sample without a direction."""


@dataclass(frozen=True)
class SunDirections(Term):
    """Unit vectors (n, 3) in B with covariances (n, 3, 3), NaN where not read.

    `other_B`, `other_covariance`: a second direction that a reading may mean, equally likely before the motion is known; NaN if
    there is none. The one that a motion fits better counts.
    """

    name: ClassVar[str] = "sun"
    label: ClassVar[str] = "Sun"
    of_sun: ClassVar[bool] = True
    per_sample: ClassVar[tuple[str, ...]] = (
        "direction_B",
        "covariance",
        "other_B",
        "other_covariance",
    )

    direction_B: np.ndarray
    covariance: np.ndarray
    other_B: np.ndarray
    other_covariance: np.ndarray

    @classmethod
    def of(cls, direction_B: np.ndarray, covariance: np.ndarray) -> Self:
        """Return directions without a second meaning."""
        nothing = np.full_like(direction_B, np.nan), np.full_like(covariance, np.nan)
        return cls(direction_B, covariance, *nothing)

    @classmethod
    def read(cls, telemetry: xr.Dataset, source: str) -> tuple[Self, np.ndarray]:
        """Return the directions of telemetry from a source, and what became of each sample (n), in words."""
        direction, covariance = (telemetry[name].values for name in COLUMNS[source])
        read = cls.of(direction, _full_rank(direction, covariance))
        if source in SECOND_MEANING and SECOND_MEANING[source][0] in telemetry:
            other, spread = (telemetry[name].values for name in SECOND_MEANING[source])
            read = replace(read, other_B=other, other_covariance=_full_rank(other, spread))
        return read, np.where(read.present(), "used", UNREAD).astype(object)

    def present(self) -> np.ndarray:
        """Return which samples (n) have a direction."""
        return np.isfinite(self.covariance[:, 0, 0])

    def freedom(self) -> np.ndarray:
        """Return two numbers for each direction (n)."""
        return 2 * self.present()

    def loosened(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        """Return the directions with the drift of a start added to their errors."""
        drift = (drift_rad**2)[:, None, None] * np.eye(3)
        return replace(
            self, covariance=self.covariance + drift, other_covariance=self.other_covariance + drift
        )

    def log_errors(self) -> float:
        """Return the sum of the logs of the errors of all directions: two of the three numbers of each covariance."""
        return float(np.linalg.slogdet(self.covariance[self.present()])[1].sum() / 3)

    def starts(self, sample: int) -> Starts:
        """Return the direction or directions that the reading of a sample may mean, if its error is small."""
        sharp = np.trace(self.covariance[sample]) < 3 * SHARP_RAD**2
        if not (self.present()[sample] and sharp):
            return Starts()
        meanings = np.stack([self.direction_B[sample], self.other_B[sample]])
        return Starts(directions=meanings[np.isfinite(meanings[:, 0])])

    @cached_property
    def _whitened(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return for the first and the second meaning: directions (n, 3), and W (n, 3, 3) that makes errors of unit size.

        W^T W is the inverse covariance; both are zero where nothing was read.
        """
        first, second = (self.direction_B, self.covariance), (self.other_B, self.other_covariance)
        meanings = []
        for direction, covariance in (first, second):
            read = np.isfinite(covariance[:, 0, 0])
            white = np.zeros((len(read), 3, 3))
            inverse = np.linalg.inv(covariance[read])
            white[read] = np.swapaxes(np.linalg.cholesky(inverse), -1, -2)
            meanings.append((np.where(read[:, None], direction, 0.0), white))
        return meanings

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the whitened difference (K, n, 3) of predicted and read direction; of two meanings the nearer one counts."""
        sun = states.sun_B
        across = cross_matrix(sun)  # a turn t of the body moves the Sun by sun x t
        (direction, white), (other, other_white) = self._whitened
        value = np.einsum("nij,knj->kni", white, sun - direction)
        by_turn = white @ across
        double = np.isfinite(self.other_covariance[:, 0, 0])
        if double.any():
            second = np.einsum("nij,knj->kni", other_white, sun - other)
            nearer = double & ((second**2).sum(axis=-1) < (value**2).sum(axis=-1))
            value = np.where(nearer[..., None], second, value)
            by_turn = np.where(nearer[..., None, None], other_white @ across, by_turn)
        yield Residual(value, by_turn)


def _full_rank(direction: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return covariances (n, 3, 3) with an error along the direction (n, 3) too, NaN where there is no direction.

    The covariance of a unit vector is zero along it, and could not be inverted.
    """
    along = np.einsum("ni,nij,nj->n", direction, covariance, direction)
    added = np.where(along < RADIAL_SIGMA**2, RADIAL_SIGMA**2, 0.0)
    projector = direction[:, :, None] * direction[:, None, :]
    known = np.isfinite(direction[:, :1, None])
    return np.where(known, covariance + added[:, None, None] * projector, np.nan)
