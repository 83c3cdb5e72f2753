"""What the page is made of, as data: sections of text, plots, tables; arrays in the compact form that plotly.js reads."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np
from markupsafe import Markup

COLOURS = ("@blue", "@orange", "@green", "@pink", "@gold", "@sky", "@ink", "@grey")
"""Colour-blind safe (Okabe and Ito), in a light and a dark shade each: page.js puts in the numbers. "@blue:0.2" is translucent."""

SYMBOLS = ("circle", "square", "diamond", "cross", "circle-open", "square-open", "diamond-open")
"""A second sign beside colour. In space plotly.js writes "x" as a letter of a picture font, an empty box where there is none."""

MOTIONS = ("Truth", "Best fit", "Slowest candidate", "Middle candidate", "Fastest candidate")
"""Motions of a study in the order in which they are offered; others follow by name, the descent last."""


def motion_order(title: str) -> tuple[int, str]:
    """A key that sorts titles of motions."""
    last = len(MOTIONS)
    return (
        last + 1 if title == "Descent" else MOTIONS.index(title) if title in MOTIONS else last
    ), title


@dataclass
class Plot:
    """A plot: traces and layout as plotly.js has them, what it shows in words, its caption.

    `views`: choices for the reader, each {"label", "show": indices of the visible traces, "layout": changes}. `narrow`: changes of
    the layout in a narrow window. `numbers`: a table of what is drawn, for those who cannot see it.
    """

    id: str
    data: list[dict[str, Any]]
    layout: dict[str, Any]
    alt: str
    caption: str = ""
    height: int = 420
    views: list[dict[str, Any]] = field(default_factory=list)
    views_label: str = "Show"
    narrow: dict[str, Any] = field(default_factory=dict)
    numbers: Table | None = None
    kind: str = "plot"


@dataclass
class Drawn:
    """A figure of `sunspin.output.figures` as SVG, what it shows in words, its caption."""

    id: str
    svg: Markup
    alt: str
    caption: str
    numbers: Table | None = None
    kind: str = "drawn"


@dataclass
class Table:
    """A table of text; `closed` tables open on demand."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    closed: bool = False
    kind: str = "table"


@dataclass
class Special:
    """A part with a template of its own: `kind` names it, `content` is its data for the template, `data` for the script."""

    kind: str
    content: dict[str, Any]
    data: Any = None


@dataclass
class Section:
    """A heading with what stands under it."""

    id: str
    title: str
    lead: Sequence[str] = ()
    items: list[Any] = field(default_factory=list)


def camera(x: float, y: float, z: float) -> dict[str, Any]:
    """Where a plot in space is seen from, with room below for the names of its axes."""
    return {"eye": {"x": x, "y": y, "z": z}, "center": {"x": 0, "y": 0, "z": -0.1}}


def packed(values: Any, dtype: str = "f4") -> dict[str, Any]:
    """An array (1-D or 2-D) as base64 of its bytes, as plotly.js reads it."""
    array = np.ascontiguousarray(np.asarray(values), dtype=np.dtype(dtype).newbyteorder("<"))
    data = {"dtype": dtype, "bdata": base64.b64encode(array.tobytes()).decode("ascii")}
    return data if array.ndim == 1 else data | {"shape": ",".join(map(str, array.shape))}


def epoch_ms(epoch_utc: str | None) -> float | None:
    """A UTC epoch in milliseconds since 1970, as date axes count."""
    if not epoch_utc:
        return None
    try:
        moment = datetime.fromisoformat(epoch_utc)
    except ValueError:
        return None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp() * 1000.0


def clock(seconds: Any, epoch_utc: str | None) -> dict[str, Any]:
    """Times for an axis: milliseconds of UTC where the epoch is known, else seconds."""
    zero = epoch_ms(epoch_utc)
    values = np.asarray(seconds, dtype=np.float64)
    return packed(values if zero is None else zero + 1000.0 * values, "f8")


def instants(seconds: Sequence[float], epoch_utc: str | None) -> list[float]:
    """The same as plain numbers, for the ends of an axis."""
    zero = epoch_ms(epoch_utc)
    return [float(t) if zero is None else zero + 1000.0 * float(t) for t in seconds]


def utc_text(seconds: float, epoch_utc: str | None, date: bool = False) -> str:
    """15:34:04 of the day, or the seconds where no epoch is known."""
    zero = epoch_ms(epoch_utc)
    if zero is None or not np.isfinite(seconds):
        return f"{seconds:z.1f} s"
    moment = datetime.fromtimestamp(round(zero / 1000.0 + float(seconds)), UTC)
    return moment.strftime("%Y-%m-%d %H:%M:%S" if date else "%H:%M:%S")


def time_axis(epoch_utc: str | None, seconds: Any) -> dict[str, Any]:
    """Layout of a time axis for these times (s from the epoch)."""
    if epoch_ms(epoch_utc) is None:
        return {"title": {"text": "time (s)"}}
    known = np.asarray(seconds, dtype=np.float64)
    known = known[np.isfinite(known)] if np.isfinite(known).any() else np.zeros(1)
    days = dict.fromkeys(utc_text(t, epoch_utc, date=True)[:10] for t in (known.min(), known.max()))
    return {
        "type": "date",
        "title": {"text": f"UTC, {' to '.join(days)}"},
        "hoverformat": "%H:%M:%S",
        "tickformatstops": [
            {"dtickrange": [None, 59_999], "value": "%H:%M:%S"},
            {"dtickrange": [60_000, 43_199_999], "value": "%H:%M"},
            {"dtickrange": [43_200_000, None], "value": "%d %b %H:%M"},
        ],
    }


def thin(count: int, most: int) -> np.ndarray:
    """Indices of at most so many of `count` things, evenly."""
    return (
        np.arange(count)
        if count <= most
        else np.unique(np.linspace(0, count - 1, most).astype(int))
    )
