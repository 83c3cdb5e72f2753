"""One reading of a sensor at its own time, as the posterior weighs it: what it would read of a motion, and how that changes.

Each kind stands in its sensor's file; :mod:`sunspin.estimate.terms.readings` lists them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np

from sunspin.base.errors import InputError

LOG_2PI = float(np.log(2 * np.pi))


@dataclass(frozen=True)
class Reading:
    """Seen at `t_s` (s): numbers `value` (m), Gaussian with one sigma each; `kind`: what a person calls it. Directions of the Sun
    and rates (rad/s) that it is compared with are (n, 3), in B."""

    numbers: ClassVar[int] = 3
    """How many numbers it is given with."""
    keys: ClassVar[tuple[str, ...]] = ("kind", "t_s", "value", "sigma")
    """What a person has to say of it."""

    t_s: float
    value: np.ndarray
    sigma: float
    kind: str = field(
        default="", init=False
    )  # a field, so that it is part of the identity of a run's rows

    @classmethod
    def of(cls, given: Mapping[str, Any], value: np.ndarray, t_s: float) -> Self:
        """The reading of checked numbers `value`, at `t_s`, that a person gave so."""
        return cls(t_s, value, float(given["sigma"]))

    @classmethod
    def checked(cls, given: Mapping[str, Any]) -> np.ndarray:
        """The numbers (`numbers`) of what a person gave, finite, its sigma positive."""
        value, sigma = (
            np.atleast_1d(np.asarray(given["value"], dtype=np.float64)),
            float(given["sigma"]),
        )
        if (
            value.shape != (cls.numbers,)
            or not np.all(np.isfinite(value))
            or not (np.isfinite(sigma) and sigma > 0)
        ):
            raise InputError(
                f"a {cls.kind} is {cls.numbers} finite numbers with a positive sigma",
                got=str(dict(given)),
            )
        return value

    def predicted(self, sun_B: np.ndarray, omega_B: np.ndarray) -> np.ndarray:
        """What it would read (n, m)."""
        raise NotImplementedError("every reading says what it would read")

    def slope(
        self, sun_B: np.ndarray, omega_B: np.ndarray, to_sun: np.ndarray, to_omega: np.ndarray
    ) -> np.ndarray:
        """How that changes (n, m) where direction and rate change so."""
        raise NotImplementedError("every reading says how it changes")

    def residual(self, sun_B: np.ndarray, omega_B: np.ndarray) -> np.ndarray:
        """Read less predicted (n, m), in sigmas."""
        return (self.value - self.predicted(sun_B, omega_B)) / self.sigma

    def log_density(self, sun_B: np.ndarray, omega_B: np.ndarray) -> np.ndarray:
        """Log density (n)."""
        return np.sum(
            -0.5 * self.residual(sun_B, omega_B) ** 2 - np.log(self.sigma) - 0.5 * LOG_2PI, axis=1
        )
