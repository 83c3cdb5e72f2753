"""Base class of the terms of a model. A term has the readings of one sensor and predicts them, or has the effect of one torque.

Conventions of all terms: K motions, n samples, r numbers in a reading, m unknowns of the term. B are body axes. N is fixed in
space, with z towards the Sun. Attitudes are matrices B_from_N. A turn is a rotation of the body, as a rotation vector in B (rad).
Unknowns u are counted in sigmas of their priors.

Which methods are called by which module:

- passes and samples (`observe`): `of_pass`, `take`, `present`, through `Observations`;
- the fit (`chain`): `unknowns`, `residuals`, or of torques `added_by_*`;
- the search (`starts`, `field_led`): `for_search`, `starts`, `loosened`, and then `first_guess` for the fit of its motions;
- errors of rounded times (`one_pass`): `loosened`, `log_errors`;
- an oscillation (`swings`): `with_fixed_unknowns`; residuals at all samples (`dense`): `freedom`, `with_errors_of`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from sunspin.estimate.model import States, Unknown
from sunspin.solve.rotations import cross

FREEDOM = 4.0
"""Degrees of freedom of Student's law of the readings at a sample: with its wide tails one bad sample in ten does little harm."""

Law = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Function from differences (..., r) in sigmas to their cost (...), minus the log of their probability density up to a constant,
and to the weights, (...) or (..., r), of their squares in a Gauss-Newton step: twice the derivatives of the cost by the squares."""


def student(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return cost and weight (...) of differences (..., r), in sigmas, under one Student's law for all r readings of a sample.

    They share one law since what makes one reading of a sample bad mostly makes all of them bad. The factor (FREEDOM + 2) / 2 is
    that of the law of two numbers, as a direction has.
    """
    square = np.einsum("...r,...r->...", value, value)
    return (FREEDOM + 2) / 2 * np.log1p(square / FREEDOM), (FREEDOM + 2) / (FREEDOM + square)


