"""The compiled step of `rates`: several bodies in one call, against SciPy's integration of the same equations."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from sunspin.dynamics.step import LOST, carry_bodies

RUNS, MOTIONS, INTERVALS = 2, 3, 4


@pytest.fixture
def bodies():
    """Inertia, rates, intervals, steps and wheels of several runs of several motions."""
    rng = np.random.default_rng(1)
    turn = Rotation.random(RUNS * MOTIONS, rng=1).as_matrix()
    moments = rng.uniform(0.8, 1.2, (RUNS * MOTIONS, 3))
    inertia = (turn * moments[:, None]) @ np.swapaxes(turn, -1, -2)
    omega = 0.05 * rng.normal(size=(RUNS, MOTIONS, INTERVALS, 3))
    momenta = tuple(0.01 * rng.normal(size=(2, INTERVALS, 3)))
    counts = rng.integers(80, 99, (MOTIONS, INTERVALS))
    dt_s = rng.uniform(5, 20, INTERVALS) * [1, -1, 1, 1]
    return inertia.reshape(RUNS, MOTIONS, 3, 3), omega, dt_s, counts, momenta


def integrated(inertia, omega, dt_s, start, end):
    """Attitude relative to that at the start, and rate, after `dt_s` seconds by Euler's equations with wheels (docs/model.md)."""

    def slope(t, state):
        wheels = start + (end - start) * t / dt_s
        rate = np.linalg.solve(inertia, state[:3] - wheels)
        relative = state[3:].reshape(3, 3)
        return np.concatenate([np.cross(state[:3], rate), -np.cross(rate, relative.T).T.ravel()])

    begin = np.concatenate([inertia @ omega + start, np.eye(3).ravel()])
    state = solve_ivp(slope, (0.0, dt_s), begin, rtol=1e-11, atol=1e-13).y[:, -1]
    return state[3:].reshape(3, 3), np.linalg.solve(inertia, state[:3] - end)


def test_bodies_move_by_eulers_equations_with_wheels(bodies):
    inertia, omega, dt_s, counts, (start, end) = bodies
    turned, rate = carry_bodies(*bodies)
    for r, k, i in np.ndindex(RUNS, MOTIONS, INTERVALS):
        attitude, last = integrated(inertia[r, k], omega[r, k, i], dt_s[i], start[i], end[i])
        assert turned[r, k, i] == pytest.approx(attitude, abs=1e-7)
        assert rate[r, k, i] == pytest.approx(last, abs=1e-8)


def test_bodies_carried_together_are_those_carried_alone(bodies):
    inertia, omega, dt_s, counts, momenta = bodies
    together = carry_bodies(*bodies)
    for r, k in np.ndindex(RUNS, MOTIONS):
        run, motion = slice(r, r + 1), slice(k, k + 1)
        alone = carry_bodies(
            inertia[run, motion], omega[run, motion], dt_s, counts[motion], momenta
        )
        for one, all_of_them in zip(alone, together, strict=True):
            assert np.array_equal(one, all_of_them[run, motion])


def test_one_inertia_serves_all_motions_of_a_run_and_each_motion_may_have_its_own_intervals(bodies):
    inertia, omega, dt_s, counts, momenta = bodies
    shared = carry_bodies(inertia[:, :1], omega, dt_s, counts, momenta)
    repeated = np.repeat(inertia[:, :1], MOTIONS, axis=1)
    each = np.repeat(dt_s[None], MOTIONS, axis=0)
    separate = carry_bodies(repeated, omega, each, counts, momenta)
    for one, other in zip(shared, separate, strict=True):
        assert np.array_equal(one, other)


def test_a_motion_that_no_step_is_fine_enough_for_is_fast_and_finite(bodies):
    inertia, omega, dt_s, counts, momenta = bodies
    omega[0, 1, 2] = 1e200
    turned, rate = carry_bodies(inertia, omega, dt_s, counts, momenta)
    assert np.array_equal(turned[0, 1, 2], np.eye(3))
    assert np.isfinite(rate).all() and np.linalg.norm(rate[0, 1, 2]) > LOST / 2
    assert np.linalg.norm(rate[0, 1, 1]) < 1
