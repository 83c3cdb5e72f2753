"""Additional observations of the posterior: a magnetic direction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.estimate.posterior.data import readings
from sunspin.estimate.posterior.likelihood import Likelihood
from sunspin.estimate.posterior.model import State, model
from sunspin.solve.rotations import move_on_sphere
from sunspin.vehicle import Friction, Vehicle, Wheel
from tests.support.vehicles import small_cube

SUN = np.array([0.3, 0.5, 0.8]) / np.linalg.norm([0.3, 0.5, 0.8])
RATE = np.array([0.05, -0.08, 0.11])
SPEED, SIGMA = 300.0, 0.01


@pytest.fixture(scope="module")
def craft() -> Vehicle:
    wheel = Wheel("wheel", np.array([0.0, 0.0, 1.0]), 2e-6, SPEED, Friction(1e-6, 1e-9))
    return replace(small_cube(), wheels=(wheel,))


@pytest.fixture(scope="module")
def telemetry(craft):
    return ss.twin(
        craft,
        {
            "omega_B": RATE,
            "sun_B": SUN,
            "t_s": np.arange(0, 200, 20.0),
            "wheel_speed_rad_s": [SPEED],
        },
        seed=1,
    )


def field(telemetry, angle_error: float = 0.0) -> dict:
    """A direction seen at the third sample, 1 rad and the error from the Sun there."""
    sun = telemetry["true_sun_B"].values[2]
    side = np.cross(sun, [0.0, 0.0, 1.0])
    axis = np.cos(1.0) * sun + np.sin(1.0) * side / np.linalg.norm(side)
    return {
        "kind": "field",
        "t_s": 40.0,
        "value": 3e-5 * axis,
        "angle_rad": 1.0 + angle_error,
        "sigma": SIGMA,
    }


def likelihood(craft, telemetry, priors=None, observations=()):
    data, _, _ = readings(craft, telemetry, observations=observations)
    unknown, _ = model(craft, priors, 1.0)
    return Likelihood(unknown, data), State(
        RATE[None], SUN[None], np.zeros((1, len(unknown.unknowns)))
    )


def test_a_field_direction_off_by_three_sigma_costs_four_and_a_half(craft, telemetry):
    good, state = likelihood(craft, telemetry, None, [field(telemetry)])
    bad, _ = likelihood(craft, telemetry, None, [field(telemetry, 3 * SIGMA)])
    assert (good(state) - bad(state))[0] == pytest.approx(4.5, abs=0.05)


def test_derivatives_by_rate_and_wheel_speed_agree_with_differences(craft, telemetry):
    found, state = likelihood(craft, telemetry, None, [field(telemetry)])
    speed = 5 + found.model.where("wheel_speed")[0]
    jacobian = found.linearised(state).jacobian
    assert np.abs(jacobian[0, -1, :5]).max() > 1  # the field tells something
    for j, step in ((0, 1e-6), (3, 1e-5), (speed, 1e-3)):
        ends = []
        for sign in (1, -1):
            omega, tangent, u = np.array(state.omega), np.zeros((1, 2)), np.array(state.u)
            (omega if j < 3 else tangent if j < 5 else u)[
                :, j if j < 3 else j - 3 if j < 5 else j - 5
            ] += sign * step
            other = State(omega, move_on_sphere(state.sun, tangent), u)
            ends.append(found.misfit(found.predict(other, 1e-10), other.u)[0])
        expected = (ends[0] - ends[1]) / (2 * step)
        assert np.abs(expected - jacobian[..., j]).max() < 5e-3 * np.abs(expected).max(), j


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"angle_rad": 4.0}, "from 0 to pi"),
        ({"value": [0.0, 0.0, 0.0]}, "from 0 to pi"),
        ({"value": [1.0]}, "3 finite numbers"),
    ],
)
def test_a_field_observation_without_valid_direction_is_refused(craft, telemetry, changes, part):
    with pytest.raises(InputError, match=part):
        readings(craft, telemetry, observations=[field(telemetry) | changes])
    without = {key: value for key, value in field(telemetry).items() if key != "angle_rad"}
    with pytest.raises(InputError, match="a field also angle_rad"):
        readings(craft, telemetry, observations=[without])
