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
from sunspin.solve.rotations import cross_matrix

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
        """To first order, by the attitude averaged over each interval at its first rate: of a body that turns several times between
        two samples only the field along the axis is left, and the torque along the axis averages out."""
        span, even, early = dt[:, None, None], *_averages(seen, dt)
        if self.field_N is None:
            # products m_j b_l of a variance of one give m x A b one of six
            size, each = self.sigma / np.sqrt(6), (_pull(early), _pull(even))
        else:
            first, last = self.field_N[:-1], self.field_N[1:]
            fields = (early, (2 * first + last) / 3), (even, (first + last) / 2)
            # e_j x b is what the matrix of -b x does to e_j; a dipole and a direction at random: m x b has a variance of two
            size, each = (
                self.sigma / np.sqrt(2),
                [-cross_matrix(np.einsum("knij,nj->kni", *pair)) for pair in fields],
            )
        return size * np.concatenate([span**2 / 2 * each[0], span * each[1]], axis=2)


def _averages(seen: Seen, dt: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Attitudes (K, n - 1, 3, 3) averaged over each interval of a body that keeps its first rate: evenly, and with a weight that
    falls evenly to zero at the end. The average of exp(-[v]x u), v being the turn, over u from 0 to 1 is closed."""
    angle = seen.omega[:, :-1] * dt[:, None]
    x = np.linalg.norm(angle, axis=-1)[..., None, None]
    axis = angle[..., None, :] / np.maximum(x, 1e-300)
    across, along = cross_matrix(axis[..., 0, :]), np.swapaxes(axis, -1, -2) @ axis
    whole, half = np.sinc(x / np.pi), np.sinc(x / (2 * np.pi)) ** 2
    averages = (whole, x / 2 * half), (half, 2 * (1 - whole) / np.maximum(x, 1e-300))
    even, early = (
        (cosine * np.eye(3) + (1 - cosine) * along - sine * across) @ seen.attitude[:, :-1]
        for cosine, sine in averages
    )
    return even, early


def _pull(attitude: np.ndarray) -> np.ndarray:
    """e_j x A e_l (..., 3, 9) for all j and l."""
    return np.einsum("jim,...ml->...ijl", cross_matrix(np.eye(3)), attitude).reshape(
        *attitude.shape[:-1], 9
    )
