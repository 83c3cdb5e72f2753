"""Magnetometer and Sun sensors calibrated along an orbit, for a whole file at once.

The unknowns that all samples have in common are fitted with the attitudes projected out (:mod:`.attitudes`): matrix and zero of the
magnetometer, the along-track offset and its drift, bias and scale of each Sun sensor. The residuals of a sample follow Student's
law, and the noise of each kind of sensor is estimated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from sunspin.environment.field import MODEL_SIGMA_T
from sunspin.environment.orbit import Orbit, SunAlongZ
from sunspin.estimate.orbit.attitudes import (
    DRIFT,
    FIRST_SENSOR,
    PER_SENSOR,
    ROUNDS,
    SHIFT,
    OrbitModel,
    OrbitState,
    summed_information,
)
from sunspin.estimate.orbit.axes import better_axes
from sunspin.estimate.orbit.invariants import (
    ISOTROPIC,
    MATRIX,
    MATRIX_SIGMA,
    STUDENT,
    ZERO,
    ZERO_SIGMA,
    Sky,
    calibrated_field,
    fit_magnetometer,
    median_residuals,
)
from sunspin.estimate.orbit.readings import Readings, orbit_readings
from sunspin.solve.rotations import cross_matrix
from sunspin.telemetry.assess import Assessment
from sunspin.vehicle import Vehicle
from sunspin.vehicle.sensors import zero_sigmas

SCALE_FREE = 3.0
"""One sigma of the magnetometer's scale, relative to that at the start of a fit: it is nearly free."""

BIAS_RAD, ANGLE_SCALE = 0.1, 0.2
"""One sigma of a Sun sensor's bias, and of its scales relative to the stated ones, if the vehicle file states none."""

MOST_SAMPLES = 600
"""Largest number of samples of a file by which sensors are calibrated, spread evenly."""

FEWEST = 40
"""Conditions that samples must put on the unknowns before Sun sensors are calibrated with the magnetometer."""

REACH, STEP_S, MOST_STEPS = 4.0, 20.0, 24
"""The field is tabulated for offsets up to this many prior sigmas, in steps of so many seconds, or larger ones if more than
`MOST_STEPS` to each side would be needed."""

FIRST_ROUNDS = 2
"""Alternations of unknowns and noise in a first fit, which finds the unit of the readings for the second one."""

WORSE = 1.3
"""Factor by which the median residual of the field's strength may grow in a fit: beyond, it has ended in another minimum."""

FEWEST_PARTS = 6
"""Least number of parts of a file that a jackknife leaves out in turn. The parts are passes, or pieces of them if these are few."""

STUDENT_SCALE = 0.83
"""Scale that a fit of Student's law with four degrees of freedom gives to normal noise of one sigma."""

SUN_TURNED_RAD = 0.01
"""Error about each axis, rad, that all directions to the Sun from panels have in common. The axes of a spinner whose panels saw the
Earth's light were 3 deg off at a sigma of 0.4, and its passes decided 5 sigma off; with this they are 3.5 off at most. With 0.02 a
satellite in orbit was decided wrongly by its magnetometer alone."""

SUN_TURNED_BY_EARTH = 0.15
"""The same error, if it is larger, in rad per full Sun of light that the Earth gives a panel which looks at it. At 0.27 full Sun
the axes of a spinner were 3 deg off, and a pass was decided 5 sigma off. With this it is 1.5 off; the sigma grows by a fifth."""

MAGNETOMETER = slice(0, 13)
"""Unknowns of the magnetometer in an orbit: matrix, zero, and along-track offset."""

SUN_KEYS = ("x_bias_rad", "y_bias_rad", "x_scale", "y_scale", "y_turned_scale")
"""Keys of a Sun sensor in the vehicle file, in the order of its unknowns: biases in rad, and scales relative to the stated ones."""


class CalibrationStart(NamedTuple):
    """Start of a fit: a magnetometer with field (T) = `matrix` reading - `zero_T`, and the along-track offset `shift_s`.

    The offset is in addition to the orbit's own. `residual_T`: median residual of the field's strength at the start.
    """

    matrix: np.ndarray
    zero_T: np.ndarray
    shift_s: float = 0.0
    residual_T: float = np.inf


