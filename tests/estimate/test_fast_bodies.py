"""Fast tumbles: the true solution is found although revolutions hide between samples. The telemetry is synthetic."""

import numpy as np
import pytest

import sunspin as ss
from sunspin.estimate.verdict import DECIDED
from tests.support.simulate import fast_body, has_true_mean_rate


@pytest.mark.evidence(
    "rates", "modelled", "simulated bodies at 5 to 30 deg/s without a largest rate"
)
def test_a_fast_tumble_is_estimated_and_another_motion_is_not_accepted():
    vehicle, data, run = fast_body(
        1.0, np.random.default_rng(np.random.SeedSequence(11, spawn_key=(0,)))
    )
    result = ss.rates(vehicle, data)
    assert np.nansum(result["probability"].values[0][has_true_mean_rate(result, run)]) > DECIDED
    assert result["cost"].values[0, 0] <= result["cost_limit"].values[0]
    other = fast_body(1.0, np.random.default_rng(4))[2].assign_coords(time=run["time"])
    assert not has_true_mean_rate(result, other).any()
