"""A magnetometer: its field compared between neighbours, in a known field, or as a direction in place of the Sun's.

Without an orbit the direction of the field in space is unknown, but it is nearly the same at two neighbouring samples. Along a pass
it turns the same way for minutes, by up to two turns an orbit. As noise from sample to sample that would average out, and the turn
about the Sun, which only the field determines, would be off by more than its sigma. So the field's change in N and the drift of
that are unknowns of a pass; what does not change evenly stays noise. In a known orbit only errors of the sensor are unknown.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import ClassVar, Protocol, Self

import numpy as np
import xarray as xr

from sunspin.environment import Surroundings
from sunspin.estimation.model import States, Unknown
from sunspin.estimation.settings import FIELD_TURN
from sunspin.estimation.terms.directions import SunDirections
from sunspin.estimation.terms.term import Residual, Term, drifting, facing, gaussian
from sunspin.solve.rotations import cross_matrix, rotate_by_smallest
from sunspin.vehicle import Vehicle
from sunspin.vehicle.sensors import VARIABLES, Magnetometer

FIELD_FACTOR = 5.0
"""A field of more than this many times the usual size is a wrapped or broken reading: along an orbit it varies by three."""

WINDOW_S, FEWEST_IN_WINDOW, ALIKE = 300.0, 8, 30
"""The strength of the field changes by a parabola in so many s of a low orbit; a window with fewer readings is not used; soft iron
makes the errors of so many neighbouring readings one."""

SOFT_IRON = 0.05
"""One sigma of each element of the matrix of a magnetometer that is not calibrated: iron that bends the field, axes off by three
degrees. With 0.03 a pass of three turns was decided 8 sigma off."""

LEFT = 0.2
"""Part of the field's turning that does not change evenly over a pass, and stays noise."""

MOST_OFF = 0.2
"""Error of a sensor's zero and matrix, as a part of the field, beyond which a search takes its directions for no worse."""

UNREAD_FIELD = "no field direction: bridged by the dynamics and other sensors"
"""What becomes of a sample without a field, if the field stands for the Sun."""


class FieldCalibration(Protocol):
    """What a magnetometer reads in a known orbit, with e errors in common; readings (n, 3), fields in T."""

    @property
    def noise_T(self) -> float:
        """Return one sigma of a component of a reading."""

    def field(self, reading: np.ndarray) -> np.ndarray:
        """Return the fields (n, 3) of readings."""

    def columns(self, reading: np.ndarray) -> np.ndarray:
        """Return what one sigma of each error changes in the fields (n, e, 3) of readings."""

    def along(self, field_along_N: np.ndarray) -> np.ndarray:
        """Return what one sigma of each error changes in the orbit's field (n, e, 3), of which one along the track is (n, 3)."""

    def sigma_T(
        self, reading: np.ndarray, field_N: np.ndarray, field_along_N: np.ndarray
    ) -> np.ndarray:
        """Return one sigma (n) of each component of readings where the field is `field_N` (n, 3)."""


