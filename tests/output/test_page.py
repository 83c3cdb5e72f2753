"""The page of a results folder as text: complete, escaped, equal to the files, robust against damaged parts."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.cases import load_case
from sunspin.cli import cli
from sunspin.output.folder import MANIFEST, MARKER
from sunspin.output.report import write_report
from sunspin.output.report.body import body_in_motion
from sunspin.output.report.page import _json, _script
from sunspin.output.report.read import Results, read_results
from sunspin.output.report.views import read_motions, sun_on_sphere
from sunspin.philae.motions import speed_figure
from sunspin.vehicle import Channel, Panel, Vehicle
from tests.support.browser import HOSTILE, Page


@pytest.fixture(scope="module")
def page(study) -> Page:
    return Page(study / "report.html")


PARTS = {
    "sun": ["summary", "sun", "tables", "provenance"],
    "rates": ["summary", "motion", "sun", "figures", "tables", "provenance"],
    "scan": ["summary", "rate-space", "provenance"],
    "simulate": ["summary", "motion", "sun", "provenance"],
    "posterior": ["summary", "motion", "sun", "rate-space", "figures", "tables", "provenance"],
    "outcomes": ["summary", "figures", "tables", "provenance"],
}


@pytest.mark.parametrize("name", PARTS)
def test_the_page_of_each_command_has_its_sections_and_escapes_foreign_labels(user_runs, name):
    read = Page(user_runs[name] / "report.html")
    assert read.ids("section") == PARTS[name]
    assert "could not be" not in read.text and f"sunspin {name}" in read.text
    ids = [attrs["id"] for _, attrs in read.tags if "id" in attrs]
    assert len(ids) == len(set(ids))
    assert not [a for _, attrs in read.tags for a in attrs if a.startswith("on")]
    scripts = [attrs.get("id") for tag, attrs in read.tags if tag == "script"]
    assert scripts == ["data", *[None] * (1 if name == "outcomes" else 2)]
    if name != "outcomes":  # of Philae, whose name is not hostile
        assert " ".join(HOSTILE.split()) in read.text
    manifest = json.loads((user_runs[name] / MANIFEST).read_text("utf-8"))
    shown = [attrs for tag, attrs in read.tags if tag == "img"]
    assert len(shown) == len(manifest["figures"]) > 0
    assert all(attrs["src"].startswith("data:image/") and attrs["alt"] for attrs in shown)


def test_the_page_of_the_study_has_every_section_and_the_figures_of_its_summary(study, page):
    parts = ["summary", "motion", "sun", "rate-space", "tables", "comparison", "provenance"]
    assert [i for i in page.ids("section") if i != "figures"] == parts
    summary = json.loads((study / "summary.json").read_text("utf-8"))
    assert "could not be" not in page.text and len(summary["headline"]) == 4
    first = page.part("summary")
    assert "No conclusion." not in first
    for sentence in summary["headline"] + summary["score"]:
        assert " ".join(sentence.split()) in first
    for sentence in summary["conclusions"]:
        assert " ".join(sentence.split()) in page.text
    for key in ("chain", "noise", "calibration", "carries"):
        assert " ".join(str(summary[key]).split())[:300] in page.part("provenance")
    for entry in summary["inputs"]:
        assert entry["sha256"] in page.text
    for text in (summary["command"], f"sunspin {summary['version']}", summary["cite"]):
        assert text in page.text


def test_the_page_loads_nothing_and_is_small(study, page):
    assert (study / "report.html").stat().st_size < 15e6
    for tag, attrs in page.tags:
        for name in ("src", "href", "action", "poster", "data"):
            value = attrs.get(name)
            assert value is None or value.startswith(("#", "data:")), (tag, value)
    policies = [
        a["content"] for t, a in page.tags if a.get("http-equiv") == "Content-Security-Policy"
    ]
    assert "default-src 'none'" in str(policies[0])
    assert "MIT License" in page.text or "MIT license" in page.text


def test_every_view_of_the_page_has_a_text_and_axes_with_units(user_runs, page):
    for read in (page, Page(user_runs["posterior"] / "report.html")):
        plots = [attrs for tag, attrs in read.tags if tag == "div" and "data-plot" in attrs]
        words = {attrs["data-plot"]: attrs["aria-label"] for attrs in plots}
        plots = json.loads(read.data)
        assert set(words) == set(plots) and all(len(str(text)) > 30 for text in words.values())
        for name, plot in plots.items():
            axes = [plot["layout"]["scene"][f"{a}axis"] for a in "xyz"]
            titles = [axis.get("title", {}).get("text", "") for axis in axes]
            if name.startswith("motion"):
                assert plot["frames"] and all(axis["visible"] is False for axis in axes)
            else:
                assert all(re.search(r"rad/s|deg/s|body", title) for title in titles), titles


@pytest.mark.parametrize("text", ["</script>", "<!--<script>", "\u2028\u2029", "a&b'\"\\", "]]>"])
def test_no_label_ends_the_script_that_contains_it(text):
    made = _json({"label": text, text: 1})
    assert not re.search(r"[<>&\u2028\u2029]", made)
    assert json.loads(made) == {"label": text, text: 1}
    assert "</script" not in _script(f"x = '{text}'") and "<!--" not in _script(text)


CUBE = Vehicle("cube", np.eye(3), panels=(Panel("a", [1, 0, 0], 1.0),))


def simulated(run, vehicle=CUBE):
    """Return what the page reads of a simulated motion."""
    results = Results(Path("."), "simulate", data={"trajectory": run}, vehicle=vehicle)
    return results, read_motions(results)


def corners_of(view):
    """Of each frame the corners (n, 3) of the body."""
    return [np.array([frame["data"][0][axis] for axis in "xyz"]).T for frame in view.frames]


@pytest.mark.evidence(
    "report", "verified", "the drawn attitude, rates and Sun against the result file"
)
def test_the_attitude_on_the_page_is_the_stored_one(user_runs):
    """The rotation is recovered from the drawn corners; the Sun's arrow, carried back by it, is the stored Sun."""
    results = read_results(user_runs["simulate"])
    (view,) = body_in_motion(results, read_motions(results))
    run = results.data["trajectory"]
    toward_sun = run["sun_B"].values / np.linalg.norm(run["sun_B"].values, axis=1, keepdims=True)
    label = view.figure.layout.sliders[0].steps[0].label
    still = corners_of(view)[0]
    sun = np.array([view.figure.data[2][a][1] for a in "xyz"])
    sun /= np.linalg.norm(sun)  # fixed in the view
    steps = view.figure.layout.sliders[0].steps
    for turned, step in list(zip(corners_of(view), steps, strict=True))[::20]:
        at = int(np.argmin(np.abs(run["time"].values - float(step.label.split()[0]))))
        matrix, *_ = np.linalg.lstsq(still, turned, rcond=None)
        np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-5)
        stored = toward_sun[at] @ toward_sun[0]
        assert sun @ matrix @ sun == pytest.approx(stored, abs=1e-4)
    speed = np.degrees(np.linalg.norm(run["omega_B"].values[0]))
    assert f"{speed:.3g} deg/s, wheel 300 rad/s" in label


