"""EMD of histograms, many at once, to one target; compiled."""

from __future__ import annotations

import numpy as np

from sunspin.dynamics.processor import njit

LANES = 32
"""Rows at a time: each adds up in its own order, and the processor's vectors hold several."""


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def emd_rows(hist, bin_of, low, high, level, emd):
    """EMD of each row's histogram to a target: half the integral of |C_r - C_n| over [-1, 1] (paper, eq. 13).

    hist (n, bins) over [-1, 1]; C_r is linear inside a bin. The target's CDF is constant on segments: segment s lies in bin
    bin_of[s] from fraction low[s] to high[s] of that bin, with C_n = level[s]. Fills emd (n); a row that was never seen gets 1.
    """
    n, bins = hist.shape
    width = 2.0 / bins
    tile, share = np.empty((bins, LANES)), np.empty(LANES)
    for first in range(0, n, LANES):
        total, below, area = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
        for i in range(LANES):
            j = min(first + i, n - 1)
            for b in range(bins):
                tile[b, i] = hist[j, b]
        for b in range(bins):
            for i in range(LANES):
                total[i] += tile[b, i]
        for i in range(LANES):
            share[i] = 1.0 / total[i]
        current = 0
        for s in range(bin_of.size):
            while current < bin_of[s]:
                for i in range(LANES):
                    below[i] += tile[current, i] * share[i]
                current += 1
            length = (high[s] - low[s]) * width
            for i in range(LANES):
                slope = tile[current, i] * share[i]
                a = below[i] + slope * low[s] - level[s]
                b = below[i] + slope * high[s] - level[s]
                straight, crossing = 0.5 * abs(a + b), 0.5 * (a * a + b * b) / abs(b - a)
                area[i] += (straight if a * b >= 0.0 else crossing) * length
        for i in range(min(LANES, n - first)):
            emd[first + i] = 0.5 * area[i] if total[i] != 0.0 else 1.0
