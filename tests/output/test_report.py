"""The report page as text: whole, safe, and never stopped by what it does not know."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import xarray as xr
from pages import Page

from sunspin.base.errors import InputError
from sunspin.output.folder import MARKER
from sunspin.output.report import write_report
from sunspin.output.report.page import _json, _script


@pytest.fixture(scope="module")
def page(study) -> Page:
    return Page(study / "report.html")


def test_the_study_has_every_part_and_no_problem(page):
    parts = [
        "summary",
        "timeline",
        "lander",
        "powers",
        "sun-path",
        "rate-space",
        "maps",
        "outcomes",
        "strategies",
        "comparison",
        "quality",
        "findings",
        "provenance",
    ]
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
    rows = {
        attrs["data-row"]: attrs["data-verdict"]
        for tag, attrs in page.tags
        if tag == "tr" and "data-row" in attrs
    }
    assert set(rows) == {row["id"] for row in summary["figures"]}
    for row in summary["figures"]:
        verdict, test = rows[row["id"]], row["kind"] == "test"
        assert (verdict == "agrees") is (row["agrees"] is True) and (verdict == "differs") is (
            row["agrees"] is False
        )
        assert (verdict == "uninformative") is (test and not row["informative"])
        assert test is (verdict in ("agrees", "differs", "uninformative"))
        assert (row["kind"] == "put_in") is (verdict in ("comes-back", "not-back", "put-in"))
        assert (row["kind"] == "not_comparable") is (verdict in ("not-comparable", "drawn"))
        if not test and row["kind"] != "not_comparable":
            assert (verdict in ("comes-back", "holds")) is (row["holds"] is True)
            assert (verdict in ("not-back", "holds-not")) is (row["holds"] is False)
    for entry in summary["inputs"]:
        assert entry["sha256"] in page.text
    assert (
        summary["command"] in page.text
        and f"sunspin {summary['version']}" in page.text
        and summary["cite"] in page.text
    )


def test_it_stands_alone_and_is_small(study, page):
    assert (study / "report.html").stat().st_size < 15e6
    for tag, attrs in page.tags:
        for name in ("src", "href", "action", "poster", "data"):
            value = attrs.get(name)
            assert value is None or value.startswith(("#", "data:")), (tag, value)
    policy = next(
        a["content"]
        for t, a in page.tags
        if t == "meta" and a.get("http-equiv") == "Content-Security-Policy"
    )
    assert "default-src 'none'" in policy
    assert "MIT License" in page.text or "MIT license" in page.text


def test_every_plot_has_words_and_axes_with_units(page):
    named = {
        attrs["data-plot"]: attrs["aria-label"]
        for tag, attrs in page.tags
        if tag == "div" and "data-plot" in attrs
    }
    plots = json.loads(page.data)["plots"]
    assert set(named) == set(plots) and all(len(text) > 30 for text in named.values())
    for name, plot in plots.items():
        scene = plot["layout"].get("scene", {})
        axes = [v for k, v in (plot["layout"] | scene).items() if re.fullmatch(r"[xyz]axis\d*", k)]
        titles = [axis["title"]["text"] for axis in axes if "title" in axis]
        told = [t for t in titles if re.search(r"\(.+\)|UTC|turn takes|component", t)]
        assert told == titles and titles, (name, titles)
        signs = {
            str(trace.get("marker", {}).get("symbol"))
            for trace in plot["data"]
            if trace["type"] == "scatter3d"
        }
        assert "x" not in signs, name  # a letter of a picture font, which many systems have not


@pytest.mark.parametrize("text", ["</script>", "<!--<script>", "\u2028\u2029", "a&b'\"\\", "]]>"])
def test_no_label_ends_the_script_it_stands_in(text):
    made = _json({"label": text, text: 1})
    assert not re.search(r"[<>&\u2028\u2029]", made) and json.loads(made) == {
        "label": text,
        text: 1,
    }
    assert "</script" not in _script(f"x = '{text}'") and "<!--" not in _script(text)


def test_regions_of_a_posterior_have_their_weights(tmp_path, framed):
    rng = np.random.default_rng(3)
    region = np.repeat([0, 4, 7], [38, 10, 2]).reshape(2, 25)
    each = ("chain", "draw")
    draws = xr.Dataset(
        {
            "omega_B": (
                (*each, "axis"),
                rng.normal(np.where(region[..., None] == 0, 0.1, -0.2), 1e-6, (2, 25, 3)),
            ),
            "log_weight": (each, np.zeros((2, 25))),
            "mode_id": (each, region),
        }
    )
    tree = xr.DataTree.from_dict(
        {"/posterior": draws, "/modes": xr.Dataset({"evidence": ("mode", [1.0, 2.0])})}
    )
    tree.attrs["verdict"] = "two regions <b> fit"
    tree.to_netcdf(tmp_path / "posterior.nc", engine="h5netcdf")
    (tmp_path / MARKER).write_text("posterior\n", "utf-8")
    read = Page(write_report(tmp_path))
    assert (
        "posterior" in read.ids("section")
        and "Two regions <b> fit." in read.text
        and "could not be" not in read.text
    )
    assert re.search(
        r"1 0\.76 5\.7\d+ ± \S+ 5\.7\d+ ± \S+ 5\.7\d+ ± \S+ 5 0\.2 -11\.4\d+ ±", read.text
    )
    assert (
        "8 0.04 -11.46 -11.46 -11.46, no sigma: too few draws" in read.text
        and "± 0 " not in read.text
    )


def test_only_our_folders_are_taken(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        write_report(tmp_path / "none")
    (tmp_path / "report.html").write_text("mine", "utf-8")
    with pytest.raises(InputError, match="not a results folder"):
        write_report(tmp_path)
    assert (tmp_path / "report.html").read_text("utf-8") == "mine"


def test_a_time_axis_names_the_days_of_its_times_and_not_of_the_epoch():
    from sunspin.output.report.section import time_axis

    def title(*hours: float) -> str:
        return time_axis("2025-03-01T00:00:00Z", [3600.0 * h for h in hours])["title"]["text"]

    assert (
        title(25, 26, np.nan) == "UTC, 2025-03-02"
        and title(23, 25) == "UTC, 2025-03-01 to 2025-03-02"
    )
    assert time_axis(None, [0.0])["title"]["text"] == "time (s)"


def test_a_number_shows_as_many_decimals_as_its_sigma_tells():
    from sunspin.output.text import with_sigma

    assert (
        with_sigma(4.09204, 0.00478) == "4.0920 ± 0.0048"
        and with_sigma(-123.456, 2.34) == "-123.5 ± 2.3"
    )
    assert with_sigma(1.0, np.inf) == "1.000 ± inf" and with_sigma(0.5, 0.0) == "0.500 ± 0"
