"""A published figure beside ours: what `summary.json` and the report show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sunspin.cases import Case

STATEMENT = "contradiction_"
"""Rows that hold the paper against itself or public facts, rather than against this run, have ids that begin so."""


@dataclass(frozen=True)
class Row:
    """A published figure and ours: agrees is None where the comparison is not one of equal things (see the note).

    `by_construction`: it agrees because what was measured here was made from it, which tests the code and not the paper.
    """

    id: str
    what: str
    published: Any
    ours: Any
    unit: str
    tolerance: float | list[float] | None
    agrees: bool | None
    note: str
    source: str
    by_construction: bool = False


def source_of(place: str) -> str:
    """Where a figure stands: a place in the paper, or the source of a fact that the paper does not state."""
    elsewhere = place.removeprefix("not stated; ")
    return elsewhere if elsewhere != place else f"paper, {place}"


def published_row(case: Case, key: str, ours: Any, tolerance: float | list[float] | None, note: str = "") -> Row:
    """The figure `key` of the case beside ours; agrees where they differ by no more than the tolerance, if there is one."""
    published = case.published[key]
    agrees = None
    if tolerance is not None:
        agrees = bool(np.all(np.abs(np.asarray(ours, float) - np.asarray(published.value, float)) <= tolerance))
    return Row(
        key, published.what, published.value, ours, published.unit, tolerance, agrees, note, source_of(published.place)
    )


def statement(
    name: str, what: str, published: Any, ours: Any, unit: str, tolerance: float | None, note: str, place: str
) -> Row:
    """A row on a statement; it stands where both numbers differ by no more than the tolerance, if there is one."""
    agrees = None
    if tolerance is not None:
        agrees = bool(np.all(np.abs(np.asarray(ours, float) - np.asarray(published, float)) <= tolerance))
    return Row(f"{STATEMENT}{name}", what, published, ours, unit, tolerance, agrees, note, f"paper, {place}")
