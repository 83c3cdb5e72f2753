"""Terms of a magnetometer: its change between neighbouring samples, its reading in a known field, or its direction without a Sun.

Without an orbit the direction of the field in space is unknown, but nearly the same at two neighbouring samples (`FieldChange`). It
rotates the same way for minutes, by up to two revolutions an orbit. If that were noise, independent from sample to sample, it would
seem to average out, and the rotation about the Sun, which only the field determines, would be off by more than its sigma. So the
mean rate of change of the field in N and the linear drift of that rate are unknowns of a pass; the rest is noise. In a known orbit
only the errors of the sensor and of the orbit are unknown (`KnownField`).

Shapes: K motions, n samples, m unknowns u in sigmas of their priors. A turn is a rotation of the body, as a rotation vector in body
axes B (rad). N is fixed in space with z towards the Sun. Attitudes are matrices B_from_N.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
import xarray as xr

from sunspin.environment import Surroundings
from sunspin.estimate.model import SUN_N, States, Unknown
from sunspin.estimate.settings import FIELD_TURN
from sunspin.estimate.terms.directions import SunDirections
from sunspin.estimate.terms.term import (
    Residual,
    Term,
    at_sample_before,
    drifting_vector,
    facing,
    gaussian,
)
from sunspin.solve.rotations import cross_matrix, rotate_attitude, rotate_by_smallest
from sunspin.vehicle import Vehicle
from sunspin.vehicle.sensors import VARIABLES, Magnetometer, zero_sigmas

if TYPE_CHECKING:
    from sunspin.estimate.orbit.calibration import FieldCalibration

LARGEST_FIELD_FACTOR = 5.0
"""A field of more than this many times the median is a wrapped or broken reading: along an orbit it varies by a factor of 3."""

PARABOLA_WINDOW_S, FEWEST_IN_WINDOW, READINGS_WITH_SAME_ERROR = 300.0, 8, 30
"""Time in which the squared strength of the field in a low orbit is a parabola; number of readings that such a window needs; and
number of neighbouring readings with the same error by soft iron, which count as one."""

ZERO_ROUNDS, OUTLIER_IN_MEDIANS = 3, 6.0
"""Rounds of the fit of a magnetometer's zero offset; and residual, as a multiple of the median, beyond which the next round leaves
a reading out."""

MATRIX_SIGMA = 0.05
"""One sigma of each element of the error matrix of an uncalibrated magnetometer: soft iron, and axes off by three degrees. With
0.03 a pass of three revolutions was decided 8 sigma off."""

LARGEST_ZERO_SHARE, ZERO_SHARES = 0.3, (1.0, 0.3, 0.1)
"""Largest sigma of the zero offset of an uncalibrated magnetometer, as a part of the field; and its equally likely values as
factors of that. Iron and currents of a small satellite make some thousand nT."""

UNEVEN_ROTATION_SHARE = 0.2
"""Part of the field's rotation that is not linear in time over a pass, and remains noise."""

LARGEST_OWN_ERROR = 0.2
"""Upper limit of the error of a sensor's zero and matrix, as a part of the field, in a search by the directions of the field."""

UNREAD_FIELD = "no field direction: bridged by the dynamics and other sensors"
"""Why a sample without a field is not used, if the field replaces the Sun."""


