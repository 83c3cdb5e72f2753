"""Panels on four sides, whose brightness does not show full sunlight: two full scales are searched, and faults mislead none."""

from dataclasses import replace

import numpy as np
import pytest

from sunspin.estimate.observe import observe
from sunspin.estimate.rates import rates
from sunspin.estimate.terms.panels import OTHER_SCALE
from sunspin.telemetry.assess import assess
from tests.support.simulate import CUBE, FAULTS_OF_FOUR_SIDES, FOUR_SIDES, cube_with_faults


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
    panels = observe(assess(craft, data)).obs.terms[0]
    searched = panels.for_search()
    assert len(searched) == count
    if count == 2:
        ratio = searched[1].gain / searched[0].gain
        assert np.ptp(ratio) < 1e-12 and abs(ratio[0] - 1) >= OTHER_SCALE
        stated = replace(panels, power=panels.power / 1.3)
        assert len(stated.for_search()) == 1


@pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.long)])
def test_a_dead_string_is_not_taken_for_another_motion(seed):
    """With all that is wrong with such files: the truth is near one of two mirror images, each with half the probability."""
    data, run = cube_with_faults(FAULTS_OF_FOUR_SIDES, np.random.default_rng(seed), FOUR_SIDES)
    pull, probability = nearest(rates(FOUR_SIDES, data, max_rate_rad_s=0.15), run)
    assert np.abs(pull).max() < 3.5 and probability > 0.3
