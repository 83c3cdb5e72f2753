"""Term of measured Sun directions in body axes, as a Sun sensor or another program gives them.

Shapes: K motions, n samples. A turn is a small rotation of the body, as a rotation vector in body axes B (rad).
"""

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
"""Sigma of the length of a unit vector, which makes its singular covariance invertible."""

SHARP_SIGMA_RAD = 0.15
"""A search may start from a direction if its rms sigma is below this."""

UNREAD = "no Sun direction: bridged by the dynamics and other sensors"
"""What becomes of a sample without a direction."""


@dataclass(frozen=True)
class SunDirections(Term):
    """Measured directions to the Sun, unit vectors `direction_B` (n, 3) in B with `covariance` (n, 3, 3), NaN where not read.

    Some readings of Sun sensors have two meanings: `other_B` (n, 3) with `other_covariance` (n, 3, 3) is the second direction, as
    likely as the first before the motion is known; NaN if there is none. Of both, the one nearer to the prediction counts.
    """

    name: ClassVar[str] = "sun"
    label: ClassVar[str] = "Sun"
    of_sun: ClassVar[bool] = True
    per_sample: ClassVar[tuple[str, ...]] = tuple(
        "direction_B covariance other_B other_covariance".split()
    )

    direction_B: np.ndarray
    covariance: np.ndarray
    other_B: np.ndarray
    other_covariance: np.ndarray

    @classmethod
    def of(cls, direction_B: np.ndarray, covariance: np.ndarray) -> Self:
        """Return directions without a second meaning."""
        no_other = np.full_like(direction_B, np.nan), np.full_like(covariance, np.nan)
        return cls(direction_B, covariance, *no_other)

    @classmethod
    def read(cls, telemetry: xr.Dataset, source: str) -> tuple[Self, np.ndarray]:
        """Return the directions of telemetry, and for each sample (n) in words whether it is used.

        `source`: "sun_sensor" or "directions", a key of `COLUMNS`.
        """
        direction, covariance = (telemetry[name].values for name in COLUMNS[source])
        term = cls.of(direction, _full_rank(direction, covariance))
        if source in SECOND_MEANING and SECOND_MEANING[source][0] in telemetry:
            other, other_covariance = (telemetry[name].values for name in SECOND_MEANING[source])
            term = replace(
                term, other_B=other, other_covariance=_full_rank(other, other_covariance)
            )
        return term, np.where(term.present(), "used", UNREAD).astype(object)

    def present(self) -> np.ndarray:
        """Return which samples (n) have a direction."""
        return np.isfinite(self.covariance[:, 0, 0])

    def freedom(self) -> np.ndarray:
        """Return the degrees of freedom of each sample (n): two for a direction, zero without one."""
        return 2 * self.present()

    def loosened(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        """Return the directions with larger errors, for a motion whose attitude is off by `drift_rad` (n)."""
        added = (drift_rad**2)[:, None, None] * np.eye(3)
        return replace(
            self, covariance=self.covariance + added, other_covariance=self.other_covariance + added
        )

    def log_errors(self) -> float:
        """Return twice the log of the sigma of a direction, summed over the samples.

        The determinant of a covariance (3, 3) is the sixth power of the mean sigma, hence a third of its log.
        """
        return float(np.linalg.slogdet(self.covariance[self.present()])[1].sum() / 3)

    def starts(self, sample: int) -> Starts:
        """Return the one or two directions that the reading of a sample may mean; none if its error is large."""
        sharp = np.trace(self.covariance[sample]) < 3 * SHARP_SIGMA_RAD**2
        if not (self.present()[sample] and sharp):
            return Starts()
        meanings = np.stack([self.direction_B[sample], self.other_B[sample]])
        return Starts(directions=meanings[np.isfinite(meanings[:, 0])])

    @cached_property
    def _whitened(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return two pairs, of the first and the second direction that a reading may mean: directions (n, 3), matrices W (n, 3, 3).

        W times a difference of directions is in sigmas: W^T W is the inverse covariance. Both are zero where nothing was read.
        """
        first, second = (self.direction_B, self.covariance), (self.other_B, self.other_covariance)
        meanings = []
        for direction, covariance in (first, second):
            was_read = np.isfinite(covariance[:, 0, 0])
            whitening = np.zeros((len(was_read), 3, 3))
            inverse = np.linalg.inv(covariance[was_read])
            # W = L^T, where L L^T is the inverse covariance
            whitening[was_read] = np.swapaxes(np.linalg.cholesky(inverse), -1, -2)
            meanings.append((np.where(was_read[:, None], direction, 0.0), whitening))
        return meanings

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the predicted less the measured direction (K, n, 3), whitened; of two meanings the nearer one counts."""
        sun = states.sun_B
        # a turn t of the body moves the Sun in body axes by sun x t
        sun_by_turn = cross_matrix(sun)
        (direction, whitening), (other, other_whitening) = self._whitened
        value = np.einsum("nij,knj->kni", whitening, sun - direction)
        by_turn = whitening @ sun_by_turn
        has_other = np.isfinite(self.other_covariance[:, 0, 0])
        if has_other.any():
            other_value = np.einsum("nij,knj->kni", other_whitening, sun - other)
            use_other = has_other & ((other_value**2).sum(axis=-1) < (value**2).sum(axis=-1))
            value = np.where(use_other[..., None], other_value, value)
            by_turn = np.where(use_other[..., None, None], other_whitening @ sun_by_turn, by_turn)
        yield Residual(value, by_turn)


def _full_rank(direction: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return invertible covariances (n, 3, 3) of unit vectors `direction` (n, 3), NaN where there is no direction.

    The covariance of a unit vector has no variance along the vector: that of `RADIAL_SIGMA` is added.
    """
    # variance d^T C d along the direction d
    along = np.einsum("ni,nij,nj->n", direction, covariance, direction)
    added = np.where(along < RADIAL_SIGMA**2, RADIAL_SIGMA**2, 0.0)
    projector = direction[:, :, None] * direction[:, None, :]
    known = np.isfinite(direction[:, :1, None])
    return np.where(known, covariance + added[:, None, None] * projector, np.nan)
