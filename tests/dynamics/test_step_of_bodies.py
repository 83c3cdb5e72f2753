"""The step of `rates` for several bodies in one call gives what it gives for each body alone."""

import numpy as np

from sunspin.dynamics.step import carry_bodies


def test_bodies_carried_together_are_those_carried_alone():
    rng = np.random.default_rng(1)
    inertia = np.stack([np.diag(rng.uniform(0.8, 1.2, 3)) for _ in range(4)])
    states = np.zeros((4, 3, 7))
    states[..., :3], states[..., 6] = 0.05 * rng.normal(size=(4, 3, 3)), 1.0
    start, end = 0.01 * rng.normal(size=(2, 4, 3, 3))
    dt_s, counts = rng.uniform(-20, 20, (4, 3)), rng.integers(2, 9, (4, 3))
    together = carry_bodies(states, dt_s, counts, (start, end), inertia)
    for k in range(4):
        one = slice(k, k + 1)
        momenta = start[one], end[one]
        alone = carry_bodies(states[one], dt_s[one], counts[one], momenta, inertia[one])
        assert np.array_equal(alone, together[one])
    assert not np.array_equal(together, states)


def test_no_intervals_give_no_states():
    none = np.zeros((2, 0, 7))
    momenta = np.zeros((2, 0, 3)), np.zeros((2, 0, 3))
    counts = np.zeros((2, 0), dtype=np.int64)
    inertia = np.repeat(np.eye(3)[None], 2, axis=0)
    assert carry_bodies(none, np.zeros((2, 0)), counts, momenta, inertia).shape == (2, 0, 7)
