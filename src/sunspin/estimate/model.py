"""What a fit believes: the body, what the equations of motion leave out, what was observed, and numbers estimated with a motion.

An alternative model is a :class:`Model` with one entry changed. Units are SI and radians; K candidates, n samples, m unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from sunspin.estimate.settings import (
    INERTIA,
    INERTIA_SIGMAS,
    UNKNOWN_MOMENT,
    UNKNOWN_PRODUCT,
    UNKNOWN_SHARES,
)
from sunspin.vehicle import Vehicle

if TYPE_CHECKING:
    from sunspin.estimate.terms.term import Term

SUN_N = np.array([0.0, 0.0, 1.0])
"""The direction to the Sun in N, whose z axis follows it."""

AS_STATED = "as stated"
"""Name of the nominal model, which is exactly as the vehicle file gives it."""

THINNEST = 0.1
"""No principal moment is less than this part of the mean one, and no second moment of the masses less than minus this."""

MOST_SHRINKS, SHRINK = 10, 0.8
"""Errors of a trial inertia that no body has are multiplied by the factor, so many times at most."""

SWINGS_PER_INTERVAL = 30.0, 2.0
"""How often a swing that the samples do not resolve forgets itself in an interval, at most and at least."""

SAMPLE_COST, READING_COST = 3.7, 1.5
"""Cost that a sample with a Sun, and another reading of three numbers, do not exceed in the mean of a true motion."""


@dataclass(frozen=True)
class Unknown:
    """A number that is estimated with the motion, in units of the sigma of what was known before.

    `index`: which of its `kind`; `limit`: how far (sigmas) a trial may be from the centre. `shares`: other sigmas that it may
    have, as factors of `sigma`; equally likely, but for a lander's inertia (:mod:`sunspin.estimate.lander.model`). `doubted`:
    an error that the vehicle file does not state; a sensor fits only without it.
    """

    name: str
    kind: str
    unit: str
    centre: float
    sigma: float
    index: int = 0
    limit: float = np.inf
    shares: tuple[float, ...] = (1.0,)
    doubted: bool = False


@dataclass(frozen=True)
class Body:
    """The rigid body that moves.

    `inertia` (3, 3) in units of its mean moment, which a torque-free motion does not determine; `errors` (e, 3, 3): one sigma of
    each independent error of it; `sphere`: no inertia is known. `wander`: one sigma of how far the body leaves a motion as the
    inertia is held in a search, as a part of the angle that it turns.
    """

    inertia: np.ndarray
    errors: np.ndarray
    sphere: bool = False
    wander: float = 0.0

    @classmethod
    def of(cls, vehicle: Vehicle, torques_stated: bool = False) -> Body:
        """Return the body of a vehicle; without an inertia a sphere with large errors.

        `torques_stated`: the strength of unknown torques is stated, and also stands for what a body that is no sphere does. Then a
        body without an inertia has no errors.
        """
        if vehicle.inertia_kg_m2 is None:
            sigma = np.where(np.eye(3, dtype=bool), UNKNOWN_MOMENT, UNKNOWN_PRODUCT)
            errors = _element_errors(sigma)
            return cls(np.eye(3), errors[: 0 if torques_stated else None], sphere=True)
        tensor = np.array(vehicle.inertia_kg_m2)
        moments = np.diag(tensor)
        fact = vehicle.facts.get("body.inertia_kg_m2")
        if fact is not None and fact.sigma is not None:
            sigma = np.broadcast_to(np.asarray(fact.sigma, dtype=np.float64), (3, 3))
        else:
            sigma = INERTIA * np.where(np.eye(3, dtype=bool), np.diag(moments), moments.mean())
        return cls(tensor / moments.mean(), _element_errors(sigma) / moments.mean())

    def for_search(self) -> Body:
        """Return the body with its inertia held.

        An error of a moment, in mean moments, changes the rate of the nutation by about this part of the rate of the body: that is
        its `wander`. A body without an inertia stays a sphere: other shapes are tried after the search (`starts.other_bodies`).
        """
        wander = 0.0 if self.sphere else float(np.abs(self.errors).max(initial=0.0))
        return replace(self, errors=self.errors[:0], wander=wander)

    def inertia_at(self, u: np.ndarray) -> np.ndarray:
        """Return the inertia (K, 3, 3) for errors u (K, e) in sigmas; (3, 3) if it is known exactly."""
        if not len(self.errors):
            return self.inertia
        return self.inertia + np.einsum("ke,eij->kij", u, self.errors)

    def possible(self, u: np.ndarray) -> np.ndarray:
        """Return errors (K, e) in sigmas of bodies that are possible: made smaller where no body has the inertia, else as they are.

        A principal moment is positive and at most the sum of the other two. Equivalently the second moments of the masses, trace(I)
        / 2 - I, are positive. Slightly negative ones are allowed, as a stated tensor has errors.
        """
        u = u.copy()
        for _ in range(MOST_SHRINKS if u.size else 0):
            inertia = self.inertia_at(u)
            masses = np.trace(inertia, axis1=1, axis2=2)[:, None, None] / 2 * np.eye(3) - inertia
            least_mass, least_moment = (
                np.linalg.eigvalsh(tensor)[:, 0] for tensor in (masses, inertia)
            )
            impossible = (least_mass < -THINNEST) | (least_moment < THINNEST)
            if not impossible.any():
                return u
            u[impossible] *= SHRINK
        return u

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the errors of the inertia; without an inertia they have one of two sizes, which evidence chooses."""
        sizes = np.linalg.norm(self.errors, axis=(1, 2))
        shares = UNKNOWN_SHARES if self.sphere else (1.0,)
        return tuple(
            Unknown(f"inertia_{i}", "inertia", "1", 0.0, float(size), i, INERTIA_SIGMAS, shares)
            for i, size in enumerate(sizes)
        )


