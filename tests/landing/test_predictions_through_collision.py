"""Predictions of a posterior through the collision of the built-in case."""

from __future__ import annotations

import numpy as np
import pytest

from sunspin.estimate.lander.predict import predict
from sunspin.landing.predictions import predict_through_collision
from sunspin.vehicle import Vehicle
from sunspin.vehicle.assumptions import Collision
from tests.support.philae import AS_DRAWN, AS_DRAWN_TRUTH, philae_draws

COLLISION, LATER = 27900.0, 31800.0


@pytest.fixture(scope="module")
def craft() -> Vehicle:
    """Return Philae with panels exactly as drawn."""
    return AS_DRAWN.vehicle


def test_predicted_rates_before_and_after_the_collision_agree_with_the_simulated_truth(craft):
    """Draws at the truth: 16:20 is as in the truth of the file, and what comes after is one of the three legs' many outcomes."""
    truth = AS_DRAWN_TRUTH
    tree = philae_draws(400)
    predicted = predict_through_collision(craft, tree, [COLLISION, LATER], seed=3)
    assert predicted["after_collision"].values.tolist() == [False, True]
    assert "leg" in predicted.attrs["collision"]
    before, sun = predicted["omega_B"].values[0, :, 0], predicted["sun_B"].values[0, :, 0]
    expected = np.tile(truth["collision_omega_before_B"], (400, 1))
    np.testing.assert_allclose(before, expected, rtol=0, atol=2e-4)
    np.testing.assert_allclose(sun, np.tile(truth["collision_sun_B"], (400, 1)), rtol=0, atol=1e-3)
    # the angular speed hardly changes once the wheel is at rest
    after = predicted["rate"].values[0, :, 1]
    true = np.linalg.norm(truth["collision_omega_after_B"])
    assert after.min() < true < after.max() and after.std() > 0.03
    runs = (predict_through_collision(craft, tree, [LATER], seed=seed) for seed in (3, 4))
    again, other = (run["omega_B"].values[0, :, 0] for run in runs)
    np.testing.assert_array_equal(again, predicted["omega_B"].values[0, :, 1])
    assert not np.array_equal(again, other)
    law = Collision(restitution=0.3)
    bounced = predict_through_collision(craft, tree, [COLLISION, LATER], seed=3, collision=law)
    np.testing.assert_array_equal(bounced["omega_B"].values[0, :, 0], before)
    assert np.mean(np.abs(bounced["rate"].values[0, :, 1] - after) > 0.01) > 0.5
    assert "0.3" in bounced.attrs["collision"]


def test_without_a_known_collision_a_prediction_continues_the_flight(craft):
    tree = philae_draws(2)
    del tree.attrs["epoch_utc"]
    predicted = predict_through_collision(craft, tree, [LATER])
    assert not predicted["after_collision"].values.any()
    assert predicted.attrs["collision"].startswith("none")
    expected = predict(craft, tree, [LATER])["omega_B"].values
    np.testing.assert_array_equal(predicted["omega_B"].values, expected)
