"""Invariants of a sample, which do not depend on its attitude, and a magnetometer calibrated by them.

They are the strength of the field, its angle to the Sun, and whether the Sun is up. An orbit predicts them but for its along-track
offset, so that K offsets can be compared at once. At each of them the magnetometer is fitted: field = matrix reading - zero, where
the matrix holds scale, soft iron and axes. Residuals follow Student's law, and their scatter (noise) is estimated for the strength
and for the angle. The angle enters as the field's component toward the Sun, which is linear in the unknowns.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sunspin.environment.earth import earth_from_J2000, rotate_vectors, sun_J2000_m
from sunspin.environment.light import sunlit_fraction
from sunspin.environment.orbit import Orbit
from sunspin.estimate.orbit.readings import Readings
from sunspin.solve.least_squares import least_squares, replace_problems, take_problems
from sunspin.solve.linear import DenseSystem, solve_dense

STUDENT = 4.0
"""Degrees of freedom of Student's law for residuals: one sample in eight of beacons is worse than a normal law allows."""

MATRIX_SIGMA = 0.2
"""One sigma of each element of the magnetometer's matrix, relative to its scale: soft iron and axes that are off."""

SCALE_INFORMATION = 0.1
"""Prior information (1 / sigma^2) on each element of the matrix, which keeps its scale finite: sigma is 3, the first scale 1."""

ZERO_SIGMA = 1.0
"""One sigma of the zero, relative to the usual reading, if the vehicle file states none: it may be missing there."""

NOT_SCALE = 8
"""Number of independent elements of the matrix in addition to its scale. Their prior sigmas are in proportion to the scale."""

LEAST_SCALE = 1e-3
"""Smallest scale of the matrix, relative to the first one."""

LEAST_SCATTER = np.array([0.003, 0.5])
"""Smallest scatter of the strength, relative to the field, and of the component toward the Sun, in sigmas of the Sun's direction:
no model is better. If few samples have a Sun, a calibration fits their angles nearly exactly, and these outvote the strength."""

FIRST_SCATTER = (0.1, 1.0)
"""Scatters, as in `LEAST_SCATTER`, with which a fit begins."""

SUN_RAD = 0.02
"""Error of every direction to the Sun in addition to the given one, rad."""

SEEN_IN_SHADOW = 0.02
"""Share of samples that show a Sun where there is none: irregular clocks, the Moon, noise."""

FEWEST = 20
"""With fewer readings of field or light, or of the angle between field and Sun, an orbit is not judged by them."""

ROUNDS, STEPS, TOLERANCE = 2, 10, 0.05
"""Alternations of unknowns and scatters, steps of a fit, and the gain in log likelihood that ends it: less changes no verdict."""

MATRIX, ZERO = slice(0, 9), slice(9, 12)
"""Slices of the matrix, by rows, and of the zero among the unknowns."""


