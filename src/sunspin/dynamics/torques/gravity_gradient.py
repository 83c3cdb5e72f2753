"""Gravity gradient on a circular orbit: 3 n^2 nadir x (I nadir), eq. (23)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sunspin.base.errors import MotionError
from sunspin.dynamics import gyrostat as g
from sunspin.dynamics.bodies import Bodies
from sunspin.environment import Surroundings


@dataclass(frozen=True)
class GravityGradient:
    """The Earth pulls harder at what is nearer: a body is at rest with its long axis to the nadir.

    Of the first order in size over distance, on a circular orbit: n is the rate at which the nadir turns.
    """

    name: str = "gravity_gradient"
    needs: tuple[str, ...] = ("nadir",)
    parameters: tuple[str, ...] = (
        "strength",
        "xx",
        "xy",
        "xz",
        "yy",
        "yz",
        "zz",
    )  # 3 n^2 (1/s2), inertia (kg m2)

    def __call__(
        self,
        omega_B: g.Vector,
        directions_B: Mapping[str, g.Vector],
        t_s: Any,
        parameters: g.Vector,
    ) -> g.Vector:
        nadir = directions_B["nadir"]
        return [parameters[0] * x for x in g.cross(nadir, g.symmetric_times(parameters[1:], nadir))]

    def values(self, bodies: Bodies, here: Surroundings | None) -> np.ndarray:
        turn = None if here is None else here.nadir_turn_N
        if turn is None:
            raise MotionError(
                "gravity_gradient needs the rate at which the nadir turns",
                do="give it as nadir_turn_N",
            )
        strength = 3 * (turn[0] ** 2).sum()
        elements = [
            bodies.inertia_kg_m2[..., i, j]
            for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
        ]
        return np.stack([np.full_like(elements[0], strength), *elements], axis=-1)

    def largest(self, values: np.ndarray) -> np.ndarray:
        tensor = values[..., [1, 2, 3, 2, 4, 5, 3, 5, 6]].reshape(*values.shape[:-1], 3, 3)
        moments = np.linalg.eigvalsh(tensor)
        return values[..., 0] / 2 * (moments[..., 2] - moments[..., 0])
