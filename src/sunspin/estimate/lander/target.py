"""The posterior of a lander under one model, as :mod:`sunspin.estimate.lander.sample` asks for it."""

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
with the error of runs, 1e-5 rad."""


class MotionSlopes(NamedTuple):
    """K motions, their `track` (K, ...), and its derivatives `track_slopes` (K, 5, ...) by rate and direction.

    Least squares at motions near by begins with these derivatives.
    """

    omega: np.ndarray
    sun: np.ndarray
    u: np.ndarray
    track_slopes: np.ndarray
    track: np.ndarray


@dataclass(frozen=True)
class LanderTarget:
    """Posterior of the motions of a lander under one model: K motions are evaluated at once.

    The `track` (K, n, w) of motions: directions to the Sun at the samples, and rates if they are needed (:meth:`FitProblem.track`).
    """

    model: LanderModel

    @cached_property
    def reading_unknowns(self) -> np.ndarray:
        """Return the indices (s) of unknowns that change readings, but not the motion: brightness, gains, tilts; not the noise."""
        own = np.arange(len(self.model.of_motion), len(self.model.unknowns))
        return np.setdiff1d(own, self.model.indices("noise"))

    @cached_property
    def motion_unknowns(self) -> np.ndarray:
        """Return the indices of unknowns that change the motion: inertia, friction, wheel speeds, torques."""
        return np.arange(len(self.model.of_motion))

    @cached_property
    def _problem(self) -> FitProblem:
        """Return the fit of rate, direction and reading unknowns."""
        free = np.zeros(len(self.model.unknowns), dtype=bool)
        free[self.reading_unknowns] = True
        return FitProblem(self.model, free)

    def linearised(
        self, motions: LanderMotions, slopes: MotionSlopes | None = None, noise_factor: float = 1.0
    ) -> DenseSystem:
        """Return the normal equations of K motions under `noise_factor` times the noise, with the :class:`MotionSlopes` there.

        Their coordinates are the five of rate and direction, then the s reading unknowns. With `slopes` of motions near by no
        further runs give derivatives. The given ones are corrected by the change that the step from there has made (Broyden), if it
        is a step in rate and direction alone.
        """
        problem = self._problem
        if slopes is None:
            system = problem.linearised(motions, noise_factor)
        else:
            before = LanderMotions(slopes.omega, slopes.sun, slopes.u)
            step, moving = motions.from_centre(before)[:, :STATE_SIZE], self.motion_unknowns
            # if unknowns of the motion differ too, the change is not by the step alone
            alike = np.all(motions.u[:, moving] == slopes.u[:, moving], axis=1)
            learnt = alike & (rotation_by(step, self.model.reach_s) > LEAST_TURN_RAD)
            track_slopes, step = in_tangents_at(
                motions.sun, slopes.sun, slopes.track_slopes, np.where(learnt[:, None], step, 0.0)
            )
            state = motions.omega, motions.sun, motions.u
            state = FitState(*state, track_slopes, slopes.track, step)
            system = problem.linearised_after(state, noise_factor)
        linear = system.extras
        at = MotionSlopes(motions.omega, motions.sun, motions.u, linear.track_slopes, linear.track)
        return DenseSystem(system.cost, system.matrix, system.slope, extras=at)

    def track(self, motions: LanderMotions) -> np.ndarray:
        """Return the track (K, n, w) of motions, not a number for those that could not be computed."""
        return self._problem.track(motions, SEARCH_ERROR)

    def reading_slopes(self, track: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return slope (K, s) and curvature (K, s, s) of the log likelihood in the reading unknowns."""
        problem, still = self._problem, np.zeros((len(u), 0, *track.shape[1:]))
        # differences of readings do not use rate and direction at the reference
        unused = np.zeros((len(u), 3))
        linear = problem.linear_readings(LanderMotions(unused, unused, u), track, still)
        _, weight = problem.weigh(linear.residuals, u, 1.0)
        curvature, gradient = normal_equations(linear.residuals, linear.jacobian, weight)
        return -gradient, curvature

    def log_likelihood(self, track: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the log likelihood (K) of all readings."""
        return self.model.log_likelihood(states_of(track), u)

    def log_replicated(
        self, track: np.ndarray, u: np.ndarray, rng: np.random.Generator
    ) -> np.ndarray:
        """Return the log likelihood (K) of readings simulated from the motions, each set under its own motion."""
        model, states = self.model, states_of(track)
        of_panels = u[:, model.of_panels]
        simulated = model.panels.replicated(states, of_panels, rng)
        total = simulated.log_density(states, of_panels)
        for term in model.given:
            off = rng.standard_normal((len(u), int(term.explained)))
            total = total - 0.5 * np.sum(off**2, axis=1)
        return total

    def outlier_probability(self, motions: LanderMotions) -> np.ndarray:
        """Return the probability (n, p) that a reading is not of the Sun, in the mean of motions."""
        track = self.track(motions)
        fine = np.isfinite(track).all(axis=(1, 2))
        own = motions.u[fine][:, self.model.of_panels]
        return self.model.panels.outlier_probability(states_of(track[fine]), own)
