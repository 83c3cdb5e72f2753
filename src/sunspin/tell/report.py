"""A results folder as one HTML page that opens from disk and asks the network for nothing."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jinja2 import Environment, StrictUndefined

from sunspin.tell.results import plain, write_whole


class Picture(NamedTuple):
    """A PNG in the results folder, what it shows in words, and its caption."""

    path: Path
    alt: str
    caption: str


def write_report(
    target: Path,
    *,
    title: str,
    synthetic: bool,
    conclusions: Sequence[str],
    pictures: Sequence[Picture],
    rows: Mapping[str, Sequence[Any]] | Sequence[Any],
    provenance: dict[str, Any],
) -> Path:
    """Write the page; `rows` in one table, or by heading. Everything that comes from outside is escaped by the template engine."""
    template = resources.files("sunspin").joinpath("tell", "report.html.j2").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    figures = [
        {"data": base64.b64encode(p.path.read_bytes()).decode("ascii"), "alt": p.alt, "caption": p.caption} for p in pictures
    ]
    named = rows if isinstance(rows, Mapping) else {"": rows}
    page = environment.from_string(template).render(
        title=title,
        synthetic=synthetic,
        conclusions=list(conclusions),
        figures=figures,
        tables=[{"title": name, "rows": [_shown(row) for row in part]} for name, part in named.items()],
        provenance=provenance,
    )
    return write_whole(target, lambda part: part.write_text(page, "utf-8"))


def _shown(row: Any) -> dict[str, str]:
    verdict, style = {True: ("yes", "yes"), False: ("no", "no"), None: ("not compared", "")}[row.agrees]
    return {
        "what": row.what,
        "published": number_text(row.published),
        "ours": number_text(row.ours),
        "unit": row.unit,
        "tolerance": "" if row.tolerance is None else number_text(row.tolerance),
        "verdict": verdict,
        "verdict_class": style,
        "note": row.note,
        "source": row.source,
    }


def number_text(value: Any) -> str:
    """A number with five digits, lists in brackets, anything else as it is."""
    value = plain(value)
    if isinstance(value, list):
        return "[" + ", ".join(number_text(item) for item in value) + "]"
    if isinstance(value, dict):
        return "; ".join(f"{key.replace('_', ' ')} {number_text(item)}" for key, item in value.items())
    if isinstance(value, float):
        return f"{value:.5g}" if np.isfinite(value) else "none"
    return "none" if value is None else str(value)
