"""What a magnetometer reads in an orbit that is known: zero and matrix (scale, soft iron, axes), with their errors, from a file.

Strength of the field and its angle to the Sun need no attitude; model and priors are those by which an orbit is judged
(:mod:`sunspin.estimate.orbit.invariants`). Of few readings little more comes back than the priors, which are wide: then a fit of
the motion finds the rest. What is open of the place along the track is part of the errors: a calibration along a shifted orbit is
another one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from sunspin.environment.orbit import Orbit
from sunspin.estimate.orbit.invariants import STEPS, Calibrated, Seen, calibrated, predict, seen_in, student_weight
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
    seen = seen_in(vehicle, telemetry)
    use = np.isfinite(seen.field).all(axis=1)
    if not use.any():
        return None
    seen = Seen(*(part[use] for part in seen))
    along = float(np.hypot(orbit.shift_sigma_s, orbit.clock_sigma_s)) * np.array([-1.0, 0.0, 1.0])
    every = predict(orbit, seen, along)
    found = calibrated(seen, every.take([1]), steps=3 * STEPS, distances=False)
    matrix, _, _, unit = found.model.fields(found.state)
    steep = found.model.steepness(unit, matrix)[0]
    few = FEW_SCATTER / float(np.median(steep)) if len(steep) < FEW else 0.0
    scatter = np.maximum(found.state.scatter, [few, 0.0])
    found = found._replace(state=found.state._replace(scatter=scatter))
    along_track = [(part[2] - part[0]) / 2 / found.unit_T for part in (every.strength, every.to_sun)]
    scale, values = found.unit_T / found.unit, found.values[0]
    units = np.concatenate([np.full(9, scale), np.full(3, found.unit_T), [1.0]])
    return FieldCalibration(
        values[:9].reshape(3, 3), values[9:], _errors(found, steep, along_track) * units,
        float(scatter[0, 0] * np.median(steep)) / OF_GAUSSIAN * found.unit_T, scale,
    )  # fmt: skip


def _errors(found: Calibrated, steep: np.ndarray, along_track: list[np.ndarray]) -> np.ndarray:
    """One sigma (13, 13) of each independent error of the twelve unknowns and of the place along the track, which changes strength
    and component to the Sun (n) by `along_track`; `steep` (n): of the strengths."""
    model, state = found.model, found.state
    strength, to_sun, by_strength, by_sun = (part[0] for part in model.residuals(state))
    there, (field, sine) = state.strength[0], state.scatter[0]
    moved = [along_track[0] / (steep * field), (along_track[1] / there)[model.with_sun] / (model.sigma * sine)]
    jacobian = np.concatenate([np.column_stack([by_strength, -moved[0]]), np.column_stack([by_sun, -moved[1]])])
    normal = (jacobian * student_weight(np.concatenate([strength, to_sun]))[:, None]).T @ jacobian + np.eye(13)
    normal[:12, :12] += model.prior(state)[0] - np.eye(12)
    # what these readings say of the place is in its sigma already, where they have judged the orbit
    normal[12, 12] = 1 + normal[12, :12] @ np.linalg.solve(normal[:12, :12], normal[:12, 12])
    return np.linalg.cholesky(np.linalg.inv(normal)).T
