"""`passes.csv`: a row for every solution of every pass, with the documented columns. The passes are made up."""

import warnings

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from sunspin.estimate.verdict import Answers, PassRow, Speed
from sunspin.estimate.verdict import passes_table as pass_variables
from sunspin.output.figures import axis_labels, render
from sunspin.output.folder import Contents, write_data, write_manifest
from sunspin.output.kinds.panels import health_lines
from sunspin.output.kinds.passes import pass_numbers, passes_table, solution_numbers
from sunspin.output.kinds.telemetry import signals_figure
from sunspin.output.text import number_text, range_text, set_text, size_text, with_range, with_sigma
from sunspin.vehicle.timeline import utc_after

COLUMNS = (
    "pass_id utc_start utc_end samples solution probability decided unique constrained_x constrained_y constrained_z fits "
    "search_complete columns_checked utc_at speed_low speed_median speed_high omega_x omega_y omega_z"
).split()


@pytest.fixture
def found():
    """A pass with two motions of which y is not constrained, and one that is decided."""
    sigma, speed_known = np.full((2, 3), 0.01), Speed(0.1, 0.01, 0.12)
    wide, narrow = (
        Answers(known, (True, known, True), True, True, (), "", speed_known)
        for known in (False, True)
    )
    omega = np.array([[0.0, 0.0, 0.1], [0.2, 0.0, 0.0]])
    speed, shares = np.array([[0.09, 0.1, 0.11], [0.19, 0.2, 0.21]]), np.array([0.7, 0.3])
    two = PassRow(9, 0.0, 80.0, 40.5, shares, omega, sigma, speed, wide, "as_stated")
    last = np.ones(1), omega[1:], sigma[1:], speed[1:]
    one = PassRow(5, 900.0, 980.0, 940.0, *last, narrow, "unchecked")
    return xr.Dataset(
        pass_variables([two, one], "2026-01-01T00:00:00Z"), {"pass_id": [3, 4]}, {"synthetic": 1}
    )


def test_passes_csv_has_a_row_for_each_solution_and_the_documented_columns(found, tmp_path):
    contents = Contents(tables=[passes_table(found)], synthetic=True)
    write_data(tmp_path, contents)
    write_manifest(tmp_path, {}, contents)
    text = (tmp_path / "passes.csv").read_text("utf-8")
    assert text.endswith("\n# synthetic telemetry\n")
    rows = pd.read_csv(tmp_path / "passes.csv", comment="#")
    assert list(rows)[: len(COLUMNS)] == COLUMNS
    assert rows["pass_id"].tolist() == [3, 3, 4] and rows["solution"].tolist() == [0, 1, 0]
    assert rows["decided"].tolist() == rows["constrained_y"].tolist() == [False, False, True]
    checked = rows["columns_checked"].tolist()
    assert rows["constrained_x"].all() and checked == ["as_stated", "as_stated", "unchecked"]
    later = "2026-01-01T00:15:40.000Z"
    assert rows["utc_at"].tolist() == [*["2026-01-01T00:00:40.500Z"] * 2, later]
    # read as one column: pandas takes the form of the first time for all
    for name in ("utc_start", "utc_end", "utc_at"):
        assert pd.to_datetime(rows[name]).notna().all()
    for name in COLUMNS[15:]:
        np.testing.assert_allclose(rows[f"{name}_deg_s"], np.degrees(rows[name]), rtol=1e-8)


@pytest.mark.parametrize("digits", [0, 1, 3])
def test_passes_csv_rounds_times_after_adding_the_epoch(digits):
    """The part of a second at which the file begins must not appear in a time that is printed to the second."""
    rng = np.random.default_rng(digits)
    for seconds, begin in zip(1e4 * rng.uniform(size=50), rng.integers(1000, size=50), strict=True):
        epoch = f"2026-03-04T10:00:00.{begin:03d}"
        text = utc_after(float(seconds), f"{epoch}Z", digits)
        off = np.datetime64(text.removesuffix("Z"), "us") - np.datetime64(epoch, "us")
        assert abs(off / np.timedelta64(1, "s") - seconds) <= 0.5 * 10.0**-digits + 1e-6
        assert len(text) == len("2026-03-04T10:00:00Z" if digits == 0 else f"{epoch}Z")


