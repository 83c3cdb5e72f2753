"""Field strength, its angle to the Sun, and light: what a sample shows at any attitude, and a magnetometer calibrated by it.

They are what is left of a sample's readings when its attitude is projected out. They depend on the along-track offset of an orbit
alone, so that K offsets can be compared at once. At each of them the magnetometer is fitted: field = matrix reading - zero, where
the matrix holds scale, soft iron and axes. Residuals have Student tails, and the scatter of strength and of angle is estimated.
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
"""Degrees of freedom of residuals: one beacon in eight is worse than a normal law allows."""

MATRIX_SIGMA = 0.2
"""One sigma of each element of the magnetometer's matrix over its scale: soft iron, axes."""

SCALE_INFORMATION = 0.1
"""Information on each element of the matrix that keeps its scale finite: one sigma is three times the field."""

ZERO_SIGMA = 1.0
"""One sigma of the zero over the usual reading, if the vehicle file states none: it may be missing there."""

NOT_SCALE = 8
"""Elements of the matrix in addition to its scale, whose prior is in proportion to it."""

LEAST_SCALE = 1e-3
"""Smallest scale of the matrix over the first one."""

LEAST_SCATTER = np.array([0.003, 0.5])
"""Smallest scatter of the strength, over the field, and of the angle, in sigmas of the Sun: no model is better. Where few samples
have a Sun, a calibration fits their angles nearly exactly, and they would outvote the strength."""

FIRST_SCATTER = (0.1, 1.0)
"""Scatters with which a fit begins."""

SUN_RAD = 0.02
"""Error of every direction to the Sun in addition to the given one, rad."""

SEEN_IN_SHADOW = 0.02
"""Share of samples that show a Sun where there is none: irregular clocks, the Moon, noise."""

FEWEST = 20
"""Fewer readings of field or light, or of the angle between field and Sun, are not compared."""

ROUNDS, STEPS, TOLERANCE = 2, 10, 0.05
"""Alternations of unknowns and scatters, steps of a fit, and the gain in log likelihood that ends it: another verdict needs
more."""

MATRIX, ZERO = slice(0, 9), slice(9, 12)
"""Places of the matrix, by rows, and of the zero among the unknowns."""


class Sky(NamedTuple):
    """Sun and field at n samples for K along-track offsets of an orbit, in Earth-fixed axes.

    `shifts` (K): seconds of flight ahead of the orbit, evenly spaced; the orbit's own drift is included. `sun` (n, 3): unit
    directions; `field` (K, n, 3) in T; `lit` (K, n): visible part of the Sun; `days` (n) from the middle of the file.
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
        """Return the sky at offsets `shifts` (K) of an orbit, or of a comparison orbit: node rotated, `phase_s` ahead."""
        when = orbit.instants(t_s)
        ahead = orbit.ahead_s(when) + phase_s + shifts[:, None]
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
        """Return the field (n, 3) in T at a drifting shift, and its slope (n, 3) in T per second of flight.

        They are those of cubics through four neighbouring shifts. Beyond the first and the last shift the field stays the same.
        """
        step, last = self.shifts[1] - self.shifts[0], len(self.shifts) - 1
        # the shift of each sample in steps from the first one, and the first of its four neighbours
        steps = (shift_s + drift_s_day * self.days - self.shifts[0]) / step
        steps = np.clip(steps, 0.0, last)
        first = np.clip(steps.astype(int) - 1, 0, last - 3)
        powers = np.vander(steps - first, 4, increasing=True)  # 1, x, x^2, x^3, from the first
        slopes = np.column_stack([np.zeros(len(steps)), powers[:, :3] * [1.0, 2.0, 3.0]])
        nodes = self.field[first[:, None] + np.arange(4), np.arange(len(steps))[:, None]]
        value, slope = (np.einsum("nk,nki->ni", part @ CUBIC.T, nodes) for part in (powers, slopes))
        return value, slope / step

    def invariants(self) -> Predicted:
        """Return what samples show at any attitude."""
        toward = (self.field * self.sun).sum(axis=-1)
        return Predicted(np.linalg.norm(self.field, axis=-1), toward, self.lit)


CUBIC = np.linalg.inv(np.vander(np.arange(4.0), 4, increasing=True)).T
"""Row k: coefficients of the cubic that is 1 at node k of 0, 1, 2, 3 and 0 at the others."""


class Predicted(NamedTuple):
    """Predictions at K offsets: field strength (K, n) in T, its component toward the Sun (K, n) in T, visible part of the Sun (K,
    n)."""

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
    """What fits of an orbit at K offsets give: minus their log posterior, and the magnetometer.

    `cost` (K); `calibration` (K, 12): matrix and zero, NaN without a magnetometer; `scatter` (K, 2) of strength, over the field,
    and of the component toward the Sun, in sigmas of the Sun.
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
    """Return the cost of K offsets in addition to that of their `prior` (K), with the magnetometer fitted at each.

    `scatter` (2): as in :class:`OffsetFits`, if it is not to be estimated. The posterior is integrated over all calibrations, not
    taken at the best one: by Laplace's method that adds half the log determinant of the curvature to the cost.
    """
    use = readings.has_field
    cost = prior + eclipse_cost(readings.light, predicted.lit)
    if use.sum() < FEWEST:
        unknown = np.full((len(prior), 12), np.nan)
        return OffsetFits(cost, calibration=unknown, scatter=unknown[:, :2])
    model, state, scales = fit_magnetometer(readings.take(use), predicted.take(use), scatter)
    system = model.linearise(state)
    cost = cost + system.cost + np.linalg.slogdet(system.matrix)[1] / 2
    return OffsetFits(cost, scales.in_T(state.unknown), state.scatter)