@dataclass(frozen=True)
class FieldCalibration:
    """A magnetometer calibrated along an orbit: field in T = `matrix` (3, 3) reading - `zero` (3).

    `errors` (13, 13): root of the covariance. Row e is one sigma of the independent error e: of the matrix by rows (9), the zero
    (3), and the place along the track in sigmas of the orbit's offset. `noise_T`: of a component.
    """

    matrix: np.ndarray
    zero: np.ndarray
    errors: np.ndarray
    noise_T: float

    def field(self, reading: np.ndarray) -> np.ndarray:
        """Return fields (n, 3) in T of readings (n, 3)."""
        return reading @ self.matrix.T - self.zero

    def reading_errors(self, reading: np.ndarray) -> np.ndarray:
        """Return the change (n, 13, 3), in T, of the calibrated fields of readings (n, 3) by one sigma of each error."""
        # change of the matrix by error e, times reading n
        by_matrix = np.einsum("eij,nj->nei", self.errors[:, MATRIX].reshape(-1, 3, 3), reading)
        return by_matrix - self.errors[None, :, ZERO]

    def orbit_errors(self, field_along_N: np.ndarray) -> np.ndarray:
        """Return the change (n, 13, 3), in T, of the orbit's field by one sigma of each error, as some move the satellite.

        `field_along_N` (n, 3): change of the field by one sigma along the track, T.
        """
        sigmas_along = self.errors[:, SHIFT:]  # (13, 1): how far each error moves the satellite
        return sigmas_along * field_along_N[:, None]

    def sigma_T(
        self, reading: np.ndarray, field_N: np.ndarray, field_along_N: np.ndarray
    ) -> np.ndarray:
        """Return one sigma (n), in T, of each component of the calibrated fields of readings (n, 3).

        It is that of the noise, or larger if the strength of the field, which needs no attitude, differs from the orbit's by more
        than the errors of this calibration explain. `field_N` (n, 3): the orbit's field, T; `field_along_N` (n, 3): its change by
        one sigma along the track.
        """
        field = self.field(reading)
        read_strength, strength = (np.linalg.norm(part, axis=1) for part in (field, field_N))
        read_unit, unit = field / read_strength[:, None], field_N / strength[:, None]
        # change (n, 13) of either strength by one sigma of each error
        by_reading = np.einsum("nei,ni->ne", self.reading_errors(reading), read_unit)
        by_orbit = np.einsum("nei,ni->ne", self.orbit_errors(field_along_N), unit)
        noise = np.hypot(self.noise_T, MODEL_SIGMA_T)
        expected = np.sqrt(noise**2 + ((by_reading - by_orbit) ** 2).sum(axis=1))
        return noise * np.fmax(np.abs(read_strength - strength) / expected, 1.0)

    def with_axes(self, axes: np.ndarray) -> FieldCalibration:
        """Return the calibration for readings in other axes: `axes` (3, 3) takes them to those of this calibration."""
        errors = self.errors.copy()
        errors[:, MATRIX] = (errors[:, MATRIX].reshape(-1, 3, 3) @ axes).reshape(-1, 9)
        return replace(self, matrix=self.matrix @ axes, errors=errors)