def test_the_page_shows_no_wheel_speed_that_a_pass_denies(user_runs):
    results = read_results(user_runs["rates"])
    assert "wheel_speed_rad_s" in read_motions(results)[0][1]
    changed = results.data["rates"].assign_attrs(
        wheel_change="wheel: speed changed by about 9 rad/s"
    )
    denied = replace(results, data=results.data | {"rates": changed})
    assert "wheel_speed_rad_s" not in read_motions(denied)[0][1]


def test_the_page_shows_fast_motions_in_part_and_motions_at_rest_whole():
    """No two frames are a third of a radian apart, whatever the rate; a body that does not turn has frames too. Of few instants
    all are shown; where the body turns by more than 2 rad between two, nobody knows which way."""
    for rate in (0.0, 0.01, 3.0):
        run = ss.propagate(CUBE, [0, 0, rate], [1, 0, 0], None, np.arange(0.0, 600.0, 0.05))
        (view,) = body_in_motion(*simulated(run))
        corners = corners_of(view)
        assert 2 <= len(corners) <= 300
        size = np.linalg.norm(corners[0], axis=1).max()
        assert max(np.abs(np.diff(corners, axis=0)).max(axis=(1, 2))) < 0.5 * size
    few = np.arange(0.0, 200.0, 10.0)
    (view,) = body_in_motion(*simulated(ss.propagate(CUBE, [0, 0, 0.05], [1, 0, 0], None, few)))
    labels = [step.label for step in view.figure.layout.sliders[0].steps]
    assert len(labels) == 20 and labels[-1].startswith("190.0 s")
    coarse = simulated(ss.propagate(CUBE, [0, 0, 0.3], [1, 0, 0], None, few))
    assert list(body_in_motion(*coarse)) == []


@pytest.mark.parametrize("sun_B", [[0.1, 0, 0.995], [1, 0, 0], [-0.8, 0, 0.6]])
def test_the_names_of_sun_and_axis_stand_on_sides_that_do_not_meet(sun_B):
    toward_sun = np.array(sun_B) / np.linalg.norm(sun_B)
    run = ss.propagate(CUBE, [0, 0, 0.05], toward_sun, None, np.arange(0.0, 200.0, 10.0))
    (view,) = body_in_motion(*simulated(run))
    sun, axis = view.figure.data[2:4]
    right = view.figure.layout.scene.camera.eye.y < 0  # seen from there x is to the right
    assert right and sun.x[1] >= axis.x[1] - 1e-6
    assert (sun.textposition, axis.textposition) == ("middle right", "middle left")


