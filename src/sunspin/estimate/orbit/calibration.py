"""Magnetometer and Sun sensors calibrated along an orbit, for a whole file at once.

The unknowns that all samples have in common are fitted with the attitudes projected out (:mod:`.attitudes`): matrix and zero of the
magnetometer, the along-track offset and its drift, bias and scale of each Sun sensor. Each sample has Student tails, and the noise
of each kind of sensor is estimated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from sunspin.environment.field import MODEL_SIGMA_T
from sunspin.environment.orbit import Orbit, SunAlongZ
from sunspin.estimate.orbit.attitudes import (
    DRIFT,
    EACH,
    ROUNDS,
    SENSORS,
    SHIFT,
    AttitudeLaw,
    OrbitState,
    summed,
)
from sunspin.estimate.orbit.axes import axes_matrix, turned_axes
from sunspin.estimate.orbit.invariants import (
    ISOTROPIC,
    MATRIX,
    MATRIX_SIGMA,
    STUDENT,
    ZERO,
    ZERO_SIGMA,
    Sky,
    field_of,
    fit_magnetometer,
    residuals_left,
)
from sunspin.estimate.orbit.readings import Readings, read
from sunspin.solve.rotations import cross_matrix
from sunspin.telemetry.assess import Assessment
from sunspin.vehicle import Vehicle
from sunspin.vehicle.sensors import zero_sigmas

SCALE_FREE = 3.0
"""One sigma of the magnetometer's scale over the first one, which is free."""

BIAS_RAD, ANGLE_SCALE = 0.1, 0.2
"""One sigma of a Sun sensor's bias, and of its scales over the stated ones, if the vehicle file states none."""

MOST_SAMPLES = 600
"""Samples of a file by which sensors are calibrated, spread evenly."""

FEWEST = 40
"""Conditions that samples must put on the unknowns before Sun sensors are calibrated with the magnetometer."""

REACH, STEP_S, MOST_STEPS = 4.0, 20.0, 24
"""The field is tabulated within so many sigmas of the shift, in steps of so many seconds, or wider ones if these are too many a
side."""

FIRST_ROUNDS = 2
"""Alternations of unknowns and noise before the readings get the unit of the whole fit."""

WORSE = 1.3
"""A fit that leaves more of the field's strength than its start by this factor rests in another minimum."""

FEWEST_PARTS = 6
"""Parts of a file, at least, that are left out in turn, as each may err as one: passes, in pieces if they are fewer."""

OF_NORMAL = 0.83
"""Scale of Student's law with four degrees of freedom that fits normal noise of one sigma."""

SUN_TURNED_RAD = 0.01
"""Error about each axis, rad, that all directions to the Sun from panels have in common. The axes of a spinner whose panels saw the
Earth's light were 3 deg off at a sigma of 0.4, and its passes decided 5 sigma off; with this they are 3.5 off at most. With 0.02 a
satellite in orbit was decided wrongly by its magnetometer alone."""

FIELD = slice(0, 13)
"""Unknowns that the magnetometer's field depends on: matrix, zero, and offset."""

SUN_KEYS = ("x_bias_rad", "y_bias_rad", "x_scale", "y_scale", "y_turned_scale")
"""Keys of a Sun sensor in the order of its unknowns: bias in rad, and scale over the stated one."""


class CalibrationStart(NamedTuple):
    """Where a fit begins: field (T) = `matrix` reading - `zero_T`, `shift_s` ahead of the orbit.

    `left_T`: the median residual of the field's strength there.
    """

    matrix: np.ndarray
    zero_T: np.ndarray
    shift_s: float = 0.0
    left_T: float = np.inf


