"""What a torque from outside is, and what a motion under a list of them carries besides: directions in space, and parameters.

A torque's equation is written once, in its `__call__`: the reference integrator, the ensemble's kernel and the step of `rates`
trace or call that text. The state behind H, h and the Sun's direction are, for each direction that the torques need, its three
components and its turning rate in space, in body axes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from sunspin.base.errors import MotionError
from sunspin.dynamics import gyrostat as g
from sunspin.dynamics.bodies import Bodies
from sunspin.environment import Environment, Surroundings

SUN_TOLERANCE = 2e-3
"""rad; a direction to the Sun and an attitude, both printed to three or four digits, agree."""

PER_DIRECTION = 6
"""Numbers carried for a direction: its components and its turning rate's."""

OWN = "own torque"
"""A vector that stands in space and that no environment gives: each body's own steady torque (N m)."""


class Torque(Protocol):
    """A torque from outside. It is compared and hashed by content, since a kernel is compiled for each list of them."""

    @property
    def name(self) -> str:
        """As it is asked for and refused by."""
        ...

    @property
    def needs(self) -> tuple[str, ...]:
        """Directions beside the Sun's, by what they are called in :class:`sunspin.environment.Surroundings`: "nadir"."""
        ...

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the numbers that its equation takes."""
        ...

    def __hash__(self) -> int: ...

    def __call__(
        self,
        omega_B: g.Vector,
        directions_B: Mapping[str, g.Vector],
        t_s: Any,
        parameters: g.Vector,
    ) -> g.Vector:
        """The torque (N m, B) by + - * on scalars: numbers, arrays, expressions of heyoka or symbols of SymPy."""
        ...

    def values(self, bodies: Bodies, here: Surroundings | None) -> np.ndarray:
        """The parameters (..., n) of bodies (...) in the surroundings at the start of the motion."""
        ...

    def largest(self, values: np.ndarray) -> np.ndarray:
        """A bound (...) on the torque (N m) with parameters (..., n): what steps are chosen by."""
        ...


def needed(torques: Sequence[Torque]) -> tuple[str, ...]:
    """The vectors that are carried for torques, each once."""
    return tuple(dict.fromkeys(name for torque in torques for name in torque.needs))


def needed_around(torques: Sequence[Torque]) -> tuple[str, ...]:
    """The directions that torques need of the environment, each once."""
    return tuple(name for name in needed(torques) if name != OWN)


def spun(torques: Sequence[Torque]) -> bool:
    """Whether an ensemble's kernel may turn the Sun's direction about a vector in space, as it does about H without torques: the
    momentum at the start, carried in the place of the turning rate of the only other vector, `OWN`, which stands."""
    return needed(torques) == (OWN,)


def n_carried(torques: Sequence[Torque]) -> int:
    return PER_DIRECTION * len(needed(torques))


def n_parameters(torques: Sequence[Torque]) -> int:
    return sum(len(torque.parameters) for torque in torques)


def carried_names(torques: Sequence[Torque]) -> list[str]:
    """Names of the numbers carried, as variables."""
    return [
        f"{kind}{i}{axis}"
        for i in range(len(needed(torques)))
        for kind in ("d", "e")
        for axis in "xyz"
    ]


def directions_of(torques: Sequence[Torque], state: g.Vector) -> dict[str, g.Direction]:
    """The Sun's direction, and those that torques need, from their part of the state (3 + n_carried, ...)."""
    directions = {"sun": g.Direction(state[:3])}
    for i, name in enumerate(needed(torques)):
        at = 3 + PER_DIRECTION * i
        directions[name] = g.Direction(state[at : at + 3], state[at + 3 : at + 6])
    return directions


def outside(torques: Sequence[Torque], values: g.Vector) -> tuple[g.OutsideTorque, ...]:
    """The torques with their parameters, given one after the other."""
    acting, at = [], 0
    for torque in torques:
        acting.append(g.OutsideTorque(torque, values[at : at + len(torque.parameters)]))
        at += len(torque.parameters)
    return tuple(acting)


