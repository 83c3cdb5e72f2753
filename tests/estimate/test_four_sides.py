"""Panels on four sides: two full scales and both mirror images are searched, neither image is decided, and faults mislead none."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from sunspin.base.errors import InputError
from sunspin.estimate import one_pass
from sunspin.estimate.budget import Budget
from sunspin.estimate.chain import defects, equations, propagate
from sunspin.estimate.images import either_side, imaged, images_of
from sunspin.estimate.model import Noise, Track
from sunspin.estimate.rates import rates
from sunspin.estimate.settings import SearchSettings
from sunspin.estimate.terms.panels import SCALE_TOLERANCE
from tests.support.passes import OMEGA, stated_model, tumbling_pass
from tests.support.simulate import CUBE, FAULTS_OF_FOUR_SIDES, FOUR_SIDES, cube_with_faults

SEARCH = SearchSettings()


def nearest(result, run):
    """Return the error of the nearest solution's mean rate in its sigma (3), and its probability."""
    truth = run["omega_B"].sel(time=result["time"].values).values.mean(axis=0)
    away = truth - result["omega_mean_B"].values[0]
    k = np.nanargmin(np.linalg.norm(away, axis=1))
    return away[k] / result["omega_sigma_B"].values[0, k], result["probability"].values[0, k]


@pytest.mark.parametrize(("craft", "count"), [(FOUR_SIDES, 2), (CUBE, 1)])
def test_another_full_scale_is_searched_only_for_panels_in_one_plane(craft, count):
    """Readings 30 % too high everywhere: four sides may have a wrong scale, six show what full Sun is."""
    data, _ = cube_with_faults((), np.random.default_rng(3), craft)
    data = data.assign(power_W=1.3 * data["power_W"])
    panels = stated_model(craft, data).obs.terms[0]
    searched = panels.for_search()
    assert len(searched) == count
    if count == 2:
        ratio = searched[1].gain / searched[0].gain
        assert np.ptp(ratio) < 1e-12 and abs(ratio[0] - 1) >= SCALE_TOLERANCE
        stated = replace(panels, power=panels.power / 1.3)
        assert len(stated.for_search()) == 1


def test_a_full_scale_without_a_motion_leaves_the_search_to_the_other(monkeypatch):
    data, _ = cube_with_faults((), np.random.default_rng(3), FOUR_SIDES)
    model = stated_model(FOUR_SIDES, data.assign(power_W=1.3 * data["power_W"]))
    refuse = InputError("no rate takes the Sun there", do="raise the limit")

    def searched_with(*results):
        """Return the motions of a search in which the models in turn have these results."""
        monkeypatch.setattr(one_pass, "search", Mock(side_effect=results))
        return one_pass.search_motions(model, 1e-4, SEARCH, Budget(np.inf))

    motions = Track.unfitted(np.eye(3)[None, None], np.zeros((1, 1, 3)))
    motions = replace(motions, cost=np.zeros(1))
    assert len(searched_with(refuse, motions)) == len(searched_with(motions, refuse)) == 1
    with pytest.raises(InputError):
        searched_with(refuse, refuse)


def test_a_dead_string_is_not_taken_for_another_motion():
    """With all that is wrong with such files: the truth is near one of two mirror images, each with half the probability."""
    data, run = cube_with_faults(FAULTS_OF_FOUR_SIDES, np.random.default_rng(3), FOUR_SIDES)
    pull, probability = nearest(rates(FOUR_SIDES, data, max_rate_rad_s=0.15), run)
    assert np.abs(pull).max() < 3.5 and probability > 0.3


def imaged_motion(attitude):
    """Return the model of four sides, that of their search, a motion that begins with an attitude (3, 3), and its image."""
    model = stated_model(FOUR_SIDES, tumbling_pass(FOUR_SIDES, 20, 12.0, seed=2)[0], rate_sigma=0.1)
    loose = model.for_search(Noise(1e-4))[0]
    motion = propagate(loose, 0, attitude[None], OMEGA[None])
    return model, loose, motion, imaged(motion, images_of(model)[1])


def test_an_image_has_the_same_cost_and_obeys_the_equations():
    attitude, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    _, loose, motion, image = imaged_motion(attitude * np.sign(np.linalg.det(attitude)))
    assert np.allclose(np.linalg.det(image.attitude), 1.0)
    assert np.allclose(image.omega, motion.omega * [-1, -1, 1])
    assert np.isclose(equations(loose, image).cost[0], equations(loose, motion).cost[0], rtol=1e-9)
    assert np.abs(defects(loose, image)[0]).max() < 1e-6


def test_motions_that_see_the_sun_on_either_side_have_one_rate():
    motion = Track(np.eye(3)[None, None].repeat(4, 1), np.tile(OMEGA, (1, 4, 1)), np.zeros((1, 0)))
    other = Track(np.diag([1.0, -1.0, -1.0]) @ motion.attitude, motion.omega, motion.u)
    both = Track.joined([motion, other])
    both = replace(both, cost=np.zeros(2), covariance=np.tile(1e-6 * np.eye(6), (2, 4, 1, 1)))
    assert either_side(both).tolist() == [True, True]
    faster = replace(both, omega=both.omega * [[[1.0]], [[1.5]]])
    assert either_side(faster).tolist() == [True, False]


def test_both_images_are_listed_and_none_is_decided():
    data, run = tumbling_pass(FOUR_SIDES, 20, 12.0, seed=2)
    result = rates(FOUR_SIDES, data, max_rate_rad_s=0.15)
    pull, probability = nearest(result, run)
    assert np.abs(pull).max() < 4 and 0.4 < probability < 0.6
    assert not result["decided"].values.any() and not result["unique"].values.any()
