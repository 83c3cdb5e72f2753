"""The period of one column of telemetry, such as a light curve or a signal strength, at times that need not be even.

At each trial frequency the readings are fitted by a sine and its second harmonic, in addition to a slow trend: the periodogram of
Lomb (1976, Astrophys. Space Sci. 39, 447) and Scargle (1982, Astrophys. J. 263, 835) with two harmonics and a floating mean. A
light curve often repeats twice in a rotation; with two harmonics its rotation is not mistaken for half of it. Where the readings
cannot tell, both periods are listed with their probabilities.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.special import logsumexp

from sunspin.base.errors import InputError

HARMONICS = (1, 2)
"""Harmonics of a trial frequency: of a light curve those of two flashes in a rotation."""

SHAPES = ((1,), (2,), (1, 2))
"""Harmonics that a light curve may have, equally likely before: that of one flash in a rotation, two equal ones, or two unequal
ones. With the third alone errors of a sine's period were 1.5 sigma in the root mean square, as the second harmonic fits noise."""

TREND = 2
"""Degree of the polynomial in time that is fitted too: range and elevation change the signal slowly over a pass."""

FEWEST = 12
"""Fewest readings of a stretch: mean, trend and harmonics have seven numbers."""

FEWEST_CYCLES = 1.5
"""The longest period is seen so many times; a longer one looks like the trend."""

OVERSAMPLED = 8
"""Trial frequencies for each 1 / duration of the stretch, for the second harmonic, whose peaks are half as wide."""

FALSE_ALARM = 0.01
"""Largest probability that noise alone has a peak as high as this, for a period to be reported."""

NOISES = 200
"""Series of noise by which the height of the largest peak of noise is known; its 99 % quantile is then known to 7 %."""

LEAST_PROBABILITY = 0.01
"""Periods that are less probable are not listed."""

GAP_INTERVALS = 6.0
"""A gap of so many usual intervals parts two stretches, as it parts two passes."""

HALF_A_STEP = 3.0, 0.02
"""What a trial frequency may lack that is half a step from the top of its peak: log likelihood, or share of the squares of the
readings, if that is more. Its phase is then wrong by up to 0.2 rad at both ends, which leaves 0.2^2 / 3 of the squares."""

LEAST_LEFT = 1e-6
"""Share of the squares that any frequency leaves: readings are at best exact to a thousandth of their size."""

MOST_TRIALS = 20_000
"""Most trial frequencies of a stretch: 20,000 with 1,000 readings take half a minute."""


@dataclass(frozen=True)
class LikelyPeriod:
    """A period (s) with one sigma (s), and its probability among those that fit the readings."""

    period_s: float
    sigma_s: float
    probability: float


@dataclass(frozen=True)
class FoundPeriod:
    """A period seen in a column at `t_s` (s from the epoch, the middle of the stretch); `aliases`: others, less probable.

    The most probable one has `period_s` (s) with one sigma `sigma_s` (s) and the probability `probability`. `false_alarm`: that of
    a peak as high as this in noise alone.
    """

    t_s: float
    period_s: float
    sigma_s: float
    probability: float
    false_alarm: float
    aliases: tuple[LikelyPeriod, ...] = ()

    @property
    def every(self) -> tuple[LikelyPeriod, ...]:
        """Return all periods, the most probable one first."""
        return (LikelyPeriod(self.period_s, self.sigma_s, self.probability), *self.aliases)


class Stretch(NamedTuple):
    """What one stretch of a column shows: first and last time (s), readings, the period if there is one, and its false alarm."""

    first_s: float
    last_s: float
    readings: int
    false_alarm: float
    found: FoundPeriod | None


