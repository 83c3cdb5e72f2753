"""A magnetic torque, an unknown of a pass of :mod:`sunspin.estimate.rates`: a dipole fixed in the body, in a field fixed in N.

A CubeSat's residual dipole accelerates it by 1e-6 to 1e-4 rad/s2, the same way for minutes, where white angular acceleration of the
same size averages out. With dipole m and field b both unknown, m x A b is linear in the nine products of their components.
"""

from __future__ import annotations

import numpy as np

from sunspin.estimate.rates.state import Motion, Track
from sunspin.solve.rotations import turn

UNKNOWNS = 9

SHARE = 0.3
"""s^-0.5; the torque's prior sigma (rad/s2) for each rad/s^1.5 of white angular acceleration: the two make a rate wander alike in
ten seconds."""

MOST = 1e-4
"""rad/s2; no prior is wider: 0.005 A m2 on a 1U CubeSat, and more white noise than goes with it stands for something else."""


def prior_sigma(noise: float) -> float:
    """Sigma (rad/s2) that goes with a white angular acceleration (rad/s^1.5)."""
    return min(SHARE * noise, MOST)


def count(motion: Motion) -> int:
    """How many unknowns there are."""
    return UNKNOWNS if motion.torque > 0 else 0


def gained(track: Track, motion: Motion, dt: np.ndarray) -> np.ndarray:
    """What one sigma of each of the unknowns adds to turn and rate over each interval `dt` (n - 1), (K, n - 1, 6, 9).

    By Simpson's rule on the attitude at the ends and, carried by the rate, in the middle: to first order, and where the body turns
    far between two samples hardly right, but there a torque averages out.
    """
    start = track.attitude[:, :-1]
    middle = turn(start, track.omega[:, :-1] * dt[:, None] / 2)
    pull = [_pull(attitude) * motion.torque / np.sqrt(6) for attitude in (start, middle, track.attitude[:, 1:])]
    span = dt[:, None, None]
    return np.concatenate([span**2 / 6 * (pull[0] + 2 * pull[1]), span / 6 * (pull[0] + 4 * pull[1] + pull[2])], axis=2)


def _pull(attitude: np.ndarray) -> np.ndarray:
    """e_j x A e_l (..., 3, 9) for all j and l; if the products m_j b_l have a variance of one, m x A b has one of six."""
    return np.stack([np.cross(dipole, attitude[..., axis]) for dipole in np.eye(3) for axis in range(3)], axis=-1)
