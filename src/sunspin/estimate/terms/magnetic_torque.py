"""A magnetic torque: a dipole fixed in the body, in a field fixed in N, both unknown.

A CubeSat's residual dipole accelerates it by 1e-6 to 1e-4 rad/s2, the same way for minutes, where white angular acceleration of the
same size averages out. With dipole m and field b both unknown, m x A b is linear in the nine products of their components; in an
orbit that is known, only the dipole's three components are unknown.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sunspin.estimate.terms.term import MotionTerm, Seen, Unknown
from sunspin.solve.rotations import cross_matrix, turn

SHARE = 0.3
"""s^-0.5; the torque's prior sigma (rad/s2) for each rad/s^1.5 of white angular acceleration: the two make a rate wander alike in
ten seconds."""

MOST = 1e-4
"""rad/s2; no prior is wider: 0.005 A m2 on a 1U CubeSat, and more white noise than goes with it stands for something else."""


@dataclass(frozen=True)
class MagneticTorque(MotionTerm):
    """`sigma` (rad/s2) of the acceleration; `field_N` (n, 3) in units of its usual size, where it is known."""

    name: ClassVar[str] = "magnetic torque"
    called: ClassVar[str] = "magnetic torque"

    sigma: float
    field_N: np.ndarray | None = None

    @classmethod
    def beside(cls, noise: float, field_N: np.ndarray | None = None) -> MagneticTorque:
        """What goes with a white angular acceleration (rad/s^1.5), in this field (n, 3)."""
        known = None if field_N is None else field_N / np.median(np.linalg.norm(field_N, axis=1))
        return cls(min(SHARE * noise, MOST), known)

    def take(self, index: np.ndarray | slice) -> MagneticTorque:
        return self if self.field_N is None else replace(self, field_N=self.field_N[index])

    def unknowns(self) -> tuple[Unknown, ...]:
        if self.field_N is not None:
            return tuple(
                Unknown(
                    f"dipole_{axis}", "magnetic_torque", "rad/s2", 0.0, self.sigma / np.sqrt(2), i
                )
                for i, axis in enumerate("xyz")
            )
        return tuple(
            Unknown(
                f"magnetic_{dipole}{axis}",
                "magnetic_torque",
                "rad/s2",
                0.0,
                self.sigma / np.sqrt(6),
                3 * i + j,
            )
            for i, dipole in enumerate("xyz")
            for j, axis in enumerate("xyz")
        )

    def pushes(self, seen: Seen, dt: np.ndarray) -> np.ndarray:
        """By Simpson's rule on the attitude at the ends and, carried by the rate, in the middle: to first order, and where the body
        turns far between two samples hardly right, but there a torque averages out."""
        start = seen.attitude[:, :-1]
        middle = turn(start, seen.omega[:, :-1] * dt[:, None] / 2)
        if self.field_N is None:
            pull = [
                _pull(attitude) * self.sigma / np.sqrt(6)
                for attitude in (start, middle, seen.attitude[:, 1:])
            ]
        else:
            first, last = self.field_N[:-1], self.field_N[1:]
            each = ((start, first), (middle, (first + last) / 2), (seen.attitude[:, 1:], last))
            # e_j x b is what the matrix of -b x does to e_j; a dipole and a direction at random: m x b has a variance of two
            pull = [
                -cross_matrix(np.einsum("knij,nj->kni", *one)) * self.sigma / np.sqrt(2)
                for one in each
            ]
        span = dt[:, None, None]
        return np.concatenate(
            [span**2 / 6 * (pull[0] + 2 * pull[1]), span / 6 * (pull[0] + 4 * pull[1] + pull[2])],
            axis=2,
        )


def _pull(attitude: np.ndarray) -> np.ndarray:
    """e_j x A e_l (..., 3, 9) for all j and l; if the products m_j b_l have a variance of one, m x A b has one of six."""
    return np.einsum("jim,...ml->...ijl", cross_matrix(np.eye(3)), attitude).reshape(
        *attitude.shape[:-1], 9
    )
