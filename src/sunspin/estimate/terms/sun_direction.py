"""A direction of the Sun that was seen otherwise than by panels."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sunspin.estimate.terms.reading import Reading


@dataclass(frozen=True)
class SunReading(Reading):
    """One direction of the Sun in B, seen otherwise than by panels."""

    kind: str = field(default="direction", init=False)

    def predicted(self, sun_B: np.ndarray, omega_B: np.ndarray) -> np.ndarray:
        return sun_B

    def slope(
        self, sun_B: np.ndarray, omega_B: np.ndarray, to_sun: np.ndarray, to_omega: np.ndarray
    ) -> np.ndarray:
        return to_sun
