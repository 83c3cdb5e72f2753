"""Columns that the motion contradicts are named, those that it confirms are not, and motions that look the same stay open."""

import numpy as np
import pytest

from sunspin.estimate.budget import Budget
from sunspin.estimate.columns import check_columns, clock_time
from sunspin.estimate.rates import rates
from sunspin.estimate.settings import RATES
from sunspin.telemetry.assess import assess
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


def test_times_are_clocks_on_the_day_of_the_epoch():
    epoch = "2026-01-01T00:00:00Z"
    assert clock_time(None, 61.4) == "61 s"
    assert clock_time(epoch, 61.0) == "00:01:01"
    assert clock_time(epoch, 86461.0).startswith("2026-01-02T00:01:01")
