"""A flat plot of the page as a figure: the description that plotly.js draws, drawn by matplotlib for the folder's PNG and SVG."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from sunspin.output.figures import named
from sunspin.output.figures.inline import THEME
from sunspin.output.report.section import Plot, Section

COLOURS = {name: colour for colour, name in THEME.items()}
PX_PER_INCH, WIDE_INCHES = 80.0, 10.0
DASHES = {"dash": "--", "dot": ":"}
SYMBOLS = {"circle": "o", "diamond": "D", "x-thin-open": "x"}
LEFT, WIDTH = 0.09, 0.82
"""Of all axes together, in shares of the figure."""

BELOW, ABOVE = 0.6, 0.75
"""Room below and above them in inches."""


def flat_plots(parts: list[Section], hero: Any) -> Iterator[Plot]:
    """The plots without a third dimension: the others have figures of their own, seen from two sides."""
    for item in [hero, *(item for part in parts for item in part.items)]:
        if isinstance(item, Plot) and "scene" not in item.layout:
            yield item


def figure_of(plot: Plot, view: int = 0) -> Figure:
    """The plot as the page shows it first, or with another of its `views` chosen."""
    figure = Figure(figsize=(WIDE_INCHES, plot.height / PX_PER_INCH))
    chosen = plot.views[view] if plot.views else {}
    layout = plot.layout | (
        {"xaxis": plot.layout["xaxis"] | {"range": chosen["range"]}} if "range" in chosen else {}
    )
    axes: dict[tuple[str, str], Any] = {}
    for k, trace in enumerate(plot.data):
        x, y = trace.get("xaxis", "x"), trace.get("yaxis", "y")
        if "overlaying" in _of(layout, y):  # nothing but a second scale of another
            continue
        if (x, y) not in axes:
            axes[x, y] = _placed(figure, layout, x, y)
        if k in chosen["show"] if chosen else trace.get("visible", True):
            _draw(axes[x, y], trace, _of(layout, x).get("type") == "date")
    for (x, y), one in axes.items():
        first = min(
            (other for other in axes if other[1] == y),
            key=lambda pair: axes[pair].get_position().x0,
        )
        _finish(
            one,
            _of(layout, x),
            _of(layout, y),
            _of(layout, x).get("anchor", y) == y,
            first == (x, y),
        )
    for second in (
        about for key, about in layout.items() if key.startswith("yaxis") and "overlaying" in about
    ):
        _second_scale(axes[second["anchor"], second["overlaying"]], second)
    for note in (*layout.get("shapes", ()), *layout.get("annotations", ())):
        _mark(axes, note)
    shown = {
        text: handle
        for one in axes.values()
        for handle, text in zip(*one.get_legend_handles_labels(), strict=True)
    }
    if "synthetic telemetry" in plot.caption.lower():
        figure.text(LEFT, 0.98, "synthetic telemetry", fontsize=9, va="top")
    figure.legend(
        shown.values(),
        shown.keys(),
        ncols=3,
        fontsize=8,
        frameon=False,
        loc="upper right",
        bbox_to_anchor=(LEFT + WIDTH, 0.99),
    )
    return figure


def _of(layout: dict[str, Any], name: str) -> dict[str, Any]:
    """What the layout says of axis "x2" under "xaxis2"."""
    return layout.get(f"{name[0]}axis{name[1:]}", {})


def _placed(figure: Figure, layout: dict[str, Any], x: str, y: str) -> Any:
    (x0, x1), (y0, y1) = (_of(layout, name).get("domain", (0.0, 1.0)) for name in (x, y))
    inches = figure.get_size_inches()[1]
    bottom, height = BELOW / inches, 1 - (BELOW + ABOVE) / inches
    return figure.add_axes(
        (LEFT + x0 * WIDTH, bottom + y0 * height, (x1 - x0) * WIDTH, (y1 - y0) * height)
    )


def _second_scale(axes: Any, about: dict[str, Any]) -> None:
    other = axes.secondary_yaxis("right")
    other.set_yticks(about["tickvals"], about["ticktext"])
    other.minorticks_off()
    other.set_ylabel(about["title"]["text"])


def _numbers(values: Any) -> np.ndarray:
    if not isinstance(values, dict):
        return np.array(values, dtype=np.float64)
    return np.frombuffer(
        base64.b64decode(values["bdata"]), dtype=np.dtype(values["dtype"]).newbyteorder("<")
    ).astype(np.float64)


def _when(values: Any, is_date: bool) -> np.ndarray:
    numbers = _numbers(values)
    if not is_date:
        return numbers
    known = np.isfinite(numbers)
    return np.where(
        known,
        np.where(known, numbers, 0.0).astype(np.int64).astype("datetime64[ms]"),
        np.datetime64("NaT"),
    )


def _colour(said: str) -> Any:
    """ "@blue:0.25" as matplotlib has it."""
    name, _, alpha = said.removeprefix("@").partition(":")
    return COLOURS[name], float(alpha or 1.0)


def _draw(axes: Any, trace: dict[str, Any], is_date: bool) -> None:
    x, y = _when(trace["x"], is_date), _numbers(trace["y"])
    label = named(trace["name"]) if trace.get("showlegend", True) else None
    line, marker = trace.get("line", {}), trace.get("marker", {})
    if "fill" in trace:
        axes.fill(
            x,
            y,
            fc=_colour(trace["fillcolor"]),
            ec=_colour(line["color"]),
            lw=line["width"],
            ls=DASHES.get(line.get("dash", ""), "-"),
            label=label,
        )
    elif trace["mode"] == "markers":
        axes.plot(
            x,
            y,
            SYMBOLS[marker["symbol"]],
            ms=0.55 * marker["size"],
            color=_colour(marker["color"]),
            label=label,
            lw=0,
        )
    else:
        axes.plot(
            x,
            y,
            DASHES.get(line.get("dash", ""), "-"),
            lw=line["width"],
            color=_colour(line["color"]),
            label=label,
        )


def _finish(axes: Any, x: dict[str, Any], y: dict[str, Any], has_scale: bool, has_y: bool) -> None:
    is_date = x.get("type") == "date"
    if is_date:
        locator = AutoDateLocator(
            minticks=2, maxticks=max(round(10 * axes.get_position().width), 3)
        )
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(ConciseDateFormatter(locator, show_offset=False))
    if "range" in x:
        axes.set_xlim(*_when(x["range"], is_date))
    if y.get("type") == "log":
        axes.set_yscale("log")
        axes.set_ylim(*(10.0 ** np.array(y["range"])))
    elif "range" in y:
        axes.set_ylim(*y["range"])
    axes.tick_params(labelbottom=has_scale)
    axes.set_xlabel(x.get("title", {}).get("text", "") if has_scale else "")
    if "tickvals" in y:
        axes.set_yticks(y["tickvals"], y["ticktext"])
        axes.minorticks_off()
    axes.tick_params(labelleft=has_y)
    axes.set_ylabel(
        "" if not has_y else named(y.get("title", {}).get("text", "")).replace("<br>", "\n"),
        fontsize=9,
    )


def _mark(axes: dict[tuple[str, str], Any], note: dict[str, Any]) -> None:
    """A line across a plot at one time, or a word above it."""
    name = note["xref"].removesuffix(" domain")
    one = next(found for (x, _), found in axes.items() if x == name)
    if "text" not in note:
        one.axvline(
            np.datetime64(round(note["x0"]), "ms"),
            lw=note["line"]["width"],
            ls=":",
            color=_colour(note["line"]["color"]),
        )
        return
    inside = name != note["xref"]
    where = one.transAxes if inside else one.get_xaxis_transform()
    x = note["x"] if inside else np.datetime64(round(note["x"]), "ms")
    one.text(
        x,
        1.01,
        note["text"],
        transform=where,
        ha=note.get("xanchor", "center"),
        va="bottom",
        fontsize=9,
    )
