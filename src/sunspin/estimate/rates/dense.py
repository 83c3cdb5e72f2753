"""From the samples that the smoother of :mod:`sunspin.estimate.rates` has kept of a dense pass to all of them.

Between two kept samples the body is carried on from the first and back from the second by the equations of motion, and the two
are blended. Unknown torques in between are those of white angular acceleration whose ends are held: a bridge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from sunspin.estimate.rates.motion import Ends, step_with_answer
from sunspin.estimate.rates.smooth import noises
from sunspin.estimate.rates.state import Motion, Observations, Track
from sunspin.solve.rotations import turn, turn_between


@dataclass(frozen=True)
class Way:
    """K states carried to m samples, from the kept samples `number` (m): attitudes (K, m, 3, 3), rates (K, m, 3) and their answer
    (K, m, 6, 6) to turn and rate at the start; `weight` (m): what part they are of the blend."""

    number: np.ndarray
    attitude: np.ndarray
    omega: np.ndarray
    answer: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True)
class Dense:
    """How the samples of a pass (n) follow from those kept (n_kept, at the places `there`): the others (at `new`) carried `on` and
    `back`, `share` (m) of an interval of `span_s` (m) behind its first, under `noise` (m), rad/s^1.5, and `rate_noise`."""

    count: int
    there: np.ndarray
    new: np.ndarray
    on: Way
    back: Way
    share: np.ndarray
    span_s: np.ndarray
    noise: np.ndarray
    rate_noise: float

    @classmethod
    def of(cls, o: Observations, every: np.ndarray, kept: np.ndarray, track: Track, motion: Motion) -> Dense:
        """Of hypotheses known at the samples `kept` (indices of `o`); `every` begins and ends with the same samples."""
        there = np.searchsorted(every, kept)
        new = np.setdiff1d(np.arange(len(every)), there)
        before = np.searchsorted(kept, every[new]) - 1
        span = o.t_s[kept[before + 1]] - o.t_s[kept[before]]
        share = (o.t_s[every[new]] - o.t_s[kept[before]]) / span
        weight = share**2 * (3 - 2 * share)  # level at both ends, so that the attitude's rate of change there is the rate
        on = _carried(o, track, before, kept[before], every[new], motion, 1 - weight)
        back = _carried(o, track, before + 1, kept[before + 1], every[new], motion, weight)
        noise, rate_noise = noises(o.take(kept), motion)
        return cls(len(every), there, new, on, back, share, span, noise[before], rate_noise)

    def mean_map(self) -> np.ndarray:
        """What the mean rate over all samples answers to turn and rate at the kept ones, (K, n_kept, 3, 6)."""
        made = np.zeros((len(self.on.omega), len(self.there), 3, 6))
        made[..., 3:] = np.eye(3)
        for way in (self.on, self.back):
            place: Any = (slice(None), way.number)  # NumPy declares lists of numbers only
            np.add.at(made, place, way.weight[:, None, None] * way.answer[..., 3:, :])
        return made / self.count

    def filled(self, track: Track) -> Track:
        """Attitude, rate and covariance at all samples; at the kept ones they are those given."""
        attitude = np.empty((len(track.omega), self.count, 3, 3))
        omega, covariance = np.empty((*attitude.shape[:2], 3)), np.empty((*attitude.shape[:2], 6, 6))
        attitude[:, self.there], omega[:, self.there], covariance[:, self.there] = track.attitude, track.omega, track.covariance
        weight = self.back.weight[:, None]
        attitude[:, self.new] = turn(self.on.attitude, weight * turn_between(self.on.attitude, self.back.attitude))
        omega[:, self.new] = self.on.omega + weight * (self.back.omega - self.on.omega)
        spread = bridge(self.share, self.span_s, self.noise, self.rate_noise)
        for way in (self.on, self.back):
            start = track.covariance[:, way.number]
            spread = spread + way.weight[:, None, None] * (way.answer @ start @ np.swapaxes(way.answer, -1, -2))
        covariance[:, self.new] = spread
        return replace(track, attitude=attitude, omega=omega, covariance=covariance)


def _carried(
    o: Observations, track: Track, number: np.ndarray, start: np.ndarray, end: np.ndarray, motion: Motion, weight: np.ndarray
) -> Way:
    """From the kept samples `number` (m), which are `start` of `o`, to its samples `end`."""
    shape = (len(track.omega), len(number))
    if not len(number):
        return Way(number, np.empty((*shape, 3, 3)), np.empty((*shape, 3)), np.empty((*shape, 6, 6)), weight)
    ends = Ends(momentum=o.momentum[start], momentum_end=o.momentum[end])
    if np.any(motion.body.dipole):
        known = np.all(np.isfinite(o.field_B[start]), axis=1) & np.all(np.isfinite(o.field_B[end]), axis=1)
        first, second = (np.where(known[:, None], np.nan_to_num(o.field_B[index]), 0.0) for index in (start, end))
        ends = ends._replace(field=first, field_end=second)
    ends = Ends(*(None if part is None else np.broadcast_to(part, (*shape, 3)) for part in ends))
    dt = np.broadcast_to(o.t_s[end] - o.t_s[start], shape)
    ends = motion.body.seen(ends, track.attitude[:, number], o.t_s[start])
    made, omega, answer = step_with_answer(motion.body, track.omega[:, number], dt, ends)
    return Way(number, made @ track.attitude[:, number], omega, answer, weight)


def bridge(share: np.ndarray, span_s: np.ndarray, noise: npt.ArrayLike, rate_noise: float = 0.0) -> np.ndarray:
    """Covariance (m, 6, 6) of turn and rate at a part `share` of an interval whose ends are held, under white angular
    acceleration: the variance of a bridge of its integral and twofold integral; and of the turn under white noise of the rate."""
    s, square = share * (1 - share), np.square(noise)
    made = np.zeros((len(share), 6, 6))
    made[:, :3, :3] = (square * span_s**3 * s**3 / 3 + rate_noise**2 * span_s * s)[:, None, None] * np.eye(3)
    made[:, 3:, 3:] = (square * span_s * s * (1 - 3 * s))[:, None, None] * np.eye(3)
    return made
