"""Rows and first screen of a study's page: what each row is called, what is counted, what is shown where nothing is concluded."""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from pages import Page

from browser import HOSTILE
from sunspin.output.folder import MARKER
from sunspin.output.report import write_report
from sunspin.output.report.rows import VERDICTS, WITHOUT, between, verdict_of
from sunspin.philae import study as rp
from sunspin.philae.row import Row, settled

FILES_OF_CANDIDATES = (
    "candidates",
    "outcomes-off",
    "outcomes-held",
    "strategies",
    "speed",
    "motion-best-fit",
)


def row(**given: Any) -> dict[str, Any]:
    """A row as summary.json has it."""
    plain = {
        "id": "some",
        "what": "what",
        "published": 1.0,
        "ours": 1.0,
        "unit": "1",
        "tolerance": None,
        "agrees": None,
        "note": "",
        "source": "",
        "kind": "test",
        "depends": "data",
        "low": None,
        "high": None,
        "prior_low": None,
        "prior_high": None,
        "informative": True,
        "chain": "telemetry",
        "holds": None,
        "part": "a part",
        "section": "a section",
    }
    return plain | given


def page_of(folder: Path, **summary: Any) -> Page:
    """The page of a study whose summary is this."""
    folder.mkdir(exist_ok=True)
    (folder / MARKER).write_text("reproduce\n", "utf-8")
    (folder / "summary.json").write_text(json.dumps(summary), "utf-8")
    return Page(write_report(folder))


def copy(study: Path, folder: Path, *names: str) -> None:
    """Some files of a study."""
    for name in names:
        (folder / name).write_bytes((study / name).read_bytes())


@pytest.mark.parametrize(
    ("given", "verdict"),
    [
        ({"agrees": True}, "agrees"),
        ({"agrees": False}, "differs"),
        ({"agrees": None, "informative": False}, "uninformative"),
        ({"agrees": True, "informative": False}, "uninformative"),
        ({"agrees": False, "informative": False}, "uninformative"),
        ({"kind": "put_in", "holds": True}, "comes-back"),
        ({"kind": "put_in", "holds": False}, "not-back"),
        ({"kind": "put_in"}, "put-in"),
        ({"kind": "put_in", "agrees": True, "holds": False}, "not-back"),
        ({"kind": "arithmetic", "holds": True}, "holds"),
        ({"kind": "arithmetic", "holds": False}, "holds-not"),
        ({"kind": "arithmetic"}, "arithmetic"),
        ({"kind": "not_comparable", "holds": True}, "not-comparable"),
        ({"kind": "not_comparable", "agrees": True}, "not-comparable"),
        ({"kind": "not_comparable", "id": "figure_3"}, "drawn"),
        ({"kind": "of another time"}, "not-comparable"),
        ({"agrees": "yes"}, "not-comparable"),
    ],
)
def test_only_an_informative_test_agrees_or_differs(given, verdict):
    assert verdict_of(row(**given)) == verdict and verdict in VERDICTS


def test_verdicts_follow_what_the_study_settles():
    """The page's words and the study's counts are of one mind on every kind of row."""
    for kind in ("test", "put_in", "arithmetic", "not_comparable"):
        for agrees in (True, False, None):
            for informative in (True, False):
                made = settled(
                    Row(
                        "x", "", 1, 1, "1", None, agrees, "", "", kind=kind, informative=informative
                    )
                )
                found = verdict_of({name: getattr(made, name) for name in Row.__dataclass_fields__})
                expected = {
                    "test": "agrees"
                    if made.agrees
                    else "differs"
                    if made.agrees is False
                    else "uninformative",
                    "put_in": {True: "comes-back", False: "not-back", None: "put-in"}[made.holds],
                    "arithmetic": {True: "holds", False: "holds-not", None: "arithmetic"}[
                        made.holds
                    ],
                    "not_comparable": "not-comparable",
                }[made.kind]
                assert found == expected
    assert (
        sum(WITHOUT in title for title in rp.SECTIONS.values()) == 1
        and WITHOUT in rp.SECTIONS["no_telemetry"]
    )