def test_the_summary_has_the_names_of_passes_csv(found):
    told = pass_numbers(found, 0) | solution_numbers(found, 0, 1)
    assert set(COLUMNS) <= set(told) and told["omega_x"] == 0.2
    assert told["omega_x_deg_s"] == pytest.approx(11.459, abs=1e-3) and told["decided"] is False
    assert told["why_not_decided"] == "several solutions; constrained: x z only"


def test_printed_numbers_have_no_minus_zero_and_a_fitting_unit():
    assert number_text([-0.0, -1e-9]) == "(0, -1e-09)"
    assert with_sigma(-0.0004, 0.1).startswith("0.00 ")
    assert with_sigma([-0.001, 0.2], [0.1, 0.0123], "deg/s") == "(0.00 ± 0.10, 0.200 ± 0.012) deg/s"
    assert with_sigma(6.4123e-8, 1.94e-9, "T") == "6.41e-08 ± 1.9e-09 T"
    assert with_sigma(8.44160005297, 9.2e-17, "deg/s") == "8.442 deg/s"  # equal runs
    assert with_sigma(0.0, 1e-17) == "0 ± 1e-17"
    assert with_sigma(1.5, np.nan) == "1.5" and with_sigma(1234.5678, 34.0) == "1235 ± 34"
    assert with_range(3.104, 3.02, 3.21) == "3.104 (3.020 to 3.210)"
    assert range_text(3.02, 3.21, sigma=0.2) == "3.02 to 3.21"
    assert with_range(3.0, 3.0, 3.0) == "3.000 (3.000 to 3.000)"
    assert number_text([[2], [2, 3]]) == "((2); (2, 3))"
    assert number_text([["2"], ["2", "3"]]) == "2; 2-3"
    assert number_text(True) == "yes" and number_text([None, False]) == "(none, no)"
    # sets of signed names
    assert set_text(("-X", "+Y", "-Y", "+Z")) == "-X, +Y, -Y, +Z"
    assert set_text(("2", "3", "6")) == "2-3-6"  # as the paper writes it
    assert number_text([["+X", "-Z"], ["-Y"]]) == "+X, -Z; -Y"
    # errors without an exponent
    assert size_text(1083.4) == "1080" and size_text(0.02) == "0.02" and size_text(12.0) == "12"
    assert size_text(2.5e-6) == "2.5e-06"


def test_impossible_illumination_patterns_are_printed_as_sets():
    many = {"impossible": {"-X, +Y, -Y": 3, "+X, -X": 1}, "explanations": []}
    many["noise_probability"] = {}
    line = health_lines(many)[0]
    assert "(-X, +Y, -Y) in 3 samples; (+X, -X) in 1 sample;" in line
    assert "2-3-6 (4)" in health_lines(many | {"impossible": {"2-3-6": 4}})[0]


def test_panels_in_figures_have_short_and_different_names():
    long = [f"{'solar_panel_' * 8}{k}" for k in range(3)] + ["+X"]
    labels = axis_labels(long)
    assert max(map(len, labels)) <= 14 and len(set(labels)) == 4 and labels[3] == "+X"
    alike = axis_labels([f"panel_{k}_of_the_solar_array" for k in range(3)])
    assert len(set(alike)) == 3


def test_long_names_of_panels_leave_room_for_the_axes():
    names = [f"{'x' * 97}{k:03d}" for k in range(8)]
    data = {"power_W": (("time", "panel"), np.ones((4, 8))), "flag": ("time", np.zeros(4))}
    attrs = {"kind": "telemetry", "epoch_utc": "2026-01-01T00:00:00Z"}
    telemetry = xr.Dataset(data, {"time": np.arange(4.0), "panel": names}, attrs)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        render(signals_figure(telemetry))
