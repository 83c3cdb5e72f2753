"""Neighbouring passes distinguish aliases if rates change slowly, and only then."""

from dataclasses import dataclass

import numpy as np
import pytest

from sunspin.estimate.between import link_passes

TIMES = np.arange(6) * 5400.0


@dataclass(frozen=True)
class Solved:
    """What neighbours are asked of the solutions of a pass."""

    probability: np.ndarray
    mean: np.ndarray
    mean_sigma: np.ndarray


def passes(rng, wander, misled=2):
    """The true rate and an alias far from it in every pass; the pass `misled` likes its alias better."""
    rate = np.array([0.01, 0.015, 0.0]) + wander * rng.normal(size=(6, 3))
    alias = rate + 0.1 * rng.normal(size=(6, 3))
    probability = [np.array([0.3, 0.7] if k == misled else [0.9, 0.1]) for k in range(6)]
    sigma = np.full((2, 3), 1e-3)
    means = [np.stack(pair) for pair in zip(rate, alias, strict=True)]
    return [Solved(share, mean, sigma) for share, mean in zip(probability, means, strict=True)]


@pytest.mark.parametrize("misled", [0, 2, 5])
def test_a_wrong_alias_is_outweighed_by_neighbouring_passes(misled):
    linked, walk = link_passes(passes(np.random.default_rng(0), 1e-3, misled), TIMES, 0.1)
    assert linked[misled].probability[0] > 0.95 and 1e-6 <= walk < 1e-4
    assert all(one.probability.sum() == pytest.approx(1.0) for one in linked)


def test_passes_with_large_rate_changes_are_not_linked():
    alone = passes(np.random.default_rng(1), 0.3)
    linked, walk = link_passes(alone, TIMES, 0.1)
    assert np.isnan(walk) or walk > 3e-4
    if np.isnan(walk):
        np.testing.assert_array_equal(linked[2].probability, alone[2].probability)
