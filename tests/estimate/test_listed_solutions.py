"""Which solutions of a posterior are listed, and their sigmas if they rest on few draws."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sunspin.estimate.lander.mixture import First
from sunspin.estimate.lander.tree import _listed, _of_proposed


@pytest.mark.parametrize(
    ("share", "effective", "count"),
    [(0.005, 5.0, 1), (0.005, 11.0, 2), (0.02, 5.0, 2), (5e-5, 400.0, 1)],
)
def test_a_solution_of_few_draws_is_listed_only_with_a_large_probability(share, effective, count):
    """At least 1e-4; below 1 % it must rest on ten draws."""
    mix: Any = SimpleNamespace(
        share=np.array([1 - share, share]), effective=lambda region: (500.0, effective)[region]
    )
    assert _listed(mix) == count


def test_a_solution_with_too_few_draws_has_the_spread_of_the_proposal():
    """One draw alone would have a sigma of zero; where next to nothing was proposed, that of the prior is left."""
    omega = 0.02 * np.random.default_rng(0).standard_normal((3000, 3))
    none = np.zeros((3000, 0))
    mix: Any = SimpleNamespace(first=lambda index: First(omega[index], omega[index], none, none))
    spread = _of_proposed(mix, np.arange(3000), np.array([0.01, 0.0, 0.0]), 0.5)
    expected = 0.02**2 * np.eye(3)
    expected[0, 0] += 0.01**2
    np.testing.assert_allclose(spread, expected, atol=3e-5)
    few = _of_proposed(mix, np.arange(9), np.zeros(3), 0.5)
    np.testing.assert_allclose(few, 0.25 * np.eye(3))
