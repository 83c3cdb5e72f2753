"""What a magnetometer reads in an orbit that is known: zero and matrix (scale, soft iron, axes), with their errors, from a file.

Strength of the field and its angle to the Sun need no attitude; the model of both and the priors are those of the orbit check
(:mod:`sunspin.estimate.orbit_check`). Of few readings little more comes back than the priors, which are wide: then a fit of the
motion finds the rest. What is open of the place along the track is part of the errors: a calibration along a shifted orbit is
another one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from sunspin.environment.orbit import Orbit
from sunspin.estimate import orbit_check as check
from sunspin.solve.least_squares import least_squares
from sunspin.solve.linear import dense
from sunspin.vehicle import Vehicle

FEW_SCATTER = 0.02
"""Scatter of readings, as a part of the field, that is believed of hardly more readings than unknowns (12)."""

FEW = 24

OF_GAUSSIAN = 0.83
"""The scale of Student's law of four degrees of freedom that fits Gaussian noise of one sigma."""


@dataclass(frozen=True)
class FieldCalibration:
    """Field (T) = `matrix` (3, 3) reading - `zero` (3); `errors` (13, 13): one sigma of each independent error, each row nine
    elements of the matrix by rows, the zero, and the place along the track in sigmas of the orbit's; `noise_T` of one component
    of a reading, and `scale`, T for a unit of it."""

    matrix: np.ndarray
    zero: np.ndarray
    errors: np.ndarray
    noise_T: float
    scale: float

    def field(self, reading: np.ndarray) -> np.ndarray:
        """Fields (n, 3) in T of readings (n, 3)."""
        return reading @ self.matrix.T - self.zero

    def columns(self, reading: np.ndarray) -> np.ndarray:
        """What one sigma of each error changes in the fields (n, 13, 3) of readings (n, 3)."""
        by_matrix = np.einsum("eij,nj->nei", self.errors[:, :9].reshape(-1, 3, 3), reading)
        return by_matrix - self.errors[None, :, 9:12]


def field_calibration(orbit: Orbit, vehicle: Vehicle, telemetry: xr.Dataset) -> FieldCalibration | None:
    """The calibration of a file's magnetometer along this orbit; None where it has none, or it reads nothing."""
    if "field_B" not in telemetry:
        return None
    seen = check._seen(vehicle, telemetry)
    use = np.isfinite(seen.field).all(axis=1)
    if not use.any():
        return None
    seen = check.Seen(*(part[use] for part in seen))
    size = np.linalg.norm(seen.field, axis=1)
    median = float(np.median(size[size > 0])) if (size > 0).any() else 1.0
    along = float(np.hypot(orbit.shift_sigma_s, orbit.clock_sigma_s)) * np.array([-1.0, 0.0, 1.0])
    every = check._predict(orbit, seen, check._Grid.of(orbit)._replace(shifts=along), 0.0, 0.0)
    predicted = every.take([1])
    strength = float(np.median(predicted.strength))
    model = check._Model(seen.field / median, seen.sun, seen.covariance)
    state = check._State(np.zeros((1, 12)), predicted.strength / strength, predicted.to_sun / strength, np.array([[0.1, 1.0]]))
    for _ in range(check.ROUNDS):
        state = least_squares(model.linearise, check._stepped, dense, state, steps=3 * check.STEPS).state
        state = state._replace(scatter=model.scatter(state))
    scatter = max(model.scatter(state)[0, 0], FEW_SCATTER if len(size) < FEW else 0.0)
    state = state._replace(scatter=np.array([[scatter, state.scatter[0, 1]]]))
    along_track = [(part[2] - part[0]) / 2 / strength for part in (every.strength, every.to_sun)]
    scale, unknown = strength / median, state.unknown[0]
    units = np.concatenate([np.full(9, scale), np.full(3, strength), [1.0]])
    return FieldCalibration(
        scale * (np.eye(3) + unknown[:9].reshape(3, 3)), strength * unknown[9:], _errors(model, state, along_track) * units,
        float(state.scatter[0, 0]) / OF_GAUSSIAN * strength, scale,
    )  # fmt: skip


def _errors(model: check._Model, state: check._State, along_track: list[np.ndarray]) -> np.ndarray:
    """One sigma (13, 13) of each independent error of the twelve unknowns and of the place along the track, which changes strength
    and component to the Sun (n) by `along_track`."""
    strength, to_sun, by_strength, by_sun = (part[0] for part in model.residuals(state))
    there, (field, sine) = state.strength[0], state.scatter[0]
    moved = [along_track[0] / (there * field), (along_track[1] / there)[model.with_sun] / (model.sigma * sine)]
    jacobian = np.concatenate([np.column_stack([by_strength, -moved[0]]), np.column_stack([by_sun, -moved[1]])])
    normal = (jacobian * check.student_weight(np.concatenate([strength, to_sun]))[:, None]).T @ jacobian + np.eye(13)
    normal[:12, :12] += model.prior - np.eye(12)
    return np.linalg.cholesky(np.linalg.inv(normal)).T