@pytest.mark.evidence(
    "report", "verified", "the counts of summary.json, recounted from the rows that the page shows"
)
def test_rows_filters_and_sentences_have_the_counts_of_the_summary(study):
    summary, page = (
        json.loads((study / "summary.json").read_text("utf-8")),
        Page(study / "report.html"),
    )
    shown = {
        attrs["data-row"]: attrs["data-verdict"]
        for tag, attrs in page.tags
        if tag == "tr" and "data-row" in attrs
    }
    assert len(shown) == len(summary["figures"])
    found = Counter(shown.values())
    filters = [re.fullmatch(r"(.+) \((\d+)\)", label) for label in page.buttons()[1:]]
    assert {each[1]: int(each[2]) for each in filters} == {
        VERDICTS[key][2:]: n for key, n in found.items()
    }
    counts = summary["counts"]
    every = [counts, counts["without_telemetry"], counts["paper"]]
    total = {
        key: sum(part[key] for part in every)
        for key in ("agree", "differ", "uninformative", "put_in", "not_comparable")
    }
    assert found["agrees"] == total["agree"] and found["differs"] == total["differ"]
    assert found["uninformative"] == total["uninformative"]
    assert found["comes-back"] + found["not-back"] + found["put-in"] == total["put_in"]
    assert found["not-comparable"] == total["not_comparable"] and found["drawn"] == 13
    own = ("holds", "holds-not", "arithmetic")
    assert sum(found[key] for key in own) == sum(part["arithmetic"] for part in every)
    lines = counts["without_telemetry"]
    said = (
        f"Tests on this telemetry: {counts['agree']} agree, {counts['differ']} differ, {counts['uninformative']} are uninformative",
        f"Tests without telemetry (the equations and the printed lines): {lines['agree']} agree, {lines['differ']} differ",
        f"Put in: {total['put_in']} figures",
        f"Not comparable: {total['not_comparable']} rows",
    )
    for sentence in said:
        assert sentence in page.text


def test_contradictions_are_a_table_of_the_unchanged_study_alone(study, tmp_path):
    """Their texts stay texts, and a damaged table leaves the page."""
    summary = json.loads((study / "summary.json").read_text("utf-8"))
    statements = summary["contradictions"]["statements"]
    strong = sum(not each["weak"] for each in statements)
    shown = Page(study / "report.html").part("contradictions")
    assert f"{strong} statements of the paper contradict" in shown
    assert all(" ".join(each["other_reading"].split()) in shown for each in statements)
    bad = {"statements": [dict.fromkeys(statements[0], HOSTILE), 3], "made": 3}
    assert " ".join(HOSTILE.split()) in page_of(tmp_path / "a", contradictions=bad).text
    for odd in (None, 3, {}, {"statements": []}):
        assert "contradict" not in page_of(tmp_path / "b", contradictions=odd).text


def test_a_row_shows_its_interval_what_was_possible_and_what_made_it(tmp_path):
    rows = [
        row(
            id="a",
            low=0.0912,
            high=1.44,
            prior_low=0.00712,
            prior_high=1.45,
            informative=False,
            chain="scan",
        ),
        row(id="b", low=[1.0, 3.0], high=[2.0, 4.0], chain="mine.csv", agrees=True, tolerance=0.5),
        row(id="c", low=None, high=2.0, chain="none", agrees=False),
    ]
    text = page_of(tmp_path / "a", figures=rows).text
    assert (
        "interval: 0.0912 to 1.44 possible before: 0.00712 to 1.45" in text
        and "from the scan's 90 % set" in text
    )
    assert (
        "interval: 1 to 2; 3 to 4" in text
        and "from the motions of mine.csv" in text
        and "✓ agrees within 0.5" in text
    )
    assert text.count("interval:") == 2 and "no telemetry" in text and "○ uninformative" in text
    assert between([1, 2], 3) == "(1, 2) to 3" and between("x", None) == ""


