"""From the samples that the smoother of :mod:`sunspin.estimate.rates` has kept of a pass to all of them, and to instants between.

Between two kept samples the body is carried on from the first and back from the second by the equations of motion, and the two
are blended. Unknown torques in between are those of white angular acceleration whose ends are held: a bridge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from sunspin.estimate.rates.motion import Ends, angle_turned, step_with_answer
from sunspin.estimate.rates.smooth import EVEN, noises
from sunspin.estimate.rates.state import Motion, Observations, Track
from sunspin.solve.rotations import rotate_attitude, rotation_between

CURVE_RAD, LEAST_INSTANTS, MOST_INSTANTS = 0.1, 50, 6000
"""Between instants of a pass's curve body or rate turn by so much at most, unless that takes more instants than the last number."""

COARSE_RAD, MOST_COARSE = 0.5, 60_000
"""Then they turn by this much, below 30 degrees, so that whoever interpolates goes the right way round. The last number, 8 hours at
60 deg/s, takes 90 MB while it is computed."""

TOGETHER = 1e-4
"""Of the time between two instants: one so near to a sample is that sample."""


class Acts(NamedTuple):
    """What acts on the body at instants `t_s` (n): `momentum` (n, 3) and `field_B` (n, 3) as of `Observations`."""

    t_s: np.ndarray
    momentum: np.ndarray
    field_B: np.ndarray

    @classmethod
    def of(cls, o: Observations) -> Acts:
        return cls(o.t_s, o.momentum, o.field_B)

    def take(self, index: np.ndarray) -> Acts:
        return Acts(*(part[index] for part in self))

    def at(self, t_s: np.ndarray) -> Acts:
        """The same, linear between these instants, as a step of the smoother has it."""
        return Acts(
            t_s,
            *(np.stack([np.interp(t_s, self.t_s, x) for x in part.T], axis=1) for part in self[1:]),
        )


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
    `back`, `share` (m) of an interval of `span_s` (m) behind its first, under `noise` (m), rad/s^1.5, with `shares` (3, 3) of the
    body's axes, and `rate_noise`."""

    count: int
    there: np.ndarray
    new: np.ndarray
    on: Way
    back: Way
    share: np.ndarray
    span_s: np.ndarray
    noise: np.ndarray
    rate_noise: float
    shares: np.ndarray

    @classmethod
    def of(
        cls, o: Observations, every: np.ndarray, kept: np.ndarray, track: Track, motion: Motion
    ) -> Dense:
        """Of hypotheses known at the samples `kept` (indices of `o`); `every` begins and ends with the same samples."""
        there = np.searchsorted(every, kept)
        new = np.setdiff1d(np.arange(len(every)), there)
        return cls.at(o.take(kept), Acts.of(o).take(every[new]), there, new, track, motion)

    @classmethod
    def at(
        cls,
        o: Observations,
        acts: Acts,
        there: np.ndarray,
        new: np.ndarray,
        track: Track,
        motion: Motion,
    ) -> Dense:
        """Of hypotheses known at the samples `o`, at the instants of `acts`, each between two of them: in the order of time
        samples stand at the places `there` and the others at `new`."""
        before = np.searchsorted(there, new) - 1
        span = o.t_s[before + 1] - o.t_s[before]
        share = (acts.t_s - o.t_s[before]) / span
        weight = share**2 * (
            3 - 2 * share
        )  # level at both ends, so that the attitude's rate of change there is the rate
        on = _carried(o, track, before, acts, motion, 1 - weight)
        back = _carried(o, track, before + 1, acts, motion, weight)
        noise, rate_noise, shares = noises(o, motion)
        count, noise = len(there) + len(new), noise[before]
        return cls(count, there, new, on, back, share, span, noise, rate_noise, shares)

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
        omega, covariance = (
            np.empty((*attitude.shape[:2], 3)),
            np.empty((*attitude.shape[:2], 6, 6)),
        )
        attitude[:, self.there], omega[:, self.there], covariance[:, self.there] = (
            track.attitude,
            track.omega,
            track.covariance,
        )
        weight = self.back.weight[:, None]
        attitude[:, self.new] = rotate_attitude(
            self.on.attitude, weight * rotation_between(self.on.attitude, self.back.attitude)
        )
        omega[:, self.new] = self.on.omega + weight * (self.back.omega - self.on.omega)
        spread = bridge(self.share, self.span_s, self.noise, self.rate_noise, self.shares)
        for way in (self.on, self.back):
            start = track.covariance[:, way.number]
            spread = spread + way.weight[:, None, None] * (
                way.answer @ start @ np.swapaxes(way.answer, -1, -2)
            )
        covariance[:, self.new] = spread
        return replace(track, attitude=attitude, omega=omega, covariance=covariance)


