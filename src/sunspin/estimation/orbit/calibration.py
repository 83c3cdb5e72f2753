"""Magnetometer and Sun sensors calibrated along an orbit, the attitude of each sample being unknown.

In each sample the Sun and the field have known directions in space, and the field a known strength. An attitude turns them into the
body, where the sensors read them: :math:`field = matrix^{-1} B + zero`, :math:`angle = scale\\,angle(Sun) + bias`. The attitude that
fits a sample best is projected out of its residuals, so that those of a sample with one Sun leave two conditions: the strength of
the field and its angle to the Sun. A second Sun sensor or the panels add more. The unknowns are common to the whole file: the
magnetometer's matrix and zero, bias and scale of each Sun sensor, the along-track offset and its drift. Each sample has Student
tails, and the noise of each kind of sensor is estimated.

This is Deming's regression: readings are compared where they were taken, so that their noise draws no scale down. Integrating the
attitudes out, as if all were equally likely, would.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from sunspin.environment.field import MODEL_SIGMA_T
from sunspin.environment.orbit import Orbit, SunAlongZ
from sunspin.estimation.orbit.axes import axes_matrix, turned_axes
from sunspin.estimation.orbit.invariants import (
    ISOTROPIC,
    MATRIX,
    MATRIX_SIGMA,
    STUDENT,
    ZERO,
    ZERO_SIGMA,
    Predicted,
    Sky,
    calibrated,
    field_of,
    residuals_left,
    sphere,
)
from sunspin.estimation.orbit.readings import Readings, read
from sunspin.solve.least_squares import least_squares
from sunspin.solve.linear import DenseSystem, solve_dense
from sunspin.solve.rotations import cross_matrix, rotate_attitude, tangent_basis
from sunspin.telemetry.assess import Assessment
from sunspin.vehicle import Vehicle

SCALE_FREE = 3.0
"""One sigma of the magnetometer's scale over the first one, which is free."""

BIAS_RAD, ANGLE_SCALE = 0.1, 0.2
"""One sigma of a Sun sensor's bias, and of its scales over the stated ones, if the vehicle file states none."""

MOST_SAMPLES = 600
"""Samples of a file by which sensors are calibrated, spread evenly."""

FEWEST = 40
"""Conditions that samples must put on the unknowns before Sun sensors are calibrated with the magnetometer."""

FEW, FEW_SCATTER = 24, 0.02
"""With fewer readings of the field there are hardly more conditions than unknowns: its noise, over the field, is no smaller than this."""

SHIFTS, WITHIN = 31, 3.0
"""Shifts, within so many of their sigmas, among which the field's strength chooses the one to begin from."""

REACH, STEP_S, MOST_STEPS = 4.0, 20.0, 24
"""The field is tabulated within so many sigmas of the shift, in steps of so many seconds, or wider ones if these are too many a side."""

WEAK, ROUNDING = 1e-4, 1e-12
"""Information (1/rad^2) that keeps an attitude finite which no reading constrains, and the same as a part of all information."""

FIRST_SCATTER = (0.5, 1.0, 0.02)
"""Noise with which a fit begins: of Sun sensors and of panels, over their stated sigmas, and of the field in its unit."""

INNER, ROUNDS, STEPS, TOLERANCE, STEADY = 2, 12, 12, 0.01, 0.01
"""Steps of the attitudes for one of the unknowns; alternations of unknowns and noise; steps of a fit and the gain in log likelihood
that ends it; the relative change of the noise below which it is settled."""

WORSE = 1.3
"""A fit that leaves more of the field's strength than its start by this factor rests in another minimum."""

CLUSTERS = 6
"""Parts of a file, at least, that are left out in turn: passes, in pieces if they are fewer."""

OF_NORMAL = 0.83
"""Scale of Student's law with four degrees of freedom that fits normal noise of one sigma."""