class Sky(NamedTuple):
    """Sun and field at n samples for K along-track offsets of an orbit, in Earth-fixed axes.

    `shifts` (K): offsets in addition to the orbit's own, in seconds of flight, evenly spaced. `sun` (n, 3): unit directions;
    `field` (K, n, 3) in T; `lit` (K, n): visible part of the Sun's disc, 0 to 1; `days` (n): time from the middle of the file.
    """

    shifts: np.ndarray
    sun: np.ndarray
    field: np.ndarray
    lit: np.ndarray
    days: np.ndarray

    @classmethod
    def along(
        cls,
        orbit: Orbit,
        t_s: np.ndarray,
        shifts: np.ndarray,
        node_rad: float = 0.0,
        phase_s: float = 0.0,
    ) -> Sky:
        """Return the sky at times `t_s` (n), s from the epoch, with the satellite `shifts` (K) s ahead of where `orbit` has it.

        For a copy with which the orbit is compared: its node is rotated by `node_rad`, its satellite another `phase_s` ahead.
        """
        when = orbit.instants(t_s)
        ahead = orbit.ahead_s(when) + phase_s + shifts[:, None]  # (K, n)
        position, _ = replace(orbit, node_rad=orbit.node_rad + node_rad).states(when, ahead)
        sun, to_earth = sun_J2000_m(when), earth_from_J2000(when)
        direction = rotate_vectors(to_earth, sun / np.linalg.norm(sun, axis=1, keepdims=True))
        field = orbit.field_map_around(when, position).at(rotate_vectors(to_earth, position))
        lit = sunlit_fraction(position, np.broadcast_to(sun, position.shape))
        return cls(shifts, direction, field, lit, orbit.days(when))

    def take(self, which: np.ndarray) -> Sky:
        """Return some of the samples."""
        lit, field = self.lit[:, which], self.field[:, which]
        return Sky(self.shifts, self.sun[which], field, lit, self.days[which])

    def field_at(self, shift_s: float, drift_s_day: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Return the field (n, 3) in T at the offset `shift_s` + `drift_s_day` days, and its derivative (n, 3) by the offset, T/s.

        Cubics through four neighbouring shifts interpolate. Beyond the first and the last shift the field stays the same.
        """
        step, last = self.shifts[1] - self.shifts[0], len(self.shifts) - 1
        # the shift of each sample in steps from the first one, and the first of its four neighbours
        steps = (shift_s + drift_s_day * self.days - self.shifts[0]) / step
        steps = np.clip(steps, 0.0, last)
        first = np.clip(steps.astype(int) - 1, 0, last - 3)
        powers = np.vander(steps - first, 4, increasing=True)  # 1, x, x^2, x^3, from the first
        slopes = np.column_stack([np.zeros(len(steps)), powers[:, :3] * [1.0, 2.0, 3.0]])
        # fields (n, 4, 3) at the four shifts; CUBIC turns powers of x into their weights
        nodes = self.field[first[:, None] + np.arange(4), np.arange(len(steps))[:, None]]
        value, slope = (np.einsum("nk,nki->ni", part @ CUBIC.T, nodes) for part in (powers, slopes))
        return value, slope / step

    def invariants(self) -> Predicted:
        """Return what the samples show at any attitude: field strength, its component toward the Sun, light."""
        toward = (self.field * self.sun).sum(axis=-1)
        return Predicted(np.linalg.norm(self.field, axis=-1), toward, self.lit)


CUBIC = np.linalg.inv(np.vander(np.arange(4.0), 4, increasing=True)).T
"""Row k: coefficients of the cubic that is 1 at node k of 0, 1, 2, 3 and 0 at the others."""


class Predicted(NamedTuple):
    """Predictions (K, n) at K offsets: field strength and its component toward the Sun in T, and visible part of the Sun's disc."""

    strength: np.ndarray
    toward: np.ndarray
    lit: np.ndarray

    def at(self, offsets: Any) -> Predicted:
        """Return the predictions at some of the offsets, by index or slice."""
        return Predicted(*(part[offsets] for part in self))

    def take(self, which: np.ndarray) -> Predicted:
        """Return the predictions for some samples."""
        return Predicted(*(part[:, which] for part in self))

    def angles(self) -> np.ndarray:
        """Return the angles (n) in rad between field and Sun at the first offset."""
        return np.arccos(np.clip(self.toward[0] / self.strength[0], -1, 1))


class OffsetFits(NamedTuple):
    """Fits of an orbit at K offsets: their `cost` (K), minus the log posterior, and the magnetometer fitted at each.

    `calibration` (K, 12): field in T = matrix reading - zero, the matrix by rows and the zero in T; NaN without a magnetometer.
    `scatter` (K, 2): noise of the strength, relative to the field, and of the component toward the Sun, in sigmas of the Sun.
    """

    cost: np.ndarray
    calibration: np.ndarray
    scatter: np.ndarray

    @property
    def best(self) -> int:
        """Index of the offset with the lowest cost."""
        return int(self.cost.argmin())


def fit_at_offsets(
    readings: Readings, predicted: Predicted, prior: np.ndarray, scatter: np.ndarray | None = None
) -> OffsetFits:
    """Return the fits of an orbit at K offsets by light and field, with the magnetometer fitted at each.

    `prior` (K): cost of the offsets by their prior, to which that of the readings is added. `scatter` (2): as in
    :class:`OffsetFits`, if it is not to be estimated. The posterior is integrated over all calibrations, not taken at the best one:
    by Laplace's method that adds half the log determinant of the curvature to the cost.
    """
    use = readings.has_field
    cost = prior + eclipse_cost(readings.light, predicted.lit)
    if use.sum() < FEWEST:
        unknown = np.full((len(prior), 12), np.nan)
        return OffsetFits(cost, calibration=unknown, scatter=unknown[:, :2])
    model, state = fit_magnetometer(readings.take(use), predicted.take(use), scatter)
    system = model.linearise(state)
    cost = cost + system.cost + np.linalg.slogdet(system.matrix)[1] / 2
    return OffsetFits(cost, model.calibration(state), state.scatter)


def eclipse_cost(light: np.ndarray, lit: np.ndarray) -> np.ndarray:
    """Return the cost (K), minus the log likelihood, of which samples are sunlit or dark, at each of K along-track offsets.

    `light` (n): 1 if a sample shows the Sun, 0 if it is dark, NaN if unknown. `lit` (K, n): predicted visible part of the Sun's
    disc, taken as the probability that the satellite is in sunlight. In the Earth's shadow all samples are dark but the share
    :data:`SEEN_IN_SHADOW`. In sunlight a sample may be dark too, if no panel faces the Sun or delivers power. The probability of
    that is estimated for each offset: the share of dark samples among those predicted in sunlight.
    """
    known = np.isfinite(light)
    dark, sunny = light[known] == 0, lit[:, known]
    dark_in_sun = (sunny * dark).sum(axis=1) / np.maximum(sunny.sum(axis=1), 1)
    # at least half a sample among all, at most the probability of darkness in the shadow: no dark or sunlit sample is impossible
    dark_in_sun = np.clip(dark_in_sun, 0.5 / max(len(dark), 1), 1 - SEEN_IN_SHADOW)[:, None]
    probability_dark = sunny * dark_in_sun + (1 - sunny) * (1 - SEEN_IN_SHADOW)
    log_likelihood = np.where(dark, np.log(probability_dark), np.log1p(-probability_dark))
    return -log_likelihood.sum(axis=1)


# -------------------------------------------------------------------------------------------------------------- the magnetometer


class MagnetometerState(NamedTuple):
    """A magnetometer at K offsets while it is fitted, in the units of a :class:`MagnetometerModel`.

    `unknown` (K, 12): M by rows, and zero, of field = (1 + M) reading - zero. `strength`, `toward` (K, n): predictions. `scatter`
    (K, 2): as in :class:`OffsetFits`. `scale` (K): of the matrix 1 + M at the last round, to which its prior is in proportion.
    """

    unknown: np.ndarray
    strength: np.ndarray
    toward: np.ndarray
    scatter: np.ndarray
    scale: np.ndarray


def fit_magnetometer(
    readings: Readings, predicted: Predicted, scatter: np.ndarray | None = None
) -> tuple[MagnetometerModel, MagnetometerState]:
    """Return a magnetometer fitted at each of K offsets by n samples that all have a field: the model, and the fitted state.

    `scatter` (2): as in :class:`OffsetFits`; None: it is fitted too. No first guess is needed. The first fit makes |matrix reading
    - zero| equal to the predicted strength, and gets near from anywhere. But noise of the readings makes its matrix too small, and
    its zero far too large (regression dilution). The second fit begins there, and has no such error. Its residual is the distance
    of each reading from the nearest one that has the predicted strength.
    """
    size = np.linalg.norm(readings.field, axis=1)
    usual = float(np.median(size[size > 0])) if (size > 0).any() else 1.0
    usual_T = float(np.median(predicted.strength))
    fit_scatter = scatter is None
    count = len(predicted.strength)  # of offsets
    model = MagnetometerModel(readings, usual, usual_T, of_readings=False)
    state = MagnetometerState(
        np.zeros((count, 12)),
        predicted.strength / usual_T,
        predicted.toward / usual_T,
        np.tile(FIRST_SCATTER if scatter is None else scatter, (count, 1)),
        np.ones(count),
    )
    # A fit that begins without a zero may miss one that is several times the field: the better of two starts is used. The second
    # has field = scale (reading - zero).
    zero, scale = fit_sphere(readings.field / usual, state.strength)
    unknown = np.column_stack([(scale - 1)[:, None] * np.eye(3).ravel(), scale[:, None] * zero])
    from_sphere = state._replace(unknown=unknown, scale=scale)
    state = model.fit(model.better(state, from_sphere), fit_scatter=fit_scatter)

    model = MagnetometerModel(readings, usual, usual_T, of_readings=True)
    if not fit_scatter:
        return model, model.fit(state, fit_scatter=False)
    state = model.fit(state._replace(scatter=model.scatter(state)), fit_scatter=True)
    # Each offset may rest in a minimum of its own: begin again from the calibration at the best one.
    best = np.full(count, model.linearise(state).cost.argmin())
    start = {name: getattr(state, name)[best] for name in ("unknown", "scatter", "scale")}
    return model, model.better(state, model.fit(state._replace(**start), fit_scatter=True))


def fit_sphere(reading: np.ndarray, strength: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fit |scale (reading - zero)| = strength; return the zero (K, 3), in the unit of readings, and the scale (K) of all axes.

    `reading` (n, 3); `strength` (K, n) of the field; both in units of their usual size. Squared, the condition is |reading|^2 = 2
    reading . zero - |zero|^2 + strength^2 / scale^2. With -|zero|^2 as an unknown of its own it is linear in five unknowns: zero,
    -|zero|^2 and 1 / scale^2. If least squares give no positive 1 / scale^2, the zero is 0 and the scale 1. The scale is limited
    to between `LEAST_SCALE` and 1 / `LEAST_SCALE`.
    """
    design = np.empty((*strength.shape, 5))
    design[..., :3], design[..., 3], design[..., 4] = 2 * reading, 1.0, strength**2
    square = (reading**2).sum(axis=1)
    transposed = np.swapaxes(design, 1, 2)
    normal = transposed @ design
    # a weak prior, which keeps the matrix invertible
    weak = 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(5)
    best = np.linalg.solve(normal + weak, transposed @ square[:, None])[..., 0]
    inverse_square = best[:, 4]
    is_sphere = inverse_square > 0
    scale = np.where(is_sphere, np.maximum(inverse_square, 1e-12) ** -0.5, 1.0)
    zero = np.where(is_sphere[:, None], best[:, :3], 0.0)
    return zero, scale.clip(LEAST_SCALE, 1 / LEAST_SCALE)


class MagnetometerModel:
    """Residuals of a magnetometer's readings at K offsets: strength of the field, and its component toward the Sun.

    The residual of the strength is that of the field; if `of_readings`, it is the distance of a reading from the nearest one of the
    predicted strength. Readings are in units of `unit` (in their own unit), fields in units of `unit_T` (T).
    """

    def __init__(
        self, readings: Readings, unit: float, unit_T: float, *, of_readings: bool
    ) -> None:
        self.unit, self.unit_T, self.of_readings = unit, unit_T, of_readings
        self.reading = readings.field / unit
        self.with_sun = np.isfinite(readings.sun).all(axis=1)
        self.sun = readings.sun[self.with_sun]
        # Sigma (s) of the component toward the Sun, relative to the field. An error e of the Sun direction changes the component by
        # e . field: only its part across the Sun counts.
        size = np.linalg.norm(self.reading[self.with_sun], axis=1, keepdims=True)
        direction = self.reading[self.with_sun] / np.where(size > 0, size, 1.0)
        across = direction - (direction * self.sun).sum(axis=1, keepdims=True) * self.sun
        covariance = readings.covariance[self.with_sun]
        self.sigma = np.sqrt(np.einsum("ni,nij,nj->n", across, covariance, across) + SUN_RAD**2)
        # Inverse prior covariances of the unknowns. The mean of the matrix's diagonal is the scale, which is hardly limited. The
        # prior sigmas of all other elements are in proportion to it: `tied_precision` is for a scale of one.
        self.free_precision, self.tied_precision = np.zeros((12, 12)), np.zeros((12, 12))
        self.free_precision[MATRIX, MATRIX] = SCALE_INFORMATION * np.eye(9)
        self.free_precision[ZERO, ZERO] = ZERO_SIGMA**-2 * np.eye(3)
        self.tied_precision[MATRIX, MATRIX] = (
            np.eye(9) - np.outer(ISOTROPIC, ISOTROPIC)
        ) / MATRIX_SIGMA**2

    def calibration(self, state: MagnetometerState) -> np.ndarray:
        """Return matrix by rows and zero (K, 12) of a state: field in T = matrix reading - zero."""
        matrix = (np.eye(3).ravel() + state.unknown[:, MATRIX]) * self.unit_T / self.unit
        return np.concatenate([matrix, self.unit_T * state.unknown[:, ZERO]], axis=1)

    def residuals(self, state: MagnetometerState) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return residuals and their Jacobian by the unknowns, twice: of the strength, and of the component toward the Sun.

        The first are (K, n) and (K, n, 12), in units of the strength's scatter; the second are (K, s) and (K, s, 12) of the s
        samples with a Sun, in units of strength, sigma of the Sun's direction and scatter.
        """
        matrix = np.eye(3) + state.unknown[:, MATRIX].reshape(-1, 3, 3)
        field = self.reading @ np.swapaxes(matrix, 1, 2) - state.unknown[:, None, ZERO]
        if self.of_readings:
            of_strength = self._distance_of_readings(state, matrix, field)
        else:
            length, unit = _length_and_direction(field)
            scatter = state.scatter[:, :1]
            by_unknown = _jacobian_along(unit / scatter[..., None], self.reading)
            of_strength = (length - state.strength) / scatter, by_unknown

        sigma = state.strength[:, self.with_sun] * self.sigma * state.scatter[:, 1:]
        toward = (field[:, self.with_sun] * self.sun).sum(axis=2) - state.toward[:, self.with_sun]
        direction = self.sun / sigma[..., None]
        of_toward = toward / sigma, _jacobian_along(direction, self.reading[self.with_sun])
        return [of_strength, of_toward]

    def _distance_of_readings(
        self, state: MagnetometerState, matrix: np.ndarray, field: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the distance (K, n) of each reading from the nearest one of the predicted strength, in scatters, and its Jacobian.

        The field is f = A reading - zero (`field`, (K, n, 3)), with A = `matrix` (K, 3, 3) and the direction e = f / |f|. Its
        strength differs from the prediction by d = |f| - strength. |f| rises by at most |g| for a unit of the reading, with the
        gradient g = A^T e. So the distance is d / |g| to first order. |g| depends on the unknowns too, through e and through A:

            |g| d|g| / df = (A g - |g|^2 e) / |f|        |g| d|g| / dA = e g^T.
        """
        length, unit = _length_and_direction(field)
        difference = length - state.strength  # d
        gradient = unit @ matrix  # g
        size = np.maximum(np.linalg.norm(gradient, axis=2), 1e-9)  # |g|
        # A g - |g|^2 e
        by_turn = gradient @ np.swapaxes(matrix, 1, 2) - (size**2)[..., None] * unit
        # |g| times the derivative of d / |g| by f
        by_field = unit - (difference / length / size**2)[..., None] * by_turn
        divisor = (size * state.scatter[:, :1])[..., None]  # |g| times the scatter
        by_unknown = _jacobian_along(by_field / divisor, self.reading)
        # the part of the derivative by A that is not through f
        outer = unit[..., :, None] * gradient[..., None, :]  # e g^T
        of_matrix = (difference / size**2)[..., None, None] / divisor[..., None] * outer
        by_unknown[..., MATRIX] -= of_matrix.reshape(*difference.shape, 9)
        return difference / divisor[..., 0], by_unknown

    def linearise(self, state: MagnetometerState) -> DenseSystem:
        """Return the normal equations of minus the log posterior; residuals have the weights of Student's law."""
        matrix = self.free_precision + self.tied_precision / state.scale[:, None, None] ** 2
        slope = (matrix @ state.unknown[..., None])[..., 0]
        # the prior of the other elements is as wide as the scale: its density has the factor 1 / scale for each of them
        cost = (slope * state.unknown).sum(axis=1) / 2 + NOT_SCALE * np.log(state.scale)
        for k, (residual, jacobian) in enumerate(self.residuals(state)):
            cost = cost + (STUDENT + 1) / 2 * np.log1p(residual**2 / STUDENT).sum(axis=1)
            cost = cost + residual.shape[1] * np.log(state.scatter[:, k])
            weighted = np.swapaxes(jacobian * student_weight(residual)[..., None], 1, 2)
            slope = slope + (weighted @ residual[..., None])[..., 0]
            matrix = matrix + weighted @ jacobian
        return DenseSystem(cost, matrix, slope)

    def fit(self, state: MagnetometerState, *, fit_scatter: bool) -> MagnetometerState:
        """Return the state with the unknowns and then the scale fitted, and with `fit_scatter` the scatters too, in two rounds."""
        for _ in range(ROUNDS if fit_scatter else 1):
            state = least_squares(
                self.linearise,
                lambda state, step: state._replace(unknown=state.unknown + step),
                solve_dense,
                state,
                steps=STEPS,
                tolerance=TOLERANCE,
            ).state
            scatter = self.scatter(state) if fit_scatter else state.scatter
            matrix = np.eye(3) + state.unknown[:, MATRIX].reshape(-1, 3, 3)
            scale = np.cbrt(np.abs(np.linalg.det(matrix)))
            state = state._replace(scatter=scatter, scale=np.maximum(scale, LEAST_SCALE))
        return state

    def scatter(self, state: MagnetometerState) -> np.ndarray:
        """Return the likeliest scatters (K, 2): weighted squares of the residuals over their degrees of freedom.

        Each residual has one degree of freedom less its leverage, jacobian covariance jacobian^T.
        """
        covariance, scatters = np.linalg.inv(self.linearise(state).matrix), []
        for k, (residual, jacobian) in enumerate(self.residuals(state)):
            weight = student_weight(residual)
            freedom = residual.shape[1] - ((jacobian @ covariance) * jacobian).sum(axis=(1, 2))
            square = (weight * residual**2).sum(axis=1) / np.maximum(freedom, 1.0)
            rms = np.sqrt(square) if residual.shape[1] else 1.0
            scatters.append(np.maximum(state.scatter[:, k] * rms, LEAST_SCATTER[k]))
        return np.stack(scatters, axis=1)

    def better(self, first: MagnetometerState, second: MagnetometerState) -> MagnetometerState:
        """Return the state that has, at each of the K offsets, the unknowns of whichever of two states costs less."""
        second_is_better = self.linearise(second).cost < self.linearise(first).cost
        offsets = np.flatnonzero(second_is_better)
        return replace_problems(first, offsets, take_problems(second, offsets))


ISOTROPIC = np.eye(3).ravel() / np.sqrt(3)
"""Unit vector (9) of a change of scale among the elements of a matrix by rows."""


def _length_and_direction(field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lengths (K, n), at least 1e-9 so that they can be divided by, and the directions (K, n, 3) of fields (K, n, 3)."""
    length = np.maximum(np.linalg.norm(field, axis=2), 1e-9)
    return length, field / length[..., None]


def _jacobian_along(v: np.ndarray, reading: np.ndarray) -> np.ndarray:
    """Return the derivatives (K, n, 12) of v . field by the unknowns M and zero, for vectors `v` (K, n, 3) and readings (n, 3).

    The field is (1 + M) reading - zero, so that v . field changes by v_i reading_j dM_ij and by -v . dzero.
    """
    jacobian = np.empty((*v.shape[:2], 12))
    by_matrix = v[..., :, None] * reading[:, None, :]
    jacobian[..., MATRIX] = by_matrix.reshape(*v.shape[:2], 9)
    jacobian[..., ZERO] = -v
    return jacobian


def student_weight(residual: np.ndarray) -> np.ndarray:
    """Return the weights (...) in least squares of residuals (...), in units of their scatter, that follow Student's law."""
    return (STUDENT + 1) / (STUDENT + residual**2)


def field_sun_angles(field: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """Return the angles (n) in rad between fields (n, 3) and unit directions to the Sun (n, 3); NaN if one is not known."""
    cosine = (field * sun).sum(axis=-1) / np.linalg.norm(field, axis=-1)
    return np.arccos(np.clip(cosine, -1, 1))


def calibrated_field(reading: np.ndarray, calibration: np.ndarray) -> np.ndarray:
    """Return fields (n, 3) in T of readings (n, 3): matrix reading - zero. `calibration` (12): matrix by rows, and zero."""
    return reading @ calibration[MATRIX].reshape(3, 3).T - calibration[ZERO]


def median_residuals(
    field: np.ndarray, sun: np.ndarray, predicted: Predicted
) -> tuple[float, float]:
    """Return the median absolute residuals of the strength (T) of fields (n, 3) in T, and of their angle to the Sun (rad).

    `sun` (n, 3): unit directions, NaN if not read; the second is NaN if no sample shows both. `predicted`: at its first offset.
    """
    strength = np.abs(np.linalg.norm(field, axis=1) - predicted.strength[0])
    angle = np.abs(field_sun_angles(field, sun) - predicted.angles())
    median_angle = float(np.nanmedian(angle)) if np.isfinite(angle).any() else np.nan
    return float(np.nanmedian(strength)), median_angle
