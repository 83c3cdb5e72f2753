"""Columns that the motion contradicts are named, those that it confirms are not, and motions that look the same stay open."""

import json
from dataclasses import replace

import numpy as np
import pytest

from sunspin.estimate.budget import Budget
from sunspin.estimate.columns import check_columns, clock_time
from sunspin.estimate.rates import rates
from sunspin.estimate.settings import RATES
from sunspin.estimate.verdict import COLUMNS_UNCHECKED, alike_motions
from sunspin.telemetry.assess import assess
from sunspin.vehicle import Channel
from tests.support.simulate import CUBE, FOUR_SIDES, simulated_pass, uneven_times

OMEGA = np.array([0.02, -0.03, 0.04])


def seen(craft=CUBE, order=None):
    """Return telemetry of a pass, its columns in another order, and the truth."""
    rng = np.random.default_rng(4)
    data, run = simulated_pass(craft, OMEGA, uneven_times(rng, 24, 12.0, 0.2), rng, albedo=0.0)
    if order is not None:
        data = data.assign(power_W=(("time", "panel"), data["power_W"].values[:, order]))
    return data, run


@pytest.fixture(scope="module")
def exchanged():
    """Return a result of a file with the columns of +x and +y exchanged, and the truth."""
    data, run = seen(order=[1, 0, 2, 3, 4, 5])
    return rates(CUBE, data, max_rate_rad_s=0.15, column_tests=True), run


def test_two_exchanged_columns_are_named_with_the_true_rate(exchanged):
    result, run = exchanged
    assert not result["decided"].values.any()
    assert result["columns_checked"].values.tolist() == ["doubtful"]
    assert "columns, signs or axes" in str(result["why_not_decided"].values[0])
    (named,) = json.loads(result.attrs["columns_changes"])
    assert named["what"] == "the columns of panels +x and +y exchanged"
    assert "CHECK THE COLUMNS" in result.attrs["verdict"]
    at = np.argmin(np.abs(run["time"].values - named["at_s"]))
    truth = np.degrees(run["omega_B"].values[at])
    np.testing.assert_allclose(named["omega_deg_s"], truth, atol=0.1)


def test_a_file_that_fits_is_not_accused_and_its_mirrors_stay_unchecked():
    data, _ = seen()
    result = rates(CUBE, data, max_rate_rad_s=0.15, column_tests=True)
    assert result["decided"].values.all() and "columns_doubt" not in result.attrs
    assert result["columns_checked"].values.tolist() == [COLUMNS_UNCHECKED]
    unseen = {one["what"] for one in json.loads(result.attrs["columns_unseen"])}
    assert unseen == {f"the columns of panels +{a} and -{a} exchanged" for a in "xyz"}


def test_a_motion_whose_mirror_image_is_not_listed_is_not_decided():
    """Panels on four sides list both images; with one of them taken away the pass must not become unique."""
    data, _ = seen(FOUR_SIDES)
    result = rates(FOUR_SIDES, data, max_rate_rad_s=0.15)
    assert result.sizes["solution"] >= 2 and result.attrs["symmetric_unlisted"] == 0
    alone = result.isel(solution=[0]).assign(
        unique=("pass_id", [True]), decided=("pass_id", [True]), why_not_decided=("pass_id", [""])
    )
    checked = check_columns(
        alone, assess(FOUR_SIDES, data), None, None, False, RATES, Budget(np.inf)
    )
    assert checked.attrs["symmetric_unlisted"] == 1
    assert not checked["unique"].values.any() and not checked["decided"].values.any()


def test_shared_inputs_have_symmetric_solutions_and_say_so():
    assert alike_motions(CUBE) == ""
    channels = (Channel("x", ("+x", "-x"), "sum"),)
    words = alike_motions(replace(CUBE, channels=channels))
    assert (
        words.startswith("input x do not show which panel is lit") or "a mirror solution" in words
    )


def test_times_are_clocks_on_the_day_of_the_epoch():
    epoch = "2026-01-01T00:00:00Z"
    assert clock_time(None, 61.4) == "61 s"
    assert clock_time(epoch, 61.0) == "00:01:01"
    assert clock_time(epoch, 86461.0).startswith("2026-01-02T00:01:01")