@dataclass(frozen=True)
class Calibration:
    """Sensors fitted along an orbit, relative to the vehicle file with which the telemetry was read.

    `values` (D) of all unknowns (:class:`.attitudes.OrbitModel`), with three covariances (D, D): `by_curvature` of the posterior,
    `by_jackknife` over parts of the file, and `prior`. In the fit fields are in units of `unit_T` (T), and readings in units of
    `unit` (in their own unit). `sensors`: number F of Sun sensors. `noise_T`: of a component of the field; `sun_noise`: of the
    angles, as a factor on the stated sigmas. `strength` (2) and `angle` (2): median residuals of the field's strength (T) and of
    its angle to the Sun (rad), by the vehicle file and by the fit. `samples`: how many show field, Sun, or both, and how many
    passes. `turned_rad`: one sigma of an error about each axis, rad, that all directions to the Sun have in common.
    """

    values: np.ndarray
    by_curvature: np.ndarray
    by_jackknife: np.ndarray
    prior: np.ndarray
    unit_T: float
    unit: float
    sensors: int
    noise_T: float
    sun_noise: float
    strength: np.ndarray
    angle: np.ndarray
    samples: dict[str, int]
    turned_rad: float = 0.0

    @property
    def matrix_T(self) -> np.ndarray:
        """Matrix (3, 3): field in T = matrix (reading - zero). The fit has reading = (1 + M) field + zero."""
        return np.linalg.inv(np.eye(3) + self.values[MATRIX].reshape(3, 3)) * self.scale_T

    @property
    def scale_T(self) -> float:
        """Scale with which the fit began: T for a unit of a reading."""
        return self.unit_T / self.unit

    @property
    def zero(self) -> np.ndarray:
        """Zero (3) in the unit of the readings."""
        return self.unit * self.values[ZERO]

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (D, D) by the curvature, each sigma widened to the one by the jackknife if it is larger, plus `by_common`."""
        widened = np.sqrt(np.maximum(np.diag(self.by_jackknife) / np.diag(self.by_curvature), 1.0))
        return self.by_curvature * np.outer(widened, widened) + self.by_common

    @property
    def by_common(self) -> np.ndarray:
        """Covariance (D, D) by `turned_rad`: the axes of a magnetometer rotate with the directions that calibrate it.

        Neither the residuals nor the jackknife show it.
        """
        matrix = np.eye(3) + self.values[MATRIX].reshape(3, 3)
        # change of 1 + M by a small rotation about each axis
        rotated = np.array([matrix @ cross_matrix(axis) for axis in np.eye(3)]).reshape(3, 9)
        covariance = np.zeros_like(self.by_curvature)
        covariance[MATRIX, MATRIX] = self.turned_rad**2 * rotated.T @ rotated
        return covariance

    @property
    def shift_s(self) -> float:
        """Along-track offset in addition to the orbit's own, s."""
        return float(self.values[SHIFT])

    @property
    def shift_sigma_s(self) -> float:
        """Standard deviation of the offset, s."""
        return float(np.sqrt(self.covariance[SHIFT, SHIFT]))

    @property
    def drift_s_day(self) -> float:
        """Drift of the offset in addition to the orbit's own, s/day."""
        return float(self.values[DRIFT])

    @property
    def drift_sigma_s_day(self) -> float:
        """Standard deviation of the drift, s/day."""
        return float(np.sqrt(self.covariance[DRIFT, DRIFT]))

    @property
    def bias(self) -> np.ndarray:
        """Bias (F, 2) of each Sun sensor's angles, rad: true angle = (angle - bias) / scale."""
        return self.values[FIRST_SENSOR:].reshape(self.sensors, PER_SENSOR)[:, :2]

    @property
    def scale(self) -> np.ndarray:
        """Scales (F, 3) of x, y and wrapped y of each Sun sensor, relative to the stated ones."""
        return 1 + self.values[FIRST_SENSOR:].reshape(self.sensors, PER_SENSOR)[:, 2:]

    def magnetometer(self, shift_s: float, sigma_s: float) -> FieldCalibration:
        """Return the calibration of the magnetometer if the along-track offset is `shift_s` with the sigma `sigma_s`, both in s.

        The other unknowns follow the offset by their regression on it. Their errors are propagated from the equation of the fit,
        reading = (1 + M) field + zero, to field = matrix reading - zero.
        """
        covariance = self.covariance[MAGNETOMETER, MAGNETOMETER]
        by_shift = covariance[:, SHIFT] / covariance[SHIFT, SHIFT]  # slopes of the regression
        values = self.values.copy()
        values[MAGNETOMETER] += by_shift * (shift_s - self.shift_s)
        moved = replace(self, values=values)
        added_variance = sigma_s**2 - covariance[SHIFT, SHIFT]
        covariance = covariance + added_variance * np.outer(by_shift, by_shift)
        # Derivatives by M, zero and offset. matrix is the inverse of 1 + M but for its scale, so that its change is
        # -matrix dM matrix / scale_T, by rows a Kronecker product; zero_T is the matrix times the zero.
        matrix, zero_T = moved.matrix_T, moved.matrix_T @ moved.zero
        slope = np.zeros((13, 13))
        slope[MATRIX, MATRIX] = -np.kron(matrix, matrix.T) / self.scale_T
        slope[ZERO, MATRIX] = -np.kron(matrix, zero_T) / self.scale_T
        slope[ZERO, ZERO] = self.unit * matrix
        slope[SHIFT, SHIFT] = 1 / sigma_s
        errors = (slope @ np.linalg.cholesky(covariance)).T
        return FieldCalibration(matrix, zero_T, errors, self.noise_T / STUDENT_SCALE)