def test_texts_of_rows_and_of_the_first_screen_stay_text(tmp_path):
    texts = (
        "what",
        "unit",
        "note",
        "source",
        "chain",
        "part",
        "section",
        "published",
        "ours",
        "low",
        "high",
    )
    rows = [row(id=f"{HOSTILE}{k}", **dict.fromkeys(texts, HOSTILE)) for k in range(2)]
    rows.append(row(id="rate_at_touchdown_bound", ours=1.0, unit=HOSTILE, chain=HOSTILE))
    page = page_of(
        tmp_path / "bad",
        title=HOSTILE,
        figures=rows,
        carries=HOSTILE,
        score=[HOSTILE],
        headline=[HOSTILE] * 3,
        noise=HOSTILE,
        calibration=HOSTILE,
        chain=HOSTILE,
        missing={"candidates": HOSTILE},
        conclusions=[HOSTILE],
        cite=HOSTILE,
        command=HOSTILE,
    )
    assert [attrs.get("id") for tag, attrs in page.tags if tag == "script"] == ["data", None, None]
    assert page.text.count(" ".join(HOSTILE.split())) > 30
    rows = [attrs["data-row"] for tag, attrs in page.tags if tag == "tr" and "data-row" in attrs]
    assert rows == [f"{HOSTILE}0", f"{HOSTILE}1", "rate_at_touchdown_bound"]


@pytest.mark.parametrize(
    "figures",
    [
        3,
        "text",
        [3, None, "x"],
        [{"id": 3, "low": {"a": 1}, "high": [], "ours": True}],
        [{"id": "emd_min", "ours": "x"}],
    ],
)
def test_a_damaged_summary_still_gives_a_page(tmp_path, figures):
    page = page_of(
        tmp_path / "odd", figures=figures, missing=[1], carries=3, score="x", headline=["one"]
    )
    assert "one" in page.part("summary")


def test_a_fact_that_the_data_leave_open_says_so(tmp_path):
    bound = {
        "id": "rate_at_touchdown_bound",
        "kind": "not_comparable",
        "unit": "rad/s",
        "published": 0.1816,
    }
    bound |= {"low": 0.09, "high": 1.4}
    known = page_of(tmp_path / "a", figures=[row(**bound, ours=0.09, chain="scan")]).part("summary")
    assert "angular speed after the touchdown, at least (90 %) 0.09 rad/s published 0.1816" in known
    levels = {
        "posterior": "(95 %)",
        "published": "whatever this telemetry says",
        "a.csv": "(of the motions of a.csv)",
    }
    for chain, words in levels.items():
        assert words in page_of(
            tmp_path / "a", figures=[row(**bound, ours=0.09, chain=chain)]
        ).part("summary")
    left = page_of(
        tmp_path / "a", figures=[row(**bound, ours=0.09, chain="scan", informative=False)]
    ).part("summary")
    assert (
        "not known from these data" in left
        and "uninformative" in left
        and "0.09 rad/s published" not in left
    )


def test_the_first_screen_of_a_study_begins_with_what_the_file_carries(study):
    summary, page = (
        json.loads((study / "summary.json").read_text("utf-8")),
        Page(study / "report.html"),
    )
    first = page.part("summary")
    assert first.index(summary["carries"]) < first.index(" ".join(summary["headline"][0].split()))
    assert "No conclusion." not in first
    for line in summary["score"]:
        assert line in first
    provenance = page.part("provenance")
    for key in ("chain", "noise", "calibration"):
        assert summary[key] in provenance
    assert "more" not in page.ids("section") or "uninformative" not in page.part("more")


@pytest.mark.long
@pytest.mark.evidence(
    "report", "verified", "a file that carries no conclusion: each panel's readings in random order"
)
def test_a_page_without_conclusions_gives_the_reason_and_claims_nothing(no_conclusion):
    summary, page = (
        json.loads((no_conclusion / "summary.json").read_text("utf-8")),
        Page(no_conclusion / "report.html"),
    )
    first = page.part("summary")
    assert {"candidates", "touchdown", "landing", "motions"} <= set(
        summary["missing"]
    ) and "could not be" not in page.text
    assert not any((no_conclusion / f"{name}.nc").exists() for name in FILES_OF_CANDIDATES)
    assert (
        "No conclusion. Nothing follows from this telemetry about the motion after the first touchdown:"
        in first
    )
    missing = summary["missing"]
    told = next(
        text for name in ("candidates", "level_set") if ", as " in (text := missing.get(name, ""))
    )
    assert " ".join(told.split(", as ", 1)[1].split()) in first and summary["carries"] in first
    assert not re.search(r"rad/s|once in|or faster|all that fits|families|four lines", first)
    plots = json.loads(page.data)["plots"]
    assert "speed" not in plots and not {"lander", "outcomes", "strategies"} & set(
        page.ids("section")
    )
    assert "four families" not in page.text.lower() and "Motions that fit" not in page.text
    verdicts = {
        attrs["data-verdict"] for tag, attrs in page.tags if tag == "tr" and "data-row" in attrs
    }
    assert "uninformative" not in verdicts


