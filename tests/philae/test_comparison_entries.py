"""Comparison entries of the paper: keys of `published.toml`, texts, and verdicts by tolerance."""

import tomllib

import pytest

from sunspin.cases import load_case
from sunspin.philae import row as rw

CASE = load_case("philae")
TABLES = rw.read_tables(CASE)
KEYS = {"published", "unit", "what", "place", "put_in", "kind", "chain", "tolerance", "at_most"}

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


@pytest.fixture
def case(monkeypatch):
    """The case with the tables above."""
    monkeypatch.setattr(rw, "read_tables", lambda case: tomllib.loads(TABLE))
    return CASE


def test_each_table_has_the_keys_of_a_comparison_entry():
    for name, table in TABLES.items():
        assert {"what", "place"} <= set(table) or name == "line", name
        assert table.get("kind", "test") in rw.KINDS, name
        notes = {key for key in table if key.startswith("note")}
        assert set(table) <= KEYS | notes | {"value", "used", "compared"}, name


def test_an_entry_fills_its_texts_and_is_judged_by_its_tolerance(case):
    row = rw.make_row(case, "turns", 2.4, notes=("note", "note_late"), who="us")
    assert row.what == "turns of us" and row.source == "paper, section 9" and row.agrees is True
    assert row.note == "by us, within 0.5; the paper's scan has steps of 0.015 rad/s, late"
    assert rw.make_row(case, "turns", 2.6, who="us").agrees is False
    assert rw.make_row(case, "turns", 9.0, who="us", agrees=True).agrees is True


def test_an_entry_with_at_most_is_judged_from_above(case):
    row = rw.make_row(case, "grows", [0.0, 0.1])
    assert row.agrees is True and row.tolerance == 0.1
    assert row.note == "" and row.source == "elsewhere"
    assert rw.make_row(case, "grows", [0.0, 0.11]).agrees is False
    assert rw.make_row(case, "grows", None, tolerance=None).agrees is None