def find_periods(t_s: np.ndarray, values: np.ndarray, shortest_s: float) -> list[Stretch]:
    """Return what each stretch of a series between long gaps shows, with its period if noise alone would hardly show one.

    Parameters
    ----------
    t_s : (n) s
        Times, in any order.
    values : (n), any unit
        NaN where nothing was read.
    shortest_s : float, s
        No period is shorter.

    Returns
    -------
    list of Stretch
        In order of time. Stretches with fewer than :data:`FEWEST` readings are left out. A stretch whose readings are all the same
        has no period.
    """
    t_s, values = np.asarray(t_s, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if not shortest_s > 0:
        raise InputError("the shortest period must be positive", got=shortest_s)
    read = np.flatnonzero(np.isfinite(values) & np.isfinite(t_s))
    read = read[np.argsort(t_s[read], kind="stable")]
    read = read[np.diff(t_s[read], prepend=-np.inf) > 0]
    if len(read) < FEWEST:
        return []
    intervals = np.diff(t_s[read])
    ends = np.flatnonzero(intervals > GAP_INTERVALS * np.median(intervals)) + 1
    return [
        find_period(t_s[part], values[part], shortest_s)
        for part in np.split(read, ends)
        if len(part) >= FEWEST
    ]


def find_period(t_s: np.ndarray, values: np.ndarray, shortest_s: float) -> Stretch:
    """Return what readings (n) of one stretch at increasing times (n, s) show, with periods of `shortest_s` and more."""
    begin, end = float(t_s[0]), float(t_s[-1])
    duration = end - begin
    first = FEWEST_CYCLES / duration
    count = int(np.ceil((1 / shortest_s - first) * duration * OVERSAMPLED * len(HARMONICS))) + 1
    if count > MOST_TRIALS:
        raise InputError(
            "too many periods to try them all",
            got=f"{duration:.4g} s with periods from {shortest_s:.3g} s",
            do="give a smaller --max-rate-deg-s, or a shorter part of the file",
        )
    trend = _orthonormal(np.vander((t_s - begin) / duration - 0.5, TREND + 1))
    y = values - trend @ (trend.T @ values)
    nothing = Stretch(begin, end, len(t_s), 1.0, None)
    if count < 3 or not np.linalg.norm(y) > 1e-9 * np.linalg.norm(values):
        return nothing
    trials = np.linspace(first, 1 / shortest_s, count)
    fitted = _Fitted(t_s - (begin + end) / 2, trend, y)

    # Noise of a series is seldom white: a signal wanders. Noise alone has the correlation of the readings from sample to sample.
    noises = _wandering(t_s, _correlation(y))
    noises -= trend @ (trend.T @ noises)
    left = fitted.left(trials, HARMONICS)
    heights = -np.log1p(-fitted.most_explained(trials, noises))
    # the largest of many peaks follows the law of Gumbel, whose two numbers are those of its mean and spread
    scale = heights.std(ddof=1) * np.sqrt(6) / np.pi
    above = (-np.log(left.min()) - heights.mean()) / scale + np.euler_gamma
    false_alarm = float(-np.expm1(-np.exp(-above)))
    if not false_alarm <= FALSE_ALARM:
        return nothing._replace(false_alarm=false_alarm)

    # correlated readings count as fewer independent ones
    top = _top(lambda frequency: float(fitted.left(frequency, HARMONICS)[0]), trials, left.argmin())
    correlation = _correlation(fitted.residual(top), LEAST_LEFT * (y @ y))
    likely = _likely_periods(fitted, trials, len(t_s) * (1 - correlation) / (1 + correlation))
    best, aliases = likely[0], tuple(likely[1:])
    found = FoundPeriod(
        (begin + end) / 2, best.period_s, best.sigma_s, best.probability, false_alarm, aliases
    )
    return Stretch(begin, end, len(t_s), false_alarm, found)


class _Fitted:
    """Fits of readings y (n), free of their trend (n, 3), by harmonics at times (n) from the middle of the stretch."""

    def __init__(self, t_s: np.ndarray, trend: np.ndarray, y: np.ndarray) -> None:
        self.t_s, self.trend, self.y = t_s, trend, y

    def _harmonics(self, frequency: np.ndarray, which: tuple[int, ...] = HARMONICS) -> np.ndarray:
        """Return orthonormal columns (m, n, 2 or 4) of some harmonics of frequencies (m, Hz), free of the trend."""
        angle = 2 * np.pi * frequency[:, None] * self.t_s
        waves = [wave(k * angle) for k in which for wave in (np.cos, np.sin)]
        columns = np.stack(waves, axis=-1)
        columns -= self.trend @ (self.trend.T @ columns)
        # an aliased harmonic is another one or the trend again: columns of rounding are none
        size = np.linalg.norm(columns, axis=1, keepdims=True)
        basis, upper = np.linalg.qr(columns / np.maximum(size, 1e-12))
        kept = np.abs(np.einsum("mii->mi", upper)) > 1e-6
        return basis * (kept & (size[:, 0] > 1e-6))[:, None, :]

    def _parts(self, count: int) -> list[np.ndarray]:
        """Return so many frequencies in parts that fit in memory."""
        return np.array_split(np.arange(count), 1 + count * len(self.y) // 200_000)

    def most_explained(self, frequency: np.ndarray, series: np.ndarray) -> np.ndarray:
        """Return the largest share (k) of the squares of series (n, k), free of the trend, that any frequency (m, Hz) explains."""
        largest, size = np.zeros(series.shape[1]), (series**2).sum(axis=0)
        for part in self._parts(len(frequency)):
            basis = np.swapaxes(self._harmonics(frequency[part]), 1, 2)
            largest = np.maximum(largest, (((basis @ series) ** 2).sum(axis=1) / size).max(axis=0))
        return np.minimum(largest, 1 - 1e-12)

    def log_likelihood(self, frequency: np.ndarray, independent: float) -> np.ndarray:
        """Return that of frequencies (m, Hz), of all :data:`SHAPES`, if so many readings are independent.

        Of each shape it is the power of what its harmonics leave of the squares, less what its numbers cost (Schwarz 1978).
        """
        each = []
        for which in SHAPES:
            left = self.left(frequency, which)
            numbers = TREND + 1 + 2 * len(which)
            freedom = max(independent - numbers, 1.0)
            each.append(-freedom / 2 * np.log(left) - len(which) * np.log(independent))
        return logsumexp(each, axis=0)

    def left(self, frequency: np.ndarray, which: tuple[int, ...]) -> np.ndarray:
        """Return the share (m) of the readings' squares that some harmonics of frequencies (m, Hz) leave."""
        explained = np.zeros(len(frequency))
        for part in self._parts(len(frequency)):
            basis = np.swapaxes(self._harmonics(frequency[part], which), 1, 2)
            explained[part] = ((basis @ self.y) ** 2).sum(axis=1)
        return np.maximum(1 - explained / (self.y @ self.y), 0.0) + LEAST_LEFT

    def residual(self, frequency: float) -> np.ndarray:
        """Return the readings (n) less trend and harmonics."""
        basis = self._harmonics(np.array([frequency]))[0]
        return self.y - basis @ (basis.T @ self.y)


def _top(depth: Callable[[np.ndarray], float], trials: np.ndarray, peak: Any) -> float:
    """Return the frequency (Hz) of the peak's top near `trials[peak]`, where `depth`, a function of one frequency (1), is least."""
    # imported here: `rates`, which only reads the results, should not wait for scipy.optimize
    from scipy.optimize import minimize_scalar

    step = float(trials[1] - trials[0])
    bounds = max(trials[peak] - step, trials[0]), min(trials[peak] + step, trials[-1])
    found = minimize_scalar(
        lambda frequency: depth(np.array([frequency])),
        bounds=bounds,
        method="bounded",
        options={"xatol": 1e-4 * step},
    )
    return float(found.x)


def _likely_periods(fitted: _Fitted, trials: np.ndarray, independent: float) -> list[LikelyPeriod]:
    """Return the periods that fit about as well as the best one, the most probable first.

    All frequencies are as likely before. Each peak is a normal law with the curvature of its top. `independent`: readings.
    """
    step = float(trials[1] - trials[0])

    def depth(frequency: np.ndarray) -> float:
        """Return minus the log likelihood of a frequency (1), Hz."""
        return -float(fitted.log_likelihood(frequency, independent)[0])

    height = fitted.log_likelihood(trials, independent)
    edges = np.concatenate([[-np.inf], height, [-np.inf]])
    peaks = np.flatnonzero((edges[1:-1] >= edges[:-2]) & (edges[1:-1] > edges[2:]))
    # the peaks of exact readings are narrow: a trial half a step away from the top of one may lie far below it
    left = fitted.left(trials, HARMONICS)
    possible = np.maximum(left - HALF_A_STEP[1], LEAST_LEFT)
    lacks = np.maximum(HALF_A_STEP[0], independent / 2 * np.log(left / possible))
    tops = (height + lacks)[peaks]
    peaks = peaks[tops > height.max() + np.log(LEAST_PROBABILITY)]
    rows = []
    for peak in peaks:
        top = np.array([_top(depth, trials, peak)])
        least, wide, drop = depth(top), step, np.inf
        while drop > 0.5 and wide > 1e-6 * step:  # down to where the top is a parabola
            wide /= 2
            drop = (depth(top + wide) + depth(top - wide)) / 2 - least
        sigma = min(wide / np.sqrt(2 * drop), step) if drop > 0 else step
        rows.append((float(top[0]), sigma, -least))
    frequency, sigma, log_height = np.array(rows).T
    weight = np.exp(log_height - log_height.max()) * sigma
    weight /= weight.sum()
    order = [k for k in np.argsort(-weight) if weight[k] >= LEAST_PROBABILITY]
    total = float(weight[order].sum())
    return [
        LikelyPeriod(
            float(1 / frequency[k]), float(sigma[k] / frequency[k] ** 2), float(weight[k] / total)
        )
        for k in order
    ]


def _correlation(left: np.ndarray, white: float = 0.0) -> float:
    """Return the correlation of neighbouring readings (n) free of their trend, with what the trend took from it, 0 to 0.95.

    `white`: sum of the squares of an uncorrelated part that is added.
    """
    n = len(left)
    read = (left[1:] @ left[:-1]) / (left @ left + white)
    # a trend of three numbers, fitted to noise of correlation r, lowers it by about (3 + 3 r) / n, as after Kendall (1954)
    return float(np.clip(read + (TREND + 1) * (1 + read) / n, 0.0, 0.95))


def _orthonormal(columns: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis (n, k) of columns (n, k)."""
    return np.linalg.qr(columns)[0]


def _wandering(t_s: np.ndarray, correlation: float) -> np.ndarray:
    """Return series of noise (n, `NOISES`) at times (n, s), with this correlation over the usual interval, the same every time."""
    fresh = np.random.default_rng(0).standard_normal((len(t_s), NOISES))
    intervals = np.diff(t_s)
    over = (
        correlation ** (intervals / np.median(intervals))
        if correlation
        else np.zeros(len(intervals))
    )
    series = fresh.copy()
    for i, one in enumerate(over, start=1):
        series[i] = one * series[i - 1] + np.sqrt(1 - one**2) * fresh[i]
    return series