def test_stale_files_of_motions_are_no_claim_where_nothing_is_concluded(study, tmp_path):
    """Files of an earlier run, or of another hand, do not put a motion on the first screen."""
    summary = json.loads((study / "summary.json").read_text("utf-8"))
    copy(
        study,
        tmp_path,
        "speed.nc",
        "motion-best-fit.nc",
        "candidates.nc",
        "scan_telemetry.nc",
        "timeline.toml",
        "vehicle.toml",
    )
    summary["missing"] = {
        "candidates": "Section 2.3: the motions that follow: not reproduced, as the panels are exchanged"
    }
    page = page_of(tmp_path, **summary)
    assert "the first touchdown: the panels are exchanged." in page.part("summary")
    plots = json.loads(page.data)["plots"]
    assert "speed" not in plots and plots["lines"]["views"][0]["text"].count("Pale") == 0


@pytest.mark.evidence(
    "report", "verified", "the telemetry's scan first; the printed lines' scan called what it is"
)
def test_rate_space_shows_the_telemetry_first_and_no_lines_that_are_not_there(study, tmp_path):
    page = Page(study / "report.html")
    plot = json.loads(page.data)["plots"]["lines"]
    first, second = plot["views"]
    assert first["label"] == "Scan against the directions of this telemetry"
    assert second["label"].startswith("No telemetry: scan against")
    names = [plot["data"][k].get("name", "") for k in first["show"]]
    assert (
        "candidates" in names
        and "fitted line" not in names
        and not any("family" in name for name in names)
    )
    found = next(
        r
        for r in json.loads((study / "summary.json").read_text("utf-8"))["figures"]
        if r["id"] == "lines_found"
    )
    assert (
        f"Of the 4 lines that the paper prints (dashed) {found['ours']} come out of them."
        in first["text"]
    )
    assert "four" not in page.part("rate-space").split("No telemetry")[0].lower()
    told = next(
        attrs["aria-label"] for tag, attrs in page.tags if attrs.get("data-plot") == "lines"
    )
    assert "four" not in told and "line" not in told
    volumes = json.loads(page.data)["slices"]["volumes"]
    scans = [
        xr.load_dataset(study / f"{name}.nc", engine="h5netcdf")["emd"]
        for name in ("scan_telemetry", "scan_published_lines")
    ]
    assert [v["low"] for v in volumes] == pytest.approx(
        [float(np.log10(scan.min())) for scan in scans], abs=1e-6
    )


def test_the_axis_of_the_first_picture_holds_every_motion(study, tmp_path):
    copy(study, tmp_path, "timeline.toml")
    speed = xr.load_dataset(study / "speed.nc", engine="h5netcdf")
    speed["speed"][{"level": 0, "time": 3}] = 0.0
    speed["speed"][{"level": 2}] = 5.0
    speed.to_netcdf(tmp_path / "speed.nc", engine="h5netcdf")
    made = json.loads(
        page_of(tmp_path, **json.loads((study / "summary.json").read_text("utf-8"))).data
    )["plots"]["speed"]["layout"]
    usual = json.loads(Page(study / "report.html").data)["plots"]["speed"]["layout"]
    assert (
        made["yaxis"]["range"][1] > np.log10(5)
        and made["yaxis"]["range"] == made["yaxis2"]["range"]
    )
    known = xr.load_dataset(study / "speed.nc", engine="h5netcdf")
    low, high = usual["yaxis"]["range"]
    for part in ("speed", "speed_after_collision"):
        assert low <= np.log10(known[part].min()) and np.log10(known[part].max()) <= high
