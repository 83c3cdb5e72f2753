"""The paper against this run, row by row."""

from __future__ import annotations

from typing import Any

from sunspin.study.row import STATEMENT
from sunspin.tell.report.read import Results
from sunspin.tell.report.section import Section, Special
from sunspin.tell.text import number_text

VERDICTS = {True: ("agrees", "✓ agrees"), False: ("differs", "✗ differs"), None: ("open", "– not compared")}
MADE = ("made", "✓ as it was made")
"""Agrees because the telemetry, or a record, was made from it: that tests the code, not the paper."""

STATEMENTS = {True: ("stands", "✓ stands"), False: ("contradicted", "✗ contradicted"), None: ("open", "– no verdict")}
LONG = 160
"""Longer values are cut in the table and whole in summary.json."""


def section(results: Results) -> Section | None:
    """All rows of the summary, by part, with filters."""
    given = [row for row in results.summary.get("figures", []) if isinstance(row, dict)]
    if not given:
        return None
    rows = [_shown(row) for row in given]
    counts = {key: sum(row["verdict"] == key for row in rows) for key, _ in (*VERDICTS.values(), MADE, *STATEMENTS.values())}
    parts: dict[str, list[dict[str, str]]] = {}
    for row in rows:
        parts.setdefault(row["part"], []).append(row)
    compared = counts["agrees"] + counts["differs"]
    lead = []
    if compared:
        lead = [
            f"{counts['agrees']} of {compared} compared figures agree within the tolerance given, {counts['differs']} differ, "
            f"{counts['open']} stand without a verdict because the two are not of the same thing; the note says why. "
        ]
    if counts["made"]:
        lead.append(
            f"{counts['made']} more agree because the telemetry or a record was made from them: that tests the code, not the paper."
        )
    if counts["contradicted"]:
        lead.append(
            f"{counts['contradicted']} statements of the paper contradict its own figures or public facts; they judge the paper, "
            f"not this run."
        )
    content = {"parts": [{"title": title, "rows": part} for title, part in parts.items()], "counts": counts}
    title = "The paper against this run, row by row" if compared else "Figures of this run"
    return Section("comparison", title, lead, [Special("comparison", content)])


def _shown(row: dict[str, Any]) -> dict[str, str]:
    statement = str(row.get("id", "")).startswith(STATEMENT)
    agrees = row.get("agrees")
    verdict, text = (STATEMENTS if statement else VERDICTS)[agrees if isinstance(agrees, bool) else None]
    if row.get("by_construction") is True:
        verdict, text = MADE
    tolerance = row.get("tolerance")
    return {
        "id": str(row.get("id", "")),
        "part": str(row.get("part", "")),
        "what": str(row.get("what", "")),
        "published": _cut(number_text(row.get("published"), 4)),
        "ours": _cut(number_text(row.get("ours"), 4)),
        "unit": str(row.get("unit", "")),
        "tolerance": "" if tolerance is None else number_text(tolerance, 3),
        "verdict": verdict,
        "verdict_text": text,
        "note": str(row.get("note", "")),
        "source": str(row.get("source", "")),
    }


def _cut(text: str) -> str:
    return text if len(text) <= LONG else text[: LONG - 1] + "…"
