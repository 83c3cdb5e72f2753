"""Rates of a satellite with panels on its sides only, whose brightness does not determine the gains. All synthetic."""

from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.estimate.rates.common_errors import Clock, places_of, sun_part
from sunspin.estimate.rates.motion import Body
from sunspin.estimate.rates.observe import observations, passes
from sunspin.estimate.rates.smooth import measured
from sunspin.estimate.rates.start import blind_axis, facing, mirrored
from sunspin.estimate.rates.state import Motion, Track
from sunspin.estimate.terms.term import normal
from tests.support.simulate import CUBE, FAULTS_OF_FOUR_SIDES, FOUR_SIDES, cube_with_faults

MOTION = Motion(Body.of(CUBE), 2e-5, 0.075)


def seen(craft=FOUR_SIDES, faults=(), seed=3):
    """Observations of a pass, and a hypothesis about it."""
    rng = np.random.default_rng(seed)
    data, _ = cube_with_faults(faults, rng, craft)
    o, why, _ = observations(craft, data)
    o = o.take(passes(o, why)[0][:8])
    sun = rng.normal(size=(1, len(o), 3))
    sun[..., 2] = 0.3 + np.abs(sun[..., 2])
    return o, Track(
        facing(sun / np.linalg.norm(sun, axis=-1, keepdims=True)),
        0.03 * rng.normal(size=(1, len(o), 3)),
    )


def nearest(result, run):
    """The error of the nearest mode's mean rate, in its sigma (3), and its weight."""
    truth = run["omega_B"].sel(time=result["time"].values).values.mean(axis=0)
    away = truth - result["omega_mean_B"].values[0]
    k = np.nanargmin(np.linalg.norm(away, axis=1))
    return away[k] / result["omega_sigma_B"].values[0, k], result["probability"].values[0, k]


def test_gains_are_estimated_only_if_brightness_does_not_determine_them():
    four, six = (seen(craft)[0].of_sun[0] for craft in (FOUR_SIDES, CUBE))
    assert len(four.gain_unknowns) == 4 and not len(four.gain_errors)
    assert len(six.gain_errors) == 6 and not len(six.gain_unknowns)


@pytest.mark.evidence("rates", "verified", "finite differences of the cost of the readings")
def test_the_gradient_by_gains_is_that_of_the_cost():
    """The Student law's cost, by differences of 1e-5 of each gain's sigma."""
    o, track = seen()
    panels = o.of_sun[0]
    slope = normal(panels, track, np.zeros((1, 4)))[1][0, :, 3:].sum(axis=0)
    for unknown, told in zip(panels.gain_unknowns, slope, strict=True):
        beside = (
            o.swapped(panels, replace(panels, gain=panels.gain + sign * 1e-5 * unknown))
            for sign in (1, -1)
        )
        up, down = (measured(other, track)[2].sum() for other in beside)
        assert told == pytest.approx((up - down) / 2e-5, rel=1e-5, abs=1e-6)


def test_time_offset_and_gains_share_one_border_of_the_equations():
    o, track = seen()
    clock, error = Clock(0.0, 0.5), np.zeros((1, len(MOTION.body.errors) + 4 + 1))
    places = places_of(o, MOTION, clock)
    part = sun_part(o, places, track, error, MOTION, clock)
    step = np.zeros_like(error)
    for place in (-1, -2):
        step[:] = 0
        step[:, place] = 1e-5
        up, down = (
            sun_part(o, places, track, error + sign * step, MOTION, clock).cost[0]
            for sign in (1, -1)
        )
        assert part.error_slope[0, place] == pytest.approx((up - down) / 2e-5, rel=1e-4, abs=1e-5)


def test_the_mirror_solution_has_the_same_readings_and_obeys_the_equations():
    o, track = seen()
    axis = blind_axis(o)
    assert abs(axis[2]) == pytest.approx(1.0) and blind_axis(seen(CUBE)[0]) is None
    image = mirrored(track, axis)
    np.testing.assert_allclose(measured(o, image)[2], measured(o, track)[2], rtol=1e-12)
    np.testing.assert_allclose(np.linalg.det(image.attitude), 1.0, rtol=1e-12)
    np.testing.assert_allclose(image.omega, track.omega * [-1, -1, 1], rtol=1e-12)


@pytest.mark.long
def test_a_dead_string_is_not_taken_for_another_motion():
    """With all that is wrong with such files: the truth is near one of two mirror images, each half the weight."""
    data, run = cube_with_faults(FAULTS_OF_FOUR_SIDES, np.random.default_rng(3), FOUR_SIDES)
    pull, weight = nearest(ss.rates(FOUR_SIDES, data, max_rate_rad_s=0.15), run)
    assert np.abs(pull).max() < 3.5 and weight > 0.3
