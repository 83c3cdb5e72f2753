"""What all figures share: colours, style, axes, titles, files. The figures of a result are drawn in its module of `kinds`."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Iterable, Mapping
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sunspin.output.folder import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
LONGEST_NAME, LONGEST_LABEL = 60, 14
"""Characters of a name in a title, and at an axis or in a legend with up to 32 others: a figure is about 100 wide."""

STYLE: Any = {
    "axes.titlesize": 10,
    "figure.titlesize": 10,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "svg.hashsalt": "sunspin",  # the same figure gives the same bytes
}


def styled(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """A drawing function in the style of all figures; the title says so if its first argument, data or a mapping of data by
    name, follows from synthetic telemetry."""

    @wraps(draw)
    def in_style(*args: Any, **more: Any) -> Figure:
        import matplotlib

        with matplotlib.rc_context(STYLE):
            figure = draw(*args, **more)
            every: Any = args[0].values() if isinstance(args[0], dict) else args[:1]
            if any(getattr(each, "attrs", {}).get("synthetic") for each in every):
                figure.suptitle(titled(figure.get_suptitle(), True), wrap=True)
        return figure

    return in_style


def axes_grid(
    width: float, height: float, rows: int = 1, columns: int = 1, title: str = "", **more: Any
) -> tuple[Figure, Any]:
    """A figure (inches) with a title and its axes, as matplotlib's `subplots` returns them; `more`: its further arguments."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    figure.suptitle(title, wrap=True)
    axes = figure.subplots(rows, columns, **more)
    for each in np.ravel(axes):
        each.tick_params(labelsize=8)
    return figure, axes


def lay_out(figure: Figure) -> Figure:
    """Find the places of axes and labels once and for all: matplotlib does it anew, twice, for each format that is written.

    No engine may be left: even one that does nothing makes matplotlib draw everything once more before it draws.
    """
    import matplotlib

    if (engine := figure.get_layout_engine()) is not None:
        engine.execute(figure)
        none: Any = {"figure.autolayout": False, "figure.constrained_layout.use": False}
        with matplotlib.rc_context(none):
            figure.set_layout_engine(None)
    return figure


def drawn(figure: Figure) -> dict[str, bytes]:
    """A figure as the content of a PNG and of an SVG file."""
    import matplotlib

    contents = {}
    with warnings.catch_warnings(), matplotlib.rc_context(STYLE):
        # names may have letters that the font has not: boxes
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        lay_out(figure)
        for suffix, metadata in (("png", {}), ("svg", {"Date": None})):
            buffer = io.BytesIO()
            figure.savefig(buffer, format=suffix, dpi=130, metadata=metadata)
            contents[suffix] = buffer.getvalue()
    return contents


def write(files: Mapping[str, bytes], folder: Path, name: str) -> list[Path]:
    """Write a figure's files."""
    return [write_whole(folder / f"{name}.{suffix}", files[suffix]) for suffix in files]


def save(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure as PNG and SVG."""
    return write(drawn(figure), folder, name)


def named(name: Any, most: int = LONGEST_NAME) -> str:
    """Return a name from outside as text and never as a formula, with at most so many characters: of a longer one begin and end."""
    text = str(name)
    if len(text) > most:
        head = (most - 1) // 2
        text = f"{text[:head]}…{text[head + 1 - most :]}"
    return text.replace("$", r"\$")


def labels_of(names: Iterable[Any], most: int = LONGEST_LABEL) -> list[str]:
    """Return labels for names that stand side by side, such as those of panels; if two look alike when shortened, they are
    numbered."""
    labels = [named(name, most) for name in names]
    return [
        f"{label} ({k + 1})" if labels.count(label) > 1 else label for k, label in enumerate(labels)
    ]


def titled(text: str, synthetic: Any) -> str:
    return f"{text} (synthetic telemetry)" if synthetic else text
