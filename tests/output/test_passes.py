"""`passes.csv`: a row for every motion of every pass, with the columns that scripts outside read. The passes are made up."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from sunspin.estimate.passes import PassMotions, table
from sunspin.estimate.verdict import Misfit, answers
from sunspin.output.folder import Contents, write_contents
from sunspin.output.kinds.passes import motion_numbers, pass_numbers, passes_table
from sunspin.output.kinds.rate_words import RateAt
from sunspin.output.text import number_text, size_text, with_sigma
from sunspin.vehicle.timeline import utc_after

COLUMNS = [
    "pass_id",
    "utc_start",
    "utc_end",
    "samples",
    "mode",
    "weight",
    "decided",
    "unique",
    "informed_x",
    "informed_y",
    "informed_z",
    "fits",
    "search_complete",
    "wiring",
    "utc_at",
    "speed_low",
    "speed_median",
    "speed_high",
    "omega_x",
    "omega_y",
    "omega_z",
]


@pytest.fixture
def found():
    """A pass with two motions of which y is not informed, and one that is decided."""
    said = [
        answers(
            weight > 0.9,
            np.array([0.01, sigma, 0.01]),
            0.1,
            {"Sun": Misfit(9, 0.0, 1.0)},
            True,
            True,
        )
        for weight, sigma in ((0.7, 0.09), (1.0, 0.01))
    ]
    omega = np.array([[0.0, 0.0, 0.1], [0.2, 0.0, 0.0]])
    speed = np.array([[0.09, 0.1, 0.11], [0.19, 0.2, 0.21]])
    two = PassMotions(
        9,
        0.0,
        80.0,
        40.5,
        np.array([0.7, 0.3]),
        omega,
        np.full((2, 3), 0.01),
        speed,
        said[0],
        "as_stated",
    )
    one = PassMotions(
        5,
        900.0,
        980.0,
        940.0,
        np.ones(1),
        omega[1:],
        np.full((1, 3), 0.01),
        speed[1:],
        said[1],
        "unchecked",
    )
    return xr.Dataset(
        table([two, one], "2026-01-01T00:00:00Z"), {"pass_id": [3, 4]}, {"synthetic": 1}
    )


def test_every_motion_is_a_row_with_the_columns_that_scripts_read(found, tmp_path):
    contents = Contents(tables=[passes_table(found)], synthetic=True)
    write_contents(tmp_path, {}, contents)
    text = (tmp_path / "passes.csv").read_text("utf-8")
    assert text.startswith("# synthetic telemetry\n")
    rows = pd.read_csv(tmp_path / "passes.csv", comment="#")
    assert list(rows)[: len(COLUMNS)] == COLUMNS
    assert rows["pass_id"].tolist() == [3, 3, 4] and rows["mode"].tolist() == [0, 1, 0]
    assert rows["decided"].tolist() == [False, False, True] and rows["informed_y"].tolist() == [
        False,
        False,
        True,
    ]
    assert rows["informed_x"].all() and rows["wiring"].tolist() == [
        "as_stated",
        "as_stated",
        "unchecked",
    ]
    assert rows["utc_at"].tolist() == [
        *["2026-01-01T00:00:40.500Z"] * 2,
        "2026-01-01T00:15:40.000Z",
    ]
    for name in (
        "utc_start",
        "utc_end",
        "utc_at",
    ):  # read as one column: pandas takes the form of the first time for all
        assert pd.to_datetime(rows[name]).notna().all()
    for name in COLUMNS[15:]:
        np.testing.assert_allclose(rows[f"{name}_deg_s"], np.degrees(rows[name]), rtol=1e-8)


@pytest.mark.parametrize("digits", [0, 1, 3])
def test_a_time_is_rounded_and_not_the_seconds_since_the_epoch(digits):
    """The part of a second at which the file begins must not appear in a time that is printed to the second."""
    rng = np.random.default_rng(digits)
    for seconds, begin in zip(1e4 * rng.uniform(size=50), rng.integers(1000, size=50), strict=True):
        text = utc_after(float(seconds), f"2026-03-04T10:00:00.{begin:03d}Z", digits)
        off = np.datetime64(text.removesuffix("Z"), "us") - np.datetime64(
            f"2026-03-04T10:00:00.{begin:03d}", "us"
        )
        assert abs(off / np.timedelta64(1, "s") - seconds) <= 0.5 * 10.0**-digits + 1e-6
        assert len(text) == len(
            "2026-03-04T10:00:00Z" if digits == 0 else "2026-03-04T10:00:00.000Z"
        )


def test_the_summary_has_the_same_names(found):
    told = pass_numbers(found, 0) | motion_numbers(found, 0, 1)
    assert (
        set(COLUMNS) <= set(told)
        and told["omega_x"] == 0.2
        and told["omega_x_deg_s"] == pytest.approx(11.459, abs=1e-3)
    )
    assert (
        told["decided"] is False
        and told["why_not_decided"] == "several motions; informed: x z only"
    )


def test_numbers_are_read_without_a_minus_zero_and_sizes_in_a_fitting_unit():
    assert number_text([-0.0, -1e-9]) == "(0, -1e-09)" and with_sigma(-0.0004, 0.1).startswith(
        "0.00 "
    )
    at = RateAt(1.0, 1.0, 1.0, 0.0, np.array([-0.001, 0.2, 1.0]), np.full(3, 0.1))
    assert at.components == "(0.00, 0.20, 1.00) +- (0.10, 0.10, 0.10)"
    assert [size_text(n) for n in (12, 34_000, 5_200_000)] == ["0.1 kB", "34.0 kB", "5.2 MB"]
