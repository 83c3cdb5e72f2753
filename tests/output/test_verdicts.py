"""Each status and warning that is printed names the section of the documentation that explains it."""

import ast
import itertools
import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from sunspin.base.errors import InputError
from sunspin.cli import cli
from sunspin.estimate.orbit.check import Verdict
from sunspin.estimate.verdict import Answers
from sunspin.output.verdicts import ANCHORS, PAGE, find_labels, read_section
from sunspin.telemetry.sun import RECONSTRUCTED, STATUS_TEXT

ROOT = Path(__file__).parents[2]


def test_every_label_is_on_the_page_and_is_its_headings_anchor_on_github_too():
    text = (ROOT / PAGE).read_text("utf-8")
    sections = re.findall(r"^\(([a-z-]+)\)=\n## (.+)", text, re.MULTILINE)
    assert sorted(label for label, _ in sections) == sorted(ANCHORS)
    assert all(label == heading.lower().replace(" ", "-") for label, heading in sections)


def warnings():
    """Words in capitals in the texts of estimates and checks, docstrings aside."""
    for folder in ("estimate", "output/check"):
        for path in (ROOT / "src" / "sunspin" / folder).rglob("*.py"):
            nodes = list(ast.walk(ast.parse(path.read_text("utf-8"))))
            docstrings = [node.value for node in nodes if isinstance(node, ast.Expr)]
            texts = [n for n in nodes if isinstance(n, ast.Constant) and n not in docstrings]
            for node in texts:
                yield from re.findall(r"\b[A-Z]{2,}(?: [A-Z]{2,})+\b", str(node.value))


def statuses():
    for unique, x, yz, fits, complete in itertools.product([True, False], repeat=5):
        answers = Answers(unique, (x, yz, yz), fits, complete)
        yield from [answers.why_not] * (not answers.decided)
    yield from (each.value for each in Verdict if each != Verdict.FITS)
    yield from (text for status, text in STATUS_TEXT.items() if status not in RECONSTRUCTED)


def test_every_status_and_every_warning_has_a_section():
    loud = {*warnings()}
    assert len(loud) > 10 and all(find_labels("rates", [text]) for text in [*loud, *statuses()])
    good = [Verdict.FITS.value, *(STATUS_TEXT[status] for status in RECONSTRUCTED)]
    assert not find_labels("rates", good) and not find_labels("compare", loud)


def test_the_last_line_and_the_summary_name_the_section(tmp_path):
    out = str(tmp_path / "sun")
    for words in (["check", "philae", "philae"], ["sun", "philae", "philae", "--out", out]):
        lines = CliRunner().invoke(cli, words, catch_exceptions=False).output.splitlines()
        assert lines[-1].startswith("For what this means: sunspin explain ")
        assert "sun-status" in lines[-1].split()
    assert (
        PAGE + "#sun-status" in json.loads((tmp_path / "sun/summary.json").read_text())["explained"]
    )


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