def _element_errors(sigma: np.ndarray) -> np.ndarray:
    """Return symmetric tensors (e, 3, 3) with the sigma (3, 3) of one element each; elements that are known exactly have none."""
    i, j = np.nonzero(np.triu(sigma > 0))
    errors = np.zeros((len(i), 3, 3))
    each = np.arange(len(i))
    errors[each, i, j] = errors[each, j, i] = sigma[i, j]
    return errors


@dataclass(frozen=True)
class Noise:
    """What the equations of motion leave out: white angular acceleration of the strength `acceleration`, rad/s^1.5.

    `rate` (rad/s^0.5): white noise of the rate, a swing too quick for the samples: the attitude wanders, the mean rate does not.
    `steps`: intervals between samples in which the rate changes at once, each with one sigma of the change (rad/s).
    """

    acceleration: float
    rate: float = 0.0
    steps: tuple[tuple[int, float], ...] = ()

    def in_intervals(self, dt: np.ndarray) -> np.ndarray:
        """Return the strength (n - 1) in each interval dt (n - 1).

        A step of the rate with the sigma s counts as torques there: in the time dt the strength q changes the rate by q sqrt(dt).
        """
        square = np.full(len(dt), self.acceleration**2)
        for interval, sigma in self.steps:
            square[interval] += sigma**2 / dt[interval]
        return np.sqrt(square)

    def hidden_variance(self, dt: np.ndarray) -> float:
        """Return the variance (rad2/s2) of a component of the rate at an instant about the mean rate between samples.

        A rate that forgets itself in the time T (Ornstein and Uhlenbeck) and makes the attitude wander by `rate` has the variance
        rate^2 / (2 T). In the mean over T, log-uniform, as often per interval dt as :data:`SWINGS_PER_INTERVAL` says.
        """
        most, least = SWINGS_PER_INTERVAL
        mean_count = (most - least) / np.log(most / least)  # the mean of dt / T
        return float(self.rate**2 / (2 * np.median(dt)) * mean_count)


@dataclass(frozen=True)
class Observations:
    """What n samples show: times `t_s` (n), `momentum` (n, 3) of the wheels in mean moments times rad/s, and terms of sensors.

    `time_sigma_s`: one sigma of the error of each time, independent from sample to sample.
    """

    t_s: np.ndarray
    momentum: np.ndarray
    terms: tuple[Term, ...]
    time_sigma_s: float = 0.0

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.t_s)

    def take(self, samples: Any) -> Observations:
        """Return some of the samples, by index or slice."""
        terms = tuple(term.take(samples) for term in self.terms)
        return Observations(self.t_s[samples], self.momentum[samples], terms, self.time_sigma_s)

    def of_pass(self, samples: Any) -> Observations:
        """Return some of the samples, those of one pass, in which the unknowns of the terms are constant."""
        taken = self.take(samples)
        return replace(taken, terms=tuple(term.of_pass(taken.t_s) for term in taken.terms))

    def with_time_errors(self, motion: States) -> Observations:
        """Return the samples with the errors of their times added to those of the readings, for a body that moves so (K = 1).

        In the time sigma a body turns the Sun by |omega x sun| times it, and any other direction by |omega| times it at most.
        """
        of_sun, of_body = self.turned_in_time_sigma(motion)
        terms = (term.loosened(of_sun if term.of_sun else of_body, 0.0) for term in self.terms)
        return replace(self, terms=tuple(terms), time_sigma_s=0.0)

    def turned_in_time_sigma(self, motion: States) -> tuple[np.ndarray, np.ndarray]:
        """Return by how much a motion (K = 1) turns the Sun in the body, and the body, in one sigma of the times (n), rad."""
        omega, sun = motion.omega[0], motion.sun_B[0]
        sizes = (np.linalg.norm(vector, axis=1) for vector in (np.cross(omega, sun), omega))
        of_sun, of_body = (self.time_sigma_s * size for size in sizes)
        return of_sun, of_body

    @cached_property
    def sees_sun(self) -> np.ndarray:
        """Return whether each sample (n) shows something of the Sun's direction."""
        seeing = [term.present() for term in self.terms if term.of_sun]
        return np.logical_or.reduce([np.zeros(len(self), dtype=bool), *seeing])

    @cached_property
    def only_sun(self) -> bool:
        """Return whether no sensor but the Sun's reads anything."""
        return not any(term.present().any() for term in self.terms if not term.of_sun)

    @cached_property
    def cost_limit(self) -> float:
        """Return the cost that a true motion does not exceed."""
        others = sum(int(term.present().sum()) for term in self.terms if not term.of_sun)
        return SAMPLE_COST * int(self.sees_sun.sum()) + READING_COST * others


