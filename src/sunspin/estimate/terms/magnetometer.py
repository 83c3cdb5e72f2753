"""A magnetometer: how the field turns in the body from sample to sample, its direction in space being unknown.

Along a pass the field in N changes the same way for minutes, by up to two turns an orbit. Taken for noise from sample to sample
that averages out, and the turn about the Sun line, which only the field determines, is off by more than its sigma. So the rate of
change in N, and the drift of that, are unknowns of a pass; what does not change evenly stays noise.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import numpy as np
import xarray as xr

from sunspin.estimate.terms.term import PairTerm, Seen, Unknown, drifting
from sunspin.solve.rotations import cross_matrix
from sunspin.vehicle import Vehicle

FIELD_FACTOR = 5.0
"""A field of more than this many times the usual size is a wrapped or broken reading: along an orbit it varies by three."""

TURN_RATE = 2.2e-3
"""rad/s; a satellite in low orbit sees the Earth's field turn at about twice its own rate of 1.1e-3 rad/s."""

LEFT = 0.2
"""Part of the field's turning that does not change evenly over a pass, and stays noise."""


@dataclass(frozen=True)
class Magnetometer(PairTerm):
    """Fields (n, 3), NaN where not read, with one sigma, in any unit (infinite: only the dipole's torque uses them); `turn_rate`
    (rad/s): what the field turns any way beside its drift, of which `drift_N` (n, u, 3) is one sigma of each unknown."""

    name: ClassVar[str] = "field"
    called: ClassVar[str] = "magnetometer"
    per_sample: ClassVar[tuple[str, ...]] = ("field_B", "drift_N")

    field_B: np.ndarray
    sigma: float
    turn_rate: float = TURN_RATE
    drift_N: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 3)))

    @classmethod
    def read(cls, vehicle: Vehicle, telemetry: xr.Dataset) -> Self | None:
        """That of telemetry, if it has one."""
        if "field_B" not in telemetry:
            return None
        part = vehicle.sensors.magnetometer
        noise = part.noise if part is not None else None
        read = _without_outliers(np.asarray(telemetry["field_B"], dtype=np.float64))
        return cls(read, noise or np.inf, drift_N=np.zeros((len(read), 0, 3)))

    def present(self) -> np.ndarray:
        return np.all(np.isfinite(self.field_B), axis=1)

    def pairs(self) -> np.ndarray:
        return super().pairs() & np.isfinite(self.sigma)

    def sigmas(self, t_s: np.ndarray) -> np.ndarray:
        """One sigma (n - 1) of the field's change between neighbours: of two readings, and of its turning."""
        return np.sqrt(2 * self.sigma**2 + (np.linalg.norm(self.field_B[:-1], axis=1) * self.turn_rate * np.diff(t_s)) ** 2)

    def wider(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        size = np.linalg.norm(np.nan_to_num(self.field_B), axis=1).max(initial=0.0)
        return replace(self, sigma=float(np.hypot(self.sigma, drift_rad.max() * size / 2)))

    def unrelated(self, t_s: np.ndarray) -> float:
        """The next reading's direction is any: the mean of its law over the sphere that the first one can be carried to."""
        pair = self.pairs()
        start, end = (np.linalg.norm(part[pair], axis=1) for part in (self.field_B[:-1], self.field_B[1:]))
        variance = self.sigmas(t_s)[pair] ** 2
        both = start * end / variance
        return float((np.log(-np.expm1(-2 * both) / (2 * both)) - (start - end) ** 2 / (2 * variance)).sum())

    def freed(self, t_s: np.ndarray) -> Self:
        if not self.pairs().any():
            return self
        sigma = TURN_RATE * np.nanmedian(np.linalg.norm(self.field_B, axis=1)) / np.sqrt(3)
        return replace(self, drift_N=drifting(t_s, sigma, TURN_RATE), turn_rate=LEFT * TURN_RATE)

    def unknowns(self) -> tuple[Unknown, ...]:
        if not (self.pairs().any() and self.drift_N.shape[1]):
            return ()
        sizes = np.linalg.norm(self.drift_N, axis=2).max(axis=0)
        return tuple(Unknown(f"{self.name}_drift_{i}", "field_drift", "field s-1", 0.0, float(s), i) for i, s in enumerate(sizes))

    def between(self, t_s: np.ndarray, relative: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        pair = self.pairs()
        start, end = np.nan_to_num(self.field_B[:-1]) * pair[:, None], np.nan_to_num(self.field_B[1:]) * pair[:, None]
        inverse = np.where(pair, 1 / self.sigmas(t_s), 0.0)[:, None]
        carried = np.einsum("knij,nj->kni", relative, start)
        value = (carried - end) * inverse
        first, second = np.zeros((*value.shape, 6)), np.zeros((*value.shape, 6))
        second[..., :3] = cross_matrix(carried) * inverse[..., None]
        first[..., :3] = -relative @ cross_matrix(start) * inverse[..., None]
        return value, first, second

    def gained(self, t_s: np.ndarray, seen: Seen) -> np.ndarray:
        change = np.einsum("knij,nmj->knim", seen.attitude[:, 1:], self.drift_N[:-1])
        return change * np.where(self.pairs(), np.diff(t_s) / self.sigmas(t_s), 0.0)[:, None, None]


def _without_outliers(read: np.ndarray) -> np.ndarray:
    """Fields (n, 3) with readings far beyond the usual size, which the Earth's field cannot reach, made NaN."""
    size = np.linalg.norm(np.nan_to_num(read), axis=1)
    usual = np.median(size[size > 0]) if np.any(size > 0) else 0.0
    return np.where((size <= FIELD_FACTOR * usual)[:, None], read, np.nan)
