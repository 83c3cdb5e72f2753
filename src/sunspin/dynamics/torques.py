"""Torques from outside, as numbers: steady ones in body axes and in space, and the gravity gradient.

Their equations are in :mod:`sunspin.dynamics.gyrostat`, in plain functions, and in the kernels (`kernels/flow.py`), where
another torque would be added.
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
"""rad; a direction to the Sun and an attitude, both printed to three or four digits, agree."""


@dataclass(frozen=True)
class GravityGradient:
    """3 n^2 nadir x (I nadir), eq. (23): the Earth attracts more strongly what is nearer, a body rests with its long axis to it.

    Of the first order in size over distance, on a circular orbit: n is the rate at which the nadir turns.
    """

    name: str = "gravity_gradient"


@dataclass(frozen=True)
class Steady:
    """A torque that is constant in body axes (a leak, a thruster), and one that is constant in space (drag, light pressure).

    `torque_N_m` (2, 3): both in body axes at the start, of every body; None: those that the bodies bring, each its own.
    """

    torque_N_m: npt.ArrayLike | None = field(default=None, compare=False, repr=False)
    name: str = "steady"

    def of(self, bodies: Bodies) -> np.ndarray:
        """Return both torques (..., 2, 3) on bodies (...), N m."""
        torque = bodies.steady_N_m if self.torque_N_m is None else self.torque_N_m
        return np.broadcast_to(np.asarray(torque, dtype=np.float64), (*bodies.shape, 2, 3))


TORQUES = (GravityGradient.name,)
"""What may be named as a torque."""


@dataclass(frozen=True)
class Acting:
    """The torques that act in a motion, its environment, and when it begins, in s on the environment's clock."""

    torques: tuple[GravityGradient | Steady, ...] = ()
    environment: Environment | None = None
    start_s: float = 0.0

    def here(self, t_s: Any = None) -> Surroundings | None:
        """Return the surroundings at the start, or at times; None without an environment."""
        if self.environment is None:
            return None
        return self.environment.at(self.start_s if t_s is None else t_s)

    @property
    def needs_attitude(self) -> bool:
        """Whether a torque depends on a direction other than the Sun's."""
        return any(isinstance(torque, GravityGradient) for torque in self.torques)

    def steady(self, bodies: Bodies) -> np.ndarray:
        """Return the steady torques (..., 2, 3) in body axes and in space on bodies (...), N m, body axes at the start."""
        parts = [torque.of(bodies) for torque in self.torques if isinstance(torque, Steady)]
        return np.sum(parts, axis=0) if parts else np.zeros((*bodies.shape, 2, 3))

    def gradient_strength(self) -> float:
        """Return 3 n^2 (1/s2) of the gravity gradient, n being the rate at which the nadir turns; 0 if it does not act."""
        if not self.needs_attitude:
            return 0.0
        turn = getattr(self.here(), "nadir_turn_N", None)
        if turn is None:
            raise MotionError(
                "gravity_gradient needs the rate at which the nadir turns",
                do="give it as nadir_turn_N",
            )
        return float(3 * (turn[0] ** 2).sum())

    def nadir_B(self, B_from_N: np.ndarray, t_s: npt.ArrayLike) -> np.ndarray:
        """Return the nadir and the rate (rad/s) at which it turns in space (n, 6), body axes, of attitudes (n, 3, 3) at times."""
        here = self.here(t_s)
        nadir, turn = getattr(here, "nadir_N", None), getattr(here, "nadir_turn_N", None)
        if nadir is None or turn is None:
            raise MotionError("the environment does not know the nadir and its rate")
        every = [np.broadcast_to(vector, (len(B_from_N), 3)) for vector in (nadir, turn)]
        return np.concatenate([np.einsum("nij,nj->ni", B_from_N, x) for x in every], axis=1)

    def largest(self, bodies: Bodies) -> np.ndarray:
        """Return a bound (...) on all torques that turn with the bodies (...) together, N m."""
        bound = np.linalg.norm(self.steady(bodies)[..., 0, :], axis=-1)
        if self.needs_attitude:
            moments = np.linalg.eigvalsh(bodies.inertia_kg_m2)
            bound = bound + self.gradient_strength() / 2 * (moments[..., 2] - moments[..., 0])
        return bound

    def attitude(self, B_from_N: npt.ArrayLike | None, sun_B: np.ndarray) -> np.ndarray:
        """Return the attitude (4) at the start, that of N unless given; `MotionError` if the Sun is then not at `sun_B` (3)."""
        here = self.here()
        if here is None:
            if B_from_N is not None:
                do = "give the environment, or leave it out"
                raise MotionError("B_from_N is the attitude in an environment", do=do)
            return np.array([0.0, 0.0, 0.0, 1.0])
        given = (0.0, 0.0, 0.0, 1.0) if B_from_N is None else B_from_N
        attitude = np.asarray(given, dtype=np.float64)
        if attitude.shape != (4,) or not abs(np.linalg.norm(attitude) - 1) < SUN_TOLERANCE:
            raise MotionError("B_from_N must be a unit quaternion, scalar last", got=B_from_N)
        attitude = attitude / np.linalg.norm(attitude)
        from scipy.spatial.transform import Rotation

        away = np.linalg.norm(Rotation.from_quat(attitude).apply(here.sun_N[0]) - sun_B)
        if not away < SUN_TOLERANCE:
            raise MotionError(
                "sun_B is not where B_from_N shows the environment's Sun",
                got=f"{away:.2g} rad away",
            )
        return attitude


NOTHING = Acting()
"""No torque acts."""


def acting(
    torques: Sequence[str | Steady], environment: Environment | None, t_s: float = 0.0
) -> Acting:
    """Return the torques, by name or steady ones as they are, in their environment, for a motion that begins at `t_s`.

    Raises `MotionError` for a name that is none, and for a torque that needs what the environment does not give.
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
