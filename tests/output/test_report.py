"""The report page as text: whole, safe, and never stopped by what it does not know."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner
from pages import Page

from browser import HOSTILE
from sunspin.base.errors import InputError
from sunspin.cli import cli
from sunspin.output.folder import MARKER
from sunspin.output.report import write_report
from sunspin.output.report.page import _json, _script


@pytest.fixture(scope="module")
def page(study) -> Page:
    return Page(study / "report.html")


def test_the_study_has_every_part_and_no_problem(page):
    parts = [
        "summary", "timeline", "lander", "powers", "sun-path", "rate-space", "maps", "outcomes", "strategies", "comparison",
        "quality",
        "findings", "provenance",
    ]  # fmt: skip
    assert [i for i in page.ids("section") if i in parts] == parts
    assert "could not be" not in page.text


@pytest.mark.evidence("report", "verified", "every verdict and sentence of summary.json")
def test_the_page_says_what_the_summary_says(study, page):
    summary = json.loads((study / "summary.json").read_text("utf-8"))
    assert len(summary["headline"]) == 3
    for sentence in summary["headline"] + summary["conclusions"]:
        assert " ".join(sentence.split()) in page.text
    for line in summary["score"]:
        assert line in page.text
    rows = {attrs["data-row"]: attrs["data-verdict"] for tag, attrs in page.tags if tag == "tr" and "data-row" in attrs}
    assert set(rows) == {row["id"] for row in summary["figures"]}
    for row in summary["figures"]:
        verdict, test = rows[row["id"]], row["kind"] == "test"
        assert (verdict == "agrees") is (row["agrees"] is True) and (verdict == "differs") is (row["agrees"] is False)
        assert (verdict == "uninformative") is (test and not row["informative"])
        assert test is (verdict in ("agrees", "differs", "uninformative"))
        assert (row["kind"] == "put_in") is (verdict in ("comes-back", "not-back", "put-in"))
        assert (row["kind"] == "not_comparable") is (verdict in ("not-comparable", "drawn"))
        if not test and row["kind"] != "not_comparable":
            assert (verdict in ("comes-back", "holds", "stands")) is (row["holds"] is True)
            assert (verdict in ("not-back", "holds-not", "contradicted", "weak")) is (row["holds"] is False)
    for entry in summary["inputs"]:
        assert entry["sha256"] in page.text
    assert summary["command"] in page.text and f"sunspin {summary['version']}" in page.text and summary["cite"] in page.text


def test_it_stands_alone_and_is_small(study, page):
    assert (study / "report.html").stat().st_size < 15e6
    for tag, attrs in page.tags:
        for name in ("src", "href", "action", "poster", "data"):
            value = attrs.get(name)
            assert value is None or value.startswith(("#", "data:")), (tag, value)
    policy = next(a["content"] for t, a in page.tags if t == "meta" and a.get("http-equiv") == "Content-Security-Policy")
    assert "default-src 'none'" in policy
    assert "MIT License" in page.text or "MIT license" in page.text


def test_every_plot_has_words_and_axes_with_units(page):
    named = {attrs["data-plot"]: attrs["aria-label"] for tag, attrs in page.tags if tag == "div" and "data-plot" in attrs}
    plots = json.loads(page.data)["plots"]
    assert set(named) == set(plots) and all(len(text) > 30 for text in named.values())
    for name, plot in plots.items():
        scene = plot["layout"].get("scene", {})
        axes = [v for k, v in (plot["layout"] | scene).items() if re.fullmatch(r"[xyz]axis\d*", k)]
        titles = [axis["title"]["text"] for axis in axes if "title" in axis]
        told = [t for t in titles if re.search(r"\(.+\)|UTC|turn takes|component", t)]
        assert told == titles and titles, (name, titles)


def test_labels_from_outside_stay_text(user_runs):
    for name, folder in user_runs.items():
        read = Page(folder / "report.html")
        scripts = [attrs for tag, attrs in read.tags if tag == "script"]
        assert [a.get("id") for a in scripts] == ["data", None, None, *([] if name == "outcomes" else [None])], name
        if name != "outcomes":
            assert " ".join(HOSTILE.split()) in read.text, name
        assert bool(json.loads(read.data)["plots"]) is (name != "outcomes")
        ids = [attrs["id"] for _, attrs in read.tags if "id" in attrs]
        assert len(ids) == len(set(ids)) and not [a for _, attrs in read.tags for a in attrs if a.startswith("on")], name


@pytest.mark.parametrize("text", ["</script>", "<!--<script>", "\u2028\u2029", "a&b'\"\\", "]]>"])
def test_no_label_ends_the_script_it_stands_in(text):
    made = _json({"label": text, text: 1})
    assert not re.search(r"[<>&\u2028\u2029]", made) and json.loads(made) == {"label": text, text: 1}
    assert "</script" not in _script(f"x = '{text}'") and "<!--" not in _script(text)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("sun", ["powers", "sun-path", "quality"]), ("rates", ["lander", "rates", "powers"]), ("scan", ["powers", "rate-space",
        "maps"]),
        ("simulate", ["lander", "trajectory", "sun-path"]), ("posterior", ["lander", "posterior", "powers", "sun-path"]),
        ("outcomes", ["outcomes", "strategies"]),
    ],
)  # fmt: skip
def test_every_command_gets_its_parts(user_runs, name, expected):
    read = Page(user_runs[name] / "report.html")
    assert [i for i in read.ids("section") if i in expected] == expected
    assert "could not be" not in read.text and f"sunspin {name}" in read.text
    figures = [attrs for tag, attrs in read.tags if tag == "figure" and attrs.get("class") == "drawn"]
    assert figures and any(tag == "svg" for tag, _ in read.tags)


def test_what_it_does_not_know_it_lists_and_what_is_broken_it_names(user_runs, tmp_path):
    folder = tmp_path / "odd"
    shutil.copytree(user_runs["simulate"], folder)
    xr.Dataset({"strange": ("thing", [1.0, np.nan, 3.0], {"units": "furlong"})}).to_netcdf(folder / "odd.nc", engine="h5netcdf")
    xr.Dataset({"B_from_N": ("a", [1.0]), "sun_B": ("b", [2.0]), "omega_B": ("c", [3.0])}).to_netcdf(
        folder / "wrong.nc", engine="h5netcdf"
    )
    (folder / "broken.nc").write_bytes(b"\x89HDF\r\n\x1a\nno")
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
        assert f"{values.mean():.4g} ± {values.std():.2g}" in read.text
    speed = np.degrees(np.median(tree["predictions"]["rate"].sel(predicted_s=600.0)))
    assert f"{speed:.4g}" in read.text and "2026-01-01 00:10:00" in read.text
    motion = xr.load_dataset(folder / "motion-region-1.nc")
    best = tree["posterior"].to_dataset().isel(chain=0, draw=int(np.argmax(tree["posterior"]["log_likelihood_sum"].values)))
    assert np.allclose(motion["omega_B"].values[0], best["omega_B"].values, atol=1e-12)
    assert motion["time"].values[[0, -1]] == pytest.approx([tree.attrs["t_first_s"], tree.attrs["t_last_s"]])
    samples = xr.load_dataset(folder / "telemetry.nc")["power_W"]
    modelled = motion["panel_signal"].interp(time=samples["time"]).values
    scale = (samples.values * modelled).sum() / (modelled**2).sum()
    assert np.abs(scale * modelled - samples.values).max() < 6 * 0.02  # of its noise, 0.02 W


def test_regions_of_a_posterior_have_their_weights(tmp_path):
    rng = np.random.default_rng(3)
    region = np.repeat([0, 4], [2 * 20, 2 * 5]).reshape(2, 25)
    each = ("chain", "draw")
    draws = xr.Dataset(
        {
            "omega_B": ((*each, "axis"), rng.normal(np.where(region[..., None] == 0, 0.1, -0.2), 1e-6, (2, 25, 3))),
            "log_weight": (each, np.zeros((2, 25))), "mode_id": (each, region),
        }
    )  # fmt: skip
    tree = xr.DataTree.from_dict({"/posterior": draws, "/modes": xr.Dataset({"evidence": ("mode", [1.0, 2.0])})})
    tree.attrs["verdict"] = "two regions <b> fit"
    tree.to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    (tmp_path / MARKER).write_text("posterior\n", "utf-8")
    read = Page(write_report(tmp_path))
    assert "posterior" in read.ids("section") and "Two regions <b> fit." in read.text and "could not be" not in read.text
    assert re.search(r"1 0\.8 5\.73 ± \S+ 5\.73 ± \S+ 5\.73 ± \S+ 5 0\.2 -11\.46 ±", read.text)


def test_only_our_folders_are_taken(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        write_report(tmp_path / "none")
    (tmp_path / "report.html").write_text("mine", "utf-8")
    with pytest.raises(InputError, match="not a results folder"):
        write_report(tmp_path)
    assert (tmp_path / "report.html").read_text("utf-8") == "mine"


def test_the_command_names_the_page(user_runs):
    done = CliRunner().invoke(cli, ["report", str(user_runs["sun"]), "--json"], catch_exceptions=False)
    said = json.loads(done.output)
    assert Path(said["report"]).stat().st_size == said["bytes"]


def test_a_time_axis_names_the_days_of_its_times_and_not_of_the_epoch():
    from sunspin.output.report.section import time_axis

    def title(*hours: float) -> str:
        return time_axis("2025-03-01T00:00:00Z", [3600.0 * h for h in hours])["title"]["text"]

    assert title(25, 26, np.nan) == "UTC, 2025-03-02" and title(23, 25) == "UTC, 2025-03-01 to 2025-03-02"
    assert time_axis(None, [0.0])["title"]["text"] == "time (s)"


def test_a_number_shows_as_many_decimals_as_its_sigma_tells():
    from sunspin.output.text import with_sigma

    assert with_sigma(4.09204, 0.00478) == "4.0920 ± 0.0048" and with_sigma(-123.456, 2.34) == "-123.5 ± 2.3"
    assert with_sigma(1.0, np.inf) == "1.000 ± inf" and with_sigma(0.5, 0.0) == "0.500 ± 0"
