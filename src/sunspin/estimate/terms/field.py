"""A magnetometer: its field compared between neighbours, in a known field, or as a direction in place of the Sun's.

Without an orbit the direction of the field in space is unknown, but it is nearly the same at two neighbouring samples. Along a pass
it turns the same way for minutes, by up to two turns an orbit. As noise from sample to sample that would average out, and the turn
about the Sun, which only the field determines, would be off by more than its sigma. So the field's change in N and the drift of
that are unknowns of a pass; what does not change evenly stays noise. In a known orbit only errors of the sensor are unknown.
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
from sunspin.estimate.terms.term import Residual, Term, at_sample_before, drifting, facing, gaussian
from sunspin.solve.rotations import cross_matrix, rotate_attitude, rotate_by_smallest
from sunspin.vehicle import Vehicle
from sunspin.vehicle.sensors import VARIABLES, Magnetometer, zero_sigmas

if TYPE_CHECKING:
    from sunspin.estimate.orbit.calibration import FieldCalibration

FIELD_FACTOR = 5.0
"""A field of more than this many times the usual size is a wrapped or broken reading: along an orbit it varies by three."""

WINDOW_S, FEWEST_IN_WINDOW, SAME_ERROR = 300.0, 8, 30
"""The strength of the field changes by a parabola in so many s of a low orbit; a window with fewer readings is not used; soft iron
gives so many neighbouring readings the same error, so that they count as one."""

ZERO_ROUNDS, ZERO_OUTLIER = 3, 6.0
"""Fits of a magnetometer's own zero, and the residual, over the median one, beyond which a reading is left out of the next."""

SOFT_IRON = 0.05
"""One sigma of each element of the matrix of a magnetometer that is not calibrated: iron that bends the field, axes off by three
degrees. With 0.03 a pass of three turns was decided 8 sigma off."""

LARGEST_ZERO, ZERO_SHARES = 0.3, (1.0, 0.3, 0.1)
"""Zero of a magnetometer that nobody has calibrated, as a part of the field: one sigma of the largest, and parts of it that are as
likely. Iron and currents of a small satellite make some thousand nT."""

LEFT = 0.2
"""Part of the field's turning that does not change evenly over a pass, and stays noise."""

MOST_OFF = 0.2
"""Error of a sensor's zero and matrix, as a part of the field, beyond which a search takes its directions for no worse."""

UNREAD_FIELD = "no field direction: bridged by the dynamics and other sensors"
"""What becomes of a sample without a field, if the field stands for the Sun."""


