"""Earth mover's distances (EMD) between many histograms of r_z and one measured distribution, the target (paper, eq. 13).

r_z is the z component of the Sun direction in body axes. CDF: cumulative distribution function.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from sunspin.base.errors import InputError
from sunspin.dynamics.processor import njit

BINS = 256
"""Number of bins of r_z over [-1, 1]. The CDF of a histogram is taken as linear inside a bin: the EMD errs by less than 1e-3."""

MAX_TARGET = 4096
"""More target values than this are replaced by this many quantiles. Measured tracks have tens of values, simulated ones 10^5."""

LANES = 32
"""Number of histograms that are computed together, so that the processor can use vector instructions."""


def target_segments(
    target_z: npt.ArrayLike, weights: npt.ArrayLike | None = None
) -> tuple[np.ndarray, ...]:
    """Return the CDF of measured r_z (n), a step function, as S segments. Each has a constant CDF and lies inside one bin.

    `weights` (n): of the values; default: equal ones.

    Returns
    -------
    bin_of, low, high, level : (S,) each
        Index of the bin, the ends of the segment from 0 to 1 across that bin, and the CDF on it; for :func:`emd_rows`.
    """
    z = np.asarray(target_z, dtype=np.float64).ravel()
    w = np.ones_like(z) if weights is None else np.asarray(weights, dtype=np.float64).ravel()
    wrong = z.size == 0 or w.shape != z.shape or not np.all(np.isfinite(z))
    if wrong or np.abs(z).max() > 1 + 1e-6:
        raise InputError(
            "target_z must be one or more values in [-1, 1], with as many weights if any"
        )
    if not (np.all(w >= 0) and w.sum() > 0):
        raise InputError("weights must not be negative and not all zero")
    order = np.argsort(z, kind="stable")
    if z.size > MAX_TARGET:
        # quantiles of equal weight: the CDF changes by less than 1 / MAX_TARGET
        levels = (np.arange(MAX_TARGET) + 0.5) / MAX_TARGET
        z = z[order][np.searchsorted(np.cumsum(w[order]) / w.sum(), levels)]
        w, order = np.ones(MAX_TARGET), np.arange(MAX_TARGET)
    # places of the values, from 0 at r_z = -1 in units of a bin; segments end there and at the edges of the bins
    position = np.clip((z[order] + 1) * BINS / 2, 0, BINS)
    knots = np.unique(np.concatenate([np.arange(BINS + 1, dtype=float), position]))
    cdf = np.concatenate([[0.0], np.cumsum(w[order])]) / w.sum()
    bin_of = np.minimum(np.floor(knots[:-1]).astype(np.int64), BINS - 1)
    level = cdf[np.searchsorted(position, knots[:-1], side="right")]
    return bin_of, knots[:-1] - bin_of, knots[1:] - bin_of, level


def distances_to_target(
    hist: np.ndarray, segments: tuple[np.ndarray, ...], workers: int = 1
) -> np.ndarray:
    """Return the EMD (n) of histograms (n, BINS) to the target with these segments (`target_segments`).

    An empty histogram has the largest EMD, 1. `workers`: number of threads, which share the histograms.
    """
    emd = np.empty(len(hist))
    if workers == 1:
        emd_rows(hist, *segments, emd)
    else:
        parts = np.array_split(hist, workers), np.array_split(emd, workers)
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(lambda part, out: emd_rows(part, *segments, out), *parts))
    return emd


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def emd_rows(hist, bin_of, low, high, level, emd):
    """Fill emd (row) with half the integral over [-1, 1] of |C_r - C_n| (paper, eq. 13) for each histogram hist (row, bin).

    C_r, the CDF of a histogram, is linear inside a bin. C_n, that of the target, is level[s] on the segment s, which lies in the
    bin bin_of[s] from the fraction low[s] to the fraction high[s] of it. An empty histogram has the EMD 1.
    """
    rows, bins = hist.shape
    width = 2.0 / bins
    # LANES rows are transposed, so that the inner loops run over rows with consecutive memory
    tile, inverse_total = np.empty((bins, LANES)), np.empty(LANES)
    for first in range(0, rows, LANES):
        total, below, area = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
        for i in range(LANES):
            j = min(first + i, rows - 1)  # the last tile repeats the last row
            for b in range(bins):
                tile[b, i] = hist[j, b]
        for b in range(bins):
            for i in range(LANES):
                total[i] += tile[b, i]
        for i in range(LANES):
            inverse_total[i] = 1.0 / total[i]
        current = 0
        for s in range(bin_of.size):
            # `below`: C_r at the lower edge of the current bin
            while current < bin_of[s]:
                for i in range(LANES):
                    below[i] += tile[current, i] * inverse_total[i]
                current += 1
            length = (high[s] - low[s]) * width
            for i in range(LANES):
                slope = tile[current, i] * inverse_total[i]
                # C_r - C_n at both ends of the segment; the area under its size is a trapezoid, or two triangles if the sign
                # changes
                left = below[i] + slope * low[s] - level[s]
                right = below[i] + slope * high[s] - level[s]
                trapezoid = 0.5 * abs(left + right)
                triangles = 0.5 * (left * left + right * right) / abs(right - left)
                area[i] += (trapezoid if left * right >= 0.0 else triangles) * length
        for i in range(min(LANES, rows - first)):
            emd[first + i] = 0.5 * area[i] if total[i] != 0.0 else 1.0