@dataclass(frozen=True)
class Acting:
    """The torques that act in a motion, its environment, and when it begins, in s on the environment's clock."""

    torques: tuple[Torque, ...] = ()
    environment: Environment | None = None
    start_s: float = 0.0

    def here(self, t_s: Any = None) -> Surroundings | None:
        """The surroundings at the start, or at times."""
        return (
            None
            if self.environment is None
            else self.environment.at(self.start_s if t_s is None else t_s)
        )

    def values(self, bodies: Bodies) -> np.ndarray:
        """All parameters (..., n) of bodies (...), one torque's after the other's."""
        if not self.torques:
            return np.zeros((*bodies.inertia_kg_m2.shape[:-2], 0))
        here = self.here()
        return np.concatenate([torque.values(bodies, here) for torque in self.torques], axis=-1)

    def largest(self, values: np.ndarray) -> np.ndarray:
        """A bound (...) on all torques together (N m)."""
        parts = np.split(
            values, np.cumsum([len(torque.parameters) for torque in self.torques])[:-1], axis=-1
        )
        bounds = [torque.largest(part) for torque, part in zip(self.torques, parts, strict=False)]
        return np.sum(bounds, axis=0) if bounds else np.zeros(values.shape[:-1])

    def torque_B(self, bodies: Bodies) -> np.ndarray:
        """Return the torque (..., 3) in N m that is constant in the axes of bodies (...)."""
        parts = [
            torque.values(bodies, None)
            for torque in self.torques
            if torque.parameters == ("x", "y", "z")
        ]
        return np.sum(parts, axis=0) if parts else np.zeros((*bodies.shape, 3))

    def gradient_strength(self) -> float:
        """Return 3 n^2 (1/s2) of the gravity gradient, n being the rate at which the nadir turns; 0 if it does not act."""
        turn = getattr(self.here(), "nadir_turn_N", None)
        if "nadir" not in needed(self.torques) or turn is None:
            return 0.0
        return float(3 * (turn[0] ** 2).sum())

    def nadir_B(self, B_from_N: np.ndarray, t_s: npt.ArrayLike) -> np.ndarray:
        """Return the nadir and the rate at which it turns in space (n, 6), body axes, of attitudes (n, 3, 3) at times (n)."""
        here = self.here(t_s)
        nadir, turn = getattr(here, "nadir_N", None), getattr(here, "nadir_turn_N", None)
        if nadir is None or turn is None:
            raise MotionError("the environment does not know the nadir and its rate")
        parts = [
            np.einsum("nij,nj->ni", B_from_N, np.broadcast_to(x, (len(B_from_N), 3)))
            for x in (nadir, turn)
        ]
        return np.concatenate(parts, axis=1)

    def attitude(self, B_from_N: npt.ArrayLike | None, sun_B: np.ndarray) -> np.ndarray:
        """The attitude (4) at the start, that of N unless given; `MotionError` if it does not show the Sun at `sun_B` (3)."""
        here = self.here()
        if here is None:
            if B_from_N is not None:
                do = "give the environment, or leave it out"
                raise MotionError("B_from_N is the attitude in an environment", do=do)
            return np.array([0.0, 0.0, 0.0, 1.0])
        attitude = (
            np.array([0.0, 0.0, 0.0, 1.0])
            if B_from_N is None
            else np.asarray(B_from_N, dtype=np.float64)
        )
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

    def own(self, bodies: Bodies) -> np.ndarray:
        """The vector `OWN` (..., 3) of bodies (...) at the start, in N m; zero where no torque needs it."""
        vectors = [own(bodies) for torque in self.torques if (own := getattr(torque, "own", None))]
        return np.sum(vectors, axis=0) if vectors else np.zeros((*bodies.shape, 3))

    def carried(
        self, B_from_N: np.ndarray, t_s: Any = None, own: npt.ArrayLike = (0.0, 0.0, 0.0)
    ) -> np.ndarray:
        """What is carried of the directions (..., n_carried), from attitudes (..., 3, 3) at the start or at times (n), and of `own`
        (..., 3) as :meth:`own` gives it."""
        here, parts = self.here(t_s), [np.zeros((*B_from_N.shape[:-2], 0))]
        for name in needed(self.torques):
            if name == OWN:
                parts += [np.broadcast_to(x, (*B_from_N.shape[:-2], 3)) for x in (own, np.zeros(3))]
                continue
            vector = getattr(here, f"{name}_N")
            turn = getattr(here, f"{name}_turn_N", None)
            parts += [
                np.einsum("...ij,...j->...i", B_from_N, x)
                for x in (vector, np.zeros((1, 3)) if turn is None else turn)
            ]
        return np.concatenate(parts, axis=-1)


NOTHING = Acting()
"""No torque acts."""
