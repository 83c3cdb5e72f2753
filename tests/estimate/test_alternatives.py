"""Other models of a pass: where they begin, what each explains, and that none is tried where nothing asks for it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sunspin.estimate.alternatives import alternatives
from sunspin.estimate.budget import Budget
from sunspin.estimate.chain import equations, whitening
from sunspin.estimate.evidence import best_motions, ladder, merge_fits
from sunspin.estimate.model import AS_STATED, Body, Model, Noise, Observations
from sunspin.estimate.one_pass import one_pass
from sunspin.estimate.settings import RATES
from sunspin.estimate.solutions import solutions
from sunspin.estimate.swings import SWINGS, log_mean_likelihood
from sunspin.estimate.terms.directions import SunDirections
from tests.support.chains import problem
from tests.support.passes import stated_model
from tests.support.vehicles import units
from validation.passes import judge, make

ALTERNATIVES = RATES.alternatives


def test_a_quiet_pass_is_asked_for_torques_and_the_zero_of_its_gyro_only():
    model, motions = problem(torque=False)
    model = model.seeing(slice(0, 5))
    fits = ladder(model, motions, RATES.ladder, RATES.search, 1e-4)
    tried = [one.what for one in alternatives(model, fits, ALTERNATIVES)]
    torques = ["a steady torque in body axes", "a steady torque in axes fixed in space"]
    assert tried == [*torques, "another zero offset of the gyro"]


def readings(suns, sigma, apart_s):
    """Return directions of the Sun at even times."""
    suns = np.array(suns, dtype=float)
    term = SunDirections.of(suns, np.tile(sigma**2 * np.eye(3), (len(suns), 1, 1)))
    return Observations(apart_s * np.arange(len(suns)), np.zeros((len(suns), 3)), (term,))


def test_a_body_that_wanders_far_has_readings_that_do_not_know_each_other():
    obs = readings([[0, 0, 1], [1, 0, 0]], 0.2, 10.0)
    far = log_mean_likelihood(obs, np.array([10.0]))[0]
    alone = [log_mean_likelihood(obs.take(slice(k, k + 1)), np.array([1.0]))[0] for k in (0, 1)]
    assert np.isclose(far, sum(alone), atol=0.01)


def solutions_of(sun, sigma):
    """Return the solutions of directions (n, 3) of the Sun in a sphere, read to `sigma` rad every minute."""
    rng = np.random.default_rng(8)
    obs = readings(units(sun + sigma * rng.normal(size=sun.shape)), sigma, 60.0)
    sphere = Body(np.eye(3), np.zeros((0, 3, 3)))
    model = Model(obs, sphere, Noise(1e-4), np.radians(1.5))
    fits = one_pass(model, RATES, Budget(np.inf))
    return solutions(fits, obs, np.arange(len(obs)), RATES.solutions, RATES.search)


def test_an_oscillation_is_not_taken_for_a_rotation():
    """A body about rest that wanders by 0.15 rad a minute: by single motions it rotates at 0.15 deg/s, five sigmas from rest."""
    rng, ways = np.random.default_rng(2), [Rotation.identity()]
    for _ in range(19):
        ways.append(Rotation.from_rotvec(0.15 * rng.normal(size=3)) * ways[-1])
    solved = solutions_of(np.array([way.apply([0.36, 0.48, 0.8]) for way in ways]), 0.05)
    assert solved.model[0] == SWINGS and solved.probability[0] > 0.9
    assert np.all(np.abs(solved.mean[0]) < 2 * solved.mean_sigma[0])
    assert np.all(solved.mean_sigma[0] > np.radians(0.05))


def test_a_rotation_is_not_taken_for_an_oscillation():
    rate = np.radians([0.6, -0.5, 0.8])
    turns = Rotation.from_rotvec(-60.0 * np.arange(10)[:, None] * rate)
    solved = solutions_of(turns.apply([0.36, 0.48, 0.8]), 0.1)
    assert solved.model[0] != SWINGS and solved.probability[0] > 0.9
    assert np.all(np.abs(solved.mean[0] - rate) < np.radians(0.05))
    assert np.all(solved.mean_sigma[0] < np.radians(0.05))


def test_a_step_is_strong_torque_in_its_interval_alone():
    dt = np.array([5.0, 10.0, 20.0])
    noise = Noise(1e-4, steps=((1, 0.01),))
    strength = noise.in_intervals(dt)
    assert strength[0] == strength[2] == 1e-4
    assert np.isclose(strength[1] ** 2, 1e-8 + 1e-4 / 10)
    swing, _ = whitening(Noise(1e-4, rate=1e-2), dt)
    covariance = np.linalg.inv(swing[1].T @ swing[1])
    assert np.isclose(covariance[0, 0], 1e-8 * 1000 / 3 + 1e-4 * 10)
    assert np.isclose(covariance[0, 3], 1e-8 * 50) and np.isclose(covariance[3, 3], 1e-8 * 10)


@pytest.fixture(scope="module")
def fits():
    """Return the fits of three samples with a gyro and a magnetometer, whose field may pull at a dipole of any size."""
    simulated = make("few samples", 0, 2)
    model = stated_model(*simulated[:2], rate_sigma=simulated.max_rate_rad_s / 2)
    assert any(len(unknown.shares) > 1 for unknown in model.unknowns)
    every = one_pass(model, RATES, Budget.of(1.0)).fits
    return [one for one in every if one.model.what == AS_STATED]


def test_a_fit_over_sizes_of_a_torque_keeps_where_its_cost_is_least(fits):
    calm = min(fits, key=lambda one: one.model.noise.acceleration)
    assert calm.lowest is not None
    at_mean = equations(calm.model, calm.motions).cost
    at_lowest = equations(calm.model, calm.to_begin_from).cost
    np.testing.assert_allclose(at_lowest, calm.motions.cost, rtol=1e-3)
    # the mean of the unknowns leaves the equations of motion under weak torques
    assert (at_mean > at_lowest + 10).any()
    begin = best_motions(fits, 1, RATES.search)
    best = max(fits, key=lambda one: one.log_evidence.max())
    np.testing.assert_array_equal(begin.omega[0], best.to_begin_from.omega[0])


def test_fits_that_are_taken_and_joined_keep_it(fits):
    one = fits[0]
    both = merge_fits([one, one], RATES.ladder, RATES.search)
    assert len(both) == 1
    np.testing.assert_allclose(both[0].to_begin_from.omega, one.to_begin_from.omega)
    assert len(one.take(slice(0, 0)).to_begin_from) == 0


def test_a_fit_ends_near_enough_for_its_evidence(fits):
    """A tenth of the tolerance moves no log evidence by 0.02."""
    for one in fits:
        finer = replace(RATES.ladder, rungs=(one.model.noise.acceleration,), tolerance=1e-5)
        (again,) = ladder(
            one.model, one.to_begin_from, finer, RATES.search, one.model.noise.acceleration
        )
        assert abs(again.log_evidence.max() - one.log_evidence.max()) < 0.02


def test_a_torque_that_may_point_two_ways_is_fitted_from_both():
    """Under strong random torques both are one minimum of the cost. One fit ended in the wrong one: decided, and 6 sigma off."""
    judged = judge("strong torque in space", 21, 5)
    assert judged["listed"] and judged["pull"] < 3.0
