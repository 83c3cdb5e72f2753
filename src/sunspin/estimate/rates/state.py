"""What :mod:`sunspin.estimate.rates` works on: what a pass measured, hypotheses of how the body moved, and what moves it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sunspin.estimate.rates.motion import Body, Ends
from sunspin.estimate.terms.known_field import KnownField
from sunspin.estimate.terms.magnetometer import Magnetometer
from sunspin.estimate.terms.term import MotionTerm, PairTerm, Seen, StateTerm, SunTerm, Term


@dataclass(frozen=True)
class Observations:
    """What a pass measured, at n samples: `t_s` (n); `momentum` (n, 3) of the wheels, in the body's mean moment of inertia times
    rad/s; `terms`: what sensors read, and errors in common."""

    t_s: np.ndarray
    momentum: np.ndarray
    terms: tuple[Term, ...]

    def __len__(self) -> int:
        return len(self.t_s)

    @cached_property
    def of_sun(self) -> tuple[SunTerm, ...]:
        return tuple(term for term in self.terms if isinstance(term, SunTerm))

    @cached_property
    def of_state(self) -> tuple[StateTerm, ...]:
        return tuple(term for term in self.terms if isinstance(term, StateTerm))

    @cached_property
    def of_pairs(self) -> tuple[PairTerm, ...]:
        """Those that have something to compare."""
        return tuple(
            term for term in self.terms if isinstance(term, PairTerm) and term.pairs().any()
        )

    @cached_property
    def of_motion(self) -> tuple[MotionTerm, ...]:
        return tuple(term for term in self.terms if isinstance(term, MotionTerm))

    @cached_property
    def points(self) -> np.ndarray:
        """Which samples (n) have a direction of the Sun of their own."""
        return np.logical_or.reduce(
            [np.zeros(len(self), dtype=bool), *(term.points() for term in self.of_sun)]
        )

    @cached_property
    def informed(self) -> np.ndarray:
        """Which samples (n) say something of the Sun."""
        return np.logical_or.reduce(
            [np.zeros(len(self), dtype=bool), *(term.informs() for term in self.of_sun)]
        )

    @cached_property
    def field_N(self) -> np.ndarray | None:
        """The field (n, 3) T in space, where a fit knows it."""
        known = [term.field_N for term in self.terms if isinstance(term, KnownField)]
        return known[0] if known else None

    @cached_property
    def field_B(self) -> np.ndarray:
        """The magnetic field (n, 3) that pulls at a dipole, NaN where it was not read."""
        read = [term.field_B for term in self.terms if isinstance(term, Magnetometer | KnownField)]
        return read[0] if read else np.full((len(self), 3), np.nan)

    @cached_property
    def field_at_ends(self) -> tuple[np.ndarray, np.ndarray] | None:
        """That field at the start and at the end of each interval (n - 1, 3), zero where one of the two was not read; None
        where all are so."""
        met = np.all(np.isfinite(self.field_B), axis=1)
        pair, field = (met[:-1] & met[1:])[:, None], np.nan_to_num(self.field_B)
        return (field[:-1] * pair, field[1:] * pair) if pair.any() else None

    def take(self, index: np.ndarray | slice) -> Observations:
        """The samples `index`."""
        return Observations(
            self.t_s[index], self.momentum[index], tuple(term.take(index) for term in self.terms)
        )

    def part(self, low: int, high: int) -> Observations:
        """Samples low to high - 1."""
        return self.take(slice(low, high))

    def swapped(self, old: Term, new: Term) -> Observations:
        """With another term in the place of one."""
        return replace(self, terms=tuple(new if term is old else term for term in self.terms))

    def freed(self) -> Observations:
        """A pass with all that is estimated beside its motion."""
        return replace(self, terms=tuple(term.freed(self.t_s) for term in self.terms))

    def wheels(self, start: int, end: int) -> Ends:
        """What the wheels do between two samples."""
        return Ends(momentum=self.momentum[start], momentum_end=self.momentum[end])


UNTOLD = np.zeros(0)
"""What stands in a `Track` for what no fit has told yet."""


@dataclass(frozen=True)
class Track(Seen):
    """K hypotheses: attitudes B_from_N (K, n, 3, 3), rates (K, n, 3), and once smoothed their `cost` (K) (minus the log of
    the posterior density) and `log_weight` (K) (log of the mass of the mode, by Laplace), `covariance` (K, n, 6, 6)."""

    cost: np.ndarray = field(default_factory=lambda: UNTOLD)
    log_weight: np.ndarray = field(default_factory=lambda: UNTOLD)
    covariance: np.ndarray = field(default_factory=lambda: UNTOLD)

    def take(self, index: np.ndarray | slice) -> Track:
        told = (
            x if x is UNTOLD else x[index] for x in (self.cost, self.log_weight, self.covariance)
        )
        return Track(self.attitude[index], self.omega[index], *told)


def joined(tracks: list[Track]) -> Track:
    """All hypotheses of smoothed tracks."""
    each = [(t.attitude, t.omega, t.cost, t.log_weight, t.covariance) for t in tracks]
    return Track(*(np.concatenate(parts) for parts in zip(*each, strict=True)))


@dataclass(frozen=True)
class Motion:
    """How the body moves: the body, the white angular acceleration `noise` (rad/s^1.5), the prior sigma of a rate (rad/s); `shares`
    (3, 3): the covariance of that noise in the body over its square."""

    body: Body
    noise: float
    rate_prior: float
    shares: np.ndarray = field(default_factory=lambda: np.eye(3))