@dataclass(frozen=True)
class FieldChange(Term):
    """Fields `field_B` (n, 3) at times `t_s` (n), s, of which each is compared with that of the previous sample.

    With the rotation matrix R of the body since the previous sample, the time dt between both, the rate of change of the field in
    body axes, and the errors e of the readings, the residual is

        R (field_before - e_before) + dt rate - (field - e).

    Attributes
    ----------
    field_B, sigma : fields in any unit, NaN where not read, and the noise of each component in that unit;
        infinite if the file states none: then no reading counts
    turn_rate : rad/s, rotation of the field in space in any direction in addition, which counts as noise
    zero_B : (z, 3), one sigma of each unknown of the zero offset
    matrix_sigma : one sigma of each of nine elements of the error matrix M; e = zero offset + M field
    drift_N : (n, d, 3), one sigma of each unknown of the rate of change of the field in N, per s
    zero_shares : equally likely sigmas of the zero offset, as factors of `zero_B`
    """

    name: ClassVar[str] = "field"
    label: ClassVar[str] = "magnetometer"
    per_sample: ClassVar[tuple[str, ...]] = ("t_s", "field_B", "drift_N")

    t_s: np.ndarray
    field_B: np.ndarray
    sigma: float
    turn_rate: float = FIELD_TURN
    zero_B: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    matrix_sigma: float = 0.0
    drift_N: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 3)))
    zero_shares: tuple[float, ...] = (1.0,)

    @classmethod
    def read(cls, vehicle: Vehicle, telemetry: xr.Dataset) -> Self | None:
        """Return the magnetometer of telemetry; None if it has none."""
        if VARIABLES["magnetometer"] not in telemetry:
            return None
        part = vehicle.sensors.magnetometer
        values = np.asarray(telemetry[VARIABLES["magnetometer"]], dtype=np.float64)
        t_s = np.asarray(telemetry["time"], dtype=np.float64)
        noise = part.noise if part is not None else None
        zero_B, matrix_sigma = np.zeros((0, 3)), 0.0
        if part is not None and part.zero_sigma.any():
            # if the zero offset is uncertain, the axes are not calibrated either
            zero_B, matrix_sigma = (part.matrix * zero_sigmas(part.zero_sigma)).T, MATRIX_SIGMA
        fields, no_drift = without_outliers(values), np.zeros((len(t_s), 0, 3))
        sigma = noise or np.inf
        return cls(t_s, fields, sigma, zero_B=zero_B, matrix_sigma=matrix_sigma, drift_N=no_drift)

    def with_any_zero(self) -> Self:
        """Return the fields of an uncalibrated sensor: its zero offset may have any of the sizes :data:`ZERO_SHARES`."""
        size = float(np.nanmedian(np.linalg.norm(self.field_B, axis=1)))
        zero_B = LARGEST_ZERO_SHARE * size * np.eye(3)
        return replace(self, zero_B=zero_B, matrix_sigma=MATRIX_SIGMA, zero_shares=ZERO_SHARES)

    def with_errors_of(self, fitted: Self) -> Self:
        """Return the fields with the errors of zero and matrix that are unknowns in a fitted model."""
        zero_B, matrix_sigma = fitted.zero_B, fitted.matrix_sigma
        shares = fitted.zero_shares
        return replace(self, zero_B=zero_B, matrix_sigma=matrix_sigma, zero_shares=shares)

    def with_own_zero(self) -> Self:
        """Return the fields less the zero offset that their strengths determine, and with the covariance of that offset.

        Only for a zero offset that the vehicle file states with a sigma. As the body rotates, the readings b stay on a sphere about
        the offset z, and its radius changes slowly. So |b|^2 - 2 b . z = |b - z|^2 - |z|^2 is a parabola in each window of time.
        With the parabolas projected out these equations are linear in z, and least squares give z.
        """
        if not self.zero_B.any():
            return self
        t_s, window = self.t_s, np.floor((self.t_s - self.t_s[0]) / PARABOLA_WINDOW_S)
        was_read = np.isfinite(self.field_B).all(axis=1)
        slopes, values = [], []
        for k in np.unique(window):
            inside = np.flatnonzero((window == k) & was_read)
            if len(inside) < FEWEST_IN_WINDOW:
                continue
            # orthonormal columns (i, 3) that span the parabolas of the window with i readings
            time = (t_s[inside] - t_s[inside].mean()) / PARABOLA_WINDOW_S
            parabola = np.linalg.qr(np.vander(time, 3))[0]
            # equations (i, 4): factors 2 b of z, then the value |b|^2; both without their parabolas
            fields = self.field_B[inside]
            rows = np.column_stack([2 * fields, (fields**2).sum(axis=1)])
            rows = rows - parabola @ (parabola.T @ rows)
            slopes.append(rows[:, :3])
            values.append(rows[:, 3])
        if not slopes:
            return self
        slope, value = np.concatenate(slopes), np.concatenate(values)
        prior = np.linalg.inv(self.zero_B.T @ self.zero_B)
        zero, keep = np.zeros(3), np.ones(len(value), dtype=bool)
        # in each round outliers are left out, and the size of the field is that with the new zero offset
        for _ in range(ZERO_ROUNDS):
            size = np.nanmedian(np.linalg.norm(self.field_B - zero, axis=1))
            scatter = np.mean((value - slope @ zero)[keep] ** 2)
            # the noise changes |b|^2 by 2 |b| times itself; errors by soft iron are equal in neighbouring readings
            variance = max(scatter, (2 * size * self.sigma) ** 2) * READINGS_WITH_SAME_ERROR
            precision = prior + slope[keep].T @ slope[keep] / variance
            zero = np.linalg.solve(precision, slope[keep].T @ value[keep] / variance)
            residual = np.abs(value - slope @ zero)
            keep = residual < OUTLIER_IN_MEDIANS * np.median(residual) + 1e-300
        covariance = np.linalg.inv(precision) + (MATRIX_SIGMA * size) ** 2 * np.eye(3)
        return replace(self, field_B=self.field_B - zero, zero_B=np.linalg.cholesky(covariance).T)

    def of_pass(self, t_s: np.ndarray) -> Self:
        """Return the fields of a pass: the rate of change of the field in N, linear in time, becomes six unknowns."""
        if not self.present().any():
            return self
        sigma = FIELD_TURN * np.nanmedian(np.linalg.norm(self.field_B, axis=1)) / np.sqrt(3)
        drift_N = drifting_vector(t_s, sigma, FIELD_TURN)
        return replace(self, drift_N=drift_N, turn_rate=UNEVEN_ROTATION_SHARE * FIELD_TURN)

    def present(self) -> np.ndarray:
        """Return which samples (n) are compared with the previous one: both have a reading."""
        read = np.isfinite(self.field_B).all(axis=1) & np.isfinite(self.sigma)
        return read & np.concatenate([[False], read[:-1]])

    def _inverse_sigma(self) -> np.ndarray:
        """Return one over the sigma (n) of the field's change since the previous sample, zero where nothing is compared."""
        size = np.linalg.norm(np.nan_to_num(self.field_B), axis=1)[:-1]
        by_rotation = size * self.turn_rate * np.diff(self.t_s)
        inverse = np.zeros(len(self.t_s))
        # noise of two readings, and rotation of the field in space
        inverse[1:] = 1 / np.sqrt(2 * self.sigma**2 + by_rotation**2)
        return np.where(self.present(), inverse, 0.0)

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the unknowns in their order: rate of change of the field, zero offset, elements of the error matrix by rows."""
        if not (self.present().any() and self.drift_N.shape[1]):  # in a search: no drift
            return ()
        drift, zero = np.linalg.norm(self.drift_N, axis=2), np.linalg.norm(self.zero_B, axis=1)
        # Kind, unit, sigmas of all unknowns of the kind, equally likely factors of these. That of a drift is its largest in time.
        kinds = (
            ("field_drift", "field s-1", drift.max(axis=0), (1.0,)),
            ("field_zero", "field", zero, self.zero_shares),
            ("field_matrix", "1", [self.matrix_sigma] * (9 if self.matrix_sigma else 0), (1.0,)),
        )
        return tuple(
            Unknown(f"{kind}_{i}", kind, unit, 0.0, float(sigma), i, shares=shares)
            for kind, unit, sigmas, shares in kinds
            for i, sigma in enumerate(sigmas)
        )

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the residual (K, n, 3) of the class docstring, in sigmas."""
        if not self.present().any():
            return
        inverse = self._inverse_sigma()[:, None]
        read = np.nan_to_num(self.field_B)
        # R (K, n, 3, 3) of the class docstring
        relative = states.attitude @ np.swapaxes(at_sample_before(states.attitude, axis=1), -1, -2)
        errors, by_u = np.zeros((len(u), *read.shape)), None
        drift = np.zeros_like(errors)
        if u.size:
            # derivatives of e (n, 3, z + 9) by zero offset and matrix: element (i, k) of M adds field_k to component i
            e_by_u = np.broadcast_to(self.zero_B.T, (len(read), 3, len(self.zero_B)))
            if self.matrix_sigma:
                elements = np.einsum("ij,nk->nijk", np.eye(3), read).reshape(-1, 3, 9)
                e_by_u = np.concatenate([e_by_u, self.matrix_sigma * elements], axis=-1)
            # derivatives of the field's change dt rate (K, n, 3, d), rotated to body axes
            dt = np.diff(self.t_s, prepend=self.t_s[0])[:, None, None]
            drift_by_u = np.einsum(
                "knij,nmj->knim", states.attitude, at_sample_before(self.drift_N) * dt
            )
            drift_count = drift_by_u.shape[-1]
            drift = np.einsum("knim,km->kni", drift_by_u, u[:, :drift_count])
            errors = np.einsum("nim,km->kni", e_by_u, u[:, drift_count:])
            by_u = np.concatenate(
                [drift_by_u, e_by_u - relative @ at_sample_before(e_by_u)], axis=-1
            )
            by_u = by_u * inverse[..., None]
        true_before = at_sample_before(read) - at_sample_before(errors, axis=1)
        expected = (relative @ true_before[..., None])[..., 0] + drift
        value = (expected - (read - errors)) * inverse
        # a turn t of the body moves a vector v of space by v x t in body axes
        by_turn = cross_matrix(expected) * inverse[..., None]
        by_previous = -relative @ cross_matrix(true_before) * inverse[..., None]
        yield Residual(value, by_turn, by_previous=by_previous, by_u=by_u, law=gaussian)

    def for_search(self) -> list[Self]:
        """Return the fields without unknowns; their errors are added to the noise, also the rotation of the field in space.

        Of several sizes of the zero offset the median counts: with an error of 0.3 of the field the readings would not help.
        """
        zero_B = self.zero_B * float(np.median(self.zero_shares))
        change = np.diff(self.field_B, axis=0, prepend=np.nan)[self.present()]
        sigma = self.sigma
        if len(change) and zero_B.any():
            # A zero offset z is fixed in the body. So it changes the comparison of two readings only along the change d of the
            # field, which is across the axis of rotation. Its variance is the mean of (z . d / |d|)^2, weighted by |d|^2. The error
            # matrix adds its part of a change.
            square = (change**2).sum()
            variance = ((change @ zero_B.T) ** 2).sum() / square
            variance += self.matrix_sigma**2 * square / len(change)
            sigma = float(np.hypot(sigma, np.sqrt(variance)))
        without_errors = replace(self, zero_B=zero_B[:0], zero_shares=(1.0,), matrix_sigma=0.0)
        no_drift = self.drift_N[:, :0]
        return [replace(without_errors, sigma=sigma, turn_rate=FIELD_TURN, drift_N=no_drift)]

    def loosened(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        """Return the fields with larger noise, for a motion whose attitude is off by `drift_rad` (n).

        The added noise is half of the largest such error times the largest field.
        """
        size = np.linalg.norm(np.nan_to_num(self.field_B), axis=1).max(initial=0.0)
        return replace(self, sigma=float(np.hypot(self.sigma, drift_rad.max() * size / 2)))


@dataclass(frozen=True)
class KnownField(Term):
    """Readings `read_B` (n, 3) in T, NaN where not read, of a field `field_N` (n, 3) that an orbit and a field model give, in T.

    The unknowns are e errors that all samples have in common: of the zero offset and matrix of the sensor and of the along-track
    offset, as far as the calibration leaves them open. One sigma of each changes the readings by `own_B` (n, e, 3) and the field by
    `along_N` (n, e, 3). `sigma_T` (n): all other errors of a component; `noise_T`: the noise among them.
    """

    name: ClassVar[str] = "field"
    label: ClassVar[str] = "magnetometer"
    about_sun: ClassVar[bool] = True
    per_sample: ClassVar[tuple[str, ...]] = tuple(
        "t_s read_B sigma_T field_N own_B along_N".split()
    )

    t_s: np.ndarray
    read_B: np.ndarray
    sigma_T: np.ndarray
    field_N: np.ndarray
    own_B: np.ndarray
    along_N: np.ndarray
    noise_T: float

    @classmethod
    def of(
        cls, fields: FieldChange, surroundings: Surroundings, calibration: FieldCalibration
    ) -> Self:
        """Return the readings with a calibration along the orbit, whose errors become those of the term."""
        field_N, along_N = surroundings.field_N, surroundings.field_along_N
        assert field_N is not None and along_N is not None
        uncalibrated = fields.field_B
        return cls(
            t_s=fields.t_s,
            read_B=calibration.field(uncalibrated),
            sigma_T=calibration.sigma_T(uncalibrated, field_N, along_N),
            field_N=field_N,
            own_B=calibration.reading_errors(uncalibrated),
            along_N=calibration.orbit_errors(along_N),
            noise_T=calibration.noise_T,
        )

    def present(self) -> np.ndarray:
        """Return which samples (n) have a reading."""
        return np.all(np.isfinite(self.read_B), axis=1)

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the errors that all samples have in common (see the class)."""
        if not self.present().any():
            return ()
        sizes = np.nan_to_num(np.linalg.norm(self.own_B, axis=2)).max(axis=0)
        return tuple(
            Unknown(f"magnetometer_{i}", "magnetometer", "T", 0.0, float(size), i)
            for i, size in enumerate(sizes)
        )

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the predicted field less the reading (K, n, 3), both with their common errors, in sigmas."""
        was_read = self.present()
        if not was_read.any():
            return
        inverse = np.where(was_read, 1 / self.sigma_T, 0.0)[:, None]
        field_B = np.einsum("knij,nj->kni", states.attitude, self.field_N)
        read, by_u = np.nan_to_num(self.read_B), None
        if u.size:
            # axes: motion k, sample n, component i, error e
            field_by_u = np.einsum("knij,nej->knie", states.attitude, self.along_N)
            read_by_u = np.swapaxes(np.nan_to_num(self.own_B), 1, 2)
            field_B = field_B + np.einsum("knie,ke->kni", field_by_u, u)
            read = read + np.einsum("nie,ke->kni", read_by_u, u)
            by_u = (field_by_u - read_by_u) * inverse[..., None]
        # a turn t of the body moves the field in body axes by field x t
        by_turn = cross_matrix(field_B) * inverse[..., None]
        yield Residual((field_B - read) * inverse, by_turn, by_u=by_u)

    def first_guess(self, states: States, about_sun: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return attitudes (K, n, 3, 3) rotated about the Sun direction so that the readings fit best, and unknowns of zero.

        A search by the Sun leaves this rotation open.
        """
        was_read = self.present()
        attitude, u = super().first_guess(states, about_sun)
        if about_sun or not was_read.any():
            return attitude, u
        read_N = np.einsum("knji,nj->kni", states.attitude[:, was_read], self.read_B[was_read])
        known, weight = self.field_N[was_read], 1 / self.sigma_T[was_read] ** 2
        # The angle about z, the Sun, takes the x and y components of the known fields to those of the readings. `sine` and `cosine`
        # are weighted sums of its sine and its cosine times both lengths.
        sine = ((known[:, 0] * read_N[..., 1] - known[:, 1] * read_N[..., 0]) * weight).sum(axis=1)
        cosine = ((known[:, :2] * read_N[..., :2]).sum(axis=2) * weight).sum(axis=1)
        about_z = rotate_attitude(np.eye(3), -np.arctan2(sine, cosine)[:, None] * SUN_N)
        return attitude @ about_z[:, None], u

    def for_search(self) -> list[Term]:
        """Return the comparison of neighbouring samples, as a search does not know the rotation about the Sun."""
        # An error that rotates all readings alike does not change the comparison: it is left out of the sigma.
        errors = _without_rotation(self.own_B, self.read_B)
        own_T = np.sqrt(np.nanmedian((errors**2).sum(axis=(1, 2))) / 3)
        sigma, no_unknowns = float(np.hypot(self.noise_T, own_T)), np.zeros((len(self.t_s), 0, 3))
        return [FieldChange(self.t_s, self.read_B, sigma, drift_N=no_unknowns)]

    def loosened(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        """Return the readings with larger errors, for a motion whose attitude is off by `drift_rad` (n)."""
        by_drift = drift_rad * np.linalg.norm(self.field_N, axis=1)
        return replace(self, sigma_T=np.hypot(self.sigma_T, by_drift))

    def without_errors(self) -> Self:
        """Return the readings without unknowns; the common errors of the sensor are added to the noise."""
        own = np.sqrt((self.own_B**2).sum(axis=(1, 2)) / 3)
        sigma = np.hypot(self.sigma_T, own)
        return replace(self, sigma_T=sigma, own_B=self.own_B[:, :0], along_N=self.along_N[:, :0])

    def as_sun_directions(self) -> SunDirections:
        """Return the directions of the field in body axes in place of those to the Sun, for a search without the Sun.

        Errors of the sensor that all samples have in common count as noise, up to `LARGEST_OWN_ERROR` of the field.
        """
        size = np.linalg.norm(self.field_N, axis=1)
        own = np.sqrt((self.own_B**2).sum(axis=(1, 2)) / 3)
        sigma = np.hypot(self.sigma_T, np.minimum(own, LARGEST_OWN_ERROR * size)) / size
        unit = self.read_B / np.linalg.norm(self.read_B, axis=1, keepdims=True)
        variance = np.where(self.present(), sigma**2, np.nan)
        return SunDirections.of(unit, variance[:, None, None] * np.eye(3))

    def field_axes(self) -> np.ndarray:
        """Return rotation matrices (n, 3, 3) from N to axes whose z is along the field at each sample.

        From one sample to the next these axes follow the field by the smallest rotation, which has no part about the field. A
        search without the Sun uses them in place of N. The first x axis is arbitrary.
        """
        unit = self.field_N / np.linalg.norm(self.field_N, axis=1, keepdims=True)
        axes_from_N = [facing(unit[0]).T]  # takes the field at the first sample to z
        for before, after in zip(unit, unit[1:], strict=False):
            # The smallest rotation R takes `after` to `before`. The matrix of the sample before takes that to z, so their product
            # takes `after` to z. Each row is a unit vector along an axis of N after R, so the transposed rows are R.
            rows = rotate_by_smallest(np.tile(after, (3, 1)), np.tile(before, (3, 1)), np.eye(3))
            axes_from_N.append(axes_from_N[-1] @ rows.T)
        return np.array(axes_from_N)

    def axes_rate_N(self) -> np.ndarray:
        """Return the angular velocities (n, 3) of the axes of :meth:`field_axes`, rad/s in N: unit x d(unit)/dt."""
        unit = self.field_N / np.linalg.norm(self.field_N, axis=1, keepdims=True)
        return np.cross(unit, np.gradient(unit, self.t_s, axis=0))


@dataclass(frozen=True)
class FieldDirection(SunDirections):
    """Directions of the field that replace those of the Sun, for a magnetometer alone and without an orbit.

    The direction of the field in space is unknown and rotates along the orbit, so the motion is estimated in axes N whose z follows
    the field. Their unknown rotation is an error of every rate (`axes_rad_s`).
    """

    name: ClassVar[str] = "field"
    label: ClassVar[str] = "magnetometer"
    axes_rad_s: ClassVar[float] = FIELD_TURN

    @classmethod
    def alone(cls, part: Magnetometer, telemetry: xr.Dataset) -> tuple[Self, np.ndarray]:
        """Return the directions of telemetry, and for each sample (n) in words whether it is used."""
        values = np.asarray(telemetry[VARIABLES["magnetometer"]], dtype=np.float64)
        fields = without_outliers(values)
        size = np.linalg.norm(fields, axis=1, keepdims=True)
        # columns: one sigma of the zero offset of each axis, in body axes
        zero = part.matrix * part.zero_sigma
        covariance = (part.noise or np.inf) ** 2 * np.eye(3) + zero @ zero.T
        directions = cls.of(fields / size, covariance / (size**2)[..., None])
        return directions, np.where(directions.present(), "used", UNREAD_FIELD).astype(object)


def reads_directions(vehicle: Vehicle, telemetry: xr.Dataset) -> bool:
    """Return whether a magnetometer's readings may be used as directions: the vehicle file states their noise."""
    part = vehicle.sensors.magnetometer
    return VARIABLES["magnetometer"] in telemetry and part is not None and bool(part.noise)


def without_outliers(fields: np.ndarray) -> np.ndarray:
    """Return fields (n, 3), with NaN for those far stronger than the median (`LARGEST_FIELD_FACTOR`)."""
    size = np.linalg.norm(np.nan_to_num(fields), axis=1)
    median = np.median(size[size > 0]) if np.any(size > 0) else 0.0
    return np.where((size <= LARGEST_FIELD_FACTOR * median)[:, None], fields, np.nan)


def _without_rotation(errors: np.ndarray, fields: np.ndarray) -> np.ndarray:
    """Return e errors (n, e, 3) of field readings without the part that looks like one small rotation of all readings.

    `fields` (n, 3): readings b in body axes, NaN if not read; these keep their errors. For each error the rotation vector r
    minimises the sum over samples of |error - r x b|^2: (sum of |b|^2 I - b b^T) r = sum of b x error. Then r x b is subtracted.
    """
    was_read = np.isfinite(fields).all(axis=1)
    field_B, error = fields[was_read], errors[was_read]
    matrix = (field_B**2).sum() * np.eye(3) - field_B.T @ field_B
    right_side = np.cross(field_B[:, None], error).sum(axis=0)  # (e, 3)
    # no rotation about the field if all readings are parallel
    rotation = right_side @ np.linalg.pinv(matrix, rcond=1e-6, hermitian=True)
    remaining = errors.copy()
    remaining[was_read] -= np.cross(rotation, field_B[:, None])
    return remaining
