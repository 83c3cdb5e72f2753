"""The pages of a user's own runs: every command's parts, labels that stay text, and what is not known or broken."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner
from pages import Page

from browser import HOSTILE
from sunspin.cli import cli
from sunspin.output.report import write_report
from sunspin.output.text import with_sigma


def test_labels_from_outside_stay_text(user_runs):
    for name, folder in user_runs.items():
        read = Page(folder / "report.html")
        scripts = [attrs for tag, attrs in read.tags if tag == "script"]
        assert [a.get("id") for a in scripts] == [
            "data",
            None,
            None,
            *([] if name == "outcomes" else [None]),
        ], name
        if name != "outcomes":
            assert " ".join(HOSTILE.split()) in read.text, name
        assert bool(json.loads(read.data)["plots"]) is (name != "outcomes")
        ids = [attrs["id"] for _, attrs in read.tags if "id" in attrs]
        assert len(ids) == len(set(ids)) and not [
            a for _, attrs in read.tags for a in attrs if a.startswith("on")
        ], name


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("sun", ["powers", "sun-path", "quality"]),
        ("rates", ["lander", "rates", "powers"]),
        ("scan", ["powers", "rate-space", "maps"]),
        ("simulate", ["lander", "trajectory", "sun-path"]),
        ("posterior", ["lander", "posterior", "powers", "sun-path"]),
        ("outcomes", ["outcomes", "strategies"]),
    ],
)
def test_every_command_gets_its_parts(user_runs, name, expected):
    read = Page(user_runs[name] / "report.html")
    assert [i for i in read.ids("section") if i in expected] == expected
    assert "could not be" not in read.text and f"sunspin {name}" in read.text
    figures = [
        attrs for tag, attrs in read.tags if tag == "figure" and attrs.get("class") == "drawn"
    ]
    assert figures and any(tag == "svg" for tag, _ in read.tags)


def test_outcomes_have_units_and_names_and_only_philae_was_flown(user_runs, tmp_path):
    text = Page(user_runs["outcomes"] / "report.html").text
    assert (
        "wheel off at touchdown" in text
        and "is what was flown" in text
        and "the lines that the paper prints" in text
    )
    assert "Fastest leg tip at first contact, m/s" in text and "touch leg" not in text
    rates = [
        line.partition("deg/s")[2].split()
        for line in text.split("Angular speed after the collision, ")[1:]
    ]
    both = [
        float(line[0].partition("\u00a0")[0]) for line in rates
    ]  # all runs of one strategy, and the strategies side by side
    assert len(both) == 2 and both[0] == pytest.approx(both[1], rel=1e-6)
    shutil.copytree(user_runs["outcomes"], folder := tmp_path / "own")
    table = xr.load_dataset(folder / "strategies.nc", engine="h5netcdf").assign_attrs(
        vehicle="my lander"
    )
    table.to_netcdf(folder / "strategies.nc", engine="h5netcdf")
    assert "flown" not in Page(write_report(folder)).text


def test_what_it_does_not_know_it_lists_and_what_is_broken_it_names(user_runs, tmp_path, framed):
    folder = tmp_path / "odd"
    shutil.copytree(user_runs["simulate"], folder)
    xr.Dataset({"strange": ("thing", [1.0, np.nan, 3.0], {"units": "furlong"})}).to_netcdf(
        folder / "odd.nc", engine="h5netcdf"
    )
    xr.Dataset(
        {"B_from_N": ("a", [1.0]), "sun_B": ("b", [2.0]), "omega_B": ("c", [3.0])}
    ).to_netcdf(folder / "wrong.nc", engine="h5netcdf")
    (folder / "broken.nc").write_bytes(b"\x89HDF\r\n\x1a\nno")
    listed = {
        "moved": [{"row": "first", "size": 1.25}, {"row": "second", "size": None}],
        "nothing": "",
    }
    (folder / "summary.json").write_text(
        json.dumps(json.loads((folder / "summary.json").read_text("utf-8")) | listed), "utf-8"
    )
    text = Page(write_report(folder)).text
    assert (
        "row size first 1.25 second none" in text and "nothing –" in text
    )  # a list of things is a table
    (folder / "summary.json").write_text('{"half": ', "utf-8")
    (folder / "figures.json").write_text('[{"file": 3}, 4]', "utf-8")
    (folder / "vehicle.toml").write_text("name = 'x'\n[body]\nmass_kg = -1\n", "utf-8")
    text = Page(write_report(folder)).text
    assert "strange" in text and "furlong" in text and "1 to 3, mean 2" in text
    for name in ("broken.nc", "summary.json", "vehicle.toml"):
        assert f"{name} could not be read" in text


@pytest.mark.evidence("report", "verified", "the draws and the best motion of a posterior's files")
def test_a_posterior_is_shown_with_its_best_motion_and_what_it_predicts(user_runs):
    folder = user_runs["posterior"]
    read, tree = Page(folder / "report.html"), xr.load_datatree(folder / "posterior.nc")
    for axis in range(3):
        values = np.degrees(tree["posterior"]["omega_B"].values[..., axis])
        assert with_sigma(values.mean(), values.std()) in read.text
    speed = np.degrees(np.median(tree["predictions"]["rate"].sel(predicted_s=600.0)))
    assert f"{speed:.4g}" in read.text and "2026-01-01 00:10:00" in read.text
    motion = xr.load_dataset(folder / "motion-region-1.nc")
    best = (
        tree["posterior"]
        .to_dataset()
        .isel(chain=0, draw=int(np.argmax(tree["posterior"]["log_likelihood_sum"].values)))
    )
    assert np.allclose(motion["omega_B"].values[0], best["omega_B"].values, atol=1e-12)
    assert motion["time"].values[[0, -1]] == pytest.approx(
        [tree.attrs["t_first_s"], tree.attrs["t_last_s"]]
    )
    samples = xr.load_dataset(folder / "telemetry.nc")["power_W"]
    modelled = motion["panel_signal"].interp(time=samples["time"]).values
    scale = (samples.values * modelled).sum() / (modelled**2).sum()
    assert np.abs(scale * modelled - samples.values).max() < 6 * 0.02  # of its noise, 0.02 W


def test_the_command_names_the_page(user_runs, framed):
    done = CliRunner().invoke(
        cli, ["report", str(user_runs["scan"]), "--json"], catch_exceptions=False
    )
    said = json.loads(done.output)
    assert Path(said["report"]).stat().st_size == said["bytes"]
