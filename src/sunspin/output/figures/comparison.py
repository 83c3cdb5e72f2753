"""What moved between two results: each row's change in its own errors."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from sunspin.output.figures import COLOURS, named

MOST_ROWS = 30
"""Rows that are drawn: those that moved most."""

LONGEST = 72
"""Characters of a row's name."""

LEAST = 1e-2
"""Smaller moves are drawn at the edge."""


def comparison_figure(found: xr.Dataset) -> Figure:
    """The rows with a known error that moved most, in errors; beyond the line at one they moved by more."""
    known = np.flatnonzero(np.isfinite(found["error"].values) & (found["change"].values != 0))[
        :MOST_ROWS
    ]
    size, change = found["size"].values[known], found["change"].values[known]
    place = np.arange(len(known))[::-1]
    figure = Figure(figsize=(10, 1.5 + 0.27 * max(len(known), 4)), layout="constrained")
    axes = figure.subplots()
    for up, marker, label in ((True, ">", "larger in B"), (False, "<", "smaller in B")):
        use = (change > 0) == up
        axes.plot(
            np.maximum(size[use], LEAST),
            place[use],
            marker,
            ms=7,
            color=COLOURS[1] if up else COLOURS[0],
            label=label,
            zorder=3,
        )
    axes.hlines(place, LEAST, np.maximum(size, LEAST), color="0.8", lw=1)
    axes.axvline(1.0, color="0.3", lw=1, ls="--")
    axes.set_xscale("log")
    axes.set_xlim(LEAST * 0.8, max(10.0, 1.6 * float(size.max(initial=1.0))))
    axes.set_yticks(place, [_label(found, i) for i in known], fontsize=8)
    axes.set_ylim(-0.8, len(known) - 0.2)
    axes.set_xlabel("change from A to B over its error (dashed: as large as the error)")
    whose = " (synthetic telemetry)" if found.attrs.get("synthetic") else ""
    axes.set_title(f"What moved{whose}", loc="left")
    axes.legend(loc="lower right", fontsize=8, framealpha=0.9)
    if not len(known):
        axes.text(
            0.5,
            0.5,
            "no row with a known error moved",
            transform=axes.transAxes,
            ha="center",
            color="0.3",
        )
    return figure


def _label(found: xr.Dataset, i: int) -> str:
    text = str(found["what" if found.attrs["command"] == "reproduce" else "row"].values[i])
    return named(text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}...")
