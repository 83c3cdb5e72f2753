"""What moves a body neither evenly nor at all times alike: steps of its rate, and a swinging too quick for the samples.

Both are noise of the motion between two samples and bring no unknowns: a step is an interval in which white angular acceleration is
much stronger, a swinging a rate that differs at every instant, so that the attitude wanders.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from sunspin.estimate.terms.term import MotionTerm

SLOWEST, QUICKEST = 2.0, 30.0
"""A swinging that the samples do not resolve forgets itself in an interval over the first number, at most, and nothing says that it
does not so in one over the second: its time is log-uniform between."""


@dataclass(frozen=True)
class RateStep(MotionTerm):
    """The rate changes by `sigma` (rad/s) between the samples (n) that are `before` it and the next."""

    name: ClassVar[str] = "rate step"
    called: ClassVar[str] = "step of the rate"
    per_sample: ClassVar[tuple[str, ...]] = ("before",)

    sigma: float
    before: np.ndarray

    def at(self, index: int) -> Self:
        """The same after the sample `index`."""
        return replace(self, before=np.arange(len(self.before)) == index)

    def acceleration_noise(self, dt: np.ndarray) -> np.ndarray:
        return self.before[:-1] * self.sigma / np.sqrt(dt)


@dataclass(frozen=True)
class Swinging(MotionTerm):
    """The rate swings about its mean, so that the attitude wanders by `noise` (rad s^-0.5)."""

    name: ClassVar[str] = "swinging"
    called: ClassVar[str] = "swinging"

    noise: float

    def rate_noise(self) -> float:
        return self.noise

    def hidden_variance(self, dt: np.ndarray) -> float:
        """Of a rate's component (rad2/s2) at an instant: noise^2 over twice the time in which it forgets itself."""
        usual = float(np.median(dt))
        return self.noise**2 / (2 * usual) * (QUICKEST - SLOWEST) / np.log(QUICKEST / SLOWEST)
