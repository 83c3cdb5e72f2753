"""Losses at grazing incidence: cover glass and coating reflect more where the Sun meets a panel at a flat angle."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from sunspin.vehicle.part import Number, Part, must, part

SCHLICK = 5
"""Power of 1 - cos by which reflection grows (Schlick 1994, Computer Graphics Forum 13, 233)."""


@part
class Grazing(Part):
    """Gain times cosine times 1 - `loss` (1 - cosine)^5."""

    loss: Annotated[
        Number, must(lambda loss: 0 <= loss <= 1, "{path} must be a share between 0 and 1")
    ]

    @property
    def panels(self) -> tuple[str, ...]:
        return ()

    def share(
        self, names: tuple[str, ...], sun_B: np.ndarray, normals_B: np.ndarray, cosine: np.ndarray
    ) -> np.ndarray:
        lit = np.maximum(cosine, 0.0)
        return lit * (1 - self.loss * (1 - lit) ** SCHLICK)
