"""Fast tumbles: the true solution is found although revolutions hide between samples. The telemetry is synthetic."""

import numpy as np
import pytest

import sunspin as ss
from sunspin.estimate.rates.motion import Body
from sunspin.estimate.rates.observe import observations
from sunspin.estimate.rates.result import DECIDED
from sunspin.estimate.rates.shoot import carried, shot
from sunspin.estimate.rates.state import Motion
from sunspin.estimate.terms.term import facing
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


def test_a_distant_trial_solution_converges_to_the_truth():
    """Ten degrees a second off, half a second of arc by the stiff motion between samples: the smoother alone stays put."""
    vehicle, data, run = fast_body(1.0, np.random.default_rng(4), samples=6)
    o = observations(vehicle, data)[0]
    motion = Motion(Body.of(vehicle), 1e-6, 1.0)
    truth = run["omega_B"].values
    start = truth[2] + np.radians([6.0, -6.0, 6.0])
    track = carried(o, 2, facing(o.of_sun[0].directions(2)), start[None], motion)
    ended = shot(o, 2, track, motion, 20)
    assert np.abs(track.omega[0] - truth).max() > np.radians(5)
    assert np.abs(ended.omega[0] - truth).max() < np.radians(
        2
    )  # six directions of 0.02 rad over 5 s
    assert ended.cost[0] < 12
