"""Neighbouring passes distinguish aliases if rates change slowly, and only then."""

import numpy as np
import pytest

from sunspin.estimate.rates.link import linked

TIMES = np.arange(6) * 5400.0
SIGMA = np.full((2, 3), 1e-3)


def passes(rng, wander):
    """The true rate and an alias far from it in every pass; the third pass likes its alias better."""
    rate = np.array([0.01, 0.015, 0.0]) + wander * rng.normal(size=(6, 3))
    alias = rate + 0.1 * rng.normal(size=(6, 3))
    weights = [np.array([0.9, 0.1])] * 2 + [np.array([0.3, 0.7])] + [np.array([0.9, 0.1])] * 3
    return [np.stack(pair) for pair in zip(rate, alias, strict=True)], weights


def test_a_wrong_alias_is_outweighed_by_neighbouring_passes():
    rates, weights = passes(np.random.default_rng(0), 1e-3)
    found, walk = linked(TIMES, rates, [SIGMA] * 6, weights, 0.1)
    assert found[2][0] > 0.95 and 1e-6 <= walk < 1e-4
    assert all(weight.sum() == pytest.approx(1.0) for weight in found)


def test_passes_with_large_rate_changes_are_not_linked():
    rates, weights = passes(np.random.default_rng(1), 0.3)
    found, walk = linked(TIMES, rates, [SIGMA] * 6, weights, 0.1)
    assert walk is None or walk > 3e-4
    if walk is None:
        np.testing.assert_array_equal(found[2], weights[2])