def gaussian(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return cost and weight (...) of differences (..., r), in sigmas, under a normal law: half the sum of squares, and one."""
    return np.einsum("...r,...r->...", value, value) / 2, np.ones(value.shape[:-1])


class Residual(NamedTuple):
    """Predictions less readings, in stated sigmas, with derivatives; a derivative is None if the difference does not depend on it.

    Attributes
    ----------
    value : (K, n, r), zero where nothing was read
    by_turn, by_rate : (K, n, r, 3), by a small turn of the body at the sample (rad, B), and by its rate (rad/s, B)
    by_previous : (K, n, r, 3), by a small turn at the previous sample, for a term that compares neighbouring samples
    by_u : (K, n, r, m), by one sigma of each unknown of the term
    law : function to the cost and the weight of `value`
    """

    value: np.ndarray
    by_turn: np.ndarray | None = None
    by_rate: np.ndarray | None = None
    by_previous: np.ndarray | None = None
    by_u: np.ndarray | None = None
    law: Law = student


class Starts(NamedTuple):
    """Sun directions and rates that the readings of a term allow at a sample: a search may start from them.

    `directions` (c, 3): unit vectors to the Sun in B, the best first. `rates` (j, 3) in rad/s, B. `rate_sigma` (rad/s): sigma of
    each component of the rates if they were measured, infinite if they are known only up to whole revolutions between samples.
    """

    directions: np.ndarray = np.zeros((0, 3))
    rates: np.ndarray = np.zeros((0, 3))
    rate_sigma: float = np.inf


@dataclass(frozen=True)
class Term:
    """One sensor or one torque at n samples. By default it has no readings, exerts no torque, and has no unknowns."""

    name: ClassVar[str]
    """Its name in files."""
    label: ClassVar[str]
    """Name of the sensor for a reader; terms of one sensor share it."""
    of_sun: ClassVar[bool] = False
    """Whether its readings depend on the direction to the Sun in the body."""
    about_sun: ClassVar[bool] = False
    """Whether it determines the rotation about the Sun direction, which Sun sensors and panels do not show."""
    per_sample: ClassVar[tuple[str, ...]] = ()
    """Names of its arrays whose first axis are the samples; such an array may be None."""
    axes_rad_s: ClassVar[float] = 0.0
    """Largest rate at which the axes of N rotate in space (rad/s): not zero if they follow a field that this term measures."""

    def of_pass(self, t_s: np.ndarray) -> Self:
        """Return the term of one pass with samples at times `t_s` (n), with the unknowns that are constant in the pass."""
        return self

    def take(self, samples: Any) -> Self:
        """Return the term of some samples, by index or slice."""
        arrays = {name: getattr(self, name) for name in self.per_sample}
        return replace(
            self, **{k: array[samples] for k, array in arrays.items() if array is not None}
        )

    def present(self) -> np.ndarray:
        """Return which samples (n) have a reading; empty if the term has no readings at all."""
        return np.zeros(0, dtype=bool)

    def freedom(self) -> np.ndarray:
        """Return how many degrees of freedom the residual of each sample (n) has; 0 where nothing was read."""
        return 3 * self.present()

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the numbers of the sensor or torque that are estimated with the motion."""
        return ()

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the differences of predictions from readings for K motions with unknowns u (K, m) of this term, in sigmas."""
        yield from ()

    def added_by_unknowns(self, states: States, dt: np.ndarray) -> np.ndarray | None:
        """Return what one sigma of each unknown torque adds to the state in the intervals dt (n - 1), s, between samples.

        The result (K, n - 1, 6, m) has turn (rad) and rate (rad/s) as in `added_by_torque`. None: there is no unknown torque.
        """
        return None

    def added_by_torque(self, states: States, dt: np.ndarray) -> np.ndarray | None:
        """Return what a known torque adds to the state in the intervals dt (n - 1), s, between samples.

        The result (K, n - 1, 6) has turn (rad), then rate (rad/s), in the body axes at the end of the interval. None: there is no
        known torque.
        """
        return None

    def first_guess(self, states: States, about_sun: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return attitudes (K, n, 3, 3) and unknowns (K, m) from which a fit begins, given the motions of a search.

        `about_sun`: the rotation about the Sun direction is already known in `states`.
        """
        return states.attitude, np.zeros((len(states.omega), len(self.unknowns())))

    def for_search(self) -> Sequence[Term]:
        """Return the term for the search: without unknowns, and with their errors added to the noise.

        There are several terms if the readings have several meanings, each of which is searched.
        """
        return [self]

    def with_fixed_unknowns(self, u: np.ndarray) -> Self:
        """Return the term without unknowns: they have the fixed values u (m), in sigmas."""
        return self

    def loosened(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        """Return the term with larger sigmas, for a motion that is off by `drift_rad` (n) in attitude and `drift_rad_s` in rate."""
        return self

    def log_errors(self) -> float:
        """Return twice the log of the sigma of the Sun's direction or signal, summed over the samples; zero for other sensors.

        Twice, as a direction has two components.
        """
        return 0.0

    def with_errors_of(self, fitted: Any) -> Self:
        """Return the term with the unknowns of `fitted`, the same term of a fitted model at some of the samples.

        An alternative model may have more unknowns than the nominal one.
        """
        return self

    def starts(self, sample: int) -> Starts:
        """Return the directions and rates that the readings of a sample (its index) and of the next one allow."""
        return Starts()


def drifting_vector(t_s: np.ndarray, sigma: float, rate_rad_s: float) -> np.ndarray:
    """Return the derivatives (n, 6, 3) of a vector that changes linearly over a pass, at times `t_s` (n), by six unknowns u.

    The vector is `sigma` (u[0:3] + `rate_rad_s` (t - mean time) u[3:6]): its change is about that of a rotation at this rate.
    """
    angle = rate_rad_s * (t_s - t_s.mean())
    # (n, 2): factors of the mean, u[0:3], and of the change, u[3:6]
    factors = sigma * np.stack([np.ones(len(t_s)), angle], axis=1)
    return (factors[:, :, None, None] * np.eye(3)).reshape(len(t_s), 6, 3)


def at_sample_before(values: np.ndarray, axis: int = 0) -> np.ndarray:
    """Return an array of the same shape with the values of the previous sample; those of the first sample stay.

    `axis`: that of the samples, 0 or 1.
    """
    if axis == 0:
        return np.concatenate([values[:1], values[:-1]])
    return np.concatenate([values[:, :1], values[:, :-1]], axis=1)


def facing(sun_B: np.ndarray) -> np.ndarray:
    """Return attitudes B_from_N (..., 3, 3) with the Sun, the z axis of N, in the directions `sun_B` (..., 3).

    The rotation about the Sun direction is arbitrary.
    """
    # x or y axis of the body, the one that is surely not parallel to the Sun
    helper = np.where(np.abs(sun_B[..., :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    x = cross(helper, sun_B)
    x = x / np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, cross(sun_B, x), sun_B], axis=-1)
