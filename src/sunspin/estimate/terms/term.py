"""A term of a fit: what one sensor read, or what one error in common does, and how a hypothesis of the motion answers to it.

A fit is a list of terms. Each is asked by the same methods, so that what a sensor is stands in one file:

- `take`: the same for some samples; `present`, `informs`, `points`, `readings`: at which samples it says what.
- `wider`, `forgiving`, `guesses`, `directions`, `images`, `rates`, `rate_sigma`: what the search needs, which knows no unknowns.
- `placed`: the same where the surroundings are known, by an orbit.
- `freed`, `unknowns`, `begin`: what is estimated beside the motion, in units of its prior sigma.
- `residuals` (of samples), `between` and `gained` (of neighbours), `pushes` (of the motion): in sigmas, with derivatives.
- `considered`: what is not estimated and counts in the result's error; `unrelated`: what a fit without it owes; `blind`: it
  without a reading.

Four kinds differ in what a residual depends on: the attitude at the Sun's instant (`SunTerm`), attitude and rate at a sample
(`StateTerm`), the turn between neighbours (`PairTerm`), or the motion itself (`MotionTerm`). Readings are those of a row's time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self

import numpy as np

from sunspin.environment import Surroundings, unknown
from sunspin.solve.rotations import cross
from sunspin.vehicle.response.planes import sphere

SUN_N = unknown().at(0.0).sun_N[0]
"""The Sun in the local frame N."""

STUDENT = 4.0
"""Degrees of freedom of the Student law of readings at a sample: tails that let one bad sample in ten be outvoted."""

EVERYWHERE = 2000
"""Directions over which the likelihood of a reading of the Sun is averaged, 5 degrees apart."""

Scope = Literal["sample", "pass", "file"]


@dataclass(frozen=True)
class Unknown:
    """Something that is estimated beside the motion: its name, what kind it is, unit, prior centre and sigma, which of its kind it
    is, what shares one value of it, and how far (sigmas) a trial may be from the centre."""

    name: str
    kind: str
    unit: str
    centre: float
    sigma: float
    index: int = 0
    scope: Scope = "pass"
    limit: float = np.inf


@dataclass(frozen=True)
class Seen:
    """K hypotheses at n samples: attitudes B_from_N (K, n, 3, 3) and rates (K, n, 3) rad/s."""

    attitude: np.ndarray
    omega: np.ndarray

    @property
    def sun_B(self) -> np.ndarray:
        return self.attitude @ SUN_N


Residual = tuple[np.ndarray, np.ndarray]
"""Differences predicted less read (K, n, m), in sigmas, and their derivative (K, n, m, d) to what they depend on and to one sigma
of each of the term's unknowns."""


