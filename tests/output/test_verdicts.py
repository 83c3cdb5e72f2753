"""Each status and warning that is printed names the section of the documentation that explains it."""

import itertools
import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from sunspin.base.errors import InputError
from sunspin.cli import cli
from sunspin.estimate.orbit.check import Verdict
from sunspin.estimate.verdict import Answers, Speed
from sunspin.output.verdicts import ANCHORS, PAGE, find_labels, read_section
from sunspin.telemetry.sun import RECONSTRUCTED, STATUS_TEXT

ROOT = Path(__file__).parents[2]


def test_every_label_is_on_the_page_and_matches_the_anchor_of_its_heading():
    text = (ROOT / PAGE).read_text("utf-8")
    sections = re.findall(r"^\(([a-z-]+)\)=\n## (.+)", text, re.MULTILINE)
    assert sorted(label for label, _ in sections) == sorted(ANCHORS)
    assert all(label == heading.lower().replace(" ", "-") for label, heading in sections)


WARNINGS = {
    "POOR FIT (gyro)": "poor-fit",
    "2 passes: NO SOLUTION FITS. Possible causes": "poor-fit",
    "pass 3: the rate changes as no free body's does (0 and 2 deg/s within 60 s)": "poor-fit",
    "half of the passes do not fit": "poor-fit",
    "the gyro contradicts the other readings": "poor-fit",
    "CHECK THE COLUMNS, find out which one is right": "check-the-columns",
    "CHECK THE SIGNS": "check-the-columns",
    "NOT CONSTRAINED (result equals the prior)": "not-constrained",
    "1 pass: SEARCH STOPPED at the computing budget": "incomplete-search",
    "WHEEL SPEED UNKNOWN (reaction-y): assumed 0": "wheel-speed-unknown",
    "a wheel changed its speed in a pass (y: speed changed": "a-wheel-changed-its-speed",
    "the search assumed a sphere, GIVE ITS INERTIA (inertia_kg_m2)": "give-its-inertia",
    "  WRONG UNIT: readings are thousandths": "messages-of-check",
    "  WRONG AXES: ": "messages-of-check",
    "  WEAK PANEL: px gives 0.8": "messages-of-check",
    "  NOISE NOT STATED: neither the vehicle file": "messages-of-check",
    "  HELD VALUES: the gyro repeats the last reading": "messages-of-check",
    "  FROZEN from 2026-01-01T00:10:00Z to": "messages-of-check",
    "the orbit is NOT USED: elements not consistent with the telemetry": "orbit",
    "magnetometer only, NO ORBIT: rates are relative to the field": "orbit",
    "THE MAGNETOMETER HAS THE OPPOSITE SIGN": "orbit",
}
"""Printed warnings -> the label that explains them; tests of each warning hold its words."""


def statuses():
    for unique, x, yz, fits, complete in itertools.product([True, False], repeat=5):
        cure = "" if complete else "budget reached"
        known = Speed(0.1, 0.01, 0.12)
        answers = Answers(unique, (x, yz, yz), fits, complete, (), cure, known)
        yield from [answers.why_not] * (not answers.decided)
    yield from (each.value for each in Verdict if each != Verdict.FITS)
    yield from (text for status, text in STATUS_TEXT.items() if status not in RECONSTRUCTED)


@pytest.mark.parametrize(("text", "label"), WARNINGS.items())
def test_a_warning_is_explained_by_its_section(text, label):
    assert label in find_labels("rates", [text]) and not find_labels("compare", [text])


def test_every_bad_status_has_a_section_and_a_good_one_has_none():
    assert all(find_labels("rates", [text]) for text in statuses())
    good = [Verdict.FITS.value, *(STATUS_TEXT[status] for status in RECONSTRUCTED)]
    assert not find_labels("rates", good)


def test_the_last_line_and_the_summary_name_the_section_to_read(tmp_path):
    out = str(tmp_path / "sun")
    for words in (["check", "philae", "philae"], ["sun", "philae", "philae", "--out", out]):
        lines = CliRunner().invoke(cli, words, catch_exceptions=False).output.splitlines()
        assert lines[-1].startswith("For what this means: sunspin explain ")
        assert "sun-status" in lines[-1].split()
    summary = json.loads((tmp_path / "sun/summary.json").read_text())
    assert PAGE + "#sun-status" in summary["explained"]


def test_explain_prints_the_section_of_the_page(tmp_path):
    page = (ROOT / PAGE).read_text("utf-8")
    for label in ANCHORS:
        done = CliRunner().invoke(cli, ["explain", label], catch_exceptions=False)
        heading, *body = done.output.splitlines()
        assert f"({label})=\n## {heading}\n" in page
        assert any(line in page for line in body if len(line) > 40)
        assert ")=" not in done.output and "](" not in done.output


def test_explain_lists_its_labels_and_names_the_nearest_one():
    done = CliRunner().invoke(cli, ["explain"], catch_exceptions=False)
    assert done.output.split() == list(ANCHORS)
    with pytest.raises(InputError, match="did you mean poor-fit?"):
        read_section("poor-fits")
