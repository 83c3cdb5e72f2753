"""Times that are rounded to whole seconds: recognised as such, and counted among the errors of readings that they change."""

import numpy as np
import pytest

from sunspin import rates
from sunspin.estimate.model import SUN_N, Body, Model, Noise, Observations, Track
from sunspin.estimate.observe import rounded_to_s
from sunspin.estimate.one_pass import with_time_errors
from sunspin.estimate.terms.directions import SunDirections
from validation.passes import FACES, observe, spin


@pytest.mark.parametrize(
    ("t_s", "unit_s"),
    [
        (np.round(10.3 * np.arange(20)), 1.0),  # a device with an interval of its own
        (1.7e9 + np.round(10.3 * np.arange(20)), 1.0),
        (np.round(10.03 * np.arange(40), 1), 0.1),
        (10.3 * np.arange(20), 0.0),
        (10.0 * np.arange(20), 0.0),
        (np.delete(10.0 * np.arange(20), [3, 4, 9]), 0.0),  # rows are missing
        (np.add.outer(60.0 * np.arange(4), np.arange(5)).ravel(), 0.0),  # bursts, a second apart
        (np.array([0.0, 30.0, 50.0, 75.0]), 0.0),  # whole multiples of 5 s
        (np.array([7.0]), 0.0),
    ],
)
def test_times_are_rounded_if_a_unit_divides_them_and_no_multiple_of_it_does(t_s, unit_s):
    assert rounded_to_s(t_s) == unit_s
    assert rounded_to_s(np.append(t_s, t_s[-1])) == unit_s  # a row that came twice


def made_pass(seed, interval_s, rounded):
    """Return a box that tumbles at 14 deg/s, sampled at an even interval with times in whole seconds or as they are."""
    rng = np.random.default_rng(seed)
    t_s = interval_s * np.arange(45)
    start = rng.normal(size=3)
    start *= np.radians(14.0) / np.linalg.norm(start)
    made = observe(FACES, *spin(start, t_s), t_s, 0.01, rng)
    times = np.round(t_s) if rounded else t_s
    return made._replace(telemetry=made.telemetry.assign_coords(time=times))


@pytest.mark.parametrize("seed", [1, 2])
def test_rates_of_times_in_whole_seconds_are_decided_and_within_their_errors(seed):
    """A body turns by 4 deg in the error of a time. Without it five of eight such passes are POOR FIT, one is decided and off."""
    made = made_pass(seed, 5.3, rounded=True)
    result = rates(made.vehicle, made.telemetry)
    assert result["decided"].values[0] and "count as rounded" in result.attrs["verdict"]
    sigma = np.sqrt(np.diagonal(result["omega_cov_B"].values, axis1=1, axis2=2))
    assert (np.abs(result["omega_B"].values - made.omega) / sigma).max() < 4.5


def test_exact_times_have_no_errors():
    """The sigmas of the same pass with exact times are much smaller."""
    made = [made_pass(0, 5.3, rounded) for rounded in (True, False)]
    results = [rates(a.vehicle, a.telemetry) for a in made]
    sigmas = [result["sigma_x"].values[0, 0] for result in results]
    assert sigmas[1] < sigmas[0] / 1.5 and "rounded" not in results[1].attrs["verdict"]


def test_errors_of_times_turn_directions_across_the_motion_and_cost_the_density_that_they_spread():
    """A body turns at 0.1 rad/s about an axis 30 degrees from the Sun: a time off by 0.5 s moves the Sun by 0.025 rad."""
    axis = np.array([0.0, np.sin(np.pi / 6), np.cos(np.pi / 6)])
    covariance = np.broadcast_to(0.01**2 * np.eye(3), (6, 3, 3))
    sun = SunDirections.of(np.broadcast_to(SUN_N, (6, 3)), covariance)
    obs = Observations(np.arange(6.0), np.zeros((6, 3)), (sun,), 0.5)
    model = Model(obs, Body(np.eye(3), np.zeros((0, 3, 3))), Noise(1e-4), 0.1)
    attitude = np.broadcast_to(np.eye(3), (1, 6, 3, 3))
    motion = Track.free(attitude, np.broadcast_to(0.1 * axis, (1, 6, 3)))
    wider = with_time_errors(model, [motion], 0.02)
    assert np.allclose(wider.obs.terms[0].covariance[:, 0, 0], 0.01**2 + 0.025**2)
    # the density at the centre of two normal numbers falls by the ratio of their variances
    assert np.isclose(wider.log_prior, -6 * np.log(1 + 2.5**2))
    assert with_time_errors(model, [motion], 0.03) is model
