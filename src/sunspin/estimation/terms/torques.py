"""Torques as terms: what an unknown torque adds to turn and rate over the intervals between samples, to first order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from sunspin.estimation.model import Seen, Unknown
from sunspin.estimation.terms.term import Term
from sunspin.solve.rotations import cross_matrix

Frame = Literal["B", "N"]

WORDS: dict[Frame, str] = {"B": "body axes", "N": "axes fixed in space"}
"""In which axes a torque is constant, in words."""

SERIES = 12
"""Terms of the exponential series of matrices of norm a half, whose remainder is 1e-14."""


@dataclass(frozen=True)
class ConstantTorque(Term):
    """A torque that is constant over a pass, in the body (a leak, a thruster) or in space (drag, gravity).

    A torque that changes the rate by dw over the time T turns the body by dw T / 2: that angle, and not the acceleration, says how
    much the data see of it. `sigma` (rad/s2): that of the largest of the `shares`; `inertia` (3, 3) and `momentum` (n, 3) as in a
    model.
    """

    name: ClassVar[str] = "constant_torque"
    label: ClassVar[str] = "constant torque"
    per_sample: ClassVar[tuple[str, ...]] = ("momentum",)

    frame: Frame
    sigma: float
    shares: tuple[float, ...]
    inertia: np.ndarray
    momentum: np.ndarray

    @classmethod
    def turning(
        cls,
        frame: Frame,
        turns_rad: Sequence[float],
        duration_s: float,
        inertia: np.ndarray,
        momentum: np.ndarray,
    ) -> ConstantTorque:
        """Return a torque that turns the body by one of these angles (one sigma each, equally likely) in the duration of a pass."""
        largest = max(turns_rad)
        shares = tuple(turn / largest for turn in sorted(turns_rad, reverse=True))
        return cls(frame, 2 * largest / duration_s**2, shares, inertia, momentum)

    def unknowns(self) -> tuple[Unknown, ...]:
        """Return the three components, as angular accelerations of a body with the mean moment."""
        return tuple(
            Unknown(
                f"steady_{axis}", "steady_torque", "rad/s2", 0.0, self.sigma, i, shares=self.shares
            )
            for i, axis in enumerate("xyz")
        )

    def pushes(self, seen: Seen, dt: np.ndarray) -> np.ndarray:
        """Return turn and rate (K, n - 1, 6, 3) that one sigma of each component adds over the intervals dt (n - 1).

        The equations are linear in turn t, rate r and torque T (docs/model.md), with the mean rate w of the interval:
        dt/ds = -w x t + r, I dr/ds = (I w + h) x r - w x (I r) + T; in space T is a vector of the body that turns: dT/ds = -w x T.
        """
        omega = (seen.omega[:, :-1] + seen.omega[:, 1:]) / 2
        turning = cross_matrix(omega)
        inverse = np.linalg.inv(self.inertia)
        momentum = omega @ self.inertia + (self.momentum[:-1] + self.momentum[1:]) / 2
        change = np.zeros((*omega.shape[:2], 9, 9))
        change[..., :3, :3] = -turning
        change[..., :3, 3:6] = np.eye(3)
        change[..., 3:6, 3:6] = inverse @ (cross_matrix(momentum) - turning @ self.inertia)
        change[..., 3:6, 6:] = inverse
        if self.frame == "N":
            change[..., 6:, 6:] = -turning
        push = self.sigma * exponential(change * dt[:, None, None])[..., :6, 6:]
        return push if self.frame == "B" else push @ seen.attitude[:, :-1]


def exponential(matrix: np.ndarray) -> np.ndarray:
    """Return the exponentials of matrices (..., d, d): the series of a small part, squared again and again."""
    largest = float(np.abs(matrix).sum(axis=-1).max(initial=0.0))
    halvings = max(0, int(np.ceil(np.log2(max(largest, 1e-300)))) + 1)
    small, eye = matrix / 2.0**halvings, np.eye(matrix.shape[-1])
    result = eye + small / SERIES
    for k in range(SERIES - 1, 0, -1):  # Horner's scheme
        result = eye + small @ result / k
    for _ in range(halvings):
        result = result @ result
    return result
