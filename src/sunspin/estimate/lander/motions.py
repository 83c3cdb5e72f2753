"""Motions of a lander, and their fits and draws.

A motion is given by its state at one instant, the reference: the equations of motion carry it from there to all samples. Relative
to another motion, its centre, it has D = 5 + m coordinates: three of the rate, two of the direction to the Sun along two tangents
of the unit sphere at the centre, and the m unknowns of the model. Arrays hold K motions. Rates and directions are in body axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.special import logsumexp

from sunspin.solve.rotations import move_on_sphere, tangent_basis

if TYPE_CHECKING:
    from sunspin.estimate.lander.model import LanderModel

STATE_SIZE = 5
"""Coordinates of the state at the reference, which come first: rate and direction to the Sun."""

RATE, SUN, UNKNOWNS = slice(0, 3), slice(3, STATE_SIZE), slice(STATE_SIZE, None)
"""Slices of the coordinates: rate (rad/s), direction to the Sun (rad, along two tangents), and unknowns (sigmas)."""


@dataclass(frozen=True)
class LanderMotions:
    """K motions: rates `omega` (K, 3) and directions to the Sun `sun` (K, 3) at the reference, and unknowns `u` (K, m) in sigmas.

    The other arrays are empty until they are known. After a fit `cost` (K): minus the log of the posterior density, up to a
    constant that all motions of a model share, and `curvature` (K, D, D): second derivatives of the cost in the coordinates about
    each motion. In a search `starts` (K): how many starts led to it, and `neighbours_s` (K): time from the reference to the far end
    of the window for which trial motions were last placed around it, or for which it was placed itself; 0 for neither.
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
        """Return the motions with rates, directions and unknowns only."""
        return LanderMotions(self.omega, self.sun, self.u)

    def take(self, which: Any) -> LanderMotions:
        """Return the motions with the indices (or slice, or mask) `which`."""
        arrays = (getattr(self, entry.name) for entry in fields(self))
        return LanderMotions(*(array[which] if len(array) else array for array in arrays))

    @staticmethod
    def joined(parts: Sequence[LanderMotions]) -> LanderMotions:
        """Return the motions of all parts, one part after the other; arrays that one part lacks are left empty."""
        parts, joined = [part for part in parts if len(part)] or parts[:1], {}
        for name in (entry.name for entry in fields(LanderMotions)):
            arrays = [getattr(part, name) for part in parts]
            if all(len(array) == len(part) for array, part in zip(arrays, parts, strict=True)):
                joined[name] = np.concatenate(arrays)
        return LanderMotions(**joined)

    def moved(self, step: np.ndarray) -> LanderMotions:
        """Return the motions moved by steps (K, D) in the coordinates about each of them, without cost, curvature and counts."""
        sun = move_on_sphere(self.sun, step[:, SUN])
        return LanderMotions(self.omega + step[:, RATE], sun, self.u + step[:, UNKNOWNS])

    def from_centre(self, centre: LanderMotions) -> np.ndarray:
        """Return the coordinates (K, D) of the motions about K centres, or about a single one: the inverse of :meth:`moved`.

        The direction is reached along the great circle from its centre.
        """
        tangents = np.stack(tangent_basis(centre.sun), axis=1)
        tangents = np.broadcast_to(tangents, (len(self), 2, 3))
        # the components of a direction at the angle a from its centre: cos a along the centre, sin a along the tangents
        sideways = np.einsum("kai,ki->ka", tangents, self.sun)
        cosine, sine = np.sum(self.sun * centre.sun, axis=1), np.linalg.norm(sideways, axis=1)
        angle = np.arctan2(sine, cosine)
        stretch = np.divide(angle, sine, out=np.ones_like(sine), where=sine > 1e-15)
        return np.concatenate(
            [self.omega - centre.omega, sideways * stretch[:, None], self.u - centre.u], axis=1
        )

    def with_unknowns(self, indices: np.ndarray, count: int) -> LanderMotions:
        """Return the motions under a model with `count` unknowns.

        The present unknowns take the places `indices` (m), the others are at the centres of their priors.
        """
        u = np.zeros((len(self), count))
        u[:, indices] = self.u
        return LanderMotions(self.omega, self.sun, u, starts=self.starts)


class Doubt(NamedTuple):
    """A remark that leaves a verdict unsure. `left_out`: motions that may fit were left out, so that "none fits" cannot be said."""

    text: str
    left_out: bool = False


@dataclass(frozen=True)
class ModelFit:
    """K motions of a lander fitted to all samples under a model, and the `draws` from its posterior once they are made.

    `log_evidence` (K), best first: log of the integral of likelihood times prior around each motion, by Laplace's method and up to
    a constant of the readings. `doubts`: on the search.
    """

    model: LanderModel
    motions: LanderMotions
    log_evidence: np.ndarray
    doubts: tuple[Doubt, ...] = ()
    draws: Draws | None = None

    def __len__(self) -> int:
        """Return the number of motions."""
        return len(self.log_evidence)

    @property
    def drawn(self) -> Draws:
        """Return the draws; to be called only once they are made."""
        assert self.draws is not None
        return self.draws

    def take(self, which: Any) -> ModelFit:
        """Return the fit of the motions with the indices (or slice, or mask) `which`."""
        return replace(
            self, motions=self.motions.take(which), log_evidence=self.log_evidence[which]
        )


@dataclass(frozen=True)
class Draws:
    """N weighted draws from the posterior of a lander, of one model or of several together.

    `log_weight` (N): log of likelihood times prior over the density of the proposals. The mean weight, not the sum, is the
    evidence; `log_evidence` is its log. `model_index` (N): index of the model of each draw, whose unknowns are those of the motion.
    `solution` (N): index of the solution that a draw belongs to, the most probable being 0. `effective`: effective sample size;
    `pareto_k`: Pareto index of the weights; `rounds` (r, 3): log evidence, effective share of draws and Pareto index after each
    round of sampling; of several models one after the other.
    """

    motions: LanderMotions
    log_weight: np.ndarray
    model_index: np.ndarray
    solution: np.ndarray
    effective: float
    pareto_k: float
    log_evidence: float
    rounds: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))

    def __len__(self) -> int:
        """Return the number of draws."""
        return len(self.log_weight)

    @property
    def probability(self) -> np.ndarray:
        """Return the weights (N) divided by their sum."""
        return np.exp(self.log_weight - logsumexp(self.log_weight))
