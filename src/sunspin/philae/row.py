"""Compare a figure of the paper with ours: what `summary.json` and the report show, and what counts as agreement.

Four kinds are counted separately:

- "test": the method or the telemetry could have given another figure;
- "put_in": the telemetry, or a record, was made from the figure, so agreement tests the code and not the paper;
- "arithmetic": the paper's own figures, or stored constants, compared with each other; no telemetry changes them;
- "not_comparable": two different quantities, shown side by side.

Only a test agrees or differs. A figure that depends on candidate motions has two intervals. One is over the chosen candidates, the
other over everything that was possible before the data. If the first is not clearly narrower, the row is uninformative and judges
nothing.

The words for a figure are in the case's `published.toml`. A step of the study computes the numbers and calls `make_row`, with the
notes that depend on them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np

from sunspin.base.errors import InputError
from sunspin.base.untrusted import read_toml
from sunspin.cases import Case
from sunspin.landing.tally import Estimate

KINDS = ("test", "put_in", "arithmetic", "not_comparable")


@dataclass(frozen=True)
class Row:
    """One figure of the paper compared with ours.

    Attributes
    ----------
    published, ours : the paper's figure; ours by the paper's own recipe
    tolerance : largest allowed difference; None if an interval, or nothing, judges the row
    agrees : only for informative rows of kind "test", else None
    depends : what the interval of ours depends on: "data" (the noise) or "candidates"
    low, high : interval of ours, over the chosen candidates or from the noise
    prior_low, prior_high : the same interval before the data, if the row depends on candidates
    informative : False if the data leave nearly everything that was possible
    chain : source of ours: "telemetry", the candidates ("scan", "posterior", "published", a file's name) or "none". An empty
        string means the source of the row's section.
    holds : for the other kinds, whether the two figures agree
    """

    id: str
    what: str
    published: Any
    ours: Any
    source: str
    note: str = ""
    unit: str = "1"
    tolerance: float | list[float] | None = None
    agrees: bool | None = None
    kind: str = "test"
    depends: str = "data"
    low: Any = None
    high: Any = None
    prior_low: Any = None
    prior_high: Any = None
    informative: bool = True
    chain: str = ""
    holds: bool | None = None


def settle(row: Row, put_in: bool = False) -> Row:
    """Return the row as it is counted: `agrees` only for an informative test, `holds` for the other kinds.

    `put_in` changes the kind of the row to "put_in". A test without a verdict becomes "not_comparable".
    """
    kind = "put_in" if put_in else row.kind
    if kind == "test" and row.agrees is None and row.informative:
        kind = "not_comparable"
    if kind == "test":
        return replace(row, agrees=row.agrees if row.informative else None)
    holds = row.agrees if row.holds is None else row.holds
    return replace(row, kind=kind, agrees=None, holds=holds)


def withhold_verdict(row: Row) -> Row:
    """Return the row without a verdict: a test becomes "not_comparable"."""
    return replace(row, kind=row.kind.replace("test", "not_comparable"), agrees=None)


def label_synthetic(row: Row) -> Row:
    """Return the row with "synthetic telemetry" in front of its note."""
    return replace(row, note="; ".join(filter(None, ["synthetic telemetry", row.note])))


def count_verdicts(rows: list[Row]) -> dict[str, int]:
    """Return how many rows agree, differ and are uninformative tests, and how many belong to each other kind."""
    tests = [row for row in rows if row.kind == "test"]
    verdicts = {
        "agree": sum(row.agrees is True for row in tests),
        "differ": sum(row.agrees is False for row in tests),
        "uninformative": sum(not row.informative for row in tests),
    }
    return verdicts | {kind: sum(row.kind == kind for row in rows) for kind in KINDS[1:]}


@cache
def _tables(path: Path) -> Mapping[str, dict[str, Any]]:
    """Read a file of published figures once."""
    return read_toml(path.read_text("utf-8"), str(path), InputError)


def read_tables(case: Case) -> Mapping[str, dict[str, Any]]:
    """Return the tables of the case's `published.toml` by the names of figures and rows. The file is read once."""
    return _tables(case.folder / "published.toml")


def make_row(
    case: Case, name: str, ours: Any, notes: Mapping[str, str] | None = None, **given: Any
) -> Row:
    """Return the row of figure `name` with our value, and with what the case's `published.toml` has for it.

    Without `agrees` or `holds` in `given` the numbers are compared: they agree if they differ by at most the tolerance. In a table
    with `at_most` they agree if ours is not larger. Without a tolerance nothing is judged.

    Parameters
    ----------
    notes : dict, optional
        Notes by the names of rows. A row without one has that of its table.
    given
        Fields of `Row` that replace those of the table. With another `id` the published figure is that of the table `id`.
    """
    about = read_tables(case).get(given.get("id", name), {}) | read_tables(case)[name]
    # a place that begins with "not stated" names another source than the paper
    source = about["place"].removeprefix("not stated; ")
    values: dict[str, Any] = {
        "id": name,
        "what": about.get("what", ""),
        "published": about.get("published", about.get("value")),
        "source": f"paper, {source}" if source == about["place"] else source,
        "tolerance": about.get("tolerance", about.get("at_most")),
        "unit": about.get("unit", "1"),
        "kind": about.get("kind", "test"),
        "chain": about.get("chain", "none" if about.get("kind") == "arithmetic" else ""),
        "note": (notes or {}).get(name, about.get("note", "")),
    }
    comparison = Row(ours=ours, **(values | given))
    if comparison.tolerance is None or {"agrees", "holds"} & set(given):
        return comparison
    difference = np.asarray(ours, dtype=np.float64)
    if "at_most" not in about:
        difference = np.abs(difference - np.asarray(comparison.published, float))
    return replace(comparison, agrees=bool(np.all(difference <= comparison.tolerance)))


def interval_90(ours: Any, sigma: Any) -> tuple[Any, Any]:
    """Return `ours` minus and plus 1.645 sigma: the 90 % interval of a Gaussian, in the shape of `ours`."""
    centre, half = np.asarray(ours, dtype=np.float64), 1.645 * np.asarray(sigma, dtype=np.float64)
    return (centre - half).tolist(), (centre + half).tolist()


def judge_range(
    row: Row, chain: str, chosen: tuple[float, float], possible: tuple[float, float]
) -> Row:
    """Return the row with the ranges (least, largest) of the value over the chosen candidates and over everything possible.

    The row is informative if the first range is narrower than half of the second. It then agrees if the published value, widened by
    the row's tolerance, lies inside. That tolerance is half a unit of the published last digit. Without it there is no published
    number to compare with, and nothing is judged.
    """
    (low, high), (prior_low, prior_high) = chosen, possible
    informative = bool(high - low < 0.5 * (prior_high - prior_low))
    agrees, half_digit = None, cast(float | None, row.tolerance)
    if half_digit is not None and informative:
        agrees = bool(low - half_digit <= row.published <= high + half_digit)
    ranges = {"low": low, "high": high, "prior_low": prior_low, "prior_high": prior_high}
    source: dict[str, Any] = {"depends": "candidates", "chain": chain}
    return replace(row, informative=informative, agrees=agrees, **source, **ranges)


def judge_share(
    row: Row, chain: str, chosen: Estimate, possible: Estimate, agrees: bool | None
) -> Row:
    """Return the row with a share or mean over random candidates and over the scan range, each with a 90 % interval.

    The row is informative if the two differ by more than three sampling errors. `agrees` is the caller's criterion, which the note
    states.
    """
    difference = abs(chosen.value - possible.value)
    informative = bool(difference > 3.0 * np.hypot(chosen.error, possible.error))
    # without a tolerance `judge_range` fills in the intervals and judges nothing
    unjudged = replace(row, tolerance=None)
    with_intervals = judge_range(unjudged, chain, interval_90(*chosen), interval_90(*possible))
    agrees = agrees if informative else None
    return replace(with_intervals, tolerance=row.tolerance, informative=informative, agrees=agrees)
