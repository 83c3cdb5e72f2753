"""Readings of Sun and field in an orbit, with the attitude of each sample projected out of their residuals.

An attitude turns the known directions of Sun and field into the body, where the sensors read them. A magnetometer reads
(1 + M) field + zero, with a matrix M (3, 3); a Sun sensor reads scale angle + bias, with the true angle of the Sun. The best
attitude of each sample makes its residuals as small as possible. What remains are two conditions for a sample with one Sun
direction: the strength of the field, and its angle to the Sun. A second Sun sensor or the panels add more.

This is Deming's regression: residuals are differences of readings, not of calibrated vectors. So the noise of the readings does not
make the estimated scale too small, as it would if one integrated over all attitudes. The unknowns that all samples have in common
(M, zero, scales, biases, along-track offset) are fitted by variable projection: with the derivatives J of a sample's residuals by
its attitude, the derivatives by the unknowns are multiplied by 1 - J (J^T J)^-1 J^T.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sunspin.estimate.orbit.invariants import (
    MATRIX,
    STUDENT,
    ZERO,
    Predicted,
    Sky,
    median_residuals,
)
from sunspin.estimate.orbit.readings import Readings
from sunspin.solve.least_squares import least_squares
from sunspin.solve.linear import DenseSystem, solve_dense
from sunspin.solve.rotations import cross_matrix, rotate_attitude, tangent_basis
from sunspin.vehicle import Vehicle

SHIFT, DRIFT, FIRST_SENSOR, PER_SENSOR = 12, 13, 14, 5
"""Indices among the unknowns, after M (0 to 8) and the zero (9 to 11), of the along-track offset (s), of its drift (s/day) and of
the first Sun sensor; and the number of unknowns of each sensor: biases of x and y, and scales of x, y and wrapped y, less one."""

WEAK, ROUNDING = 1e-4, 1e-12
"""Added to the information (1/rad^2) on each attitude, so that an unconstrained one stays finite: this much, and this part of all
information on it."""

FIRST_SCATTER = (0.5, 1.0, 0.02)
"""Noise with which a fit begins: of Sun sensors and of panels, as factors on their stated sigmas, and of the field in its unit."""

ATTITUDE_STEPS = 2
"""Gauss-Newton steps of the attitudes for each step of the unknowns."""

ROUNDS, STEADY = 12, 0.01
"""Largest number of alternations of unknowns and noise, and the relative change of the noise below which they end."""

STEPS, TOLERANCE = 12, 0.01
"""Steps of a fit of the unknowns, and the gain in log likelihood that ends it."""

FEW, FEW_SCATTER = 24, 0.02
"""With fewer than `FEW` readings of the field there are hardly more conditions than unknowns. Then its noise, over the field, is at
least `FEW_SCATTER`."""

ANY_DIRECTION = np.array([0.0, 0.0, 1.0])
"""Stands for a direction that was not read. Its residuals are set to zero."""


class OrbitState(NamedTuple):
    """Unknowns (1, D) of one least-squares problem, and attitudes (1, n, 3, 3), B from Earth-fixed axes, near the best."""

    unknown: np.ndarray
    attitude: np.ndarray


class ProjectedResiduals(NamedTuple):
    """Residuals of the readings at the best attitude of each sample, as functions of the unknowns.

    `attitude` (n, 3, 3): the best attitudes for the unknowns; `value` (n, R): residuals there; `slope` (n, R, D): derivatives by
    the unknowns, the attitudes always at their best; `leverage` (n, R): share of each residual that the fit of the attitude
    removes.
    """

    attitude: np.ndarray
    value: np.ndarray
    slope: np.ndarray
    leverage: np.ndarray


@dataclass(frozen=True)
class OrbitModel:
    """Residuals of the readings of n samples in an orbit, as functions of D unknowns in common and of the attitude of each sample.

    A sample has R residuals: two of each of F Sun sensors, two of the panels, three of the field. The unknowns are M by rows (9),
    zero (3), along-track offset, drift, and five of each Sun sensor. The predicted field is in units of `unit_T` (T), and
    `readings.field` in a unit in which M is small. `precision` (D, D): inverse covariance of the unknowns before the data.
    `scatter` (3): noise of Sun sensors and of panels as factors on stated sigmas, and of the field in the unit of its readings.
    """

    vehicle: Vehicle
    readings: Readings
    sky: Sky
    unit_T: float
    precision: np.ndarray
    scatter: tuple[float, ...] = FIRST_SCATTER

    @cached_property
    def kinds(self) -> np.ndarray:
        """Index (R) of each residual's kind of sensor in `scatter`: Sun sensors, panels, magnetometer."""
        return np.repeat([0, 1, 2], [2 * len(self.vehicle.sensors.sun_sensors), 2, 3])

    @cached_property
    def was_read(self) -> np.ndarray:
        """True (n, R) for the residuals whose reading is there."""
        readings = self.readings
        angles = readings.angle.reshape(len(readings.t_s), -1)
        # both residuals of the panels need the direction: two of its components stand for it
        parts = [angles, readings.panel_sun[:, :2], readings.field]
        return np.isfinite(np.concatenate(parts, axis=1))

    @cached_property
    def conditions(self) -> np.ndarray:
        """Number (n) of conditions that a sample puts on the unknowns: its readings less what its attitude takes up."""
        has_sun, count = self.was_read[:, :-3].any(axis=1), self.was_read.sum(axis=1)
        # one direction determines two of the attitude's three angles, two directions all three
        return np.maximum(count - np.where(has_sun & self.readings.has_field, 3, 2), 0)

    def residuals(self, unknown: np.ndarray, attitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the residuals (n, R) at unknowns (D) and attitudes (n, 3, 3), and their derivatives (n, R, 3) by the attitude.

        A residual is the prediction less the reading, in sigmas, 0 without a reading. The derivatives are by a small rotation t
        (rad, body axes) of the body: it changes the components v of a vector fixed in space by v x t.
        """
        sun, field = self._predicted_vectors(unknown, attitude)
        n, readings = len(sun), self.readings
        # Sun sensors: reading = scale angle + bias
        true_angle, angle_by_sun = self._sensor_angles(sun)
        scale, bias = self._scale_and_bias(unknown)
        sigma = self._sensor_sigma
        sensors = ((scale * true_angle + bias - readings.angle) / sigma).reshape(n, -1)
        sensors_by_sun = ((scale / sigma)[..., None] * angle_by_sun).reshape(n, -1, 3)
        sensors_by_turn = sensors_by_sun @ cross_matrix(sun)

        # panels: components of the predicted Sun along two tangents at the measured direction, 0 if both directions are equal
        measured = np.isfinite(readings.panel_sun)
        direction = np.where(measured, readings.panel_sun, ANY_DIRECTION)
        tangents = np.stack(tangent_basis(direction), axis=1)
        inverse_sigma = 1 / (readings.panel_sigma * self.scatter[1])
        panels = (tangents @ sun[..., None])[..., 0] * inverse_sigma[:, None]
        panels_by_turn = tangents @ cross_matrix(sun) * inverse_sigma[:, None, None]

        # magnetometer: reading = (1 + M) field + zero
        matrix = np.eye(3) + unknown[MATRIX].reshape(3, 3)
        magnetometer = (field @ matrix.T + unknown[ZERO] - readings.field) / self.scatter[2]
        magnetometer_by_turn = matrix @ cross_matrix(field) / self.scatter[2]

        value = np.concatenate([sensors, panels, magnetometer], axis=1)
        by_turn = np.concatenate([sensors_by_turn, panels_by_turn, magnetometer_by_turn], axis=1)
        was_read = self.was_read
        return np.where(was_read, value, 0.0), np.where(was_read[..., None], by_turn, 0.0)

    def by_unknowns(self, unknown: np.ndarray, attitude: np.ndarray) -> np.ndarray:
        """Return the derivatives (n, R, D) of the residuals by the unknowns (D), at fixed attitudes (n, 3, 3); 0 for the panels."""
        sun, field = self._predicted_vectors(unknown, attitude)
        slope = np.zeros((len(sun), len(self.kinds), len(unknown)))
        # each angle of a Sun sensor (n, F, 2) has a bias and a scale of its own
        sigma, (true_angle, _) = self._sensor_sigma, self._sensor_angles(sun)
        sample, sensor, axis = np.indices(true_angle.shape)
        residual = 2 * sensor + axis
        bias_index = FIRST_SENSOR + PER_SENSOR * sensor + axis
        slope[sample, residual, bias_index] = 1 / sigma
        slope[sample, residual, self._scale_index] = true_angle / sigma

        # the last three residuals are (1 + M) attitude field_in_space(offset + drift days) + zero - reading
        magnetometer = slope[:, -3:]  # a view: what is written there is in `slope`
        for i in range(3):
            row_of_matrix = slice(3 * i, 3 * i + 3)
            magnetometer[:, i, row_of_matrix] = field
            magnetometer[:, i, ZERO.start + i] = 1.0
        matrix = np.eye(3) + unknown[MATRIX].reshape(3, 3)
        _, field_by_shift = self.sky.field_at(unknown[SHIFT], unknown[DRIFT])
        # (1 + M) attitude (derivative of the field by the offset)
        by_shift = np.einsum("ij,njk,nk->ni", matrix, attitude, field_by_shift / self.unit_T)
        magnetometer[:, :, SHIFT] = by_shift
        magnetometer[:, :, DRIFT] = by_shift * self.sky.days[:, None]
        magnetometer /= self.scatter[2]
        return np.where(self.was_read[..., None], slope, 0.0)

    def project_out_attitudes(
        self, unknown: np.ndarray, attitude: np.ndarray
    ) -> ProjectedResiduals:
        """Return the residuals at the attitudes that fit best at given unknowns (D), with their derivatives by the unknowns.

        Gauss-Newton steps from `attitude` (n, 3, 3), B from Earth-fixed axes, find the best attitude of each sample by itself.
        """
        for _ in range(ATTITUDE_STEPS):
            value, by_turn = self.residuals(unknown, attitude)
            gradient = np.einsum("nri,nr->ni", by_turn, value)  # J^T r of each sample
            turn = np.linalg.solve(_attitude_information(by_turn), gradient[..., None])
            # no step rotates by more than 0.5 rad about an axis
            attitude = rotate_attitude(attitude, np.clip(-turn[..., 0], -0.5, 0.5))
        value, by_turn = self.residuals(unknown, attitude)
        # `inverse` is (J^T J)^-1 J^T with J = by_turn. If the unknowns change the residuals by r, the best attitude rotates by
        # -inverse r, which adds -J inverse r to the residuals. The diagonal of J inverse is the leverage of the attitude.
        inverse = np.linalg.solve(_attitude_information(by_turn), np.swapaxes(by_turn, -1, -2))
        slope = self.by_unknowns(unknown, attitude)
        slope = slope - by_turn @ (inverse @ slope)
        leverage = np.einsum("nri,nir->nr", by_turn, inverse)
        return ProjectedResiduals(attitude, value, slope, leverage)

    def weights(self, value: np.ndarray) -> np.ndarray:
        """Return the weight of each sample (n) by its residuals (n, R): all of a sample follow one Student's law, multivariate."""
        return (STUDENT + self.conditions) / (STUDENT + (value**2).sum(axis=1))

    def linearise(self, state: OrbitState) -> DenseSystem:
        """Return the normal equations of minus the log posterior of the unknowns, the attitudes projected out.

        `extras` of the system are the best attitudes, from which those of the next step are sought.
        """
        unknown = state.unknown[0]
        best = self.project_out_attitudes(unknown, state.attitude[0])
        weight = self.weights(best.value)
        gradient = self.precision @ unknown + self.gradients(best).sum(axis=0)
        # the prior, Student's law, and the log of each reading's noise, which its density is divided by
        freedom, square = STUDENT + self.conditions, (best.value**2).sum(axis=1)
        cost = unknown @ self.precision @ unknown / 2
        cost += (freedom / 2 * np.log1p(square / STUDENT)).sum()
        cost += (self.was_read.sum(axis=0) * np.log(np.array(self.scatter)[self.kinds])).sum()
        matrix = self.precision + summed_information(weight, best.slope)
        return DenseSystem(
            np.array([cost]), matrix[None], gradient[None], extras=(best.attitude[None],)
        )

    def gradients(self, best: ProjectedResiduals) -> np.ndarray:
        """Return the gradient (n, D) of each sample's cost by the unknowns: weight slope^T residuals."""
        return self.weights(best.value)[:, None] * np.einsum("nrd,nr->nd", best.slope, best.value)

    def fit_with_scatter(self, state: OrbitState, rounds: int) -> tuple[OrbitModel, OrbitState]:
        """Return the model with fitted noise (`scatter`), and the fitted state, after at most `rounds` alternations of the two."""
        model = self
        for _ in range(rounds):
            solution = least_squares(
                model.linearise,
                lambda state, step: state._replace(unknown=state.unknown + step),
                solve_dense,
                state,
                steps=STEPS,
                tolerance=TOLERANCE,
                # each step begins at the best attitudes of the one before
                keep=lambda state, system: state._replace(attitude=system.extras[0]),
            )
            state = solution.state._replace(attitude=solution.system.extras[0])
            scatter_before, model = model.scatter, model.with_fitted_scatter(state)
            if np.allclose(model.scatter, scatter_before, rtol=STEADY):
                break
        return model, state

    def with_fitted_scatter(self, state: OrbitState) -> OrbitModel:
        """Return the model with the likeliest noise of each kind of sensor: weighted squares over their degrees of freedom.

        A residual has one degree of freedom, less its leverages in the fits of its attitude and of the unknowns. With three degrees
        or less the noise of a kind stays as it was.
        """
        best = self.project_out_attitudes(state.unknown[0], state.attitude[0])
        weight = self.weights(best.value)
        covariance = np.linalg.inv(self.precision + summed_information(weight, best.slope))
        # the leverage of the unknowns: the diagonal of weight slope covariance slope^T
        of_unknowns = weight[:, None] * ((best.slope @ covariance) * best.slope).sum(axis=2)
        freedom = np.where(self.was_read, 1 - best.leverage - of_unknowns, 0.0)
        scatter = []
        for k, old in enumerate(self.scatter):
            of_kind = self.kinds == k
            total_freedom = freedom[:, of_kind].sum()
            square = (weight[:, None] * best.value**2)[:, of_kind].sum()
            ratio = np.sqrt(square / total_freedom) if total_freedom > 3 else 1.0
            scatter.append(float(np.clip(old * ratio, 1e-3, 100)))
        if self.readings.has_field.sum() < FEW:
            scatter[2] = max(scatter[2], FEW_SCATTER)
        return replace(self, scatter=tuple(scatter))

    def unknowns_of_file(self, unknown: np.ndarray) -> np.ndarray:
        """Return the unknowns (D) of sensors that are as the vehicle file states, at the offset and drift of `unknown` (D).

        Only the magnetometer's scale is the one that fits best, as a file may state readings in any unit.
        """
        field, _ = self.sky.field_at(unknown[SHIFT], unknown[DRIFT])
        strength = np.linalg.norm(field, axis=1) / self.unit_T
        scale = np.nanmedian(np.linalg.norm(self.readings.field, axis=1) / strength)
        stated = np.zeros(len(unknown))
        stated[[SHIFT, DRIFT]] = unknown[[SHIFT, DRIFT]]
        stated[MATRIX] = ((scale if np.isfinite(scale) else 1.0) - 1) * np.eye(3).ravel()
        return stated

    def median_residuals(self, unknown: np.ndarray) -> tuple[float, float]:
        """Return the median residuals of the field's strength (T) and of its angle to the Sun (rad) at unknowns (D)."""
        true_field, _ = self.sky.field_at(unknown[SHIFT], unknown[DRIFT])
        toward = (true_field * self.sky.sun).sum(axis=1)
        unused = toward[None]  # in place of the light
        predicted = Predicted(np.linalg.norm(true_field, axis=1)[None], toward[None], unused)
        inverse = np.linalg.inv(np.eye(3) + unknown[MATRIX].reshape(3, 3))
        field = (self.readings.field - unknown[ZERO]) @ inverse.T * self.unit_T
        return median_residuals(field, self._measured_sun(unknown), predicted)

    def triad_attitudes(self, unknown: np.ndarray) -> np.ndarray:
        """Return attitudes (n, 3, 3), B from Earth-fixed axes, from which a fit begins (TRIAD).

        Each takes the predicted field exactly to the direction of the measured one, and the Sun as near to the measured one as that
        allows. It is the rotation between two sets of axes that :func:`_triad` makes of field and Sun: of the measured ones in B,
        and of the predicted ones in Earth-fixed axes. Of `unknown` (D) the calibration, the offset and the drift are used.
        """
        inverse = np.linalg.inv(np.eye(3) + unknown[MATRIX].reshape(3, 3))
        field_B = np.nan_to_num((self.readings.field - unknown[ZERO]) @ inverse.T)
        sun_B = np.nan_to_num(self._measured_sun(unknown))
        true_field, _ = self.sky.field_at(unknown[SHIFT], unknown[DRIFT])
        # vectors that were not read are zero in both frames: `_triad` puts arbitrary ones in their place
        has_sun = (sun_B != 0).any(axis=1, keepdims=True)
        true_field = true_field * self.readings.has_field[:, None]
        in_earth_axes = _triad(true_field, self.sky.sun * has_sun)
        return _triad(field_B, sun_B) @ np.swapaxes(in_earth_axes, -1, -2)

    def _measured_sun(self, unknown: np.ndarray) -> np.ndarray:
        """Return the mean unit direction to the Sun (n, 3) by panels and Sun sensors; NaN where none shows it.

        Each has a weight of one over its variance; that of a Sun sensor is taken from its x angle alone.
        """
        readings, sensors = self.readings, self.vehicle.sensors.sun_sensors
        weighted_sum = np.nan_to_num(readings.panel_sun) / readings.panel_sigma[:, None] ** 2
        if sensors:
            scale, bias = self._scale_and_bias(unknown)
            angle = (readings.angle - bias) / scale  # the inverse of: reading = scale angle + bias
            known = np.isfinite(angle[..., 0])
            # the tangents of a sensor's angles are the Sun's components x and y over that along the normal
            tangent = np.tan(np.nan_to_num(angle))
            # normal + tan(x angle) x axis + tan(y angle) y axis
            direction = self._axes[:, 2] + np.einsum("nfs,fsi->nfi", tangent, self._axes[:, :2])
            direction /= np.linalg.norm(direction, axis=2, keepdims=True)
            weight = known / np.array([sensor.x_sigma_rad for sensor in sensors]) ** 2
            weighted_sum = weighted_sum + (weight[..., None] * direction).sum(axis=1)
        size = np.linalg.norm(weighted_sum, axis=1, keepdims=True)
        return weighted_sum / np.where(size > 0, size, np.nan)

    @cached_property
    def _axes(self) -> np.ndarray:
        """Axes (F, 3, 3) of each Sun sensor in the body: x, y, and its normal."""
        sensors = self.vehicle.sensors.sun_sensors
        axes = [(s.x_axis_B, np.cross(s.normal_B, s.x_axis_B), s.normal_B) for s in sensors]
        return np.array(axes).reshape(-1, 3, 3)

    @cached_property
    def _sensor_sigma(self) -> np.ndarray:
        """Noise (F, 2) of the angles of each Sun sensor, rad."""
        sigma = [(s.x_sigma_rad, s.y_sigma_rad) for s in self.vehicle.sensors.sun_sensors]
        return np.array(sigma).reshape(-1, 2) * self.scatter[0]

    @cached_property
    def _scale_index(self) -> np.ndarray:
        """Indices (n, F, 2) of the scales of each angle among the unknowns: y has another one if its reading wraps."""
        turned = self.readings.y_turned
        first = FIRST_SENSOR + PER_SENSOR * np.arange(turned.shape[1])
        x_scale, y_scale = np.broadcast_to(first + 2, turned.shape), first + 3 + turned
        return np.stack([x_scale, y_scale], axis=2)

    def _scale_and_bias(self, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return scale (n, F, 2) and bias (F, 2) of each angle of the Sun sensors."""
        bias = unknown[FIRST_SENSOR:].reshape(-1, PER_SENSOR)[:, :2]
        return 1 + unknown[self._scale_index], bias

    def _predicted_vectors(
        self, unknown: np.ndarray, attitude: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the predicted directions to the Sun (n, 3) and fields (n, 3) in body axes, the latter in units of `unit_T`."""
        true_field, _ = self.sky.field_at(unknown[SHIFT], unknown[DRIFT])
        sun_B = np.einsum("nij,nj->ni", attitude, self.sky.sun)
        return sun_B, np.einsum("nij,nj->ni", attitude, true_field) / self.unit_T

    def _sensor_angles(self, sun: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the x and y angles (n, F, 2) of Sun directions (n, 3), body axes, at each Sun sensor, and derivatives by these.

        With the Sun's component a along the x (or y) axis of the sensor and b along its normal the angle is arctan(a / b). It
        changes by (b da - a db) / (a^2 + b^2), which gives derivatives (n, F, 2, 3).
        """
        component = np.einsum("fsi,ni->nfs", self._axes, sun)
        a, b = component[..., :2], component[..., 2:]
        x_and_y, normal = self._axes[:, :2], self._axes[:, 2:]
        slope = b[..., None] * x_and_y - a[..., None] * normal
        square = np.maximum(b**2 + a**2, 1e-6)
        return np.arctan2(a, b), slope / square[..., None]


def _attitude_information(by_turn: np.ndarray) -> np.ndarray:
    """Return the information J^T J (n, 3, 3) on each attitude from the derivatives J (n, R, 3) of residuals, made invertible."""
    information = np.swapaxes(by_turn, -1, -2) @ by_turn
    weak = WEAK + ROUNDING * np.trace(information, axis1=1, axis2=2)
    return information + weak[:, None, None] * np.eye(3)


def summed_information(weight: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Return the information (D, D) on the unknowns from samples with weights (n) and derivatives (n, R, D)."""
    flat = (np.sqrt(weight)[:, None, None] * slope).reshape(-1, slope.shape[2])
    return flat.T @ flat


def _triad(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return axes (n, 3, 3), as columns: along the first vector (n, 3), across both, and across these two.

    A vector that is zero or parallel to the other one is replaced by an arbitrary one.
    """
    # the added vector keeps `tangent_basis` finite if both vectors are zero
    is_known = (first != 0).any(axis=1, keepdims=True)
    first = np.where(is_known, first, tangent_basis(second + ANY_DIRECTION * 1e-9)[0])
    x = first / np.linalg.norm(first, axis=1, keepdims=True)
    size = np.linalg.norm(second, axis=1, keepdims=True)
    y = np.cross(x, second / np.where(size > 0, size, 1.0))
    is_parallel = np.linalg.norm(y, axis=1, keepdims=True) < 1e-6
    y = np.where(is_parallel, tangent_basis(x)[0], y)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=2)
