"""How far the answer of :mod:`sunspin.infer.rates` may be off: the mean rate of a pass, and what errors in common add.

The panels' gains are wrong by the same amount in every sample of a pass, and the Earth lights the same side of a turning body, so
that more samples do not help. They are "considered" and not estimated here: the answer's shift for each, times its sigma, is added
to the covariance. A gyro's zero and scale and the inertia are estimated (:mod:`sunspin.infer.rates.common`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sunspin.infer.rates.common import Common
from sunspin.infer.rates.smooth import Motion, Observations, Track, measured, normal_equations, solve


def with_spread(
    o: Observations, track: Track, motion: Motion, mean: np.ndarray, common: Common | None = None
) -> tuple[Track, np.ndarray]:
    """Modes whose covariance counts the common errors of gains and the Earth's light, and the sigma (K, 3) of their mean rates over
    the pass, which answer to turn and rate at the samples by `mean` (K, n, 3, 6). `common`: errors of gyro and clock, fitted."""
    if common is None:
        diagonal, upper, *_ = normal_equations(o, track, motion)
        seen = track

        def answer(slope: np.ndarray) -> np.ndarray:
            return solve(diagonal, upper, slope)[0]
    else:
        seen, answer = common.seen, common.shift
    variance = np.empty((len(track.omega), 3))
    for axis in range(3):
        variance[:, axis] = np.einsum("kni,kni->k", mean[..., axis, :], answer(-mean[..., axis, :]))
    covariance = track.covariance
    back = np.swapaxes(seen.attitude @ np.swapaxes(track.attitude, -1, -2), -1, -2)  # from the Sun's instant to the state's
    for slope in [*_gain_slopes(o, seen), *_earth_slopes(o, seen)]:
        slope[..., :3] = np.einsum("knij,knj->kni", back, slope[..., :3])
        shift = answer(slope)
        covariance = covariance + shift[..., :, None] * shift[..., None, :]
        variance += np.einsum("knji,kni->kj", mean, shift) ** 2
    return replace(track, covariance=covariance), np.sqrt(np.maximum(variance, 0.0))


def _gain_slopes(o: Observations, track: Track) -> list[np.ndarray]:
    """What one sigma of each common error of the panels' gains adds to the gradient (K, n, 6)."""
    if not len(o.row_errors):
        return []
    before = measured(o, track)[1]
    return [measured(replace(o, rows=o.rows + error), track)[1] - before for error in o.row_errors]


def _earth_slopes(o: Observations, track: Track) -> list[np.ndarray]:
    """What the Earth's light adds to the gradient (K, n, 6), from each end of three axes that are fixed in space.

    It may come from anywhere: the mean over the six stands for that over all directions.
    """
    if not (o.earth_light > 0 and o.power.size):
        return []
    before = measured(o, track)[1]
    found = []
    for side in np.vstack([np.eye(3), -np.eye(3)]):
        light = o.earth_light * o.scale[:, None] * np.maximum(track.attitude @ side @ o.rows.T, 0.0)
        each = [measured(replace(o, power=o.power + light[k]), track.take(np.array([k])))[1] for k in range(len(light))]
        found.append((np.concatenate(each) - before) / np.sqrt(6))
    return found
