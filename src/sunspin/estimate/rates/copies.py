"""When two motions that a search of :mod:`sunspin.estimate.rates` holds are copies of one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sunspin.estimate.rates.state import Track
from sunspin.estimate.terms.term import Seen

ALIKE_RAD = 0.25
"""Copies turn alike between neighbours, and see the Sun alike, to this everywhere: panels on the sides alone leave two mirror
images, which turn nearly alike where the body spins about the axis that nothing looks along."""

SUN_SHARE = 0.35
"""Directions of the Sun count so much less than turns there: they part mirror images, not what is still on its way to one place."""

WHOLE_SHARE = 0.7
"""And turns from the middle of the samples so much: 0.35 rad of them part two motions, as a fit moves no farther. Slow motions turn
nearly alike between neighbours, and by whole turns otherwise over a pass."""

BENT_RAD = 1.0
"""Two models, or two meanings of a reading, may bend one motion apart by so much between two samples; other motions differ by more,
mostly by whole turns."""

COPY_SIGMAS = 3.0
"""Motions that far apart at most, at every sample, lie in one valley of the cost, however long that is, and are copies too."""


class Outline(NamedTuple):
    """What motions (K) are compared by: `steps` (K, m, 3), turns between neighbours and directions of the Sun; turns from
    the middle, `whole` (K, n - 1, 3); rates `omega` (K, n, 3) and their covariance (K, n, 3, 3), or none (K, 0, 3, 3)."""

    steps: np.ndarray
    whole: np.ndarray
    omega: np.ndarray
    covariance: np.ndarray

    @classmethod
    def of(cls, track: Seen, times: np.ndarray, covariance: np.ndarray | None = None) -> Outline:
        """Return the outline of motions at `times` (n), s; `covariance` (K, n, 6, 6) of turn and rate, if not the track's."""
        if covariance is None:
            covariance = track.covariance if isinstance(track, Track) else np.zeros(0)
        count = len(track.omega)
        rates = covariance[..., 3:, 3:] if covariance.size else np.zeros((count, 0, 3, 3))
        dt = np.diff(times)[:, None] if len(times) > 1 else np.ones((1, 1))
        turns = track.omega[:, : len(dt)] * dt
        whole = np.cumsum(turns, axis=1)
        whole = WHOLE_SHARE * (whole - whole[:, len(dt) // 2, None])
        steps = np.concatenate([turns, SUN_SHARE * track.sun_B], axis=1)
        return cls(steps.astype(np.float32), whole.astype(np.float32), track.omega, rates)

    def take(self, index: np.ndarray) -> Outline:
        """Return the outline of the motions `index`."""
        return Outline(*(part[index] for part in self))

    def steps_alike(self, k: int, others: Outline, apart_rad: float = ALIKE_RAD) -> np.ndarray:
        """Return which of some motions (K) turn like motion `k` between neighbours and see the Sun where it does."""
        return _nowhere_farther(self.steps[k], others.steps, apart_rad)

    def copies(self, k: int, others: Outline) -> np.ndarray:
        """Return which of some motions (K), fitted under one model, are copies of motion `k`.

        They turn alike at every step; and alike over the whole pass, or their rates are within `COPY_SIGMAS` in each one's own
        sigma: a broad minimum reaches over narrow ones, which are none of its copies.
        """
        steps, whole = self.steps_alike(k, others), self._whole_alike(k, others, ALIKE_RAD)
        return whole & steps | self._within_sigmas(k, others, steps & ~whole, joint=False)

    def same(self, k: int, others: Outline, models_differ: bool) -> np.ndarray:
        """Return which of some motions (K) are the same as motion `k` for a user.

        Their turns agree as copies do, or to `BENT_RAD` where `models_differ`, or their rates are within `COPY_SIGMAS` of the joint
        error: minima so near to each other make one motion with a larger error.
        """
        apart_rad = BENT_RAD if models_differ else ALIKE_RAD
        alike = self.steps_alike(k, others, apart_rad) & self._whole_alike(k, others, apart_rad)
        # a Sun on the other side of the body is another motion, however alike the rates are
        near = self.steps_alike(k, others, BENT_RAD) & self._suns_alike(k, others) & ~alike
        return alike | self._within_sigmas(k, others, near, joint=True)

    def _suns_alike(self, k: int, others: Outline) -> np.ndarray:
        suns = slice(-self.omega.shape[1], None)
        return _nowhere_farther(self.steps[k, suns], others.steps[:, suns], ALIKE_RAD)

    def _whole_alike(self, k: int, others: Outline, apart_rad: float) -> np.ndarray:
        return _nowhere_farther(self.whole[k], others.whole, apart_rad)

    def _within_sigmas(self, k: int, others: Outline, asked: np.ndarray, joint: bool) -> np.ndarray:
        """Return which of the motions `asked` for (K) have rates within `COPY_SIGMAS` of motion `k` at every sample."""
        within = np.zeros(len(asked), dtype=bool)
        which = np.flatnonzero(asked)
        if len(which) and self.covariance.size and others.covariance.size:
            own, theirs = self.covariance[k], others.covariance[which]
            off = others.omega[which] - self.omega[k]
            spreads = [own + theirs] if joint else [np.broadcast_to(own, theirs.shape), theirs]
            far = np.max([_squared_sigmas(off, spread) for spread in spreads], axis=0)
            within[which] = far <= COPY_SIGMAS**2
        return within


def _nowhere_farther(own: np.ndarray, others: np.ndarray, apart_rad: float) -> np.ndarray:
    """Return which of some rows of vectors (K, m, 3) are nowhere farther from one row (m, 3) than this."""
    return ((others - own) ** 2).sum(axis=-1).max(axis=-1) <= apart_rad**2


def _squared_sigmas(off: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the largest squared distance (K), over samples, of `off` (K, n, 3) in sigmas of `covariance` (K, n, 3, 3); infinite
    where that is none."""
    variance, axes = np.linalg.eigh(np.nan_to_num(covariance))
    along = np.einsum("knij,kni->knj", axes, off)
    with np.errstate(divide="ignore", invalid="ignore"):
        squares = np.where(variance > 0, along**2 / variance, np.inf)
    return squares.sum(axis=-1).max(axis=-1)
