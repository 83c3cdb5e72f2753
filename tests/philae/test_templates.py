"""Texts of the rows of the paper: every table of `rows.toml` is used, every row has one, and slips are one sentence."""

import ast
from pathlib import Path

import pytest

from sunspin.philae import row as rw
from sunspin.philae import templates as tp
from sunspin.telemetry.case import load_case

CASE = load_case("philae")
TABLES = tp.templates(CASE)
CODE = [ast.parse(path.read_text("utf-8")) for path in Path(tp.__file__).parent.glob("*.py")]

TABLE = """
[turns]
what = "turns of {who}"
unit = "1"
place = "section 9"
published = 2.0
tolerance = 0.5
note = "by {who}, within {tolerance:g}; the paper's scan has steps of {paper[scan_step]} rad/s"
note_late = ", late"

[grows]
what = "growth"
published = "none"
unit = "1"
place = "not stated; elsewhere"
at_most = 0.1
"""


def strings(tree: ast.AST) -> set[str]:
    return {
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }


def asked_for() -> set[str]:
    """Names that calls of `row` spell out."""
    calls = [node for tree in CODE for node in ast.walk(tree) if isinstance(node, ast.Call)]
    second = [
        call.args[1]
        for call in calls
        if isinstance(call.func, ast.Name) and call.func.id == "row" and len(call.args) > 2
    ]
    return set().union(*(strings(name) for name in second if isinstance(name, ast.Constant)))


@pytest.fixture
def case(monkeypatch):
    """The case with the tables above."""
    monkeypatch.setattr(rw, "templates", lambda case: tp.parse_templates(TABLE, "rows.toml"))
    return CASE


def test_each_table_is_used_and_each_row_has_one():
    said = set().union(*map(strings, CODE))
    inputs = {name for name, table in TABLES.items() if "input" in table.values}
    assert len(asked_for()) > 80 and asked_for() <= set(TABLES)
    assert (
        set(TABLES) - inputs <= said and inputs <= set(CASE.published) and not inputs & asked_for()
    )
    assert {
        key for table in TABLES.values() for key in table.texts if key.startswith("note_")
    } <= said


def test_each_table_says_what_a_row_needs():
    for name, table in TABLES.items():
        assert (
            {"what", "unit", "place"} <= set(table.texts)
            or name in CASE.published
            or name == "line"
        ), name


def test_texts_are_filled_and_numbers_judged(case):
    made = rw.row(case, "turns", 2.4, says=("note", "note_late"), who="us")
    assert made.what == "turns of us" and made.source == "paper, section 9" and made.agrees is True
    assert made.note == "by us, within 0.5; the paper's scan has steps of 0.015 rad/s, late"
    assert rw.row(case, "turns", 2.6, who="us").agrees is False
    assert rw.row(case, "turns", 9.0, who="us", agrees=True).agrees is True
    assert rw.row(case, "turns", 1.0, who="us", sigma=1.0).low == pytest.approx(-0.645)


def test_ours_may_be_bounded_from_above(case):
    made = rw.row(case, "grows", [0.0, 0.1])
    assert (
        made.agrees is True
        and made.tolerance == 0.1
        and made.note == ""
        and made.source == "elsewhere"
    )
    assert rw.row(case, "grows", [0.0, 0.11]).agrees is False
    assert rw.row(case, "grows", None, tolerance=None).agrees is None
