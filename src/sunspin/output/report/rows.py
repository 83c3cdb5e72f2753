"""The comparison of a study with the paper: the text and the verdict of each row."""

from __future__ import annotations

import re
from collections import Counter
from typing import Any

from sunspin.output.text import number_text

VERDICTS = {
    "agrees": "✓ agrees",
    "differs": "✗ differs",
    "uninformative": "○ uninformative",
    "comes-back": "✓ input, reproduced",
    "not-back": "✗ input, not reproduced",
    "put-in": "– input",
    "holds": "✓ paper's arithmetic, holds",
    "holds-not": "✗ paper's arithmetic, does not hold",
    "arithmetic": "– paper's arithmetic, no verdict",
    "not-comparable": "– not comparable",
    "drawn": "– figure, side by side",
}
"""Verdict of a row -> its words on the page, in the order of the filters."""

TESTS = ("agrees", "differs", "uninformative")
"""Verdicts of rows that test the method."""

OF_KIND = {
    "put_in": {True: "comes-back", False: "not-back", None: "put-in"},
    "arithmetic": {True: "holds", False: "holds-not", None: "arithmetic"},
}
"""Kind of a row -> its entry `holds` -> verdict."""

SOURCES = {
    "telemetry": "from this telemetry",
    "scan": "from the scan's 90 % set",
    "posterior": "from the posterior of the readings",
    "published": "from the printed lines",
    "none": "no telemetry",
}
"""Source of our value, the entry `chain` of a row, in words; another source is the name of a file of candidates."""

FIGURE = re.compile(r"figure_\d+")
"""Form of the ids of rows that only refer a figure of the paper to figures of this run."""


def comparison(summary: dict[str, Any]) -> dict[str, Any] | None:
    """Return the comparison with the paper for the page: title, filters with counts, rows by section and part.

    None if the summary has no rows.
    """
    entries = summary.get("figures")
    entries = entries if isinstance(entries, list) else []
    entries = [row for row in entries if isinstance(row, dict)]
    if not entries:
        return None
    rows = [_row_texts(row) for row in entries]
    sections: dict[str, dict[str, list[dict[str, str]]]] = {}  # section -> part -> rows
    for row in rows:
        sections.setdefault(row["section"], {}).setdefault(row["part"], []).append(row)
    count = Counter(row["verdict"] for row in rows)
    has_tests = any(count[key] for key in TESTS)
    title = "The paper against this run, row by row" if has_tests else "Figures of this run"
    filters = [
        {"key": key, "label": text[2:], "count": count[key]}  # without the mark of the verdict
        for key, text in VERDICTS.items()
        if count[key]
    ]
    return {"title": title, "sections": sections, "filters": filters}


def verdict_of(row: dict[str, Any]) -> str:
    """Return the key of `VERDICTS` for a row of the summary. Only an informative test agrees or differs.

    A row without a kind, as of an old file, is a test. A row without a verdict is a figure, or its values cannot be compared.
    """
    kind = row.get("kind")
    # anything but a truth value, as in a damaged file, is no verdict
    agrees, holds = (
        row[key] if isinstance(row.get(key), bool) else None for key in ("agrees", "holds")
    )
    if kind in OF_KIND:
        return OF_KIND[kind][holds]
    if kind in ("test", None):
        if row.get("informative") is False:
            return "uninformative"
        if agrees is not None:
            return "agrees" if agrees else "differs"
    return "drawn" if FIGURE.fullmatch(str(row.get("id", ""))) else "not-comparable"


def _row_texts(row: dict[str, Any]) -> dict[str, str]:
    """Return the texts of a row, by the names that the template uses.

    The remark is the tolerance of a test with a verdict, or says why a row cannot be compared.
    """
    verdict, tolerance = verdict_of(row), row.get("tolerance")
    remark = ""
    if tolerance is not None and verdict in ("agrees", "differs"):
        remark = f"within {number_text(tolerance, 3)}"
    if row.get("informative") is False and verdict == "not-comparable":
        remark = "the data leave it open"
    source = str(row.get("chain") or "")
    unchanged = ("id", "part", "section", "what", "note", "source")
    return {name: str(row.get(name, "")) for name in unchanged} | {
        "published": "–" if row.get("published") is None else number_text(row["published"]),
        "ours": number_text(row.get("ours")),
        "interval": interval_text(row.get("low"), row.get("high")),
        "before": interval_text(row.get("prior_low"), row.get("prior_high")),
        "chain": SOURCES.get(source, f"from the motions of {source}" if source else ""),
        "unit": "" if row.get("unit") == "1" else str(row.get("unit", "")),
        "verdict": verdict,
        "verdict_text": VERDICTS[verdict],
        "remark": remark,
    }


def interval_text(low: Any, high: Any) -> str:
    """Return an interval as text, with three digits and at most five decimals.

    If both ends are lists, each pair is an interval. The text is empty if an end is missing.
    """
    if low is None or high is None:
        return ""
    if isinstance(low, list) and isinstance(high, list) and len(low) == len(high):
        texts = (interval_text(*ends) for ends in zip(low, high, strict=True))
        return "; ".join(text for text in texts if text)
    return " to ".join(
        number_text(round(end, 5) if isinstance(end, float) and abs(end) < 1 else end, 3)
        for end in (low, high)
    )
