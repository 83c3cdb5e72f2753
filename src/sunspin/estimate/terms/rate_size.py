"""A sensor of how fast the body turns, but not about which axis: some beacons send the size of the rate alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
import xarray as xr

from sunspin.estimate.model import States, Unknown
from sunspin.estimate.terms.term import Residual, Term
from sunspin.vehicle import Vehicle
from sunspin.vehicle.sensors import VARIABLES


@dataclass(frozen=True)
class RateMagnitudes(Term):
    """Magnitudes of the rate (n) in rad/s, NaN where not read, with one `sigma` (rad/s) and a relative `scale_sigma`.

    They distinguish aliases, whose speeds differ by whole turns between samples, and say nothing of the axis.
    """

    name: ClassVar[str] = "rate_size"
    label: ClassVar[str] = "size of the rate"
    per_sample: ClassVar[tuple[str, ...]] = ("size",)

    size: np.ndarray
    sigma: float
    scale_sigma: float = 0.0

    @classmethod
    def read(cls, vehicle: Vehicle, telemetry: xr.Dataset) -> Self | None:
        """Return the sizes of the rate in telemetry; None if it has none."""
        part = vehicle.sensors.rate_size
        if VARIABLES["rate_size"] not in telemetry or part is None:
            return None
        size = np.asarray(telemetry[VARIABLES["rate_size"]], dtype=np.float64)
        return cls(size, part.noise_rad_s, part.scale_sigma / part.scale_rad_s)

    def present(self) -> np.ndarray:
        """Return which samples (n) have a size."""
        return np.isfinite(self.size)

    def freedom(self) -> np.ndarray:
        """Return how many numbers each reading (n) has."""
        return 1 * self.present()

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the scale, if it is not known."""
        if not self.scale_sigma or not self.present().any():
            return ()
        return (Unknown("rate_size_scale", "rate_size_scale", "1", 0.0, self.scale_sigma),)

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the predicted reading, the size of the rate with the error of the scale, less the reading (K, n, 1), in sigmas.

        The derivative of the size by the rate is the axis of the rate. At rest the size grows alike along every axis; the
        derivative is taken as zero.
        """
        was_read = self.present()
        if not was_read.any():
            return
        reading = np.where(was_read, self.size, 0.0)
        size = np.linalg.norm(states.omega, axis=-1)
        axis = states.omega / np.where(size > 0, size, 1.0)[..., None]
        value = (was_read * (size - reading) / self.sigma)[..., None]
        by_rate = (was_read[:, None] * axis / self.sigma)[:, :, None, :]
        if not u.size:
            yield Residual(value, by_rate=by_rate)
            return
        # an error of the scale is in proportion to the size, for which the reading stands
        column = (self.scale_sigma * reading / self.sigma)[:, None, None]
        value = value + column[..., 0] * u[:, None, :]
        yield Residual(value, by_rate=by_rate, by_u=np.broadcast_to(column, (*value.shape, 1)))

    def for_search(self) -> list[Self]:
        """Return the sizes without an unknown scale, whose error is added to their noise."""
        common = self.scale_sigma * np.sqrt(np.nanmean(self.size**2)) if self.unknowns() else 0.0
        return [replace(self, sigma=float(np.hypot(self.sigma, common)), scale_sigma=0.0)]

    def loosened(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        """Return the sizes with the drift of a start added to their errors."""
        return replace(self, sigma=float(np.hypot(self.sigma, drift_rad_s)))
