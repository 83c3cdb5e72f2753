"""A gyro: the body rate, off by a zero and a scale that all samples of a pass share."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
import xarray as xr
from scipy.special import gamma

from sunspin.estimate.terms.reading import Reading
from sunspin.estimate.terms.term import STUDENT, Residual, Seen, StateTerm, Unknown
from sunspin.vehicle import Vehicle
from sunspin.vehicle.sensors import VARIABLES
from sunspin.vehicle.sensors import Gyro as Part


@dataclass(frozen=True)
class Gyro(StateTerm):
    """Rates (n, 3) rad/s, NaN where not read, with one sigma (rad/s), and one sigma (n, 4, 3) rad/s of the errors in common: its
    zero axis by axis, and its scale."""

    name: ClassVar[str] = "gyro"
    called: ClassVar[str] = "gyro"
    table: ClassVar[str] = "gyro"
    per_sample: ClassVar[tuple[str, ...]] = ("rate_B", "common")
    measured: ClassVar[tuple[str, ...]] = ("rate_B",)

    rate_B: np.ndarray
    sigma: float
    common: np.ndarray

    @classmethod
    def read(cls, vehicle: Vehicle, telemetry: xr.Dataset) -> Self | None:
        """That of telemetry, if it has one."""
        if VARIABLES[cls.table] not in telemetry:
            return None
        rate, part = (
            np.asarray(telemetry[VARIABLES[cls.table]], dtype=np.float64),
            vehicle.sensors.with_columns.get(cls.table),
        )
        return cls(rate, 1.0 if part is None else part.noise_rad_s, _common(part, rate))

    def present(self) -> np.ndarray:
        return np.all(np.isfinite(self.rate_B), axis=1)

    def readings(self) -> int:
        return int(self.present().sum())

    def wider(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        return replace(self, sigma=float(np.hypot(self.sigma, drift_rad_s)))

    def coarser(self, factor: float) -> Self:
        return replace(self, sigma=factor * self.sigma)

    def off_zero(self, sigma: float) -> Self | None:
        if np.any(self.common):
            return None
        common = np.zeros_like(self.common)
        common[:, :3] = sigma * np.eye(3)
        return replace(self, common=common)

    def forgiving(self) -> Self:
        return replace(
            self, sigma=float(np.hypot(self.sigma, np.sqrt((self.common**2).sum(axis=1).mean())))
        )

    def rates(self, index: int, dt: float, rate_max: float) -> np.ndarray:
        return self.rate_B[index : index + 2]

    def rate_sigma(self, index: int) -> float:
        return self.sigma if np.isfinite(self.rate_B[index : index + 2]).all() else np.inf

    def unrelated(self, t_s: np.ndarray) -> float:
        """Rates of the size of those that it reads, from one law for all."""
        read = self.rate_B[self.present()]
        square = max(float((read**2).mean()), self.sigma**2)
        filled = (
            (STUDENT * np.pi * self.sigma**2) ** 1.5
            * gamma((STUDENT - 1) / 2)
            / gamma((STUDENT + 2) / 2)
        )
        found = (
            np.log(filled) - 1.5 * np.log(2 * np.pi * square) - (read**2).sum(axis=1) / (2 * square)
        )
        return float(np.minimum(found, 0.0).sum())

    def unknowns(self) -> tuple[Unknown, ...]:
        if not (self.present().any() and np.any(self.common)):
            return ()
        zero = self.common[0, :3].diagonal()
        scale = np.abs(self.common[:, 3]).max() / max(np.nanmax(np.abs(self.rate_B)), 1e-300)
        made = (
            Unknown(f"gyro_zero_{axis}", "gyro_zero", "rad/s", 0.0, float(zero[i]), i)
            for i, axis in enumerate("xyz")
        )
        return (*made, Unknown("gyro_scale", "gyro_scale", "1", 0.0, float(scale)))

    @cached_property
    def _constant(self) -> tuple[np.ndarray, ...]:
        """Which rates were read (n), the rates (n, 3), in sigmas what one sigma of zero and scale adds (n, 4, 3), and slopes."""
        read = self.present()
        column = np.nan_to_num(self.common) * read[:, None, None] / self.sigma
        own = read[:, None, None] * np.eye(3) / self.sigma
        slope = np.concatenate(
            [np.zeros((len(read), 3, 3)), own, np.swapaxes(column, -1, -2)], axis=-1
        )
        return read, np.nan_to_num(self.rate_B), column, slope

    def residuals(self, seen: Seen, error: np.ndarray | None = None) -> Iterator[Residual]:
        read, rate, column, slope = self._constant
        if not read.any():
            return
        value = np.where(read[:, None], (seen.omega - rate) / self.sigma, 0.0)
        if error is not None and error.shape[1]:
            value = value + np.einsum("ka,nai->kni", error, column)
        else:
            slope = slope[..., :6]
        yield value, np.broadcast_to(slope, (len(value), *slope.shape))


@dataclass(frozen=True)
class GyroReading(Reading):
    """One body rate, rad/s."""

    kind: str = field(default="gyro", init=False)

    def predicted(self, sun_B: np.ndarray, omega_B: np.ndarray) -> np.ndarray:
        return omega_B

    def slope(
        self, sun_B: np.ndarray, omega_B: np.ndarray, to_sun: np.ndarray, to_omega: np.ndarray
    ) -> np.ndarray:
        return to_omega


def _common(part: Part | None, rate: np.ndarray) -> np.ndarray:
    errors = np.zeros((len(rate), 4, 3))
    if part is not None:
        errors[:, :3] = np.diag(part.scale_rad_s * part.zero_sigma)
        errors[:, 3] = np.nan_to_num(rate) * part.scale_sigma / abs(part.scale_rad_s)
    return errors
