"""`sunspin reproduce`: its telemetry and vehicle, what it refuses, the figures of its summary."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import sunspin as ss
from sunspin.cli import cli
from sunspin.philae import reproduction
from sunspin.philae.rebound import read_truth
from sunspin.philae.row import read_tables

CASE = ss.load_case("philae")


@pytest.fixture(scope="module")
def summary(study: Path) -> dict:
    return json.loads((study / "summary.json").read_text("utf-8"))


SEVERAL_ENTRIES = {"line": "line_L1", "line_distance": "line_L1_distance"}
SEVERAL_ENTRIES |= {"angle": "angle_smaller", "rz_held": "rz_held_lines"}
"""Published figures with more than one entry of the comparison, and the first of these."""

LEFT_OUT = {
    # the step "precession": tests/philae/test_mechanics.py
    *("sun_height_lines", "axis_swing", "range_of_z_examples", "range_of_z_lines"),
    *("nutation_constant", "rz_peaks"),
    # the step "sensitivity": tests/philae/test_sensitivity.py
    *("E_map_rates", "E_map_parameters", "E_study_bound", "one_percent_E", "one_percent_emd"),
    *("phase_growth", "valley_width"),
    # the posterior of the samples: tests/philae/test_timing.py
    *("timed_rate_at_touchdown", "timed_rate_at_collision", "timed_rate_after_collision"),
}
"""Published figures of the steps that the small study leaves out."""


@pytest.mark.evidence("reproduce", "verified", "the list of published figures: none is passed over")
def test_each_published_figure_is_compared_or_marked_as_used(summary, reached):
    entries = {row["id"] for row in summary["figures"]}
    marked = {
        name for name, about in read_tables(CASE).items() if {"used", "compared"} & set(about)
    }
    compared = {name for name in read_tables(CASE) if SEVERAL_ENTRIES.get(name, name) in entries}
    assert set(read_tables(CASE)) - compared - marked == LEFT_OUT
    reached("published figures", len(CASE.published))


def test_the_motion_of_the_truth_has_the_collision_of_the_telemetry(study: Path):
    """Just after the collision its state is the one from which the samples after the collision were made, which are kept."""
    assert (study / "telemetry.csv").read_bytes() == (CASE.folder / "telemetry.csv").read_bytes()
    truth = read_truth(CASE)
    with xr.open_dataset(study / "motion-truth.nc") as motion:
        after = motion.sel(time=truth["collision_t_s"])
        for variable, key in (
            ("omega_B", "collision_omega_after_B"),
            ("sun_B", "collision_sun_B"),
            ("wheel_speed_rad_s", "collision_wheel_speed_after_rad_s"),
        ):
            np.testing.assert_allclose(after[variable], truth[key], rtol=1e-9)
        assert f"leg {truth['collision_leg']} hits" in motion.attrs["about"]


def test_telemetry_in_the_results_folder_is_refused_and_kept(tmp_path):
    """The folder is written anew: what a user changed there would be lost."""
    out = tmp_path / "out"
    out.mkdir()
    mine = out / "mine.csv"
    mine.write_bytes((CASE.folder / "telemetry.csv").read_bytes())
    with pytest.raises(ss.InputError, match="copy it to another place first"):
        reproduction.reproduce(out, mine)
    assert mine.is_file()


def test_telemetry_of_another_vehicle_is_refused_in_one_sentence(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = CliRunner()
    assert run.invoke(cli, ["init", "mine"]).exit_code == 0
    for words, error, said in (
        ("--telemetry mine/telemetry.csv", ss.TelemetryError, "column"),
        ("--vehicle mine/vehicle.toml", ss.InputError, "one wheel and legs"),
    ):
        with pytest.raises(error, match=said):
            run.invoke(cli, f"reproduce {words} --out out".split(), catch_exceptions=False)
    assert not Path("out").exists()


def test_a_vehicle_file_replaces_philae(tmp_path):
    """A heavier lander in a file of its own: the case has its inertia, and the telemetry is read with its columns."""
    text = (CASE.folder / "vehicle.toml").read_text("utf-8")
    path = tmp_path / "heavy.toml"
    path.write_text(text.replace("value = 97.63", "value = 120.0"), "utf-8")
    case, _ = reproduction._load_inputs(None, path, ())
    assert case.vehicle.mass_kg == 120.0 and case.telemetry.sizes == CASE.telemetry.sizes
    assert reproduction._hash_inputs(case, path)[1]["file"] == "heavy.toml"


def test_the_summary_of_the_study_has_the_documented_keys(summary):
    """API: the keys of each figure, null where nothing is judged, and the counts."""
    known = "version seed synthetic_telemetry seconds headline chain figures".split()
    assert set(known) <= set(summary)
    assert {"agree", "differ", "uninformative"} <= set(summary["counts"])
    keys = "id what published ours low high prior_low prior_high unit tolerance agrees".split()
    keys += "kind depends informative chain note source".split()
    kinds = ("test", "put_in", "arithmetic", "not_comparable")
    for row in summary["figures"]:
        assert set(keys) <= set(row) and row["kind"] in kinds, row["id"]
        assert row["depends"] in ("candidates", "data"), row["id"]
        assert isinstance(row["informative"], bool) and row["chain"], row["id"]
        if row["kind"] != "test" or not row["informative"]:
            assert row["agrees"] is None, row["id"]
        if row["depends"] == "data":
            assert row["prior_low"] is None and row["informative"], row["id"]
        else:
            assert row["chain"] == "scan", row["id"]
            assert row["prior_low"] is not None and row["prior_high"] is not None, row["id"]
    here = summary["counts"]
    assert here["agree"] + here["differ"] < 15
    judged = [row for row in summary["figures"] if row["agrees"] is not None]
    every = here, here["without_telemetry"], here["paper"]
    assert sum(part["agree"] + part["differ"] for part in every) == len(judged)


def test_input_figures_are_marked_and_neither_agree_nor_differ(summary):
    put_in = {row["id"] for row in summary["figures"] if row["kind"] == "put_in"}
    names = "delta_mean delta_max descent_rate_cubic samples_after_collision spin_down_coefficients"
    assert set(names.split()) <= put_in
    assert put_in == {name for name, about in read_tables(CASE).items() if "put_in" in about}
    for row in (row for row in summary["figures"] if row["kind"] == "put_in"):
        assert row["agrees"] is None and (row["holds"] is not None or not row["informative"])
    # the built-in file was selected for these
    assert {"emd_min", "lines_found", "rate_at_touchdown_min", "sun_height_range"} <= put_in
    assert not {"wheel_stop", "line_L1_distance", "descent_behind"} & put_in


def test_no_tolerance_is_half_of_its_figure_or_more(summary):
    """A tolerance of half of the figure or more would pass nearly whatever this run found."""
    agreed = [row for row in summary["figures"] if row["agrees"] and row["tolerance"]]
    numbers = [row for row in agreed if {type(row["ours"]), type(row["published"])} == {float}]
    assert not [row["id"] for row in numbers if row["tolerance"] >= abs(row["published"]) / 2]
