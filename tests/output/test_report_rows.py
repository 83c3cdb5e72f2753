"""Comparison entries and first screen of a study's page: names, counts, and a page without conclusions."""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from sunspin.cases import load_case
from sunspin.output.report import write_report
from sunspin.output.report.rows import VERDICTS, interval_text, verdict_of
from tests.output.test_compare import folder
from tests.support.browser import HOSTILE, Page

FILES_OF_CANDIDATES = tuple(
    "candidates outcomes-off outcomes-held strategies speed motion-smallest-emd".split()
)


def row(**given: Any) -> dict[str, Any]:
    """A row as summary.json has it."""
    names = "tolerance agrees low high prior_low prior_high holds".split()
    plain = {"id": "some", "what": "what", "published": 1.0, "ours": 1.0, "unit": "1", "note": ""}
    plain |= {"source": "", "kind": "test", "depends": "data", "informative": True}
    plain |= {"chain": "telemetry", "part": "a part", "section": "a section"}
    return dict.fromkeys(names) | plain | given


def page_of(path: Path, **summary: Any) -> Page:
    """The page of a study whose summary is this."""
    return Page(write_report(folder(path, "reproduce", **summary)))


def shown_rows(page: Page) -> list[dict]:
    return [attrs for tag, attrs in page.tags if tag == "tr" and "data-row" in attrs]


@pytest.mark.parametrize(
    ("given", "verdict"),
    [
        ({"agrees": True}, "agrees"),
        ({"agrees": False}, "differs"),
        ({"agrees": None, "informative": False}, "uninformative"),
        ({"agrees": True, "informative": False}, "uninformative"),
        ({"kind": "put_in", "holds": True}, "comes-back"),
        ({"kind": "put_in", "holds": False}, "not-back"),
        ({"kind": "put_in"}, "put-in"),
        ({"kind": "put_in", "agrees": True, "holds": False}, "not-back"),
        ({"kind": "arithmetic", "holds": True}, "holds"),
        ({"kind": "arithmetic", "holds": False}, "holds-not"),
        ({"kind": "arithmetic"}, "arithmetic"),
        ({"kind": "not_comparable", "holds": True}, "not-comparable"),
        ({"kind": "not_comparable", "id": "figure_3"}, "drawn"),
        ({"kind": "of another time"}, "not-comparable"),
        ({"agrees": "yes"}, "not-comparable"),
    ],
)
def test_only_an_informative_test_agrees_or_differs(given, verdict):
    assert verdict_of(row(**given)) == verdict and verdict in VERDICTS


@pytest.mark.evidence(
    "report", "verified", "the counts of summary.json, recounted from the rows that the page shows"
)
def test_entries_and_filters_have_the_counts_of_the_summary(study):
    summary = json.loads((study / "summary.json").read_text("utf-8"))
    page = Page(study / "report.html")
    shown = {attrs["data-row"]: attrs["data-verdict"] for attrs in shown_rows(page)}
    assert len(shown) == len(summary["figures"])
    found = Counter(shown.values())
    filters = [re.fullmatch(r"(.+) \((\d+)\)", label) for label in page.buttons()[1:]]
    expected = {VERDICTS[key][2:]: n for key, n in found.items()}
    assert {each[1]: int(each[2]) for each in filters} == expected
    counts = summary["counts"]
    every = [counts, counts["without_telemetry"], counts["paper"]]
    kinds = "agree differ uninformative put_in not_comparable".split()
    total = {key: sum(part[key] for part in every) for key in kinds}
    assert found["agrees"] == total["agree"] and found["differs"] == total["differ"]
    assert found["uninformative"] == total["uninformative"]
    assert found["comes-back"] + found["not-back"] + found["put-in"] == total["put_in"]
    assert found["not-comparable"] == total["not_comparable"] and found["drawn"] == 13
    own = ("holds", "holds-not", "arithmetic")
    assert sum(found[key] for key in own) == sum(part["arithmetic"] for part in every)


