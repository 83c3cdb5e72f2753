"""Model of a lander: a body with wheels that run down, its unknowns with their priors, and the observations.

Unlike in a chain (:mod:`sunspin.estimate.model`) the equations of motion are exact: the state at one instant, the reference, and
the unknowns give the whole motion. So the readings also determine inertia and friction (docs/posterior.md). Units are SI and
radians. Arrays hold K motions and m unknowns u, which are counted in sigmas from the centres of their priors.
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
"""Kinds of unknowns that are logarithms of factors on properties of wheels -> names of these properties in `Bodies`."""

MASS = ("inertia", "wheel_inertia")
"""Kinds of unknowns some values of which describe a body that cannot exist."""

FARTHEST = 8.0
"""Limit of an unknown in a fit, in its largest sigmas from its centre."""

HALVINGS = 30
"""Bisections that find the largest possible deviation of inertias from their centres, to 1e-9 of the deviation."""

LEAST_MOMENT = 0.01
"""Least moment with free wheels, as a part of the nominal body's: steps of a run grow with its inverse. A prior with a sigma of
100 % has 0.2 % of its mass below."""

PRIOR_DRAWS = 20_000
"""Draws from which the share of possible bodies in the prior is estimated: a share of 0.5 to 1 % of itself, one of 0.03 to 4 %."""

Sizes = Mapping[str, int]
"""Kind of unknowns with several possible prior sigmas (:attr:`Unknown.shares`) -> index of the sigma that a fit uses."""

ALL_SIZES: Sizes = {}
"""A fit uses the prior with all possible sigmas: their mixture."""


@dataclass(frozen=True)
class LanderModel:
    """A lander and its observations.

    `of_motion`: the unknowns on which the motion depends; those of the panels follow them. `max_rate` (rad/s): largest rate at the
    reference, below which the prior is uniform. The reference is `after_s` after the first sample. Times of the observations count
    from it, but wheel speeds of vehicle and unknowns are those at the first sample. `frame`: axes in which a constant torque is
    fixed ("B": body, "N": space), empty without one; `what`: the model in words.
    """

    vehicle: Vehicle
    obs: Observations
    of_motion: tuple[Unknown, ...]
    max_rate: float
    wheel_mode: str | tuple[str, ...] = "coast"
    after_s: float = 0.0
    frame: Frame | Literal[""] = ""
    what: str = AS_STATED

    @cached_property
    def panels(self) -> PanelPowers:
        """Return the sensor model of the panels with their readings."""
        return next(term for term in self.obs.terms if isinstance(term, PanelPowers))

    @cached_property
    def given(self) -> tuple[Given, ...]:
        """Return the observations that do not come from panels, each with its sensor model."""
        return tuple(term for term in self.obs.terms if isinstance(term, Given))

    @cached_property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Return all m unknowns: of the motion, then of the panels."""
        return (*self.of_motion, *self.panels.own)

    @property
    def commands(self) -> tuple[str, ...]:
        """Return the mode of each wheel, such as "coast" or "hold"."""
        return batch.one_command(self.vehicle, self.wheel_mode)

    @property
    def of_panels(self) -> slice:
        """Return the slice of the unknowns that belongs to the panels."""
        return slice(len(self.of_motion), None)

    @cached_property
    def reach_s(self) -> float:
        """Return the longest time from the reference to a sample, s."""
        return max(float(np.abs(self.obs.t_s).max()), 1e-6)

    @property
    def dimension(self) -> int:
        """Return the number D of coordinates of a motion: rate, direction and unknowns."""
        return STATE_SIZE + len(self.unknowns)

    def indices(self, *kinds: str) -> list[int]:
        """Return the indices of the unknowns of some kinds."""
        return [i for i, unknown in enumerate(self.unknowns) if unknown.kind in kinds]

    def values(self, u: np.ndarray) -> np.ndarray:
        """Return unknowns u (K, m) in their own units (:attr:`Unknown.unit`)."""
        centre = np.array([unknown.centre for unknown in self.unknowns])
        return centre + u * np.array([unknown.sigma for unknown in self.unknowns])

    def _deviation(self, u: np.ndarray, kind: str, count: int) -> np.ndarray:
        """Return the deviations (K, count) from their centres of `count` numbers of a kind, such as the friction of each wheel.

        The columns are those of :attr:`Unknown.index`. The deviation is zero for numbers that are no unknowns.
        """
        deviation = np.zeros((len(u), count))
        for i in self.indices(kind):
            deviation[:, self.unknowns[i].index] = self.unknowns[i].sigma * u[:, i]
        return deviation

    def at_centres(self, omega: np.ndarray, sun: np.ndarray) -> LanderMotions:
        """Return the motions with rates (K, 3) and directions (K, 3) at the reference, and all unknowns at their centres."""
        return LanderMotions(omega, sun, np.zeros((len(omega), len(self.unknowns))))

    def at_samples(self, samples: slice) -> LanderModel:
        """Return the model with the observations of some of the samples only."""
        return replace(self, obs=self.obs.take(samples))

    def after(self, after_s: float, max_rate: float) -> LanderModel:
        """Return the model with its reference `after_s` after the first sample, and `max_rate` (rad/s) as largest rate there."""
        obs = replace(self.obs, t_s=self.obs.t_s - (after_s - self.after_s))
        return replace(self, obs=obs, after_s=after_s, max_rate=max_rate)

    def _with_several_sigmas(self) -> Iterator[tuple[list[int], np.ndarray, np.ndarray]]:
        """Yield for each kind of unknowns with s possible prior sigmas: indices, the sigmas, and the logs of their probabilities.

        The sigmas (s) are factors of `Unknown.sigma`. All unknowns of a kind have the same one.
        """
        for kind in dict.fromkeys(x.kind for x in self.unknowns if len(x.shares) > 1):
            indices = self.indices(kind)
            shares = np.array(self.unknowns[indices[0]].shares)
            probability = np.full(len(shares), 1 / len(shares))
            if kind == "inertia":
                probability = np.array([1 - LOOSER_CHANCE, LOOSER_CHANCE])
            yield indices, shares, np.log(probability)

    def prior_cost(self, u: np.ndarray, sizes: Sizes = ALL_SIZES) -> tuple[np.ndarray, np.ndarray]:
        """Return minus the log prior density (K) of unknowns u (K, m), and the weights (K, m) of their squares in a fit.

        The density is over that of m standard normal numbers at zero. Unknowns with several possible sigmas have a mixture of
        normal densities, unless `sizes` has the index of the one sigma to use. Their weight is the inverse square of the sigma,
        averaged over the sigmas with their probabilities at u.
        """
        total, weight = (0.5 * u**2).sum(axis=1), np.ones_like(u)
        for indices, shares, log_probability in self._with_several_sigmas():
            if (size := sizes.get(self.unknowns[indices[0]].kind)) is not None:
                shares, log_probability = shares[[size]], log_probability[[size]]
            half_square = 0.5 * np.sum(u[:, indices] ** 2, axis=1)[:, None]
            # log of the joint density of u and each sigma (K, s)
            joint = log_probability - half_square / shares**2 - len(indices) * np.log(shares)
            mixture = logsumexp(joint, axis=1)
            # the mixture replaces the standard normal density that `total` began with
            total += -mixture - half_square[:, 0]
            weight[:, indices] = (np.exp(joint - mixture[:, None]) @ shares**-2.0)[:, None]
        return total, weight

    def log_prior_density(self, motions: LanderMotions) -> np.ndarray:
        """Return the log prior density (K) over rate (rad/s), direction to the Sun (solid angle) and u.

        It is minus infinity for bodies that cannot exist and for rates above the largest. Over all others it is normalised.
        """
        volume = np.log(4 / 3 * np.pi * self.max_rate**3) + np.log(4 * np.pi)
        density = -self.prior_cost(motions.u)[0] - 0.5 * len(self.unknowns) * np.log(2 * np.pi)
        # a fit that ends on the largest rate may exceed it by rounding
        allowed = np.linalg.norm(motions.omega, axis=1) <= self.max_rate * (1 + 1e-12)
        if self.indices(*MASS):
            allowed &= self._can_exist(self._bodies_of(motions.u))
        return np.where(allowed, density - volume - self.log_possible, -np.inf)

    @cached_property
    def log_possible(self) -> float:
        """Return the log of the prior probability that a body with these unknowns can exist (:meth:`_can_exist`).

        :meth:`log_prior_density` is divided by this probability, so that it is normalised over the bodies that can exist. The
        probability is estimated from `PRIOR_DRAWS` draws. It is one, and its log zero, if no inertia is unknown.
        """
        if not self.indices(*MASS):
            return 0.0
        # a fixed seed, as this is a property of the model: it must not change with the seed of the caller
        rng = np.random.default_rng(0)
        u = rng.standard_normal((PRIOR_DRAWS, len(self.unknowns)))
        # if a kind has several possible sigmas, each draw takes one of them for all unknowns of the kind
        for indices, shares, log_probability in self._with_several_sigmas():
            u[:, indices] *= rng.choice(shares, (PRIOR_DRAWS, 1), p=np.exp(log_probability))
        count = np.count_nonzero(self._can_exist(self._bodies_of(u)))
        # at least one draw counts as possible, so that the log is finite
        return float(np.log(max(count, 1) / PRIOR_DRAWS))

    def bodies(self, u: np.ndarray) -> Bodies:
        """Return inertia, wheels, friction and torque of unknowns u (K, m); bodies that cannot exist are made :meth:`possible`."""
        return self._bodies_of(self.possible(u))

    def _bodies_of(self, u: np.ndarray) -> Bodies:
        """Return the bodies (K) that unknowns u (K, m) describe, also those that cannot exist."""
        nominal, wheels = Bodies.of(self.vehicle, len(u)), len(self.vehicle.wheels)
        tensor = np.array(nominal.inertia_kg_m2)
        for i in self.indices("inertia"):
            a, b = divmod(self.unknowns[i].index, 3)  # row and column of the tensor
            tensor[:, a, b] += self.unknowns[i].sigma * u[:, i]
            tensor[:, b, a] = tensor[:, a, b]
        factors = {
            name: getattr(nominal, name) * np.exp(self._deviation(u, kind, wheels))
            for kind, name in WHEEL_FACTORS.items()
        }
        steady = self.steady_torques(u) * np.trace(self.vehicle.require_inertia()) / 3
        return replace(nominal, inertia_kg_m2=tensor, steady_N_m=steady, **factors)

    def steady_torques(self, u: np.ndarray) -> np.ndarray:
        """Return the constant torques (K, 2, 3), over the mean moment of inertia (rad/s2): one fixed in the body, one in space.

        The components of both are along the body axes at the reference.
        """
        steady = np.zeros((len(u), 2, 3))
        steady[:, 1 if self.frame == "N" else 0] = self._deviation(u, "steady_torque", 3)
        return steady

    def _can_exist(self, bodies: Bodies) -> np.ndarray:
        """Return which bodies (K) can exist.

        The largest moment of inertia is at most the sum of the two others. The least one without the wheels' part about their axes,
        as if the wheels turned freely, is at least `LEAST_MOMENT` times that of the nominal body.
        """
        _, largest = extreme_eigenvalues(bodies.inertia_kg_m2)
        others = np.trace(bodies.inertia_kg_m2, axis1=-2, axis2=-1) - largest
        free = [True] * bodies.n_wheels
        nominal = Bodies.of(self.vehicle)
        least_nominal = extreme_eigenvalues(gyrostat.free_inertia(nominal, free))[0]
        least = extreme_eigenvalues(gyrostat.free_inertia(bodies, free))[0]
        is_triangle = largest <= others * (1 + SYMMETRY_TOLERANCE)
        return np.asarray(is_triangle & (least >= LEAST_MOMENT * least_nominal))

    def possible(self, u: np.ndarray, inside: float = 1.0) -> np.ndarray:
        """Return unknowns u (K, m), changed where the body cannot exist.

        There all deviations of inertias are shortened to the part `inside` of the longest ones with which the body can exist. These
        are found by bisection, as all shorter ones are possible too: the conditions are convex in the tensor of the body. A
        wheel's inertia is the exponential of its unknown: on the way it adds less than in proportion, so this holds for it too.
        """
        mass = self.indices(*MASS)
        if not mass or not len(u):
            return u
        impossible = np.flatnonzero(~self._can_exist(self._bodies_of(u)))
        if not len(impossible):
            return u
        rows, shortened = impossible[:, None], u.copy()
        low, high = np.zeros(len(impossible)), np.ones(len(impossible))  # factors on the deviations
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            shortened[rows, mass] = middle[:, None] * u[rows, mass]
            can_exist = self._can_exist(self._bodies_of(shortened[impossible]))
            low, high = np.where(can_exist, middle, low), np.where(can_exist, high, middle)
        shortened[rows, mass] = inside * low[:, None] * u[rows, mass]
        return shortened

    def limited(self, u: np.ndarray, inside: float = 1.0) -> np.ndarray:
        """Return unknowns u (K, m) cut off at :data:`FARTHEST`, and with bodies that can exist (:meth:`possible`)."""
        most = FARTHEST * np.array([max(1.0, *unknown.shares) for unknown in self.unknowns])
        return self.possible(np.clip(u, -most, most), inside)

    def wheel_speeds(self, u: np.ndarray) -> np.ndarray:
        """Return the speeds (K, n_wheel) of the wheels at the reference, rad/s.

        The vehicle file and the unknowns give them at the first sample. Until the reference, `after_s` later, friction slows every
        wheel that its motor does not hold, as does a brake that is on. This neglects how the body's own rate about the wheel's axis
        changes in that time: 0.3 rad/s if Philae takes up the whole momentum of its wheel, which ran at 865 rad/s.
        """
        wheels = self.vehicle.wheels
        stated = np.array([wheel.speed_rad_s for wheel in wheels])
        speeds = stated + self._deviation(u, "wheel_speed", len(wheels))
        if not self.after_s:  # the reference is the first sample
            return speeds
        bodies = self.bodies(u)
        for i, (wheel, command) in enumerate(zip(wheels, self.commands, strict=True)):
            if command != "hold":
                speeds[:, i] = spin_down_speed(
                    friction_limit(wheel, command, bodies.coulomb_N_m[:, i]),
                    bodies.viscous_N_m_s[:, i],
                    bodies.wheel_inertia_kg_m2[:, i],
                    speeds[:, i],
                    self.after_s,
                )
        return speeds

    def nominal_speeds(self, after_s: float) -> np.ndarray:
        """Return the speeds (n_wheel) of the wheels `after_s` after the first sample, rad/s, with unknowns at their centres."""
        centres = np.zeros((1, len(self.unknowns)))
        return replace(self, after_s=after_s).wheel_speeds(centres)[0]

    def spun_up(self, after_s: float) -> float:
        """Return the rate (rad/s) that wheels running down for `after_s` give the body, if about the axis of its least moment."""
        lost = np.abs(self.nominal_speeds(after_s) - self.nominal_speeds(0.0))
        momentum = lost @ np.array([wheel.inertia_kg_m2 for wheel in self.vehicle.wheels])
        return float(momentum / np.linalg.eigvalsh(self.vehicle.require_inertia())[0])

    @property
    def acting(self) -> Acting:
        """Return the torques that act on the body: a constant one, or none."""
        return Acting((Steady(),) if self.frame else (), start_s=self.after_s)

    def rows(self, motions: LanderMotions) -> batch.Rows:
        """Return the states at the reference for :func:`batch.run`, without bodies if all are the vehicle's nominal one."""
        bodies = None
        of_body = [unknown.kind != "wheel_speed" for unknown in self.of_motion]
        if motions.u[:, : len(of_body)][:, of_body].any():
            bodies = self.bodies(motions.u)
        return batch.Rows(motions.omega, motions.sun, self.wheel_speeds(motions.u), bodies)

    def run(
        self, rows: batch.Rows, times_s: np.ndarray, error_rad: float, attitude: bool = False
    ) -> batch.Motion:
        """Return motions at times (n) from the reference, all later or all earlier than it; with the attitude if asked for.

        `rows`: their states at the reference; `error_rad`: largest error of directions.
        """
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

    def sun_states(self, motions: LanderMotions, error_rad: float) -> SunStates:
        """Return rates and directions to the Sun of K motions at all samples, propagated from the reference to both sides.

        `error_rad`: largest error of the directions. A motion that cannot be computed to all samples is NaN at all of them.
        """
        t_s, rows = self.obs.t_s, self.rows(motions)
        sun, omega = (np.empty((len(motions), len(t_s), 3)) for _ in range(2))
        computed = np.ones(len(motions), dtype=bool)
        # times count from the reference, from which each run begins: the samples before it are reached latest first
        before, after = np.flatnonzero(t_s < 0)[::-1], np.flatnonzero(t_s >= 0)
        for samples in (before, after):
            if len(samples):
                motion = self.run(rows, t_s[samples], error_rad)
                sun[:, samples], omega[:, samples] = motion.sun_B, motion.omega_B
                computed &= motion.outcome == batch.Outcome.FINE
        computed &= np.isfinite(sun).all(axis=(1, 2)) & np.isfinite(omega).all(axis=(1, 2))
        sun[~computed], omega[~computed] = np.nan, np.nan
        return SunStates.of(sun, omega)

    def first_speed(self, motions: LanderMotions, error_rad: float) -> np.ndarray:
        """Return the angular speeds (K) of motions at the first sample, rad/s; infinite for those that cannot be computed."""
        if not (self.after_s and len(motions)):  # the reference is the first sample, or no motions
            return np.linalg.norm(motions.omega, axis=1)
        back = self.run(self.rows(motions), np.array([-self.after_s]), error_rad)
        speed = np.linalg.norm(back.omega_B[:, 0], axis=1)
        return np.where(np.isfinite(speed), speed, np.inf)

    def log_likelihood(self, states: SunStates, u: np.ndarray) -> np.ndarray:
        """Return the log likelihood (K) of all readings for states at the samples and unknowns u (K, m).

        The normalising constants of the observations other than panels are left out: all motions share them. The result is minus
        infinity for motions that could not be computed.
        """
        with np.errstate(invalid="ignore"):
            total = self.panels.log_density(states, u[:, self.of_panels])
            no_unknowns = u[:, :0]
            for term in self.given:
                for residual in term.residuals(states, no_unknowns):
                    cost, _ = residual.law(residual.value)  # of each sample, and its weight
                    total = total - cost.sum(axis=1)
        computed = np.isfinite(states.sun_B).all(axis=(1, 2)) & np.isfinite(total)
        return np.where(computed, total, -np.inf)
