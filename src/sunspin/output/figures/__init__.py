"""What all figures share: colours, style, axes, titles, files. The modules of `kinds` draw the figures of results."""

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

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#999999")
"""Colours of Okabe and Ito, which colour-blind people can distinguish."""

BLACK, GREY = COLOURS[6], COLOURS[7]
"""Colours of what is no component and no solution: measured values, sizes and truths are black, auxiliary lines grey."""

ABOVE: dict[str, Any] = {
    "loc": "lower right",
    "bbox_to_anchor": (1.0, 1.0),
    "borderaxespad": 0.2,
    "frameon": False,
}
"""Arguments of a legend above the axes, where it covers no data."""

ON_PAPER: dict[str, Any] = {"facecolor": "#ffffff", "edgecolor": "none", "pad": 0.5}
"""Background of a label that is written across lines."""

LONGEST_NAME = 60
"""Characters of a name in a title; a figure is about 100 characters wide."""

LONGEST_LABEL = 14
"""Characters of a name at an axis or in a legend, next to up to 32 others."""

STYLE: Any = {
    "axes.titlesize": 10,
    "figure.titlesize": 10,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "svg.hashsalt": "sunspin",  # the same figure gives the same bytes
}


def styled(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """Decorate a drawing function so that it draws in the style of all figures.

    The first argument of the function is a result, or a dict of results by name. If one of them comes from synthetic telemetry,
    the title says so.
    """

    @wraps(draw)
    def draw_in_style(*args: Any, **options: Any) -> Figure:
        import matplotlib

        with matplotlib.rc_context(STYLE):
            figure = draw(*args, **options)
            results: Any = args[0].values() if isinstance(args[0], dict) else args[:1]
            if any(getattr(result, "attrs", {}).get("synthetic") for result in results):
                figure.suptitle(titled(figure.get_suptitle(), True), wrap=True)
        return figure

    return draw_in_style


def empty_figure(width: float, height: float) -> Figure:
    """Create a figure of a size in inches, without axes; the space between those that are added follows from their labels."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def axes_grid(
    width: float, height: float, rows: int = 1, columns: int = 1, title: str = "", **options: Any
) -> tuple[Figure, Any]:
    """Create a figure of a size in inches, with a title and axes, and return figure and axes.

    `options` are further arguments of matplotlib's `Figure.subplots`. As there, the axes are a single object for one row and
    column, an array (n) for one row or one column, and else an array (rows, columns).
    """
    figure = empty_figure(width, height)
    figure.suptitle(title, wrap=True)
    axes = figure.subplots(rows, columns, **options)
    for each in np.ravel(axes):
        each.tick_params(labelsize=8)
    return figure, axes


def lay_out(figure: Figure) -> Figure:
    """Compute the positions of axes and labels once, and return the figure without a layout engine.

    With an engine, matplotlib would compute them twice for each format that is written. Even an engine that does nothing makes
    matplotlib draw everything an additional time.
    """
    import matplotlib

    if (engine := figure.get_layout_engine()) is not None:
        engine.execute(figure)
        # without these settings matplotlib would take an engine from the user's defaults
        no_engine: Any = {"figure.autolayout": False, "figure.constrained_layout.use": False}
        with matplotlib.rc_context(no_engine):
            figure.set_layout_engine(None)
    return figure


def render(figure: Figure) -> dict[str, bytes]:
    """Return a figure as the contents of its files, by suffix: "png" and "svg"; its layout is computed and fixed."""
    import matplotlib

    contents = {}
    with warnings.catch_warnings(), matplotlib.rc_context(STYLE):
        # a letter that the font lacks is drawn as a box, without a warning for each
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        lay_out(figure)
        for suffix, metadata in (("png", {}), ("svg", {"Date": None})):
            buffer = io.BytesIO()
            figure.savefig(buffer, format=suffix, dpi=130, metadata=metadata)
            contents[suffix] = buffer.getvalue()
    return contents


def write_files(files: Mapping[str, bytes], folder: Path, name: str) -> list[Path]:
    """Write the files of a figure (suffix -> content) into a folder, and return their paths."""
    return [write_whole(folder / f"{name}.{suffix}", files[suffix]) for suffix in files]


def load() -> None:
    """Import what draws, and draw an empty figure once, which loads fonts and all that matplotlib loads at its first use."""
    figure, _ = axes_grid(1, 1, title="empty")
    render(figure)


def escape_name(name: Any, most: int = LONGEST_NAME) -> str:
    """Return a name from a file as matplotlib should print it: dollar signs start no formula.

    A name of more than `most` characters is shortened to its beginning and end.
    """
    text = str(name)
    if len(text) > most:
        begin = (most - 1) // 2  # characters before the ellipsis, the others after it
        end = most - 1 - begin
        text = f"{text[:begin]}…{text[-end:]}"
    return text.replace("$", r"\$")


def axis_labels(names: Iterable[Any], most: int = LONGEST_LABEL) -> list[str]:
    """Return labels for names side by side, such as those of panels; shortened labels that look alike are numbered."""
    labels = [escape_name(name, most) for name in names]
    return [
        f"{label} ({k + 1})" if labels.count(label) > 1 else label for k, label in enumerate(labels)
    ]


def titled(text: str, synthetic: Any) -> str:
    """Return the title of a figure, with a remark if the telemetry is synthetic."""
    return f"{text} (synthetic telemetry)" if synthetic else text
