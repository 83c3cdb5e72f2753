"""The page of a results folder: one HTML file that opens from disk and needs no network."""

from __future__ import annotations

import base64
import json
import re
from functools import cache
from importlib import metadata, resources
from pathlib import Path
from typing import Any

import numpy as np

from sunspin.base.extras import require_extra
from sunspin.output.folder import CITE, LARGEST_SVG_BYTES, to_plain_data, write_whole
from sunspin.output.report.read import PageFigure, PageTable, Results, read_results
from sunspin.output.report.rows import comparison
from sunspin.output.text import number_text

FIRST_SENTENCES = 5
"""Number of sentences on the first screen; the others are folded."""

HIDDEN = (
    *("figures", "sentences", "headline", "score", "conclusions"),
    *("command", "inputs", "title", "changes", "stop"),
)
"""Entries of a summary that the page shows elsewhere than in the list of numbers, or not at all."""

DIRECTION_MARKS = re.compile("[\\u061c\\u200e\\u200f\\u202a-\\u202e\\u2066-\\u2069]")
"""Characters that change the direction of the text after them. A name from a file could use them to look like another name."""


def write_report(folder: str | Path) -> Path:
    """Write `report.html` of a results folder from what its manifest lists, and return its path.

    Raises
    ------
    InputError
        The folder is no results folder, or the packages that write a page are not installed.
    """
    require_extra("pictures", "the HTML page")
    results = read_results(folder)
    with np.errstate(all="ignore"):  # a damaged file may hold any numbers
        text = _render_page(results)
    text = DIRECTION_MARKS.sub(lambda mark: f"\\u{ord(mark[0]):04x}", text)
    return write_whole(results.folder / "report.html", text)


def _render_page(results: Results) -> str:
    """Return the HTML of the page."""
    from markupsafe import Markup

    summary = results.summary
    views = results.attempt("the views", lambda: _views(results)) or {}
    first_sentences, folded_sentences = _sentences(summary)
    figures = []
    for figure in results.figures or results.attempt("the figures", lambda: _draw(results)) or []:
        image_type = "svg+xml" if figure.name.endswith(".svg") else "png"
        data = f"data:image/{image_type};base64,{base64.b64encode(figure.content).decode('ascii')}"
        figures.append(figure._asdict() | {"data": data})
    # id of the HTML element -> figure and frames as plain data for plotly.js
    plotted = {
        view.id: json.loads(view.figure.to_json()) | {"frames": view.frames}
        for views_of_section in views.values()
        for view in views_of_section
    }
    scripts = [*([_plotly()] if plotted else []), _read_asset("page.js")]
    return _template().render(
        title=str(summary.get("title") or _page_title(results)),
        results=results,
        stop=str(summary.get("stop") or ""),
        changes=[str(line) for line in _read_list(summary, "changes")],
        first=first_sentences,
        folded=folded_sentences,
        views=views,
        figures=figures,
        tables=results.tables + _event_tables(results),
        rows=results.attempt("the comparison", lambda: comparison(summary)),
        numbers=_numbers(summary),
        provenance=_provenance(results),
        command=str(summary.get("command") or ""),
        style=Markup(_read_asset("page.css")),
        data=Markup(_json(plotted)),
        licence=_licence() if plotted else "",
        scripts=[Markup(_script(text)) for text in scripts],
    )


def _draw(results: Results) -> list[PageFigure]:
    """Return the figures of a folder that was written without the packages of figures, drawn from its data."""
    from sunspin.output.kind import Context

    context = Context(results.data.get("telemetry"), results.vehicle)
    figures = []
    for data in results.data.values():
        for picture in data.sunspin.pictures(results.command, context):
            suffix = "png" if len(picture.files["svg"]) > LARGEST_SVG_BYTES else "svg"
            name, content = f"{picture.name}.{suffix}", picture.files[suffix]
            figures.append(PageFigure(name, content, picture.alt, picture.caption))
    return figures


def _sentences(summary: dict[str, Any]) -> tuple[list[str], list[str]]:
    """Return the sentences of the first screen, and those that are folded.

    `reproduce` writes headline and score for the first screen, and conclusions; the other commands write sentences in one list.
    """
    first = [str(line) for key in ("headline", "score") for line in _read_list(summary, key)]
    if first:
        return first, [str(line) for line in _read_list(summary, "conclusions")]
    sentences = [str(line) for line in _read_list(summary, "sentences")]
    return sentences[:FIRST_SENTENCES], sentences[FIRST_SENTENCES:]