def test_the_page_lights_panels_of_a_shared_input_one_by_one():
    """The view colours panels, not inputs: a pair of opposite panels on one channel is lit on one side at a time."""
    pair = (Panel("a", [1, 0, 0], 1.0), Panel("b", [-1, 0, 0], 1.0))
    cube = replace(CUBE, panels=pair, channels=(Channel("x", ("a", "b"), "sum"),))
    run = ss.propagate(cube, [0, 0, 0.5], [1, 0, 0], None, np.arange(0.0, 12.0, 0.1))
    (view,) = body_in_motion(*simulated(run, cube))
    colours = np.array([frame["data"][0]["facecolor"] for frame in view.frames])
    assert {colours[0][0], colours[0][2]} == {"#facd3c", "#283c6e"}
    assert len(set(colours[:, 0])) > 5


def test_panels_of_one_side_share_a_label_on_the_sphere():
    panels = (Panel("a", [1, 0, 0], 1.0), Panel("b", [1, 0, 0], 1.0), Panel("c", [0, 0, 1], 1.0))
    cube = replace(CUBE, panels=panels)
    run = ss.propagate(cube, [0, 0, 0.1], [1, 0, 0], None, np.arange(9.0))
    view = sun_on_sphere(*simulated(run, cube))
    assert sorted(view.figure.data[-1].text) == ["a, b", "c"]


def test_the_speed_axis_of_the_study_contains_every_motion(study):
    speed = xr.load_dataset(study / "speed.nc", engine="h5netcdf")
    parts = ("speed", "speed_after_collision")
    low, high = speed_figure(load_case("philae"), speed, True).axes[0].get_ylim()
    assert low <= min(speed[part].min() for part in parts)
    assert high >= max(speed[part].max() for part in parts)
    speed["speed"][{"level": 0, "time": 3}] = 0.0
    speed["speed"][{"level": 2}] = 5.0
    low, high = speed_figure(load_case("philae"), speed, True).axes[0].get_ylim()
    assert 0 < low < 1e-4 and high > 5


def test_tables_on_the_page_are_those_of_the_files(user_runs):
    folder = user_runs["rates"]
    passes = pd.read_csv(folder / "passes.csv", comment="#")
    text = Page(folder / "report.html").part("tables")
    for value in passes[["speed_median_deg_s", "omega_x_deg_s", "sigma_x_deg_s"]].values.ravel():
        assert f"{value:.4g}" in text
    strategies = Page(user_runs["outcomes"] / "report.html").part("tables")
    assert "off at touchdown" in strategies and "m/s" in strategies
    assert "touch_leg" not in strategies


def test_report_refuses_folders_that_sunspin_did_not_write(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        write_report(tmp_path / "none")
    (tmp_path / "report.html").write_text("mine", "utf-8")
    with pytest.raises(InputError, match="not a results folder"):
        write_report(tmp_path)
    (tmp_path / MARKER).write_text("rates\n", "utf-8")
    with pytest.raises(InputError, match="the run did not end.*run the command again"):
        write_report(tmp_path)
    (tmp_path / MARKER).write_text("export\n", "utf-8")
    with pytest.raises(InputError, match="holds files of `sunspin export`; give that of another"):
        write_report(tmp_path)
    assert (tmp_path / "report.html").read_text("utf-8") == "mine"


@pytest.mark.evidence(
    "report", "verified", "the draws and the likeliest motion of a posterior's files"
)
def test_the_motion_shown_of_a_posterior_is_its_likeliest_draw(user_runs):
    folder = user_runs["posterior"]
    tree = xr.load_datatree(folder / "posterior.nc")
    motion = xr.load_dataset(folder / "motion-solution-1.nc")
    likeliest = int(np.argmax(tree["posterior"]["log_likelihood_sum"].values))
    best = tree["posterior"].to_dataset().isel(chain=0, draw=likeliest)
    assert np.allclose(motion["omega_B"].values[0], best["omega_B"].values, atol=1e-12)
    ends = [tree.attrs["t_first_s"], tree.attrs["t_last_s"]]
    assert motion["time"].values[[0, -1]] == pytest.approx(ends)
    samples = xr.load_dataset(folder / "telemetry.nc")["power_W"]
    modelled = motion["panel_signal"].interp(time=samples["time"]).values
    scale = (samples.values * modelled).sum() / (modelled**2).sum()
    assert np.abs(scale * modelled - samples.values).max() < 6 * 0.02  # of its noise, 0.02 W


def test_report_prints_the_path_of_the_page(user_runs):
    words = ["report", str(user_runs["scan"]), "--json"]
    said = json.loads(CliRunner().invoke(cli, words, catch_exceptions=False).output)
    assert Path(said["report"]).stat().st_size == said["bytes"]
