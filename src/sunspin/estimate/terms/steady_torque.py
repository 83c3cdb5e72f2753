"""A torque that is constant over a stretch: in body axes (a leak, a wheel that brakes) or in those of N (a drag, gravity).

A torque that changes the rate by dw over the time T turns the body by dw T / 2: that angle, and not the acceleration, says how
much the data see of it. Its size is not known even to a power of ten.
"""

from __future__ import annotations

import numpy as np

from sunspin.estimate.terms.term import Unknown

WORDS = {"B": "body axes", "N": "axes fixed in space"}

TURNED = np.radians(np.geomspace(1.0, 300.0, 6))
"""rad by which a constant torque may turn the body over a stretch: each as likely as any other."""


def sizes(duration_s: float, turned: np.ndarray = TURNED) -> np.ndarray:
    """Accelerations (rad/s2) that turn a body by so much over a time."""
    return 2 * turned / duration_s**2


def unknowns(sigma: float) -> tuple[Unknown, ...]:
    """The components of a steady torque over the mean moment of inertia, with this sigma (rad/s2) each."""
    return tuple(
        Unknown(f"steady_{axis}", "steady_torque", "rad/s2", 0.0, sigma, i)
        for i, axis in enumerate("xyz")
    )
