"""Sections into one HTML file: the template, the scripts, and the data as JSON that no label can break out of."""

from __future__ import annotations

import base64
import json
import re
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from sunspin.base.errors import OutputError, sentence
from sunspin.output.folder import plain, write_whole
from sunspin.output.report import sections
from sunspin.output.report.read import Results, read_results
from sunspin.output.report.section import Plot, Section, Special

MAX_PICTURES = 5_000_000
"""Bytes of drawn figures put into the page; what is beyond stays in the folder and is named."""


REDRAWN = {
    "fig03_measured",
    "fig04_phases",
    "fig08_maps",
    "fig09_lines",
    "fig09_telemetry",
    "fig13_after_collision",
    "strategies",
}
"""Figures of the study that the page has in another form, most of them to be turned; the files stay in the folder."""


TURNS = re.compile("[\\u061c\\u200e\\u200f\\u202a-\\u202e\\u2066-\\u2069]")
"""Characters that turn the direction of the text after them, by which names from outside could show what they are not."""


def write_report(folder: str | Path, ours: bool = False, figures: bool = False) -> Path:
    """Write `report.html` of a results folder from the files in it, and return its path; `ours` as in `read_results`.

    With `figures` the page's flat plots are also written as PNG and SVG.
    """
    results = read_results(folder, ours)
    with np.errstate(
        all="ignore"
    ):  # a damaged file may hold any numbers: they are shown as they are
        page = sections.page(results)
        data = _data(page)
        if figures:
            _save_figures(results, page)
    turned = bool(data["plots"]) or len(data) > 1  # else nothing on the page needs the library
    redrawn = REDRAWN if results.command == "reproduce" else results.drawn
    pictures, left_out = _pictures(
        [picture for picture in results.pictures if picture.path.stem not in redrawn]
    )
    text = _template().render(
        page=page,
        pictures=pictures,
        left_out=left_out,
        problems=results.problems,
        style=Markup(_asset("page.css")),
        data=Markup(_json(data)),
        licence=_licence() if turned else "",
        scripts=[
            Markup(_script(text))
            for text in (*([_plotly()] if turned else []), _asset("page.js"), _asset("lander.js"))
        ],
    )
    text = TURNS.sub(lambda found: f"\\u{ord(found[0]):04x}", text)
    return write_whole(
        results.folder / "report.html",
        lambda part: part.write_bytes(text.encode("utf-8", "backslashreplace")),
    )


def _save_figures(results: Results, page: sections.Page) -> None:
    from sunspin.output.figures import save
    from sunspin.output.report.described import figure_of, flat_plots

    for plot in flat_plots(page.sections, page.hero):
        sections.guarded(
            results,
            f"the figure {plot.id}",
            lambda _, plot=plot: save(figure_of(plot), results.folder, plot.id),
        )


@cache
def _template() -> Any:
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(_asset("page.html.j2"))


def _asset(name: str) -> str:
    return resources.files("sunspin").joinpath("output", "report", name).read_text(encoding="utf-8")


def _data(page: sections.Page) -> dict[str, Any]:
    """What the scripts need: each plot by its id, and the data of special parts by their kind."""
    parts: list[Section] = [*page.sections]
    items = [page.hero] if page.hero is not None else []
    items += [item for part in parts for item in part.items]
    plots = {
        item.id: {
            "data": item.data,
            "layout": item.layout,
            "views": item.views,
            "narrow": item.narrow,
            "height": item.height,
        }
        for item in items
        if isinstance(item, Plot)
    }
    return {
        "plots": plots,
        **{
            item.kind: item.data
            for item in items
            if isinstance(item, Special) and item.data is not None
        },
    }


def _json(data: Any) -> str:
    """JSON for a script element: without a sign that could end the element or a string."""
    text = json.dumps(plain(data), ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _script(text: str) -> str:
    """A script as the content of its element, which ends at the first closing tag whatever it stands in."""
    return text.replace("</script", "<\\/script").replace("<!--", "<\\!--")


def _plotly() -> str:
    """The drawing library, as its package brings it."""
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        raise OutputError(
            sentence("plotly, which draws the report, is not installed", do="pip install plotly")
        ) from None
    return get_plotlyjs()


def _licence() -> str:
    """The library's licence, which travels with it."""
    from importlib import metadata

    files = metadata.files("plotly") or []
    for file in files:
        if file.name.upper().startswith("LICENSE") and "dist-info" in str(file):
            return file.read_text()
    return "plotly.js, Copyright Plotly, Inc., MIT licence"


def _pictures(pictures: list[Any]) -> tuple[list[dict[str, str]], list[str]]:
    shown, left_out, total = [], [], 0
    for picture in pictures:
        size = picture.path.stat().st_size
        if total + size > MAX_PICTURES:
            left_out.append(picture.path.name)
            continue
        total += size
        data = base64.b64encode(picture.path.read_bytes()).decode("ascii")
        shown.append(
            {
                "data": data,
                "alt": picture.alt,
                "caption": picture.caption,
                "file": picture.path.name,
            }
        )
    return shown, left_out
