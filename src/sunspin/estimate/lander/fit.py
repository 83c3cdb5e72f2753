"""Fits of a lander's motions: one state at the reference, from which the equations of motion reach every sample.

The cost of a motion is minus the log of its posterior density: that of each reading (:meth:`PanelPowers.law`) and the prior of the
unknowns. Damped least squares lowers it for K motions at once. Derivatives of the motion are computed once, by differences of
runs. After each step they are corrected by the change that the step has made (Broyden 1965, Math. Comp. 19, 577), so that a step
takes one run. The noise is no unknown of a step: after the steps it gets its best value for the residuals.

A motion has D coordinates (:mod:`sunspin.estimate.lander.motions`), of which F are free in a fit. c of these change the motion, the
others only the readings. The `track` (K, n, w) of K motions is what sensors depend on at n samples: directions to the Sun (w = 3),
and rates if they are needed (w = 6). `value` (K, R) are predicted less read numbers.
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
"""Step of the differences in unknowns, in sigmas, for a window of `UNKNOWN_STEP_S`; it is in inverse proportion to the length of
the window, up to `LARGEST_UNKNOWN_STEP`."""

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
"""Derivatives, and motions, that one thread holds in memory at once."""


def states_of(track: np.ndarray) -> SunStates:
    """Return `track` (K, n, w) as directions to the Sun and rates."""
    return SunStates.of(track[..., TRACK_SUN], track[..., TRACK_RATE])


class Point(NamedTuple):
    """Motions of a fit one `step` (K, c) after motions whose derivatives are known; the tangents are those of the new directions.

    `before` (K, n, w): `track` before the step, and `track_slopes` (K, c, n, w): its derivatives. A step of zero does not correct
    these.
    """

    omega: np.ndarray
    sun: np.ndarray
    u: np.ndarray
    track_slopes: np.ndarray
    before: np.ndarray
    step: np.ndarray

    @property
    def motions(self) -> LanderMotions:
        """Return the motions."""
        return LanderMotions(self.omega, self.sun, self.u)


class Linear(NamedTuple):
    """Residuals `value` (K, R) in stated sigmas and their derivatives `jacobian` (K, R, F) by the free coordinates.

    `fine` (K): the motion could be computed; `track` (K, n, w), and `track_slopes` (K, c, n, w): its derivatives.
    """

    value: np.ndarray
    jacobian: np.ndarray
    fine: np.ndarray
    track_slopes: np.ndarray
    track: np.ndarray


@dataclass(frozen=True)
class FitProblem:
    """A least-squares problem: motions are fitted to the samples of a model, with some coordinates free.

    `free_unknowns` (m): which unknowns are free; the noise never is. `error_rad`: of directions in runs. `sizes`: the sigma to use
    for unknowns with several (:meth:`LanderModel.prior_cost`).
    """

    model: LanderModel
    free_unknowns: np.ndarray
    error_rad: float = SEARCH_ERROR
    sizes: Sizes = field(default_factory=dict)

    @cached_property
    def fitted(self) -> np.ndarray:
        """Return the indices of the unknowns that steps change: the free ones but for the noise."""
        noise = self.model.indices("noise")
        return np.setdiff1d(np.flatnonzero(self.free_unknowns), noise)

    @cached_property
    def moving(self) -> np.ndarray:
        """Return the indices of fitted unknowns on which the motion depends, so that a derivative needs a run; they come first."""
        return self.fitted[self.fitted < len(self.model.of_motion)]

    @cached_property
    def coordinates(self) -> np.ndarray:
        """Return the indices (F) of the free coordinates among all (D): the state, and the fitted unknowns."""
        return np.concatenate([np.arange(STATE_SIZE), STATE_SIZE + self.fitted])

    @property
    def of_motion(self) -> np.ndarray:
        """Return the indices (c) of the free coordinates on which the motion depends."""
        return np.concatenate([np.arange(STATE_SIZE), STATE_SIZE + self.moving])

    @property
    def rows_at_once(self) -> int:
        """Return how many motions one thread fits at once."""
        size = self.model.panels.power.size * (len(self.coordinates) + 1)
        return int(np.clip(NUMBERS_AT_ONCE // size, 8, ROWS_AT_ONCE))

    # ---- derivatives -------------------------------------------------------------------------------------------------------

    def track(self, motions: LanderMotions, error_rad: float) -> np.ndarray:
        """Return `track` (K, n, w) of motions, not a number for those that could not be computed.

        Rates are included if times of samples have errors, or if there are other readings than those of panels.
        """
        states = self.model.carried(motions, error_rad)
        if not (self.model.given or self.model.panels.time_s):
            return states.sun_B
        return np.concatenate([states.sun_B, states.omega], axis=2)

    def derivatives(self, motions: LanderMotions) -> tuple[np.ndarray, np.ndarray]:
        """Return `track` (K, n, w) and its derivatives (K, c, n, w), by differences of runs.

        They include the jump when a wheel stops. Derivatives by the direction need one run: r(0) -> r(t) is a rotation that does
        not depend on r(0), so that one tangent is propagated like the Sun, and the other one is across both.
        """
        count = len(motions)
        rate_step = RATE_STEP / self.model.reach_s
        tangent, _ = tangent_basis(motions.sun)
        # runs: the motion (0), three other rates (1 to 3), a tangent in place of the Sun (4), and each unknown changed (5 on)
        motions = motions.bare
        runs = [motions]
        runs += [replace(motions, omega=motions.omega + rate_step * axis) for axis in np.eye(3)]
        runs.append(replace(motions, sun=tangent))
        steps = self._unknown_steps()
        for i, step in zip(self.moving, steps, strict=True):
            u = motions.u.copy()
            u[:, i] += step
            runs.append(replace(motions, u=u))
        # differences need more exact runs than predictions
        track = self.track(LanderMotions.joined(runs), self.error_rad / 10)
        track = track.reshape(len(runs), count, *track.shape[1:])
        base = track[0]
        track_slopes = np.zeros((STATE_SIZE + len(self.moving), *base.shape))
        track_slopes[RATE] = (track[1:4] - base) / rate_step
        sun, carried = base[..., TRACK_SUN], track[4, ..., TRACK_SUN]
        track_slopes[SUN, ..., TRACK_SUN] = np.stack([carried, cross(sun, carried)])
        track_slopes[UNKNOWNS] = (track[5:] - base) / steps[:, None, None, None]
        return base, np.nan_to_num(np.moveaxis(track_slopes, 0, 1))

    def _unknown_steps(self) -> np.ndarray:
        """Return the steps of the differences in the unknowns of the motion, in sigmas."""
        usual = min(
            UNKNOWN_STEP * max(UNKNOWN_STEP_S / self.model.reach_s, 1.0), LARGEST_UNKNOWN_STEP
        )
        steps = np.full(len(self.moving), usual)
        for k, i in enumerate(self.moving):
            if self.model.unknowns[i].kind == "steady_torque":
                # turn of the body within the window by one sigma
                turn = max(self.model.unknowns[i].sigma * self.model.reach_s**2 / 2, RATE_STEP)
                steps[k] = RATE_STEP / turn
        return steps

    def differences(
        self, motions: LanderMotions, track: np.ndarray, track_slopes: np.ndarray
    ) -> Linear:
        """Return residuals of readings and their derivatives, by the chain rule from `track` (K, n, w) and `track_slopes`.

        If `track_slopes` has c = 0 the only derivatives are those by unknowns on which the motion does not depend.
        """
        model, count = self.model, len(motions)
        fine = np.all(np.isfinite(track), axis=(1, 2))
        track = np.where(fine[:, None, None], track, 0.0)
        states = states_of(track)
        # a change d of the Sun is the rotation d x sun of the body; no sensor shows the rotation about the Sun
        turn = np.moveaxis(cross(track_slopes[..., TRACK_SUN], states.sun[:, None]), 1, -1)
        of_rate = np.moveaxis(track_slopes[..., TRACK_RATE], 1, -1)
        # fitted unknowns of the panels; the first `moving` columns of the Jacobian are coordinates that change the motion
        own = self.fitted[len(self.moving) :] - len(model.of_motion)
        moving = track_slopes.shape[1]
        values, columns = [], []
        for term in (model.panels, *model.given):
            for residual in term.residuals(states, motions.u[:, model.of_panels]):
                jacobian = np.zeros((*residual.value.shape, moving + len(own)))
                if moving and residual.by_turn is not None:
                    jacobian[..., :moving] += residual.by_turn @ turn
                if moving and residual.by_rate is not None:
                    jacobian[..., :moving] += residual.by_rate @ of_rate
                if residual.by_u is not None:
                    jacobian[..., moving:] = residual.by_u[..., own]
                values.append(residual.value.reshape(count, -1))
                columns.append(jacobian.reshape(*values[-1].shape, jacobian.shape[-1]))
        value, jacobian = np.concatenate(values, axis=1), np.concatenate(columns, axis=1)
        fine = fine & np.all(np.isfinite(value), axis=1)
        value = np.where(fine[:, None], value, 0.0)
        jacobian = np.where(np.isfinite(jacobian) & fine[:, None, None], jacobian, 0.0)
        return Linear(value, jacobian, fine, track_slopes, track)

    def of_panels(self, value: np.ndarray) -> np.ndarray:
        """Return the residuals (K, n, p) of the panels among all (K, R)."""
        shape = self.model.panels.power.shape
        return value[:, : shape[0] * shape[1]].reshape(-1, *shape)

    def weigh(
        self, value: np.ndarray, u: np.ndarray, noise_factor: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return cost (K) and weights (K, R) of residuals under `noise_factor` times the noise; only panels have outliers."""
        law = self.model.panels.law(u[:, self.model.of_panels], noise_factor)
        by_sample, weight = law(self.of_panels(value))
        others = value[:, weight[0].size :]
        cost = by_sample.sum(axis=1) + 0.5 * np.sum(others**2, axis=1)
        return cost, np.concatenate([weight.reshape(len(u), -1), np.ones_like(others)], axis=1)

    def read_curvature(self, u: np.ndarray, linear: Linear, noise_factor: float) -> np.ndarray:
        """Return the part (K, F, F) of the curvature of the cost that the readings give."""
        weight = self.weigh(linear.value, u, noise_factor)[1]
        return normal_equations(linear.value, linear.jacobian, weight)[0]

    def linearised(self, motions: LanderMotions, noise_factor: float) -> DenseSystem:
        """Return the normal equations at motions, with derivatives by differences of runs."""
        linear = self.differences(motions, *self.derivatives(motions))
        return self.system(motions.u, linear, noise_factor)

    def linearised_after(self, point: Point, noise_factor: float) -> DenseSystem:
        """Return the normal equations after a step; the change that it has made corrects the derivatives (:func:`corrected`)."""
        track = self.track(point.motions, self.error_rad)
        fine = np.all(np.isfinite(track), axis=(1, 2))
        change = np.where(fine[:, None, None], track - point.before, 0.0)
        step = np.where(fine[:, None], point.step, 0.0)
        track_slopes = corrected(point.track_slopes, step, change)
        linear = self.differences(point.motions, track, track_slopes)
        return self.system(point.u, linear, noise_factor)

    def system(self, u: np.ndarray, linear: Linear, noise_factor: float) -> DenseSystem:
        """Return the normal equations of a step in the free coordinates (F), priors of unknowns included; extras are `linear`."""
        cost, weight = self.weigh(linear.value, u, noise_factor)
        prior, precision = self.model.prior_cost(u, self.sizes)
        normal, gradient = normal_equations(linear.value, linear.jacobian, weight)
        diagonal = np.arange(STATE_SIZE, len(self.coordinates))
        normal[:, diagonal, diagonal] += precision[:, self.fitted]
        gradient[:, UNKNOWNS] += precision[:, self.fitted] * u[:, self.fitted]
        scale = np.einsum("kff->kf", normal).copy()
        floor = FLOOR * scale.max(axis=1) + 1e-12
        normal[:, np.arange(scale.shape[1]), np.arange(scale.shape[1])] += floor[:, None]
        cost = np.where(linear.fine, cost + prior, np.inf)
        return DenseSystem(cost, normal, gradient, scale, linear)


