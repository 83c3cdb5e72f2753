"""Results to figures, a subject a file. Each function returns a matplotlib Figure; `save` writes it as PNG and SVG.

Synthetic telemetry is called so in the title of every figure that shows it.
"""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from sunspin.output.folder import write_whole

# colour-blind safe (Okabe and Ito)
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#999999")
ABOVE: dict[str, Any] = {
    "loc": "lower right",
    "bbox_to_anchor": (1.0, 1.0),
    "borderaxespad": 0.2,
    "frameon": False,
}
"""A legend above the axes, where it covers no data."""
ON_PAPER: dict[str, Any] = {"facecolor": "#ffffff", "edgecolor": "none", "pad": 0.5}
"""The ground of a label that stands on lines."""

matplotlib.rcParams["svg.hashsalt"] = "sunspin"  # the same figure gives the same bytes


def lay_out(figure: Figure) -> Figure:
    """Find the places of axes and labels once and for all: matplotlib does it anew, twice, for each format that is written.

    No engine may be left: even one that does nothing makes matplotlib draw everything once more before it draws.
    """
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        with matplotlib.rc_context(
            {"figure.autolayout": False, "figure.constrained_layout.use": False}
        ):
            figure.set_layout_engine(None)
    return figure


def drawn(figure: Figure) -> dict[str, bytes]:
    """A figure as the content of a PNG and of an SVG file."""
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", "Glyph .* missing from"
        )  # names may have letters that the font has not: boxes
        lay_out(figure)
        found = {}
        for suffix, metadata in (("png", {}), ("svg", {"Date": None})):
            buffer = io.BytesIO()
            figure.savefig(buffer, format=suffix, dpi=130, metadata=metadata)
            found[suffix] = buffer.getvalue()
    return found


def write(files: dict[str, bytes], folder: Path, name: str) -> list[Path]:
    """Write a figure's files."""
    return [
        write_whole(
            folder / f"{name}.{suffix}", lambda part, content=content: part.write_bytes(content)
        )
        for suffix, content in files.items()
    ]


def save(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure as PNG and SVG."""
    return write(drawn(figure), folder, name)


def named(name: Any) -> str:
    """A name from outside as text and never as a formula."""
    return str(name).replace("$", r"\$")


def titled(text: str, synthetic: Any) -> str:
    return f"{text} (synthetic telemetry)" if synthetic else text