@dataclass(frozen=True)
class FieldChange(Term):
    """Fields (n, 3) at times `t_s` (n), NaN where not read, with one `sigma`, in any unit: neighbours are compared.

    R is the turn of the body since the sample before, dt the time between both, e the error of a reading. Compared are

        R (field_before - e_before) + dt drift    and    field - e.

    `drift_N` (n, d, 3): one sigma of each unknown of the field's change in N, per s; `turn_rate` (rad/s): what the field turns any
    way in addition, as noise. The error e is that of the zero, `zero_B` (z, 3) being one sigma of each of its unknowns, and that of
    nine elements of the sensor's matrix, `matrix_sigma` each.
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
        part = vehicle.sensors.with_columns.get("magnetometer")
        values = np.asarray(telemetry[VARIABLES["magnetometer"]], dtype=np.float64)
        t_s = np.asarray(telemetry["time"], dtype=np.float64)
        noise = part.noise if part is not None else None
        stated = part is not None and bool(part.zero_sigma.any())
        zero_B = np.zeros((0, 3))
        if part is not None and stated:
            zero_B = (part.matrix * zero_sigmas(part.zero_sigma)).T
        return cls(
            t_s,
            without_outliers(values),
            noise or np.inf,
            zero_B=zero_B,
            # who does not know the zero has not calibrated the axes
            matrix_sigma=SOFT_IRON if stated else 0.0,
            drift_N=np.zeros((len(t_s), 0, 3)),
        )

    def with_any_zero(self) -> Self:
        """Return the fields of a sensor that nobody has calibrated: its zero may have any of the sizes :data:`ZERO_SHARES`."""
        size = float(np.nanmedian(np.linalg.norm(self.field_B, axis=1)))
        return replace(
            self,
            zero_B=LARGEST_ZERO * size * np.eye(3),
            matrix_sigma=SOFT_IRON,
            zero_shares=ZERO_SHARES,
        )

    def with_errors_of(self, fitted: Self) -> Self:
        """Return the fields with the unknowns of zero and matrix that they have in a fitted model."""
        return replace(
            self,
            zero_B=fitted.zero_B,
            matrix_sigma=fitted.matrix_sigma,
            zero_shares=fitted.zero_shares,
        )

    def with_own_zero(self) -> Self:
        """Return the fields less the zero that their strengths show, and with its errors.

        As a body turns, readings b stay on a sphere about the zero z, whose radius changes slowly: |b|^2 - 2 b . z is |b - z|^2 -
        |z|^2, in each window of time a parabola. With the parabolas projected out that is linear in z. Only for a zero that the
        vehicle file states with a sigma.
        """
        if not self.zero_B.any():
            return self
        t_s, window = self.t_s, np.floor((self.t_s - self.t_s[0]) / WINDOW_S)
        read = np.isfinite(self.field_B).all(axis=1)
        slopes, values = [], []
        for k in np.unique(window):
            inside = np.flatnonzero((window == k) & read)
            if len(inside) < FEWEST_IN_WINDOW:
                continue
            # orthonormal columns that span the parabolas of the window
            time = (t_s[inside] - t_s[inside].mean()) / WINDOW_S
            parabola = np.linalg.qr(np.vander(time, 3))[0]
            # columns 0 to 2: slope 2 b of the condition by the zero; column 3: its value |b|^2
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
        for _ in range(ZERO_ROUNDS):  # outliers leave, and the size of the field follows the zero
            size = np.nanmedian(np.linalg.norm(self.field_B - zero, axis=1))
            scatter = np.mean((value - slope @ zero)[keep] ** 2)
            # a square is off by twice the field times the noise; the soft iron's errors are alike in neighbours
            variance = max(scatter, (2 * size * self.sigma) ** 2) * SAME_ERROR
            precision = prior + slope[keep].T @ slope[keep] / variance
            zero = np.linalg.solve(precision, slope[keep].T @ value[keep] / variance)
            off = np.abs(value - slope @ zero)
            keep = off < ZERO_OUTLIER * np.median(off) + 1e-300
        covariance = np.linalg.inv(precision) + (SOFT_IRON * size) ** 2 * np.eye(3)
        return replace(self, field_B=self.field_B - zero, zero_B=np.linalg.cholesky(covariance).T)

    def of_pass(self, t_s: np.ndarray) -> Self:
        """Return the fields with an even drift in N, and the drift of that, as unknowns."""
        if not self.present().any():
            return self
        sigma = FIELD_TURN * np.nanmedian(np.linalg.norm(self.field_B, axis=1)) / np.sqrt(3)
        return replace(self, drift_N=drifting(t_s, sigma, FIELD_TURN), turn_rate=LEFT * FIELD_TURN)

    def present(self) -> np.ndarray:
        """Return which samples (n) are compared with the one before: both have a reading."""
        read = np.isfinite(self.field_B).all(axis=1) & np.isfinite(self.sigma)
        return read & np.concatenate([[False], read[:-1]])

    def _inverse_sigma(self) -> np.ndarray:
        """Return one over the sigma (n) of the field's change since the sample before, zero where nothing is compared."""
        size = np.linalg.norm(np.nan_to_num(self.field_B), axis=1)[:-1]
        turned = size * self.turn_rate * np.diff(self.t_s)
        inverse = np.zeros(len(self.t_s))
        inverse[1:] = 1 / np.sqrt(2 * self.sigma**2 + turned**2)
        return np.where(self.present(), inverse, 0.0)

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return drift and change of the drift, the zero, and the nine elements of the sensor's matrix by rows."""
        if not (self.present().any() and self.drift_N.shape[1]):
            return ()
        sigmas = {
            "field_drift": ("field s-1", np.linalg.norm(self.drift_N, axis=2).max(axis=0)),
            "field_zero": ("field", np.linalg.norm(self.zero_B, axis=1)),
            "field_matrix": ("1", [self.matrix_sigma] * (9 if self.matrix_sigma else 0)),
        }
        shares = {"field_zero": self.zero_shares}
        return tuple(
            Unknown(
                f"{kind}_{i}", kind, unit, 0.0, float(sigma), i, shares=shares.get(kind, (1.0,))
            )
            for kind, (unit, of_kind) in sigmas.items()
            for i, sigma in enumerate(of_kind)
        )

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the comparison (K, n, 3) of each field with the one before it, as the class has it, in sigmas."""
        was_read = self.present()
        if not was_read.any():
            return
        inverse = self._inverse_sigma()[:, None]
        read = np.nan_to_num(self.field_B)
        relative = states.attitude @ np.swapaxes(at_sample_before(states.attitude, axis=1), -1, -2)
        errors, by_u = np.zeros((len(u), *read.shape)), None
        drift = np.zeros_like(errors)
        if u.size:
            # what one sigma of each unknown adds to a reading (n, 3, z + 9): zero, and elements of the matrix by rows
            by_error = np.broadcast_to(self.zero_B.T, (len(read), 3, len(self.zero_B)))
            if self.matrix_sigma:
                rows = np.einsum("ij,nk->nijk", np.eye(3), read).reshape(-1, 3, 9)
                by_error = np.concatenate([by_error, self.matrix_sigma * rows], axis=-1)
            # and to the field (K, n, 3, d) since the sample before
            dt = np.diff(self.t_s, prepend=self.t_s[0])[:, None, None]
            by_drift = np.einsum(
                "knij,nmj->knim", states.attitude, at_sample_before(self.drift_N) * dt
            )
            of_drift = slice(0, by_drift.shape[-1])
            of_errors = slice(of_drift.stop, None)
            drift = np.einsum("knim,km->kni", by_drift, u[:, of_drift])
            errors = np.einsum("nim,km->kni", by_error, u[:, of_errors])
            by_u = np.concatenate(
                [by_drift, by_error - relative @ at_sample_before(by_error)], axis=-1
            )
            by_u = by_u * inverse[..., None]
        true_before = at_sample_before(read) - at_sample_before(errors, axis=1)
        expected = (relative @ true_before[..., None])[..., 0] + drift
        value = (expected - (read - errors)) * inverse
        # a turn t moves a vector v of space by v x t
        by_turn = cross_matrix(expected) * inverse[..., None]
        by_previous = -relative @ cross_matrix(true_before) * inverse[..., None]
        yield Residual(value, by_turn, by_previous=by_previous, by_u=by_u, law=gaussian)

    def for_search(self) -> list[Self]:
        """Return the fields without unknowns, whose errors are added to the noise, in a field that turns any way.

        Of the sizes of a zero the middle one counts: with an error of 0.3 of the field the readings would say next to nothing.
        """
        zero_B = self.zero_B * float(np.median(self.zero_shares))
        was_read = self.present()
        change = np.diff(self.field_B, axis=0, prepend=np.nan)[was_read]
        sigma = self.sigma
        if len(change) and zero_B.any():
            # The search compares neighbouring readings. A zero z that is subtracted from both turns with the body, so that it
            # changes their difference only along the changes d of the field, which lie across the axis of the turn. So its variance
            # is the mean of (z d / |d|)^2, weighed by d^2. The matrix adds its share of a change.
            square = (change**2).sum()
            variance = ((change @ zero_B.T) ** 2).sum() / square
            variance += self.matrix_sigma**2 * square / len(change)
            sigma = float(np.hypot(sigma, np.sqrt(variance)))
        return [
            replace(
                self,
                sigma=sigma,
                turn_rate=FIELD_TURN,
                zero_B=self.zero_B[:0],
                zero_shares=(1.0,),
                matrix_sigma=0.0,
                drift_N=self.drift_N[:, :0],
            )
        ]

    def loosened(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        """Return the fields with what drifts (n) of a start, in rad, turn the largest field added to their errors."""
        size = np.linalg.norm(np.nan_to_num(self.field_B), axis=1).max(initial=0.0)
        return replace(self, sigma=float(np.hypot(self.sigma, drift_rad.max() * size / 2)))


@dataclass(frozen=True)
class KnownField(Term):
    """Readings `read_B` (n, 3) in T, NaN where none, `sigma_T` (n) of each component, and the field there `field_N` (n, 3).

    There are e errors that all samples have in common: of the sensor's zero and matrix and of the place along the track, as the
    calibration has left them. One sigma of each changes a reading by `own_B` (n, e, 3), and the field there by `along_N` (n, e, 3).
    `noise_T`: of a component.
    """

    name: ClassVar[str] = "field"
    label: ClassVar[str] = "magnetometer"
    about_sun: ClassVar[bool] = True
    per_sample: ClassVar[tuple[str, ...]] = (
        "t_s",
        "read_B",
        "sigma_T",
        "field_N",
        "own_B",
        "along_N",
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
        """Return readings calibrated along an orbit; their errors are those of the calibration."""
        field_N, along_N = surroundings.field_N, surroundings.field_along_N
        assert field_N is not None and along_N is not None
        read = fields.field_B
        return cls(
            t_s=fields.t_s,
            read_B=calibration.field(read),
            sigma_T=calibration.sigma_T(read, field_N, along_N),
            field_N=field_N,
            own_B=calibration.reading_errors(read),
            along_N=calibration.orbit_errors(along_N),
            noise_T=calibration.noise_T,
        )

    def present(self) -> np.ndarray:
        """Return which samples (n) have a reading."""
        return np.all(np.isfinite(self.read_B), axis=1)

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the errors of the calibration."""
        if not self.present().any():
            return ()
        sizes = np.nan_to_num(np.linalg.norm(self.own_B, axis=2)).max(axis=0)
        return tuple(
            Unknown(f"magnetometer_{i}", "magnetometer", "T", 0.0, float(size), i)
            for i, size in enumerate(sizes)
        )

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the known field less the reading (K, n, 3), both with the errors in common, in sigmas."""
        was_read = self.present()
        if not was_read.any():
            return
        inverse = np.where(was_read, 1 / self.sigma_T, 0.0)[:, None]
        field_B = np.einsum("knij,nj->kni", states.attitude, self.field_N)
        read, by_u = np.nan_to_num(self.read_B), None
        if u.size:
            # axes: candidate k, sample n, component i, error e
            by_place = np.einsum("knij,nej->knie", states.attitude, self.along_N)
            by_sensor = np.swapaxes(np.nan_to_num(self.own_B), 1, 2)
            field_B = field_B + np.einsum("knie,ke->kni", by_place, u)
            read = read + np.einsum("nie,ke->kni", by_sensor, u)
            by_u = (by_place - by_sensor) * inverse[..., None]
        by_turn = cross_matrix(field_B) * inverse[..., None]
        yield Residual((field_B - read) * inverse, by_turn, by_u=by_u)

    def begin(self, states: States, about_sun: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return attitudes (K, n, 3, 3) turned about the Sun so that the readings fit best, as a search knows the Sun alone."""
        was_read = self.present()
        attitude, u = super().begin(states, about_sun)
        if about_sun or not was_read.any():
            return attitude, u
        read_N = np.einsum("knji,nj->kni", states.attitude[:, was_read], self.read_B[was_read])
        known, weight = self.field_N[was_read], 1 / self.sigma_T[was_read] ** 2
        # the angle about z, the Sun, that takes the components across z of the known fields to those of the readings: weighted
        # sums of |known| |read| times its sine and its cosine
        sine = ((known[:, 0] * read_N[..., 1] - known[:, 1] * read_N[..., 0]) * weight).sum(axis=1)
        cosine = ((known[:, :2] * read_N[..., :2]).sum(axis=2) * weight).sum(axis=1)
        about_z = rotate_attitude(np.eye(3), -np.arctan2(sine, cosine)[:, None] * SUN_N)
        return attitude @ about_z[:, None], u

    def for_search(self) -> list[Term]:
        """Return the comparison of neighbours: a search does not know the turn about the Sun."""
        # An error of the axes turns all readings alike, which no comparison of neighbours shows: it is left out of the sigma.
        left = _without_rotation(self.own_B, self.read_B)
        own_T = np.sqrt(np.nanmedian((left**2).sum(axis=(1, 2))) / 3)
        sigma, none = float(np.hypot(self.noise_T, own_T)), np.zeros((len(self.t_s), 0, 3))
        return [FieldChange(self.t_s, self.read_B, sigma, drift_N=none)]

    def without_errors(self) -> Self:
        """Return the readings without unknowns, whose errors are added to the noise."""
        own = np.sqrt((self.own_B**2).sum(axis=(1, 2)) / 3)
        sigma = np.hypot(self.sigma_T, own)
        return replace(self, sigma_T=sigma, own_B=self.own_B[:, :0], along_N=self.along_N[:, :0])

    def directions(self) -> SunDirections:
        """Return the directions of the field in the body as if they were the Sun's, for a search where no Sun is seen."""
        size = np.linalg.norm(self.field_N, axis=1)
        own = np.sqrt((self.own_B**2).sum(axis=(1, 2)) / 3)
        sigma = np.hypot(self.sigma_T, np.minimum(own, MOST_OFF * size)) / size
        unit = self.read_B / np.linalg.norm(self.read_B, axis=1, keepdims=True)
        variance = np.where(self.present(), sigma**2, np.nan)
        return SunDirections.of(unit, variance[:, None, None] * np.eye(3))

    def frames(self) -> np.ndarray:
        """Return matrices (n, 3, 3) from N to axes with z along the field, without a turn about the field from one to the next."""
        unit = self.field_N / np.linalg.norm(self.field_N, axis=1, keepdims=True)
        frames = [facing(unit[0]).T]
        for before, after in zip(unit, unit[1:], strict=False):
            # the smallest rotation that takes the new direction to the old one, column by column
            back = rotate_by_smallest(np.tile(after, (3, 1)), np.tile(before, (3, 1)), np.eye(3)).T
            frames.append(frames[-1] @ back)
        return np.array(frames)

    def turning(self) -> np.ndarray:
        """Return the rates (n, 3) in rad/s, in N, at which the axes of :meth:`frames` turn: unit x d(unit)/dt."""
        unit = self.field_N / np.linalg.norm(self.field_N, axis=1, keepdims=True)
        return np.cross(unit, np.gradient(unit, self.t_s, axis=0))