@pytest.mark.long
def test_contradictions_are_a_table_of_the_unchanged_study_alone(study, no_conclusion):
    shipped = json.loads((load_case("philae").folder / "contradictions.json").read_text("utf-8"))
    shown = Page(study / "report.html").part("tables")
    assert f"Computed on {shipped['made']} by python -m studies.contradictions" in shown
    assert all(" ".join(each["other_reading"].split()) in shown for each in shipped["statements"])
    assert "contradicts itself" not in Page(no_conclusion / "report.html").text


def test_an_entry_shows_its_interval_the_possible_range_and_its_source(tmp_path):
    ranges = {"low": 0.0912, "high": 1.44, "prior_low": 0.00712, "prior_high": 1.45}
    rows = [
        row(id="a", informative=False, chain="scan", **ranges),
        row(id="b", low=[1.0, 3.0], high=[2.0, 4.0], chain="mine.csv", agrees=True, tolerance=0.5),
        row(id="c", low=None, high=2.0, chain="none", agrees=False),
    ]
    text = page_of(tmp_path / "a", figures=rows).text
    assert "interval: 0.0912 to 1.44 possible before: 0.00712 to 1.45" in text
    assert "from the scan's 90 % set" in text
    assert "interval: 1 to 2; 3 to 4" in text
    assert "from the motions of mine.csv" in text
    assert "✓ agrees within 0.5" in text
    assert text.count("interval:") == 2 and "no telemetry" in text and "○ uninformative" in text
    assert interval_text([1, 2], 3) == "(1, 2) to 3" and interval_text("x", None) == ""


def test_texts_of_entries_and_of_the_first_screen_are_escaped(tmp_path):
    texts = tuple("what unit note source chain part section published ours low high".split())
    rows = [row(id=f"{HOSTILE}{k}", **dict.fromkeys(texts, HOSTILE)) for k in range(2)]
    rows.append(row(id="rate_at_touchdown_bound", ours=1.0, unit=HOSTILE, chain=HOSTILE))
    names = "title carries noise calibration chain stop cite command".split()
    lists = dict.fromkeys(("score", "headline", "conclusions"), [HOSTILE] * 3)
    texts = dict.fromkeys(names, HOSTILE) | lists | {"missing": {"candidates": HOSTILE}}
    page = page_of(tmp_path / "bad", figures=rows, **texts)
    assert [attrs.get("id") for tag, attrs in page.tags if tag == "script"] == ["data", None]
    assert page.text.count(" ".join(HOSTILE.split())) > 30
    ids = [f"{HOSTILE}0", f"{HOSTILE}1", "rate_at_touchdown_bound"]
    assert [attrs["data-row"] for attrs in shown_rows(page)] == ids


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
    odd = {"missing": [1], "carries": 3, "score": "x", "headline": ["one"]}
    page = page_of(tmp_path / "odd", figures=figures, **odd)
    assert "one" in page.part("summary")


@pytest.mark.long
@pytest.mark.evidence(
    "report", "verified", "telemetry without information: each panel's readings in random order"
)
def test_a_page_without_conclusions_gives_the_reason_and_no_result(no_conclusion):
    summary = json.loads((no_conclusion / "summary.json").read_text("utf-8"))
    page = Page(no_conclusion / "report.html")
    first = page.part("summary")
    lacking = {"candidates", "touchdown", "collision", "strategies", "motions"}
    assert lacking <= set(summary["missing"]) and "could not be" not in page.text
    assert not any((no_conclusion / f"{name}.nc").exists() for name in FILES_OF_CANDIDATES)
    said = "No conclusion. Nothing follows from this telemetry about the motion after the first"
    assert f"{said} touchdown:" in first
    missing = summary["missing"]
    told = next(
        text for name in ("candidates", "level_set") if ", as " in (text := missing.get(name, ""))
    )
    assert " ".join(told.split(", as ", 1)[1].rstrip(".").split()) in first
    seen = first.split("In full (")[0]  # the rest is closed
    assert not re.search(r"rad/s|once in|at least|all that fits|families|four lines", seen)
    assert not any(name.startswith(("motion", "speed")) for name in json.loads(page.data))
    assert not (no_conclusion / "speed.svg").exists() and "four families" not in page.text.lower()
    assert "uninformative" not in {attrs["data-verdict"] for attrs in shown_rows(page)}
