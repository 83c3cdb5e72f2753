"""What a magnetometer reads in an orbit that is known: zero and matrix (scale, soft iron, axes), with their errors, from a file.

It is the calibration by which the along-track offset is found: with biases and scales of Sun sensors where there are any
(:mod:`sunspin.estimate.orbit.sensor_calibration`), else by strength of the field and its angle to the Sun
(:mod:`sunspin.estimate.orbit.invariants`). Of few readings little more comes back than the priors, which are wide: then a fit of
the motion finds the rest. What is open of the place along the track is part of the errors: a calibration along a shifted orbit is
another one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from sunspin.environment.field import MODEL_SIGMA_T
from sunspin.environment.orbit import Orbit
from sunspin.estimate.orbit.invariants import (
    STEPS,
    Calibrated,
    Seen,
    calibrated,
    predict,
    seen_in,
    student_weight,
    turned_axes,
)
from sunspin.estimate.orbit.sensor_calibration import Calibration, Start, by_sun_sensors
from sunspin.estimate.wiring import axes_matrix
from sunspin.telemetry.assess import Assessment, assess
from sunspin.vehicle import Vehicle

FEW_SCATTER = 0.02
"""Scatter of readings, as a part of the field, that is believed of hardly more readings than unknowns (12)."""

FEW = 24

MOST_SAMPLES = 1000
"""Samples that a magnetometer is calibrated by: one fit, where the check of an orbit makes hundreds."""

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

    def along(self, field_along_N: np.ndarray) -> np.ndarray:
        """What one sigma of each error changes in the orbit's field (n, 13, 3), of which one along the track is (n, 3) T."""
        return self.errors[:, 12:] * field_along_N[:, None]

    def sigma_T(
        self, reading: np.ndarray, field_N: np.ndarray, field_along_N: np.ndarray
    ) -> np.ndarray:
        """One sigma (n) of each component of readings (n, 3) where the field is `field_N` (n, 3) T, and one sigma along the track
        changes it by (n, 3) T. The strength needs no attitude, so how far it is off is known before any fit of the motion: a
        reading is taken for no better in any direction, beyond what the errors of this calibration may be."""
        field = self.field(reading)
        size, strength = np.linalg.norm(field, axis=1), np.linalg.norm(field_N, axis=1)
        own = np.einsum("nei,ni->ne", self.columns(reading), field / size[:, None])
        place = np.einsum("nei,ni->ne", self.along(field_along_N), field_N / strength[:, None])
        noise = np.hypot(self.noise_T, MODEL_SIGMA_T)
        expected = np.sqrt(noise**2 + ((own - place) ** 2).sum(axis=1))
        return noise * np.fmax(np.abs(size - strength) / expected, 1.0)