@dataclass(frozen=True)
class Term:
    """What every term can be asked; n are its samples."""

    name: ClassVar[str]
    called: ClassVar[str]
    """What a person calls it; what reads the same thing has one such name."""
    per_sample: ClassVar[tuple[str, ...]] = ()
    """Its arrays whose first axis are the samples."""
    measured: ClassVar[tuple[str, ...]] = ()
    """Those of its arrays in which NaN says that nothing was read."""

    def take(self, index: np.ndarray | slice) -> Self:
        """The samples `index`."""
        return replace(self, **{name: getattr(self, name)[index] for name in self.per_sample})

    def present(self) -> np.ndarray:
        """At which samples (n) it has a reading."""
        return np.zeros(0, dtype=bool)

    def several(self) -> bool:
        """Whether one of its readings may mean several things."""
        return False

    def blind(self, index: int) -> Self:
        """The same without what it read at a sample."""
        arrays = {name: getattr(self, name).copy() for name in self.measured}
        for array in arrays.values():
            array[index] = np.nan
        return replace(self, **arrays)

    def readings(self) -> int:
        """How many readings of three numbers it adds to those of the Sun."""
        return 0

    def freedom(self) -> np.ndarray:
        """How many numbers each reading (n) says."""
        return 3 * self.present()

    def wider(self, drift_rad: np.ndarray, drift_rad_s: float) -> Self:
        """The same trusted no further than a start that is off by turns (n) and a rate of this size."""
        return self

    def forgiving(self) -> Self:
        """The same trusted no further than its common errors, which the search holds at what the vehicle file says."""
        return self

    def coarser(self, factor: float) -> Self:
        """The same with sigmas so many times those stated."""
        raise NotImplementedError("readings at a sample can be worse than stated")

    def guesses(self) -> list[Self]:
        """What is searched."""
        return [self.forgiving()]

    def rates(self, index: int, dt: float, rate_max: float) -> np.ndarray:
        """Rates (m, 3) that sample `index` and the next, `dt` s later, say there are."""
        return np.zeros((0, 3))

    def rate_sigma(self, index: int) -> float:
        """rad/s to which they do so without doubt about whole turns."""
        return np.inf

    def placed(self, here: Surroundings) -> Self:
        """The same in surroundings at its samples, in a frame with z to the Sun."""
        return self

    def freed(self, t_s: np.ndarray) -> Term:
        """The same with what is estimated of it, of a pass at these times (n)."""
        return self

    def unknowns(self) -> tuple[Unknown, ...]:
        """What is estimated of it beside the motion."""
        return ()

    def unrelated(self, t_s: np.ndarray) -> float:
        """Log of the mean likelihood of its readings, at these times (n), if what it sees were another at every reading: what
        leaving it out costs, in the measure of its own cost."""
        return 0.0

    def considered(self, seen: Seen) -> list[tuple[Self, float]]:
        """It as an error that is not estimated would change it, and by what part that counts."""
        return []


