"""A panel that does not stand as drawn: turned by an angle that is known with an error only."""

from __future__ import annotations

import numpy as np

from sunspin.solve.rotations import seen_turned
from sunspin.vehicle.part import Name, Part, Vector, part


@part
class Tilted(Part):
    """Gain times cosine, the normal of `panel` being turned by the rotation vector `turn_B_rad`; its sigma is in the facts."""

    panel: Name
    turn_B_rad: Vector

    @property
    def panels(self) -> tuple[str, ...]:
        return (self.panel,)

    def share(
        self, names: tuple[str, ...], sun_B: np.ndarray, normals_B: np.ndarray, cosine: np.ndarray
    ) -> np.ndarray:
        turned = seen_turned(normals_B, -self.turn_B_rad * (np.array(names) == self.panel)[:, None])
        return np.maximum(np.einsum("...i,...pi->...p", sun_B, turned), 0.0)
