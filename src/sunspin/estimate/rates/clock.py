"""How late gyro, magnetometer and attitude are behind the Sun of their row, from all passes of :mod:`sunspin.estimate.rates`.

One number for a file. Each pass tells it as well as its rates change; told or not, a lateness that the data want is looked for.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sunspin.estimate.rates.common_errors import Clock, has_common, with_common
from sunspin.estimate.rates.smooth import smooth
from sunspin.estimate.rates.state import Motion, Observations, Track

UNTOLD_SIGMA_S = 30.0
"""How late sensors may be where the vehicle file says nothing and it is only asked whether they are."""

LOOKED_AT = 3
"""Passes, those with the most samples, in which a lateness is looked for."""

SURE_SIGMAS, SURE_GAIN = 5.0, 12.0
"""A lateness that nobody spoke of is told if it is so many sigma from zero and lowers the cost by so much."""

TRIED_RAD = (0.0, 1.0, -1.0)
"""Where the fit of a lateness begins: that of these turns of the body."""


class Late(NamedTuple):
    """A lateness (s), its sigma (s), and by how much it lowers the cost."""

    late_s: float
    sigma_s: float
    gain: float


def others_there(o: Observations) -> bool:
    """Whether a pass has any of the sensors that may be late."""
    return any(term.readings() for term in o.terms)


def lateness(passes: list[tuple[Observations, Track]], motion: Motion, clock: Clock) -> Late | None:
    """The lateness that all passes tell together under the prior `clock`, each by its best mode; None where none is told."""
    precision, weighted, gain, count = 0.0, 0.0, 0.0, 0
    for o, track in passes:
        if not others_there(o):
            continue
        best = track.take(np.array([0] * len(TRIED_RAD)))
        rate = max(float(np.linalg.norm(best.omega[0], axis=1).mean()), 1e-6)
        first = np.clip(np.array(TRIED_RAD) / rate / clock.sigma_s, -2, 2)
        fit = with_common(o, best, motion, clock, first)
        k = int(np.argmin(fit.track.cost))
        own = (
            1 / (fit.covariance[k, -1, -1] * clock.sigma_s**2) - 1 / clock.sigma_s**2
        )  # what the pass adds to the prior
        if own > 0:
            late = clock.late_s + clock.sigma_s * fit.error[k, -1]
            precision += own
            weighted += own * late + (late - clock.late_s) / clock.sigma_s**2
            gain += _cost_without(o, best.take(np.array([0])), motion, clock) - float(
                fit.track.cost[k]
            )
            count += 1
    if not count:
        return None
    total = precision + 1 / clock.sigma_s**2
    return Late((weighted + clock.late_s / clock.sigma_s**2) / total, total**-0.5, gain)


def _cost_without(o: Observations, track: Track, motion: Motion, clock: Clock) -> float:
    """The cost of a motion whose sensors are as late as the prior says."""
    known = Clock(clock.late_s) if clock.late_s else None
    if has_common(o, known, motion):
        return float(with_common(o, track, motion, known).track.cost[0])
    return float(smooth(o, track, motion, steps=10).cost[0])


def suspected(passes: list[tuple[Observations, Track]], motion: Motion) -> Late | None:
    """A lateness that the vehicle file does not speak of but the data want; None where they do not."""
    longest = sorted(passes, key=lambda one: len(one[0]), reverse=True)[:LOOKED_AT]
    late = lateness(longest, motion, Clock(0.0, UNTOLD_SIGMA_S))
    sure = (
        late is not None and abs(late.late_s) > SURE_SIGMAS * late.sigma_s and late.gain > SURE_GAIN
    )
    return late if sure else None
