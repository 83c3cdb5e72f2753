"""The page of a results folder: one HTML file that opens from disk and asks the network for nothing."""

from __future__ import annotations

import base64
import json
import re
from functools import cache
from importlib import metadata, resources
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from sunspin.output.folder import CITE, plain, write_whole
from sunspin.output.report import rows
from sunspin.output.report.read import PageTable, Results, read_results
from sunspin.output.text import number_text

FIRST_SENTENCES = 5
"""Sentences of the first screen; the others are closed."""

HIDDEN = (
    *("figures", "sentences", "headline", "score", "conclusions"),
    *("command", "inputs", "title", "changes", "stop"),
)
"""Entries of a summary that the page shows in a place of their own."""

TURNS = re.compile("[\\u061c\\u200e\\u200f\\u202a-\\u202e\\u2066-\\u2069]")
"""Characters that turn the direction of the text after them, by which names from outside could show what they are not."""


def write_report(folder: str | Path) -> Path:
    """Write `report.html` of a results folder from what its manifest lists, and return its path.

    Raises
    ------
    InputError
        Not a results folder.
    """
    results = read_results(folder)
    with np.errstate(all="ignore"):  # a damaged file may hold any numbers
        text = _page(results)
    text = TURNS.sub(lambda turn: f"\\u{ord(turn[0]):04x}", text)
    return write_whole(results.folder / "report.html", text)


def _page(results: Results) -> str:
    summary = results.summary
    views = results.attempt("the views", lambda: _views(results)) or {}
    every = [str(line) for key in ("headline", "score") for line in _list(summary, key)]
    every += [str(line) for line in _list(summary, "conclusions" if every else "sentences")]
    figures = []
    for figure in results.figures:
        kind = "svg+xml" if figure.name.endswith(".svg") else "png"
        data = f"data:image/{kind};base64,{base64.b64encode(figure.content).decode('ascii')}"
        figures.append(figure._asdict() | {"data": data})
    first = len(_list(summary, "headline")) + len(_list(summary, "score")) or FIRST_SENTENCES
    shown = [view for part in views.values() for view in part]
    plotted = {
        view.id: json.loads(view.figure.to_json()) | {"frames": view.frames} for view in shown
    }
    scripts = [*([_plotly()] if plotted else []), _asset("page.js")]
    return _template().render(
        title=str(summary.get("title") or _title(results)),
        results=results,
        stop=str(summary.get("stop") or ""),
        changes=[str(line) for line in _list(summary, "changes")],
        first=every[:first],
        more=every[first:],
        views=views,
        figures=figures,
        tables=results.tables + _events(results),
        rows=results.attempt("the comparison", lambda: rows.comparison(summary)),
        numbers=_numbers(summary),
        provenance=_provenance(results),
        command=str(summary.get("command") or ""),
        style=Markup(_asset("page.css")),
        data=Markup(_json(plotted)),
        licence=_licence() if plotted else "",
        scripts=[Markup(_script(text)) for text in scripts],
    )


def _views(results: Results) -> dict[str, list[Any]]:
    """Interactive views by the heading of their section."""
    from sunspin.output.report.body import body_in_motion
    from sunspin.output.report.views import motions_of, rate_space, sun_on_sphere

    motions = results.attempt("the motions", lambda: motions_of(results)) or []
    parts = {
        "Motion": results.attempt("the motion", lambda: list(body_in_motion(results, motions))),
        "Sun": results.attempt("the Sun's path", lambda: [sun_on_sphere(results, motions)]),
        "Rate space": results.attempt("rate space", lambda: list(rate_space(results))),
    }
    known = {title: [view for view in part or [] if view] for title, part in parts.items()}
    return {title: part for title, part in known.items() if part}


def _list(summary: dict[str, Any], key: str) -> list[Any]:
    value = summary.get(key)
    return value if isinstance(value, list) else []


TITLES = {
    "rates": "How {vehicle} rotates",
    "sun": "Sun directions of {vehicle}",
    "simulate": "A motion of {vehicle}",
    "scan": "Which motions of {vehicle} fit",
    "outcomes": "What the motion of {vehicle} leads to",
    "posterior": "How {vehicle} rotated: the posterior",
}


def _title(results: Results) -> str:
    if results.command not in TITLES:
        return f"Results of sunspin {results.command}"
    vehicle = results.vehicle.name if results.vehicle else "the vehicle"
    vehicle = vehicle.capitalize() if vehicle == "philae" else vehicle
    return TITLES[results.command].format(vehicle=vehicle)


def _events(results: Results) -> list[PageTable]:
    """The events of a timeline as a table."""
    if results.timeline is None:
        return []
    from sunspin.vehicle.timeline import utc_after

    rows = []
    for event in results.timeline.events:
        utc = utc_after(event.t_s, results.timeline.epoch_utc)
        source = event.refined_source or event.source
        rows.append([utc, event.name.replace("_", " "), event.note, source])
    return [PageTable("Timeline", ["UTC", "event", "", "source"], rows)]


def _numbers(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Every entry of the summary that is no list of objects, as text."""
    entries = []
    for key, value in summary.items():
        if key not in HIDDEN:
            nested = value.items() if isinstance(value, dict) else [("", value)]
            for name, item in nested:
                entries.append((f"{key} {name}".replace("_", " ").strip(), number_text(item)))
    return entries


def _provenance(results: Results) -> list[tuple[str, str]]:
    """Version, seed, inputs with hashes, what is synthetic, how to cite."""
    summary = results.summary
    maker = f"sunspin {summary.get('version', 'of unknown version')}, command {results.command}"
    facts = [("computed by", maker)]
    facts += [(key, str(summary[key])) for key in ("seed", "seconds") if key in summary]
    origin = "computed, not measured" if results.synthetic else "no file calls itself synthetic"
    facts.append(("synthetic data", origin))
    for entry in _list(summary, "inputs"):
        if isinstance(entry, dict):
            words = f"{entry.get('file', '')}, SHA-256 {entry.get('sha256', '')}"
            facts.append((str(entry.get("what", "input")), words))
    return [*facts, ("please cite", f"{summary.get('cite', CITE)}; and sunspin with its version")]


@cache
def _template() -> Any:
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    environment.trim_blocks = environment.lstrip_blocks = True
    return environment.from_string(_asset("page.html.j2"))


def _asset(name: str) -> str:
    return resources.files("sunspin").joinpath("output", "report", name).read_text(encoding="utf-8")


def _json(data: Any) -> str:
    """JSON for a script element: without a sign that could end the element or a string."""
    text = json.dumps(plain(data), ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _script(text: str) -> str:
    """A script as the content of its element, which ends at the first closing tag wherever it stands."""
    return text.replace("</script", "<\\/script").replace("<!--", "<\\!--")


def _plotly() -> str:
    """The drawing library, as its package brings it."""
    from plotly.offline import get_plotlyjs

    return get_plotlyjs()


def _licence() -> str:
    """The library's licence, which travels with it."""
    for file in metadata.files("plotly") or []:
        if file.name.upper().startswith("LICENSE") and "dist-info" in str(file):
            return file.read_text()
    return "plotly.js, Copyright Plotly, Inc., MIT licence"