def calibrate_magnetometer(
    local: Any, assessment: Assessment, known: Calibration | None = None
) -> FieldCalibration | None:
    """Return the calibration of a file's magnetometer along an orbit; None without an orbit or without readings of the field.

    Each step begins at the result of the one before:

    1. Without Sun sensors: if the file has exchanged axes of the magnetometer (:func:`.axes.better_axes`), its readings are put in
       the right ones, which is undone at the end.
    2. The strength of the field and its angle to the Sun are fitted. Neither depends on the attitude, and no first guess is needed.
    3. All readings are fitted, with the attitude of each sample projected out: together with the errors of the Sun sensors, or, if
       there are none, too few samples, or that fit is poor, with the directions to the Sun as they are.

    With few readings the result is close to the priors, which are wide; the fit of the motion estimates the calibration further.

    Parameters
    ----------
    local : Orbit, SunAlongZ, or another environment, which gives None
    assessment : vehicle and telemetry of the whole file
    known : fit of all sensors that the check of this orbit has made, if any; it replaces the three steps
    """
    orbit = local.orbit if isinstance(local, SunAlongZ) else local
    if not isinstance(orbit, Orbit) or "field_B" not in assessment.telemetry:
        return None
    if known is not None:
        # the orbit has been moved by the offset of this fit since then
        return known.magnetometer(known.shift_s, orbit.offset_sigma_s)
    readings = orbit_readings(assessment, MOST_SAMPLES)
    use = readings.has_field
    if not use.any():
        return None
    vehicle = assessment.vehicle
    predicted = Sky.along(orbit, readings.t_s, np.zeros(1)).invariants()
    # `axes` (3, 3): from the axes of the file to those of the fit
    change = None
    if "sun_sensor_angle" not in assessment.telemetry:
        change = better_axes(readings, predicted, vehicle)
    axes = np.eye(3) if change is None else change.axes["field_B"]
    readings = readings.with_axes(axes)
    model, state = fit_magnetometer(readings.take(use), predicted.take(use))
    first = model.calibration(state)[0]
    field = calibrated_field(readings.field, first)
    residual_T, _ = median_residuals(field, readings.sun, predicted)
    start = CalibrationStart(first[MATRIX].reshape(3, 3), first[ZERO], residual_T=residual_T)
    fitted = calibrate_with_sun_sensors(orbit, vehicle, readings, start)
    if fitted is None:
        prior = priors(vehicle, readings, orbit)
        # the sigmas that the file states for its own axes, in the order of the axes of the fit
        prior[ZERO] = np.abs(axes) @ prior[ZERO]
        fitted = fit_sensors(orbit, vehicle, readings.with_stated_sun(), start, prior)
    # at the orbit's own offset, and for readings in the axes of the file
    fitted = with_common_sun_error(fitted, assessment)
    return fitted.magnetometer(0.0, orbit.offset_sigma_s).with_axes(axes)


def with_common_sun_error(fitted: Calibration, assessment: Assessment) -> Calibration:
    """Return a calibration by panels with the error that all their directions to the Sun have in common.

    Light of the Earth, and sides without a panel, rotate the directions of a whole file by nearly the same angle. A calibration
    with Sun sensors is returned as it is.
    """
    if fitted.sensors:
        return fitted
    earth = assessment.quality.attrs["earth_light"] if assessment.has_panels else 0.0
    return replace(fitted, turned_rad=max(SUN_TURNED_RAD, SUN_TURNED_BY_EARTH * earth))


def calibrate_with_sun_sensors(
    orbit: Orbit, vehicle: Vehicle, readings: Readings, start: CalibrationStart
) -> Calibration | None:
    """Return magnetometer and Sun sensors calibrated together, by a fit that begins at `start`.

    None without Sun sensors, with too few conditions on the unknowns, or if the fit leaves the field's strength clearly worse.
    """
    # Each sample with a field puts a condition on the strength of the field, and one with a direction to the Sun too puts another
    # on the angle between both.
    conditions = readings.has_field.sum() + (readings.has_field & readings.has_sun).sum()
    if not np.isfinite(readings.angle).any() or conditions < FEWEST:
        return None
    fitted = fit_sensors(orbit, vehicle, readings, start, priors(vehicle, readings, orbit))
    return fitted if fitted.strength[1] < WORSE * start.residual_T else None


