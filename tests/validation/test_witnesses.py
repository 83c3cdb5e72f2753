"""`python -m validation witnesses`: each witness agrees to the digits that it should, and would notice an error."""

from functools import cache

import numpy as np
import pytest

import sunspin as ss
from sunspin.vehicle import Vehicle
from validation.witnesses import SUN, WITNESSES, Row, euler


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


def test_a_moment_of_inertia_off_by_a_millionth_changes_the_phase():
    """A part in a million of one moment is 1e-4 rad after 200 turns: invariants alone would not tell."""
    moments, omega, t = (
        np.array([0.7, 1.0, 1.6]),
        np.array([0.2, 0.3, 1.0]),
        np.linspace(0, 1300, 50),
    )
    wrong = ss.propagate(
        Vehicle("wrong", np.diag(moments * [1, 1, 1 + 1e-6])), omega, SUN, None, t
    )["omega_B"].values
    assert 1e-5 < np.abs(wrong - euler(moments, omega, t)).max() < 1e-2