@dataclass(frozen=True)
class FieldCalibration:
    """A magnetometer along an orbit: field in T = `matrix` reading - `zero`.

    `errors` (13, 13): one sigma of each independent error, a row each: nine elements of the matrix by rows, the zero, and the
    place along the track in sigmas of the orbit's. `noise_T`: of a component; `scale`: T for a unit of a reading.
    """

    matrix: np.ndarray
    zero: np.ndarray
    errors: np.ndarray
    noise_T: float
    scale: float

    def field(self, reading: np.ndarray) -> np.ndarray:
        """Return fields (n, 3) in T of readings (n, 3)."""
        return reading @ self.matrix.T - self.zero

    def columns(self, reading: np.ndarray) -> np.ndarray:
        """Return what one sigma of each error changes in the fields (n, 13, 3) of readings (n, 3)."""
        by_matrix = np.einsum("eij,nj->nei", self.errors[:, MATRIX].reshape(-1, 3, 3), reading)
        return by_matrix - self.errors[None, :, ZERO]

    def along(self, field_along_N: np.ndarray) -> np.ndarray:
        """Return what one sigma of each error changes in the orbit's field (n, 13, 3) in T.

        `field_along_N` (n, 3): change of the field by one sigma along the track, T.
        """
        # (13, 1): how far each error moves the place along the track, in sigmas
        by_error = self.errors[:, SHIFT:]
        return by_error * field_along_N[:, None]

    def sigma_T(
        self, reading: np.ndarray, field_N: np.ndarray, field_along_N: np.ndarray
    ) -> np.ndarray:
        """Return one sigma (n) of each component of readings (n, 3), from how far their strength is off, in T.

        `field_N` (n, 3): the field, T; `field_along_N` (n, 3): its change by one sigma along the track. The strength needs no
        attitude. So a reading whose strength is off by more than the errors of this calibration is trusted less in all directions.
        """
        field = self.field(reading)
        size, strength = np.linalg.norm(field, axis=1), np.linalg.norm(field_N, axis=1)
        # what one sigma of each error (n, e) changes in the strength that was read, and in the one that the orbit has
        in_read = np.einsum("nei,ni->ne", self.columns(reading), field / size[:, None])
        in_orbit = np.einsum("nei,ni->ne", self.along(field_along_N), field_N / strength[:, None])
        noise = np.hypot(self.noise_T, MODEL_SIGMA_T)
        expected = np.sqrt(noise**2 + ((in_read - in_orbit) ** 2).sum(axis=1))
        return noise * np.fmax(np.abs(size - strength) / expected, 1.0)

    def of_axes(self, axes: np.ndarray) -> FieldCalibration:
        """Return the calibration of readings that `axes` (3, 3) turn into those of this one."""
        errors = self.errors.copy()
        errors[:, MATRIX] = (errors[:, MATRIX].reshape(-1, 3, 3) @ axes).reshape(-1, 9)
        return replace(self, matrix=self.matrix @ axes, errors=errors)


