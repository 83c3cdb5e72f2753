"""A wall: what stands beside a panel and keeps the Sun from it wherever the Sun stands beyond."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from sunspin.vehicle.part import FloatArray, Name, Number, Part, must, part, unit


@part
class Wall(Part):
    """Gain times cosine, but none of it on `panel` where the cosine of the angle from `toward_B` to the Sun is above `above`."""

    panel: Name
    toward_B: Annotated[FloatArray, unit("panel_response.wall.toward_B")]
    above: Annotated[
        Number, must(lambda cosine: -1 <= cosine <= 1, "{path} must be a cosine, between -1 and 1")
    ]

    @property
    def panels(self) -> tuple[str, ...]:
        return (self.panel,)

    def share(
        self, names: tuple[str, ...], sun_B: np.ndarray, normals_B: np.ndarray, cosine: np.ndarray
    ) -> np.ndarray:
        hidden = (sun_B @ self.toward_B > self.above)[..., None] & (np.array(names) == self.panel)
        return np.where(hidden, 0.0, np.maximum(cosine, 0.0))
