"""A term of a model: what one sensor read, and what it would read of a motion; or what a torque does.

A fit asks each term for the differences of its predictions from its readings, in sigmas, with their derivatives. On what a term
depends it says by the derivatives that it returns. Who asks for what:

- `observe`: `take`, `of_pass`, `present`; the fit (`chain`): `unknowns`, `residuals`, or of torques `added_by_*`;
- the search (`starts`, `field_led`): `for_search`, `starts`, `loosened`, and `begin` when its motions go on to the fit;
- other models (`alternatives`, `swings`): `without`, `held`; the verdict (`dense`): `freedom`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from sunspin.estimate.model import States, Unknown
from sunspin.solve.rotations import cross

FREEDOM = 4.0
"""Degrees of freedom of Student's law of the readings at a sample: its tails let one bad sample in ten be outvoted."""

Law = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Function from differences (..., r) in sigmas to their cost (...) and the weight (...) of their squares in a step of a fit."""


def student(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return cost and weight (...) of the readings at a sample (..., r) under one Student's law for all of them.

    They share it since what makes one reading of a sample bad mostly makes all of them bad. The factor (FREEDOM + 2) / 2 is that of
    a law of two numbers.
    """
    square = np.einsum("...r,...r->...", value, value)
    return (FREEDOM + 2) / 2 * np.log1p(square / FREEDOM), (FREEDOM + 2) / (FREEDOM + square)


def gaussian(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return cost and weight (...) of readings (..., r) with normally distributed errors."""
    return np.einsum("...r,...r->...", value, value) / 2, np.ones(value.shape[:-1])


class Residual(NamedTuple):
    """Differences of predictions from readings in stated sigmas, with derivatives.

    `value` (K, n, r), zero where nothing was read; `by_turn` (K, n, r, 3) by a turn of the body at the sample (rad, B); `by_rate`
    (K, n, r, 3) by its rate; `by_previous` (K, n, r, 3) by a turn at the sample before, for a term that compares neighbours;
    `by_u` (K, n, r, m) by one sigma of each of the term's unknowns. None: it does not depend on that.
    """

    value: np.ndarray
    by_turn: np.ndarray | None = None
    by_rate: np.ndarray | None = None
    by_previous: np.ndarray | None = None
    by_u: np.ndarray | None = None
    law: Law = student


class Starts(NamedTuple):
    """What a term knows at a sample from which a search may start.

    `directions` (c, 3): those to the Sun, in B, that it allows, the best first. `rates` (r, 3) in rad/s; `rate_sigma` (rad/s):
    their sigma if they leave no doubt about whole turns to the next sample, else infinity.
    """

    directions: np.ndarray = np.zeros((0, 3))
    rates: np.ndarray = np.zeros((0, 3))
    rate_sigma: float = np.inf


@dataclass(frozen=True)
class Term:
    """What one sensor reads of a motion, or a torque does to it, at n samples. By default there are no readings and no unknowns."""

    name: ClassVar[str]
    """Its name in files."""
    label: ClassVar[str]
    """What a person calls it; terms that see the same thing share it."""
    of_sun: ClassVar[bool] = False
    """Whether it shows the direction to the Sun."""
    about_sun: ClassVar[bool] = False
    """Whether it shows the turn about the Sun."""
    per_sample: ClassVar[tuple[str, ...]] = ()
    """Its arrays whose first axis are the samples; None stands for one that is not known."""
    axes_rad_s: ClassVar[float] = 0.0
    """How fast the axes of N turn in space, at most, if they follow what this term reads."""

    def of_pass(self, t_s: np.ndarray) -> Self:
        """Return the term of one pass with samples at times (n), with the unknowns that are constant in it."""
        return self

    def take(self, samples: Any) -> Self:
        """Return the term of some samples."""
        known = (name for name in self.per_sample if getattr(self, name) is not None)
        return replace(self, **{name: getattr(self, name)[samples] for name in known})

    def present(self) -> np.ndarray:
        """Return at which samples (n) it has a reading."""
        return np.zeros(0, dtype=bool)

    def freedom(self) -> np.ndarray:
        """Return how many independent numbers each reading (n) has, 0 where there is none."""
        return 3 * self.present()

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the numbers of the sensor or torque that are estimated with the motion."""
        return ()

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the differences of motions from readings; u (K, m): the unknowns of this term, in sigmas."""
        yield from ()

    def added_by_unknowns(self, states: States, dt: np.ndarray) -> np.ndarray | None:
        """Return turn and rate (K, n - 1, 6, m) that one sigma of each unknown adds in intervals dt; None if it is no torque."""
        return None

    def added_by_torque(self, states: States, dt: np.ndarray) -> np.ndarray | None:
        """Return turn (rad) and rate (rad/s) (K, n - 1, 6) at the end of each interval dt (n - 1) that a known torque adds.

        They are in the body's axes at that instant. None if there is no torque.
        """
        return None

    def begin(self, states: States, about_sun: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return attitudes (K, n, 3, 3) and unknowns (K, m) from which a fit of motions that a search has found begins.

        `about_sun`: the turn about the Sun is known already.
        """
        return states.attitude, np.zeros((len(states.omega), len(self.unknowns())))

    def for_search(self) -> Sequence[Term]:
        """Return the term without unknowns, whose errors are added to the noise; several if readings may mean several things."""
        return [self]

    def held(self, u: np.ndarray) -> Self:
        """Return the term without unknowns, which are held at u (m)."""
        return self

    def loosened(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        """Return the term with larger sigmas, for a start that is off by `drift_rad` (n) in attitude and `drift_rad_s` in rate."""
        return self

    def log_errors(self) -> float:
        """Return the sum over the samples of the log of the errors of a direction, two numbers each; zero if no Sun is seen."""
        return 0.0

    def with_errors_of(self, fitted: Any) -> Self:
        """Return the term with the unknowns that it has in a fitted model: an alternative one may have more than the nominal one.

        `fitted`: the same term there, at some of the samples.
        """
        return self

    def starts(self, sample: int) -> Starts:
        """Return what its readings at a sample and the next one say of where a search may start."""
        return Starts()


def drifting(t_s: np.ndarray, sigma: float, rate_rad_s: float) -> np.ndarray:
    """Return one sigma (n, 6, 3) of each of the six unknowns of a vector that drifts evenly over a pass at times (n).

    The vector at t is `sigma` (u[0:3] + `rate_rad_s` (t - mean time) u[3:6]): it drifts as fast as a turn at this rate makes it.
    """
    away = rate_rad_s * (t_s - t_s.mean())
    # (n, 2): of the mean, and of the drift
    sigmas = sigma * np.stack([np.ones(len(t_s)), away], axis=1)
    return (sigmas[:, :, None, None] * np.eye(3)).reshape(len(t_s), 6, 3)


def at_sample_before(values: np.ndarray, axis: int = 0) -> np.ndarray:
    """Return values with those of the sample before in place of each, and the first twice; `axis`: that of the samples, 0 or 1."""
    if axis == 0:
        return np.concatenate([values[:1], values[:-1]])
    return np.concatenate([values[:, :1], values[:, :-1]], axis=1)


def facing(sun_B: np.ndarray) -> np.ndarray:
    """Return an attitude (..., 3, 3), B_from_N, that shows the Sun in the direction `sun_B` (..., 3); the turn about it is any."""
    aside = np.where(np.abs(sun_B[..., :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    x = cross(aside, sun_B)
    x = x / np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, cross(sun_B, x), sun_B], axis=-1)
