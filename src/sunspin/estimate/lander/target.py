"""The posterior density of a lander's motions under one model, as sampling along curved ridges needs it
(:mod:`sunspin.estimate.lander.ridges`, :mod:`sunspin.estimate.lander.sample`).

K motions are given by rate and direction to the Sun at the reference and unknowns u (K, m) in sigmas. Their `track` (K, n, w) holds
the direction to the Sun (body axes) at the n samples, and rates (rad/s) if some sensor needs them (:meth:`FitProblem.track`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sunspin.estimate.lander.fit import (
    SEARCH_ERROR,
    FitProblem,
    FitState,
    in_tangents_at,
    normal_equations,
    rotation_by,
    states_of,
)
from sunspin.estimate.lander.model import LanderModel
from sunspin.estimate.lander.motions import STATE_SIZE, LanderMotions
from sunspin.solve.linear import DenseSystem

LEAST_TURN_RAD = 1e-3
"""Derivatives are not corrected by steps that rotate the body by less than this within the window: the change would be comparable
with the error of integration, 1e-5 rad."""


class MotionSlopes(NamedTuple):
    """K motions with `track` (K, n, w), and the derivatives `track_slopes` (K, 5, n, w) of that by rate and direction.

    Least squares at motions near by begins with these derivatives, to save runs.
    """

    omega: np.ndarray
    sun: np.ndarray
    u: np.ndarray
    track_slopes: np.ndarray
    track: np.ndarray


@dataclass(frozen=True)
class LanderTarget:
    """Posterior of the motions of a lander under one model: K motions are evaluated at once."""

    model: LanderModel

    @cached_property
    def reading_unknowns(self) -> np.ndarray:
        """Return the indices (s) of unknowns that change readings but not the motion: brightness, gains, tilts; not the noise."""
        own = np.arange(len(self.model.of_motion), len(self.model.unknowns))
        return np.setdiff1d(own, self.model.indices("noise"))

    @cached_property
    def motion_unknowns(self) -> np.ndarray:
        """Return the indices of unknowns that change the motion: inertia, friction, wheel speeds, torques."""
        return np.arange(len(self.model.of_motion))

    @cached_property
    def _problem(self) -> FitProblem:
        """Return the least-squares problem in which rate, direction and reading unknowns are free."""
        free = np.zeros(len(self.model.unknowns), dtype=bool)
        free[self.reading_unknowns] = True
        return FitProblem(self.model, free)

    def linearised(
        self, motions: LanderMotions, slopes: MotionSlopes | None = None, noise_factor: float = 1.0
    ) -> DenseSystem:
        """Return the normal equations of K motions, with `noise_factor` times the noise; `extras` are their :class:`MotionSlopes`.

        The coordinates are the five of rate and direction, then the s reading unknowns. Derivatives of the track come from
        differences of runs or, without further runs, from the `slopes` of motions near by. These are then corrected by the change
        of the track over the step from there (Broyden's method), if the step is in rate and direction alone.
        """
        problem = self._problem
        state = motions.omega, motions.sun, motions.u
        if slopes is None:
            system = problem.linearised(motions, noise_factor)
        else:
            before = LanderMotions(slopes.omega, slopes.sun, slopes.u)
            step, moving = motions.from_centre(before)[:, :STATE_SIZE], self.motion_unknowns
            # if unknowns of the motion differ too, the track does not change by the step alone
            same_body = np.all(motions.u[:, moving] == slopes.u[:, moving], axis=1)
            correct = same_body & (rotation_by(step, self.model.reach_s) > LEAST_TURN_RAD)
            # a step of zero corrects nothing
            step = np.where(correct[:, None], step, 0.0)
            track_slopes, step = in_tangents_at(motions.sun, slopes.sun, slopes.track_slopes, step)
            point = FitState(*state, track_slopes, slopes.track, step)
            system = problem.linearised_after(point, noise_factor)
        linear = system.extras
        extras = MotionSlopes(*state, linear.track_slopes, linear.track)
        return DenseSystem(system.cost, system.matrix, system.slope, extras=extras)

    def track(self, motions: LanderMotions) -> np.ndarray:
        """Return the track (K, n, w) of motions, NaN for those that could not be computed."""
        return self._problem.track(motions, SEARCH_ERROR)

    def reading_slopes(self, track: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the gradient (K, s) of the log likelihood by the reading unknowns, and the matrix J'WJ (K, s, s).

        J'WJ is minus the second derivative in Gauss-Newton's approximation. The `track` (K, n, w) is fixed; `u` (K, m) are all
        unknowns. Priors are not included. Both are zero for motions that could not be computed.
        """
        # Without derivatives of the track (c = 0) the Jacobian has only the columns of the reading unknowns. As the track is given,
        # rate and direction at the reference are not used.
        problem, no_slopes = self._problem, np.zeros((len(u), 0, *track.shape[1:]))
        unused = np.zeros((len(u), 3))
        linear = problem.linear_readings(LanderMotions(unused, unused, u), track, no_slopes)
        _, weight = problem.weigh(linear.residuals, u, noise_factor=1.0)
        curvature, cost_slope = normal_equations(linear.residuals, linear.jacobian, weight)
        return -cost_slope, curvature

    def log_likelihood(self, track: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the log likelihood (K) of all readings, given the track (K, n, w) and the unknowns u (K, m)."""
        return self.model.log_likelihood(states_of(track), u)

    def log_replicated(
        self, track: np.ndarray, u: np.ndarray, rng: np.random.Generator
    ) -> np.ndarray:
        """Return the log likelihoods (K) of readings that are simulated with each motion, under that motion.

        Compared with :meth:`log_likelihood` they show whether the measured readings are as probable as simulated ones.
        """
        model, states = self.model, states_of(track)
        u_panels = u[:, model.of_panels]
        simulated = model.panels.replicated(states, u_panels, rng)
        total = simulated.log_density(states, u_panels)
        for term in model.given:  # other observations have normal errors
            errors = rng.standard_normal((len(u), int(term.explained)))
            total = total - 0.5 * np.sum(errors**2, axis=1)
        return total

    def outlier_probability(self, motions: LanderMotions) -> np.ndarray:
        """Return the probability (n, p) that a panel reading does not come from the Sun, averaged over motions."""
        track = self.track(motions)
        computed = np.isfinite(track).all(axis=(1, 2))
        u_panels = motions.u[computed][:, self.model.of_panels]
        return self.model.panels.outlier_probability(states_of(track[computed]), u_panels)
