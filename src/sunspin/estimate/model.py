"""The model that a fit assumes: body, unknown torques, observations, and the unknowns that are estimated with a motion.

An alternative model is a :class:`Model` with one entry changed. Units are SI and radians, but inertia and momentum are over the
mean moment of inertia, which a torque-free motion does not determine. In shapes K is motions, n samples, m unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any, TypeVar

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

T = TypeVar("T", bound="Term")

SUN_N = np.array([0.0, 0.0, 1.0])
"""The direction to the Sun in N, whose z axis follows it."""

AS_STATED = "as stated"
"""Name of the nominal model, which is exactly as the vehicle file gives it. Columns as in the file: `equivalence.AS_WRITTEN`."""

THINNEST = 0.1
"""Least principal moment of a trial inertia, in mean moments; its second moments of mass may be negative by as much."""

MOST_SHRINKS, SHRINK = 10, 0.8
"""Errors of an impossible trial inertia are multiplied by SHRINK until it is possible, at most MOST_SHRINKS times."""

SWINGS_PER_INTERVAL = 30.0, 2.0
"""Largest and smallest number of correlation times, in an interval, of an oscillation that the samples do not resolve."""

SAMPLE_COST, READING_COST = 3.7, 1.5
"""Upper limits of the mean cost of a true motion, for each sample that shows the Sun and each other reading of three numbers."""


@dataclass(frozen=True)
class Unknown:
    """A number that is estimated with the motion, in units of the `sigma` of its prior about `centre`.

    `index`: among those of its `kind`; `limit`: largest distance (sigmas) of a trial from the centre. `shares`: sizes that the
    sigma may have, as factors of `sigma`; equally likely, except for a lander's inertia (:mod:`sunspin.estimate.lander.model`).
    `doubted`: an error beyond what the vehicle file states; the verdict tests a sensor without it.
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
    """A rigid body.

    `inertia` (3, 3) in units of its mean moment; `errors` (e, 3, 3): one sigma of each independent error of it; `sphere`: no
    inertia is known. `angle_error`: if a search holds the inertia fixed, one sigma of the angle by which the true motion deviates,
    over the angle that the body has turned.
    """

    inertia: np.ndarray
    errors: np.ndarray
    sphere: bool = False
    angle_error: float = 0.0

    @classmethod
    def of(cls, vehicle: Vehicle, torques_stated: bool = False) -> Body:
        """Return the body of a vehicle: its inertia in mean moments, with the errors that the vehicle file states, or default ones.

        Without an inertia it is a sphere, whose moments and products have the large errors UNKNOWN_MOMENT and UNKNOWN_PRODUCT.
        `torques_stated`: the vehicle file or the user states the strength of unknown torques. The sphere then has no errors, as
        this strength must also cover the nutation of a body that is no sphere. A stated inertia keeps its errors.
        """
        if vehicle.inertia_kg_m2 is None:
            sigma = np.where(np.eye(3, dtype=bool), UNKNOWN_MOMENT, UNKNOWN_PRODUCT)
            errors = np.zeros((0, 3, 3)) if torques_stated else _element_errors(sigma)
            return cls(np.eye(3), errors, sphere=True)
        tensor = np.array(vehicle.inertia_kg_m2)
        fact = vehicle.facts.get("body.inertia_kg_m2")
        if fact is not None and fact.sigma is not None:
            # one sigma for all elements, or one for each
            sigma = np.broadcast_to(np.asarray(fact.sigma, dtype=np.float64), (3, 3))
        else:
            sigma = inertia_sigma(tensor, INERTIA)
        mean_moment = np.trace(tensor) / 3
        return cls(tensor / mean_moment, _element_errors(sigma) / mean_moment)

    def for_search(self) -> Body:
        """Return the body with a fixed inertia, whose largest error becomes `angle_error`.

        An error of a moment, in mean moments, changes the rate of the nutation by about this part of the rate of the body. A body
        without an inertia stays a sphere: other shapes are tried after the search (`starts.other_bodies`).
        """
        angle_error = 0.0 if self.sphere else float(np.abs(self.errors).max(initial=0.0))
        return replace(self, errors=self.errors[:0], angle_error=angle_error)

    def momentum_size(
        self, omega: np.ndarray, covariance: np.ndarray, wheels: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the size |H| (K) of the angular momentum H = I w + h, and its sigmas (K) by the rate w and by the inertia I.

        `omega` (K, 3) in rad/s, with `covariance` (K, 3, 3); `wheels` (K, 3): h. Momenta are in mean moments times rad/s.
        """
        momentum = omega @ self.inertia + wheels
        size = np.linalg.norm(momentum, axis=1)
        along = momentum / np.maximum(size, 1e-12)[:, None]
        # |H| changes by H/|H| . (I dw) with the rate, and by H/|H| . (dI w) with one sigma of each error of the inertia
        slope = along @ self.inertia
        by_rate = np.sqrt(np.einsum("ki,kij,kj->k", slope, covariance, slope))
        by_inertia = np.linalg.norm(np.einsum("ki,eij,kj->ke", along, self.errors, omega), axis=1)
        return size, by_rate, by_inertia

    def inertia_at(self, u: np.ndarray) -> np.ndarray:
        """Return the inertia (K, 3, 3) for errors u (K, e) in sigmas; (3, 3) if the body has no errors."""
        if not len(self.errors):
            return self.inertia
        return self.inertia + np.einsum("ke,eij->kij", u, self.errors)

    def possible_errors(self, u: np.ndarray) -> np.ndarray:
        """Return errors u (K, e) in sigmas, reduced if no rigid body can have the inertia that they make.

        Each principal moment is positive and at most the sum of the other two. Equivalently the second moments of mass, the
        eigenvalues of trace(I) / 2 - I, are positive. Slightly negative ones are allowed, as a stated tensor has errors.
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
        """Return the errors of the inertia as unknowns; without an inertia their sigmas have one of two sizes, by the evidence."""
        sizes = np.linalg.norm(self.errors, axis=(1, 2))
        shares = UNKNOWN_SHARES if self.sphere else (1.0,)
        return tuple(
            Unknown(f"inertia_{i}", "inertia", "1", 0.0, float(size), i, INERTIA_SIGMAS, shares)
            for i, size in enumerate(sizes)
        )


def inertia_sigma(tensor: np.ndarray, relative: float) -> np.ndarray:
    """Return the sigmas (3, 3) of the elements of an inertia tensor for one relative sigma.

    It is that of each moment, and times the mean moment that of each product: a product of zero is not known exactly.
    """
    moments = np.diag(tensor)
    return relative * np.where(np.eye(3, dtype=bool), moments, moments.mean())


def _element_errors(sigma: np.ndarray) -> np.ndarray:
    """Return symmetric tensors (e, 3, 3), each one sigma of one element of `sigma` (3, 3); an exact element has none."""
    i, j = np.nonzero(np.triu(sigma > 0))
    errors = np.zeros((len(i), 3, 3))
    e = np.arange(len(i))
    errors[e, i, j] = errors[e, j, i] = sigma[i, j]
    return errors


@dataclass(frozen=True)
class Noise:
    """Unknown torques: white angular acceleration of the strength `acceleration`, rad/s^1.5, and what else disturbs a motion.

    `rate` (rad/s^0.5): white noise of the rate, which stands for an oscillation too fast for the samples: it changes the attitude
    and not the mean rate. `steps`: intervals between samples with a sudden change of the rate, each with its sigma (rad/s).
    """

    acceleration: float
    rate: float = 0.0
    steps: tuple[tuple[int, float], ...] = ()

    def in_intervals(self, dt: np.ndarray) -> np.ndarray:
        """Return the strength (n - 1) of the acceleration in each interval dt (n - 1), s, steps of the rate included.

        In the time dt the strength q changes the rate by q sqrt(dt), so that a step with the sigma s adds s^2 / dt to q^2.
        """
        square = np.full(len(dt), self.acceleration**2)
        for interval, sigma in self.steps:
            square[interval] += sigma**2 / dt[interval]
        return np.sqrt(square)

    def hidden_variance(self, dt: np.ndarray) -> float:
        """Return the variance (rad2/s2) of a component of the rate at an instant about the mean rate between samples dt (n), s.

        An Ornstein-Uhlenbeck rate with the correlation time T that changes the attitude as `rate` does has the variance
        rate^2 / (2 T). This is averaged over T: dt / T is log-uniform between the :data:`SWINGS_PER_INTERVAL`.
        """
        most, least = SWINGS_PER_INTERVAL
        mean_count = (most - least) / np.log(most / least)  # the mean of dt / T
        return float(self.rate**2 / (2 * np.median(dt)) * mean_count)


@dataclass(frozen=True)
class Observations:
    """Samples of a pass or a file: times `t_s` (n), total momentum of the wheels (n, 3) in mean moments times rad/s, and `terms`.

    `time_sigma_s`: one sigma of the error of each time, independent from sample to sample.
    """

    t_s: np.ndarray
    momentum: np.ndarray
    terms: tuple[Term, ...]
    time_sigma_s: float = 0.0

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.t_s)

    def of_kind(self, kind: type[T]) -> T | None:
        """Return the term of a class, of which there is one at most; None if there is none."""
        return next((term for term in self.terms if isinstance(term, kind)), None)

    def replacing(self, old: Term, new: Term) -> Observations:
        """Return the observations with the term `new` in the place of `old`."""
        return replace(self, terms=tuple(new if term is old else term for term in self.terms))

    def take(self, samples: Any) -> Observations:
        """Return some of the samples, by indices or slice."""
        terms = tuple(term.take(samples) for term in self.terms)
        return Observations(self.t_s[samples], self.momentum[samples], terms, self.time_sigma_s)

    def of_pass(self, samples: Any) -> Observations:
        """Return the samples of one pass, by indices or slice; the unknowns of its terms are constant in it (`Term.of_pass`)."""
        taken = self.take(samples)
        return replace(taken, terms=tuple(term.of_pass(taken.t_s) for term in taken.terms))

    def with_time_errors(self, motion: States) -> Observations:
        """Return the samples with the errors of their times added to those of the readings, for a body with this motion (K = 1)."""
        of_sun, of_body = self.turned_in_time_sigma(motion)
        terms = (term.loosened(of_sun if term.of_sun else of_body, 0.0) for term in self.terms)
        return replace(self, terms=tuple(terms), time_sigma_s=0.0)

    def turned_in_time_sigma(self, motion: States) -> tuple[np.ndarray, np.ndarray]:
        """Return the angles (n) and (n), rad, by which a motion (K = 1) turns the Sun direction and the body in a sigma of the
        times.

        The rates are |omega x sun| and |omega|, the most by which any other direction turns.
        """
        omega, sun = motion.omega[0], motion.sun_B[0]
        sizes = (np.linalg.norm(vector, axis=1) for vector in (np.cross(omega, sun), omega))
        of_sun, of_body = (self.time_sigma_s * size for size in sizes)
        return of_sun, of_body

    @cached_property
    def sees_sun(self) -> np.ndarray:
        """Return whether each sample (n) has a reading of the Sun, by panels or Sun sensors."""
        seeing = [term.present() for term in self.terms if term.of_sun]
        return np.logical_or.reduce([np.zeros(len(self), dtype=bool), *seeing])

    @cached_property
    def only_sun(self) -> bool:
        """Return whether only the Sun was read, and no other sensor."""
        return not any(term.present().any() for term in self.terms if not term.of_sun)

    @cached_property
    def cost_limit(self) -> float:
        """Return the cost that a true motion does not exceed: a fit that costs more does not fit."""
        others = sum(int(term.present().sum()) for term in self.terms if not term.of_sun)
        return SAMPLE_COST * int(self.sees_sun.sum()) + READING_COST * others