@dataclass(frozen=True)
class Calibration:
    """Sensors fitted along an orbit, relative to the vehicle file with which the telemetry was read.

    `values` (D) of all unknowns, with their covariances (D, D): `model` by the curvature, `robust` by leaving out each pass
    (jackknife), and `prior`. `unit_T` and `unit`: units of the field in T and of the readings in theirs; `sensors`: number of Sun
    sensors. `noise_T` of a component of the field; `sun_noise` in units of the stated sigmas. `strength` (2) and
    `angle` (2): median residuals in T and rad, before and after. `samples`: numbers of those that show something.
    """

    values: np.ndarray
    model: np.ndarray
    robust: np.ndarray
    prior: np.ndarray
    unit_T: float
    unit: float
    sensors: int
    noise_T: float
    sun_noise: float
    strength: np.ndarray
    angle: np.ndarray
    samples: dict[str, int]

    @property
    def matrix_T(self) -> np.ndarray:
        """Matrix (3, 3): field in T = matrix (reading - zero)."""
        return np.linalg.inv(np.eye(3) + self.values[MATRIX].reshape(3, 3)) * self.scale_T

    @property
    def scale_T(self) -> float:
        """T for a unit of a reading, before the fit."""
        return self.unit_T / self.unit

    @property
    def zero(self) -> np.ndarray:
        """Zero (3) in the unit of the readings."""
        return self.unit * self.values[ZERO]

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (D, D) by the curvature, each sigma widened to that by the scatter between passes if this is larger."""
        wider = np.sqrt(np.maximum(np.diag(self.robust) / np.diag(self.model), 1.0))
        return self.model * np.outer(wider, wider)

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
        return self.values[SENSORS:].reshape(self.sensors, EACH)[:, :2]

    @property
    def scale(self) -> np.ndarray:
        """Scales (F, 3) of x, y and turned y of each Sun sensor over the stated ones."""
        return 1 + self.values[SENSORS:].reshape(self.sensors, EACH)[:, 2:]

    def turned_by_sun(self) -> np.ndarray:
        """Return the covariance (9, 9) of the matrix, by rows, from errors that all directions of panels have in common.

        Light of the Earth, and sides without a panel, move the Sun's directions of a whole file one way. Neither the residuals nor
        the parts of the file show it: all directions of the field are turned by the same angle.
        """
        axes = np.eye(3) + self.values[MATRIX].reshape(3, 3)
        turned = np.array([axes @ cross_matrix(axis) for axis in np.eye(3)]).reshape(3, 9)
        return SUN_TURNED_RAD**2 * turned.T @ turned

    def of_field(self, shift_s: float, sigma_s: float) -> FieldCalibration:
        """Return the magnetometer's part at another offset (s) with another sigma.

        Given the offset, the other unknowns are where the regression on it has them. The errors are then turned from those of the
        fit, reading = (1 + M) field + zero, to those of field = matrix reading - zero.
        """
        covariance = self.covariance[FIELD, FIELD]
        by_shift = covariance[:, SHIFT] / covariance[SHIFT, SHIFT]
        values = self.values.copy()
        values[FIELD] += by_shift * (shift_s - self.shift_s)
        moved = replace(self, values=values)
        added_variance = sigma_s**2 - covariance[SHIFT, SHIFT]
        covariance = covariance + added_variance * np.outer(by_shift, by_shift)
        if not self.sensors:
            covariance[MATRIX, MATRIX] += moved.turned_by_sun()
        # matrix is the inverse of 1 + M, so that its change is -matrix dM matrix; by rows that is a Kronecker product
        matrix, zero_T = moved.matrix_T, moved.matrix_T @ moved.zero
        slope = np.zeros((13, 13))
        slope[MATRIX, MATRIX] = -np.kron(matrix, matrix.T) / self.scale_T
        slope[ZERO, MATRIX] = -np.kron(matrix, zero_T) / self.scale_T
        slope[ZERO, ZERO] = self.unit * matrix
        slope[SHIFT, SHIFT] = 1 / sigma_s
        errors = (slope @ np.linalg.cholesky(covariance)).T
        return FieldCalibration(matrix, zero_T, errors, self.noise_T / OF_NORMAL, self.scale_T)


def along_orbit(
    local: Any, assessment: Assessment, known: Calibration | None = None
) -> FieldCalibration | None:
    """Return the calibration of a file's magnetometer along an orbit; None without an orbit or without readings.

    `local`: the environment, in J2000 or in axes along the Sun. `known`: the fit by which the check of this orbit has estimated
    its along-track offset; else one is made here. Few readings give little more back than the priors, which are wide: then a fit
    of the motion estimates the rest.

    The magnetometer is fitted to strength and angle first, which needs no start, then with the attitudes projected out.
    """
    orbit = local.orbit if isinstance(local, SunAlongZ) else local
    if not isinstance(orbit, Orbit) or "field_B" not in assessment.telemetry:
        return None
    along = float(np.hypot(orbit.shift_sigma_s, orbit.clock_sigma_s))
    if known is not None:
        return known.of_field(known.shift_s, along)
    readings = read(assessment, MOST_SAMPLES)
    use = readings.has_field
    if not use.any():
        return None
    predicted = Sky.along(orbit, readings.t_s, np.zeros(1)).invariants()
    way = None
    if "sun_sensor_angle" not in assessment.telemetry:
        way = turned_axes(readings, predicted, assessment.vehicle)
    axes = np.eye(3) if way is None else axes_matrix(way)
    readings = readings.with_axes(axes)
    _, state, scales = fit_magnetometer(readings.take(use), predicted.take(use))
    values = scales.in_T(state.unknown)[0]
    left, _ = residuals_left(field_of(readings.field, values), readings.sun, predicted)
    start = CalibrationStart(values[MATRIX].reshape(3, 3), values[ZERO], left_T=left)
    prior = priors(assessment.vehicle, readings, orbit)
    prior[ZERO] = np.abs(axes) @ prior[ZERO]
    fitted = by_sun_sensors(orbit, assessment.vehicle, readings, start)
    if fitted is None:
        stated = readings.with_stated_sun()
        fitted = fit_along(orbit, assessment.vehicle, stated, start, prior)
    return fitted.of_field(0.0, along).of_axes(axes)


def by_sun_sensors(
    orbit: Orbit, vehicle: Vehicle, readings: Readings, start: CalibrationStart
) -> Calibration | None:
    """Return the calibration of a file whose Sun sensors may be off; None if it has none, too few samples show them and the field,
    or the fit is clearly worse than its start."""
    if not np.isfinite(readings.angle).any() or conditions_on_unknowns(readings) < FEWEST:
        return None
    fitted = fit_along(orbit, vehicle, readings, start, priors(vehicle, readings, orbit))
    return fitted if fitted.strength[1] < WORSE * start.left_T else None


def conditions_on_unknowns(readings: Readings) -> int:
    """Return how many field strengths, and angles to the Sun, the readings show."""
    return int(readings.has_field.sum() + (readings.has_field & readings.has_sun).sum())


def priors(vehicle: Vehicle, readings: Readings, orbit: Orbit) -> np.ndarray:
    """Return one sigma (D) of each unknown before the data: matrix (9), zero (3), offset, drift, and five of each Sun sensor.

    It is that of the vehicle file, else the usual one. The zero's is in the unit of the readings.
    """
    part, usual = vehicle.sensors.magnetometer, 1.0
    if part is not None and readings.has_field.any():
        column = readings.field @ np.linalg.inv(part.matrix).T + part.zero
        usual = float(np.nanmedian(np.linalg.norm(column, axis=1)))
    zero = np.full(3, ZERO_SIGMA * usual)
    if part is not None and part.zero_sigma.any():
        zero = zero_sigmas(part.zero_sigma)
    along = float(np.hypot(orbit.shift_sigma_s, orbit.clock_sigma_s))
    sigma = [np.full(9, MATRIX_SIGMA), zero, np.array([along, orbit.drift_sigma_s_day])]
    for sensor in vehicle.sensors.sun_sensors:
        of_sensor = np.repeat([BIAS_RAD, ANGLE_SCALE], [2, 3])
        # biases as they are, scales over the stated ones
        unit = [1.0, 1.0, sensor.x_scale, sensor.y_scale, sensor.y_turned_scale]
        for k, key in enumerate(SUN_KEYS):
            fact = vehicle.facts.get(f"sun_sensor.{sensor.name}.{key}")
            if fact is not None and isinstance(fact.sigma, float) and fact.sigma > 0:
                of_sensor[k] = fact.sigma / abs(unit[k] or 1.0)
        sigma.append(of_sensor)
    return np.concatenate(sigma)


def fit_along(
    orbit: Orbit, vehicle: Vehicle, readings: Readings, start: CalibrationStart, prior: np.ndarray
) -> Calibration:
    """Return the sensors calibrated by these readings, with the along-track offset and its drift.

    `start`: near enough, as :func:`.invariants.fit_magnetometer` gets from anywhere. `prior` (D): as :func:`priors` gives it.
    """
    half = int(np.clip(np.ceil(REACH * prior[SHIFT] / STEP_S), 4, MOST_STEPS))
    shifts = REACH * prior[SHIFT] / half * np.arange(-half, half + 1)
    sky = Sky.along(orbit, readings.t_s, shifts)
    # what is seen in the shadow is not the Sun
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
        # the prior is about a matrix near one: readings are in the unit that the fit before has given them
        unit = unit_T * abs(np.linalg.det(start.matrix)) ** (-1 / 3)
        inverse, unknown = np.linalg.inv(start.matrix), np.zeros(len(prior))
        unknown[MATRIX] = (inverse * unit_T / unit - np.eye(3)).ravel()
        unknown[ZERO], unknown[SHIFT] = inverse @ start.zero_T / unit, start.shift_s
        scaled = readings._replace(field=readings.field / unit)
        law = AttitudeLaw(vehicle, scaled, sky, unit_T, _precision(prior, unit))
        begin = OrbitState(unknown[None], law.triads(unknown)[None])
        law, state = law.settled(begin, rounds)
        unknown = state.unknown[0]
        matrix = np.linalg.inv(np.eye(3) + unknown[MATRIX].reshape(3, 3)) * unit_T / unit
        start = CalibrationStart(matrix, unit * matrix @ unknown[ZERO], unknown[SHIFT])
    return calibration_of(law, state, unit)


def _precision(prior: np.ndarray, unit: float) -> np.ndarray:
    """Return the inverse covariance (D, D) of the unknowns before the data; the scale of the matrix is free.

    `prior` (D): sigmas, that of the zero in readings; `unit`: of readings in the fit. The scale is the mean of the diagonal: along
    its direction among the nine elements the sigma is :data:`SCALE_FREE`.
    """
    sigma = prior.copy()
    sigma[ZERO] /= unit
    precision = np.diag(sigma**-2.0)
    precision[MATRIX, MATRIX] += (SCALE_FREE**-2 - MATRIX_SIGMA**-2) * np.outer(
        ISOTROPIC, ISOTROPIC
    )
    return precision


def calibration_of(law: AttitudeLaw, state: OrbitState, unit: float) -> Calibration:
    """Return the calibration that a fit ends with, and its covariances; `unit`: of its readings of the field.

    The jackknife leaves out each part of the file in turn. Where the unknowns go without it is one Newton step, as the gradients of
    the remaining samples and of the prior add to minus that of the part.
    """
    unknown, r = state.unknown[0], law.readings
    best = law.settle(unknown, state.attitude[0])
    gradients = law.gradients(best)
    # expected weight of a sample under Student's law
    expected = (STUDENT + law.conditions) / (STUDENT + law.conditions + 2)
    information = law.precision + summed(expected, best.slope)
    covariance, part_of = np.linalg.inv(information), _parts_left_out(r.pass_of)
    steps = []
    for k in range(part_of.max() + 1):
        part = part_of == k
        of_rest = information - summed(expected[part], best.slope[part])
        steps.append(np.linalg.solve(of_rest, gradients[part].sum(axis=0)))
    off = np.array(steps) - np.mean(steps, axis=0)
    robust = (1 - 1 / len(off)) * off.T @ off + covariance @ law.precision @ covariance
    residuals = np.array([law.left(law.stated_unknown(unknown)), law.left(unknown)])
    return Calibration(
        values=unknown,
        model=covariance,
        robust=robust,
        prior=np.linalg.inv(law.precision),
        unit_T=law.unit_T,
        unit=unit,
        sensors=len(law.vehicle.sensors.sun_sensors),
        noise_T=law.scatter[2] * law.unit_T,
        sun_noise=law.scatter[0],
        strength=residuals[:, 0],
        angle=residuals[:, 1],
        samples={
            "field": int(r.has_field.sum()),
            "Sun": int(r.has_sun.sum()),
            "passes": len(np.unique(r.pass_of)),
            "field and Sun": int((r.has_field & r.has_sun).sum()),
        },
    )


def _parts_left_out(pass_of: np.ndarray) -> np.ndarray:
    """Return the number (n), from zero, of the part of a file that a sample is in: passes, in even pieces if they are few."""
    _, passes, counts = np.unique(pass_of, return_inverse=True, return_counts=True)
    pieces = -(-FEWEST_PARTS // len(counts))
    # which sample of its pass it is; samples are in the order of time
    index_in_pass = np.arange(len(passes)) - np.searchsorted(passes, passes)
    piece = index_in_pass * pieces // counts[passes]
    return np.unique(passes * pieces + piece, return_inverse=True)[1]
