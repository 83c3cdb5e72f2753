"""Motions of a lander: the state at one instant, the reference, from which the equations of motion carry it to all samples.

A motion has D = 5 + m coordinates about a centre: three of the rate, two steps of the direction to the Sun along the tangents of
its centre, and the m unknowns of the model. K motions, body axes B, rad/s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import logsumexp

from sunspin.solve.rotations import move_on_sphere, tangent_basis

if TYPE_CHECKING:
    from sunspin.estimate.lander.model import LanderModel

STATE_SIZE = 5
"""Coordinates of the state at the reference, which come first: rate and direction to the Sun."""

RATE, SUN, UNKNOWNS = slice(0, 3), slice(3, STATE_SIZE), slice(STATE_SIZE, None)
"""Where rate (rad/s), direction to the Sun (rad, along two tangents) and unknowns (sigmas) stand among the coordinates."""


@dataclass(frozen=True)
class LanderMotions:
    """K motions by rates `omega` (K, 3) and directions to the Sun `sun` (K, 3) at the reference, and unknowns `u` (K, m) in sigmas.

    After a fit also `cost` (K): minus the log of the posterior density, up to a constant that all motions of a model share, and
    `curvature` (K, D, D): its second derivatives in the coordinates about each motion. In a search `starts` (K): how many starts
    came together in it, and `neighbours_s` (K): end of the window for which neighbours of it were last placed, or for which it was
    placed; 0 for none.
    """

    omega: np.ndarray
    sun: np.ndarray
    u: np.ndarray
    cost: np.ndarray = field(default_factory=lambda: np.zeros(0))
    curvature: np.ndarray = field(default_factory=lambda: np.zeros(0))
    starts: np.ndarray = field(default_factory=lambda: np.zeros(0))
    neighbours_s: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __len__(self) -> int:
        """Return the number of motions."""
        return len(self.omega)

    @property
    def bare(self) -> LanderMotions:
        """Return rates, directions and unknowns alone."""
        return LanderMotions(self.omega, self.sun, self.u)

    def take(self, which: Any) -> LanderMotions:
        """Return some of the motions."""
        arrays = (getattr(self, part.name) for part in fields(self))
        return LanderMotions(*(array[which] if len(array) else array for array in arrays))

    @staticmethod
    def joined(parts: Sequence[LanderMotions]) -> LanderMotions:
        """Return the motions of several parts, with what is known of all of them."""
        parts, joined = [part for part in parts if len(part)] or parts[:1], {}
        for name in (part.name for part in fields(LanderMotions)):
            arrays = [getattr(part, name) for part in parts]
            if all(len(array) == len(part) for array, part in zip(arrays, parts, strict=True)):
                joined[name] = np.concatenate(arrays)
        return LanderMotions(**joined)

    def moved(self, step: np.ndarray) -> LanderMotions:
        """Return the motions moved by steps (K, D) in their own coordinates, without what is known of them."""
        sun = move_on_sphere(self.sun, step[:, SUN])
        return LanderMotions(self.omega + step[:, RATE], sun, self.u + step[:, UNKNOWNS])

    def from_centre(self, centre: LanderMotions) -> np.ndarray:
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

    def with_unknowns(self, indices: np.ndarray, count: int) -> LanderMotions:
        """Return motions of a model with `count` unknowns: theirs stand at `indices` (m), the others at their centres."""
        u = np.zeros((len(self), count))
        u[:, indices] = self.u
        return LanderMotions(self.omega, self.sun, u, starts=self.starts)


@dataclass(frozen=True)
class ModelFit:
    """Motions of a lander fitted to all samples under a model, best first, and `draws` from its posterior if there are any yet.

    `log_evidence` (K): log of the integral of the posterior density around each, by Laplace's method and up to the constant of the
    model. `complete`: every motion that may fit was followed; `notes`: what the verdict has to say.
    """

    model: LanderModel
    motions: LanderMotions
    log_evidence: np.ndarray
    complete: bool = True
    notes: tuple[str, ...] = ()
    draws: Draws | None = None

    def __len__(self) -> int:
        """Return the number of motions."""
        return len(self.log_evidence)

    @property
    def drawn(self) -> Draws:
        """Return the draws of a model that was drawn."""
        assert self.draws is not None
        return self.draws

    def take(self, which: Any) -> ModelFit:
        """Return some of the motions."""
        return replace(
            self, motions=self.motions.take(which), log_evidence=self.log_evidence[which]
        )


@dataclass(frozen=True)
class Draws:
    """N weighted draws from the posterior of a lander, of one model or of several together.

    `log_weight` (N): log of the posterior density over that of the proposals. The mean weight, not the sum, is the evidence;
    `evidence` is its log. `of_model` (N): index of the model of each draw, by which its unknowns are read; `region` (N): index of
    the solution that it belongs to. `effective`: how many equal draws they are worth; `tail`: Pareto index k of the weights;
    `rounds` (r, 3): log evidence, effective share of draws and k after each round.
    """

    motions: LanderMotions
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

    @property
    def probability(self) -> np.ndarray:
        """Return the weights (N) divided by their sum."""
        return np.exp(self.log_weight - logsumexp(self.log_weight))
