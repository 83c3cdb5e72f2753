"""Time tags that are off: a sample was taken a little earlier or later than it says, all its panels together.

That moves the powers of one sample in step with their rates of change. The error of each sample is integrated out by Laplace's
method about the error that explains the sample best: exact where powers change in proportion to it, and it follows errors that are
large beside what the noise leaves, where a quadrature over their prior would miss the peak.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.special import log_ndtr

from sunspin.estimate.terms.reading import LOG_2PI
from sunspin.solve.rotations import components_after_rotation

if TYPE_CHECKING:
    from sunspin.estimate.posterior.likelihood import Likelihood, Prediction

STEPS = 3
"""Newton's steps to the error that explains a sample best."""

FAR = 4.0
"""Sigmas beyond which such an error is not sought."""

TRIED = np.geomspace(1e-3, 0.1, 13)
"""Sigmas of time tags that are tried where they are said to be exact, as parts of the samples' interval."""


def turned(sun: np.ndarray, rate: np.ndarray, shift_s: np.ndarray) -> np.ndarray:
    """Directions (..., 3) in body axes `shift_s` (...) later, at the body rate (..., 3) that there is now."""
    return components_after_rotation(sun, rate * shift_s[..., None])


def power_slope(
    likelihood: Likelihood, sun: np.ndarray, rate: np.ndarray, u: np.ndarray
) -> np.ndarray:
    """Rates of change (n, K, P) of the powers at directions and rates (n, K, 3): none on dark panels."""
    slope = likelihood.response.power_changes(
        sun, [-np.cross(rate, sun)], gain=likelihood.gain(u), tilt=likelihood.tilt(u)
    )[0]
    return likelihood.throttle(likelihood.light(sun, u)).slope(slope)


def tagged(
    likelihood: Likelihood, prediction: Prediction, u: np.ndarray, tag_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Log density (n, K) of samples with times off by `tag_s` (one sigma, s), and the error (n, K) that explains each best.

    The best of two ways there: readings far off are spoilt, or the time is and they are far off because of it.
    """
    found, best = np.full(prediction.sun.shape[:2], -np.inf), np.zeros(prediction.sun.shape[:2])
    for trusting in (False, True):
        shift = np.zeros(best.shape)
        known, pull, hold = _sample(likelihood, prediction, u, shift, trusting)
        for _ in range(STEPS):
            shift = np.clip((pull + hold * shift) / (hold + tag_s**-2), -FAR * tag_s, FAR * tag_s)
            known, pull, hold = _sample(likelihood, prediction, u, shift)
        value = known - 0.5 * (shift / tag_s) ** 2 - 0.5 * np.log1p(tag_s**2 * hold)
        found, best = np.maximum(found, value), np.where(value > found, shift, best)
    return found, best


def tags_wanted(
    likelihood: Likelihood, prediction: Prediction, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What errors of time tags would add to the log-likelihood (n) of exact ones, and how large (n, s) they are then.

    With the slopes of exact times, as small errors are meant. The gain is that of the best of `TRIED`.
    """
    _, pull, hold = _sample(likelihood, prediction, u, np.zeros(prediction.sun.shape[:2]))
    tags = TRIED * float(np.median(np.diff(likelihood.data.t_s)))
    each = [
        0.5 * np.sum(pull**2 / (hold + tag**-2) - np.log1p(tag**2 * hold), axis=1) for tag in tags
    ]
    best = np.argmax(each, axis=0)
    return np.max(each, axis=0), tags[best]


def _sample(
    likelihood: Likelihood,
    prediction: Prediction,
    u: np.ndarray,
    shift: np.ndarray,
    trusting: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Log density (n, K) of samples `shift` s (n, K) later than they say, its derivative, and its curvature by Gauss and Newton.

    `trusting`: derivative and curvature as if no reading were spoilt.
    """
    data, s = likelihood.data, likelihood.noise(u)[:, None]
    sun = turned(prediction.sun, prediction.rate, shift)
    power, slope = likelihood.power(sun, u), power_slope(likelihood, sun, prediction.rate, u)
    good = likelihood.sunlight(power, s)
    total = np.logaddexp(good, likelihood.outlier)
    weight = np.where(
        data.used, 1.0 if trusting else np.exp(good - total), 0.0
    )  # probability that it is the Sun's
    off = np.where(data.lit, data.value - power, data.threshold - power) / s
    mills = np.exp(-0.5 * off**2 - 0.5 * LOG_2PI - log_ndtr(off))
    pull = weight * np.where(data.lit, off, -mills) / s
    hold = weight * np.where(data.lit, 1.0, mills * (mills + off)) / s**2
    known = np.where(data.used, total, 0.0).sum(axis=-1)
    return known, np.sum(pull * slope, axis=-1), np.sum(hold * slope**2, axis=-1)
