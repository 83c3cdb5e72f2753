"""A figure as SVG inside a page: its colours follow the page's theme, and nothing in it can be anything but a drawing."""

from __future__ import annotations

import io
import re
import warnings
from xml.etree import ElementTree

from matplotlib.figure import Figure

from sunspin.output.figures import lay_out

THEME = {
    "#000000": "ink",
    "#ffffff": "paper",
    "#0072b2": "blue",
    "#d55e00": "orange",
    "#009e73": "green",
    "#cc79a7": "pink",
    "#e69f00": "gold",
    "#56b4e9": "sky",
    "#999999": "grey",
    "#cccccc": "line",
    "#555555": "muted",
}
"""Colours of the figures -> the page's variables of them, which a dark page has in other shades."""

DRAWS = {"svg", "g", "defs", "path", "use", "rect", "clipPath", "image", "circle", "pattern"}
"""Elements that stay: matplotlib writes text as paths, so that no label is ever text or markup in the drawing."""

STAYS = re.compile(
    r"id|style|d|x|y|cx|cy|r|width|height|viewBox|transform|clip-path|fill|stroke|href|opacity|patternUnits|preserveAspectRatio"
)
HREF = re.compile(r"#[\w.-]+|data:image/png;base64,[\w+/=\s]*")
LEAST_PX_PER_INCH = 66
"""In a narrower window the figure scrolls, so that its smallest letters stay legible; on a telephone only once it is enlarged."""

MOST_PX_PER_INCH = 115


def inline_svg(figure: Figure, prefix: str) -> str:
    """The drawing as an `svg` element, with `prefix` before every id: two drawings of a page must not share any."""
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # odd numbers of a damaged file are drawn as far as they can be
        lay_out(figure).savefig(buffer, format="svg", metadata={"Date": None})
    root = _cleaned(ElementTree.fromstring(buffer.getvalue()), prefix)
    for name in ("width", "height"):
        root.attrib.pop(name, None)
    wide = float(figure.get_size_inches()[0])
    root.set(
        "style",
        f"min-width:{LEAST_PX_PER_INCH * wide:.0f}px;max-width:{MOST_PX_PER_INCH * wide:.0f}px",
    )
    root.set("aria-hidden", "true")  # the element around it says in words what it shows
    return ElementTree.tostring(root, encoding="unicode")


def _cleaned(element: ElementTree.Element, prefix: str) -> ElementTree.Element:
    kept = ElementTree.Element(_local(element.tag))
    for name, value in element.attrib.items():
        name = _local(name)
        if not STAYS.fullmatch(name) or (name == "href" and not HREF.fullmatch(value)):
            continue
        if name == "id" or (name == "href" and value.startswith("#")):
            value = value.replace("#", "") if name == "id" else value[1:]
            value = f"{'#' if name == 'href' else ''}{prefix}{value}"
        elif name in ("style", "clip-path", "fill", "stroke"):
            value = re.sub(r"url\(#([^)]*)\)", rf"url(#{prefix}\1)", _themed(value))
        kept.set(name, value)
    kept.extend(
        _cleaned(child, prefix)
        for child in element
        if isinstance(child.tag, str) and _local(child.tag) in DRAWS
    )
    return kept


def _local(name: str) -> str:
    return name.rpartition("}")[2]


def _themed(style: str) -> str:
    """A style with the page's colours; those that no theme knows stay as they are."""
    return re.sub(
        r"#[0-9a-fA-F]{6}\b",
        lambda m: f"var(--{THEME[m[0].lower()]})" if m[0].lower() in THEME else m[0],
        style,
    )
