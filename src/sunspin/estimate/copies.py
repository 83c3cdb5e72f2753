"""When two motions are one: copies in a search, and one solution under several models."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sunspin.estimate.carry import RATE
from sunspin.estimate.model import Track
from sunspin.estimate.settings import SearchSettings

SUN_SHARE, WHOLE_SHARE = 0.35, 0.7
"""Directions of the Sun, and turns from the middle of a window, count so much less than turns between neighbouring samples.

The former part mirror images, and not what is still on its way to one place. The latter part motions 0.35 rad from each other, as a
fit moves no farther: slow motions turn nearly alike between neighbours."""


class Outline(NamedTuple):
    """What motions (K) at n samples are compared by.

    `steps` (K, n - 1, 3), rad: turns between neighbours, at the rate of the earlier one, as vectors; `whole` (K, n, 3): their sums
    from the middle sample on; `sun` (K, n, 3): directions; rates `omega` (K, n, 3) and their covariance (K, n, 3, 3), or none (0,
    ...).
    """

    steps: np.ndarray
    whole: np.ndarray
    sun: np.ndarray
    omega: np.ndarray
    covariance: np.ndarray

    @classmethod
    def of(cls, motions: Track, t_s: np.ndarray) -> Outline:
        """Return the outline of motions at times (n), s."""
        steps = motions.omega[:, :-1] * np.diff(t_s)[:, None]
        total = np.concatenate([np.zeros((len(steps), 1, 3)), np.cumsum(steps, axis=1)], axis=1)
        middle = total[:, len(t_s) // 2, None]
        covariance = motions.covariance[..., RATE, RATE]
        return cls(steps, total - middle, motions.sun_B, motions.omega, covariance)

    def take(self, which: np.ndarray) -> Outline:
        """Return the outline of some of the motions."""
        return Outline(*(part[which] if len(part) else part for part in self))

    def copies(self, k: int, others: Outline, apart_rad: float, sigmas: float) -> np.ndarray:
        """Return which of other motions (K), fitted under one model, are copies of motion `k`.

        A copy turns like it from sample to sample, to `apart_rad`, and also over the whole window. A motion that turns alike only
        from sample to sample is a copy if both lie in one valley of the cost: if its rates are within `sigmas` of those of `k`, by
        the covariance of each. One covariance alone is too little: a broad minimum may reach over narrow ones, which are no copies
        of it.
        """
        steps_alike = self._steps_alike(k, others, apart_rad)
        whole_alike = _nowhere_farther(self.whole[k], others.whole, apart_rad / WHOLE_SHARE)
        in_valley = self._within(k, others, steps_alike & ~whole_alike, sigmas, joint=False)
        return (steps_alike & whole_alike) | in_valley

    def same(
        self, k: int, others: Outline, apart_rad: float, near_rad: float, sigmas: float
    ) -> np.ndarray:
        """Return which of other motions (K) are one solution with motion `k` for a user.

        They turn alike to `apart_rad`. Or they see the Sun alike and turn alike between neighbours to `near_rad`, and their rates
        are within `sigmas` of the difference: minima so near to each other are one motion with a larger error.
        """
        alike = self._steps_alike(k, others, apart_rad)
        alike &= _nowhere_farther(self.whole[k], others.whole, apart_rad / WHOLE_SHARE)
        near = _nowhere_farther(self.steps[k], others.steps, near_rad)
        near &= _nowhere_farther(self.sun[k], others.sun, near_rad)
        return alike | self._within(k, others, near & ~alike, sigmas, joint=True)

    def _steps_alike(self, k: int, others: Outline, apart_rad: float) -> np.ndarray:
        """Return which other motions (K) see the Sun as motion `k` does and turn like it between neighbours, to `apart_rad`."""
        suns = _nowhere_farther(self.sun[k], others.sun, apart_rad / SUN_SHARE)
        return _nowhere_farther(self.steps[k], others.steps, apart_rad) & suns

    def _within(
        self, k: int, others: Outline, asked: np.ndarray, sigmas: float, joint: bool
    ) -> np.ndarray:
        """Return which of the motions `asked` for (K, bool) have rates within `sigmas` of those of motion `k` at every sample.

        `joint`: by the covariance of the difference; else by that of each motion.
        """
        within, which = np.zeros(len(asked), dtype=bool), np.flatnonzero(asked)
        if len(which) and len(self.covariance) and len(others.covariance):
            own, theirs = self.covariance[k], others.covariance[which]
            off = others.omega[which] - self.omega[k]
            covariances = [own + theirs] if joint else [np.broadcast_to(own, theirs.shape), theirs]
            square = np.max([_squared_sigmas(off, part) for part in covariances], axis=0)
            within[which] = square <= sigmas**2
        return within


def _nowhere_farther(own: np.ndarray, others: np.ndarray, apart: float) -> np.ndarray:
    """Return which of K rows of vectors `others` (K, n, 3) are at none of n samples farther than `apart` from `own` (n, 3)."""
    return ((others - own) ** 2).sum(axis=-1).max(axis=-1, initial=0.0) <= apart**2


def _squared_sigmas(off: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the largest squared size (K) over samples of differences `off` (K, n, 3), in sigmas of their covariance.

    It is infinite where the covariance (K, n, 3, 3) has a variance that is not positive, or NaN.
    """
    variance, axes = np.linalg.eigh(np.nan_to_num(covariance))
    along = np.einsum("knij,kni->knj", axes, off)
    with np.errstate(divide="ignore", invalid="ignore"):
        squares = np.where(variance > 0, along**2 / variance, np.inf)
    return squares.sum(axis=-1).max(axis=-1)


def distinct(
    motions: Track,
    t_s: np.ndarray,
    s: SearchSettings,
    most: int | None = None,
    drop: float | None = None,
    order_by: np.ndarray | None = None,
) -> np.ndarray:
    """Return the indices of motions (K) without the improbable ones and without copies, best first.

    `order_by` (K): minus the logs of their probabilities; default: their costs. Those that exceed the least by `drop` are
    improbable. At most `most` are returned. `drop` and `most` are by default those of the settings.
    """
    most, drop = s.most if most is None else most, s.drop if drop is None else drop
    cost = motions.cost if order_by is None else order_by
    order = np.argsort(cost, kind="stable")
    if not len(order):
        return order
    order = order[cost[order] < cost[order[0]] + drop]
    outline = Outline.of(motions, t_s)
    chosen = np.zeros(0, dtype=int)
    for i in order:
        if len(chosen) == most:
            break
        if not outline.copies(i, outline.take(chosen), s.copies_rad, s.copies_sigmas).any():
            chosen = np.append(chosen, i)
    return chosen