@dataclass(frozen=True)
class Model:
    """The model that a fit assumes: observations, body, unknown torques, and the prior of the rate.

    `rate_sigma` (rad/s): prior sigma of each component of the rate at the first sample. `what`: in words, the change from the
    nominal model; `log_prior`: log of its prior probability relative to that model.
    """

    obs: Observations
    body: Body
    noise: Noise
    rate_sigma: float
    what: str = AS_STATED
    log_prior: float = 0.0

    @cached_property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the unknowns, the numbers that are estimated with a motion: those of the body, then those of each term."""
        return (*self.body.unknowns, *(u for term in self.obs.terms for u in term.unknowns()))

    @property
    def rate_max(self) -> float:
        """Return the largest rate (rad/s) that is searched: two sigmas of the prior."""
        return 2 * self.rate_sigma

    @property
    def inertia_slice(self) -> slice:
        """Return the slice of the errors of the inertia among the unknowns: they come first."""
        return slice(0, len(self.body.errors))

    @cached_property
    def term_slices(self) -> tuple[slice, ...]:
        """Return the slice of the unknowns of each term among those of the model."""
        counts = [len(self.body.errors), *(len(term.unknowns()) for term in self.obs.terms)]
        ends = np.cumsum(counts).tolist()
        return tuple(slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True))

    @cached_property
    def terms_with_slices(self) -> tuple[tuple[Term, slice], ...]:
        """Return the terms, each with the slice of its own unknowns among those of the model."""
        return tuple(zip(self.obs.terms, self.term_slices, strict=True))

    def seeing(self, samples: Any) -> Model:
        """Return the model of some of the samples, by indices or slice."""
        return replace(self, obs=self.obs.take(samples))

    def with_momentum(self, momentum: np.ndarray) -> Model:
        """Return the model with another momentum (n, 3) of the wheels."""
        return replace(self, obs=replace(self.obs, momentum=momentum))

    def under(self, acceleration: float) -> Model:
        """Return the model under another strength of unknown torques (rad/s^1.5); steps of the rate stay."""
        return replace(self, noise=replace(self.noise, acceleration=acceleration))

    def plus(self, term: Term, what: str) -> Model:
        """Return the model with one more term, with the same prior probability; `what` it adds, in words.

        The term comes last: terms of all samples are paired with those of a model by their place (`dense.residuals_by_sensor`).
        """
        return replace(self, obs=replace(self.obs, terms=(*self.obs.terms, term)), what=what)

    def for_search(self, noise: Noise) -> list[Model]:
        """Return models for the search, under unknown torques `noise`: errors of the unknowns are added to the noise of the
        readings.

        There are several models if readings have several possible meanings (`Term.for_search`).
        """
        body = self.body.for_search()
        combinations_of_terms = product(*(term.for_search() for term in self.obs.terms))
        return [
            replace(self, obs=replace(self.obs, terms=terms), body=body, noise=noise)
            for terms in combinations_of_terms
        ]


@dataclass(frozen=True)
class States:
    """K motions at n samples: attitudes B_from_N (K, n, 3, 3) and rates `omega` (K, n, 3) in rad/s, body axes."""

    attitude: np.ndarray
    omega: np.ndarray

    @property
    def sun_B(self) -> np.ndarray:
        """Return the Sun directions (K, n, 3) in body axes."""
        return self.attitude @ SUN_N


@dataclass(frozen=True)
class Track(States):
    """K motions with their unknowns u (K, m) in sigmas.

    After a fit they have a `cost` (K), minus the log of the posterior density, and the `covariance` (K, n, 6, 6) of turn (rotation
    vector in body axes, rad) and rate (rad/s) at each sample; both are empty before.
    """

    u: np.ndarray
    cost: np.ndarray = field(default_factory=lambda: np.zeros(0))
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 6, 6)))

    def __len__(self) -> int:
        """Return the number of motions."""
        return len(self.omega)

    @classmethod
    def unfitted(cls, attitude: np.ndarray, omega: np.ndarray) -> Track:
        """Return motions that were not fitted: without unknowns, cost and covariance."""
        return cls(attitude, omega, np.zeros((len(omega), 0)))

    def take(self, which: Any) -> Track:
        """Return some of the motions, by indices or slice."""
        of_fit = (part[which] if len(part) else part for part in (self.cost, self.covariance))
        return Track(self.attitude[which], self.omega[which], self.u[which], *of_fit)

    @staticmethod
    def joined(tracks: Sequence[Track]) -> Track:
        """Return the motions of several tracks at the same samples; costs and covariances only if all have them."""
        names = ["attitude", "omega", "u"]
        if all(len(track.cost) == len(track) for track in tracks):
            names += ["cost", "covariance"]
        parts = {name: [getattr(track, name) for track in tracks] for name in names}
        return Track(**{name: np.concatenate(part) for name, part in parts.items()})
