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
    """A published figure and ours: agrees is None where the comparison is not one of equal things (see the note)."""

    id: str
    what: str
    published: Any
    ours: Any
    unit: str
    tolerance: float | list[float] | None
    agrees: bool | None
    note: str
    source: str


def published_row(case: Case, key: str, ours: Any, tolerance: float | list[float] | None, note: str = "") -> Row:
    """The figure `key` of the case beside ours; agrees where they differ by no more than the tolerance, if there is one."""
    published = case.published[key]
    agrees = None
    if tolerance is not None:
        agrees = bool(np.all(np.abs(np.asarray(ours, float) - np.asarray(published.value, float)) <= tolerance))
    return Row(
        key, published.what, published.value, ours, published.unit, tolerance, agrees, note, f"paper, {published.place}"
    )


def statement(
    name: str, what: str, published: Any, ours: Any, unit: str, tolerance: float | None, note: str, place: str
) -> Row:
    """A row on a statement; it stands where both numbers differ by no more than the tolerance, if there is one."""
    agrees = None
    if tolerance is not None:
        agrees = bool(np.all(np.abs(np.asarray(ours, float) - np.asarray(published, float)) <= tolerance))
    return Row(f"{STATEMENT}{name}", what, published, ours, unit, tolerance, agrees, note, f"paper, {place}")
