"""Motions of a lander: the state at one instant, the reference, from which the equations of motion carry it to all samples.

A motion has D = 5 + m coordinates about a centre: three of the rate, two steps of the direction to the Sun along the tangents of
its centre, and the m unknowns of the model. K motions, body axes B, rad/s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sunspin.solve.rotations import move_on_sphere, tangent_basis

if TYPE_CHECKING:
    from sunspin.estimate.lander.model import LanderModel

STATE_SIZE = 5
"""Coordinates of the state at the reference, which come first: rate and direction to the Sun."""

RATE, SUN, UNKNOWNS = slice(0, 3), slice(3, STATE_SIZE), slice(STATE_SIZE, None)
"""Where rate (rad/s), direction to the Sun (rad, along two tangents) and unknowns (sigmas) stand among the coordinates."""


@dataclass(frozen=True)
class Shots:
    """K motions by rates `omega` (K, 3) and directions to the Sun `sun` (K, 3) at the reference, and unknowns `u` (K, m) in sigmas.

    After a fit also `cost` (K): minus the log of the posterior density, up to a constant that all motions of a model share.
    """

    omega: np.ndarray
    sun: np.ndarray
    u: np.ndarray
    cost: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __len__(self) -> int:
        """Return the number of motions."""
        return len(self.omega)

    def take(self, which: Any) -> Shots:
        """Return some of the motions."""
        cost = self.cost[which] if len(self.cost) else self.cost
        return Shots(self.omega[which], self.sun[which], self.u[which], cost)

    @staticmethod
    def joined(parts: Sequence[Shots]) -> Shots:
        """Return the motions of several parts; with costs only if all have them."""
        omega, sun, u = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("omega", "sun", "u")
        )
        fitted = all(len(part.cost) == len(part) for part in parts)
        cost = np.concatenate([part.cost for part in parts]) if fitted else np.zeros(0)
        return Shots(omega, sun, u, cost)

    def moved(self, step: np.ndarray) -> Shots:
        """Return the motions moved by steps (K, D) in their own coordinates, without costs."""
        sun = move_on_sphere(self.sun, step[:, SUN])
        return Shots(self.omega + step[:, RATE], sun, self.u + step[:, UNKNOWNS])

    def from_centre(self, centre: Shots) -> np.ndarray:
        """Return the coordinates (K, D) of motions about a centre each, or about one; the inverse of :meth:`moved`.

        The direction is reached along the great circle from its centre.
        """
        across = np.stack(tangent_basis(centre.sun), axis=1)
        side = np.einsum("kai,ki->ka", np.broadcast_to(across, (len(self), 2, 3)), self.sun)
        along = np.sum(self.sun * centre.sun, axis=1)
        size = np.linalg.norm(side, axis=1)
        stretch = np.divide(
            np.arctan2(size, along), size, out=np.ones_like(size), where=size > 1e-15
        )
        return np.concatenate(
            [self.omega - centre.omega, side * stretch[:, None], self.u - centre.u], axis=1
        )

    def with_unknowns(self, places: np.ndarray, count: int) -> Shots:
        """Return motions of a model with `count` unknowns: theirs stand at `places` (m), the others at their centres."""
        u = np.zeros((len(self), count))
        u[:, places] = self.u
        return replace(self, u=u)


@dataclass(frozen=True)
class TrialMotions:
    """Motions on their way through a search, and what it keeps of each.

    `starts` (K): how many starts came together in it; `curvature` (K, D, D): curvature of its cost after a fit, else (0, 0, 0);
    `neighbours_s` (K): end of the window for which neighbours of it were last placed, or for which it was placed; 0 for none.
    """

    shots: Shots
    starts: np.ndarray
    curvature: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 0)))
    neighbours_s: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __len__(self) -> int:
        """Return the number of motions."""
        return len(self.shots)

    @property
    def cost(self) -> np.ndarray:
        """Return the cost (K) of each motion."""
        return self.shots.cost

    def take(self, which: Any) -> TrialMotions:
        """Return some of the motions."""
        rest = (x[which] if len(x) else x for x in (self.curvature, self.neighbours_s))
        return TrialMotions(self.shots.take(which), self.starts[which], *rest)

    @staticmethod
    def joined(parts: Sequence[TrialMotions]) -> TrialMotions:
        """Return the motions of several searches."""
        arrays = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("starts", "curvature", "neighbours_s")
        )
        return TrialMotions(Shots.joined([part.shots for part in parts]), *arrays)


@dataclass(frozen=True)
class ShotFit:
    """Motions of a lander fitted to all samples under a model, best first.

    `curvature` (K, D, D): second derivatives of the cost in the coordinates about each motion; `log_evidence` (K): log of the
    integral of the posterior density around each, by Laplace's method and up to the constant of the model; `starts` (K): how many
    starts of the search ended there. `complete`: every motion that may fit was followed; `notes`: what the verdict has to say.
    """

    model: LanderModel
    motions: Shots
    curvature: np.ndarray
    log_evidence: np.ndarray
    starts: np.ndarray
    complete: bool = True
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Return the number of motions."""
        return len(self.log_evidence)

    def take(self, which: Any) -> ShotFit:
        """Return some of the motions."""
        return replace(
            self,
            motions=self.motions.take(which),
            curvature=self.curvature[which],
            log_evidence=self.log_evidence[which],
            starts=self.starts[which],
        )


@dataclass(frozen=True)
class Draws:
    """N weighted draws from the posterior of a lander, of one model or of several together.

    `log_weight` (N): log of the posterior density over that of the proposals; `of_model` (N): index of the model of each draw, by
    which its unknowns are read; `region` (N): index of the solution that it belongs to. `effective`: how many equal draws they are
    worth; `tail`: Pareto index k of the weights; `evidence`: log of the mean weight; `rounds` (r, 3): log evidence, effective share
    of draws and k after each round.
    """

    shots: Shots
    log_weight: np.ndarray
    of_model: np.ndarray
    region: np.ndarray
    effective: float
    tail: float
    evidence: float
    rounds: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))

    def __len__(self) -> int:
        """Return the number of draws."""
        return len(self.log_weight)
