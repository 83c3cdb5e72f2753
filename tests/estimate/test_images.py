"""Mirror images: panels in one plane read the same in them, both are listed, and neither is decided."""

from dataclasses import replace

import numpy as np

from sunspin.estimate.chain import carried, defects, equations
from sunspin.estimate.images import either_side, imaged, images_of, with_images
from sunspin.estimate.model import Body, Model, Noise, Track
from sunspin.estimate.observe import observe
from sunspin.estimate.rates import rates
from sunspin.estimate.settings import SearchSettings
from sunspin.telemetry.assess import assess
from tests.estimate.test_four_sides import nearest
from tests.support.simulate import FOUR_SIDES, simulated_pass, uneven_times

OMEGA = np.array([0.02, -0.03, 0.04])


def seen(vehicle=FOUR_SIDES):
    """Return the model of a pass of panels on four sides, its telemetry and the truth."""
    rng = np.random.default_rng(2)
    data, run = simulated_pass(vehicle, OMEGA, uneven_times(rng, 20, 12.0, 0.2), rng, albedo=0.0)
    obs = observe(assess(vehicle, data)).obs
    model = Model(obs, Body.of(vehicle), Noise(1e-4), 0.1)
    return model, data, run


def test_an_image_has_the_same_cost_and_obeys_the_equations():
    model, *_ = seen()
    loose = model.for_search(Noise(1e-4))[0]
    rng = np.random.default_rng(1)
    attitude, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    attitude *= np.sign(np.linalg.det(attitude))
    motion = carried(loose, 0, attitude[None], OMEGA[None])
    image = imaged(motion, images_of(model)[1])
    assert np.allclose(np.linalg.det(image.attitude), 1.0)
    assert np.allclose(image.omega, motion.omega * [-1, -1, 1])
    assert np.isclose(equations(loose, image).cost[0], equations(loose, motion).cost[0], rtol=1e-9)
    assert np.abs(defects(loose, image)[0]).max() < 1e-6


def test_each_motion_gets_its_image_once():
    model, *_ = seen()
    loose = model.for_search(Noise(1e-4))[0]
    motion = carried(loose, 0, np.eye(3)[None], OMEGA[None])
    both = Track.joined([motion, imaged(motion, images_of(model)[1])])
    assert len(with_images(motion, model, SearchSettings())) == 2
    # the second is an image of the first
    assert len(with_images(both, model, SearchSettings())) == 3


def test_motions_that_see_the_sun_on_either_side_have_one_rate():
    motion = Track(np.eye(3)[None, None].repeat(4, 1), np.tile(OMEGA, (1, 4, 1)), np.zeros((1, 0)))
    other = Track(np.diag([1.0, -1.0, -1.0]) @ motion.attitude, motion.omega, motion.u)
    both = Track.joined([motion, other])
    both = replace(both, cost=np.zeros(2), covariance=np.tile(1e-6 * np.eye(6), (2, 4, 1, 1)))
    assert either_side(both).tolist() == [True, True]
    faster = replace(both, omega=both.omega * [[[1.0]], [[1.5]]])
    assert either_side(faster).tolist() == [True, False]


def test_both_images_are_listed_and_none_is_decided():
    _, data, run = seen()
    result = rates(FOUR_SIDES, data, max_rate_rad_s=0.15)
    pull, probability = nearest(result, run)
    assert np.abs(pull).max() < 4 and 0.4 < probability < 0.6
    assert not result["decided"].values.any() and not result["unique"].values.any()
