"""External torques: which ones act, and the numbers that describe them. They are steady torques and the gravity gradient.

Their equations are in :mod:`sunspin.dynamics.gyrostat` as plain functions, and in the kernels (`kernels/flow.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from sunspin.base.errors import MotionError
from sunspin.dynamics.bodies import Bodies
from sunspin.environment import Environment, Surroundings

SUN_TOLERANCE = 2e-3
"""Largest difference (rad) between the Sun of an attitude and a stated direction, both printed to three or four digits."""


@dataclass(frozen=True)
class GravityGradient:
    """The torque 3 n^2 nadir x (I nadir) of the Earth's attraction (eq. 23), which is stronger on the nearer parts of the body.

    n is the rate at which the nadir rotates in space. It holds for a circular orbit and a body far smaller than the distance.
    """

    name: str = "gravity_gradient"


@dataclass(frozen=True)
class Steady:
    """A torque that is constant in body axes (a leak, a thruster), and one that is constant in space (drag, light pressure).

    `torque_N_m` (2, 3): both, in body axes at the start, the same for all bodies; None: those of each body (`Bodies.steady_N_m`).
    """

    torque_N_m: npt.ArrayLike | None = field(default=None, compare=False, repr=False)
    name: str = "steady"

    def of(self, bodies: Bodies) -> np.ndarray:
        """Return both torques (..., 2, 3) on bodies (...), N m."""
        torque = bodies.steady_N_m if self.torque_N_m is None else self.torque_N_m
        return np.broadcast_to(np.asarray(torque, dtype=np.float64), (*bodies.shape, 2, 3))


TORQUES = (GravityGradient.name,)
"""Names of torques that the caller of a propagation may give."""


@dataclass(frozen=True)
class Acting:
    """The torques that act in a motion, its environment, and when it begins, in s on the environment's clock."""

    torques: tuple[GravityGradient | Steady, ...] = ()
    environment: Environment | None = None
    start_s: float = 0.0

    def here(self, t_s: Any = None) -> Surroundings | None:
        """Return the surroundings (Sun, nadir) at the start, or at times `t_s`; None without an environment."""
        if self.environment is None:
            return None
        return self.environment.at(self.start_s if t_s is None else t_s)

    @property
    def needs_attitude(self) -> bool:
        """Return whether a torque depends on the attitude, and not only on rate and direction to the Sun."""
        return any(isinstance(torque, GravityGradient) for torque in self.torques)

    def steady(self, bodies: Bodies) -> np.ndarray:
        """Return the sum of steady torques on bodies (...), N m: (..., 2, 3), constant in body axes and in space.

        Both are given in body axes at the start.
        """
        parts = [torque.of(bodies) for torque in self.torques if isinstance(torque, Steady)]
        return np.sum(parts, axis=0) if parts else np.zeros((*bodies.shape, 2, 3))

    def gradient_strength(self) -> float:
        """Return 3 n^2 (1/s2) of the gravity gradient, n being the rate at which the nadir rotates; 0 if it does not act."""
        if not self.needs_attitude:
            return 0.0
        nadir_rate = getattr(self.here(), "nadir_turn_N", None)
        if nadir_rate is None:
            raise MotionError(
                "gravity_gradient needs the rate at which the nadir turns",
                do="give it as nadir_turn_N",
            )
        return float(3 * (nadir_rate[0] ** 2).sum())

    def nadir_B(self, B_from_N: np.ndarray, t_s: npt.ArrayLike) -> np.ndarray:
        """Return the nadir and its rate of rotation in space, rad/s, as (n, 6), body axes, for attitudes (n, 3, 3) at times."""
        here = self.here(t_s)
        nadir, nadir_rate = getattr(here, "nadir_N", None), getattr(here, "nadir_turn_N", None)
        if nadir is None or nadir_rate is None:
            raise MotionError("the environment does not know the nadir and its rate")
        vectors_N = [np.broadcast_to(vector, (len(B_from_N), 3)) for vector in (nadir, nadir_rate)]
        return np.concatenate([np.einsum("nij,nj->ni", B_from_N, x) for x in vectors_N], axis=1)

    def attitude(self, B_from_N: npt.ArrayLike | None, sun_B: np.ndarray) -> np.ndarray:
        """Return the attitude at the start as a unit quaternion (4), scalar last; the identity unless given.

        MotionError if the environment's Sun is then not at `sun_B` (3), or if an attitude is given without an environment.
        """
        here = self.here()
        if here is None:
            if B_from_N is not None:
                do = "give the environment, or leave it out"
                raise MotionError("B_from_N is the attitude in an environment", do=do)
            return np.array([0.0, 0.0, 0.0, 1.0])
        quaternion = (0.0, 0.0, 0.0, 1.0) if B_from_N is None else B_from_N
        attitude = np.asarray(quaternion, dtype=np.float64)
        if attitude.shape != (4,) or not abs(np.linalg.norm(attitude) - 1) < SUN_TOLERANCE:
            raise MotionError("B_from_N must be a unit quaternion, scalar last", got=B_from_N)
        attitude = attitude / np.linalg.norm(attitude)
        from scipy.spatial.transform import Rotation

        off = np.linalg.norm(Rotation.from_quat(attitude).apply(here.sun_N[0]) - sun_B)
        if not off < SUN_TOLERANCE:
            raise MotionError(
                "sun_B is not where B_from_N shows the environment's Sun",
                got=f"{off:.2g} rad away",
            )
        return attitude


NOTHING = Acting()
"""No torques, and no environment."""


def acting(
    torques: Sequence[str | Steady], environment: Environment | None, t_s: float = 0.0
) -> Acting:
    """Return the torques of the public argument `torques`, with their environment, for a motion that begins at `t_s`.

    Steady torques are given as objects, others by name. MotionError for an unknown name, and for a torque that needs what the
    environment does not give.
    """
    if isinstance(torques, str):
        raise MotionError("torques must be a list", got=torques, do=f"write [{torques!r}]")
    known: list[GravityGradient | Steady] = []
    for torque in torques:
        if isinstance(torque, Steady):
            known.append(torque)
        elif isinstance(torque, str) and torque in TORQUES:
            known.append(GravityGradient())
        else:
            raise MotionError("no such torque", got=torque, do=f"choose from {', '.join(TORQUES)}")
    forces = Acting(tuple(known), environment, float(t_s))
    if forces.needs_attitude:
        here, name = forces.here(), GravityGradient.name
        if here is None:
            do = "give one, such as sunspin.environment.circular(...)"
            raise MotionError(f"the torque {name!r} needs an environment", do=do)
        if here.nadir_N is None:
            raise MotionError(
                f"the torque {name!r} needs the nadir, which the environment does not know"
            )
    return forces