@dataclass(frozen=True)
class FieldChange(Term):
    """Fields (n, 3) at times `t_s` (n), NaN where not read, with one `sigma`, in any unit: neighbours are compared.

    `turn_rate` (rad/s): what the field turns any way in addition to its drift, of which `drift_N` (n, d, 3) is one sigma of each
    unknown; `zero_B` (z, 3): one sigma of each error of the zero; `matrix_sigma`: of each element of the matrix of the sensor.
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
        zero = (part.matrix * part.zero_sigma).T if part is not None and stated else None
        return cls(
            t_s,
            without_outliers(values),
            noise or np.inf,
            zero_B=np.zeros((0, 3)) if zero is None else zero,
            # who does not know the zero has not calibrated the axes
            matrix_sigma=SOFT_IRON if stated else 0.0,
            drift_N=np.zeros((len(t_s), 0, 3)),
        )

    def with_own_zero(self) -> Self:
        """Return the fields less the zero that their strengths show, and with its errors.

        As a body turns, readings stay on a sphere about the zero, whose radius changes slowly: in each window of time the squares
        of the readings less twice their product with the zero are a parabola. Only for a zero that the vehicle file states with a
        sigma.
        """
        if not self.zero_B.any():
            return self
        t_s, window = self.t_s, np.floor((self.t_s - self.t_s[0]) / WINDOW_S)
        read = np.isfinite(self.field_B).all(axis=1)
        slopes, values = [], []
        for k in np.unique(window):
            here = np.flatnonzero((window == k) & read)
            if len(here) < FEWEST_IN_WINDOW:
                continue
            parabola = np.linalg.qr(np.vander((t_s[here] - t_s[here].mean()) / WINDOW_S, 3))[0]
            rows = np.column_stack([2 * self.field_B[here], (self.field_B[here] ** 2).sum(axis=1)])
            rows = rows - parabola @ (parabola.T @ rows)
            slopes.append(rows[:, :3])
            values.append(rows[:, 3])
        if not slopes:
            return self
        slope, value = np.concatenate(slopes), np.concatenate(values)
        prior = np.linalg.inv(self.zero_B.T @ self.zero_B)
        zero, keep = np.zeros(3), np.ones(len(value), dtype=bool)
        for _ in range(3):  # outliers leave, and the size of the field follows the zero
            size = np.nanmedian(np.linalg.norm(self.field_B - zero, axis=1))
            scatter = np.mean((value - slope @ zero)[keep] ** 2)
            variance = max(scatter, (2 * size * self.sigma) ** 2) * ALIKE
            precision = prior + slope[keep].T @ slope[keep] / variance
            zero = np.linalg.solve(precision, slope[keep].T @ value[keep] / variance)
            off = np.abs(value - slope @ zero)
            keep = off < 6 * np.median(off) + 1e-300
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
        """Return drift and change of the drift, the zero, and the matrix of the sensor."""
        if not (self.present().any() and self.drift_N.shape[1]):
            return ()
        sizes = np.linalg.norm(self.drift_N, axis=2).max(axis=0)
        drift = [
            Unknown(f"field_drift_{i}", "field_drift", "field s-1", 0.0, float(size), i)
            for i, size in enumerate(sizes)
        ]
        zero = [
            Unknown(f"field_zero_{i}", "field_zero", "field", 0.0, float(size), i)
            for i, size in enumerate(np.linalg.norm(self.zero_B, axis=1))
        ]
        matrix = [
            Unknown(f"field_matrix_{i}", "field_matrix", "1", 0.0, self.matrix_sigma, i)
            for i in range(9 if self.matrix_sigma else 0)
        ]
        return (*drift, *zero, *matrix)

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the field of the sample before, carried by the turn of the body, and the errors in common, less the reading."""
        there = self.present()
        if not there.any():
            return
        inverse = self._inverse_sigma()[:, None]
        read = np.nan_to_num(self.field_B)
        before = np.concatenate([read[:1], read[:-1]])
        previous = np.concatenate([states.attitude[:, :1], states.attitude[:, :-1]], axis=1)
        relative = states.attitude @ np.swapaxes(previous, -1, -2)
        errors, by_u = np.zeros((len(u), *read.shape)), None
        drift = np.zeros_like(errors)
        if u.size:
            # one sigma of each error of the sensor: zero, and elements of the matrix row by row
            own = np.broadcast_to(self.zero_B.T, (len(read), 3, len(self.zero_B)))
            if self.matrix_sigma:
                rows = np.einsum("ij,nk->nijk", np.eye(3), read).reshape(-1, 3, 9)
                own = np.concatenate([own, self.matrix_sigma * rows], axis=-1)
            dt = np.diff(self.t_s, prepend=self.t_s[0])[:, None, None]
            by_drift = np.concatenate([self.drift_N[:1], self.drift_N[:-1]]) * dt
            by_drift = np.einsum("knij,nmj->knim", states.attitude, by_drift)
            of_drift = slice(0, by_drift.shape[-1])
            drift = np.einsum("knim,km->kni", by_drift, u[:, of_drift])
            errors = np.einsum("nim,km->kni", own, u[:, of_drift.stop :])
            # what a sensor reads too much stays where it is while the field is carried on
            before_own = np.concatenate([own[:1], own[:-1]])
            by_u = np.concatenate([by_drift, own - relative @ before_own], axis=-1)
            by_u = by_u * inverse[..., None]
        start = before - np.concatenate([errors[:, :1], errors[:, :-1]], axis=1)
        carried = (relative @ start[..., None])[..., 0] + drift
        value = (carried - read + errors) * inverse
        # a turn t moves a vector v of space by v x t
        by_turn = cross_matrix(carried) * inverse[..., None]
        by_previous = -relative @ cross_matrix(start) * inverse[..., None]
        yield Residual(value, by_turn, by_previous=by_previous, by_u=by_u, law=gaussian)

    def for_search(self) -> list[Self]:
        """Return the fields as uncertain as the errors in common make neighbours, in a field that turns any way."""
        there = self.present()
        change = np.diff(self.field_B, axis=0, prepend=np.nan)[there]
        sigma = self.sigma
        if len(change) and self.zero_B.any():
            # along the axis of a spin a zero moves no neighbour against the other: as the field's change weighs it
            square = (change**2).sum()
            moved = ((change @ self.zero_B.T) ** 2).sum() / square
            moved += self.matrix_sigma**2 * square / len(change)
            sigma = float(np.hypot(sigma, np.sqrt(moved)))
        return [
            replace(
                self,
                sigma=sigma,
                turn_rate=FIELD_TURN,
                zero_B=self.zero_B[:0],
                matrix_sigma=0.0,
                drift_N=self.drift_N[:, :0],
            )
        ]

    def loosened(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        """Return the fields with what a drift of the start turns them."""
        size = np.linalg.norm(np.nan_to_num(self.field_B), axis=1).max(initial=0.0)
        return replace(self, sigma=float(np.hypot(self.sigma, drift_rad.max() * size / 2)))

    def without(self, sample: int) -> tuple[Self, float]:
        """Return the fields without one, and the log density of its comparisons if its direction were any.

        That is the mean of the law over the sphere to which the field before can be carried.
        """
        there = np.flatnonzero(self.present())
        lost = there[(there == sample) | (there == sample + 1)]
        start, end = (np.linalg.norm(self.field_B[lost - back], axis=1) for back in (1, 0))
        precision = self._inverse_sigma()[lost] ** 2
        both = start * end * precision
        log = np.log(-np.expm1(-2 * both) / (2 * both)) - (start - end) ** 2 * precision / 2
        fields = self.field_B.copy()
        fields[sample] = np.nan
        return replace(self, field_B=fields), float(log.sum())


@dataclass(frozen=True)
class KnownField(Term):
    """Readings `read_B` (n, 3) in T, NaN where none, `sigma_T` (n) of each component, and the field there `field_N` (n, 3).

    `own_B`, `along_N` (n, e, 3): what one sigma of each of e errors changes in both. They are errors of the sensor's zero and
    matrix and, with them, of the place along the track, which moves the field of all samples together. `noise_T`: of a component.
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
    def of(cls, fields: FieldChange, here: Surroundings, one: FieldCalibration) -> Self:
        """Return readings calibrated along an orbit; noise and the zero's error are then those of the calibration."""
        field_N, along_N = here.field_N, here.field_along_N
        assert field_N is not None and along_N is not None
        read = fields.field_B
        return cls(
            fields.t_s,
            one.field(read),
            one.sigma_T(read, field_N, along_N),
            field_N,
            one.columns(read),
            one.along(along_N),
            one.noise_T,
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
        """Yield the known field less the reading, both with the errors in common."""
        there = self.present()
        if not there.any():
            return
        inverse = np.where(there, 1 / self.sigma_T, 0.0)[:, None]
        field_B = np.einsum("knij,nj->kni", states.attitude, self.field_N)
        read, by_u = np.nan_to_num(self.read_B), None
        if u.size:
            along = np.einsum("knij,nej->knie", states.attitude, self.along_N)
            own = np.swapaxes(np.nan_to_num(self.own_B), 1, 2)
            field_B = field_B + np.einsum("knie,ke->kni", along, u)
            read = read + np.einsum("nie,ke->kni", own, u)
            by_u = (along - own) * inverse[..., None]
        by_turn = cross_matrix(field_B) * inverse[..., None]
        yield Residual((field_B - read) * inverse, by_turn, by_u=by_u)

    def begin(self, states: States, about_sun: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return attitudes (K, n, 3, 3) turned about the Sun so that the readings fit best, as a search knows the Sun alone."""
        there = self.present()
        attitude, u = super().begin(states, about_sun)
        if about_sun or not there.any():
            return attitude, u
        read_N = np.einsum("knji,nj->kni", states.attitude[:, there], self.read_B[there])
        known, weight = self.field_N[there], 1 / self.sigma_T[there] ** 2
        # N is turned by the angle about z that carries the known field to the one read, as far as both lie across z
        sine = ((known[:, 0] * read_N[..., 1] - known[:, 1] * read_N[..., 0]) * weight).sum(axis=1)
        cosine = ((known[:, :2] * read_N[..., :2]).sum(axis=2) * weight).sum(axis=1)
        angle = np.arctan2(sine, cosine)
        about = np.zeros((len(angle), 3, 3))
        about[:, 0, 0] = about[:, 1, 1] = np.cos(angle)
        about[:, 1, 0], about[:, 0, 1] = np.sin(angle), -np.sin(angle)
        about[:, 2, 2] = 1.0
        return attitude @ about[:, None], u

    def for_search(self) -> list[Term]:
        """Return the comparison of neighbours: a search does not know the turn about the Sun."""
        # a zero turns with the body, so neighbours differ by its error; axes that are turned turn all readings alike
        own = np.sqrt(
            np.nanmedian((_not_turned(self.own_B, self.read_B) ** 2).sum(axis=(1, 2))) / 3
        )
        none = np.zeros((len(self.t_s), 0, 3))
        return [
            FieldChange(self.t_s, self.read_B, float(np.hypot(self.noise_T, own)), drift_N=none)
        ]

    def without_errors(self) -> Self:
        """Return the readings without errors in common, as uncertain as these make them."""
        own = np.sqrt((self.own_B**2).sum(axis=(1, 2)) / 3)
        sigma = np.hypot(self.sigma_T, own)
        return replace(self, sigma_T=sigma, own_B=self.own_B[:, :0], along_N=self.along_N[:, :0])

    def without(self, sample: int) -> tuple[Self, float]:
        """Return the readings without one, and its log density: a direction to a sigma fills that part of the sphere."""
        share = self.sigma_T[sample] ** 2 / (2 * (self.field_N[sample] ** 2).sum())
        read = self.read_B.copy()
        read[sample] = np.nan
        return replace(self, read_B=read), float(min(np.log(share), 0.0))

    def directions(self) -> SunDirections:
        """Return the directions of the field in the body as if they were the Sun's, for a search where no Sun is seen."""
        size = np.linalg.norm(self.field_N, axis=1)
        own = np.sqrt((self.own_B**2).sum(axis=(1, 2)) / 3)
        sigma = np.hypot(self.sigma_T, np.minimum(own, MOST_OFF * size)) / size
        unit = self.read_B / np.linalg.norm(self.read_B, axis=1, keepdims=True)
        variance = np.where(self.present(), sigma**2, np.nan)
        return SunDirections.of(unit, variance[:, None, None] * np.eye(3))

    def frames(self) -> np.ndarray:
        """Return matrices (n, 3, 3) from N to axes with z along the field, which turn as little as the field does."""
        unit = self.field_N / np.linalg.norm(self.field_N, axis=1, keepdims=True)
        made = [facing(unit[0]).T]
        for before, after in zip(unit, unit[1:], strict=False):
            # the rotation that takes the new direction to the old one, column by column
            back = rotate_by_smallest(np.tile(after, (3, 1)), np.tile(before, (3, 1)), np.eye(3)).T
            made.append(made[-1] @ back)
        return np.array(made)

    def turning(self) -> np.ndarray:
        """Return the rates (n, 3) in rad/s, in N, at which these axes turn."""
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
        """Return the directions of telemetry, and a sentence for each sample (n)."""
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


def _not_turned(errors: np.ndarray, fields: np.ndarray) -> np.ndarray:
    """Return what is left of errors (n, e, 3) of fields (n, 3) after the common rotation that is most like each."""
    read = np.isfinite(fields).all(axis=1)
    field_B, error = fields[read], errors[read]
    spread = (field_B**2).sum() * np.eye(3) - field_B.T @ field_B
    moment = np.cross(field_B[:, None], error).sum(axis=0)
    rotation = moment @ np.linalg.pinv(spread, rcond=1e-6, hermitian=True)
    left = errors.copy()
    left[read] -= np.cross(rotation, field_B[:, None])
    return left