@dataclass(frozen=True)
class Model:
    """What a fit believes: readings, body, what the equations of motion leave out, and the prior of the rate.

    `rate_sigma` (rad/s): sigma of each component of the rate before the data. `log_prior`: relative to that of the nominal model;
    `what` it changes, in words.
    """

    obs: Observations
    body: Body
    noise: Noise
    rate_sigma: float
    what: str = AS_STATED
    log_prior: float = 0.0

    @cached_property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Return all numbers that are estimated with a motion: those of the body, then those of each term."""
        return (*self.body.unknowns, *(u for term in self.obs.terms for u in term.unknowns()))

    @property
    def rate_max(self) -> float:
        """Return the largest rate (rad/s) that is searched: two sigmas of the prior."""
        return 2 * self.rate_sigma

    @property
    def inertia_slice(self) -> slice:
        """Return where the errors of the inertia stand among the unknowns: they come first."""
        return slice(0, len(self.body.errors))

    @cached_property
    def term_slices(self) -> tuple[slice, ...]:
        """Return where the unknowns of each term stand among those of the model."""
        counts = [len(self.body.errors), *(len(term.unknowns()) for term in self.obs.terms)]
        ends = np.cumsum(counts)
        return tuple(slice(int(a), int(b)) for a, b in zip(ends[:-1], ends[1:], strict=True))

    @cached_property
    def terms_with_slices(self) -> tuple[tuple[Term, slice], ...]:
        """Return the terms, each with the slice of its own unknowns among those of the model."""
        return tuple(zip(self.obs.terms, self.term_slices, strict=True))

    def seeing(self, samples: Any) -> Model:
        """Return the model of some of the samples."""
        return replace(self, obs=self.obs.take(samples))

    def with_momentum(self, momentum: np.ndarray) -> Model:
        """Return the model with wheels of this momentum (n, 3)."""
        return replace(self, obs=replace(self.obs, momentum=momentum))

    def under(self, acceleration: float) -> Model:
        """Return the model with another strength of unknown torques (rad/s^1.5), and its steps of the rate."""
        return replace(self, noise=replace(self.noise, acceleration=acceleration))

    def plus(self, term: Term, what: str) -> Model:
        """Return the model with one more term, as probable before the data."""
        return replace(self, obs=replace(self.obs, terms=(*self.obs.terms, term)), what=what)

    def for_search(self, noise: Noise) -> list[Model]:
        """Return the model without unknowns, whose errors are added to the noise of the readings; `noise`: unknown torques.

        There are several models if readings may mean several things (`Term.for_search`).
        """
        body = self.body.for_search()
        meanings = product(*(term.for_search() for term in self.obs.terms))
        return [
            replace(self, obs=replace(self.obs, terms=terms), body=body, noise=noise)
            for terms in meanings
        ]


@dataclass(frozen=True)
class States:
    """K motions at n samples: attitudes B_from_N (K, n, 3, 3) and rates (K, n, 3) in rad/s, body axes."""

    attitude: np.ndarray
    omega: np.ndarray

    @property
    def sun_B(self) -> np.ndarray:
        """Return the directions to the Sun (K, n, 3)."""
        return self.attitude @ SUN_N


@dataclass(frozen=True)
class Track(States):
    """K motions with their unknowns u (K, m) in sigmas.

    After a fit also their `cost` (K), minus the log of the posterior density, and the `covariance` (K, n, 6, 6) of turn (rad, B)
    and rate at each sample.
    """

    u: np.ndarray
    cost: np.ndarray = field(default_factory=lambda: np.zeros(0))
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 6, 6)))

    def __len__(self) -> int:
        """Return the number of motions."""
        return len(self.omega)

    @classmethod
    def free(cls, attitude: np.ndarray, omega: np.ndarray) -> Track:
        """Return motions without unknowns that no fit has seen."""
        return cls(attitude, omega, np.zeros((len(omega), 0)))

    def take(self, which: Any) -> Track:
        """Return some of the motions."""
        fitted = (part[which] if len(part) else part for part in (self.cost, self.covariance))
        return Track(self.attitude[which], self.omega[which], self.u[which], *fitted)

    @staticmethod
    def joined(tracks: Sequence[Track]) -> Track:
        """Return the motions of several tracks at the same samples; costs and covariances only if all have them."""
        names = ["attitude", "omega", "u"]
        if all(len(track.cost) == len(track) for track in tracks):
            names += ["cost", "covariance"]
        parts = {name: [getattr(track, name) for track in tracks] for name in names}
        return Track(**{name: np.concatenate(part) for name, part in parts.items()})
