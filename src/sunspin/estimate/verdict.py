"""What may be believed of an estimate: three questions, asked alike of every pass of `rates` and of every posterior.

Is one motion left? Do the data inform it, or is the prior given back? Does it fit, each sensor by itself? A motion is decided
if all three are answered with yes and the search left nothing out. Everything here is a pure function of what was found.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.special import (
    chdtri,
    ndtr,
)  # scipy.stats takes longer to import than a short pass to estimate

from sunspin.vehicle import Vehicle

NARROWER = 0.5
"""A component is constrained if its standard deviation, all solutions counted, is below this part of the prior's."""

BEYOND = 2 * float(ndtr(-3.0))
"""Chance of a sound reading to lie beyond three sigma."""

MOST_BEYOND, ONE_SPIKE = 0.3, 1.5
"""No motion fits where a larger share of one sensor's readings, and more than one, lies beyond three sigma, however strewn."""

FEW_BEYOND, LEAST_BEYOND = 0.04, 4
"""Readings beyond three sigma that come one after another are no spikes, but a motion that is not this one: from this share on,
and so many of them."""

IN_RUNS = 1e-2
"""Chance below which readings beyond three sigma would lie next to each other so often if they were strewn."""

LEAST_DRAWS = 200.0
"""Effective draws from which a median is known to a tenth of its sigma."""


class Misfit(NamedTuple):
    """One sensor's residuals along the best motion: readings, share beyond three sigma, chance of so few runs over time."""

    count: int
    share: float
    chance: float

    @property
    def fits(self) -> bool:
        """Whether the sensor agrees with the motion."""
        beyond = self.share * self.count
        in_runs = self.share > FEW_BEYOND and beyond > LEAST_BEYOND - 0.5 and self.chance < IN_RUNS
        return not (in_runs or (self.share > MOST_BEYOND and beyond > ONE_SPIKE))


class Speed(NamedTuple):
    """The angular speed of the reported motion, rad/s: `value`, that of the most probable solution; `sigma`, the root mean square
    of the speed's difference from it within that solution; `below`, the 95 % quantile of the speed, all solutions counted."""

    value: float
    sigma: float
    below: float

    @property
    def constrained(self) -> bool:
        """Whether the data give a speed. Otherwise they give an upper limit only, `below`."""
        return bool(self.sigma <= self.value)

    @property
    def limit(self) -> str:
        """The upper limit in words, in deg/s with two digits."""
        return f"speed below {upper_text(np.degrees(self.below))} deg/s (95 %)"


def upper_text(value: float) -> str:
    """Return a positive number with two significant digits, rounded up, without an exponent: 0.053, 8.4, 120."""
    if not np.isfinite(value) or value <= 0:
        return f"{value:g}"
    unit = 10.0 ** (np.floor(np.log10(value)) - 1)
    # a limit rounded down would not hold; 1e-9 keeps 0.050 from becoming 0.051 by rounding errors
    return np.format_float_positional(
        np.ceil(value / unit - 1e-9) * unit, precision=2, fractional=False, trim="-"
    )


class Answers(NamedTuple):
    """The three answers for one pass or posterior, and whether the search left nothing out; `constrained` (3) by component, `wrong`
    the sensors that do not agree with the motion, `cure` what may have been left out and what would help, `speed` that of the
    motion, if it was judged."""

    unique: bool
    constrained: tuple[bool, bool, bool]
    fits: bool
    search_complete: bool
    wrong: tuple[str, ...] = ()
    cure: str = ""
    speed: Speed | None = None

    @property
    def speed_constrained(self) -> bool:
        """Whether the error of the speed is not larger than the speed."""
        return self.speed is None or self.speed.constrained

    @property
    def decided(self) -> bool:
        """Whether an operator may act on the motion."""
        constrained = all(self.constrained) and self.speed_constrained
        return self.unique and self.fits and constrained and self.search_complete

    @property
    def why_not(self) -> str:
        """What keeps the motion from being decided, in words; empty where it is."""
        known = [axis for axis, told in zip("xyz", self.constrained, strict=True) if told]
        reasons = []
        if not self.fits:
            reasons.append("POOR FIT" + (f" ({', '.join(self.wrong)})" if self.wrong else ""))
        if not self.unique:
            reasons.append("several solutions")
        if len(known) < 3:
            reasons.append(
                f"constrained: {' '.join(known)} only"
                if known
                else "NOT CONSTRAINED (result equals the prior)"
            )
        # an upper limit needs a model that fits, and data that say more than the prior
        elif self.speed and not self.speed.constrained and self.fits:
            reasons.append(self.speed.limit)
        if not self.search_complete:
            reasons.append("search incomplete" + (f" ({self.cure})" if self.cure else ""))
        return "; ".join(reasons)


def answers(
    unique: bool,
    sigma: np.ndarray,
    prior_sigma: float,
    misfits: Mapping[str, Misfit],
    explained: bool,
    search_complete: bool,
    cure: str = "",
) -> Answers:
    """The answers for one motion.

    `sigma` (3), standard deviation of each component over all solutions, and `prior_sigma`, that before anything was measured, in
    one unit; `misfits` by sensor; `explained`: the misfit of all readings together is as of a motion of this kind.
    """
    wrong = tuple(name for name, one in misfits.items() if not one.fits)
    x, y, z = (
        bool(one < NARROWER * prior_sigma) for one in np.asarray(sigma)
    )  # NaN is not constrained
    return Answers(
        bool(unique), (x, y, z), bool(explained and not wrong), bool(search_complete), wrong, cure
    )


def in_sigma(square: np.ndarray, freedom: np.ndarray | int) -> np.ndarray:
    """Sums of squared residuals (...) with so many degrees of freedom, scaled so that 3 has the chance of three sigma."""
    return 3 * np.sqrt(np.maximum(square, 0.0) / chdtri(np.maximum(freedom, 1), BEYOND))


def misfit(sigmas: np.ndarray) -> Misfit:
    """Of one sensor's residuals (n) in the order of time, in sigmas (`in_sigma`); NaN where it read nothing."""
    beyond = np.asarray(sigmas)[np.isfinite(sigmas)] > 3.0
    n, bad = len(beyond), int(beyond.sum())
    good = n - bad
    if not bad or not good:
        return Misfit(n, bad / max(n, 1), 1.0)
    runs = 1 + int(np.count_nonzero(beyond[1:] != beyond[:-1]))  # Wald and Wolfowitz
    expected = 1 + 2 * bad * good / n
    variance = (expected - 1) * (expected - 2) / max(n - 1, 1)
    chance = ndtr((runs - expected) / np.sqrt(variance)) if variance > 0 else 1.0
    return Misfit(n, bad / n, float(chance))


def alike_motions(vehicle: Vehicle) -> str:
    """Which motions panels on shared inputs cannot tell apart, for the verdict; empty where they tell all."""
    count = len(vehicle.response_in().symmetries)
    if count == 1:
        return ""
    shared = [one.name for one in vehicle.inputs if len(one.panels) > 1]
    which = f"{'inputs' if len(shared) > 1 else 'input'} {', '.join(shared)}"
    copies = "a mirror solution" if count == 2 else f"{count - 1} symmetric solutions"
    return (
        f"{which} do not show which panel is lit, so each solution has {copies} with some signs reversed. A gyro, magnetometer or "
        "Sun sensor resolves this; inertia or wheels sometimes do"
    )