def eclipse_cost(light: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Return minus the log likelihood (K) of light (n; 1, 0 or NaN) where a part (K, n) of the Sun's disc is predicted to be seen.

    A sample is dark with a probability that is high in the shadow (:data:`SEEN_IN_SHADOW`). In the Sun, where no panel may look
    there or a panel may be idle, it is the share of sunny samples that are dark, for each offset.
    """
    known = np.isfinite(light)
    dark, sunny = light[known] == 0, part[:, known]
    dark_in_sun = (sunny * dark).sum(axis=1) / np.maximum(sunny.sum(axis=1), 1)
    dark_in_sun = np.clip(dark_in_sun, 0.5 / max(len(dark), 1), 1 - SEEN_IN_SHADOW)[:, None]
    probability_dark = sunny * dark_in_sun + (1 - sunny) * (1 - SEEN_IN_SHADOW)
    log_likelihood = np.where(dark, np.log(probability_dark), np.log1p(-probability_dark))
    return -log_likelihood.sum(axis=1)


# -------------------------------------------------------------------------------------------------------------- the magnetometer


class Scales(NamedTuple):
    """Units of a fit: `reading` that of the readings in theirs, `field_T` that of the field in T."""

    reading: float
    field_T: float

    def in_T(self, unknown: np.ndarray) -> np.ndarray:
        """Return matrix and zero (K, 12): field in T = matrix reading - zero."""
        matrix = (np.eye(3).ravel() + unknown[:, MATRIX]) * self.field_T / self.reading
        return np.concatenate([matrix, self.field_T * unknown[:, ZERO]], axis=1)


class MagnetometerState(NamedTuple):
    """A magnetometer at K offsets, while it is fitted, in the units of :class:`Scales`.

    `unknown` (K, 12): matrix less one, by rows, and zero. `strength`, `toward` (K, n): predictions. `scatter` (K, 2): as in
    :class:`OffsetFits`. `scale` (K): scale of the matrix, with which its soft iron grows; the first one is wrong if the zero is
    large.
    """

    unknown: np.ndarray
    strength: np.ndarray
    toward: np.ndarray
    scatter: np.ndarray
    scale: np.ndarray


def fit_magnetometer(
    readings: Readings, predicted: Predicted, scatter: np.ndarray | None = None
) -> tuple[MagnetometerModel, MagnetometerState, Scales]:
    """Return a magnetometer fitted at each of K offsets by n samples that all have a field: model, fitted state and units.

    `scatter` (2): the scatters of strength and angle, if they are not to be fitted.

    First the strength is fitted as |matrix reading - zero| = predicted strength, which gets near from anywhere. But noise in the
    readings draws such a fit to a matrix that is too small, with far too large a zero (regression dilution). Then, from there, the
    distance of each reading from all readings of that strength is fitted, which has no such error.
    """
    size = np.linalg.norm(readings.field, axis=1)
    usual = float(np.median(size[size > 0])) if (size > 0).any() else 1.0
    scales = Scales(usual, float(np.median(predicted.strength)))
    fit_scatter = scatter is None
    count = len(predicted.strength)  # of offsets
    model = MagnetometerModel(readings, scales, of_readings=False)
    state = MagnetometerState(
        np.zeros((count, 12)),
        predicted.strength / scales.field_T,
        predicted.toward / scales.field_T,
        np.tile(FIRST_SCATTER if scatter is None else scatter, (count, 1)),
        np.ones(count),
    )
    # A fit that begins without a zero may miss one that is several times the field: the better of two starts.
    zero, scale = fit_sphere(readings.field / scales.reading, state.strength)
    unknown = np.column_stack([(scale - 1)[:, None] * np.eye(3).ravel(), scale[:, None] * zero])
    from_sphere = state._replace(unknown=unknown, scale=scale)
    state = model.fit(model.better(state, from_sphere), fit_scatter)

    model = MagnetometerModel(readings, scales, of_readings=True)
    if not fit_scatter:
        return model, model.fit(state, fit_scatter), scales
    state = model.fit(state._replace(scatter=model.scatter(state)), fit_scatter)
    # Each offset may rest in a minimum of its own: begin again from the calibration at the best one.
    best = np.full(count, model.linearise(state).cost.argmin())
    again = {name: getattr(state, name)[best] for name in ("unknown", "scatter", "scale")}
    return model, model.better(state, model.fit(state._replace(**again), fit_scatter)), scales


def fit_sphere(reading: np.ndarray, strength: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the zero (K, 3) of readings (n, 3) and one scale for all axes (K), by field strengths (K, n).

    The condition |scale (reading - zero)| = strength is linear in zero, |zero|^2 and 1 / scale^2. It reads
    |reading|^2 = 2 reading . zero - |zero|^2 + (strength / scale)^2. Where 1 / scale^2 is not positive, the zero is 0 and
    the scale 1.
    """
    design = np.empty((*strength.shape, 5))
    design[..., :3], design[..., 3], design[..., 4] = 2 * reading, 1.0, strength**2
    square = (reading**2).sum(axis=1)
    transposed = np.swapaxes(design, 1, 2)
    normal = transposed @ design
    weak = 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(5)
    best = np.linalg.solve(normal + weak, transposed @ square[:, None])[..., 0]
    inverse_square = best[:, 4]
    is_sphere = inverse_square > 0
    scale = np.where(is_sphere, np.maximum(inverse_square, 1e-12) ** -0.5, 1.0)
    zero = np.where(is_sphere[:, None], best[:, :3], 0.0)
    return zero, scale.clip(LEAST_SCALE, 1 / LEAST_SCALE)


class MagnetometerModel:
    """Residuals of a magnetometer's readings: strength of the field, and its component toward the Sun.

    The residual of the strength is in the field, or, `of_readings`, the distance of a reading from all readings of that strength.
    """

    def __init__(self, readings: Readings, scales: Scales, *, of_readings: bool) -> None:
        self.of_readings = of_readings
        self.reading = readings.field / scales.reading
        self.with_sun = np.isfinite(readings.sun).all(axis=1)
        self.sun = readings.sun[self.with_sun]
        # sigma of the component toward the Sun, over the field: the error of the Sun that tilts it toward the field
        size = np.linalg.norm(self.reading[self.with_sun], axis=1, keepdims=True)
        unit = self.reading[self.with_sun] / np.where(size > 0, size, 1.0)
        across = unit - (unit * self.sun).sum(axis=1, keepdims=True) * self.sun
        covariance = readings.covariance[self.with_sun]
        self.sigma = np.sqrt(np.einsum("ni,nij,nj->n", across, covariance, across) + SUN_RAD**2)
        # Inverse prior covariances. The mean of the diagonal is the scale, which is hardly limited. The prior sigmas of all other
        # elements are in proportion to it: their precision is divided by the square of the scale of each state.
        self.free_precision, self.tied_precision = np.zeros((12, 12)), np.zeros((12, 12))
        self.free_precision[MATRIX, MATRIX] = SCALE_INFORMATION * np.eye(9)
        self.free_precision[ZERO, ZERO] = ZERO_SIGMA**-2 * np.eye(3)
        self.tied_precision[MATRIX, MATRIX] = (
            np.eye(9) - np.outer(ISOTROPIC, ISOTROPIC)
        ) / MATRIX_SIGMA**2

    def residuals(self, state: MagnetometerState) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return two pairs of residuals and Jacobian: of the strength, and of the component toward the Sun of samples that show it.

        They are (K, n) and (K, n, 12) of n samples, or (K, s) and (K, s, 12) of s samples with a Sun. The strength is off in units
        of its scatter. The component toward the Sun is off in units of strength, sigma of the Sun's direction and scatter.
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
        """Return the distance (K, n) of each reading from the nearest one of the predicted strength, in scatters, with Jacobian.

        The field is f = A reading - zero (`field`, (K, n, 3)), in the direction e; A is `matrix` (K, 3, 3). Its strength is wrong
        by off = |f| - strength. |f| rises by at most |g| for a unit of the reading, with g = A^T e. So the distance is off / |g|
        to first order. |g| depends on the unknowns too: e turns with f, and A stands in g. Therefore

            |g| d|g| / df = (A g - |g|^2 e) / |f|        |g| d|g| / dA = e g^T.
        """
        length, unit = _length_and_direction(field)
        off = length - state.strength
        steepest = unit @ matrix  # g
        steepness = np.maximum(np.linalg.norm(steepest, axis=2), 1e-9)
        turning = steepest @ np.swapaxes(matrix, 1, 2) - (steepness**2)[..., None] * unit
        # |g| times the derivative of off / |g| by f
        by_field = unit - (off / length / steepness**2)[..., None] * turning
        size = (steepness * state.scatter[:, :1])[..., None]  # |g| times the scatter
        by_unknown = _jacobian_along(by_field / size, self.reading)
        # the part by A that comes from |g| alone
        outer = unit[..., :, None] * steepest[..., None, :]
        of_matrix = (off / steepness**2)[..., None, None] / size[..., None] * outer
        by_unknown[..., MATRIX] -= of_matrix.reshape(*off.shape, 9)
        return off / size[..., 0], by_unknown

    def linearise(self, state: MagnetometerState) -> DenseSystem:
        """Return the normal equations of minus the log posterior; Student's law by its weights."""
        matrix = self.free_precision + self.tied_precision / state.scale[:, None, None] ** 2
        slope = (matrix @ state.unknown[..., None])[..., 0]
        # the prior of the other elements is as wide as the scale: its density has the factor 1 / scale for each of them
        cost = (slope * state.unknown).sum(axis=1) / 2 + NOT_SCALE * np.log(state.scale)
        for k, (residual, jacobian) in enumerate(self.residuals(state)):
            cost = cost + (STUDENT + 1) / 2 * np.log1p(residual**2 / STUDENT).sum(axis=1)
            cost = cost + residual.shape[1] * np.log(state.scatter[:, k])
            weighed = np.swapaxes(jacobian * student_weight(residual)[..., None], 1, 2)
            slope = slope + (weighed @ residual[..., None])[..., 0]
            matrix = matrix + weighed @ jacobian
        return DenseSystem(cost, matrix, slope)

    def fit(self, state: MagnetometerState, fit_scatter: bool) -> MagnetometerState:
        """Return the state with unknowns and scale fitted and, if `free`, the scatters, in turn."""
        for _ in range(ROUNDS if fit_scatter else 1):
            solution = least_squares(
                self.linearise, _stepped, solve_dense, state, steps=STEPS, tolerance=TOLERANCE
            )
            state = solution.state
            scatter = self.scatter(state) if fit_scatter else state.scatter
            matrix = np.eye(3) + state.unknown[:, MATRIX].reshape(-1, 3, 3)
            scale = np.cbrt(np.abs(np.linalg.det(matrix)))
            state = state._replace(scatter=scatter, scale=np.maximum(scale, LEAST_SCALE))
        return state

    def scatter(self, state: MagnetometerState) -> np.ndarray:
        """Return the likeliest scatters (K, 2), given the weights of residuals and how much of them has been fitted."""
        covariance, scatters = np.linalg.inv(self.linearise(state).matrix), []
        for k, (residual, jacobian) in enumerate(self.residuals(state)):
            weight = student_weight(residual)
            freedom = residual.shape[1] - ((jacobian @ covariance) * jacobian).sum(axis=(1, 2))
            square = (weight * residual**2).sum(axis=1) / np.maximum(freedom, 1.0)
            rms = np.sqrt(square) if residual.shape[1] else 1.0
            scatters.append(np.maximum(state.scatter[:, k] * rms, LEAST_SCATTER[k]))
        return np.stack(scatters, axis=1)

    def better(self, first: MagnetometerState, second: MagnetometerState) -> MagnetometerState:
        """Return, at each offset, the state that costs less."""
        second_is_better = self.linearise(second).cost < self.linearise(first).cost
        offsets = np.flatnonzero(second_is_better)
        return replace_problems(first, offsets, take_problems(second, offsets))


ISOTROPIC = np.eye(3).ravel() / np.sqrt(3)
"""Direction of the scale among the nine elements of a matrix."""


def _length_and_direction(field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return lengths (K, n), which are never zero, and directions (K, n, 3) of fields (K, n, 3)."""
    length = np.maximum(np.linalg.norm(field, axis=2), 1e-9)
    return length, field / length[..., None]


def _jacobian_along(direction: np.ndarray, reading: np.ndarray) -> np.ndarray:
    """Return the derivative (K, m, 12) by the unknowns of the fields' components along vectors (K, m, 3), at readings (m, 3).

    As field = (1 + M) reading - zero, the component along v changes by v reading^T dM and by -v dzero.
    """
    jacobian = np.empty((*direction.shape[:2], 12))
    by_matrix = direction[..., :, None] * reading[:, None, :]
    jacobian[..., MATRIX] = by_matrix.reshape(*direction.shape[:2], 9)
    jacobian[..., ZERO] = -direction
    return jacobian


def _stepped(state: MagnetometerState, step: np.ndarray) -> MagnetometerState:
    """Return the state with its unknowns moved by a step (K, 12)."""
    return state._replace(unknown=state.unknown + step)


def student_weight(residual: np.ndarray) -> np.ndarray:
    """Return how much residuals (...), in units of their scatter, count under Student's law."""
    return (STUDENT + 1) / (STUDENT + residual**2)


def field_sun_angles(field: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """Return the angles (n) in rad between fields and Suns (n, 3), NaN if one is not known."""
    cosine = (field * sun).sum(axis=-1) / np.linalg.norm(field, axis=-1)
    return np.arccos(np.clip(cosine, -1, 1))


def calibrated_field(reading: np.ndarray, calibration: np.ndarray) -> np.ndarray:
    """Return fields (n, 3) in T of readings (n, 3) by matrix and zero (12)."""
    return reading @ calibration[MATRIX].reshape(3, 3).T - calibration[ZERO]


def median_residuals(
    field: np.ndarray, sun: np.ndarray, predicted: Predicted
) -> tuple[float, float]:
    """Return the median absolute residuals of fields (n, 3) in T at the first offset: of strength (T) and angle to the Sun (rad).

    `sun` (n, 3): NaN where it was not read; the second is NaN if no sample shows both.
    """
    strength = np.abs(np.linalg.norm(field, axis=1) - predicted.strength[0])
    angle = np.abs(field_sun_angles(field, sun) - predicted.angles())
    any_angle = np.isfinite(angle).any()
    return float(np.nanmedian(strength)), float(np.nanmedian(angle)) if any_angle else np.nan
