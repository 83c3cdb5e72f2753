"""Exchanged columns of a file that fits, which the motion distinguishes; and motions that look the same, which stay open."""

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from sunspin.estimate.budget import Budget
from sunspin.estimate.column_tests import (
    SampleCosts,
    gain_in_evidence,
    gains_of_silent_inputs,
)
from sunspin.estimate.columns import SAMPLES_CONTRADICT, check_columns, clock_time, estimators_of
from sunspin.estimate.equivalence import AS_WRITTEN, exchange
from sunspin.estimate.rates import rates
from sunspin.estimate.settings import RATES
from sunspin.estimate.verdict import COLUMNS_UNCHECKED, rates_words
from sunspin.telemetry.assess import assess
from tests.support.passes import estimate, printed_rates, tumbling_pass
from tests.support.simulate import FOUR_SIDES
from validation.exchanges import draw_satellite, files
from validation.passes import make

CASE = "exchanged, six panels", 0, 12
"""A body that turns about z with the Sun near -z; the columns of -x and -y are exchanged."""

HIDDEN = 7, 1
"""A satellite with a wheel and five panels, three of them lit; with +Z and -X exchanged its file fits a motion 74 sigma off."""


@pytest.fixture(scope="module")
def spinner():
    return make(*CASE)


def of_satellite(number, order):
    """Return a drawn satellite, and the result of its file with the columns in another order."""
    craft = draw_satellite(*number)
    vehicle, data = files(craft, np.array(order), craft.momenta)
    return craft, rates(vehicle, data, max_rate_rad_s=0.09)


def fits_and_names(result, why="columns, signs or axes") -> dict:
    """Return by name the changes that a result names, which fits and is not decided for the reason `why`."""
    assert result["fits"].values.all() and not result["decided"].values.any()
    assert why in str(result["why_not_decided"].values[0])
    return {change["what"]: change for change in json.loads(result.attrs["columns_changes"])}


def is_not_accused(result) -> bool:
    return bool(result["decided"].values.all()) and "columns_doubt" not in result.attrs


@pytest.mark.slow
def test_exchanged_columns_are_named_where_reversed_wheels_fit_better_than_the_file():
    """The file fits, and with its wheel reversed it fits better; with +Y and +Z as they were it fits better still."""
    _, result = of_satellite((7, 25), [0, 2, 1, 3, 4])
    assert set(fits_and_names(result)) == {"the columns of panels +Y and +Z exchanged"}


def test_exchanged_dark_columns_are_named_with_the_true_rate_though_the_file_fits(spinner):
    named = fits_and_names(estimate(spinner))
    right = named.pop("the columns of panels -x and -y exchanged")
    at = np.argmin(np.abs(spinner.telemetry["time"].values - right["at_s"]))
    np.testing.assert_allclose(right["omega_deg_s"], np.degrees(spinner.omega[at]), atol=0.3)
    # the mirror of that motion, with the columns that look the same, is all else that is named
    assert set(named) == {"the columns of panels +x and +y exchanged"}


