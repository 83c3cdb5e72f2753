"""How fast the body turns, whatever about: a period seen in a radio signal or a light curve."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from sunspin.estimate.terms.reading import Reading


@dataclass(frozen=True)
class AngularSpeed(Reading):
    """rad/s."""

    kind: str = field(default="rate", init=False)
    numbers: ClassVar[int] = 1

    def predicted(self, sun_B: np.ndarray, omega_B: np.ndarray) -> np.ndarray:
        return np.linalg.norm(omega_B, axis=1)[:, None]

    def slope(
        self, sun_B: np.ndarray, omega_B: np.ndarray, to_sun: np.ndarray, to_omega: np.ndarray
    ) -> np.ndarray:
        size = np.maximum(np.linalg.norm(omega_B, axis=1, keepdims=True), 1e-12)
        return np.sum(omega_B * to_omega, axis=1, keepdims=True) / size