def field_calibration(
    orbit: Orbit,
    vehicle: Vehicle,
    telemetry: xr.Dataset | Assessment,
    made: Calibration | None = None,
) -> FieldCalibration | None:
    """The calibration of a file's magnetometer along this orbit; None where it has none, or it reads nothing. `made`: the fit with
    Sun sensors by which this orbit was judged (:class:`~sunspin.estimate.orbit.check.OrbitCheck`), which else is made here."""
    assessment = assess(vehicle, telemetry)
    if "field_B" not in assessment.telemetry:
        return None
    along = float(np.hypot(orbit.shift_sigma_s, orbit.clock_sigma_s))
    if made is not None:
        return _of_sensors(made, made.shift_s, along)
    seen = seen_in(assessment, MOST_SAMPLES)
    use = np.isfinite(seen.field).all(axis=1)
    if not use.any():
        return None
    seen = Seen(*(part[use] for part in seen))
    every = predict(orbit, seen, along * np.array([-1.0, 0.0, 1.0]))
    way = None if "sun_sensor_angle" in assessment.telemetry else turned_axes(seen, every.take([1]))
    axes = np.eye(3) if way is None else axes_matrix(*way[1:])
    seen = seen._replace(field=seen.field @ axes.T)
    found = calibrated(seen, every.take([1]), steps=3 * STEPS)
    values = found.values[0]
    matrix, zero = values[:9].reshape(3, 3), values[9:]
    left = np.abs(np.linalg.norm(seen.field @ matrix.T - zero, axis=1) - every.strength[1])
    start = Start(matrix, zero, left_T=float(np.median(left)))
    if (made := by_sun_sensors(orbit, assessment, start)) is not None:
        return _of_sensors(made, 0.0, along)
    bent, _, _, unit = found.model.fields(found.state)
    steep = found.model.steepness(unit, bent)[0]
    few = FEW_SCATTER / float(np.median(steep)) if len(steep) < FEW else 0.0
    scatter = np.maximum(found.state.scatter, [few, 0.0])
    found = found._replace(state=found.state._replace(scatter=scatter))
    along_track = [
        (part[2] - part[0]) / 2 / found.unit_T for part in (every.strength, every.to_sun)
    ]
    scale = found.unit_T / found.unit
    units = np.concatenate([np.full(9, scale), np.full(3, found.unit_T), [1.0]])
    errors = _errors(found, steep, along_track) * units
    errors[:, :9] = (errors[:, :9].reshape(-1, 3, 3) @ axes).reshape(-1, 9)
    return FieldCalibration(
        matrix @ axes,
        zero,
        errors,
        float(scatter[0, 0] * np.median(steep)) / OF_GAUSSIAN * found.unit_T,
        scale,
    )


def _of_sensors(made: Calibration, shift_s: float, along_s: float) -> FieldCalibration:
    """That of a fit with Sun sensors, along an orbit at this shift (s) beside the one of the fit, with its sigma."""
    covariance = made.covariance[:13, :13]
    by_place = covariance[:, 12] / covariance[12, 12]
    made = replace(
        made,
        values=made.values
        + np.append(by_place * (shift_s - made.shift_s), np.zeros(len(made.values) - 13)),
    )
    covariance = covariance + (along_s**2 - covariance[12, 12]) * np.outer(by_place, by_place)
    matrix, zero_T, scale = made.matrix_T, made.matrix_T @ made.zero, made.unit_T / made.unit
    slope = np.zeros((13, 13))  # of matrix, zero and place by the fit's unknowns
    slope[:9, :9] = -np.kron(matrix, matrix.T) / scale
    slope[9:12, :9] = -np.kron(matrix, zero_T) / scale
    slope[9:12, 9:12] = made.unit * matrix
    slope[12, 12] = 1 / along_s
    errors = slope @ np.linalg.cholesky(covariance)
    return FieldCalibration(matrix, zero_T, errors.T, made.noise_T / OF_GAUSSIAN, scale)


def _errors(found: Calibrated, steep: np.ndarray, along_track: list[np.ndarray]) -> np.ndarray:
    """One sigma (13, 13) of each independent error of the twelve unknowns and of the place along the track, which changes strength
    and component to the Sun (n) by `along_track`; `steep` (n): of the strengths."""
    model, state = found.model, found.state
    strength, to_sun, by_strength, by_sun = (part[0] for part in model.residuals(state))
    there, (field, sine) = state.strength[0], state.scatter[0]
    moved = [
        along_track[0] / (steep * field),
        (along_track[1] / there)[model.with_sun] / (model.sigma * sine),
    ]
    jacobian = np.concatenate(
        [np.column_stack([by_strength, -moved[0]]), np.column_stack([by_sun, -moved[1]])]
    )
    normal = (
        jacobian * student_weight(np.concatenate([strength, to_sun]))[:, None]
    ).T @ jacobian + np.eye(13)
    normal[:12, :12] += model.prior(state)[0] - np.eye(12)
    # what these readings say of the place is in its sigma already, where they have judged the orbit
    normal[12, 12] = 1 + normal[12, :12] @ np.linalg.solve(normal[:12, :12], normal[:12, 12])
    return np.linalg.cholesky(np.linalg.inv(normal)).T
