"""Fast tumbles: is the true motion among those found, whatever hides between samples? The telemetry is synthetic."""

import itertools

import numpy as np
import pytest

import sunspin as ss
from fast_twins import BODIES, Kind, craft, found, near, tally, twin
from sunspin.estimate.rates.motion import Body
from sunspin.estimate.rates.observe import observations
from sunspin.estimate.rates.shoot import carried, shot
from sunspin.estimate.rates.state import Motion


@pytest.mark.evidence("rates", "modelled", "twins that turn by 5 to 30 deg/s, no largest rate told")
@pytest.mark.parametrize("twins", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "kind",
    [
        Kind(1.0, "long", False, "directions"),
        pytest.param(Kind(2.0, "sphere", True, "panels"), marks=pytest.mark.slow),
        pytest.param(Kind(10.0, "triaxial", False, "directions"), marks=pytest.mark.slow),
    ],
)
def test_the_true_motion_of_a_fast_tumble_is_found(kind, twins):
    told = tally(kind, twins, seed=11)
    assert told.listed == told.count and told.wrong == 0
    assert told.decided == told.count


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind",
    [
        Kind(*kind)
        for kind in itertools.product(
            (1.0, 2.0, 5.0, 10.0), BODIES, (False, True), ("directions", "panels")
        )
    ],
)
def test_the_true_motion_of_fast_tumbles_is_found(kind):
    told = tally(kind, 5, seed=2)
    assert told.listed >= 4 and told.wrong == 0


def test_the_control_another_truth_is_not_found():
    kind = Kind(1.0, "long", False, "directions")
    result, run = found(kind, 11, 0)  # of the first test
    other = twin(kind, np.random.default_rng(4))[2].assign_coords(time=run["time"])
    assert near(result, run).any() and not near(result, other).any()


@pytest.mark.slow
def test_a_search_that_must_be_coarse_says_so():
    """An uneven body, a minute between samples, rates up to a turn in six seconds: ten turns hide, too many to lay a fine grid."""
    kind = Kind(60.0, "long", False, "directions")
    vehicle, data, _ = twin(kind, np.random.default_rng(5), samples=5)
    assert (
        "may have been missed"
        in ss.rates(vehicle, data, max_rate_rad_s=1.0, acceleration_noise=1e-5).attrs["verdict"]
    )
    assert (
        "missed"
        not in ss.rates(vehicle, data, max_rate_rad_s=0.05, acceleration_noise=1e-5).attrs[
            "verdict"
        ]
    )


def test_a_start_is_shot_to_the_truth_from_afar():
    """Ten degrees a second off, half a second of arc by the stiff motion between samples: the smoother alone stays put."""
    kind = Kind(1.0, "long", False, "directions")
    vehicle, data, run = twin(kind, np.random.default_rng(4), samples=6)
    o = observations(vehicle, data)[0]
    motion = Motion(Body.of(craft(kind)), 1e-6, 1.0)
    truth = run["omega_B"].values
    start = truth[2] + np.radians([6.0, -6.0, 6.0])
    track = carried(o, 2, o.of_sun[0].directions(2), start[None], motion)
    ended = shot(o, 2, track, motion, 20)
    assert np.abs(track.omega[0] - truth).max() > np.radians(5)
    assert np.abs(ended.omega[0] - truth).max() < np.radians(
        2
    )  # six directions of 0.02 rad over 5 s
    assert ended.cost[0] < 12
