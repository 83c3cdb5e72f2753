"""A figure of the paper beside ours: what `summary.json` and the report show, and what counts as agreement.

Four kinds, counted apart:

- "test": the method or the telemetry could have given another figure;
- "put_in": the telemetry, or a record, was made from it, so that it comes back tests the code and not the paper;
- "arithmetic": the paper's own figures, or stored constants, against each other: no telemetry changes them;
- "not_comparable": two different things, shown side by side.

Only a test agrees or differs. A figure that depends on candidate motions carries the interval over the chosen set and the one
over all that was possible before the data; where the first is not clearly narrower the row is uninformative and judges nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sunspin.landing.tally import Estimate
from sunspin.output.report.rows import STATEMENT
from sunspin.telemetry.case import Case

KINDS = ("test", "put_in", "arithmetic", "not_comparable")
DEPENDS = ("data", "candidates")

NARROWER = 0.5
"""An interval informs where it is narrower than this part of what was possible before the data."""

SIGMAS = 3.0
"""A share or mean over candidates informs where it differs from the one over all that was possible by this many errors."""


@dataclass(frozen=True)
class Row:
    """One figure of the paper beside ours.

    Attributes
    ----------
    published, ours : the paper's figure; ours by the paper's own recipe
    tolerance : how far ours may be off; None where an interval, or nothing, judges
    agrees : only for informative rows of kind "test", else None
    low, high : interval of ours: over the chosen candidates ("candidates") or from the noise ("data")
    prior_low, prior_high : the same over all that was possible before the data, where the row depends on candidates
    informative : False where the data leave nearly all that was possible
    chain : what made ours: "telemetry", the candidates ("scan", "posterior", "published", a file's name) or "none"; where a row
        does not say, it is that of its part's section
    holds : for the other kinds, whether the two figures agree (a figure put in comes back, a statement of the paper stands)
    weak : of a statement: hardly more than a matter of wording
    sentence, other_reading, changes : of a statement: what the paper says, how else it could be read, what it changes
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
    kind: str = "test"
    depends: str = "data"
    low: Any = None
    high: Any = None
    prior_low: Any = None
    prior_high: Any = None
    informative: bool = True
    chain: str = ""
    holds: bool | None = None
    weak: bool = False
    sentence: str = ""
    other_reading: str = ""
    changes: str = ""

    def __post_init__(self) -> None:
        assert self.kind in KINDS and self.depends in DEPENDS, (self.id, self.kind, self.depends)


def settled(row: Row, put_in: bool = False) -> Row:
    """The row as it counts: only an informative test agrees or differs; what another kind compared goes to `holds`."""
    kind = "put_in" if put_in else row.kind
    if kind == "test" and row.agrees is None and row.informative:
        kind = "not_comparable"
    if kind == "test":
        return replace(row, agrees=row.agrees if row.informative else None)
    return replace(row, kind=kind, agrees=None, holds=row.agrees if row.holds is None else row.holds)


def counts(rows: list[Row]) -> dict[str, int]:
    """How many rows agree, differ, are uninformative tests, and how many there are of each other kind."""
    tests = [row for row in rows if row.kind == "test"]
    found = {
        "agree": sum(row.agrees is True for row in tests), "differ": sum(row.agrees is False for row in tests),
        "uninformative": sum(not row.informative for row in tests),
    }  # fmt: skip
    return found | {kind: sum(row.kind == kind for row in rows) for kind in KINDS[1:]}


def source_of(place: str) -> str:
    """Where a figure stands: a place in the paper, or the source of a fact that the paper does not state."""
    elsewhere = place.removeprefix("not stated; ")
    return elsewhere if elsewhere != place else f"paper, {place}"


def published_row(
    case: Case, key: str, ours: Any, tolerance: float | list[float] | None, note: str = "", sigma: Any = None, **more: Any
) -> Row:
    """The figure `key` of the case beside ours; agrees where they differ by no more than the tolerance, if there is one.

    `sigma`: one standard error of ours from the noise; the interval is 1.645 of them either way (90 %). `more`: fields of `Row`.
    """
    published = case.published[key]
    agrees = None
    if tolerance is not None:
        agrees = bool(np.all(np.abs(np.asarray(ours, float) - np.asarray(published.value, float)) <= tolerance))
    if sigma is not None:
        more |= dict(zip(("low", "high"), interval(ours, sigma), strict=True))
    row = Row(
        key, published.what, published.value, ours, published.unit, tolerance, agrees, note, source_of(published.place)
    )
    return replace(row, **more)


def interval(ours: Any, sigma: Any) -> tuple[Any, Any]:
    """Ours less and plus 1.645 sigma, in the shape of ours."""
    middle, half = np.asarray(ours, dtype=np.float64), 1.645 * np.asarray(sigma, dtype=np.float64)
    return (middle - half).tolist(), (middle + half).tolist()


def over_candidates(
    row: Row, chain: str, chosen: tuple[float, float], possible: tuple[float, float], half_digit: float | None = None
) -> Row:
    """The row with the least and largest value over the chosen candidates, and over all that was possible.

    It informs where the first range is narrower than half of the second, and then agrees where the published value, widened by
    half a unit of its last digit, lies inside. Without `half_digit` there is no published number to hold against it.
    """
    low, high = chosen
    informative = bool(high - low < NARROWER * (possible[1] - possible[0]))
    agrees = None
    if half_digit is not None and informative:
        agrees = bool(low - half_digit <= row.published <= high + half_digit)
    return replace(
        row, depends="candidates", chain=chain, low=low, high=high, prior_low=possible[0], prior_high=possible[1],
        informative=informative, agrees=agrees, tolerance=half_digit,
    )  # fmt: skip


def share_of_candidates(row: Row, chain: str, chosen: Estimate, possible: Estimate, agrees: bool | None) -> Row:
    """The row with a share or mean over even draws of the candidates (90 % interval of its sampling error), and over the box.

    It informs where the two differ by more than three sampling errors; `agrees` is the caller's criterion, stated in the note.
    """
    apart = abs(chosen.value - possible.value)
    informative = bool(apart > SIGMAS * np.hypot(chosen.error, possible.error))
    low, high = interval(chosen.value, chosen.error)
    before = interval(possible.value, possible.error)
    return replace(
        row, depends="candidates", chain=chain, low=low, high=high, prior_low=before[0], prior_high=before[1],
        informative=informative, agrees=agrees if informative else None,
    )  # fmt: skip


def statement(
    name: str, what: str, published: Any, ours: Any, unit: str, tolerance: float | list[float] | None, place: str, *,
    sentence: str, other_reading: str, changes: str, note: str = "", weak: bool = False,
) -> Row:  # fmt: skip
    """A row on a statement of the paper; it stands where both numbers differ by no more than the tolerance, if there is one.

    Parameters
    ----------
    sentence : what the paper says, in a few words
    other_reading : the fairest other reading, and why it does not help
    changes : what follows differently
    weak : hardly more than a matter of wording
    """
    holds = None
    if tolerance is not None:
        holds = bool(np.all(np.abs(np.asarray(ours, float) - np.asarray(published, float)) <= tolerance))
    told = f"The paper: {sentence} Read otherwise: {other_reading} Changes: {changes}"
    return Row(
        f"{STATEMENT}{name}", what, published, ours, unit, tolerance, None, f"{note} {told}".strip(), f"paper, {place}",
        kind="arithmetic", chain="none", holds=holds, weak=weak, sentence=sentence, other_reading=other_reading, changes=changes,
    )  # fmt: skip