@dataclass(frozen=True)
class FieldDirection(SunDirections):
    """Directions of the field (n, 3) with covariances (n, 3, 3), used as those of the Sun: a magnetometer alone, without an orbit.

    The direction of the field in space is not known and turns along the orbit, so the motion is found in axes that follow it. How
    fast they turn is not known, and is an error of every rate. The turn about the field is seen only through the motion.
    """

    name: ClassVar[str] = "field"
    label: ClassVar[str] = "magnetometer"
    axes_rad_s: ClassVar[float] = FIELD_TURN

    @classmethod
    def alone(cls, part: Magnetometer, telemetry: xr.Dataset) -> tuple[Self, np.ndarray]:
        """Return the directions of telemetry, and what became of each sample (n), in words."""
        values = np.asarray(telemetry[VARIABLES["magnetometer"]], dtype=np.float64)
        read = without_outliers(values)
        size = np.linalg.norm(read, axis=1, keepdims=True)
        zero = part.matrix * part.zero_sigma
        covariance = (part.noise or np.inf) ** 2 * np.eye(3) + zero @ zero.T
        directions = cls.of(read / size, covariance / (size**2)[..., None])
        return directions, np.where(directions.present(), "used", UNREAD_FIELD).astype(object)


def reads_directions(vehicle: Vehicle, telemetry: xr.Dataset) -> bool:
    """Return whether a magnetometer's readings may be used as directions: the vehicle file states their noise."""
    part = vehicle.sensors.magnetometer
    return VARIABLES["magnetometer"] in telemetry and part is not None and bool(part.noise)


def without_outliers(fields: np.ndarray) -> np.ndarray:
    """Return fields (n, 3), NaN where they are far beyond the usual size, which the Earth's field cannot reach."""
    size = np.linalg.norm(np.nan_to_num(fields), axis=1)
    usual = np.median(size[size > 0]) if np.any(size > 0) else 0.0
    return np.where((size <= FIELD_FACTOR * usual)[:, None], fields, np.nan)


def _without_rotation(errors: np.ndarray, fields: np.ndarray) -> np.ndarray:
    """Return errors (n, e, 3) of fields b (n, 3) less their part r x b, with one rotation r for all samples.

    Least squares for each error: (sum of |b|^2 - b b^T) r = sum of b x error.
    """
    read = np.isfinite(fields).all(axis=1)
    field_B, error = fields[read], errors[read]
    normal = (field_B**2).sum() * np.eye(3) - field_B.T @ field_B
    moment = np.cross(field_B[:, None], error).sum(axis=0)
    rotation = moment @ np.linalg.pinv(normal, rcond=1e-6, hermitian=True)
    left = errors.copy()
    left[read] -= np.cross(rotation, field_B[:, None])
    return left
