"""Comparison entries of the paper: keys of `published.toml`, texts, and verdicts by tolerance."""

import tomllib

import pytest

from sunspin.cases import load_case
from sunspin.philae import row as rw

CASE = load_case("philae")
TABLES = rw.read_tables(CASE)
KEYS = {"published", "unit", "what", "place", "put_in", "kind", "chain", "tolerance", "at_most"}
KEYS |= {"note", "value", "used", "compared"}
FILLED = {"line", "line_distance", "rz_held", "valley_width", "angle"}
FILLED |= {"rate_at_touchdown_bound", "rate_at_touchdown_max"}
"""Tables whose rows say in the study what they compare."""

TABLE = """
[turns]
what = "turns"
unit = "1"
place = "section 9"
published = 2.0
tolerance = 0.5
note = "by us"

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
        assert "place" in table or name == "line", name
        assert ("what" in table) == (name not in FILLED), name
        assert table.get("kind", "test") in rw.KINDS, name
        assert set(table) <= KEYS, name
        assert not any("{" in text for text in table.values() if isinstance(text, str)), name


def test_an_entry_has_the_texts_of_its_table_and_is_judged_by_its_tolerance(case):
    row = rw.make_row(case, "turns", 2.4)
    assert row.what == "turns" and row.source == "paper, section 9" and row.agrees is True
    other = rw.make_row(case, "turns", 2.4, {"grows": "late"})
    assert row.note == other.note == "by us"
    assert rw.make_row(case, "turns", 2.4, {"turns": "late"}, what="more").note == "late"
    assert rw.make_row(case, "turns", 2.6).agrees is False
    assert rw.make_row(case, "turns", 9.0, agrees=True).agrees is True


def test_an_entry_with_at_most_is_judged_from_above(case):
    row = rw.make_row(case, "grows", [0.0, 0.1])
    assert row.agrees is True and row.tolerance == 0.1
    assert row.note == "" and row.source == "elsewhere"
    assert rw.make_row(case, "grows", [0.0, 0.11]).agrees is False
    assert rw.make_row(case, "grows", None, tolerance=None).agrees is None