def test_a_right_file_with_dark_columns_is_not_accused(spinner):
    power = spinner.telemetry["power_W"].values[:, [0, 1, 2, 4, 3, 5]]
    right = spinner.telemetry.assign(power_W=(("time", "panel"), power))
    result = estimate(spinner._replace(telemetry=right))
    assert is_not_accused(result)
    off = printed_rates(result)[0][0] - spinner.omega[len(spinner.omega) // 2]
    assert np.degrees(np.linalg.norm(off)) < 0.5


@pytest.mark.parametrize(
    ("gain", "wider", "expected"),
    [(6.0, -2.0, 4.0), (2.6, 4.5, 2.6), (-2.6, -4.5, -2.6), (25.0, -42.0, 0.0)],
)
def test_the_sigmas_of_readings_make_no_columns_better(gain, wider, expected):
    changed, written = (
        xr.Dataset(attrs={"log_evidence": [evidence], "log_sigmas": [sigmas]})
        for evidence, sigmas in ((400.0 + gain, -500.0 + wider), (400.0, -500.0))
    )
    assert gain_in_evidence(changed, written) == pytest.approx(expected)


def test_a_right_file_of_a_slow_body_is_decided_though_other_columns_have_more_evidence():
    """With two columns exchanged the log evidence is 25 higher, as less light of the Earth is seen; without the sigmas 17 lower."""
    assert is_not_accused(estimate(make("slow, wide range", 31, 15)))


def test_tests_of_dark_columns_that_the_budget_stopped_are_said(spinner):
    """A file that fits, so that nothing but its dark columns is tried."""

    def fail(*_):
        raise AssertionError("estimated without a budget")

    as_given = assess(spinner.vehicle, spinner.telemetry)
    result = estimate(spinner, column_tests=False, effort=1e-6)
    result = result.assign({name: ("pass_id", [True]) for name in ("fits", "decided")})
    checked = check_columns(result, as_given, None, fail, RATES, Budget(0.0))
    assert "column_tests_cut" not in result.attrs
    assert checked.attrs["column_tests_cut"] == 1
    assert "not every other order of columns was tried" in rates_words(checked)


def test_of_several_passes_the_samples_of_the_longest_decided_one_choose_the_columns(
    spinner, monkeypatch
):
    """The longest pass is not decided, and its samples would allow other columns."""
    whole = spinner.telemetry
    part = whole.isel(time=slice(16)).assign_coords(time=whole["time"].values[:16] + 1e5)
    data = xr.concat([whole, part], "time")
    assessment = assess(spinner.vehicle, data)
    options = {"max_rate_rad_s": spinner.max_rate_rad_s, "column_tests": False, "effort": 1e-6}
    result = rates(spinner.vehicle, assessment, **options)
    assert result["samples"].values.tolist() == [24, 16]
    asked = []
    monkeypatch.setattr(
        "sunspin.estimate.columns.rival_exchanges", lambda *given: asked.append(given[1:3]) or []
    )
    for decided in ([True, True], [False, True]):
        known = result.assign(decided=("pass_id", decided), fits=("pass_id", [True, True]))
        check_columns(known, assessment, None, rates, RATES, Budget(1.0))
    for samples, (compared, costs) in zip((24, 16), asked, strict=True):
        assert compared.sizes["time"] == samples
        expected = SampleCosts.of(spinner.vehicle, compared)
        assert costs.as_written == expected.as_written
        np.testing.assert_array_equal(costs.of_changes, expected.of_changes)


def test_exchanged_lit_columns_are_named_with_the_true_rate_though_the_file_fits():
    craft, result = of_satellite(HIDDEN, [0, 2, 1, 3, 4])
    right = fits_and_names(result)["the columns of panels +Z and -X exchanged"]
    at = np.argmin(np.abs(craft.t_s - right["at_s"]))
    np.testing.assert_allclose(right["omega_deg_s"], np.degrees(craft.omega[at]), atol=0.1)


def test_a_right_file_whose_columns_without_a_signal_are_left_out_is_not_accused():
    """Two columns read next to nothing. One of them would be left out if they were exchanged, and both are in the right file."""
    craft, result = of_satellite((7, 0), range(8))
    vehicle, data = files(craft, np.arange(8), craft.momenta)
    assert gains_of_silent_inputs(vehicle, data, AS_WRITTEN) == [1.0, 2.0]
    assert gains_of_silent_inputs(vehicle, data, exchange(vehicle, 3, 6)) == [2.0]
    assert is_not_accused(result)


def test_a_pass_is_not_decided_if_two_faint_columns_fit_better_exchanged():
    """With +X and W1a exchanged a glint of 6 % moves the rate to 5.6 sigma off; the right columns fit better by 3.5."""
    _, result = of_satellite((7, 0), (6, 1, 2, 3, 4, 5, 0, 7))
    assert not result["decided"].values.any()
    assert "the columns of panels +X and W1a exchanged" in result.attrs["columns_doubt"]


def test_a_pass_is_not_decided_if_other_columns_fit_a_little_better():
    """With +Y and -X exchanged a cube without a wheel fits a motion 42 sigma off, worse by 6 in log evidence."""
    _, result = of_satellite((7, 58), [2, 1, 0, 3, 4])
    assert not result["decided"].values.any()
    assert result["columns_checked"].values.tolist() == [COLUMNS_UNCHECKED]
    words = "the data fit as well with the columns of panels +Y and -X exchanged: find out which"
    assert words in result.attrs["verdict"] and "CHECK" not in result.attrs["verdict"]


def test_with_the_columns_that_fit_a_little_better_the_pass_is_decided_along_the_truth():
    """The advice is to find out which columns are right: those of the simulator are."""
    craft, result = of_satellite((7, 58), range(5))
    assert is_not_accused(result)
    (omega, *_), (sigma, *_) = printed_rates(result)
    middle_s = (craft.t_s[0] + craft.t_s[-1]) / 2
    truth = craft.omega[np.argmin(np.abs(craft.t_s - middle_s))]
    assert (np.abs(omega - truth) < 4 * sigma).all()


@pytest.mark.parametrize(
    ("number", "exchanged"),
    [pytest.param((101, 1), (2, 5), marks=pytest.mark.slow), ((103, 5), (1, 4))],
)
def test_opposite_columns_exchanged_on_a_satellite_with_a_wheel_are_named(number, exchanged):
    """The reversed wheel looks the same, and its motion is within the errors of the file's, which strong torques make large.

    With these columns exchanged the file fits under 0.003 rad/s^1.5 along a motion 11 or 21 sigma off. With its wheel reversed the
    log evidence is higher by more than 130.
    """
    order = np.arange(len(draw_satellite(*number).names))
    order[list(exchanged)] = order[list(exchanged)][::-1]
    craft, result = of_satellite(number, order)
    named = fits_and_names(result, "the sign of a wheel")
    a, b = (craft.names[k] for k in exchanged)
    right = named[f"the columns of panels {a} and {b} exchanged"]
    assert "wheel wheel 0 turning the other way" in named
    at = np.argmin(np.abs(craft.t_s - right["at_s"]))
    np.testing.assert_allclose(right["omega_deg_s"], np.degrees(craft.omega[at]), atol=0.1)


def test_a_pass_is_not_decided_if_other_columns_have_a_tenth_of_the_probability():
    """With +Z and -Z exchanged a motion is 177 sigma off; the right columns are better by 2.3 in a quick search, by 4.6 in all."""
    _, result = of_satellite((11, 30), [0, 3, 2, 1, 4, 5])
    assert not result["decided"].values.any()
    assert "the columns of panels +Z and -Z exchanged" in result.attrs["columns_doubt"]


def test_other_columns_that_fit_a_little_worse_are_said_and_the_pass_is_decided():
    """The right file of that satellite."""
    _, result = of_satellite((11, 30), range(6))
    assert is_not_accused(result) and result["columns_checked"].values[0] == COLUMNS_UNCHECKED
    words = "about as well with the columns of panels +Z and -Z exchanged: omega ("
    assert words in result.attrs["columns_rivals"] and words in result.attrs["verdict"]


def test_the_log_evidence_of_a_pass_does_not_depend_on_the_order_of_its_panels():
    craft = draw_satellite(11, 30)
    vehicle, data = files(craft, np.arange(6), craft.momenta)
    order = [3, 5, 0, 1, 4, 2]
    panels = tuple(vehicle.panels[k] for k in order)
    reordered = replace(vehicle, panels=panels), data.isel(panel=order)
    options = {"max_rate_rad_s": 0.09, "column_tests": False}
    both = [rates(*file, **options) for file in ((vehicle, data), reordered)]
    evidences = [result.attrs["log_evidence"][0] for result in both]
    assert evidences[0] == pytest.approx(evidences[1], abs=0.1)


def test_samples_that_deny_the_columns_leave_a_pass_undecided_without_column_tests():
    """A motion fits a slow pass with two exchanged columns, but the samples, each by itself, do not fit the panels.

    The advice is to estimate with these tests, which is the default: they name the exchange.
    """
    simulated = make("columns exchanged", 7, 4)
    result = estimate(simulated, column_tests=False)
    assert result["fits"].values.all() and not result["decided"].values.any()
    assert SAMPLES_CONTRADICT in str(result["why_not_decided"].values[0])
    assert "estimate without `--no-column-tests`" in result.attrs["columns_doubt"]
    tested = estimate(simulated)
    named = [change["what"] for change in json.loads(tested.attrs["columns_changes"])]
    assert f"the columns of panels {' and '.join(simulated.exchanged)} exchanged" in named


def test_other_columns_are_searched_as_far_as_the_file_as_it_is_written(monkeypatch):
    """A largest rate that nobody stated stays so; a solution beyond it extends the quick searches of other columns too."""
    asked = []

    def unchanged(result, assessment, doubt, *how):
        asked.extend(how)
        return result

    monkeypatch.setattr("sunspin.estimate.rates.check_columns", unchanged)
    monkeypatch.setattr("sunspin.estimate.columns.quick_evidence", lambda model, *_: model.rate_max)
    data, _ = tumbling_pass(FOUR_SIDES, 10, 60.0, seed=4)
    result = rates(FOUR_SIDES, data, effort=1e-6)
    again, settings, budget = asked
    assert again.keywords["max_rate_rad_s"] is None
    limit = result.attrs["max_rate_rad_s"]
    for factor, reach in ((0.9, limit), (1.5, 2.0 * limit)):
        rate = np.full(result["omega_x"].shape, factor * limit)
        faster = result.assign(
            omega_x=(result["omega_x"].dims, rate), omega_y=0 * result["omega_x"], omega_z=0.0
        )
        estimators = estimators_of(faster, again, settings, budget)
        assert estimators.evidence(FOUR_SIDES, data) == pytest.approx(reach)


def test_a_motion_whose_mirror_image_is_not_listed_is_not_decided():
    """Panels on four sides list both images; with one of them taken away the pass must not become unique."""
    data, _ = tumbling_pass(FOUR_SIDES, 12, 12.0, seed=4)
    result = rates(FOUR_SIDES, data, max_rate_rad_s=0.15)
    assert result.sizes["solution"] >= 2 and result.attrs["symmetric_unlisted"] == 0
    yes, no_words = ("pass_id", [True]), ("pass_id", [""])
    alone = result.isel(solution=[0]).assign(unique=yes, decided=yes, why_not_decided=no_words)
    checked = check_columns(alone, assess(FOUR_SIDES, data), None, None, RATES, Budget(np.inf))
    assert checked.attrs["symmetric_unlisted"] == 1
    assert not checked["unique"].values.any() and not checked["decided"].values.any()


def test_times_are_clocks_on_the_day_of_the_epoch():
    epoch = "2026-01-01T00:00:00Z"
    assert clock_time(None, 61.4) == "61 s"
    assert clock_time(epoch, 61.0) == "00:01:01"
    assert clock_time(epoch, 86461.0).startswith("2026-01-02T00:01:01")
