"""Two samples a millisecond apart: the equations of motion must not tell the turn so well that all digits of a fit are lost."""

from dataclasses import replace

import numpy as np
import pytest

from sunspin.estimate.chain import fit
from sunspin.estimate.evidence import over_shares
from sunspin.estimate.model import Body, Model, Noise, Track
from sunspin.estimate.observe import observe
from sunspin.telemetry.assess import assess
from tests.support.passes import estimate, stated_model
from validation.passes import compare_with_truth, make


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
    one = fit(model, Track.free(still, simulated.omega[None, near]), 30)
    assert np.linalg.eigvalsh(one.u_covariance).min() > 0
    assert np.linalg.eigvalsh(one.motions.covariance).min() > 0


def test_a_fit_without_a_minimum_is_not_moved_by_other_sigmas_of_its_unknowns():
    simulated = make("few samples", 0, 2)
    model = stated_model(simulated.vehicle, simulated.telemetry, rate_sigma=0.035)
    obs = model.obs
    still = np.tile(np.eye(3), (1, len(obs), 1, 1))
    one = fit(model, Track.free(still, np.zeros((1, len(obs), 3))), 20)
    broken = replace(one, u_covariance=one.u_covariance - 2 * np.eye(len(model.unknowns)))
    summed = over_shares(broken, 3.0)
    np.testing.assert_array_equal(summed.motions.u, one.motions.u)
    np.testing.assert_allclose(summed.motions.omega, one.motions.omega, atol=1e-15)
    counts = {unknown.kind: len(unknown.shares) for unknown in model.unknowns}
    expected = one.log_evidence[0] - np.log(np.prod(list(counts.values())))
    assert np.isclose(summed.log_evidence[0], expected)


def test_a_file_with_such_times_is_right(simulated):
    row = compare_with_truth(estimate(simulated), simulated)
    assert row["decided"] and row["listed"] and not row["wrong"]
