"""A gyro's reading: the body rate."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sunspin.estimate.terms.reading import Reading


@dataclass(frozen=True)
class GyroReading(Reading):
    """One body rate, rad/s."""

    kind: str = field(default="gyro", init=False)

    def predicted(self, sun_B: np.ndarray, omega_B: np.ndarray) -> np.ndarray:
        return omega_B

    def slope(
        self, sun_B: np.ndarray, omega_B: np.ndarray, to_sun: np.ndarray, to_omega: np.ndarray
    ) -> np.ndarray:
        return to_omega