def priors(vehicle: Vehicle, readings: Readings, orbit: Orbit) -> np.ndarray:
    """Return one sigma (D) of each unknown before the data: M (9), zero (3), offset, drift, and five of each Sun sensor.

    Sigmas are those that the vehicle file states, else those of this module. That of the zero is in the unit of the readings.
    """
    magnetometer, usual = vehicle.sensors.magnetometer, 1.0
    if magnetometer is not None and readings.has_field.any():
        # the telemetry holds matrix (column - zero); `usual` is the median size of the columns themselves
        column = readings.field @ np.linalg.inv(magnetometer.matrix).T + magnetometer.zero
        usual = float(np.nanmedian(np.linalg.norm(column, axis=1)))
    zero = np.full(3, ZERO_SIGMA * usual)
    if magnetometer is not None and magnetometer.zero_sigma.any():
        zero = zero_sigmas(magnetometer.zero_sigma)
    offset_and_drift = np.array([orbit.offset_sigma_s, orbit.drift_sigma_s_day])
    sigmas = [np.full(9, MATRIX_SIGMA), zero, offset_and_drift]
    for sensor in vehicle.sensors.sun_sensors:
        sensor_sigma = np.repeat([BIAS_RAD, ANGLE_SCALE], [2, 3])
        # biases in rad, scales relative to the stated ones
        unit = [1.0, 1.0, sensor.x_scale, sensor.y_scale, sensor.y_turned_scale]
        for k, key in enumerate(SUN_KEYS):
            fact = vehicle.facts.get(f"sun_sensor.{sensor.name}.{key}")
            if fact is not None and isinstance(fact.sigma, float) and fact.sigma > 0:
                sensor_sigma[k] = fact.sigma / abs(unit[k] or 1.0)
        sigmas.append(sensor_sigma)
    return np.concatenate(sigmas)


def fit_sensors(
    orbit: Orbit, vehicle: Vehicle, readings: Readings, start: CalibrationStart, prior: np.ndarray
) -> Calibration:
    """Return the sensors calibrated by these readings, with the along-track offset and its drift.

    `start`: near the best calibration, such as that of :func:`.invariants.fit_magnetometer`. `prior` (D): as of :func:`priors`.
    """
    # the sky at offsets within REACH sigmas, among which the fit interpolates
    half = int(np.clip(np.ceil(REACH * prior[SHIFT] / STEP_S), 4, MOST_STEPS))
    shifts = REACH * prior[SHIFT] / half * np.arange(-half, half + 1)
    sky = Sky.along(orbit, readings.t_s, shifts)
    # light in the Earth's shadow is not the Sun
    dark = sky.lit[np.abs(shifts - start.shift_s).argmin()] < 0.5
    readings = readings._replace(
        angle=np.where(dark[:, None, None], np.nan, readings.angle),
        panel_sun=np.where(dark[:, None], np.nan, readings.panel_sun),
        sun=np.where(dark[:, None], np.nan, readings.sun),
    )
    use = readings.has_field | readings.has_sun
    readings, sky = readings.take(use), sky.take(use)
    unit_T = float(np.median(np.linalg.norm(sky.field_at(start.shift_s)[0], axis=1)))

    for rounds in (FIRST_ROUNDS, ROUNDS):
        # The prior expects a small M. So readings are in the unit that makes the determinant of the start's matrix one. Then the
        # start, field = matrix reading - zero_T, becomes reading = (1 + M) field + zero.
        unit = unit_T * abs(np.linalg.det(start.matrix)) ** (-1 / 3)
        inverse, unknown = np.linalg.inv(start.matrix), np.zeros(len(prior))
        unknown[MATRIX] = (inverse * unit_T / unit - np.eye(3)).ravel()
        unknown[ZERO], unknown[SHIFT] = inverse @ start.zero_T / unit, start.shift_s
        scaled = readings._replace(field=readings.field / unit)
        model = OrbitModel(vehicle, scaled, sky, unit_T, _precision(prior, unit))
        begin = OrbitState(unknown[None], model.triad_attitudes(unknown)[None])
        model, state = model.fit_with_scatter(begin, rounds)
        unknown = state.unknown[0]
        matrix = np.linalg.inv(np.eye(3) + unknown[MATRIX].reshape(3, 3)) * unit_T / unit
        start = CalibrationStart(matrix, unit * matrix @ unknown[ZERO], unknown[SHIFT])
    return calibration_with_errors(model, state, unit)