SHIFT, DRIFT, SENSORS, EACH = 12, 13, 14, 5
"""Places of the along-track offset (s), of its drift (s/day) and of the first Sun sensor among the unknowns, five to a sensor."""

FIELD = slice(0, 13)
"""Unknowns that the magnetometer's field depends on: matrix, zero, and offset."""

SUN_KEYS = ("x_bias_rad", "y_bias_rad", "x_scale", "y_scale", "y_turned_scale")
"""Keys of a Sun sensor in the order of its unknowns: bias in rad, and scale over the stated one."""


class Start(NamedTuple):
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
        """Return what one sigma of each error changes in the orbit's field (n, 13, 3), by one sigma along the track (n, 3) in T."""
        return self.errors[:, SHIFT:] * field_along_N[:, None]

    def sigma_T(
        self, reading: np.ndarray, field_N: np.ndarray, field_along_N: np.ndarray
    ) -> np.ndarray:
        """Return one sigma (n) of each component of readings (n, 3), from how far their strength is off, in T.

        `field_N` (n, 3): the field, T; `field_along_N` (n, 3): its change by one sigma along the track. The strength needs no
        attitude. So a reading whose strength is off by more than the errors of this calibration is trusted less in all directions.
        """
        field = self.field(reading)
        size, strength = np.linalg.norm(field, axis=1), np.linalg.norm(field_N, axis=1)
        own = np.einsum("nei,ni->ne", self.columns(reading), field / size[:, None])
        place = np.einsum("nei,ni->ne", self.along(field_along_N), field_N / strength[:, None])
        noise = np.hypot(self.noise_T, MODEL_SIGMA_T)
        expected = np.sqrt(noise**2 + ((own - place) ** 2).sum(axis=1))
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
    sensors. `noise_T` of a component of the field; `sun_noise`, `panel_noise` in units of the stated sigmas. `strength` (2) and
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
    panel_noise: float
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

    def of_field(self, shift_s: float, sigma_s: float) -> FieldCalibration:
        """Return the magnetometer's part at another offset (s) with another sigma, as the covariance carries it there."""
        covariance = self.covariance[FIELD, FIELD]
        by_place = covariance[:, SHIFT] / covariance[SHIFT, SHIFT]
        values = self.values.copy()
        values[FIELD] += by_place * (shift_s - self.shift_s)
        moved = replace(self, values=values)
        other_sigma = sigma_s**2 - covariance[SHIFT, SHIFT]
        covariance = covariance + other_sigma * np.outer(by_place, by_place)
        # derivatives of matrix, zero and place by the unknowns; the matrix of a field is the inverse of one of a reading
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
        way = turned_axes(readings, predicted)
    axes = np.eye(3) if way is None else axes_matrix(way)
    readings = readings.with_axes(axes)
    _, state, scales = calibrated(readings.take(use), predicted.take(use))
    values = scales.in_T(state.unknown)[0]
    left, _ = residuals_left(field_of(readings.field, values), readings.sun, predicted)
    start = Start(values[MATRIX].reshape(3, 3), values[ZERO], left_T=left)
    prior = priors(assessment.vehicle, readings, orbit)
    prior[ZERO] = np.abs(axes) @ prior[ZERO]
    fitted = by_sun_sensors(orbit, assessment.vehicle, readings, start)
    if fitted is None:
        stated = readings.with_stated_sun()
        fitted = fit_along(orbit, assessment.vehicle, stated, start, prior)
    return fitted.of_field(0.0, along).of_axes(axes)


