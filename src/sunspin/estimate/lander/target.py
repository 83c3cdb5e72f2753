"""The posterior of a lander under one model, as :mod:`sunspin.estimate.lander.sample` asks for it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sunspin.estimate.lander.fit import (
    SEARCH_ERROR,
    FitProblem,
    Point,
    in_tangents_at,
    states_of,
)
from sunspin.estimate.lander.model import CarriedStates, LanderModel
from sunspin.estimate.lander.motions import RATE, STATE_SIZE, SUN, LanderMotions
from sunspin.estimate.model import Unknown
from sunspin.solve.linear import DenseSystem

LEAST_TURN_RAD = 1e-3
"""Derivatives are not corrected by steps that rotate the body by less than this within the window: the change would be comparable
with the error of runs, 1e-5 rad."""


class MotionSlopes(NamedTuple):
    """K motions, what sensors `seen` (K, ...) of them, and its derivatives `seen_slopes` (K, 5, ...) by rate and direction.

    Least squares at motions near by begins with these derivatives.
    """

    omega: np.ndarray
    sun: np.ndarray
    u: np.ndarray
    seen_slopes: np.ndarray
    seen: np.ndarray


@dataclass(frozen=True)
class LanderTarget:
    """Posterior of the motions of a lander under one model: K motions are evaluated at once.

    What is `seen` (K, n, w) of motions are directions to the Sun, and rates if they are needed (:meth:`FitProblem.seen`).
    """

    model: LanderModel

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the unknowns (m)."""
        return self.model.unknowns

    @cached_property
    def reading_unknowns(self) -> np.ndarray:
        """Return the indices (s) of unknowns that change readings, but not the motion: brightness, gains, tilts; not the noise."""
        own = np.arange(len(self.model.of_motion), len(self.unknowns))
        return np.setdiff1d(own, self.model.places("noise"))

    @cached_property
    def motion_unknowns(self) -> np.ndarray:
        """Return the indices of unknowns that change the motion: inertia, friction, wheel speeds, torques."""
        return np.arange(len(self.model.of_motion))

    @property
    def reach_s(self) -> float:
        """Return the longest time from the reference to a sample."""
        return self.model.reach_s

    @property
    def rate_max(self) -> float:
        """Return the largest rate (rad/s)."""
        return self.model.max_rate

    @cached_property
    def _problem(self) -> FitProblem:
        """Return the fit of rate, direction and reading unknowns."""
        free = np.zeros(len(self.unknowns), dtype=bool)
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
            step = motions.from_centre(LanderMotions(slopes.omega, slopes.sun, slopes.u))[
                :, :STATE_SIZE
            ]
            turn = np.maximum(
                np.linalg.norm(step[:, RATE], axis=1) * self.reach_s,
                np.linalg.norm(step[:, SUN], axis=1),
            )
            # if unknowns of the motion differ too, the change is not by the step alone
            alike = np.all(
                motions.u[:, self.motion_unknowns] == slopes.u[:, self.motion_unknowns], axis=1
            )
            learnt = (alike & (turn > LEAST_TURN_RAD))[:, None]
            seen_slopes, step = in_tangents_at(
                motions.sun, slopes.sun, slopes.seen_slopes, np.where(learnt, step, 0.0)
            )
            state = motions.omega, motions.sun, motions.u
            point = Point(*state, seen_slopes, slopes.seen, step)
            system = problem.linearised_after(point, noise_factor)
        linear = system.extras
        at = MotionSlopes(motions.omega, motions.sun, motions.u, linear.seen_slopes, linear.seen)
        return DenseSystem(system.cost, system.matrix, system.slope, extras=at)

    def run(self, motions: LanderMotions) -> np.ndarray:
        """Return what sensors see (K, n, w), not a number for motions that could not be computed."""
        seen, fine = self._problem.seen(motions, SEARCH_ERROR)
        return np.where(fine[:, None, None], seen, np.nan)

    def reading_slopes(self, seen: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return slope (K, s) and curvature (K, s, s) of the log likelihood in the reading unknowns."""
        problem, still = self._problem, np.zeros((len(u), 0, *seen.shape[1:]))
        # differences of readings do not use rate and direction at the reference
        unused = np.zeros((len(u), 3))
        linear = problem.differences(LanderMotions(unused, unused, u), seen, still)
        _, weight = problem.weigh(linear.value, u, 1.0)
        jacobian = linear.jacobian
        weighted = np.swapaxes(jacobian * weight[..., None], 1, 2)
        return -(weighted @ linear.value[..., None])[..., 0], weighted @ jacobian

    def log_likelihood(self, seen: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the log likelihood (K) of all readings."""
        carried = CarriedStates(states_of(seen), np.all(np.isfinite(seen), axis=(1, 2)))
        return self.model.log_likelihood(carried, u)

    def log_replicated(
        self, seen: np.ndarray, u: np.ndarray, rng: np.random.Generator
    ) -> np.ndarray:
        """Return the log likelihood (K) of readings simulated from the motions, each set under its own motion."""
        model, states = self.model, states_of(seen)
        of_panels = u[:, model.of_panels]
        simulated = model.panels.replicated(states, of_panels, rng)
        total = simulated.log_density(states, of_panels)
        for term in model.given:
            off = rng.standard_normal((len(u), int(term.explained)))
            total = total - 0.5 * np.sum(off**2, axis=1)
        return total

    def outlier_probability(self, motions: LanderMotions) -> np.ndarray:
        """Return the probability (n, p) that a reading is not of the Sun, in the mean of motions."""
        seen = self.run(motions)
        fine = np.isfinite(seen).all(axis=(1, 2))
        own = motions.u[fine][:, self.model.of_panels]
        return self.model.panels.outlier_probability(states_of(seen[fine]), own)

    def log_prior(self, motions: LanderMotions) -> np.ndarray:
        """Return the log prior density (K)."""
        return self.model.log_prior_density(motions)
