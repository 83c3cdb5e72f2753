"""The mixture that proposes motions: the same densities however its components are kept, and regions by what they share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sunspin.infer.posterior.likelihood import moved
from sunspin.infer.posterior.mixture import SOFT, Mixture, monomials
from sunspin.infer.posterior.model import State
from sunspin.infer.posterior.widths import BLOCK, DEFENCE, pooled, regions

MOVING = (1, 2)
UNKNOWNS = 3


def mixture(seed: int, count: int) -> Mixture:
    """Unbent components about a few motions."""
    rng = np.random.default_rng(seed)
    d = 5 + UNKNOWNS
    centre = State(0.1 * rng.standard_normal((count, 3)), moved(np.tile([0.0, 0.6, 0.8], (count, 1)), rng.normal(size=(count, 2))),
                   rng.standard_normal((count, UNKNOWNS)))  # fmt: skip
    root = 0.1 * rng.standard_normal((count, d, d)) + 0.3 * np.eye(d)
    bend = np.zeros((count, monomials(np.zeros((1, d)), MOVING).shape[1], 5 - SOFT))
    bend[:, : UNKNOWNS + SOFT] = rng.standard_normal((count, UNKNOWNS + SOFT, 5 - SOFT))
    weight = rng.uniform(0.5, 1.0, count)
    basis = np.tile(np.diag([50.0] * 3 + [1.0] * 2), (count, 1, 1))
    return Mixture(centre, basis, bend, np.zeros((count, d)), root @ root.swapaxes(1, 2), weight / weight.sum(), MOVING)


def density(of: Mixture, state: State) -> np.ndarray:
    return np.exp(of.log_densities(state)).sum(axis=1)


def test_the_pooled_mixture_has_the_density_of_all_rounds():
    """Each round but the first begins with the same defence, which is kept once."""
    first = mixture(0, 4)
    wide = replace(first, covariance=2 * first.covariance, weight=DEFENCE * first.weight)
    later = [Mixture.joined([wide, replace(m, weight=(1 - DEFENCE) * m.weight)]) for m in (mixture(1, 3), mixture(2, 5))]
    tried = [(0.1, first), (0.02, later[0]), (0.3, later[1])]
    state = first.draw(200, np.random.default_rng(3))
    made = pooled(tried)
    assert len(made.weight) == 4 + 4 + 3 + 5 and made.weight.sum() == pytest.approx(1.0)
    expected = sum(share * density(m, state) for share, m in tried) / sum(share for share, _ in tried)
    np.testing.assert_allclose(density(made, state), expected, rtol=1e-9)


def test_a_bend_of_nothing_is_no_bend():
    """Components without products in their bend go a shorter way to the same coordinates."""
    straight = mixture(4, 2)
    bend = np.array(straight.bend)
    bend[:, -1] = 1e-200
    state = straight.draw(50, np.random.default_rng(5))
    for m in range(2):
        np.testing.assert_allclose(straight.coordinates(state, m), replace(straight, bend=bend).coordinates(state, m), rtol=1e-9)


def test_components_that_share_draws_are_one_region():
    """Two that share all their draws and one apart, with draws enough for several blocks; the last has no weight at all."""
    n = 2 * BLOCK + 7
    share = np.full((n, 4), 1e-9)
    share[:n // 3, 2] = 1.0
    share[n // 3 :, :2] = 0.5
    share[:, 3] = 1e-30
    parts = np.log(share)
    region, component = regions(np.zeros(n), parts, np.log(share.sum(axis=1)))
    assert component.tolist() == [0, 0, 1, -1]
    assert np.all(region[: n // 3] == 1) and np.all(region[n // 3 :] == 0)
