"""EMD of histograms, many at once, to one target; compiled."""

from __future__ import annotations

import numpy as np

from sunspin.compute.compiler import njit


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def emd_rows(hist, bin_of, low, high, level, emd, seen):
    """EMD of each row's histogram to a target: half the integral of |C_r - C_n| over [-1, 1] (paper, eq. 13).

    hist (n, bins) over [-1, 1]; C_r is linear inside a bin. The target's CDF is constant on segments: segment s lies in bin
    bin_of[s] from fraction low[s] to high[s] of that bin, with C_n = level[s]. Fills emd (n) and seen (n), the sum of the
    row; a row that was never seen gets NaN in emd and 0 in seen.
    """
    bins = hist.shape[1]
    width = 2.0 / bins
    for j in range(hist.shape[0]):
        total = 0.0
        for b in range(bins):
            total += hist[j, b]
        seen[j] = total
        if total == 0.0:
            emd[j] = np.nan
            continue
        share = 1.0 / total
        below, current, area = 0.0, 0, 0.0
        for s in range(bin_of.size):
            while current < bin_of[s]:
                below += hist[j, current] * share
                current += 1
            slope = hist[j, current] * share
            a = below + slope * low[s] - level[s]
            b = below + slope * high[s] - level[s]
            length = (high[s] - low[s]) * width
            if a * b >= 0.0:
                area += 0.5 * abs(a + b) * length
            else:
                area += 0.5 * (a * a + b * b) / abs(b - a) * length
        emd[j] = 0.5 * area
