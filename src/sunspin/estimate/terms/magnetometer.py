"""A magnetometer: how the field turns in the body from sample to sample, its direction in space being unknown.

Along a pass the field in N changes the same way for minutes, by up to two turns an orbit. Taken for noise from sample to sample
that averages out, and the turn about the Sun line, which only the field determines, is off by more than its sigma. So the rate of
change in N, and the drift of that, are unknowns of a pass; what does not change evenly stays noise. So is the zero in the body
where the vehicle file says how well it is known, and with it the matrix: who does not know the zero has not calibrated the axes.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import numpy as np
import xarray as xr

from sunspin.environment import Surroundings
from sunspin.estimate.orbit.field_calibration import FieldCalibration
from sunspin.estimate.terms.known_field import KnownField
from sunspin.estimate.terms.term import PairTerm, Seen, Term, Unknown, drifting
from sunspin.solve.rotations import cross_matrix
from sunspin.vehicle import Vehicle
from sunspin.vehicle.sensors import VARIABLES

FIELD_FACTOR = 5.0
"""A field of more than this many times the usual size is a wrapped or broken reading: along an orbit it varies by three."""

TURN_RATE = 2.2e-3
"""rad/s; a satellite in low orbit sees the Earth's field turn at about twice its own rate of 1.1e-3 rad/s."""

WINDOW_S, FEWEST_IN_WINDOW, ALIKE = 300.0, 8, 30
"""The strength of the field changes by a parabola in so many s of a low orbit (it turns by 0.6 rad at most); a window with fewer
readings is not used; soft iron makes the errors of so many neighbouring readings one."""

SOFT_IRON = 0.05
"""One sigma of each element of the matrix of a magnetometer that is not calibrated: iron that bends the field, axes off by three
degrees. To the strengths it looks like a zero of this part of the field: on 16 simulated spinners the zero is then off by 0.1 to 2
sigma across the axis of the spin. At 0.03 a pass of three turns was decided 8 sigma off."""

LEFT = 0.2
"""Part of the field's turning that does not change evenly over a pass, and stays noise."""