def _carried(
    o: Observations,
    track: Track,
    number: np.ndarray,
    acts: Acts,
    motion: Motion,
    weight: np.ndarray,
) -> Way:
    """From the samples `number` (m) of `o` to the instants of `acts` (m)."""
    shape = (len(track.omega), len(number))
    if not len(number):
        return Way(
            number,
            np.empty((*shape, 3, 3)),
            np.empty((*shape, 3)),
            np.empty((*shape, 6, 6)),
            weight,
        )
    ends = Ends(momentum=o.momentum[number], momentum_end=acts.momentum)
    if np.any(motion.body.dipole):
        known = np.all(np.isfinite(o.field_B[number]), axis=1) & np.all(
            np.isfinite(acts.field_B), axis=1
        )
        first, second = (
            np.where(known[:, None], np.nan_to_num(field), 0.0)
            for field in (o.field_B[number], acts.field_B)
        )
        ends = ends._replace(field=first, field_end=second)
    ends = Ends(*(None if part is None else np.broadcast_to(part, (*shape, 3)) for part in ends))
    dt = np.broadcast_to(acts.t_s - o.t_s[number], shape)
    ends = motion.body.seen(ends, track.attitude[:, number], o.t_s[number])
    made, omega, answer = step_with_answer(motion.body, track.omega[:, number], dt, ends)
    return Way(number, made @ track.attitude[:, number], omega, answer, weight)


def curve(o: Observations, track: Track, motion: Motion) -> tuple[np.ndarray, Track]:
    """A motion (K = 1) known at the samples `o`, on even instants (m) s, so close that straight lines between them will do."""
    spans = np.diff(o.t_s)
    angle = angle_turned(
        motion.body,
        track.omega[0, :-1],
        spans,
        Ends(momentum=o.momentum[:-1], momentum_end=o.momentum[1:]),
    )
    turned = (o.t_s[-1] - o.t_s[0]) * np.max(angle / spans)
    most = max(MOST_INSTANTS, min(np.ceil(turned / COARSE_RAD), MOST_COARSE))
    count = int(np.clip(np.ceil(turned / CURVE_RAD), LEAST_INSTANTS, most)) + 1
    instants, step = np.linspace(o.t_s[0], o.t_s[-1], count, retstep=True)
    there = np.searchsorted(instants, o.t_s - step * TOGETHER)
    met = np.abs(instants[there] - o.t_s) <= step * TOGETHER
    every = np.union1d(np.delete(instants, there[met]), o.t_s)
    known = np.isin(every, o.t_s)
    found = Dense.at(
        o,
        Acts.of(o).at(every[~known]),
        np.flatnonzero(known),
        np.flatnonzero(~known),
        track,
        motion,
    ).filled(track)
    at = np.searchsorted(every, instants - step * TOGETHER)
    return instants, replace(
        found,
        attitude=found.attitude[:, at],
        omega=found.omega[:, at],
        covariance=found.covariance[:, at],
    )


def bridge(
    share: np.ndarray,
    span_s: np.ndarray,
    noise: npt.ArrayLike,
    rate_noise: float = 0.0,
    shares: np.ndarray = EVEN,
) -> np.ndarray:
    """Covariance (m, 6, 6) of turn and rate at a part `share` of an interval whose ends are held, under white angular
    acceleration: the variance of a bridge of its integral and twofold integral; and of the turn under white noise of the rate."""
    s, span = (share * (1 - share))[:, None, None], span_s[:, None, None]
    square = np.square(noise)[..., None, None] * shares
    made = np.zeros((len(share), 6, 6))
    made[:, :3, :3] = square * span**3 * s**3 / 3 + rate_noise**2 * span * s * EVEN
    made[:, 3:, 3:] = square * span * s * (1 - 3 * s)
    return made
