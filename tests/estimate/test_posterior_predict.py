"""Predictions of the posterior: draws propagated as by the reference, and the effect of a collision."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.estimate.posterior.model import model
from sunspin.estimate.posterior.predict import intervals, predict
from sunspin.landing.predictions import predict_through_collision
from sunspin.vehicle import Friction
from sunspin.vehicle.assumptions import Collision
from tests.support.philae import AS_DRAWN, AS_DRAWN_TRUTH, philae_draws
from validation.calibrate import AS_DRAWN as KNOWN_PANELS

TOUCHDOWN, COLLISION, LATER = 25143.98, 27900.0, 31800.0


@pytest.fixture(scope="module")
def craft():
    return AS_DRAWN.vehicle


@pytest.mark.evidence(
    "posterior",
    "verified",
    "the reference propagator, through the wheel stop and backward",
)
def test_predicted_draws_agree_with_the_reference_through_the_wheel_stop_and_backward(craft):
    """Each with its own inertia, friction and wheel speed; the wheel stops at about 2500 s."""
    tree, state = philae_draws(3, 0.003)
    times = [TOUCHDOWN, 25200.0, 27000.0, LATER]
    found = predict(craft, tree, times)
    unknown, _ = model(craft, KNOWN_PANELS, 1.0)
    body = unknown.bodies(state.u)
    for i in range(3):
        wheel = replace(
            craft.wheels[0],
            friction=Friction(float(body.coulomb_N_m[i, 0]), float(body.viscous_N_m_s[i, 0])),
        )
        own = replace(craft, inertia_kg_m2=body.inertia_kg_m2[i], wheels=(wheel,))
        speed = unknown.wheel_speeds(state.u)[i]
        back = ss.propagate(own, state.omega[i], state.sun[i], speed, [0.0, TOUCHDOWN - 25200.0])
        on = ss.propagate(own, state.omega[i], state.sun[i], speed, np.array(times[1:]) - 25200.0)
        for name, tolerance in (("omega_B", 1e-4), ("sun_B", 5e-4), ("wheel_speed_rad_s", 1e-3)):
            got = found[name].values[0, i]
            assert np.allclose(got[0], back[name].values[-1], rtol=0, atol=tolerance), name
            assert np.allclose(got[1:], on[name].values, rtol=0, atol=tolerance), name
    assert np.all(found["wheel_speed_rad_s"].values[0, :, -1] == 0)
    momentum = found["z_to_momentum"].values[0]
    assert np.all((momentum > 0) & (momentum < np.pi / 2))


def test_predicted_rates_before_and_after_the_collision_agree_with_the_simulated_truth(craft):
    """One draw at the truth: 16:20 is as in the truth of the file, and what comes after is one of the three legs' many outcomes."""
    truth = AS_DRAWN_TRUTH
    tree, _ = philae_draws(400)
    found = predict_through_collision(craft, tree, [COLLISION, LATER], seed=3)
    assert (
        found["after_collision"].values.tolist() == [False, True]
        and "leg" in found.attrs["collision"]
    )
    before = found["omega_B"].values[0, :, 0]
    assert np.allclose(before, truth["collision_omega_before_B"], rtol=0, atol=2e-4)
    assert np.allclose(found["sun_B"].values[0, :, 0], truth["collision_sun_B"], rtol=0, atol=1e-3)
    after = found["rate"].values[0, :, 1]
    true = np.linalg.norm(
        truth["collision_omega_after_B"]
    )  # its size hardly changes once the wheel is at rest
    assert after.min() < true < after.max() and after.std() > 0.03
    again, other = (
        predict_through_collision(craft, tree, [LATER], seed=3),
        predict_through_collision(craft, tree, [LATER], seed=4),
    )
    assert np.array_equal(again["omega_B"].values[0, :, 0], found["omega_B"].values[0, :, 1])
    assert not np.array_equal(again["omega_B"].values, other["omega_B"].values)
    bounced = predict_through_collision(
        craft, tree, [COLLISION, LATER], seed=3, collision=Collision(restitution=0.3)
    )
    assert np.array_equal(bounced["omega_B"].values[0, :, 0], found["omega_B"].values[0, :, 0])
    assert (
        np.mean(np.abs(bounced["rate"].values[0, :, 1] - after) > 0.01) > 0.5
        and "0.3" in bounced.attrs["collision"]
    )


def test_without_a_known_collision_a_prediction_continues_the_flight(craft):
    tree, _ = philae_draws(2)
    del tree.attrs["epoch_utc"]
    found = predict_through_collision(craft, tree, [LATER])
    assert not found["after_collision"].values.any() and found.attrs["collision"].startswith("none")
    assert np.array_equal(found["omega_B"].values, predict(craft, tree, [LATER])["omega_B"].values)


def test_predicted_intervals_are_the_quantiles_of_the_draws(craft):
    tree, state = philae_draws(500, 0.003)
    table = {row["quantity"]: row for row in intervals(predict(craft, tree, [25200.0]))}
    expected = np.quantile(state.omega[:, 1], [0.05, 0.25, 0.5, 0.75, 0.95])
    got = [table["omega_y"][key] for key in ("low_90", "low_50", "median", "high_50", "high_90")]
    assert np.allclose(got, expected, rtol=0, atol=1e-9) and table["omega_y"]["unit"] == "rad/s"
    assert table["sun_off"]["high_90"] < 1e-6  # all draws have one direction at the first sample
    assert table["rate"]["median"] == pytest.approx(
        np.median(np.linalg.norm(state.omega, axis=1)), abs=1e-9
    )


@pytest.mark.parametrize("times", [[], [np.nan], [25200.0 + 8 * 86400]])
def test_predictions_at_invalid_times_are_refused(craft, times):
    with pytest.raises(InputError, match="times to predict must be numbers, at most a week"):
        predict(craft, philae_draws(1)[0], times)


def test_a_prediction_with_another_vehicle_is_refused(craft):
    heavier = replace(craft, inertia_kg_m2=1.1 * np.array(craft.inertia_kg_m2))
    with pytest.raises(InputError, match="not of this vehicle"):
        predict(heavier, philae_draws(1)[0], [LATER])


def test_a_prediction_is_saved_drawn_and_summarised(craft, tmp_path):
    from sunspin.cli.values import parse_times
    from sunspin.landing.predictions import add_predictions
    from sunspin.output.kinds.predictions import predicted_figure, predictions_summary

    tree, _ = philae_draws(50, 0.003)
    asked = parse_times("16:20,2014-11-12T17:25, 25300", tree.attrs["epoch_utc"])
    assert list(asked) == [25300.0, COLLISION, LATER]
    add_predictions(craft, tree, asked, 0)
    told = predictions_summary(tree["predictions"].to_dataset())
    assert len(told["predicted"]) == 30 and json.dumps(told)
    text = str(told)
    assert "at 2014-11-12T17:25 UTC, after the collision" in text and "angular speed 27." in text
    figure = predicted_figure(tree["predictions"].to_dataset(), list(asked.values()))
    assert "synthetic" in figure.get_suptitle() and len(figure.axes) == 12
    with pytest.raises(InputError, match="no epoch"):
        parse_times("16:20", None)
    with pytest.raises(InputError, match="ISO-8601"):  # taken to UTC it would lie before the year 1
        parse_times("0001-01-01T00:00:00+23:59", tree.attrs["epoch_utc"])
