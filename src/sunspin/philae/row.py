"""A figure of the paper beside ours: what `summary.json` and the report show, and what counts as agreement.

Four kinds, counted apart:

- "test": the method or the telemetry could have given another figure;
- "put_in": the telemetry, or a record, was made from it, so that it comes back tests the code and not the paper;
- "arithmetic": the paper's own figures, or stored constants, against each other: no telemetry changes them;
- "not_comparable": two different things, shown side by side.

Only a test agrees or differs. A figure that depends on candidate motions carries the interval over the chosen set and the one
over all that was possible before the data; where the first is not clearly narrower the row is uninformative and judges nothing.

What a row says stands in the case's `rows.toml` (:mod:`sunspin.philae.templates`); a part computes its numbers and asks for `row`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from sunspin.base.errors import InputError
from sunspin.landing.tally import Estimate
from sunspin.philae.templates import Template, templates
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
    holds : for the other kinds, whether the two figures agree (a figure put in comes back)
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

    def __post_init__(self) -> None:
        assert self.kind in KINDS and self.depends in DEPENDS, (self.id, self.kind, self.depends)


def settled(row: Row, put_in: bool = False) -> Row:
    """The row as it counts: only an informative test agrees or differs; what another kind compared goes to `holds`."""
    kind = "put_in" if put_in else row.kind
    if kind == "test" and row.agrees is None and row.informative:
        kind = "not_comparable"
    if kind == "test":
        return replace(row, agrees=row.agrees if row.informative else None)
    return replace(
        row, kind=kind, agrees=None, holds=row.agrees if row.holds is None else row.holds
    )


def counts(rows: list[Row]) -> dict[str, int]:
    """How many rows agree, differ, are uninformative tests, and how many there are of each other kind."""
    tests = [row for row in rows if row.kind == "test"]
    found = {
        "agree": sum(row.agrees is True for row in tests),
        "differ": sum(row.agrees is False for row in tests),
        "uninformative": sum(not row.informative for row in tests),
    }
    return found | {kind: sum(row.kind == kind for row in rows) for kind in KINDS[1:]}


def source_of(place: str) -> str:
    """Where a figure stands: a place in the paper, or the source of a fact that the paper does not state."""
    elsewhere = place.removeprefix("not stated; ")
    return elsewhere if elsewhere != place else f"paper, {place}"


def row(
    case: Case,
    name: str,
    ours: Any,
    *,
    says: tuple[str, ...] = ("note",),
    sigma: Any = None,
    **given: Any,
) -> Row:
    """The figure `name` beside ours, with the texts that the case's `rows.toml` has for it.

    What the table there leaves out is that of the published figure of the row's id, which is `name` unless another is given.
    Numbers within the tolerance of each other agree; of a row with `at_most`, ours that are no larger. `agrees` or `holds` judge
    instead where they are given.

    Parameters
    ----------
    says : the notes of the table that the row shows, one after the other
    sigma : one standard error of ours from the noise; the interval is 1.645 of them either way (90 %)
    given : fields of `Row` that replace those of the table; anything else is a field of its texts
    """
    template, figure = _template_of(case, name), case.published.get(given.get("id", name))
    values = dict(template.values)
    most = values.pop("at_most", None)
    values.pop("input", None)
    values |= {} if most is None else {"tolerance": most}
    values |= (
        {} if sigma is None else dict(zip(("low", "high"), interval(ours, sigma), strict=True))
    )
    values |= {"id": name, "ours": ours} | {
        key: given.pop(key) for key in list(given) if key in Row.__dataclass_fields__
    }
    if unknown := sorted(set(given) - template.needs):
        raise InputError(f"the row's texts do not name {', '.join(unknown)}", where=template.where)
    fields = {"paper": {key: one.value for key, one in case.published.items()}} | values | given
    texts = {
        key: template.fill(key, fields)
        for key in template.texts
        if key not in values and not key.startswith("note")
    }
    note = "".join(
        template.fill(key, fields) for key in says if key != "note" or key in template.texts
    )
    stated = (
        {}
        if figure is None
        else {
            "what": figure.what,
            "unit": figure.unit,
            "place": figure.place,
            "published": figure.value,
        }
    )
    found: dict[str, Any] = (
        {"tolerance": None, "agrees": None, "note": note} | stated | texts | values
    )
    try:
        found["source"] = source_of(found.pop("place"))
        made = Row(**found)
    except (KeyError, TypeError) as error:
        raise InputError(f"the row lacks a field ({error})", where=template.where) from None
    if made.tolerance is not None and not {"agrees", "holds"} & set(values):
        made = replace(made, agrees=_within(made, most))
    return made


def _template_of(case: Case, name: str) -> Template:
    found = templates(case).get(name)
    if found is None:
        raise InputError("a row has no table in rows.toml", got=name, do="add one with its texts")
    return found


def _within(row: Row, most: float | None) -> bool:
    ours = np.asarray(row.ours, float)
    off = ours if most is not None else np.abs(ours - np.asarray(row.published, float))
    return bool(np.all(off <= row.tolerance))


def interval(ours: Any, sigma: Any) -> tuple[Any, Any]:
    """Ours less and plus 1.645 sigma, in the shape of ours."""
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
    low, high = chosen
    informative = bool(high - low < NARROWER * (possible[1] - possible[0]))
    agrees, half_digit = None, cast(float | None, row.tolerance)
    if half_digit is not None and informative:
        agrees = bool(low - half_digit <= row.published <= high + half_digit)
    return replace(
        row,
        depends="candidates",
        chain=chain,
        low=low,
        high=high,
        prior_low=possible[0],
        prior_high=possible[1],
        informative=informative,
        agrees=agrees,
    )


def share_of_candidates(
    row: Row, chain: str, chosen: Estimate, possible: Estimate, agrees: bool | None
) -> Row:
    """The row with a share or mean over even draws of the candidates (90 % interval of its sampling error), and over the box.

    It informs where the two differ by more than three sampling errors; `agrees` is the caller's criterion, stated in the note.
    """
    apart = abs(chosen.value - possible.value)
    informative = bool(apart > SIGMAS * np.hypot(chosen.error, possible.error))
    low, high = interval(chosen.value, chosen.error)
    before = interval(possible.value, possible.error)
    return replace(
        row,
        depends="candidates",
        chain=chain,
        low=low,
        high=high,
        prior_low=before[0],
        prior_high=before[1],
        informative=informative,
        agrees=agrees if informative else None,
    )