def _precision(prior: np.ndarray, unit: float) -> np.ndarray:
    """Return the inverse covariance (D, D) of the unknowns before the data; the scale of the matrix is hardly limited.

    `prior` (D): sigmas, that of the zero in the unit of readings; `unit`: of the readings in the fit, in that unit. The scale is
    the mean of the diagonal: along its direction among the nine elements of M the sigma is :data:`SCALE_FREE`.
    """
    sigma = prior.copy()
    sigma[ZERO] /= unit
    precision = np.diag(sigma**-2.0)
    precision[MATRIX, MATRIX] += (SCALE_FREE**-2 - MATRIX_SIGMA**-2) * np.outer(
        ISOTROPIC, ISOTROPIC
    )
    return precision


def calibration_with_errors(model: OrbitModel, state: OrbitState, unit: float) -> Calibration:
    """Return the calibration by a fitted model, with its covariances; `unit`: of the field's readings in the fit.

    The jackknife leaves out each part of the file in turn. At the minimum all gradients add to zero, so that without a part they
    add to minus its own: one Newton step with the curvature of the rest gives the change of the unknowns.
    """
    unknown, readings = state.unknown[0], model.readings
    best = model.project_out_attitudes(unknown, state.attitude[0])
    gradients = model.gradients(best)
    # expected weight of a sample under Student's law, in place of the one by its residuals
    expected = (STUDENT + model.conditions) / (STUDENT + model.conditions + 2)
    information = model.precision + summed_information(expected, best.slope)
    covariance, part_of = np.linalg.inv(information), _parts_left_out(readings.pass_of)
    steps = []
    for k in range(part_of.max() + 1):
        part = part_of == k
        rest = information - summed_information(expected[part], best.slope[part])
        steps.append(np.linalg.solve(rest, gradients[part].sum(axis=0)))
    deviation = np.array(steps) - np.mean(steps, axis=0)
    jackknife = (1 - 1 / len(deviation)) * deviation.T @ deviation
    # the prior has an error as well, which no part of the file shows
    jackknife = jackknife + covariance @ model.precision @ covariance
    residuals = np.array(
        [model.median_residuals(model.unknowns_of_file(unknown)), model.median_residuals(unknown)]
    )
    return Calibration(
        values=unknown,
        by_curvature=covariance,
        by_jackknife=jackknife,
        prior=np.linalg.inv(model.precision),
        unit_T=model.unit_T,
        unit=unit,
        sensors=len(model.vehicle.sensors.sun_sensors),
        noise_T=model.scatter[2] * model.unit_T,
        sun_noise=model.scatter[0],
        strength=residuals[:, 0],
        angle=residuals[:, 1],
        samples={
            "field": int(readings.has_field.sum()),
            "Sun": int(readings.has_sun.sum()),
            "passes": len(np.unique(readings.pass_of)),
            "field and Sun": int((readings.has_field & readings.has_sun).sum()),
        },
    )


def _parts_left_out(pass_of: np.ndarray) -> np.ndarray:
    """Return the number (n), from zero, of the part of the file that a jackknife leaves out with each sample.

    A part is a pass, or a piece of one if passes are fewer than `FEWEST_PARTS`. `pass_of` (n): the pass of each sample, in the
    order of time.
    """
    _, passes, counts = np.unique(pass_of, return_inverse=True, return_counts=True)
    pieces = -(-FEWEST_PARTS // len(counts))  # of each pass, rounded up
    index_in_pass = np.arange(len(passes)) - np.searchsorted(passes, passes)
    piece = index_in_pass * pieces // counts[passes]
    return np.unique(passes * pieces + piece, return_inverse=True)[1]