@dataclass(frozen=True)
class Magnetometer(PairTerm):
    """Fields (n, 3), NaN where not read, with one sigma, in any unit (infinite: only the dipole's torque uses them).

    `turn_rate` (rad/s): what the field turns any way beside its drift, of which `drift_N` (n, u, 3) is one sigma of each unknown;
    `zero_B` (u, 3): one sigma of each error of the zero; `matrix_sigma`: of each element of the matrix that makes the reading of
    the field. `known`: the same readings where an orbit says the field; the search, which does not know the turn about the Sun,
    compares neighbours.
    """

    name: ClassVar[str] = "field"
    called: ClassVar[str] = "magnetometer"
    table: ClassVar[str] = "magnetometer"
    per_sample: ClassVar[tuple[str, ...]] = ("field_B", "drift_N")
    measured: ClassVar[tuple[str, ...]] = ("field_B",)

    field_B: np.ndarray
    sigma: float
    turn_rate: float = TURN_RATE
    drift_N: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 3)))
    zero_B: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    matrix_sigma: float = 0.0
    calibration: FieldCalibration | None = None
    known: KnownField | None = None

    @classmethod
    def read(cls, vehicle: Vehicle, telemetry: xr.Dataset) -> Self | None:
        """That of telemetry, if it has one."""
        if VARIABLES[cls.table] not in telemetry:
            return None
        part = vehicle.sensors.with_columns.get(cls.table)
        noise = part.noise if part is not None else None
        read = without_outliers(np.asarray(telemetry[VARIABLES[cls.table]], dtype=np.float64))
        zero = (
            np.zeros((0, 3))
            if part is None or not part.zero_sigma.any()
            else (part.matrix * part.zero_sigma).T
        )
        bent = SOFT_IRON if len(zero) else 0.0
        return cls(
            read,
            noise or np.inf,
            drift_N=np.zeros((len(read), 0, 3)),
            zero_B=zero,
            matrix_sigma=bent,
        )

    def with_own_zero(self, t_s: np.ndarray) -> Self:
        """Less the zero, and with its errors, that the strengths at times (n) show: as a body turns, readings stay on a sphere
        about the zero, whose radius changes slowly. Only for a zero that the vehicle file states with a sigma."""
        if not self.zero_B.any():
            return self
        window = np.floor((t_s - t_s[0]) / WINDOW_S)
        read, square = [], []
        for k in np.unique(window):
            here = np.flatnonzero((window == k) & self.present())
            if len(here) >= FEWEST_IN_WINDOW:
                changing = np.linalg.qr(np.vander((t_s[here] - t_s[here].mean()) / WINDOW_S, 3))[0]
                both = np.column_stack(
                    [2 * self.field_B[here], (self.field_B[here] ** 2).sum(axis=1)]
                )
                both = both - changing @ (changing.T @ both)
                read.append(both[:, :3])
                square.append(both[:, 3])
        if not read:
            return self
        slope, value = np.concatenate(read), np.concatenate(square)
        prior, zero, keep = (
            np.linalg.inv(self.zero_B.T @ self.zero_B),
            np.zeros(3),
            np.ones(len(value), dtype=bool),
        )
        for _ in range(3):
            size = np.nanmedian(np.linalg.norm(self.field_B - zero, axis=1))
            variance = (
                max(np.mean((value - slope @ zero)[keep] ** 2), (2 * size * self.sigma) ** 2)
                * ALIKE
            )
            precision = prior + slope[keep].T @ slope[keep] / variance
            zero = np.linalg.solve(precision, slope[keep].T @ value[keep] / variance)
            off = np.abs(value - slope @ zero)
            keep = off < 6 * np.median(off) + 1e-300
        covariance = np.linalg.inv(precision) + (SOFT_IRON * size) ** 2 * np.eye(3)
        return replace(self, field_B=self.field_B - zero, zero_B=np.linalg.cholesky(covariance).T)

    def take(self, index: np.ndarray | slice) -> Self:
        return replace(
            super().take(index), known=None if self.known is None else self.known.take(index)
        )

    def blind(self, index: int) -> Self:
        return replace(
            super().blind(index), known=None if self.known is None else self.known.blind(index)
        )

    def placed(self, here: Surroundings) -> Self:
        """With the field known; noise and the zero's error are the calibration's, and the vehicle file need not state them."""
        one = self.calibration
        if one is None or here.field_N is None or here.field_along_N is None:
            return self
        read = self.field_B
        sigma, along = (
            one.sigma_T(read, here.field_N, here.field_along_N),
            one.along(here.field_along_N),
        )
        known = KnownField(read, one.field(read), sigma, here.field_N, one.columns(read), along)
        # a zero turns with the body, so neighbours differ by its error; axes that are turned turn all readings alike
        own = np.sqrt(
            np.nanmedian((_not_turned(known.own_B, known.read_B) ** 2).sum(axis=(1, 2))) / 3
        )
        return replace(
            self,
            sigma=float(np.hypot(one.noise_T, own)),
            zero_B=np.zeros((0, 3)),
            matrix_sigma=0.0,
            known=known,
        )

    @property
    def vector_B(self) -> np.ndarray:
        """The field (n, 3) as it is compared, in the unit of `sigma`."""
        return self.field_B if self.known is None else self.known.read_B

    def present(self) -> np.ndarray:
        return np.all(np.isfinite(self.field_B), axis=1)

    def pairs(self) -> np.ndarray:
        return super().pairs() & np.isfinite(self.sigma)

    def sigmas(self, t_s: np.ndarray) -> np.ndarray:
        """One sigma (n - 1) of the field's change between neighbours: of two readings, and of its turning."""
        return np.sqrt(
            2 * self.sigma**2
            + (np.linalg.norm(self.vector_B[:-1], axis=1) * self.turn_rate * np.diff(t_s)) ** 2
        )

    def forgiving(self) -> Self:
        change = np.diff(self.vector_B, axis=0)[self.pairs()]
        if not len(change) or not self.zero_B.any():
            return self
        # along an axis about which the body spins a zero moves no neighbour against the other, as the field there changes nothing
        moved = ((change @ self.zero_B.T) ** 2).sum() / (change**2).sum() + self.matrix_sigma**2 * (
            change**2
        ).sum(axis=1).mean()
        return replace(self, sigma=float(np.hypot(self.sigma, np.sqrt(moved))))

    def wider(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        size = np.linalg.norm(np.nan_to_num(self.vector_B), axis=1).max(initial=0.0)
        return replace(self, sigma=float(np.hypot(self.sigma, drift_rad.max() * size / 2)))

    def unrelated(self, t_s: np.ndarray) -> float:
        """The next reading's direction is any: the mean of its law over the sphere that the first one can be carried to."""
        pair = self.pairs()
        start, end = (
            np.linalg.norm(part[pair], axis=1) for part in (self.vector_B[:-1], self.vector_B[1:])
        )
        variance = self.sigmas(t_s)[pair] ** 2
        both = start * end / variance
        return float(
            (np.log(-np.expm1(-2 * both) / (2 * both)) - (start - end) ** 2 / (2 * variance)).sum()
        )

    def freed(self, t_s: np.ndarray) -> Term:
        if self.known is not None:
            return self.known
        if not self.pairs().any():
            return self
        sigma = TURN_RATE * np.nanmedian(np.linalg.norm(self.field_B, axis=1)) / np.sqrt(3)
        return replace(self, drift_N=drifting(t_s, sigma, TURN_RATE), turn_rate=LEFT * TURN_RATE)

    def unknowns(self) -> tuple[Unknown, ...]:
        if not (self.pairs().any() and self.drift_N.shape[1]):
            return ()
        sizes = np.linalg.norm(self.drift_N, axis=2).max(axis=0)
        drift = (
            Unknown(f"{self.name}_drift_{i}", "field_drift", "field s-1", 0.0, float(s), i)
            for i, s in enumerate(sizes)
        )
        sizes = np.linalg.norm(self.zero_B, axis=1)
        zero = (
            Unknown(f"{self.name}_zero_{i}", "field_zero", "field", 0.0, float(s), i)
            for i, s in enumerate(sizes)
        )
        bent = (
            Unknown(f"{self.name}_matrix_{i}", "field_matrix", "1", 0.0, self.matrix_sigma, i)
            for i in range(9)
        )
        return (*drift, *zero, *(bent if self.matrix_sigma else ()))

    def between(
        self, t_s: np.ndarray, relative: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        pair = self.pairs()
        start, end = (
            np.nan_to_num(part) * pair[:, None] for part in (self.vector_B[:-1], self.vector_B[1:])
        )
        inverse = np.where(pair, 1 / self.sigmas(t_s), 0.0)[:, None]
        carried = np.einsum("knij,nj->kni", relative, start)
        value = (carried - end) * inverse
        first, second = np.zeros((*value.shape, 6)), np.zeros((*value.shape, 6))
        second[..., :3] = cross_matrix(carried) * inverse[..., None]
        first[..., :3] = -relative @ cross_matrix(start) * inverse[..., None]
        return value, first, second

    def gained(self, t_s: np.ndarray, seen: Seen) -> np.ndarray:
        inverse = np.where(self.pairs(), 1 / self.sigmas(t_s), 0.0)[:, None, None]
        change = (
            np.einsum("knij,nmj->knim", seen.attitude[:, 1:], self.drift_N[:-1])
            * np.diff(t_s)[:, None, None]
        )
        relative = seen.attitude[:, 1:] @ np.swapaxes(seen.attitude[:, :-1], -1, -2)
        zero = (
            self.zero_B.T - relative @ self.zero_B.T
        )  # a zero stays where it is while the field is carried on
        parts = [change, zero]
        if self.matrix_sigma:  # the elements of a matrix, row by row
            off = self.matrix_sigma * np.einsum(
                "ij,nk->nijk", np.eye(3), np.nan_to_num(self.vector_B)
            ).reshape(-1, 3, 9)
            parts.append(off[1:] - relative @ off[:-1])
        return np.concatenate(parts, axis=-1) * inverse


def _not_turned(error_B: np.ndarray, field_B: np.ndarray) -> np.ndarray:
    """What is left of errors (n, e, 3) of fields (n, 3) when each is compared with the common rotation that is most like it."""
    read = np.isfinite(field_B).all(axis=1)
    field, error = field_B[read], error_B[read]
    spread = (field**2).sum() * np.eye(3) - field.T @ field
    rotation = np.cross(field[:, None], error).sum(axis=0) @ np.linalg.pinv(
        spread, rcond=1e-6, hermitian=True
    )
    left = error_B.copy()
    left[read] -= np.cross(rotation, field[:, None])
    return left


def without_outliers(read: np.ndarray) -> np.ndarray:
    """Fields (n, 3) with readings far beyond the usual size, which the Earth's field cannot reach, made NaN."""
    size = np.linalg.norm(np.nan_to_num(read), axis=1)
    usual = np.median(size[size > 0]) if np.any(size > 0) else 0.0
    return np.where((size <= FIELD_FACTOR * usual)[:, None], read, np.nan)
