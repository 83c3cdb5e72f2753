"""The angle of the Sun from a direction seen in the body, such as the magnetic field's, whose angle from the Sun is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np

from sunspin.base.errors import InputError
from sunspin.estimate.terms.reading import Reading


@dataclass(frozen=True)
class SunAngle(Reading):
    """rad, from the direction `axis_B` (3) in B."""

    kind: str = field(default="field", init=False)
    keys: ClassVar[tuple[str, ...]] = (*Reading.keys, "angle_rad")

    axis_B: np.ndarray

    @classmethod
    def of(cls, given: Mapping[str, Any], value: np.ndarray, t_s: float) -> Self:
        angle, length = float(given["angle_rad"]), float(np.linalg.norm(value))
        if not (0 <= angle <= np.pi and length > 0):
            raise InputError(
                "a field is a direction and an angle from 0 to pi (rad)", got=str(dict(given))
            )
        return cls(t_s, np.array([angle]), float(given["sigma"]), value / length)

    def predicted(self, sun_B: np.ndarray, omega_B: np.ndarray) -> np.ndarray:
        return np.arccos(np.clip(sun_B @ self.axis_B, -1.0, 1.0))[:, None]

    def slope(
        self, sun_B: np.ndarray, omega_B: np.ndarray, to_sun: np.ndarray, to_omega: np.ndarray
    ) -> np.ndarray:
        sine = np.sqrt(np.maximum(1.0 - (sun_B @ self.axis_B) ** 2, 1e-6))
        return -((to_sun @ self.axis_B) / sine)[:, None]