@dataclass(frozen=True)
class SunTerm(Term):
    """Sees the Sun: derivatives (K, n, m, 3 + u) are to a turn at the Sun's instant and to the unknowns."""

    def informs(self) -> np.ndarray:
        """Which samples (n) say something of the Sun's direction."""
        raise NotImplementedError("every term of the Sun says where it informs")

    def unrelated(self, t_s: np.ndarray) -> float:
        everywhere = facing(sphere(EVERYWHERE))[:, None]
        seen = Seen(np.repeat(everywhere, len(t_s), axis=1), np.zeros((EVERYWHERE, len(t_s), 3)))
        return float(np.log(np.exp(-normal(self, seen)[2]).mean(axis=0)).sum())

    def points(self) -> np.ndarray:
        """Which samples (n) have a direction of their own, whatever the motion."""
        return np.zeros_like(self.informs())

    def log_size(self) -> float:
        """Log of the readings' sigmas, where another reading of the same file changes them; what is left out counts as if it
        might be anything."""
        return 0.0

    def directions(self, index: int) -> np.ndarray | None:
        """The Sun's direction in the body (m, 3) at a sample, where that is a point to start from."""
        return None

    def blind_axis(self) -> np.ndarray | None:
        """The direction (3) along which nothing is seen: a mirror across its plane changes no reading."""
        return None

    def images(self) -> np.ndarray:
        """Mirrors and turns (m, 3, 3) of the body that change no reading, or little, the first of them none at all."""
        return np.eye(3)[None]

    def begin(self, seen: Seen, turned: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Attitudes (K, n, 3, 3) and unknowns (K, u), in sigmas, from which a fit begins; `turned`: the turn about the Sun is that
        of N, by another sensor."""
        return seen.attitude, np.zeros((len(seen.omega), len(self.unknowns())))

    def residuals(self, seen: Seen, error: np.ndarray | None = None) -> Iterator[Residual]:
        """Residuals, the unknowns off by `error` (K, u) sigmas; None: there are none."""
        raise NotImplementedError("every term of the Sun has residuals")


@dataclass(frozen=True)
class StateTerm(Term):
    """Reads attitude or rate at a sample: derivatives (K, n, m, 6 + u) are to turn, rate and the unknowns."""

    def begin(self, seen: Seen) -> np.ndarray | None:
        """Attitudes (K, n, 3, 3) from which a fit begins, where it says the turn about the Sun; else None."""
        return None

    def off_zero(self, sigma: float) -> Self | None:
        """The same with a zero off by `sigma` (rad/s), where it reads rates and its zero is taken for known; its first three
        unknowns are that."""
        return None

    def residuals(self, seen: Seen, error: np.ndarray | None = None) -> Iterator[Residual]:
        """As those of a `SunTerm`."""
        raise NotImplementedError("every term of states has residuals")


@dataclass(frozen=True)
class PairTerm(Term):
    """Compares neighbours, three numbers a pair; residuals are Gaussian."""

    def pairs(self) -> np.ndarray:
        """Which neighbours (n - 1) it compares."""
        met = self.present()
        return met[:-1] & met[1:]

    def readings(self) -> int:
        return int(self.pairs().sum())

    def between(
        self, t_s: np.ndarray, relative: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residuals (K, n - 1, 3) of the turns between neighbours (K, n - 1, 3, 3), and derivatives (K, n - 1, 3, 6) to turn and
        rate at the first and at the second."""
        raise NotImplementedError("every term of neighbours compares them")

    def gained(self, t_s: np.ndarray, seen: Seen) -> np.ndarray:
        """What one sigma of each of its unknowns adds to the residuals (K, n - 1, 3, u)."""
        return np.zeros((*seen.omega[:, 1:].shape, 0))


@dataclass(frozen=True)
class MotionTerm(Term):
    """Moves the body, over the intervals `dt` (n - 1) between samples: by what is estimated, or as noise."""

    def pushes(self, seen: Seen, dt: np.ndarray) -> np.ndarray:
        """What one sigma of each unknown adds to turn and rate (K, n - 1, 6, u)."""
        return np.zeros((*seen.omega[:, 1:].shape[:2], 6, 0))

    def acceleration_noise(self, dt: np.ndarray) -> np.ndarray:
        """White angular acceleration (n - 1), rad/s^1.5, beside that of the motion."""
        return np.zeros(len(dt))

    def rate_noise(self) -> float:
        """White noise of the rate, rad s^-0.5: the attitude wanders, the rate between samples does not."""
        return 0.0

    def hidden_variance(self, dt: np.ndarray) -> float:
        """Variance (rad2/s2) of the rate at an instant about that of the fit."""
        return 0.0


def normal(
    term: SunTerm | StateTerm, seen: Seen, error: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normal matrices (K, n, d, d), gradients (K, n, d) and costs (K, n) of a term at each sample, under a Student law."""
    k, n = seen.omega.shape[:2]
    size = (3 if isinstance(term, SunTerm) else 6) + (0 if error is None else error.shape[1])
    matrix, slope, cost = np.zeros((k, n, size, size)), np.zeros((k, n, size)), np.zeros((k, n))
    for value, jacobian in term.residuals(seen, error):
        weight, part = student(value)
        matrix += np.einsum("kn,knmi,knmj->knij", weight, jacobian, jacobian)
        slope += np.einsum("kn,knmi,knm->kni", weight, jacobian, value)
        cost += part
    return matrix, slope, cost


def facing(sun_B: np.ndarray) -> np.ndarray:
    """Some attitude (..., 3, 3), B_from_N, that shows the Sun of N in the direction `sun_B` (..., 3)."""
    other = np.where(np.abs(sun_B[..., :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    x = cross(other, sun_B)
    x = x / np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, cross(sun_B, x), sun_B], axis=-1)


def student(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weight and cost of residual vectors (..., m) under a Student law of `STUDENT` degrees of freedom."""
    square = (value**2).sum(axis=-1)
    return (STUDENT + 2) / (STUDENT + square), (STUDENT + 2) / 2 * np.log1p(square / STUDENT)


def drifting(t_s: np.ndarray, sigma: float, rate_rad_s: float) -> np.ndarray:
    """Unknowns (n, 6, 3) of a vector that drifts evenly over a pass, at its times (n): one sigma of each component in its middle,
    and of each component's drift, as fast as a turn at this rate."""
    away = rate_rad_s * (t_s - t_s.mean())
    return (
        sigma * np.stack([np.ones(len(t_s)), away], axis=1)[:, :, None, None] * np.eye(3)
    ).reshape(len(t_s), 6, 3)