def by_sun_sensors(
    orbit: Orbit, vehicle: Vehicle, readings: Readings, start: Start
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
    """Return one sigma (D) of each unknown before the data, the zero's in the unit of the readings.

    It is that of the vehicle file, else the usual one.
    """
    part, usual = vehicle.sensors.magnetometer, 1.0
    if part is not None and readings.has_field.any():
        column = readings.field @ np.linalg.inv(part.matrix).T + part.zero
        usual = float(np.nanmedian(np.linalg.norm(column, axis=1)))
    zero = np.full(3, ZERO_SIGMA * usual)
    if part is not None and part.zero_sigma.any():
        zero = np.broadcast_to(part.zero_sigma, 3)
    along = float(np.hypot(orbit.shift_sigma_s, orbit.clock_sigma_s))
    sigma = [np.full(9, MATRIX_SIGMA), zero, np.array([along, orbit.drift_sigma_s_day])]
    for sensor in vehicle.sensors.sun_sensors:
        own = np.repeat([BIAS_RAD, ANGLE_SCALE], [2, 3])
        size = [1.0, 1.0, sensor.x_scale, sensor.y_scale, sensor.y_turned_scale]
        for k, key in enumerate(SUN_KEYS):
            fact = vehicle.facts.get(f"sun_sensor.{sensor.name}.{key}")
            if fact is not None and isinstance(fact.sigma, float) and fact.sigma > 0:
                own[k] = fact.sigma / abs(size[k] or 1.0)
        sigma.append(own)
    return np.concatenate(sigma)


def fit_along(
    orbit: Orbit, vehicle: Vehicle, readings: Readings, start: Start, prior: np.ndarray
) -> Calibration:
    """Return the sensors calibrated by these readings, with the along-track offset and its drift.

    The fit begins at `start` and at the sphere that explains the field's strength; the one that fits better is kept. `prior` (D):
    as :func:`priors` gives it.
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

    def settled(begin: Start, unit: float, rounds: int) -> tuple[AttitudeLaw, OrbitState]:
        """Return the fit from a start, with readings in this unit."""
        law = AttitudeLaw(
            vehicle,
            readings._replace(field=readings.field / unit),
            sky,
            unit_T,
            _precision(prior, unit),
        )
        inverse, unknown = np.linalg.inv(begin.matrix), np.zeros(len(prior))
        unknown[MATRIX] = (inverse * unit_T / unit - np.eye(3)).ravel()
        unknown[ZERO], unknown[SHIFT] = inverse @ begin.zero_T / unit, begin.shift_s
        return law.settled(OrbitState(unknown[None], law.triads(unknown)[None]), rounds)

    fits = []
    for begin in [*_sphere(readings, sky, prior[SHIFT]), start]:
        unit = unit_T * abs(np.linalg.det(begin.matrix)) ** (-1 / 3)
        unknown = settled(begin, unit, 2)[1].unknown[0]
        matrix = np.linalg.inv(np.eye(3) + unknown[MATRIX].reshape(3, 3)) * unit_T / unit
        # the prior is about a matrix near one, so readings are now in the unit that the fit has given them
        begin = Start(matrix, unit * matrix @ unknown[ZERO], unknown[SHIFT])
        unit = unit_T * abs(np.linalg.det(matrix)) ** (-1 / 3)
        law, state = settled(begin, unit, ROUNDS)
        fits.append((law.cost_left(state.unknown[0]), law, state, unit))
    _, law, state, unit = min(fits, key=lambda each: each[0])
    return law.calibration(state, unit)


def _precision(prior: np.ndarray, unit: float) -> np.ndarray:
    """Return the inverse covariance (D, D) of the unknowns before the data; the scale of the matrix is free."""
    sigma = prior.copy()
    sigma[ZERO] /= unit
    precision = np.diag(sigma**-2.0)
    scale = (SCALE_FREE**-2 - MATRIX_SIGMA**-2) * np.outer(ISOTROPIC, ISOTROPIC)
    precision[MATRIX, MATRIX] += scale
    return precision


def _sphere(readings: Readings, sky: Sky, sigma_s: float) -> list[Start]:
    """Return the zero and the one scale for all axes that explain the field's strength best, at the best of several shifts.

    No start if no scale does.
    """
    use = readings.has_field
    if not use.any():
        return []
    shifts = np.linspace(-WITHIN, WITHIN, SHIFTS) * sigma_s
    sky = sky.take(use)
    strength = np.array([np.linalg.norm(sky.field_at(shift)[0], axis=1) for shift in shifts])
    usual_T = float(np.median(strength))
    usual = float(np.median(np.linalg.norm(readings.field[use], axis=1)))
    zero, scale, misfit = sphere(readings.field[use] / usual, strength / usual_T)
    k = int(misfit.argmin())
    if not np.isfinite(misfit[k]):
        return []
    in_T = scale[k] * usual_T / usual
    return [Start(in_T * np.eye(3), in_T * usual * zero[k], shifts[k])]


# ---------------------------------------------------------------------------------------------- the attitude of each sample unknown


class OrbitState(NamedTuple):
    """Unknowns (1, D), and attitudes (1, n, 3, 3), B from Earth-fixed axes, from which those that fit best are sought."""

    unknown: np.ndarray
    attitude: np.ndarray


class Residuals(NamedTuple):
    """Residuals (n, R) in sigmas, 0 if not read, and their slopes by a rotation of the body (n, R, 3)."""

    value: np.ndarray
    by_turn: np.ndarray


class Settled(NamedTuple):
    """Attitudes (n, 3, 3) that fit the unknowns best, residuals (n, R) there and their slopes (n, R, D) by the unknowns when the
    attitudes follow these; `taken` (n, R): share of each residual that the attitude takes up."""

    attitude: np.ndarray
    value: np.ndarray
    slope: np.ndarray
    taken: np.ndarray


@dataclass(frozen=True)
class AttitudeLaw:
    """Residuals of readings whose field is in its unit; R of a sample: two of each Sun sensor, two of panels, three of the field.

    `precision` (D, D): of the unknowns before the data; `scatter`: of Sun sensors and of panels over their sigmas, and of the field.
    """

    vehicle: Vehicle
    readings: Readings
    sky: Sky
    unit_T: float
    precision: np.ndarray
    scatter: tuple[float, ...] = FIRST_SCATTER

    @property
    def kinds(self) -> np.ndarray:
        """Place (R) of each residual's noise in `scatter`."""
        return np.repeat([0, 1, 2], [2 * len(self.vehicle.sensors.sun_sensors), 2, 3])

    @property
    def was_read(self) -> np.ndarray:
        """True (n, R) for the residuals of readings."""
        r = self.readings
        parts = [r.angle.reshape(len(r.t_s), -1), r.panel_sun[:, :2], r.field]
        return np.isfinite(np.concatenate(parts, axis=1))

    @property
    def conditions(self) -> np.ndarray:
        """Number (n) of conditions that a sample puts on the unknowns: its readings less what its attitude takes up."""
        of_sun, count = self.was_read[:, :-3].any(axis=1), self.was_read.sum(axis=1)
        return np.maximum(count - np.where(of_sun & self.readings.has_field, 3, 2), 0)

    def residuals(self, unknown: np.ndarray, attitude: np.ndarray) -> Residuals:
        """Return the residuals at attitudes (n, 3, 3)."""
        sun, field = self._turned(unknown, attitude)
        true, by_sun = self._angles(sun)
        scale, bias = self._of_sensors(unknown)
        sigma = self._sensor_sigma
        n = len(sun)
        off = ((scale * true + bias - self.readings.angle) / sigma).reshape(n, -1)
        slope = (scale / sigma)[..., None] * by_sun
        by_turn = slope.reshape(n, -1, 3) @ cross_matrix(sun)

        seen = np.where(np.isfinite(self.readings.panel_sun), self.readings.panel_sun, UP)
        side = np.stack(tangent_basis(seen), axis=1)
        weight = 1 / (self.readings.panel_sigma * self.scatter[1])
        off_panels = (side @ sun[..., None])[..., 0] * weight[:, None]
        by_panels = side @ cross_matrix(sun) * weight[:, None, None]

        matrix = np.eye(3) + unknown[MATRIX].reshape(3, 3)
        off_field = (field @ matrix.T + unknown[ZERO] - self.readings.field) / self.scatter[2]
        by_field = matrix @ cross_matrix(field) / self.scatter[2]
        value = np.concatenate([off, off_panels, off_field], axis=1)
        turn = np.concatenate([by_turn, by_panels, by_field], axis=1)
        was_read = self.was_read
        return Residuals(np.where(was_read, value, 0.0), np.where(was_read[..., None], turn, 0.0))

    def by_unknowns(self, unknown: np.ndarray, attitude: np.ndarray) -> np.ndarray:
        """Return the slopes (n, R, D) of the residuals by the unknowns, at attitudes (n, 3, 3) that are held."""
        sun, field = self._turned(unknown, attitude)
        n, count, d = len(sun), len(self.kinds), len(unknown)
        slope = np.zeros((n, count, d))
        sigma, (true, _) = self._sensor_sigma, self._angles(sun)
        sample, sensor, side = np.indices(true.shape)
        row = 2 * sensor + side
        slope[sample, row, SENSORS + EACH * sensor + side] = 1 / sigma
        slope[sample, row, self._scale_places] = true / sigma

        matrix = np.eye(3) + unknown[MATRIX].reshape(3, 3)
        _, by_shift = self.sky.field_at(unknown[SHIFT], unknown[DRIFT])
        along = np.einsum("ij,njk,nk->ni", matrix, attitude, by_shift / self.unit_T)
        of_field = slope[:, -3:]  # a view
        for i in range(3):
            of_field[:, i, 3 * i : 3 * i + 3] = field
            of_field[:, i, ZERO.start + i] = 1.0
        of_field[:, :, SHIFT], of_field[:, :, DRIFT] = along, along * self.sky.days[:, None]
        of_field /= self.scatter[2]
        return np.where(self.was_read[..., None], slope, 0.0)

    def settle(self, unknown: np.ndarray, attitude: np.ndarray) -> Settled:
        """Return the attitudes that fit best near these (n, 3, 3), and what is left there: Gauss-Newton, each sample by itself."""
        for _ in range(INNER):
            value, by_turn = self.residuals(unknown, attitude)
            turn = np.linalg.solve(
                _information(by_turn), np.einsum("nri,nr->ni", by_turn, value)[..., None]
            )
            attitude = rotate_attitude(attitude, np.clip(-turn[..., 0], -0.5, 0.5))
        value, by_turn = self.residuals(unknown, attitude)
        transposed = np.swapaxes(by_turn, -1, -2)
        share = np.linalg.solve(_information(by_turn), transposed)
        slope = self.by_unknowns(unknown, attitude)
        slope = slope - by_turn @ (share @ slope)
        return Settled(attitude, value, slope, np.einsum("nri,nir->nr", by_turn, share))

    def weights(self, value: np.ndarray) -> np.ndarray:
        """Return how much each sample (n) counts under Student's law."""
        return (STUDENT + self.conditions) / (STUDENT + (value**2).sum(axis=1))

    def linearise(self, state: OrbitState) -> DenseSystem:
        """Return the normal equations of minus the log posterior of the unknowns, the attitudes projected out."""
        unknown = state.unknown[0]
        best = self.settle(unknown, state.attitude[0])
        weight = self.weights(best.value)
        slope = self.precision @ unknown + self._gradients(best).sum(axis=0)
        freedom, square = STUDENT + self.conditions, (best.value**2).sum(axis=1)
        cost = unknown @ self.precision @ unknown / 2
        cost += (freedom / 2 * np.log1p(square / STUDENT)).sum()
        cost += (self.was_read.sum(axis=0) * np.log(np.array(self.scatter)[self.kinds])).sum()
        matrix = self.precision + _summed(weight, best.slope)
        return DenseSystem(
            np.array([cost]), matrix[None], slope[None], extras=(best.attitude[None],)
        )

    def _gradients(self, best: Settled) -> np.ndarray:
        """Return the gradient (n, D) of each sample's cost."""
        return self.weights(best.value)[:, None] * np.einsum("nrd,nr->nd", best.slope, best.value)

    def settled(self, state: OrbitState, rounds: int) -> tuple[AttitudeLaw, OrbitState]:
        """Return the law with its noise, and the unknowns, fitted in turn."""
        law = self
        for _ in range(rounds):
            solution = least_squares(
                law.linearise,
                lambda state, step: state._replace(unknown=state.unknown + step),
                solve_dense,
                state,
                steps=STEPS,
                tolerance=TOLERANCE,
                carry=lambda state, system: state._replace(attitude=system.extras[0]),
            )
            state = solution.state._replace(attitude=solution.system.extras[0])
            before, law = law.scatter, law.with_scatter(state)
            if np.allclose(law.scatter, before, rtol=STEADY):
                break
        return law, state

    def with_scatter(self, state: OrbitState) -> AttitudeLaw:
        """Return the law with the likeliest noise, given the weights and how much of the residuals has been fitted."""
        best = self.settle(state.unknown[0], state.attitude[0])
        weight = self.weights(best.value)
        covariance = np.linalg.inv(self.precision + _summed(weight, best.slope))
        fitted = weight[:, None] * ((best.slope @ covariance) * best.slope).sum(axis=2)
        freedom = np.where(self.was_read, 1 - best.taken - fitted, 0.0)
        scatter = []
        for k, old in enumerate(self.scatter):
            which = self.kinds == k
            left = freedom[:, which].sum()
            square = (weight[:, None] * best.value**2)[:, which].sum()
            ratio = np.sqrt(square / left) if left > 3 else 1.0
            scatter.append(float(np.clip(old * ratio, 1e-3, 100)))
        if self.readings.has_field.sum() < FEW:
            scatter[2] = max(scatter[2], FEW_SCATTER)
        return replace(self, scatter=tuple(scatter))

    def calibration(self, state: OrbitState, unit: float) -> Calibration:
        """Return the answer of a fit whose readings of the field are in this unit."""
        unknown, r = state.unknown[0], self.readings
        best = self.settle(unknown, state.attitude[0])
        gradients = self._gradients(best)
        # expected weight of a sample under Student's law
        expected = (STUDENT + self.conditions) / (STUDENT + self.conditions + 2)
        whole = self.precision + _summed(expected, best.slope)
        covariance = np.linalg.inv(whole)
        clusters = _clusters(r.pass_of)
        steps = []
        for k in range(clusters.max() + 1):  # where the unknowns go without a part of the file
            part = clusters == k
            rest = whole - _summed(expected[part], best.slope[part])
            steps.append(np.linalg.solve(rest, gradients[part].sum(axis=0)))
        apart = np.array(steps) - np.mean(steps, axis=0)
        robust = (1 - 1 / len(apart)) * apart.T @ apart
        robust += covariance @ self.precision @ covariance
        before, after = self.left(self._as_stated(unknown)), self.left(unknown)
        samples = {
            "field": int(r.has_field.sum()),
            "Sun": int(r.has_sun.sum()),
            "passes": len(np.unique(r.pass_of)),
            "field and Sun": int((r.has_field & r.has_sun).sum()),
        }
        return Calibration(
            unknown,
            covariance,
            robust,
            np.linalg.inv(self.precision),
            self.unit_T,
            unit,
            len(self.vehicle.sensors.sun_sensors),
            self.scatter[2] * self.unit_T,
            self.scatter[0],
            self.scatter[1],
            np.array([before[0], after[0]]),
            np.array([before[1], after[1]]),
            samples,
        )

    def _as_stated(self, unknown: np.ndarray) -> np.ndarray:
        """Return the unknowns (D) of the vehicle file, at this offset and with the scale that fits best."""
        field, _ = self.sky.field_at(unknown[SHIFT], unknown[DRIFT])
        strength = np.linalg.norm(field, axis=1) / self.unit_T
        scale = np.nanmedian(np.linalg.norm(self.readings.field, axis=1) / strength)
        stated = np.zeros(len(unknown))
        stated[[SHIFT, DRIFT]] = unknown[[SHIFT, DRIFT]]
        stated[MATRIX] = ((scale if np.isfinite(scale) else 1.0) - 1) * np.eye(3).ravel()
        return stated

    def left(self, unknown: np.ndarray) -> tuple[float, float]:
        """Return the median residuals of the field's strength (T) and of its angle to the Sun (rad)."""
        field_N, _ = self.sky.field_at(unknown[SHIFT], unknown[DRIFT])
        toward = (field_N * self.sky.sun).sum(axis=1)
        predicted = Predicted(np.linalg.norm(field_N, axis=1)[None], toward[None], toward[None])
        inverse = np.linalg.inv(np.eye(3) + unknown[MATRIX].reshape(3, 3))
        field = (self.readings.field - unknown[ZERO]) @ inverse.T * self.unit_T
        return residuals_left(field, self._sun_read(unknown), predicted)

    def cost_left(self, unknown: np.ndarray) -> float:
        """Return minus a log likelihood by the medians of what is left of strength and angle.

        The cost of the fit, in which each sample has an attitude, does not tell a noisy field from noisy Suns.
        """
        strength, angle = self.left(unknown)
        both = (self.readings.has_field & self.readings.has_sun).sum()
        cost = self.readings.has_field.sum() * np.log(strength)
        return float(cost + (both * np.log(angle) if np.isfinite(angle) else 0.0))

    def triads(self, unknown: np.ndarray) -> np.ndarray:
        """Return attitudes (n, 3, 3) to begin with: the field as it was read, and the Sun next to it."""
        inverse = np.linalg.inv(np.eye(3) + unknown[MATRIX].reshape(3, 3))
        field = np.nan_to_num((self.readings.field - unknown[ZERO]) @ inverse.T)
        sun = np.nan_to_num(self._sun_read(unknown))
        field_N, _ = self.sky.field_at(unknown[SHIFT], unknown[DRIFT])
        has_sun = sun.any(axis=1)[:, None]
        in_N = _frame(field_N * self.readings.has_field[:, None], self.sky.sun * has_sun)
        return _frame(field, sun) @ np.swapaxes(in_N, -1, -2)

    def _sun_read(self, unknown: np.ndarray) -> np.ndarray:
        """Return the direction to the Sun (n, 3) that all sensors of a sample have read, NaN without any."""
        r, sensors = self.readings, self.vehicle.sensors.sun_sensors
        total = np.nan_to_num(r.panel_sun) / r.panel_sigma[:, None] ** 2
        if sensors:
            scale, bias = self._of_sensors(unknown)
            angle = (r.angle - bias) / scale
            known = np.isfinite(angle[..., 0])
            tangent = np.tan(np.nan_to_num(angle))
            direction = self._axes[:, 2] + np.einsum("nfs,fsi->nfi", tangent, self._axes[:, :2])
            direction /= np.linalg.norm(direction, axis=2, keepdims=True)
            weight = known / np.array([sensor.x_sigma_rad for sensor in sensors]) ** 2
            total = total + (weight[..., None] * direction).sum(axis=1)
        size = np.linalg.norm(total, axis=1, keepdims=True)
        return total / np.where(size > 0, size, np.nan)

    @property
    def _axes(self) -> np.ndarray:
        """Axes (F, 3, 3) of each Sun sensor in the body: x, y, and its normal."""
        sensors = self.vehicle.sensors.sun_sensors
        axes = [(s.x_axis_B, np.cross(s.normal_B, s.x_axis_B), s.normal_B) for s in sensors]
        return np.array(axes).reshape(-1, 3, 3)

    @property
    def _sensor_sigma(self) -> np.ndarray:
        """Noise (F, 2) of the angles of each Sun sensor, rad."""
        sigma = [(s.x_sigma_rad, s.y_sigma_rad) for s in self.vehicle.sensors.sun_sensors]
        return np.array(sigma).reshape(-1, 2) * self.scatter[0]

    @property
    def _scale_places(self) -> np.ndarray:
        """Places (n, F, 2) of the scales of each angle among the unknowns."""
        turned = self.readings.y_turned
        first = SENSORS + EACH * np.arange(turned.shape[1])
        return np.stack([np.broadcast_to(first + 2, turned.shape), first + 3 + turned], axis=2)

    def _of_sensors(self, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return scale (n, F, 2) and bias (F, 2) of each angle."""
        bias = unknown[SENSORS:].reshape(-1, EACH)[:, :2]
        return 1 + unknown[self._scale_places], bias

    def _turned(self, unknown: np.ndarray, attitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the directions to the Sun (n, 3) and the fields (n, 3), in their unit, in the body."""
        field, _ = self.sky.field_at(unknown[SHIFT], unknown[DRIFT])
        sun, field = (np.einsum("nij,nj->ni", attitude, v) for v in (self.sky.sun, field))
        return sun, field / self.unit_T

    def _angles(self, sun: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the true angles (n, F, 2) of Suns (n, 3) at each Sun sensor, and their slopes (n, F, 2, 3) by the Sun."""
        part = np.einsum("fsi,ni->nfs", self._axes, sun)
        wide, high = part[..., :2], part[..., 2:]
        across, normal = self._axes[:, :2], self._axes[:, 2:]
        slope = high[..., None] * across - wide[..., None] * normal
        square = np.maximum(high**2 + wide**2, 1e-6)
        return np.arctan2(wide, high), slope / square[..., None]


UP = np.array([0.0, 0.0, 1.0])
"""Any direction, where none was read."""


def _information(by_turn: np.ndarray) -> np.ndarray:
    """Return the information (n, 3, 3) on a sample's attitude from residuals with these slopes (n, R, 3)."""
    information = np.swapaxes(by_turn, -1, -2) @ by_turn
    weak = WEAK + ROUNDING * np.trace(information, axis1=1, axis2=2)
    return information + weak[:, None, None] * np.eye(3)


def _summed(weight: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Return the information (D, D) of samples with weights (n) and slopes (n, R, D)."""
    flat = (np.sqrt(weight)[:, None, None] * slope).reshape(-1, slope.shape[2])
    return flat.T @ flat


def _frame(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return axes (n, 3, 3), as columns, along the first vector (n, 3) and across it toward the second; a zero vector is any one."""
    first = np.where(first.any(axis=1)[:, None], first, tangent_basis(second + UP * 1e-9)[0])
    first = first / np.linalg.norm(first, axis=1, keepdims=True)
    size = np.linalg.norm(second, axis=1, keepdims=True)
    across = np.cross(first, second / np.where(size > 0, size, 1.0))
    flat = np.linalg.norm(across, axis=1, keepdims=True) < 1e-6
    across = np.where(flat, tangent_basis(first)[0], across)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return np.stack([first, across, np.cross(first, across)], axis=2)


def _clusters(pass_of: np.ndarray) -> np.ndarray:
    """Return the number (n), from zero, of the part of a file that may err as one: passes, in even pieces if they are few."""
    _, passes, counts = np.unique(pass_of, return_inverse=True, return_counts=True)
    pieces = -(-CLUSTERS // len(counts))
    # place of a sample in its pass; samples are in the order of time
    place = np.arange(len(passes)) - np.searchsorted(passes, passes)
    return np.unique(passes * pieces + place * pieces // counts[passes], return_inverse=True)[1]
