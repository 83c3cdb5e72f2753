"""Fits of a lander's motions: one state at the reference, from which the equations of motion reach every sample.

The cost of a motion is minus the log of its posterior density: that of each reading (:meth:`PanelPowers.law`) and the prior of the
unknowns. Damped least squares lowers it for K motions at once. Derivatives of the motion are computed once, by differences of
runs (integrations of the equations of motion). After each step they are corrected by the change that the step has made (Broyden
1965, Math. Comp. 19, 577), so that a step takes one run. The noise is no unknown of a step: afterwards it gets its best value.

Shapes: a motion has D coordinates (:mod:`sunspin.estimate.lander.motions`), of which F are free in a fit. The first c of these
change the motion, the others (gains, brightness, misalignments) only the readings. R residuals are predicted less read numbers in
sigmas: of p panels at each of n samples, then of other observations. The `track` (K, n, w) is what sensors depend on: the direction
to the Sun at each sample (w = 3), and the rate too if it is needed (w = 6); `track_slopes` (K, c, n, w) are its derivatives. It is
an array, not the class `Track` of :mod:`sunspin.estimate.model`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sunspin.estimate.lander.model import LanderModel, Sizes
from sunspin.estimate.lander.motions import RATE, STATE_SIZE, SUN, UNKNOWNS, LanderMotions
from sunspin.estimate.terms.powers import LARGEST_LOG_NOISE, SunStates
from sunspin.solve.least_squares import least_squares, limit_length, take_problems
from sunspin.solve.linear import DenseSystem, solve_dense
from sunspin.solve.rotations import cross, move_on_sphere, tangent_basis

TRACK_SUN, TRACK_RATE = slice(0, 3), slice(3, None)
"""Slices of `track`: direction to the Sun and rate (rad/s) at a sample."""

RATE_STEP = 3e-4
"""Step of the differences in rates, as a rotation (rad) over the window. Second-order terms are a thousandth of the derivative."""

UNKNOWN_STEP, UNKNOWN_STEP_S, LARGEST_UNKNOWN_STEP = 1e-4, 2700.0, 3e-3
"""Step of the differences in unknowns, in sigmas, for windows of `UNKNOWN_STEP_S` or more. For shorter ones it is larger, in
inverse proportion to the length, up to `LARGEST_UNKNOWN_STEP`."""

SEARCH_ERROR, FINAL_ERROR = 1e-3, 1e-5
"""Largest error of directions (rad) in runs of a search and of draws, and of the fit to all samples; real errors are fifty times
smaller. It is a tenth of that in runs whose differences give derivatives."""

FLOOR = 1e-9
"""Part of the largest curvature that is added to all, so that directions which no reading determines do not change."""

INSIDE = 0.95
"""Fits go up to this part of the distance to bodies that cannot exist, so that most draws about them can."""

LARGEST_TURN = 0.5
"""rad by which one step may rotate the Sun within the window; the limit of an unknown is one sigma."""

NUMBERS_AT_ONCE, ROWS_AT_ONCE = 2_500_000, 1024
"""Numbers of derivatives, and motions, that one thread holds in memory at once, at most."""


def states_of(track: np.ndarray) -> SunStates:
    """Return `track` (K, n, w) as directions to the Sun and rates."""
    return SunStates.of(track[..., TRACK_SUN], track[..., TRACK_RATE])


class FitState(NamedTuple):
    """K motions of a fit after a `step` (K, c), and what is known from before it.

    `track_before` (K, n, w): track before the step; `track_slopes` (K, c, n, w): its derivatives there. The change of the track by
    the step will correct these; a step of zero corrects nothing. Step and derivatives are along the tangents at the new directions.
    """

    omega: np.ndarray
    sun: np.ndarray
    u: np.ndarray
    track_slopes: np.ndarray
    track_before: np.ndarray
    step: np.ndarray

    @property
    def motions(self) -> LanderMotions:
        """Return the motions without derivatives."""
        return LanderMotions(self.omega, self.sun, self.u)


class LinearReadings(NamedTuple):
    """Readings of K motions to first order, from `track` and `track_slopes`.

    `residuals` (K, R) in stated sigmas and their derivatives `jacobian` (K, R, F) are zero for motions not `computed` (K).
    """

    residuals: np.ndarray
    jacobian: np.ndarray
    computed: np.ndarray
    track_slopes: np.ndarray
    track: np.ndarray


@dataclass(frozen=True)
class FitProblem:
    """A least-squares problem: motions are fitted to the samples of a model, with rate, direction and some unknowns free.

    `free_unknowns` (m): which unknowns are free; the noise never is. `error_rad`: largest error of directions in runs. `sizes`: the
    prior sigma to use for unknowns with several (:meth:`LanderModel.prior_cost`).
    """

    model: LanderModel
    free_unknowns: np.ndarray
    error_rad: float = SEARCH_ERROR
    sizes: Sizes = field(default_factory=dict)

    @cached_property
    def fitted_unknowns(self) -> np.ndarray:
        """Return the indices of the unknowns that steps change, in rising order: the free ones but for the noise."""
        noise = self.model.indices("noise")
        return np.setdiff1d(np.flatnonzero(self.free_unknowns), noise)

    @cached_property
    def motion_unknowns(self) -> np.ndarray:
        """Return the first of the fitted unknowns: the indices of those on which the motion depends."""
        return self.fitted_unknowns[self.fitted_unknowns < len(self.model.of_motion)]

    @cached_property
    def free_coordinates(self) -> np.ndarray:
        """Return the indices (F) of the free coordinates among all D: rate, direction and fitted unknowns."""
        return np.concatenate([np.arange(STATE_SIZE), STATE_SIZE + self.fitted_unknowns])

    @property
    def motion_coordinates(self) -> np.ndarray:
        """Return the indices (c) among all D of the free coordinates on which the motion depends."""
        return np.concatenate([np.arange(STATE_SIZE), STATE_SIZE + self.motion_unknowns])

    @property
    def rows_at_once(self) -> int:
        """Return how many motions one thread fits at once."""
        size = self.model.panels.power.size * (len(self.free_coordinates) + 1)
        return int(np.clip(NUMBERS_AT_ONCE // size, 8, ROWS_AT_ONCE))

    def track(self, motions: LanderMotions, error_rad: float) -> np.ndarray:
        """Return the track (K, n, w) of motions, not a number for those that could not be computed.

        Rates are included if times of samples have errors, or if there are other observations than those of panels.
        """
        states = self.model.sun_states(motions, error_rad)
        if not (self.model.given or self.model.panels.time_s):
            return states.sun_B
        return np.concatenate([states.sun_B, states.omega], axis=2)

    def track_with_slopes(self, motions: LanderMotions) -> tuple[np.ndarray, np.ndarray]:
        """Return the track (K, n, w) of motions and its derivatives (K, c, n, w), by differences of runs.

        They include the jump when a wheel stops. The two by the direction need one run, as all directions that are fixed in space
        rotate alike in body axes: the first tangent is propagated like the Sun, and the second is the cross product of both.
        """
        count = len(motions)
        rate_step = RATE_STEP / self.model.reach_s
        tangent, _ = tangent_basis(motions.sun)
        # runs: the motion (0), three other rates (1 to 3), a tangent in place of the Sun (4), and each unknown changed (5 on)
        motions = motions.bare
        runs = [motions]
        runs += [replace(motions, omega=motions.omega + rate_step * axis) for axis in np.eye(3)]
        runs.append(replace(motions, sun=tangent))
        usual_step = UNKNOWN_STEP * max(UNKNOWN_STEP_S / self.model.reach_s, 1.0)
        steps = np.full(len(self.motion_unknowns), min(usual_step, LARGEST_UNKNOWN_STEP))
        for k, i in enumerate(self.motion_unknowns):
            if self.model.unknowns[i].kind == "steady_torque":
                # angle (rad) by which a torque of one sigma (rad/s2) turns the body within the window
                angle = self.model.unknowns[i].sigma * self.model.reach_s**2 / 2
                steps[k] = RATE_STEP / max(angle, RATE_STEP)
            u = motions.u.copy()
            u[:, i] += steps[k]
            runs.append(replace(motions, u=u))
        # differences need more exact runs than predictions
        track = self.track(LanderMotions.joined(runs), self.error_rad / 10)
        track = track.reshape(len(runs), count, *track.shape[1:])
        base = track[0]
        track_slopes = np.zeros((len(self.motion_coordinates), *base.shape))
        track_slopes[RATE] = (track[1:4] - base) / rate_step
        sun, tangent = base[..., TRACK_SUN], track[4, ..., TRACK_SUN]
        track_slopes[SUN, ..., TRACK_SUN] = np.stack([tangent, cross(sun, tangent)])
        track_slopes[UNKNOWNS] = (track[5:] - base) / steps[:, None, None, None]
        return base, np.nan_to_num(np.moveaxis(track_slopes, 0, 1))

    def linear_readings(
        self, motions: LanderMotions, track: np.ndarray, track_slopes: np.ndarray
    ) -> LinearReadings:
        """Return the residuals of motions and their derivatives, by the chain rule from the track and its derivatives.

        If `track_slopes` has c = 0 the only derivatives are those by unknowns on which the motion does not depend.
        """
        model, count, c = self.model, len(motions), track_slopes.shape[1]
        computed = np.all(np.isfinite(track), axis=(1, 2))
        track = np.where(computed[:, None, None], track, 0.0)
        states = states_of(track)
        # a change d of the Sun is the rotation d x sun of the body; no sensor shows the rotation about the Sun
        rotation = np.moveaxis(cross(track_slopes[..., TRACK_SUN], states.sun[:, None]), 1, -1)
        rate = np.moveaxis(track_slopes[..., TRACK_RATE], 1, -1)  # both (K, n, 3, c)
        # the first c columns of the Jacobian are coordinates that change the motion, the others fitted unknowns of the panels
        panel_unknowns = self.fitted_unknowns[len(self.motion_unknowns) :] - len(model.of_motion)
        values, jacobians = [], []
        for term in (model.panels, *model.given):
            for residual in term.residuals(states, motions.u[:, model.of_panels]):
                jacobian = np.zeros((*residual.value.shape, c + len(panel_unknowns)))
                if c and residual.by_turn is not None:
                    jacobian[..., :c] += residual.by_turn @ rotation
                if c and residual.by_rate is not None:
                    jacobian[..., :c] += residual.by_rate @ rate
                if residual.by_u is not None:
                    jacobian[..., c:] = residual.by_u[..., panel_unknowns]
                values.append(residual.value.reshape(count, -1))
                jacobians.append(jacobian.reshape(*values[-1].shape, jacobian.shape[-1]))
        residuals, jacobian = np.concatenate(values, axis=1), np.concatenate(jacobians, axis=1)
        computed = computed & np.all(np.isfinite(residuals), axis=1)
        residuals = np.where(computed[:, None], residuals, 0.0)
        jacobian = np.where(np.isfinite(jacobian) & computed[:, None, None], jacobian, 0.0)
        return LinearReadings(residuals, jacobian, computed, track_slopes, track)

    def panel_residuals(self, residuals: np.ndarray) -> np.ndarray:
        """Return the residuals (K, n, p) of the panels, which come first among all (K, R)."""
        shape = self.model.panels.power.shape
        return residuals[:, : shape[0] * shape[1]].reshape(-1, *shape)

    def weigh(
        self, residuals: np.ndarray, u: np.ndarray, noise_factor: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return cost (K) and weights (K, R) of residuals under `noise_factor` times the noise; only panels have outliers."""
        law = self.model.panels.law(u[:, self.model.of_panels], noise_factor)
        by_sample, weight = law(self.panel_residuals(residuals))
        others = residuals[:, weight[0].size :]
        cost = by_sample.sum(axis=1) + 0.5 * np.sum(others**2, axis=1)
        return cost, np.concatenate([weight.reshape(len(u), -1), np.ones_like(others)], axis=1)

    def reading_curvature(
        self, u: np.ndarray, linear: LinearReadings, noise_factor: float
    ) -> np.ndarray:
        """Return the curvature (K, F, F) of the cost of the readings, without the priors."""
        weight = self.weigh(linear.residuals, u, noise_factor)[1]
        return normal_equations(linear.residuals, linear.jacobian, weight)[0]

    def linearised(self, motions: LanderMotions, noise_factor: float) -> DenseSystem:
        """Return the normal equations at motions, with derivatives by differences of runs."""
        linear = self.linear_readings(motions, *self.track_with_slopes(motions))
        return self.equations(motions.u, linear, noise_factor)

    def linearised_after(self, state: FitState, noise_factor: float) -> DenseSystem:
        """Return the normal equations at the motions after a step.

        The track is computed there. Its derivatives from before the step are corrected so that they explain its change
        (:func:`corrected`). Those of motions that could not be computed stay, by a step of zero.
        """
        track = self.track(state.motions, self.error_rad)
        computed = np.all(np.isfinite(track), axis=(1, 2))
        change = np.where(computed[:, None, None], track - state.track_before, 0.0)
        step = np.where(computed[:, None], state.step, 0.0)
        track_slopes = corrected(state.track_slopes, step, change)
        linear = self.linear_readings(state.motions, track, track_slopes)
        return self.equations(state.u, linear, noise_factor)

    def equations(self, u: np.ndarray, linear: LinearReadings, noise_factor: float) -> DenseSystem:
        """Return the normal equations (:class:`DenseSystem`) in the F free coordinates, from readings and priors of the unknowns.

        `u` (K, m): unknowns of the motions. `linear`: the readings to first order about these motions, returned in `extras`.
        `noise_factor`: factor on the noise of the panels. The cost of motions that could not be computed is infinite.
        """
        fitted = self.fitted_unknowns
        cost, weight = self.weigh(linear.residuals, u, noise_factor)
        normal, gradient = normal_equations(linear.residuals, linear.jacobian, weight)
        # the prior of an unknown u adds its precision to the diagonal, and precision times u to the gradient
        prior, precision = self.model.prior_cost(u, self.sizes)
        diagonal = np.arange(len(self.free_coordinates))
        normal[:, diagonal[UNKNOWNS], diagonal[UNKNOWNS]] += precision[:, fitted]
        gradient[:, UNKNOWNS] += precision[:, fitted] * u[:, fitted]
        # Marquardt's damping is without the floor, which keeps the matrix regular if no reading determines a coordinate
        scale = np.einsum("kff->kf", normal).copy()
        floor = FLOOR * scale.max(axis=1) + 1e-12
        normal[:, diagonal, diagonal] += floor[:, None]
        cost = np.where(linear.computed, cost + prior, np.inf)
        return DenseSystem(cost, normal, gradient, scale, linear)