def _views(results: Results) -> dict[str, list[Any]]:
    """Return the interactive views of each section of the page, by its heading; sections without views are left out."""
    from sunspin.output.report.body import body_in_motion
    from sunspin.output.report.views import rate_space, read_motions, sun_on_sphere

    motions = results.attempt("the motions", lambda: read_motions(results)) or []
    # None: a section that failed (`Results.attempt`). A list that holds None: the Sun's path, without data.
    attempts = {
        "Motion": results.attempt("the motion", lambda: list(body_in_motion(results, motions))),
        "Sun": results.attempt("the Sun's path", lambda: [sun_on_sphere(results, motions)]),
        "Rate space": results.attempt("rate space", lambda: list(rate_space(results))),
    }
    sections = {
        heading: [view for view in views or [] if view is not None]
        for heading, views in attempts.items()
    }
    return {heading: views for heading, views in sections.items() if views}


def _read_list(summary: dict[str, Any], key: str) -> list[Any]:
    """Return a list of the summary; an empty one if the entry is missing or no list."""
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
"""Command -> title of the page of its results."""


def _page_title(results: Results) -> str:
    """Return the title of the page, by command and vehicle."""
    if results.command not in TITLES:
        return f"Results of sunspin {results.command}"
    vehicle = results.vehicle.name if results.vehicle else "the vehicle"
    vehicle = vehicle.capitalize() if vehicle == "philae" else vehicle
    return TITLES[results.command].format(vehicle=vehicle)


def _event_tables(results: Results) -> list[PageTable]:
    """Return the table of the events of the timeline; the list is empty without a timeline."""
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
    """Return name and text of each entry of the summary that the page shows nowhere else.

    A dict becomes an entry for each of its keys.
    """
    entries = []
    for key, value in summary.items():
        if key not in HIDDEN:
            nested = value.items() if isinstance(value, dict) else [("", value)]
            for name, item in nested:
                entries.append((f"{key} {name}".replace("_", " ").strip(), number_text(item)))
    return entries


def _provenance(results: Results) -> list[tuple[str, str]]:
    """Return the provenance as (what, text): version, seed, time, synthetic data, inputs with hashes, citation."""
    summary = results.summary
    program = f"sunspin {summary.get('version', 'of unknown version')}, command {results.command}"
    facts = [("computed by", program)]
    facts += [(key, str(summary[key])) for key in ("seed", "seconds") if key in summary]
    origin = "computed, not measured" if results.synthetic else "no file calls itself synthetic"
    facts.append(("synthetic data", origin))
    for entry in _read_list(summary, "inputs"):
        if isinstance(entry, dict):
            text = f"{entry.get('file', '')}, SHA-256 {entry.get('sha256', '')}"
            facts.append((str(entry.get("what", "input")), text))
    return [*facts, ("please cite", f"{summary.get('cite', CITE)}; and sunspin with its version")]


@cache
def _template() -> Any:
    """Return the template of the page, which escapes all texts that it is given."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(autoescape=True, undefined=StrictUndefined)
    environment.trim_blocks = environment.lstrip_blocks = True
    return environment.from_string(_read_asset("page.html.j2"))


def _read_asset(name: str) -> str:
    """Read a file of this package as text."""
    return resources.files("sunspin").joinpath("output", "report", name).read_text(encoding="utf-8")


def _json(data: Any) -> str:
    """Return data as JSON for a script element: characters that could end the element are escaped."""
    text = json.dumps(
        to_plain_data(data), ensure_ascii=True, allow_nan=False, separators=(",", ":")
    )
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _script(text: str) -> str:
    """Return a script as the content of its element, with closing tags escaped, since the first one would end the element."""
    return text.replace("</script", "<\\/script").replace("<!--", "<\\!--")


def _plotly() -> str:
    """Return plotly.js as the package plotly contains it."""
    from plotly.offline import get_plotlyjs

    return get_plotlyjs()


def _licence() -> str:
    """Return the licence of plotly.js, which must accompany it."""
    for file in metadata.files("plotly") or []:
        if file.name.upper().startswith("LICENSE") and "dist-info" in str(file):
            return file.read_text()
    return "plotly.js, Copyright Plotly, Inc., MIT licence"
