"""Other models begin where the cost of the nominal one is least, not at its mean over the sizes of a torque."""

from dataclasses import replace

import numpy as np
import pytest

from sunspin.estimate.budget import Budget
from sunspin.estimate.chain import equations
from sunspin.estimate.evidence import ladder, leading, united
from sunspin.estimate.model import AS_STATED, Body, Model, Noise
from sunspin.estimate.observe import observe
from sunspin.estimate.one_pass import one_pass
from sunspin.estimate.settings import RATES
from sunspin.telemetry.assess import assess
from validation.passes import make


@pytest.fixture(scope="module")
def fits():
    """Return the fits of three samples with a gyro and a magnetometer, whose field may pull at a dipole of any size."""
    simulated = make("few samples", 0, 2)
    obs = observe(assess(simulated.vehicle, simulated.telemetry)).obs
    model = Model(obs, Body.of(simulated.vehicle), Noise(1e-4), simulated.max_rate_rad_s / 2)
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
    begin = leading(fits, 1, RATES.search)
    best = max(fits, key=lambda one: one.log_evidence.max())
    np.testing.assert_array_equal(begin.omega[0], best.to_begin_from.omega[0])


def test_fits_that_are_taken_and_joined_keep_it(fits):
    one = fits[0]
    both = united([one, one], RATES.ladder, RATES.search)
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
