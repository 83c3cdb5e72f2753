"""Each witness agrees to the digits that it should and would notice an error; docs/accuracy.md states what they give."""

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import sunspin as ss
from sunspin.vehicle import Vehicle
from validation.witnesses import SUN, WITNESSES, Row, euler

PAGE = Path(__file__).parents[2] / "docs" / "accuracy.md"
STATED = {
    "Basilisk's published attitude after 10 s": "attitude (MRP)",
    "Jacobi's elliptic functions, torque-free body, 1300 s": "free body",
    "closed form of the axisymmetric gyrostat, 1 h": "axisymmetric gyrostat",
    "numerical integration (DOP853) of the paper's equations, 45 min": "rates after 45 min",
    "earth mover's distance (EMD) by linear programming": "EMD as the cheapest transport",
}
"""Line of the page -> beginning of the comparisons whose largest difference it states."""

OTHER_MACHINE = 1.5
"""Digits by which differences of rounding size may differ on another processor."""

LUCK = 14.0
"""Digits beyond which two integrations of thousands of steps agree by luck: each step is rounded, on each processor otherwise."""


@cache
def said(witness) -> list[Row]:
    return list(witness())


LONG = ("paper_equations",)


@pytest.mark.evidence(
    "propagate",
    "validated",
    "Basilisk's published attitude, Jacobi's functions, DOP853 on the paper's equations",
)
@pytest.mark.evidence(
    "propagate", "verified", "closed form of the axisymmetric gyrostat; the same run backward"
)
@pytest.mark.parametrize(
    "witness",
    [
        pytest.param(w, id=w.__name__, marks=pytest.mark.long if w.__name__ in LONG else ())
        for w in WITNESSES
    ],
)
def test_a_witness_agrees_to_its_stated_digits(witness, reached):
    rows = said(witness)
    for row in rows:
        reached(f"{row.witness}: {row.what}", row.error, "", row.wanted)
    assert rows and [row for row in rows if not row.holds] == []


@pytest.mark.long
def test_the_page_states_what_the_witnesses_give():
    rows = [row for witness in WITNESSES for row in said(witness)]
    text = PAGE.read_text("utf-8")
    page = dict(re.findall(r"^\| (.+?) \| ([\d.]+e-\d+)\b", text, re.MULTILINE))
    assert set(page) == set(STATED)
    for line, beginning in STATED.items():
        error = max(row.error for row in rows if row.what.startswith(beginning))
        digits = min(-np.log10(float(page[line])), LUCK)
        assert -np.log10(max(error, 1e-16)) > digits - OTHER_MACHINE, line


def test_a_moment_of_inertia_off_by_a_millionth_changes_the_phase():
    """A part in a million of one moment is 1e-4 rad after 200 turns: invariants alone would not tell."""
    moments = np.array([0.7, 1.0, 1.6])
    omega = np.array([0.2, 0.3, 1.0])
    t = np.linspace(0, 1300, 50)
    body = Vehicle("wrong", np.diag(moments * [1, 1, 1 + 1e-6]))
    wrong = ss.propagate(body, omega, SUN, None, t)["omega_B"].values
    assert 1e-5 < np.abs(wrong - euler(moments, omega, t)).max() < 1e-2
