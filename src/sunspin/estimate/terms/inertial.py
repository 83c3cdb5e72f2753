"""Terms of sensors of the rotation in space: gyro, magnitude of the rate, attitude sensor; and of their time offset.

Shapes: K motions, n samples, m unknowns u of a term, in sigmas of their priors. A turn is a rotation of the body, as a rotation
vector in body axes B (rad). Attitudes are matrices B_from_N.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
import xarray as xr

from sunspin.estimate.model import States, Unknown
from sunspin.estimate.settings import GYRO_DRIFTS, GYRO_ZEROS
from sunspin.estimate.terms.term import Residual, Starts, Term, at_sample_before, gaussian
from sunspin.solve.rotations import matrix_from_quaternion, rotation_between
from sunspin.vehicle import Vehicle
from sunspin.vehicle.sensors import VARIABLES, zero_sigmas

MOST_REVOLUTIONS = 20
"""Largest number of whole revolutions between two attitudes that is tried, in either sense. The largest rate allows fewer."""


@dataclass(frozen=True)
class GyroRates(Term):
    """Gyro readings `rate_B` (n, 3) in rad/s, NaN where not read, with noise `sigma` (rad/s) of each component.

    The gyro has a zero offset on each axis and one scale error. `zero_sigma` (3), rad/s: sigma of the offset, 0 for an axis whose
    offset is known. `scale_sigma`: relative sigma of the scale. `zero_stated`: the vehicle file states a sigma of the offset.
    `any_zero`: the sigma may be any of :data:`GYRO_ZEROS`, whose first and largest is `zero_sigma`, as none is stated, or in spite
    of the stated one. `drifts_over`: first and last time (s) of the pass, if the zero offset drifts evenly, with a change from the
    middle to the end of any of the sizes :data:`GYRO_DRIFTS`; None if it does not drift. `t_s` (n): times of the readings, for
    that alone.
    """

    name: ClassVar[str] = "gyro"
    label: ClassVar[str] = "gyro"
    per_sample: ClassVar[tuple[str, ...]] = ("rate_B", "t_s")

    rate_B: np.ndarray
    t_s: np.ndarray
    sigma: float
    zero_sigma: np.ndarray
    scale_sigma: float
    zero_stated: bool = True
    any_zero: bool = False
    drifts_over: tuple[float, float] | None = None

    @classmethod
    def read(cls, vehicle: Vehicle, telemetry: xr.Dataset) -> Self | None:
        """Return the gyro of telemetry, with its errors from the vehicle file; None if the telemetry has none.

        If the vehicle file states no sigma of the zero offset, the offset may have any of the sizes :data:`GYRO_ZEROS`.
        """
        if VARIABLES["gyro"] not in telemetry:
            return None
        rate = np.asarray(telemetry[VARIABLES["gyro"]], dtype=np.float64)
        t_s = np.asarray(telemetry["time"], dtype=np.float64)
        part = vehicle.sensors.gyro
        if part is None:
            # the noise is unknown: with a sigma of 1 rad/s the rates hardly count
            return cls(rate, t_s, sigma=1.0, zero_sigma=np.zeros(3), scale_sigma=0.0)
        # from sigmas in the unit of the columns to rad/s, and to a relative sigma of the scale
        zero = abs(part.scale_rad_s) * zero_sigmas(part.zero_sigma)
        scale = part.scale_sigma / abs(part.scale_rad_s)
        gyro = cls(rate, t_s, part.noise_rad_s, zero, scale)
        return gyro if np.any(zero) else replace(gyro, zero_stated=False).with_any_zero()

    def with_any_zero(self) -> Self:
        """Return the gyro with a zero offset of any of the sizes :data:`GYRO_ZEROS`."""
        return replace(self, zero_sigma=np.full(3, GYRO_ZEROS[0]), any_zero=True)

    def drifting(self, over_s: tuple[float, float]) -> Self:
        """Return the gyro with a zero offset that drifts evenly from a first to a last time (s)."""
        return replace(self, drifts_over=over_s)

    def with_errors_of(self, fitted: Self) -> Self:
        """Return the gyro with the drift and the error of the scale that are unknowns in a fitted model."""
        return replace(self, drifts_over=fitted.drifts_over, scale_sigma=fitted.scale_sigma)

    def present(self) -> np.ndarray:
        """Return which samples (n) have a rate."""
        return np.all(np.isfinite(self.rate_B), axis=1)

    @property
    def _reading_by_u(self) -> np.ndarray:
        """Return what one sigma of each unknown (in the order of `unknowns`) adds to the readings (n, 3, m), rad/s."""
        was_read = self.present()[:, None, None]
        # offsets of the axes whose offset is not known
        zero = np.diag(self.zero_sigma)[:, self.zero_sigma > 0]
        by_u = [np.broadcast_to(zero, (len(was_read), *zero.shape))]
        if self.scale_sigma:
            # in proportion to the rate; the reading is near enough to it
            by_u.append((self.scale_sigma * np.nan_to_num(self.rate_B))[..., None])
        if self.drifts_over is not None:
            begin, end = self.drifts_over
            # from -1 at the first time to 1 at the last
            drifted = (2 * self.t_s - begin - end) / max(end - begin, 1e-9)
            by_u.append(GYRO_DRIFTS[0] * drifted[:, None, None] * np.eye(3))
        return was_read * np.concatenate(by_u, axis=-1)

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the zero offset of each axis and the scale, if they are not known, and the drift of the offset if it drifts."""
        if not self.present().any():
            return ()
        # sigmas of the offset that are equally likely, as factors of the largest
        shares = tuple(zero / GYRO_ZEROS[0] for zero in GYRO_ZEROS) if self.any_zero else (1.0,)
        kind, doubted = "gyro_zero", self.any_zero and self.zero_stated
        zeros = [
            Unknown(f"{kind}_{axis}", kind, "rad/s", 0.0, sigma, i, shares=shares, doubted=doubted)
            for i, (axis, sigma) in enumerate(zip("xyz", self.zero_sigma.tolist(), strict=True))
            if sigma
        ]
        scale = Unknown("gyro_scale", "gyro_scale", "1", 0.0, self.scale_sigma)
        sizes = tuple(drift / GYRO_DRIFTS[0] for drift in GYRO_DRIFTS)
        drifts = [
            Unknown(
                f"gyro_drift_{axis}", "gyro_drift", "rad/s", 0.0, GYRO_DRIFTS[0], i, shares=sizes
            )
            for i, axis in enumerate("xyz" if self.drifts_over is not None else "")
        ]
        return (*zeros, *([scale] if self.scale_sigma else []), *drifts)

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the predicted less the read rate (K, n, 3) in sigmas, with the errors of zero, scale and drift."""
        was_read = self.present()[:, None]
        if not was_read.any():
            return
        value = was_read * (states.omega - np.nan_to_num(self.rate_B)) / self.sigma
        by_rate = np.broadcast_to(was_read[..., None] * np.eye(3) / self.sigma, (*value.shape, 3))
        by_u = self._reading_by_u / self.sigma
        value = value + np.einsum("nim,km->kni", by_u, u)
        by_u = np.broadcast_to(by_u, (*value.shape, by_u.shape[-1]))
        yield Residual(value, by_rate=by_rate, by_u=by_u)

    def for_search(self) -> list[Self]:
        """Return the gyro without unknowns, as a list of one; the errors of zero offset and scale count as noise instead.

        The rms of what these errors together add to a component of the rate, over samples and axes, is added to `sigma` in squares.
        A zero offset of any size counts as exactly zero. With its largest possible sigma, 3 deg/s (`GYRO_ZEROS`), a gyro would
        hardly narrow the rates to be searched. A drift is left out too.
        """
        zero_sigma = np.zeros(3) if self.any_zero else self.zero_sigma
        by_u = replace(self, zero_sigma=zero_sigma)._reading_by_u  # (n, 3, m) rad/s
        by_u = by_u[self.present()]  # the others are zero
        # mean over the samples and the three axes of the sum over the unknowns
        rms_error = np.sqrt((by_u**2).sum(axis=(1, 2)).mean() / 3) if by_u.size else 0.0
        sigma = float(np.hypot(self.sigma, rms_error))
        return [
            replace(self, sigma=sigma, zero_sigma=np.zeros(3), scale_sigma=0.0, drifts_over=None)
        ]

    def loosened(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        """Return the gyro with larger noise, for a motion whose rate is off by `drift_rad_s`."""
        return replace(self, sigma=float(np.hypot(self.sigma, drift_rad_s)))

    def starts(self, sample: int) -> Starts:
        """Return the rates that were read at a sample and the next one, with a finite sigma only if both were read."""
        rates = self.rate_B[sample : sample + 2]
        rates = rates[np.isfinite(rates).all(axis=1)]
        return Starts(rates=rates, rate_sigma=self.sigma if len(rates) == 2 else np.inf)


@dataclass(frozen=True)
class RateMagnitudes(Term):
    """Magnitudes of the rate, `size` (n) in rad/s, NaN where not read, with noise `sigma` (rad/s) and a relative `scale_sigma`.

    They distinguish aliases, whose angular speeds differ by whole revolutions between samples, but do not show the axis.
    """

    name: ClassVar[str] = "rate_size"
    label: ClassVar[str] = "size of the rate"
    per_sample: ClassVar[tuple[str, ...]] = ("size",)

    size: np.ndarray
    sigma: float
    scale_sigma: float = 0.0

    @classmethod
    def read(cls, vehicle: Vehicle, telemetry: xr.Dataset) -> Self | None:
        """Return the magnitudes of the rate in telemetry; None if it has none."""
        part = vehicle.sensors.rate_size
        if VARIABLES["rate_size"] not in telemetry or part is None:
            return None
        size = np.asarray(telemetry[VARIABLES["rate_size"]], dtype=np.float64)
        return cls(size, part.noise_rad_s, part.scale_sigma / part.scale_rad_s)

    def present(self) -> np.ndarray:
        """Return which samples (n) have a reading."""
        return np.isfinite(self.size)

    def freedom(self) -> np.ndarray:
        """Return the degrees of freedom of each sample (n): one for a reading, zero without one."""
        return 1 * self.present()

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the scale, if it is not known."""
        if not self.scale_sigma or not self.present().any():
            return ()
        return (Unknown("rate_size_scale", "rate_size_scale", "1", 0.0, self.scale_sigma),)

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the predicted less the read magnitudes (K, n, 1) in sigmas.

        The prediction is the magnitude of the rate, changed by the error u (K, 1) of the scale if that is not known. Its derivative
        by the rate is the unit vector along the rate, or zero for a body at rest.
        """
        was_read = self.present()
        if not was_read.any():
            return
        reading = np.where(was_read, self.size, 0.0)
        magnitude = np.linalg.norm(states.omega, axis=-1)
        axis = states.omega / np.where(magnitude > 0, magnitude, 1.0)[..., None]
        value = (was_read * (magnitude - reading) / self.sigma)[..., None]
        by_rate = (was_read[:, None] * axis / self.sigma)[:, :, None, :]
        if not u.size:  # the scale is known
            yield Residual(value, by_rate=by_rate)
            return
        # a scale error changes the prediction in proportion to the magnitude, for which the reading is taken here
        by_scale = (self.scale_sigma * reading / self.sigma)[:, None, None]
        value = value + by_scale[..., 0] * u[:, None, :]
        yield Residual(value, by_rate=by_rate, by_u=np.broadcast_to(by_scale, (*value.shape, 1)))

    def for_search(self) -> list[Self]:
        """Return the magnitudes without an unknown scale; the rms of its error over the readings is added to `sigma` in squares."""
        rms_error = self.scale_sigma * np.sqrt(np.nanmean(self.size**2)) if self.unknowns() else 0.0
        return [replace(self, sigma=float(np.hypot(self.sigma, rms_error)), scale_sigma=0.0)]

    def loosened(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        """Return the magnitudes with larger noise, for a motion whose rate is off by `drift_rad_s`."""
        return replace(self, sigma=float(np.hypot(self.sigma, drift_rad_s)))


@dataclass(frozen=True)
class AttitudeChange(Term):
    """Measured attitudes `B_from_N` (n, 3, 3) at times `t_s` (n), NaN where not read, with one sigma `sigma_rad` about each axis.

    N may be any inertial frame, as only the turn between neighbouring samples is used.
    """

    name: ClassVar[str] = "attitude"
    label: ClassVar[str] = "attitude"
    per_sample: ClassVar[tuple[str, ...]] = ("t_s", "B_from_N")

    t_s: np.ndarray
    B_from_N: np.ndarray
    sigma_rad: float

    @classmethod
    def read(cls, vehicle: Vehicle, telemetry: xr.Dataset) -> Self | None:
        """Return the attitudes of telemetry; None if it has none."""
        if VARIABLES["attitude"] not in telemetry:
            return None
        quaternion = np.asarray(telemetry[VARIABLES["attitude"]], dtype=np.float64)
        was_read = np.isfinite(quaternion).all(axis=1)
        B_from_N = np.full((len(quaternion), 3, 3), np.nan)
        B_from_N[was_read] = matrix_from_quaternion(quaternion[was_read])
        part = vehicle.sensors.attitude
        t_s = np.asarray(telemetry["time"], dtype=np.float64)
        return cls(t_s, B_from_N, part.sigma_rad if part is not None else np.inf)

    def present(self) -> np.ndarray:
        """Return which samples (n) are compared with the previous one: both have a reading."""
        read = np.isfinite(self.B_from_N[:, 0, 0]) & np.isfinite(self.sigma_rad)
        return read & np.concatenate([[False], read[:-1]])

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the predicted less the measured turn (K, n, 3) of the body since the previous sample, in sigmas.

        The value is the rotation vector that takes the measured turn to the predicted one. It is small, so that a further small
        turn adds to it as a vector: hence the derivatives.
        """
        was_read = self.present()
        if not was_read.any():
            return
        turn_read = self.B_from_N @ np.swapaxes(at_sample_before(self.B_from_N), -1, -2)
        turn_read = np.where(was_read[:, None, None], turn_read, np.eye(3))
        before = at_sample_before(states.attitude, axis=1)
        # matrices of the turns; they take a turn at the previous sample to the axes of this one
        relative = states.attitude @ np.swapaxes(before, -1, -2)
        # A turn has the errors of two readings, hence sqrt 2. The correlation of turns that share a reading is neglected.
        inverse = np.where(was_read, 1 / (np.sqrt(2) * self.sigma_rad), 0.0)[:, None]
        turn_read = np.broadcast_to(turn_read, relative.shape)
        value = rotation_between(turn_read, relative) * inverse
        by_turn = np.broadcast_to(np.eye(3) * inverse[..., None], relative.shape)
        by_previous = -relative * inverse[..., None]
        yield Residual(value, by_turn, by_previous=by_previous, law=gaussian)

    def loosened(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        """Return the attitudes with a larger sigma, for a motion whose attitude is off by `drift_rad` (n)."""
        return replace(self, sigma_rad=float(np.hypot(self.sigma_rad, drift_rad.max())))

    def starts(self, sample: int) -> Starts:
        """Return the constant rates that make the turn from a sample to the next, with whole revolutions more and fewer."""
        pair = self.B_from_N[sample : sample + 2]
        if len(pair) < 2 or not np.isfinite(pair).all():
            return Starts()
        dt = self.t_s[sample + 1] - self.t_s[sample]
        angle = rotation_between(pair[0], pair[1])
        size = max(float(np.linalg.norm(angle)), 1e-9)
        revolutions = 2 * np.pi * np.arange(-MOST_REVOLUTIONS, MOST_REVOLUTIONS + 1)[:, None]
        return Starts(rates=angle / dt * (1 + revolutions / size))


@dataclass(frozen=True)
class Latency(Term):
    """Time offset of gyro, magnetometer and attitude sensor: they are read `late_s` (s) before the Sun of the same row.

    `sigma_s` (s): its sigma. The term has no readings. The fit predicts these sensors from the motion at the earlier time.
    """

    name: ClassVar[str] = "clock"
    label: ClassVar[str] = "clock"

    late_s: float
    sigma_s: float

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the time offset, unless it is known exactly."""
        if not self.sigma_s:
            return ()
        return (Unknown("late_s", "clock", "s", self.late_s, self.sigma_s),)

    def for_search(self) -> list[Self]:
        """Return a time offset of zero: its effect is small against the errors of starts, which a search adds to the sigmas."""
        return [replace(self, late_s=0.0, sigma_s=0.0)]
