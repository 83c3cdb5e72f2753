"""The compiled step of `rates`: several bodies in one call, and steps of a chosen size, against SciPy's integration."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from sunspin.dynamics.kernels.intervals import LOST
from sunspin.dynamics.step import carry_bodies
from sunspin.estimate.carry import STEP_RAD, angle_turned, step

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


@pytest.mark.evidence(
    "rates", "verified", "a step of a fit with wheels, SciPy on Euler's equations"
)
def test_compiled_steps_agree_with_eulers_equations(reached):
    """Steps as long as a fit takes, whose error grows with the angle by which the body turns."""
    inertia = np.array([[1.2, 0.05, -0.02], [0.05, 1.0, 0.04], [-0.02, 0.04, 0.8]])
    rng = np.random.default_rng(5)
    start = 0.4 * rng.normal(size=(6, 3))
    momenta = start, start + 0.05 * rng.normal(size=(6, 3))
    omega, dt_s = 0.1 * rng.normal(size=(6, 3)), rng.uniform(5.0, 20.0, 6)
    end = step(inertia, omega[None], dt_s, momenta)
    steps = np.ceil(angle_turned(inertia[None], omega[None], dt_s, momenta)[0] / STEP_RAD)
    turns = np.maximum(steps * STEP_RAD / (2 * np.pi), 1.0)
    for i in range(6):
        attitude, rate = integrated(inertia, omega[i], dt_s[i], momenta[0][i], momenta[1][i])
        turned = Rotation.from_matrix(end.turned[0, i])
        away = (turned * Rotation.from_matrix(attitude).inv()).magnitude()
        reached("error of the attitude in a turn", away / turns[i], "rad", 2e-4)
        assert away < 2e-4 * turns[i]
        assert np.abs(end.omega[0, i] - rate).max() < 2e-4 * turns[i]  # rad/s
