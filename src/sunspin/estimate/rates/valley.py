"""Motions beside a fitted one that the samples so far fit nearly as well: what a search of :mod:`sunspin.estimate.rates` may lose.

A few samples of the Sun alone hardly tell the spin about the Sun's direction, so the cost has a long, flat valley. A fit rests at
one place of it. When the window of samples grows, the valley bends and breaks into several minima, and a motion that starts from
one place ends in the nearest of them: slow bodies were lost so. Here the valley is sampled, no farther apart
than a fit moves, before the window grows.
"""

from __future__ import annotations

import numpy as np

from sunspin.estimate.rates.shoot import carried
from sunspin.estimate.rates.state import Motion, Observations, Track
from sunspin.solve.rotations import rotate_attitude

BASIN_RAD = 0.35
"""A start ends in the motion that turns the body by less than this otherwise, at all samples of its window."""

REACH = 2.5
"""Sigmas along the valley; a motion farther out costs 3 more, and is reached from its own neighbours if it stays."""

MOST_EACH, MOST = 8, 16
"""Neighbours on either side of one motion, and of all. With 64 no more of 100 slow bodies were found, and dense passes took
longer."""

LEADING = 6.0
"""Motions that cost more than the best by this have no neighbours."""


def neighbours(o: Observations, track: Track, motion: Motion) -> Track:
    """Return motions along the least certain direction of the rate of each of the fitted motions (K), best first.

    They are spaced so that a fit reaches what lies between two of them (`BASIN_RAD`), out to `REACH` sigmas, and no faster than the
    search goes. None is made where the samples `o` leave no such freedom, or the fit told no covariance.

    Parameters
    ----------
    track : Track
        Motions fitted to `o`, with covariance.
    """
    if not track.covariance.size or not len(track.cost):
        return track.take(slice(0))
    middle = len(o) // 2
    covariance = np.nan_to_num(track.covariance[:, middle])
    variance, axes = np.linalg.eigh(covariance[:, 3:, 3:])
    sigma, axis = np.sqrt(np.maximum(variance[:, -1], 0.0)), axes[:, :, -1]
    # an error of the rate turns the body otherwise by that times the time to the farther end of the window
    spacing = 2 * BASIN_RAD / np.abs(o.t_s - o.t_s[middle]).max()
    on_each_side = np.clip(np.ceil(REACH * sigma / spacing - 0.5), 0, MOST_EACH).astype(int)
    on_each_side[track.cost > track.cost.min() + LEADING] = 0
    # the attitude that goes with a rate, as the covariance has it: the Sun stays where it was seen
    turn_per_rate = np.einsum("kij,kj->ki", covariance[:, :3, 3:], axis)
    turn_per_rate /= np.maximum(variance[:, -1:], np.finfo(float).tiny)
    which = np.repeat(np.arange(len(sigma)), 2 * on_each_side)[:MOST]
    steps = [np.concatenate([np.arange(1, n + 1), -np.arange(1, n + 1)]) for n in on_each_side]
    change = spacing * np.concatenate([np.zeros(0), *steps])[:MOST, None]
    omega = track.omega[which, middle] + change * axis[which]
    attitude = rotate_attitude(track.attitude[which, middle], change * turn_per_rate[which])
    slow = np.linalg.norm(omega, axis=1) < 2 * motion.rate_prior
    return carried(o, middle, attitude[slow], omega[slow], motion)
