"""What may be believed of a posterior: three questions, which `rates` asks of every pass too.

Is one motion left? Do the data inform it, or is the prior given back? Does it fit, each sensor by itself? A motion is decided
if all three are answered with yes and the search left nothing out. Everything here is a pure function of what was found.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sunspin.vehicle import Vehicle

NARROWER = 0.5
"""A component is constrained if its standard deviation, all solutions counted, is below this part of the prior's."""

LEAST_DRAWS = 200.0
"""Effective draws from which a median is known to a tenth of its sigma."""


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
    """The three answers for a posterior, and whether the search left nothing out; `constrained` (3) by component, `speed` that of
    the motion, if it was judged."""

    unique: bool
    constrained: tuple[bool, bool, bool]
    fits: bool
    search_complete: bool
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
            reasons.append("POOR FIT")
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
            reasons.append("search incomplete")
        return "; ".join(reasons)


def answers(
    unique: bool, sigma: np.ndarray, prior_sigma: float, explained: bool, search_complete: bool
) -> Answers:
    """The answers for one posterior.

    `sigma` (3), standard deviation of each component over all solutions, and `prior_sigma`, that before anything was measured, in
    one unit; `explained`: the misfit of all readings together is as of a motion of this kind.
    """
    x, y, z = (
        bool(one < NARROWER * prior_sigma) for one in np.asarray(sigma)
    )  # NaN is not constrained
    return Answers(bool(unique), (x, y, z), bool(explained), bool(search_complete))


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