def normal_equations(
    residuals: np.ndarray, jacobian: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrices J'WJ (K, F, F) and the slopes J'Wr (K, F) of residuals r (K, R) with weights W (K, R)."""
    weighted = np.swapaxes(jacobian * weight[..., None], 1, 2)
    return weighted @ jacobian, (weighted @ residuals[..., None])[..., 0]


def corrected(track_slopes: np.ndarray, step: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Return derivatives (K, c, n, w) of the track, corrected so that a step (K, c) explains its change (K, n, w) exactly.

    This is Broyden's update. With the derivatives J, a row for each of c coordinates, the step s and the change y it adds
    W s (y - s J) / (s W s) to J. W is diagonal and holds the squared length of each row. So of all corrections that explain the
    change this one is the smallest relative to the rows: it has the least sum over rows of (|correction| / |row|)^2. A step of zero
    corrects nothing.
    """
    flat = track_slopes.reshape(*track_slopes.shape[:2], -1)
    weighted = step * np.sum(flat**2, axis=2)  # W s
    length = np.sum(weighted * step, axis=1, keepdims=True)  # s W s
    share = np.divide(weighted, length, out=np.zeros_like(weighted), where=length > 0)
    unexplained = change.reshape(len(flat), 1, -1) - step[:, None] @ flat  # y - s J
    return track_slopes + (share[:, :, None] * unexplained).reshape(track_slopes.shape)


def in_tangents_at(
    new_sun: np.ndarray, sun: np.ndarray, track_slopes: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return derivatives (K, c, n, w) and a step (K, c) after a change of the tangents to which two of the coordinates belong.

    These two move the direction to the Sun: along the tangents at `sun` (K, 3) before, and along those at `new_sun` (K, 3) after.
    """
    tangents = np.stack(tangent_basis(new_sun), axis=1)
    change = tangents @ np.swapaxes(np.stack(tangent_basis(sun), axis=1), 1, 2)  # (K, 2, 2)
    track_slopes, step = track_slopes.copy(), step.copy()
    track_slopes[:, SUN] = np.einsum("kab,kbnw->kanw", change, track_slopes[:, SUN])
    step[:, SUN] = np.einsum("kab,kb->ka", change, step[:, SUN])
    return track_slopes, step


def rotation_by(step: np.ndarray, reach_s: float) -> np.ndarray:
    """Return the angle (K), rad, by which steps (K, 5 or more) rotate the Sun within a window up to `reach_s` from the reference.

    It is the larger one of the angle by the change of the rate and the angle by the change of the direction to the Sun.
    """
    rate, sun = (np.linalg.norm(step[:, part], axis=1) for part in (RATE, SUN))
    return np.maximum(rate * reach_s, sun)


class Fitting:
    """A batch of motions that are fitted together; the result of each does not depend on the others.

    `motions`: where the fit is now; `system`: the normal equations there under `noise_factor` times the noise.
    """

    def __init__(self, problem: FitProblem, motions: LanderMotions) -> None:
        """Begin at motions whose bodies can exist, with the stated noise.

        A small noise from a fit to fewer readings would make levels of larger noise less effective.
        """
        u = problem.model.limited(motions.u, INSIDE)
        u[:, problem.model.indices("noise")] = 0.0
        self.problem, self.noise_factor = problem, 1.0
        self.motions = replace(motions.bare, u=u)
        self.refresh()

    def refresh(self) -> None:
        """Compute the derivatives by differences where the motions are now."""
        self.system = self.problem.linearised(self.motions, self.noise_factor)

    def fit_under(self, noise_factor: float, steps: int) -> None:
        """Take at most so many steps under `noise_factor` times the noise."""
        self.noise_factor = noise_factor
        self.system = self.problem.equations(self.motions.u, self.system.extras, noise_factor)
        self.iterate(steps)

    def iterate(self, count: int) -> None:
        """Take at most `count` steps of damped least squares; derivatives are corrected after each."""
        motions, linear = self.motions, self.system.extras
        no_step = np.zeros((len(motions), len(self.problem.motion_coordinates)))
        start = FitState(
            motions.omega, motions.sun, motions.u, linear.track_slopes, linear.track, no_step
        )
        end = least_squares(
            lambda state: self.problem.linearised_after(state, self.noise_factor),
            self._moved,
            solve_dense,
            start,
            steps=count,
            system=self.system,
            length_ratio=self._length_ratio,
            limit=self._limited,
            keep=lambda state, system: state._replace(
                track_slopes=system.extras.track_slopes, track_before=system.extras.track
            ),
        )
        self.motions, self.system = end.state.motions, end.system

    def _moved(self, state: FitState, step: np.ndarray) -> FitState:
        """Return the state after steps (K, F) from it, with step and derivatives along the tangents at the new directions."""
        whole = np.zeros((len(step), self.problem.model.dimension))
        whole[:, self.problem.free_coordinates] = step
        sun = move_on_sphere(state.sun, whole[:, SUN])
        motion_step = whole[:, self.problem.motion_coordinates]
        track_slopes, motion_step = in_tangents_at(sun, state.sun, state.track_slopes, motion_step)
        omega, u = state.omega + whole[:, RATE], state.u + whole[:, UNKNOWNS]
        return FitState(omega, sun, u, track_slopes, state.track_before, motion_step)

    def _length_ratio(self, state: FitState, step: np.ndarray) -> np.ndarray:
        """Return the lengths (K) of steps (K, F) over the longest one allowed, from any state.

        Allowed are a rotation of the Sun by `LARGEST_TURN`, by a constant torque too, and one sigma of each unknown.
        """
        model, fitted = self.problem.model, self.problem.fitted_unknowns
        of_unknowns = step[:, UNKNOWNS]
        torque = np.isin(fitted, model.indices("steady_torque"))
        sigma = np.array([model.unknowns[i].sigma for i in fitted[torque]])  # rad/s2
        by_torque = np.linalg.norm(of_unknowns[:, torque] * sigma, axis=1) * model.reach_s**2 / 2
        angle = np.maximum(rotation_by(step, model.reach_s), by_torque)
        return np.maximum(angle / LARGEST_TURN, np.abs(of_unknowns).max(axis=1, initial=0.0))

    def _limited(self, state: FitState) -> FitState:
        """Return the state within the limits of the prior; a step that was cut off is zero, so that it corrects no derivatives."""
        model = self.problem.model
        omega, u = limit_length(state.omega, model.max_rate), model.limited(state.u, INSIDE)
        is_within = (omega == state.omega).all(axis=1) & (u == state.u).all(axis=1)
        return state._replace(omega=omega, u=u, step=np.where(is_within[:, None], state.step, 0.0))

    def fit_noise(self, *, few: bool = False, held: bool = False) -> None:
        """Set the noise to its best value for the present residuals.

        `few`: there are hardly more readings than fitted numbers, so that degrees of freedom are subtracted. `held`: the noise is
        then also not smaller than stated. Otherwise a family of motions that fit the first samples would look like one motion,
        known to a tenth of the family's width.
        """
        panels, of_panels = self.problem.model.panels, self.problem.model.of_panels
        freedom = self._fitted_freedom() if few else np.zeros(len(self.motions))
        least = 0.0 if few and held else -LARGEST_LOG_NOISE
        u, linear = self.motions.u.copy(), self.system.extras
        if panels.time_s:
            # with the best errors of times residuals are smaller than the noise
            freedom = freedom + panels.freedom_of_times(states_of(linear.track), u[:, of_panels])
        residuals = self.problem.panel_residuals(linear.residuals)
        u[:, of_panels] = panels.best_noise(residuals, u[:, of_panels], freedom, least)
        self.motions = replace(self.motions, u=u)
        self.system = self.problem.equations(u, linear, self.noise_factor)

    def _fitted_freedom(self) -> np.ndarray:
        """Return the degrees of freedom (K) that the fit uses.

        They are the trace of (C + P)^-1 C, with the curvature C of the readings and P of the priors.
        """
        problem, u = self.problem, self.motions.u
        read = problem.reading_curvature(u, self.system.extras, self.noise_factor)
        prior = np.zeros(read.shape[:2])
        precision = problem.model.prior_cost(u, problem.sizes)[1]
        prior[:, UNKNOWNS] = precision[:, problem.fitted_unknowns]
        # in units of the root of each diagonal element the matrices are well conditioned
        size = np.sqrt(np.einsum("kff->kf", read) + prior + 1e-12)
        read /= size[:, :, None] * size[:, None, :]
        total = read + np.eye(read.shape[1]) * (prior / size**2 + 1e-9)[:, :, None]
        return np.trace(np.linalg.solve(total, read), axis1=1, axis2=2)

    def curvature(self) -> np.ndarray:
        """Return second derivatives (K, D, D) of the cost, by Gauss-Newton; for unknowns that are not free, those of the prior."""
        problem, model, u = self.problem, self.problem.model, self.motions.u
        linear, free = self.system.extras, problem.free_coordinates
        curvature = np.zeros((len(u), model.dimension, model.dimension))
        curvature[:, free[:, None], free] = problem.reading_curvature(u, linear, self.noise_factor)
        unknowns = np.arange(STATE_SIZE, model.dimension)
        curvature[:, unknowns, unknowns] += model.prior_cost(u, problem.sizes)[1]
        residuals = problem.panel_residuals(linear.residuals)
        for i in model.indices("noise"):
            at = STATE_SIZE + i
            curvature[:, at, at] += model.panels.noise_curvature(residuals, u[:, model.of_panels])
        return curvature


Levels = Sequence[tuple[float, int]]
"""(factor on the noise, largest number of steps) of the levels of a fit, one after the other."""


def fit_window(
    problem: FitProblem,
    motions: LanderMotions,
    levels: Levels,
    hopeless: float = np.inf,
    held: bool = False,
) -> LanderMotions:
    """Return motions fitted to a window of the search, under one level of noise after the other, with costs and curvatures.

    Derivatives are computed once, and corrected after each step. Motions that cost more than `hopeless` after the first level go no
    further: they keep its result and cost, and have zero curvature. The cost of the others is that under the last level. `held`:
    `problem` holds body and wheel; then the noise, which stands for their errors, is not fitted below the stated one.
    """
    fitting = Fitting(problem, motions)
    fitting.fit_under(*levels[0])
    curvature = np.zeros((len(motions), problem.model.dimension, problem.model.dimension))
    fitted = replace(fitting.motions, cost=fitting.system.cost.copy(), curvature=curvature)
    promising = np.flatnonzero(fitting.system.cost <= hopeless)
    if not len(promising):
        return fitted
    fitting.motions = fitting.motions.take(promising)
    fitting.system = take_problems(fitting.system, promising)
    for noise_factor, steps in levels[1:]:
        fitting.fit_under(noise_factor, steps)
    fitting.fit_noise(few=True, held=held)
    for name in ("omega", "sun", "u"):
        getattr(fitted, name)[promising] = getattr(fitting.motions, name)
    fitted.cost[promising], fitted.curvature[promising] = fitting.system.cost, fitting.curvature()
    return fitted


def fit_finally(problem: FitProblem, motions: LanderMotions, levels: Levels) -> LanderMotions:
    """Return motions fitted to all samples, with costs and curvatures.

    Derivatives are computed again at each level, and twice after the levels, each time with a fit of the noise and two more steps.
    """
    fitting = Fitting(problem, motions)
    for k, (noise_factor, steps) in enumerate(levels):
        if k:
            fitting.refresh()
        fitting.fit_under(noise_factor, steps)
    fitting.fit_noise()
    for _ in range(2):
        fitting.refresh()
        fitting.fit_noise()
        fitting.iterate(2)
    return replace(fitting.motions, cost=fitting.system.cost, curvature=fitting.curvature())


def in_pieces(
    fit: Callable[[LanderMotions], LanderMotions], motions: LanderMotions, rows: int, workers: int
) -> LanderMotions:
    """Return the result of a fit of many motions, made in pieces of `rows` motions by several threads; it depends on neither."""
    pieces = [motions.take(slice(k, k + rows)) for k in range(0, len(motions), rows)]
    with ThreadPoolExecutor(workers) as pool:
        fitted = LanderMotions.joined(list(pool.map(fit, pieces)))
    return replace(fitted, starts=motions.starts, neighbours_s=motions.neighbours_s)
