"""When two fitted motions count as one: copies of each other in a search, and one solution under several models."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sunspin.estimate.carry import RATE
from sunspin.estimate.model import Track
from sunspin.estimate.settings import SearchSettings

SUN_WEIGHT, WHOLE_WEIGHT = 0.35, 0.7
"""Weights, relative to rotations between neighbouring samples, of the Sun's directions and of rotations since the middle sample.

Directions distinguish mirror images; with a larger weight they would also part motions on their way to the same minimum. Rotations
since the middle part slow motions, which rotate nearly alike between neighbours, from 0.35 rad on, as far as a fit moves."""


class Outline(NamedTuple):
    """What motions (K) at n samples are compared by.

    `steps` (K, n - 1, 3), rad: rotation vectors between neighbours, from the rate at the earlier one; `whole` (K, n, 3): their
    sums, counted from the middle sample; `sun` (K, n, 3): directions to the Sun in body axes; `omega` (K, n, 3): rates, rad/s, and
    their `covariance` (K, n, 3, 3), which is empty (0, ...) if no fit has made it.
    """

    steps: np.ndarray
    whole: np.ndarray
    sun: np.ndarray
    omega: np.ndarray
    covariance: np.ndarray

    @classmethod
    def of(cls, motions: Track, t_s: np.ndarray) -> Outline:
        """Return the outline of motions at times `t_s` (n)."""
        steps = motions.omega[:, :-1] * np.diff(t_s)[:, None]
        # rotation from the first sample to each
        total = np.concatenate([np.zeros((len(steps), 1, 3)), np.cumsum(steps, axis=1)], axis=1)
        middle = total[:, len(t_s) // 2, None]
        covariance = motions.covariance[..., RATE, RATE]
        return cls(steps, total - middle, motions.sun_B, motions.omega, covariance)

    def take(self, which: np.ndarray) -> Outline:
        """Return the outline of some of the motions."""
        return Outline(*(part[which] if len(part) else part for part in self))

    def copies(self, k: int, others: Outline, apart_rad: float, sigmas: float) -> np.ndarray:
        """Return which of the motions `others` (K), fitted under the same model, are copies of motion `k`.

        A copy sees the Sun and rotates as `k` does, between neighbouring samples (to `apart_rad`) and over the whole window. If it
        does so only between neighbours, it is one if both lie in one valley of the cost: their rates are within `sigmas` of each
        other, by the covariance of each. That of one is not enough: a broad minimum may reach over narrow ones, which are others.
        """
        steps_alike = self._steps_alike(k, others, apart_rad)
        whole_alike = _nowhere_farther(self.whole[k], others.whole, apart_rad / WHOLE_WEIGHT)
        in_valley = self._rates_agree(k, others, steps_alike & ~whole_alike, sigmas, joint=False)
        return (steps_alike & whole_alike) | in_valley

    def same(
        self, k: int, others: Outline, apart_rad: float, near_rad: float, sigmas: float
    ) -> np.ndarray:
        """Return which of the motions `others` (K), fitted under any model, are the same solution as motion `k` for a user.

        Both see the Sun and rotate alike, to `apart_rad`. Or they do so only between neighbours, to `near_rad`, and the difference
        of their rates is within `sigmas` of its covariance: minima so near to each other are one motion with a larger error.
        """
        alike = self._steps_alike(k, others, apart_rad)
        alike &= _nowhere_farther(self.whole[k], others.whole, apart_rad / WHOLE_WEIGHT)
        near = _nowhere_farther(self.steps[k], others.steps, near_rad)
        near &= _nowhere_farther(self.sun[k], others.sun, near_rad)
        return alike | self._rates_agree(k, others, near & ~alike, sigmas, joint=True)

    def _steps_alike(self, k: int, others: Outline, apart_rad: float) -> np.ndarray:
        """Return which of `others` (K) see the Sun as motion `k` does and rotate like it between neighbours, to `apart_rad`."""
        suns = _nowhere_farther(self.sun[k], others.sun, apart_rad / SUN_WEIGHT)
        return _nowhere_farther(self.steps[k], others.steps, apart_rad) & suns

    def _rates_agree(
        self, k: int, others: Outline, compared: np.ndarray, sigmas: float, *, joint: bool
    ) -> np.ndarray:
        """Return which of `others` (K), of those that are `compared` (K), have rates within `sigmas` of those of motion `k`.

        `joint`: by the covariance of the difference; else by that of each motion. Without covariances no rates agree.
        """
        agree, which = np.zeros(len(compared), dtype=bool), np.flatnonzero(compared)
        if len(which) and len(self.covariance) and len(others.covariance):
            of_k, of_others = self.covariance[k], others.covariance[which]
            off = others.omega[which] - self.omega[k]
            by_each = [np.broadcast_to(of_k, of_others.shape), of_others]
            covariances = [of_k + of_others] if joint else by_each
            square = np.max([_squared_sigmas(off, part) for part in covariances], axis=0)
            agree[which] = square <= sigmas**2
        return agree


def _nowhere_farther(own: np.ndarray, others: np.ndarray, apart: float) -> np.ndarray:
    """Return which of K series of vectors `others` (K, n, 3) are at no sample farther than `apart` from the series `own` (n, 3)."""
    return ((others - own) ** 2).sum(axis=-1).max(axis=-1, initial=0.0) <= apart**2


def _squared_sigmas(off: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the largest squared size (K) over n samples of differences `off` (K, n, 3), in sigmas of their covariance.

    It is infinite if a covariance (K, n, 3, 3) is not positive definite.
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
    """Return the indices of motions (K) at times `t_s` (n) without improbable ones and copies, the most probable first.

    `order_by` (K): minus the logs of their probabilities; default: their costs. A motion is improbable if this is above the least
    one by `drop` or more. At most `most` are returned. `drop` and `most` are by default those of the settings.
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
