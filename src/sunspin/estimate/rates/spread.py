"""How far the answer of :mod:`sunspin.estimate.rates` may be off: the mean rate of a pass, and what errors in common add.

The panels' gains are wrong by the same amount in every sample of a pass, and the Earth lights the same side of a turning body, so
that more samples do not help. Gains that the brightness of all samples has told, and the Earth's light, are "considered" and not
estimated here: the answer's shift for each, times its sigma, is added to the covariance. Gains that are not told so, a gyro's zero
and scale and the inertia are estimated (:mod:`sunspin.estimate.rates.common_errors`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sunspin.estimate.rates.common_errors import Clock, Common, places_of, sun_part
from sunspin.estimate.rates.state import Motion, Observations, Track
from sunspin.solve.linear import solve_bordered


def with_spread(
    o: Observations, motion: Motion, mean: np.ndarray, common: Common, clock: Clock | None = None
) -> tuple[Track, np.ndarray]:
    """Modes whose covariance counts the common errors of gains and the Earth's light, and the sigma (K, 3) of their mean rates
    over the pass, which answer to turn and rate at the samples by `mean` (K, n, 3, 6). `common`: them with their errors in common,
    fitted with this `clock`."""
    track, system = common.track, common.system

    def answer(slope: np.ndarray, error_slope: np.ndarray | float = 0.0) -> np.ndarray:
        downhill = error_slope + np.zeros_like(system.border_slope)
        return solve_bordered(
            system._replace(slope=slope, border_slope=downhill), np.zeros(len(slope))
        )[0][0]

    def slopes(other: Observations) -> tuple[np.ndarray, np.ndarray]:
        part = sun_part(other, places_of(other, motion, clock), track, common.error, motion, clock)
        return part.slope, part.error_slope

    variance = np.empty((len(track.omega), 3))
    for axis in range(3):
        variance[:, axis] = np.einsum("kni,kni->k", mean[..., axis, :], answer(-mean[..., axis, :]))
    covariance, before = track.covariance, slopes(o)
    for other, share in [
        (o.swapped(term, other), share)
        for term in o.terms
        for other, share in term.considered(common.seen)
    ]:
        shift = share * answer(*(new - old for new, old in zip(slopes(other), before, strict=True)))
        covariance = covariance + shift[..., :, None] * shift[..., None, :]
        variance += np.einsum("knji,kni->kj", mean, shift) ** 2
    return replace(track, covariance=covariance), np.sqrt(np.maximum(variance, 0.0))