def normal_equations(
    value: np.ndarray, jacobian: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return J'WJ (K, F, F) and J'Wr (K, F) of residuals (K, R) with weights (K, R)."""
    weighted = np.swapaxes(jacobian * weight[..., None], 1, 2)
    return weighted @ jacobian, (weighted @ value[..., None])[..., 0]


def corrected(track_slopes: np.ndarray, step: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Return derivatives (K, c, n, w) of `track`, corrected so that they explain its change (K, n, w) by a step (K, c).

    Broyden's update is the smallest such correction: with the derivatives J (c rows), the step s and the change y it adds
    W s (y - s J) / (s W s) to J. Here the metric W is diagonal, with the squared lengths of the rows of J.
    """
    flat = track_slopes.reshape(*track_slopes.shape[:2], -1)
    weighted = step * np.sum(flat**2, axis=2)
    length = np.sum(weighted * step, axis=1, keepdims=True)
    share = np.divide(weighted, length, out=np.zeros_like(weighted), where=length > 0)
    unexplained = change.reshape(len(flat), 1, -1) - step[:, None] @ flat
    return track_slopes + (share[:, :, None] * unexplained).reshape(track_slopes.shape)


def in_tangents_at(
    there: np.ndarray, sun: np.ndarray, track_slopes: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return derivatives and a step by tangents at directions `sun` (K, 3), as those by tangents at directions `there` (K, 3)."""
    across = np.stack(tangent_basis(there), axis=1)
    turn = across @ np.swapaxes(np.stack(tangent_basis(sun), axis=1), 1, 2)  # (K, 2, 2)
    track_slopes, step = track_slopes.copy(), step.copy()
    track_slopes[:, SUN] = np.einsum("kab,kbnw->kanw", turn, track_slopes[:, SUN])
    step[:, SUN] = np.einsum("kab,kb->ka", turn, step[:, SUN])
    return track_slopes, step


def rotation_by(step: np.ndarray, reach_s: float) -> np.ndarray:
    """Return the rotation (K), rad, within a window up to `reach_s` by the rate or the direction of steps (K, 5 or more)."""
    rate, sun = (np.linalg.norm(step[:, part], axis=1) for part in (RATE, SUN))
    return np.maximum(rate * reach_s, sun)


class Fitting:
    """A batch of motions that are fitted together; the result of each does not depend on the others."""

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
        """Compute the derivatives where the motions are now."""
        self.system = self.problem.linearised(self.motions, self.noise_factor)

    def fit_under(self, noise_factor: float, steps: int) -> None:
        """Take steps under `noise_factor` times the noise."""
        self.noise_factor = noise_factor
        self.system = self.problem.system(self.motions.u, self.system.extras, noise_factor)
        self.steps(steps)

    def take(self, rows: np.ndarray) -> None:
        """Continue with some of the motions."""
        self.motions, self.system = self.motions.take(rows), take_problems(self.system, rows)

    def steps(self, count: int) -> None:
        """Take steps of damped least squares."""
        motions, linear = self.motions, self.system.extras
        still = np.zeros((len(motions), len(self.problem.of_motion)))
        end = least_squares(
            lambda point: self.problem.linearised_after(point, self.noise_factor),
            self._moved,
            solve_dense,
            Point(motions.omega, motions.sun, motions.u, linear.track_slopes, linear.track, still),
            steps=count,
            system=self.system,
            length_ratio=self._length_ratio,
            limit=self._limited,
            carry=lambda point, system: point._replace(
                track_slopes=system.extras.track_slopes, before=system.extras.track
            ),
        )
        self.motions, self.system = end.state.motions, end.system

    def _moved(self, point: Point, step: np.ndarray) -> Point:
        """Return the motions after steps (K, F), with derivatives in the tangents of the new directions."""
        whole = np.zeros((len(step), self.problem.model.dimension))
        whole[:, self.problem.coordinates] = step
        sun = move_on_sphere(point.sun, whole[:, SUN])
        own = whole[:, self.problem.of_motion]
        track_slopes, own = in_tangents_at(sun, point.sun, point.track_slopes, own)
        omega, u = point.omega + whole[:, RATE], point.u + whole[:, UNKNOWNS]
        return Point(omega, sun, u, track_slopes, point.before, own)

    def _length_ratio(self, point: Point, step: np.ndarray) -> np.ndarray:
        """Return the lengths (K) of steps (K, F) over the longest one allowed."""
        problem, fitted = self.problem, self.problem.fitted
        turn = rotation_by(step, problem.model.reach_s)
        torque = np.isin(fitted, problem.model.indices("steady_torque"))
        sigma = np.array([problem.model.unknowns[i].sigma for i in fitted[torque]])
        pushed = (
            np.linalg.norm(step[:, UNKNOWNS][:, torque] * sigma, axis=1)
            * problem.model.reach_s**2
            / 2
        )
        unknowns = np.abs(step[:, UNKNOWNS]).max(axis=1, initial=0.0)
        return np.maximum(np.maximum(turn, pushed) / LARGEST_TURN, unknowns)

    def _limited(self, point: Point) -> Point:
        """Return motions within the limits of the prior; derivatives are not corrected by a step that was cut off."""
        model = self.problem.model
        omega, u = limit_length(point.omega, model.max_rate), model.limited(point.u, INSIDE)
        is_within = (omega == point.omega).all(axis=1) & (u == point.u).all(axis=1)
        return point._replace(omega=omega, u=u, step=np.where(is_within[:, None], point.step, 0.0))

    def fit_noise(self, few: bool = False, held: bool = False) -> None:
        """Set the noise to its best value for the present residuals.

        `few`: there are hardly more readings than fitted numbers, so that degrees of freedom are subtracted. `held`: the noise is
        then also not smaller than stated. Otherwise a family of motions that fit the first samples would look like one motion,
        known to a tenth of the family's width.
        """
        panels, own = self.problem.model.panels, self.problem.model.of_panels
        fitted_freedom = self._fitted_freedom() if few else np.zeros(len(self.motions))
        least = 0.0 if few and held else -LARGEST_LOG_NOISE
        u, linear = self.motions.u.copy(), self.system.extras
        value = self.problem.of_panels(linear.value)
        if panels.time_s:
            # with the best errors of times residuals are smaller than the noise
            taken = panels.freedom_of_times(states_of(linear.track), u[:, own])
            fitted_freedom = fitted_freedom + taken
        u[:, own] = panels.best_noise(value, u[:, own], fitted_freedom, least)
        self.motions = replace(self.motions, u=u)
        self.system = self.problem.system(u, linear, self.noise_factor)

    def _fitted_freedom(self) -> np.ndarray:
        """Return the degrees of freedom (K) that the fit uses: the trace of the readings' part in the curvature."""
        problem, u = self.problem, self.motions.u
        read = problem.read_curvature(u, self.system.extras, self.noise_factor)
        prior = np.zeros(read.shape[:2])
        prior[:, UNKNOWNS] = problem.model.prior_cost(u, problem.sizes)[1][:, problem.fitted]
        # in units of the root of each diagonal element the matrices are well conditioned
        size = np.sqrt(np.einsum("kff->kf", read) + prior + 1e-12)
        read /= size[:, :, None] * size[:, None, :]
        total = read + np.eye(read.shape[1]) * (prior / size**2 + 1e-9)[:, :, None]
        return np.trace(np.linalg.solve(total, read), axis1=1, axis2=2)

    def curvature(self) -> np.ndarray:
        """Return second derivatives (K, D, D) of the cost, by Gauss-Newton; for unknowns that are not free, those of the prior."""
        problem, model, u = self.problem, self.problem.model, self.motions.u
        linear = self.system.extras
        read = problem.read_curvature(u, linear, self.noise_factor)
        curvature = np.zeros((len(u), model.dimension, model.dimension))
        curvature[:, problem.coordinates[:, None], problem.coordinates] = read
        unknowns = np.arange(STATE_SIZE, model.dimension)
        curvature[:, unknowns, unknowns] += model.prior_cost(u, problem.sizes)[1]
        for i in model.indices("noise"):
            value, at = problem.of_panels(linear.value), STATE_SIZE + i
            curvature[:, at, at] += model.panels.noise_curvature(value, u[:, model.of_panels])
        return curvature


Levels = Sequence[tuple[float, int]]
"""Factors on the noise, each with a number of steps."""


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
    (noise_factor, steps), *others = levels
    fitting.fit_under(noise_factor, steps)
    none = np.zeros((len(motions), problem.model.dimension, problem.model.dimension))
    fitted = replace(fitting.motions, cost=fitting.system.cost.copy(), curvature=none)
    going = np.flatnonzero(fitting.system.cost <= hopeless)
    if not len(going):
        return fitted
    fitting.take(going)
    for noise_factor, steps in others:
        fitting.fit_under(noise_factor, steps)
    fitting.fit_noise(few=True, held=held)
    for name in ("omega", "sun", "u"):
        getattr(fitted, name)[going] = getattr(fitting.motions, name)
    fitted.cost[going], fitted.curvature[going] = fitting.system.cost, fitting.curvature()
    return fitted


def fit_finally(problem: FitProblem, motions: LanderMotions, levels: Levels) -> LanderMotions:
    """Return motions fitted to all samples, with costs and curvatures; derivatives are computed again at each level."""
    fitting = Fitting(problem, motions)
    for k, (noise_factor, steps) in enumerate(levels):
        if k:
            fitting.refresh()
        fitting.fit_under(noise_factor, steps)
    fitting.fit_noise()
    for _ in range(2):
        fitting.refresh()
        fitting.fit_noise()
        fitting.steps(2)
    return replace(fitting.motions, cost=fitting.system.cost, curvature=fitting.curvature())


def in_pieces(
    fit: Callable[[LanderMotions], LanderMotions], motions: LanderMotions, rows: int, workers: int
) -> LanderMotions:
    """Return the result of a fit of many motions, in pieces of `rows` motions by `workers` threads; both do not change it."""
    pieces = [motions.take(slice(k, k + rows)) for k in range(0, len(motions), rows)]
    with ThreadPoolExecutor(workers) as pool:
        fitted = LanderMotions.joined(list(pool.map(fit, pieces)))
    return replace(fitted, starts=motions.starts, neighbours_s=motions.neighbours_s)
