"""Model of a lander: a body with wheels that run down, its unknowns with their priors, and the observations.

Unlike in a chain (:mod:`sunspin.estimate.model`) the equations of motion are exact: one state and the unknowns give the whole
motion. So the readings also determine inertia and friction (docs/posterior.md). Units are SI and radians.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.special import logsumexp

from sunspin.dynamics import batch, gyrostat
from sunspin.dynamics.bodies import Bodies
from sunspin.dynamics.friction import spin_down_speed
from sunspin.dynamics.torques import Acting, Steady
from sunspin.dynamics.wheel_modes import friction_limit
from sunspin.estimate.lander.motions import STATE_SIZE, LanderMotions
from sunspin.estimate.model import AS_STATED, Observations, Unknown
from sunspin.estimate.settings import LOOSER_CHANCE
from sunspin.estimate.terms.given import Given
from sunspin.estimate.terms.powers import PanelPowers, SunStates
from sunspin.estimate.terms.torques import Frame
from sunspin.solve.linear import extreme_eigenvalues
from sunspin.vehicle import Vehicle
from sunspin.vehicle.craft import SYMMETRY_TOLERANCE

WHEEL_FACTORS = {
    "wheel_inertia": "wheel_inertia_kg_m2",
    "coulomb": "coulomb_N_m",
    "viscous": "viscous_N_m_s",
}
"""Kinds of unknowns that are logs of factors on numbers of wheels -> names of these numbers of a body."""

MASS = ("inertia", "wheel_inertia")
"""Kinds of unknowns that may describe a body that cannot exist."""

FARTHEST = 8.0
"""Limit of an unknown in a fit, in its largest sigmas from its centre."""

HALVINGS = 30
"""Bisections that find how far inertias may be from their centres: to 1e-9 of their distance."""

LEAST_MOMENT = 0.01
"""Least moment with free wheels, as a part of the nominal body's: steps of a run grow with its inverse. A prior with a sigma of
100 % has 0.2 % of its mass below."""

PRIOR_DRAWS = 20_000
"""Draws by which the part of the prior that describes bodies is measured: a half of it to 1 %, 3 % of it to 4 %."""


Sizes = Mapping[str, int]
"""Kind of unknowns with several possible sigmas (:attr:`Unknown.shares`) -> index of the one that a fit uses."""

ALL_SIZES: Sizes = {}
"""The prior is the mixture over all sigmas."""


@dataclass(frozen=True)
class LanderModel:
    """A lander and its observations.

    `of_motion`: the unknowns on which the motion depends; those of the panels follow them. `max_rate` (rad/s): the ball of rates at
    the reference, which is `after_s` after the first sample; times of the observations count from there, wheel speeds are those at
    the first sample. `frame`: in which axes a constant torque acts, if any; `what`: the model in words.
    """

    vehicle: Vehicle
    obs: Observations
    of_motion: tuple[Unknown, ...]
    max_rate: float
    wheel_mode: str | tuple[str, ...] = "coast"
    after_s: float = 0.0
    frame: Frame | Literal[""] = ""
    what: str = AS_STATED

    # ---- unknowns ----------------------------------------------------------------------------------------------------------

    @cached_property
    def panels(self) -> PanelPowers:
        """Return the readings of the panels."""
        return next(term for term in self.obs.terms if isinstance(term, PanelPowers))

    @cached_property
    def given(self) -> tuple[Given, ...]:
        """Return the other observations."""
        return tuple(term for term in self.obs.terms if isinstance(term, Given))

    @cached_property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Return all unknowns (m): of the motion, then of the panels."""
        return (*self.of_motion, *self.panels.own)

    @property
    def commands(self) -> tuple[str, ...]:
        """Return the mode of each wheel."""
        return batch.one_command(self.vehicle, self.wheel_mode)

    @property
    def of_panels(self) -> slice:
        """Return where the unknowns of the panels stand."""
        return slice(len(self.of_motion), None)

    @cached_property
    def reach_s(self) -> float:
        """Return the longest time from the reference to a sample."""
        return max(float(np.abs(self.obs.t_s).max()), 1e-6)

    @property
    def dimension(self) -> int:
        """Return the number D of coordinates of a motion."""
        return STATE_SIZE + len(self.unknowns)

    def indices(self, *kinds: str) -> list[int]:
        """Return the indices of the unknowns of some kinds."""
        return [i for i, unknown in enumerate(self.unknowns) if unknown.kind in kinds]

    def values(self, u: np.ndarray) -> np.ndarray:
        """Return the unknowns (K, m) in their own units."""
        centre = np.array([unknown.centre for unknown in self.unknowns])
        return centre + u * np.array([unknown.sigma for unknown in self.unknowns])

    def _deviation(self, u: np.ndarray, kind: str, count: int) -> np.ndarray:
        """Return the deviations (K, count) of the unknowns of a kind from their centres, by :attr:`Unknown.index`.

        They are zero for numbers that are known.
        """
        off = np.zeros((len(u), count))
        for i in self.indices(kind):
            off[:, self.unknowns[i].index] = self.unknowns[i].sigma * u[:, i]
        return off

    def at_centres(self, omega: np.ndarray, sun: np.ndarray) -> LanderMotions:
        """Return motions by rates (K, 3) and directions (K, 3) at the reference, all unknowns at their centres."""
        return LanderMotions(omega, sun, np.zeros((len(omega), len(self.unknowns))))

    def seeing(self, samples: slice) -> LanderModel:
        """Return the model of some of the samples."""
        return replace(self, obs=self.obs.take(samples))

    def after(self, after_s: float, max_rate: float) -> LanderModel:
        """Return the model with a reference `after_s` after the first sample, and another ball of rates (rad/s) there."""
        obs = replace(self.obs, t_s=self.obs.t_s - (after_s - self.after_s))
        return replace(self, obs=obs, after_s=after_s, max_rate=max_rate)

    # ---- prior -------------------------------------------------------------------------------------------------------------

    def _shared(self) -> Iterator[tuple[list[int], np.ndarray, np.ndarray]]:
        """Yield each kind of unknowns with s possible sigmas: indices, the sigmas over `sigma` (s), and their log odds (s)."""
        for kind in dict.fromkeys(x.kind for x in self.unknowns if len(x.shares) > 1):
            indices = self.indices(kind)
            shares = np.array(self.unknowns[indices[0]].shares)
            odds = np.full(len(shares), 1 / len(shares))
            if kind == "inertia":
                odds = np.array([1 - LOOSER_CHANCE, LOOSER_CHANCE])
            yield indices, shares, np.log(odds)

    def prior_cost(self, u: np.ndarray, sizes: Sizes = ALL_SIZES) -> tuple[np.ndarray, np.ndarray]:
        """Return minus the log prior density (K) of unknowns, over that of m standard normal numbers at zero, and weights (K, m).

        A fit multiplies the square of each unknown by its weight. The prior of unknowns with several possible sigmas is a mixture
        of normal laws, unless `sizes` names the index of the one sigma to use.
        """
        cost, weight = 0.5 * u**2, np.ones_like(u)
        total = cost.sum(axis=1)
        for indices, shares, log_odds in self._shared():
            some = u[:, indices]
            if (size := sizes.get(self.unknowns[indices[0]].kind)) is not None:
                shares, log_odds = shares[[size]], log_odds[[size]]
            square = 0.5 * np.sum(some**2, axis=1)[:, None]
            of_sigmas = log_odds - square / shares**2 - len(indices) * np.log(shares)  # (K, s)
            mixture = logsumexp(of_sigmas, axis=1)
            total += -mixture - square[:, 0]
            weight[:, indices] = (np.exp(of_sigmas - mixture[:, None]) @ shares**-2.0)[:, None]
        return total, weight

    def log_prior_density(self, motions: LanderMotions) -> np.ndarray:
        """Return the log prior density (K) over rate (rad/s), direction and u.

        It is minus infinity for bodies that cannot exist and rates beyond the ball, and normalised over the others.
        """
        ball = np.log(4 / 3 * np.pi * self.max_rate**3) + np.log(4 * np.pi)
        density = -self.prior_cost(motions.u)[0] - 0.5 * len(self.unknowns) * np.log(2 * np.pi)
        # a fit that ends on the largest rate may exceed it by rounding
        allowed = np.linalg.norm(motions.omega, axis=1) <= self.max_rate * (1 + 1e-12)
        if self.indices(*MASS):
            allowed &= self._exists(self._bodies_of(motions.u))
        return np.where(allowed, density - ball - self.log_possible, -np.inf)

    @cached_property
    def log_possible(self) -> float:
        """Return the log of the part of the prior that describes bodies that can exist."""
        if not self.indices(*MASS):
            return 0.0
        # a property of the prior, which does not depend on the seed of the draws
        rng = np.random.default_rng(0)
        u = rng.standard_normal((PRIOR_DRAWS, len(self.unknowns)))
        for indices, shares, log_odds in self._shared():
            u[:, indices] *= rng.choice(shares, (PRIOR_DRAWS, 1), p=np.exp(log_odds))
        count = np.count_nonzero(self._exists(self._bodies_of(u)))
        return float(np.log(max(count, 1) / PRIOR_DRAWS))

    # ---- body and wheels ---------------------------------------------------------------------------------------------------

    def bodies(self, u: np.ndarray) -> Bodies:
        """Return inertia, wheels, friction and constant torque of each motion, bodies that cannot exist made :meth:`possible`."""
        return self._bodies_of(self.possible(u))

    def _bodies_of(self, u: np.ndarray) -> Bodies:
        """Return the bodies that unknowns describe, also those that cannot exist."""
        nominal, wheels = Bodies.of(self.vehicle, len(u)), len(self.vehicle.wheels)
        tensor = np.array(nominal.inertia_kg_m2)
        for i in self.indices("inertia"):
            a, b = divmod(self.unknowns[i].index, 3)
            tensor[:, a, b] += self.unknowns[i].sigma * u[:, i]
            tensor[:, b, a] = tensor[:, a, b]
        factors = {
            name: getattr(nominal, name) * np.exp(self._deviation(u, kind, wheels))
            for kind, name in WHEEL_FACTORS.items()
        }
        steady = self.steady_torques(u) * np.trace(self.vehicle.require_inertia()) / 3
        return replace(nominal, inertia_kg_m2=tensor, steady_N_m=steady, **factors)

    def steady_torques(self, u: np.ndarray) -> np.ndarray:
        """Return the constant torques (K, 2, 3) in body axes and in space, over the mean moment of inertia (rad/s2).

        Both are given in the body axes of the reference.
        """
        steady = np.zeros((len(u), 2, 3))
        steady[:, 1 if self.frame == "N" else 0] = self._deviation(u, "steady_torque", 3)
        return steady

    def _exists(self, bodies: Bodies) -> np.ndarray:
        """Return which bodies (K) can exist.

        The largest moment is at most the sum of the others, and without what free wheels carry the least one is positive.
        """
        moments = extreme_eigenvalues(bodies.inertia_kg_m2)
        others = np.trace(bodies.inertia_kg_m2, axis1=-2, axis2=-1) - moments[1]
        free = [True] * bodies.n_wheels
        nominal = Bodies.of(self.vehicle)
        least = extreme_eigenvalues(gyrostat.free_inertia(nominal, free))[0]
        own = extreme_eigenvalues(gyrostat.free_inertia(bodies, free))[0]
        fine = moments[1] <= others * (1 + SYMMETRY_TOLERANCE)
        return np.asarray(fine & (own >= LEAST_MOMENT * least))

    def possible(self, u: np.ndarray, inside: float = 1.0) -> np.ndarray:
        """Return unknowns (K, m) of bodies that can exist.

        Deviations of inertias are shortened, to the part `inside` of the longest ones with which the body can exist. All shorter
        ones are possible too. The conditions are convex in the tensor of the body. The inertia of a wheel is sampled by its
        logarithm: half the deviation of the logarithm is less than half the deviation of the inertia.
        """
        mass = self.indices(*MASS)
        if not mass or not len(u):
            return u
        wrong = np.flatnonzero(~self._exists(self._bodies_of(u)))
        if not len(wrong):
            return u
        low, high, shortened = np.zeros(len(wrong)), np.ones(len(wrong)), u.copy()
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            shortened[wrong[:, None], mass] = middle[:, None] * u[wrong[:, None], mass]
            fine = self._exists(self._bodies_of(shortened[wrong]))
            low, high = np.where(fine, middle, low), np.where(fine, high, middle)
        shortened[wrong[:, None], mass] = inside * low[:, None] * u[wrong[:, None], mass]
        return shortened

    def limited(self, u: np.ndarray, inside: float = 1.0) -> np.ndarray:
        """Return unknowns (K, m) within the limits of a fit: :data:`FARTHEST`, and bodies that can exist."""
        most = FARTHEST * np.array([max(1.0, *unknown.shares) for unknown in self.unknowns])
        return self.possible(np.clip(u, -most, most), inside)

    def wheel_speeds(self, u: np.ndarray) -> np.ndarray:
        """Return the speeds (K, n_wheel) of the wheels at the reference, rad/s.

        The body's rate is taken as constant while they run down, with an error of 1e-4 for Philae.
        """
        wheels = self.vehicle.wheels
        first = np.array([wheel.speed_rad_s for wheel in wheels])
        speeds = first + self._deviation(u, "wheel_speed", len(wheels))
        if not self.after_s:
            return speeds
        bodies = self.bodies(u)
        for i, (wheel, command) in enumerate(zip(wheels, self.commands, strict=True)):
            if command != "hold":
                brake = friction_limit(wheel, command) - wheel.friction.coulomb_N_m
                speeds[:, i] = spin_down_speed(
                    bodies.coulomb_N_m[:, i] + brake,
                    bodies.viscous_N_m_s[:, i],
                    bodies.wheel_inertia_kg_m2[:, i],
                    speeds[:, i],
                    self.after_s,
                )
        return speeds

    def nominal_speeds(self, after_s: float) -> np.ndarray:
        """Return the speeds (n_wheel) of the nominal wheels `after_s` after the first sample, rad/s."""
        none = np.zeros((1, len(self.unknowns)))
        return replace(self, after_s=after_s).wheel_speeds(none)[0]

    def spun_up(self, after_s: float) -> float:
        """Return the rate (rad/s), about the axis of the least moment, of the momentum that wheels lose up to `after_s`."""
        lost = np.abs(self.nominal_speeds(after_s) - self.nominal_speeds(0.0))
        momentum = lost @ np.array([wheel.inertia_kg_m2 for wheel in self.vehicle.wheels])
        return float(momentum / np.linalg.eigvalsh(self.vehicle.require_inertia())[0])

    # ---- motion ------------------------------------------------------------------------------------------------------------

    @property
    def acting(self) -> Acting:
        """Return what acts on the body."""
        return Acting((Steady(),) if self.frame else (), start_s=self.after_s)

    def rows(self, motions: LanderMotions) -> batch.Rows:
        """Return the states at the reference as the kernel takes them; one body for all if they differ in none."""
        bodies = None
        alike = [x.kind != "wheel_speed" for x in self.of_motion]
        if motions.u[:, : len(alike)][:, alike].any():
            bodies = self.bodies(motions.u)
        return batch.Rows(motions.omega, motions.sun, self.wheel_speeds(motions.u), bodies)

    def run(
        self, rows: batch.Rows, times_s: np.ndarray, error_rad: float, attitude: bool = False
    ) -> batch.Motion:
        """Return motions from the reference at times (n) from there, all later or all earlier; with the `attitude` if asked for."""
        return batch.run(
            self.vehicle,
            rows,
            times_s,
            command=self.wheel_mode,
            error=error_rad,
            acting=self.acting,
            attitude=attitude,
            leave_long=True,  # one motion with too many steps, far out in the priors, must not be an error for all
        )

    def carried(self, motions: LanderMotions, error_rad: float) -> SunStates:
        """Return motions at all samples, forward and backward from the reference; directions err by `error_rad` at most.

        Motions that could not be computed are not numbers.
        """
        t_s, rows = self.obs.t_s, self.rows(motions)
        sun, omega = (np.empty((len(motions), len(t_s), 3)) for _ in range(2))
        fine = np.ones(len(motions), dtype=bool)
        before, after = np.flatnonzero(t_s < 0)[::-1], np.flatnonzero(t_s >= 0)
        for samples in (before, after):
            if len(samples):
                moved = self.run(rows, t_s[samples], error_rad)
                sun[:, samples], omega[:, samples] = moved.sun_B, moved.omega_B
                fine &= moved.outcome == batch.Outcome.FINE
        fine &= np.isfinite(sun).all(axis=(1, 2)) & np.isfinite(omega).all(axis=(1, 2))
        sun[~fine], omega[~fine] = np.nan, np.nan
        return SunStates.of(sun, omega)

    def first_speed(self, motions: LanderMotions, error_rad: float) -> np.ndarray:
        """Return angular speeds (K) at the first sample, rad/s; infinite for motions that cannot be computed."""
        if not (self.after_s and len(motions)):
            return np.linalg.norm(motions.omega, axis=1)
        back = self.run(self.rows(motions), np.array([-self.after_s]), error_rad)
        speed = np.linalg.norm(back.omega_B[:, 0], axis=1)
        return np.where(np.isfinite(speed), speed, np.inf)

    def log_likelihood(self, states: SunStates, u: np.ndarray) -> np.ndarray:
        """Return the log likelihood (K) of all readings, up to a constant of the other observations.

        It is minus infinity for motions that could not be computed.
        """
        with np.errstate(invalid="ignore"):
            total = self.panels.log_density(states, u[:, self.of_panels])
            for term in self.given:
                for residual in term.residuals(states, u[:, :0]):
                    total = total - residual.law(residual.value)[0].sum(axis=1)
        fine = np.isfinite(states.sun_B).all(axis=(1, 2)) & np.isfinite(total)
        return np.where(fine, total, -np.inf)
