"""The EMD of histograms compared with eq. 13 on a fine grid, and by hand."""

import numpy as np
import pytest

from sunspin.estimate.scan.histogram import BINS, distances_to_target, target_segments

Z = (np.arange(400_000) + 0.5) / 200_000 - 1


def area(hist, target, weights) -> float:
    """Half the integral of |C_r - C_n| over [-1, 1], by the midpoint rule."""
    ours = np.interp(
        Z, np.linspace(-1, 1, BINS + 1), np.concatenate([[0.0], np.cumsum(hist)]) / hist.sum()
    )
    order = np.argsort(target)
    steps = np.concatenate([[0.0], np.cumsum(weights[order])]) / weights.sum()
    return float(np.abs(ours - steps[np.searchsorted(target[order], Z, side="right")]).mean())


@pytest.mark.parametrize("seed", range(3))
def test_histogram_emd_is_half_the_area_between_the_distributions(seed):
    rng = np.random.default_rng(seed)
    hist = rng.exponential(1.0, (6, BINS)) * (rng.random((6, BINS)) < rng.uniform(0.02, 1, (6, 1)))
    hist[:, : rng.integers(1, 40)] = 0.0  # both distributions are zero there
    hist = np.append(hist, np.zeros((1, BINS)), axis=0)
    target, weights = rng.uniform(-0.8, 1, 17), rng.uniform(0, 1, 17)
    target[:3] = target[3]
    emd = distances_to_target(hist.astype(np.float32), target_segments(target, weights))
    expected = [area(row, target, weights) for row in hist[:-1]]
    np.testing.assert_allclose(emd[:-1], expected, rtol=0, atol=2e-6)
    assert emd[-1] == 1  # nothing was seen
