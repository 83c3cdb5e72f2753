"""The command `reproduce` at its borders: whose telemetry and vehicle it takes, what it refuses before any work."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

import sunspin as ss
from sunspin.cli import cli
from sunspin.philae import reproduction

CASE = ss.load_case("philae")


def test_the_telemetry_used_is_written_to_copy_and_change(study: Path):
    assert (study / "telemetry.csv").read_bytes() == (CASE.folder / "telemetry.csv").read_bytes()


def test_telemetry_in_the_results_folder_is_refused_and_kept(tmp_path):
    """The folder is written anew: what a user changed there would be lost."""
    out = tmp_path / "out"
    out.mkdir()
    mine = out / "mine.csv"
    mine.write_bytes((CASE.folder / "telemetry.csv").read_bytes())
    with pytest.raises(ss.InputError, match="copy it to another place first"):
        reproduction.reproduce(out, mine)
    assert mine.is_file()


def test_another_vehicles_file_is_refused_in_a_sentence(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = CliRunner()
    assert run.invoke(cli, ["init", "mine"]).exit_code == 0
    with pytest.raises(ss.TelemetryError, match="column"):
        run.invoke(cli, ["reproduce", "--telemetry", "mine/telemetry.csv", "--out", "out"], catch_exceptions=False)
    with pytest.raises(ss.InputError, match="one wheel and legs"):
        run.invoke(cli, ["reproduce", "--vehicle", "mine/vehicle.toml", "--out", "out"], catch_exceptions=False)
    assert not Path("out").exists()


def test_another_body_takes_the_place_of_philae(tmp_path):
    """A heavier lander in a file of its own: the case has its inertia, and the telemetry is read with its columns."""
    text = (CASE.folder / "vehicle.toml").read_text("utf-8").replace("value = 97.63", "value = 120.0")
    path = tmp_path / "heavy.toml"
    path.write_text(text, "utf-8")
    case = reproduction._case(None, path)
    assert case.vehicle.mass_kg == 120.0 and case.telemetry.sizes == CASE.telemetry.sizes
    assert reproduction._inputs(case, path)[1]["file"] == "heavy.toml"


def test_the_summary_has_the_public_form(study: Path):
    """API: the keys of each figure, null where nothing is judged, and the counts."""
    summary = json.loads((study / "summary.json").read_text("utf-8"))
    assert {"version", "seed", "synthetic_telemetry", "seconds", "headline", "chain", "figures"} <= set(summary)
    assert {"agree", "differ", "uninformative"} <= set(summary["counts"])
    keys = {"id", "what", "published", "ours", "low", "high", "prior_low", "prior_high", "unit", "tolerance", "agrees", "kind",
            "depends", "informative", "chain", "note", "source"}  # fmt: skip
    for row in summary["figures"]:
        assert keys <= set(row) and row["kind"] in ("test", "put_in", "arithmetic", "not_comparable"), row["id"]
        assert row["depends"] in ("candidates", "data") and isinstance(row["informative"], bool) and row["chain"], row["id"]
        if row["kind"] != "test" or not row["informative"]:
            assert row["agrees"] is None, row["id"]
        if row["depends"] == "data":
            assert row["prior_low"] is None and row["informative"], row["id"]
