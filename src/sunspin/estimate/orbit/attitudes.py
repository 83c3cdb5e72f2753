"""Readings of Sun and field in an orbit, with the attitude of each sample projected out of their residuals.

An attitude turns the known directions of Sun and field into the body, where the sensors read them: reading = (1 + M) field + zero,
and angle = scale angle of the Sun + bias. What the attitude that fits a sample best cannot take up is left. Of a sample with one
Sun these are two conditions, the strength of the field and its angle to the Sun; a second Sun sensor or the panels add more.

This is Deming's regression: readings are compared where they were taken, so that their noise draws no scale down. Integrating the
attitudes out, as if all were equally likely, would.
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
    residuals_left,
)
from sunspin.estimate.orbit.readings import Readings
from sunspin.solve.least_squares import least_squares
from sunspin.solve.linear import DenseSystem, solve_dense
from sunspin.solve.rotations import cross_matrix, rotate_attitude, tangent_basis
from sunspin.vehicle import Vehicle

SHIFT, DRIFT, SENSORS, EACH = 12, 13, 14, 5
"""Indices of the along-track offset (s), of its drift (s/day) and of the first Sun sensor among the unknowns. A sensor has five:
biases of x and y, scales of x, y and turned y, less one."""

WEAK, ROUNDING = 1e-4, 1e-12
"""Information (1/rad^2) that keeps an attitude finite which no reading constrains, and the same as a part of all information."""

FIRST_SCATTER = (0.5, 1.0, 0.02)
"""Noise with which a fit begins: of Sun sensors and of panels, over their stated sigmas, and of the field in its unit."""

INNER, ROUNDS, STEPS, TOLERANCE, STEADY = 2, 12, 12, 0.01, 0.01
"""Steps of the attitudes for one of the unknowns; alternations of unknowns and noise; steps of a fit and the gain in log likelihood
that ends it; the relative change of the noise below which it is settled."""

FEW, FEW_SCATTER = 24, 0.02
"""With fewer readings of the field there are hardly more conditions than unknowns: its noise, over the field, is no smaller than
this."""


class OrbitState(NamedTuple):
    """Unknowns (1, D), and attitudes (1, n, 3, 3), B from Earth-fixed axes, from which those that fit best are sought."""

    unknown: np.ndarray
    attitude: np.ndarray


class Residuals(NamedTuple):
    """Residuals (n, R) in sigmas, 0 if not read, and their slopes by a rotation of the body (n, R, 3)."""

    value: np.ndarray
    by_turn: np.ndarray


class Settled(NamedTuple):
    """What is left of the readings when the attitude of each sample is projected out.

    `attitude` (n, 3, 3): those that fit the unknowns best; `value` (n, R): residuals there; `slope` (n, R, D): by the unknowns
    while the attitudes follow them; `taken` (n, R): share of each residual that the attitude takes up.
    """

    attitude: np.ndarray
    value: np.ndarray
    slope: np.ndarray
    taken: np.ndarray


@dataclass(frozen=True)
class AttitudeLaw:
    """Residuals of readings in an orbit: R of a sample, two of each of F Sun sensors, two of panels, three of the field.

    The D unknowns: matrix less one (9), zero (3), offset, drift, five of each Sun sensor. Fields are in units of `unit_T`, readings
    of them in their own. `precision` (D, D): of the unknowns before the data; `scatter` (3): noise of Sun sensors and of panels
    over their sigmas, and of the field.
    """

    vehicle: Vehicle
    readings: Readings
    sky: Sky
    unit_T: float
    precision: np.ndarray
    scatter: tuple[float, ...] = FIRST_SCATTER

    @cached_property
    def kinds(self) -> np.ndarray:
        """Index (R) of each residual's noise in `scatter`."""
        return np.repeat([0, 1, 2], [2 * len(self.vehicle.sensors.sun_sensors), 2, 3])

    @cached_property
    def was_read(self) -> np.ndarray:
        """True (n, R) for the residuals of readings."""
        r = self.readings
        parts = [r.angle.reshape(len(r.t_s), -1), r.panel_sun[:, :2], r.field]
        return np.isfinite(np.concatenate(parts, axis=1))

    @cached_property
    def conditions(self) -> np.ndarray:
        """Number (n) of conditions that a sample puts on the unknowns: its readings less what its attitude takes up."""
        of_sun, count = self.was_read[:, :-3].any(axis=1), self.was_read.sum(axis=1)
        return np.maximum(count - np.where(of_sun & self.readings.has_field, 3, 2), 0)

    def residuals(self, unknown: np.ndarray, attitude: np.ndarray) -> Residuals:
        """Return the residuals at attitudes (n, 3, 3): predicted less read. A turn t of the body moves a vector v by v x t."""
        sun, field = self._in_body(unknown, attitude)
        n = len(sun)
        # Sun sensors: scale angle + bias
        true_angle, by_sun = self._angles(sun)
        scale, bias = self._of_sensors(unknown)
        sigma = self._sensor_sigma
        of_sensors = ((scale * true_angle + bias - self.readings.angle) / sigma).reshape(n, -1)
        slope = (scale / sigma)[..., None] * by_sun
        sensors_by_turn = slope.reshape(n, -1, 3) @ cross_matrix(sun)

        # panels: the Sun's two components across the direction that they have read
        direction = np.where(np.isfinite(self.readings.panel_sun), self.readings.panel_sun, UP)
        across = np.stack(tangent_basis(direction), axis=1)
        inverse = 1 / (self.readings.panel_sigma * self.scatter[1])
        of_panels = (across @ sun[..., None])[..., 0] * inverse[:, None]
        panels_by_turn = across @ cross_matrix(sun) * inverse[:, None, None]

        # magnetometer: (1 + M) field + zero
        matrix = np.eye(3) + unknown[MATRIX].reshape(3, 3)
        of_field = (field @ matrix.T + unknown[ZERO] - self.readings.field) / self.scatter[2]
        field_by_turn = matrix @ cross_matrix(field) / self.scatter[2]

        value = np.concatenate([of_sensors, of_panels, of_field], axis=1)
        by_turn = np.concatenate([sensors_by_turn, panels_by_turn, field_by_turn], axis=1)
        was_read = self.was_read
        return Residuals(
            np.where(was_read, value, 0.0), np.where(was_read[..., None], by_turn, 0.0)
        )

    def by_unknowns(self, unknown: np.ndarray, attitude: np.ndarray) -> np.ndarray:
        """Return the slopes (n, R, D) of the residuals by the unknowns, at attitudes (n, 3, 3) that are held."""
        sun, field = self._in_body(unknown, attitude)
        n, count, d = len(sun), len(self.kinds), len(unknown)
        slope = np.zeros((n, count, d))  # panels know no unknowns
        # each angle of a sensor (n, F, 2) has a bias and a scale of its own
        sigma, (true_angle, _) = self._sensor_sigma, self._angles(sun)
        sample, sensor, side = np.indices(true_angle.shape)
        row = 2 * sensor + side
        bias_index = SENSORS + EACH * sensor + side
        slope[sample, row, bias_index] = 1 / sigma
        slope[sample, row, self._scale_index] = true_angle / sigma

        matrix = np.eye(3) + unknown[MATRIX].reshape(3, 3)
        _, by_shift = self.sky.field_at(unknown[SHIFT], unknown[DRIFT])
        along = np.einsum("ij,njk,nk->ni", matrix, attitude, by_shift / self.unit_T)
        of_field = slope[:, -3:]  # a view of the last three residuals
        for i in range(3):
            row_of_matrix = slice(3 * i, 3 * i + 3)
            of_field[:, i, row_of_matrix] = field
            of_field[:, i, ZERO.start + i] = 1.0
        of_field[:, :, SHIFT], of_field[:, :, DRIFT] = along, along * self.sky.days[:, None]
        of_field /= self.scatter[2]
        return np.where(self.was_read[..., None], slope, 0.0)

    def settle(self, unknown: np.ndarray, attitude: np.ndarray) -> Settled:
        """Return the attitudes that fit best near these (n, 3, 3), and what is left there: Gauss-Newton, each sample by itself.

        `unknown`: at which values of the unknowns; :meth:`settled` fits these too.
        """
        for _ in range(INNER):
            value, by_turn = self.residuals(unknown, attitude)
            gradient = np.einsum("nri,nr->ni", by_turn, value)
            turn = np.linalg.solve(_information(by_turn), gradient[..., None])
            attitude = rotate_attitude(attitude, np.clip(-turn[..., 0], -0.5, 0.5))
        value, by_turn = self.residuals(unknown, attitude)
        # When the unknowns change residuals by r, the attitude turns by -answer r, which takes by_turn answer r of them back.
        answer = np.linalg.solve(_information(by_turn), np.swapaxes(by_turn, -1, -2))
        slope = self.by_unknowns(unknown, attitude)
        slope = slope - by_turn @ (answer @ slope)
        return Settled(attitude, value, slope, np.einsum("nri,nir->nr", by_turn, answer))

    def weights(self, value: np.ndarray) -> np.ndarray:
        """Return how much each sample (n) counts under Student's law."""
        return (STUDENT + self.conditions) / (STUDENT + (value**2).sum(axis=1))

    def linearise(self, state: OrbitState) -> DenseSystem:
        """Return the normal equations of minus the log posterior of the unknowns, the attitudes projected out.

        `extras` of the system are the attitudes that fit, from which the next step begins.
        """
        unknown = state.unknown[0]
        best = self.settle(unknown, state.attitude[0])
        weight = self.weights(best.value)
        slope = self.precision @ unknown + self.gradients(best).sum(axis=0)
        freedom, square = STUDENT + self.conditions, (best.value**2).sum(axis=1)
        cost = unknown @ self.precision @ unknown / 2
        cost += (freedom / 2 * np.log1p(square / STUDENT)).sum()
        cost += (self.was_read.sum(axis=0) * np.log(np.array(self.scatter)[self.kinds])).sum()
        matrix = self.precision + summed(weight, best.slope)
        return DenseSystem(
            np.array([cost]), matrix[None], slope[None], extras=(best.attitude[None],)
        )

    def gradients(self, best: Settled) -> np.ndarray:
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
        """Return the law with the likeliest noise of each kind of sensor: the weighted squares over their degrees of freedom.

        These are one for a residual, less what its attitude and what the unknowns have taken up of it.
        """
        best = self.settle(state.unknown[0], state.attitude[0])
        weight = self.weights(best.value)
        covariance = np.linalg.inv(self.precision + summed(weight, best.slope))
        by_unknowns = weight[:, None] * ((best.slope @ covariance) * best.slope).sum(axis=2)
        freedom = np.where(self.was_read, 1 - best.taken - by_unknowns, 0.0)
        scatter = []
        for k, old in enumerate(self.scatter):
            of_kind = self.kinds == k
            of_freedom = freedom[:, of_kind].sum()
            square = (weight[:, None] * best.value**2)[:, of_kind].sum()
            ratio = np.sqrt(square / of_freedom) if of_freedom > 3 else 1.0
            scatter.append(float(np.clip(old * ratio, 1e-3, 100)))
        if self.readings.has_field.sum() < FEW:
            scatter[2] = max(scatter[2], FEW_SCATTER)
        return replace(self, scatter=tuple(scatter))

    def stated_unknown(self, unknown: np.ndarray) -> np.ndarray:
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
        unused = toward[None]  # in place of the light
        predicted = Predicted(np.linalg.norm(field_N, axis=1)[None], toward[None], unused)
        inverse = np.linalg.inv(np.eye(3) + unknown[MATRIX].reshape(3, 3))
        field = (self.readings.field - unknown[ZERO]) @ inverse.T * self.unit_T
        return residuals_left(field, self._sun_read(unknown), predicted)

    def triads(self, unknown: np.ndarray) -> np.ndarray:
        """Return attitudes (n, 3, 3) to begin with, by two vectors (TRIAD): the field exactly, the Sun as near as it allows.

        Axes that are made of both in the body and in space are the same axes.
        """
        inverse = np.linalg.inv(np.eye(3) + unknown[MATRIX].reshape(3, 3))
        field_B = np.nan_to_num((self.readings.field - unknown[ZERO]) @ inverse.T)
        sun_B = np.nan_to_num(self._sun_read(unknown))
        field_N, _ = self.sky.field_at(unknown[SHIFT], unknown[DRIFT])
        has_sun = (sun_B != 0).any(axis=1, keepdims=True)
        in_N = _frame(field_N * self.readings.has_field[:, None], self.sky.sun * has_sun)
        return _frame(field_B, sun_B) @ np.swapaxes(in_N, -1, -2)

    def _sun_read(self, unknown: np.ndarray) -> np.ndarray:
        """Return the direction to the Sun (n, 3) that all sensors of a sample have read, weighted; NaN without any."""
        r, sensors = self.readings, self.vehicle.sensors.sun_sensors
        total = np.nan_to_num(r.panel_sun) / r.panel_sigma[:, None] ** 2
        if sensors:
            scale, bias = self._of_sensors(unknown)
            angle = (r.angle - bias) / scale
            known = np.isfinite(angle[..., 0])
            # a sensor's angles are those of the Sun's components x and y over that along the normal
            tangent = np.tan(np.nan_to_num(angle))
            direction = self._axes[:, 2] + np.einsum("nfs,fsi->nfi", tangent, self._axes[:, :2])
            direction /= np.linalg.norm(direction, axis=2, keepdims=True)
            weight = known / np.array([sensor.x_sigma_rad for sensor in sensors]) ** 2
            total = total + (weight[..., None] * direction).sum(axis=1)
        size = np.linalg.norm(total, axis=1, keepdims=True)
        return total / np.where(size > 0, size, np.nan)

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
        """Indices (n, F, 2) of the scales of each angle among the unknowns: a turned sensor has another one for y."""
        turned = self.readings.y_turned
        first = SENSORS + EACH * np.arange(turned.shape[1])
        x_scale, y_scale = np.broadcast_to(first + 2, turned.shape), first + 3 + turned
        return np.stack([x_scale, y_scale], axis=2)

    def _of_sensors(self, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return scale (n, F, 2) and bias (F, 2) of each angle."""
        bias = unknown[SENSORS:].reshape(-1, EACH)[:, :2]
        return 1 + unknown[self._scale_index], bias

    def _in_body(self, unknown: np.ndarray, attitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the directions to the Sun (n, 3) and the fields (n, 3), in units of `unit_T`, in the body."""
        field_N, _ = self.sky.field_at(unknown[SHIFT], unknown[DRIFT])
        sun_B = np.einsum("nij,nj->ni", attitude, self.sky.sun)
        return sun_B, np.einsum("nij,nj->ni", attitude, field_N) / self.unit_T

    def _angles(self, sun: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the true angles (n, F, 2) of Suns (n, 3) at each Sun sensor, and their slopes (n, F, 2, 3) by the Sun.

        The angle of the components a across the sensor and b along its normal is arctan(a / b), of slope (b da - a db) / (a^2 +
        b^2).
        """
        component = np.einsum("fsi,ni->nfs", self._axes, sun)
        a, b = component[..., :2], component[..., 2:]
        across, normal = self._axes[:, :2], self._axes[:, 2:]
        slope = b[..., None] * across - a[..., None] * normal
        square = np.maximum(b**2 + a**2, 1e-6)
        return np.arctan2(a, b), slope / square[..., None]


UP = np.array([0.0, 0.0, 1.0])
"""Any direction, where none was read."""


def _information(by_turn: np.ndarray) -> np.ndarray:
    """Return the information (n, 3, 3) on a sample's attitude from residuals with these slopes (n, R, 3)."""
    information = np.swapaxes(by_turn, -1, -2) @ by_turn
    weak = WEAK + ROUNDING * np.trace(information, axis1=1, axis2=2)
    return information + weak[:, None, None] * np.eye(3)


def summed(weight: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Return the information (D, D) of samples with weights (n) and slopes (n, R, D)."""
    flat = (np.sqrt(weight)[:, None, None] * slope).reshape(-1, slope.shape[2])
    return flat.T @ flat


def _frame(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return axes (n, 3, 3), as columns: along the first vector (n, 3), across both, and across these two.

    A vector that is zero may be any: then the axes are across the other one, or about it, anyhow.
    """
    is_known = (first != 0).any(axis=1, keepdims=True)
    first = np.where(is_known, first, tangent_basis(second + UP * 1e-9)[0])
    x = first / np.linalg.norm(first, axis=1, keepdims=True)
    size = np.linalg.norm(second, axis=1, keepdims=True)
    y = np.cross(x, second / np.where(size > 0, size, 1.0))
    is_parallel = np.linalg.norm(y, axis=1, keepdims=True) < 1e-6
    y = np.where(is_parallel, tangent_basis(x)[0], y)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=2)
