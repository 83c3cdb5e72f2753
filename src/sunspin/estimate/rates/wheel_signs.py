"""Whether the wheels turn the way the file says: the signs of a wheel's axis and speed are conventions, so the other is tried.

A wheel turns the rate of the body round. Half a turn forward and half a turn back between two samples end alike, so that a wheel
of the wrong sign may fit as well, with another motion. A reversed wheel is named where it clearly fits better than the wheel as
stated, and its motion is one that the sigmas as stated leave out: one too weak to be seen is not accused. Where both signs fit
alike the file is believed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.estimate.effort import may_go_on
from sunspin.estimate.equivalence import CLEARLY, WEAK_RAD, wheel_changes
from sunspin.estimate.rates.alternatives import Others
from sunspin.estimate.rates.common_errors import Clock
from sunspin.estimate.rates.finish import Pass, finished, leading
from sunspin.estimate.rates.motion import Body, nutation
from sunspin.estimate.rates.noise import NOISE_LADDER, Task, refined
from sunspin.estimate.rates.smooth import cost_limit
from sunspin.estimate.rates.state import Motion, Observations
from sunspin.estimate.rates.wheels import momentum_of_each
from sunspin.estimate.terms.magnetic_torque import MagneticTorque
from sunspin.estimate.terms.term import Term
from sunspin.estimate.verdict import misfit
from sunspin.vehicle import Vehicle

LOOKED_AT = 2
"""Passes, those with the most samples, that are asked."""

FAR = 20.0
"""Log evidence by which reversed wheels must be worse, in a search that holds the inertia fast, to be out of the question."""

WRAPPED_RAD = 10.0
"""Nor wheels that turn it round by more than this from sample to sample: at 42 rad one of five right files was accused."""

AS_WELL = 1.0
"""Log evidence by which they may be worse in one pass and are looked at on."""

OTHER_SIGMAS = 3.0
"""A motion is another one where its rates are so many sigmas of the stated one from it, at half of the samples."""


class Anew(NamedTuple):
    """What a pass is estimated with a second time: its body, the largest rate (rad/s), the acceleration noise if it is `given`,
    the clock, other models; `more`: terms that go with the noise, and come anew with another."""

    body: Body
    rate_max: float
    given: float | None
    clock: Clock | None
    others: Others
    more: tuple[Term, ...]

    def bare(self, o: Observations) -> Observations:
        """Without what a search does not know."""
        return replace(
            o, terms=tuple(term for term in o.terms if not any(term is one for one in self.more))
        )

    def estimated(self, o: Observations, whole: np.ndarray, part: np.ndarray, noise: float) -> Pass:
        """The pass of all samples `whole`, searched on `part` under a noise."""
        motion = Motion(self.body, noise, self.rate_max / 2)
        bare = self.bare(o)
        track = leading(bare.take(part), motion, self.rate_max)
        if self.more:
            o = replace(
                bare, terms=(*bare.terms, MagneticTorque.beside(noise, bare.freed().field_N))
            )
        if self.given is None:
            motion = replace(motion, noise=refined([(o.take(part).freed(), track)], motion))
        return finished(
            o, whole, part, track, motion, self.clock, self.rate_max, noise, self.others
        )


class Reversed(NamedTuple):
    """Wheels, by their numbers, that may turn the other way, by how much log evidence that fits better, and the longest pass
    estimated so: whether it fits, its times (n) s, rates (n, 3) rad/s and directions of the Sun (n, 3)."""

    wheels: tuple[int, ...]
    gain: float
    fits: bool
    t_s: np.ndarray
    omega: np.ndarray
    sun_B: np.ndarray


def reversed_momenta(
    vehicle: Vehicle, telemetry: xr.Dataset, doing: str, o: Observations
) -> dict[tuple[int, ...], np.ndarray]:
    """The wheels' momenta (n, 3) as they would be with each of them reversed, and with all, by the numbers of those reversed;
    `doing`: what they do (:func:`wheel_momenta`). None of one so slow that it hardly turns the rate round, or so
    fast that it wraps."""
    body, found = Body.of(vehicle), {}
    each = momentum_of_each(vehicle, telemetry, doing)
    for change in wheel_changes(vehicle) if np.any(o.momentum) else ():
        which = change.reversed_wheels
        momentum = each.sum(axis=0) - 2 * each[list(which)].sum(axis=0)
        rate = nutation(body, (momentum - o.momentum) / 2).max(initial=0.0)
        if rate * np.ptp(o.t_s) > WEAK_RAD and rate * np.median(np.diff(o.t_s)) < WRAPPED_RAD:
            found[which] = momentum
    return found


def tasks(
    o: Observations,
    parts: Sequence[np.ndarray],
    body: Body,
    noise: float,
    given: float | None,
    rate_max: float,
    momenta: dict[tuple[int, ...], np.ndarray],
) -> list[Task]:
    """Of which the evidence says which reversed wheels are not out of the question for the longest pass: the wheels as stated
    under the `noise` of the search, then the reversed ones. What is observed is as a search takes it."""
    part = parts[_longest_first(parts)[0]]
    others = [(replace(o, momentum=momentum), _rungs(given)) for momentum in momenta.values()]
    return (
        [(one.take(part), body, noises, rate_max) for one, noises in [(o, (noise,)), *others]]
        if others
        else []
    )


def _rungs(given: float | None) -> tuple[float, ...]:
    """Noises (rad/s^1.5) tried of reversed wheels, where none or one is `given`."""
    return NOISE_LADDER if given is None else (given,)


def _near(
    o: Observations,
    momenta: dict[tuple[int, ...], np.ndarray],
    rungs: tuple[float, ...],
    evidence: Sequence[np.ndarray],
) -> dict[tuple[int, ...], tuple[Observations, float]]:
    """Which reversed wheels are not out of the question by the evidence of their :func:`tasks`: what is observed with them, and the
    acceleration noise (rad/s^1.5) that they want."""
    stated, *found = evidence
    levels = {
        which: rungs[int(np.argmax(one))]
        for which, one in zip(momenta, found, strict=True)
        if one.max() > stated[0] - FAR
    }
    return {which: (replace(o, momentum=momenta[which]), level) for which, level in levels.items()}


def _longest_first(parts: Sequence[np.ndarray]) -> list[int]:
    """Numbers of the passes (samples of each) that are asked."""
    return sorted(range(len(parts)), key=lambda k: -len(parts[k]))[:LOOKED_AT]


def doubted_signs(
    o: Observations,
    momenta: dict[tuple[int, ...], np.ndarray],
    passes: list[tuple[np.ndarray, np.ndarray, Pass]],
    noise: float,
    anew: Anew,
    evidence: Sequence[np.ndarray],
) -> Reversed | None:
    """The wheels whose sign the data doubt; None where they do not, or cannot.

    `momenta` (n, 3): with wheels reversed, by their numbers; `passes`: all samples of each, those searched, and what was found
    under the `noise` of the search; `evidence`: of the :func:`tasks` of the longest pass.
    """
    if not momenta:
        return None
    longest = [passes[k] for k in _longest_first([part for _, part, _ in passes])]
    found: list[Reversed] = []
    for which, (other, level) in _near(o, momenta, _rungs(anew.given), evidence).items():
        gain, another, turned = 0.0, False, None
        for whole, part, stated in longest:
            one = (
                _gained(o, other, whole, part, stated, (noise, level), anew) if may_go_on() else OUT
            )
            gain, another, turned = gain + one.gain, another or one.another, turned or one.turned
            if gain < -AS_WELL:
                break
        else:
            if another and gain >= CLEARLY and turned is not None:
                found.append(_reversed(o, which, gain, turned))
    return max(found, key=lambda one: one.gain, default=None)


def _reversed(o: Observations, which: tuple[int, ...], gain: float, turned: Pass) -> Reversed:
    """What is known of reversed wheels, with the longest pass as estimated with them."""
    agree = all(misfit(left[0]).fits for left in turned.residual.values())
    fits = bool(agree and turned.track.cost[0] <= cost_limit(o.take(turned.kept)))
    return Reversed(
        which, gain, fits, o.t_s[turned.index], turned.track.omega[0], turned.track.sun_B[0]
    )


class Gained(NamedTuple):
    """What reversed wheels gain of a pass, in log evidence, whether they leave another motion, and the pass estimated with them."""

    gain: float
    another: bool
    turned: Pass | None = None


OUT = Gained(-np.inf, False)
"""Where no motion is found with them."""


def _gained(
    o: Observations,
    other: Observations,
    whole: np.ndarray,
    part: np.ndarray,
    stated: Pass,
    noises: tuple[float, float],
    anew: Anew,
) -> Gained:
    """Of one pass, under the noises (rad/s^1.5) that the wheels as stated and the others want, each tried under both where that
    decides: held fast, an inertia that is a little off passes for torques, and its noise is too strong."""
    noise, level = noises
    try:
        turned = anew.estimated(other, whole, part, level)
        gain = _evidence(turned) - _evidence(stated)
        if -FAR < gain < -AS_WELL and level != noise:
            again = anew.estimated(other, whole, part, noise)
            turned, gain = max(
                (turned, gain),
                (again, _evidence(again) - _evidence(stated)),
                key=lambda one: one[1],
            )
        if gain > -AS_WELL and level != noise:
            gain = min(gain, _evidence(turned) - _evidence(anew.estimated(o, whole, part, level)))
    except InputError:
        return OUT
    return Gained(gain, _another(stated, turned), turned)


def _evidence(found: Pass) -> float:
    return float(np.logaddexp.reduce(found.track.log_weight))


def _another(stated: Pass, turned: Pass) -> bool:
    """Whether the best motion of the second is none that the first allows."""
    sigma = np.sqrt(np.einsum("nii->ni", stated.track.covariance[0, :, 3:, 3:]))
    off = np.abs(turned.track.omega[0] - stated.track.omega[0]) / sigma
    return bool(np.median(off.max(axis=1)) > OTHER_SIGMAS)
