"""A torque that is constant over a pass, in body axes (a leak, a thruster, a wheel that brakes) or in those of N (a drag, gravity).

A torque that changes the rate by dw over the time T turns the body by dw T / 2: that angle, and not the acceleration, says how
much the data see of it. Its size is not known even to a power of ten.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self

import numpy as np
from scipy.linalg import expm

from sunspin.estimate.terms.term import MotionTerm, Seen, Unknown
from sunspin.solve.rotations import cross_matrix

WORDS = {"B": "body axes", "N": "axes fixed in space"}

TURNED = np.radians(np.geomspace(1.0, 300.0, 6))
"""rad by which a constant torque may turn the body over a pass: each as likely as any other."""


def sizes(duration_s: float, turned: np.ndarray = TURNED) -> np.ndarray:
    """Accelerations (rad/s2) that turn a body by so much over a time."""
    return 2 * turned / duration_s**2


@dataclass(frozen=True)
class SteadyTorque(MotionTerm):
    """`sigma` (rad/s2) of each component, over the mean moment of inertia, in the axes of `frame`; `inertia` (3, 3), of the body in
    units of that moment."""

    name: ClassVar[str] = "steady torque"
    called: ClassVar[str] = "steady torque"

    sigma: float
    frame: Literal["B", "N"]
    inertia: np.ndarray

    def sized(self, share: float) -> Self:
        """The same with `share` of its sigma."""
        return replace(self, sigma=share * self.sigma)

    def unknowns(self) -> tuple[Unknown, ...]:
        return tuple(
            Unknown(f"steady_{axis}", "steady_torque", "rad/s2", 0.0, self.sigma, i)
            for i, axis in enumerate("xyz")
        )

    def pushes(self, seen: Seen, dt: np.ndarray) -> np.ndarray:
        """By the equations of motion, linear in turn and rate, at the mean rate of each interval."""
        omega = (seen.omega[:, :-1] + seen.omega[:, 1:]) / 2
        change = np.zeros((*omega.shape[:2], 9, 9))
        change[..., :3, :3] = change[..., 6:, 6:] = -cross_matrix(omega)
        change[..., :3, 3:6] = np.eye(3)
        inverse = np.linalg.inv(self.inertia)
        change[..., 3:6, 3:6] = inverse @ (
            cross_matrix(omega @ self.inertia) - cross_matrix(omega) @ self.inertia
        )
        change[..., 3:6, 6:] = inverse
        if self.frame == "B":
            change[..., 6:, 6:] = 0.0
        made = expm(change * dt[:, None, None])[..., :6, 6:] * self.sigma
        return made if self.frame == "B" else made @ seen.attitude[:, :-1]
