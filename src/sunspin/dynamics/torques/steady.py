"""A torque that is constant over a motion: in body axes (a leak, a thruster), in space (a drag, light pressure), or one of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from sunspin.dynamics import gyrostat as g
from sunspin.dynamics.bodies import Bodies
from sunspin.dynamics.torques.acting import OWN
from sunspin.environment import Surroundings


@dataclass(frozen=True)
class Steady:
    """The torque that stays in the body, and the one that stays in space and is carried as a direction is.

    `torque_N_m` (2, 3): both in body axes at the start, of every body; None: those that the bodies bring, each its own.
    """

    torque_N_m: npt.ArrayLike | None = field(
        default=None, compare=False, repr=False
    )  # numbers of a run, not of its equations
    name: str = "steady"
    needs: tuple[str, ...] = (OWN,)
    parameters: tuple[str, ...] = ("x", "y", "z")

    def __call__(
        self,
        omega_B: g.Vector,
        directions_B: Mapping[str, g.Vector],
        t_s: Any,
        parameters: g.Vector,
    ) -> g.Vector:
        return [parameters[k] + directions_B[OWN][k] for k in range(3)]

    def values(self, bodies: Bodies, here: Surroundings | None) -> np.ndarray:
        return self._both(bodies)[..., 0, :]

    def largest(self, values: np.ndarray) -> np.ndarray:
        return np.linalg.norm(values, axis=-1)

    def own(self, bodies: Bodies) -> np.ndarray:
        """The torque (..., 3) that stays in space, in body axes at the start."""
        return self._both(bodies)[..., 1, :]

    def _both(self, bodies: Bodies) -> np.ndarray:
        torque = (
            bodies.steady_N_m
            if self.torque_N_m is None
            else np.asarray(self.torque_N_m, dtype=np.float64)
        )
        return np.broadcast_to(torque, (*bodies.shape, 2, 3))
