"""The chain: slopes, steps and evidence against differences, dense solves and integrals; also of samples close together."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sunspin.estimate.carry import step
from sunspin.estimate.chain import (
    LEAST_DEFECT_RAD,
    equations,
    fit,
    fit_single_shooting,
    propagate,
    variance_of,
    whitening,
)
from sunspin.estimate.evidence import ladder, sum_over_shares
from sunspin.estimate.model import Body, Model, Noise, Track
from sunspin.estimate.observe import observe
from sunspin.estimate.settings import RATES
from sunspin.estimate.terms.term import facing
from sunspin.solve.linear import solve_bordered
from sunspin.solve.rotations import rotate_attitude
from sunspin.telemetry.assess import assess
from tests.support.chains import ERRORS, INERTIA, T_S, problem
from tests.support.orbit_cases import sparse_pass
from tests.support.passes import estimate, slope_of, stated_model
from validation.passes import compare_with_truth, make

ROUNDING = 1e-4
"""What rounding may leave of two solutions with the same matrix: its condition, 6e10, times 2e-16, with a reserve."""


def moved(motions, nodes, u):
    """Return motions with turns and rates (K, n, 6) and unknowns (K, m) changed."""
    attitude = rotate_attitude(motions.attitude, nodes[..., :3])
    return Track(attitude, motions.omega + nodes[..., 3:], motions.u + u)


def test_slope_is_that_of_differences():
    model, motions = problem()
    rng = np.random.default_rng(2)
    nodes, u = 1e-3 * rng.normal(size=(1, 5, 6)), 0.2 * rng.normal(size=motions.u.shape)
    motions = moved(motions, nodes, u)
    system, still = equations(model, motions), np.zeros((1, 5, 6))
    for sample, place in ((0, 1), (2, 0), (2, 4), (4, 5)):
        step = still.copy()
        step[0, sample, place] = 1e-6
        by_node = slope_of(lambda h: equations(model, moved(motions, h, 0.0)).cost, step, 1e-6)
        assert np.allclose(by_node, system.slope[:, sample, place], rtol=5e-3, atol=0.5)
    for j, step in enumerate(1e-4 * np.eye(motions.u.shape[1])):
        by_u = slope_of(lambda h: equations(model, moved(motions, still, h)).cost, step, 1e-4)
        assert np.allclose(by_u, system.border_slope[:, j], rtol=5e-3, atol=0.2)


def test_variance_of_a_mean_is_that_of_the_whole_covariance():
    """A step under no slope but the weights of the mean is the covariance times them."""
    model, motions = problem()
    one = fit(model, motions, 20)
    weights = np.zeros((1, 5, 3, 6))
    weights[..., 3:] = np.eye(3) / 5
    system = equations(model, one.motions)
    system = system._replace(border_slope=0 * system.border_slope)
    expected = []
    for mean in np.moveaxis(weights, 2, 0):
        (nodes, _), _ = solve_bordered(system._replace(slope=-mean), np.zeros(1))
        expected.append((mean * nodes).sum())
    assert np.allclose(variance_of(one, weights)[0], expected, rtol=ROUNDING)


def test_whitening_gives_the_covariance_of_white_acceleration():
    # a millisecond, in which torques alone would tell the turn too well
    dt, q = np.array([1e-3, 3.0, 20.0]), 2e-4
    white, log_determinant = whitening(Noise(q), dt)
    for k, t in enumerate(dt):
        eye = np.eye(3)
        covariance = q**2 * np.block([[eye * t**3 / 3, eye * t**2 / 2], [eye * t**2 / 2, eye * t]])
        covariance[:3, :3] += LEAST_DEFECT_RAD**2 * eye
        assert np.allclose(white[k] @ covariance @ white[k].T, np.eye(6), atol=1e-9)
    logs = [np.linalg.slogdet(np.linalg.inv(one.T @ one))[1] for one in white]
    assert np.isclose(log_determinant, sum(logs) / 2)


def test_evidence_does_not_hang_on_rounding():
    """Times scaled by 1 + 1e-12 move the evidence of the lowest rung by less than 0.02."""
    model, motions = problem(noise=5e-6, torque=False)
    other = replace(model, obs=replace(model.obs, t_s=T_S * (1 + 1e-12)))
    logs = [fit(one, motions, 20).log_evidence[0] for one in (model, other)]
    assert abs(logs[0] - logs[1]) < 0.02


def test_shooting_and_chain_find_the_same_motion_if_torques_are_weak():
    model, truth = problem(noise=1e-7, gyro=False, torque=False)
    model = model.for_search(Noise(1e-7))[0]
    begin = propagate(model, 2, truth.attitude[:, 2], truth.omega[:, 2] + 2e-3)
    by_shooting = fit_single_shooting(model, 2, begin, 20)
    by_chain = fit(model, by_shooting, 20).motions
    assert np.abs(by_chain.omega - by_shooting.omega).max() < 1e-5
    # the prior of the rate stands at the first sample in a chain, and at the sample that is shot
    assert np.isclose(by_chain.cost[0], by_shooting.cost[0], atol=0.02)


def test_motions_of_several_bodies_are_those_of_each_alone():
    inertia = np.stack([INERTIA, np.eye(3), np.diag([0.8, 1.0, 1.2])])
    omega = np.random.default_rng(4).normal(size=(3, 4, 3)) * 0.05
    dt, momenta = np.array([3.0, 5.0, 8.0, 20.0]), (np.zeros((4, 3)), np.full((4, 3), 0.02))
    together = step(inertia, omega, dt, momenta, True, ERRORS)
    for k in range(3):
        alone = step(inertia[k], omega[k : k + 1], dt, momenta, True, ERRORS)
        for one, other in zip(together, alone, strict=True):
            assert np.array_equal(one[k], other[0])


WEAK = 5e-6
"""rad/s^1.5; the weakest torques of `rates`, under which steps that are straight creep."""


def test_a_sphere_turns_evenly_as_a_body_that_is_nearly_one_is_integrated():
    rng = np.random.default_rng(4)
    omega, dt = 0.2 * rng.normal(size=(3, 4, 3)), np.array([10.0, -3.0, 0.0, 40.0])
    still = np.zeros((4, 3)), np.zeros((4, 3))
    even = step(np.eye(3), omega, dt, still, True)
    nearly = step(np.eye(3) + np.diag([1e-12, 0.0, 0.0]), omega, dt, still, True)
    assert np.allclose(even.turned, nearly.turned, atol=1e-3)  # the steps' own error
    assert np.allclose(even.omega, nearly.omega, atol=1e-9)
    by_start = even.by_start - nearly.by_start
    assert np.allclose(by_start[..., :3, 3:], 0.0, atol=2e-2)
    assert np.allclose(by_start[..., 3:, :], 0.0, atol=1e-6)


def test_the_true_motion_of_a_body_without_an_inertia_costs_little_under_weak_torques():
    """A body at 7 deg/s, samples 34 s apart: by straight steps alone its cost is 140, more than that of its slower alias."""
    vehicle, telemetry, truth = sparse_pass(11, 9)
    stated = stated_model(vehicle, telemetry, WEAK, 0.14)
    obs = stated.obs.of_pass(np.arange(len(stated.obs)))
    at = truth.sel(time=obs.t_s)
    # attitudes in axes with z to the Sun
    sun_N = at["sun_N"].values[0]
    attitude = Rotation.from_quat(at["B_from_N"].values).as_matrix() @ facing(sun_N)
    begin = Track(attitude[None], at["omega_B"].values[None], np.zeros((1, 0)))
    fits = ladder(replace(stated, obs=obs), begin, RATES.ladder, RATES.search, RATES.search.noise)
    cost = {one.model.noise.acceleration: float(one.motions.cost.min()) for one in fits}
    assert cost[WEAK] < obs.cost_limit / 4, cost


@pytest.fixture(scope="module")
def simulated():
    """Return a pass with a gyro whose time tags are off; some stand a millisecond apart."""
    return make("time tags", 7, 0)


def test_states_and_unknowns_of_a_fit_keep_positive_variances(simulated):
    seen = observe(assess(simulated.vehicle, simulated.telemetry))
    obs = seen.obs.take(seen.usable)
    assert np.diff(obs.t_s).min() < 0.01
    model = Model(obs, Body.of(simulated.vehicle), Noise(5e-6), 0.075)
    near = np.searchsorted(simulated.telemetry["time"].values, obs.t_s)
    still = np.tile(np.eye(3), (1, len(obs), 1, 1))
    one = fit(model, Track.unfitted(still, simulated.omega[None, near]), 30)
    assert np.linalg.eigvalsh(one.u_covariance).min() > 0
    assert np.linalg.eigvalsh(one.motions.covariance).min() > 0


def test_a_fit_without_a_minimum_is_not_moved_by_other_sigmas_of_its_unknowns():
    simulated = make("few samples", 0, 2)
    model = stated_model(simulated.vehicle, simulated.telemetry, rate_sigma=0.035)
    obs = model.obs
    still = np.tile(np.eye(3), (1, len(obs), 1, 1))
    one = fit(model, Track.unfitted(still, np.zeros((1, len(obs), 3))), 20)
    broken = replace(one, u_covariance=one.u_covariance - 2 * np.eye(len(model.unknowns)))
    summed = sum_over_shares(broken, 3.0)
    np.testing.assert_array_equal(summed.motions.u, one.motions.u)
    np.testing.assert_allclose(summed.motions.omega, one.motions.omega, atol=1e-15)
    counts = {unknown.kind: len(unknown.shares) for unknown in model.unknowns}
    expected = one.log_evidence[0] - np.log(np.prod(list(counts.values())))
    assert np.isclose(summed.log_evidence[0], expected)


def test_a_file_with_such_times_is_right(simulated):
    row = compare_with_truth(estimate(simulated), simulated)
    assert row["decided"] and row["listed"] and not row["wrong"]
