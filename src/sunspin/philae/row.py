"""A figure of the paper beside ours: what `summary.json` and the report show, and what counts as agreement.

Four kinds, counted apart:

- "test": the method or the telemetry could have given another figure;
- "put_in": the telemetry, or a record, was made from it, so that it comes back tests the code and not the paper;
- "arithmetic": the paper's own figures, or stored constants, against each other: no telemetry changes them;
- "not_comparable": two different things, shown side by side.

Only a test agrees or differs. A figure that depends on candidate motions carries the interval over the chosen set and the one
over all that was possible before the data; where the first is not clearly narrower the row is uninformative and judges nothing.

What a row says stands in the case's `published.toml`; a step of the study computes its numbers and asks for `row`.
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
    """One figure of the paper beside ours.

    Attributes
    ----------
    published, ours : the paper's figure; ours by the paper's own recipe
    tolerance : how far ours may be off; None where an interval, or nothing, judges
    agrees : only for informative rows of kind "test", else None
    depends : on what an interval of ours does, "data" (the noise) or "candidates"
    low, high : interval of ours, over the chosen candidates or from the noise
    prior_low, prior_high : the same over all that was possible before the data, where the row depends on candidates
    informative : False where the data leave nearly all that was possible
    chain : what made ours: "telemetry", the candidates ("scan", "posterior", "published", a file's name) or "none"; where a row
        does not say, it is that of its part's section
    holds : for the other kinds, whether the two figures agree (a figure put in comes back)
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


def settled(row: Row, put_in: bool = False) -> Row:
    """The row as it counts: only an informative test agrees or differs; what another kind compared goes to `holds`."""
    kind = "put_in" if put_in else row.kind
    if kind == "test" and row.agrees is None and row.informative:
        kind = "not_comparable"
    if kind == "test":
        return replace(row, agrees=row.agrees if row.informative else None)
    holds = row.agrees if row.holds is None else row.holds
    return replace(row, kind=kind, agrees=None, holds=holds)


def labelled(row: Row) -> Row:
    """The row with the words that it is of synthetic telemetry."""
    return replace(row, note="; ".join(filter(None, ["synthetic telemetry", row.note])))


def counts(rows: list[Row]) -> dict[str, int]:
    """How many rows agree, differ, are uninformative tests, and how many there are of each other kind."""
    tests = [row for row in rows if row.kind == "test"]
    verdicts = {
        "agree": sum(row.agrees is True for row in tests),
        "differ": sum(row.agrees is False for row in tests),
        "uninformative": sum(not row.informative for row in tests),
    }
    return verdicts | {kind: sum(row.kind == kind for row in rows) for kind in KINDS[1:]}


@cache
def _tables(path: Path) -> Mapping[str, dict[str, Any]]:
    return read_toml(path.read_text("utf-8"), str(path), InputError)


def tables(case: Case) -> Mapping[str, dict[str, Any]]:
    """The tables of the case's `published.toml`, by the names of figures and rows; read once."""
    return _tables(case.folder / "published.toml")


def row(case: Case, name: str, ours: Any, **given: Any) -> Row:
    """The figure `name` beside ours, with the texts that the case's `published.toml` has for it.

    Numbers within the tolerance of each other agree; of a row with `at_most`, ours that are no larger. `agrees` or `holds` judge
    instead where they are given. A text names fields in braces, with a format as in Python: `{share:.1%}`; `{paper[emd_min]}` is
    a published figure, and the row's own values have their names (`{tolerance:g}`).

    Parameters
    ----------
    says : tuple of str
        The notes of the table that the row shows, one after the other; default: "note".
    given
        Fields of `Row` that replace those of the table (with another `id`, the figure of that name); the rest fills its texts.
    """
    says = ("what", *given.pop("says", ("note",)))
    about = tables(case).get(given.get("id", name), {}) | tables(case)[name]
    values: dict[str, Any] = {
        "id": name,
        "ours": ours,
        "published": about.get("published", about.get("value")),
        "tolerance": about.get("tolerance", about.get("at_most")),
        "unit": about.get("unit", "1"),
        "kind": about.get("kind", "test"),
        "chain": about.get("chain", "none" if about.get("kind") == "arithmetic" else ""),
    }
    judged = bool({"agrees", "holds"} & set(given))
    values |= {key: given.pop(key) for key in list(given) if key in Row.__dataclass_fields__}
    fields = {"paper": {key: figure.value for key, figure in case.published.items()}}
    fields |= values | given
    if isinstance(values["published"], str):
        values["published"] = values["published"].format_map(fields)
    source = about["place"].removeprefix("not stated; ")
    source = f"paper, {source}" if source == about["place"] else source
    what, *notes = (about[key].format_map(fields) if key in about else "" for key in says)
    values = {"source": source, "what": what, "note": "".join(notes), **values}
    comparison = Row(**values)
    if comparison.tolerance is None or judged:
        return comparison
    off = np.asarray(ours, dtype=np.float64)
    if "at_most" not in about:
        off = np.abs(off - np.asarray(comparison.published, float))
    return replace(comparison, agrees=bool(np.all(off <= comparison.tolerance)))


def interval(ours: Any, sigma: Any) -> tuple[Any, Any]:
    """Ours less and plus 1.645 sigma (90 %), in the shape of ours."""
    middle, half = np.asarray(ours, dtype=np.float64), 1.645 * np.asarray(sigma, dtype=np.float64)
    return (middle - half).tolist(), (middle + half).tolist()


def over_candidates(
    row: Row, chain: str, chosen: tuple[float, float], possible: tuple[float, float]
) -> Row:
    """The row with the least and largest value over the chosen candidates, and over all that was possible.

    It informs where the first range is narrower than half of the second, and then agrees where the published value, widened by
    the row's tolerance, lies inside. That is half a unit of its last digit; a row without one has no published number to hold
    against it.
    """
    (low, high), (prior_low, prior_high) = chosen, possible
    informative = bool(high - low < 0.5 * (prior_high - prior_low))
    agrees, half_digit = None, cast(float | None, row.tolerance)
    if half_digit is not None and informative:
        agrees = bool(low - half_digit <= row.published <= high + half_digit)
    ranges = {"low": low, "high": high, "prior_low": prior_low, "prior_high": prior_high}
    about: dict[str, Any] = {"depends": "candidates", "chain": chain} | ranges
    return replace(row, informative=informative, agrees=agrees, **about)


def share_of_candidates(
    row: Row, chain: str, chosen: Estimate, possible: Estimate, agrees: bool | None
) -> Row:
    """The row with a share or mean over even draws of the candidates (90 % interval of its sampling error), and over the box.

    It informs where the two differ by more than three sampling errors; `agrees` is the caller's criterion, stated in the note.
    """
    apart = abs(chosen.value - possible.value)
    informative = bool(apart > 3.0 * np.hypot(chosen.error, possible.error))
    unjudged = replace(row, tolerance=None)
    shown = over_candidates(unjudged, chain, interval(*chosen), interval(*possible))
    agrees = agrees if informative else None
    return replace(shown, tolerance=row.tolerance, informative=informative, agrees=agrees)
