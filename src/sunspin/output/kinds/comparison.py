"""Comparisons of two results."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sunspin.output.compare import INTERVAL, SIGMA, TOLERANCE
from sunspin.output.figures import COLOURS, axes_grid, named, styled
from sunspin.output.kind import KINDS, Context, Drawing, Kind, Summary, Table

MOST_LINES = 20
"""Rows that are printed; the table has all."""

MOST_DRAWN = 30
"""Rows that are drawn."""

LONGEST = 72
"""Characters of a row's label in the figure."""

LEAST = 1e-2
"""Changes of less than this part of their errors are drawn at the edge."""

UNITS = {INTERVAL: "half widths", TOLERANCE: "tolerances", SIGMA: "sigmas"}
"""What a change is compared with -> in what its size is counted."""

COLUMNS = ("what", "a", "b", "unit", "change", "error", "of", "size", "beyond", "words")


def comparison_summary(data: Any) -> Summary:
    """How many rows changed by more than their errors, and which."""
    attrs, table = data.attrs, _table(data)
    known = table["error"].notna()
    changed = table[table["beyond"] | (table["words"] != "")]
    names = {"command": "command", "a": "folder_a", "b": "folder_b"}
    numbers: dict[str, Any] = {key: attrs[name] for key, name in names.items()} | {
        "rows": len(table),
        "beyond": int((table["beyond"] & known).sum()),
        "changed_without_error": int((table["beyond"] & ~known).sum()),
        "same_telemetry": bool(attrs["same_telemetry"]),
        "synthetic_telemetry": bool(attrs["synthetic"]),
        **{name: attrs[name].splitlines() for name in ("only_a", "only_b", "said_a", "said_b")},
        "moved": changed.to_dict("records"),
    }
    lines = []
    for letter in "ab":
        lines.append(f"{letter.upper()}: {attrs[f'folder_{letter}']}")
        lines += [f"   {line}" for line in attrs[f"changes_{letter}"].splitlines()]
        lines += [f"   concludes: {line}" for line in numbers[f"said_{letter}"]]
        if only := numbers[f"only_{letter}"]:
            shown = ", ".join(only[:MOST_LINES]) + ", ..." * (len(only) > MOST_LINES)
            lines.append(f"   {len(only)} rows are in this result alone: {shown}")
    telemetry = "both are of the same" if numbers["same_telemetry"] else "not of the same"
    lines.append(
        f"{numbers['beyond']} of {known.sum()} rows with a known error changed by more than it; of {(~known).sum()} without one "
        f"{numbers['changed_without_error']} changed"
        + ("" if attrs["command"] == "outcomes" else f"; {telemetry} telemetry")
    )
    for row in changed[:MOST_LINES].itertuples():
        size, units = (row.size, UNITS[row.of]) if row.of in UNITS else (100 * row.size, "%")
        unit, words = row.unit and f" {row.unit}", row.words and f"; {row.words}"
        now = f"{row.row}: {row.a}, now {row.b}{unit}{words}"
        lines.append(f"  {f'{size:7.2g} {units}':22}{now}")
    rest = len(changed) - MOST_LINES
    notes = [f"  and {rest} more: give --out for the whole table"] if rest > 0 else []
    return Summary(numbers, lines, notes)


def _table(data: Any) -> Any:
    """The rows as a pandas table."""
    import pandas as pd

    return pd.DataFrame({name: data[name].values for name in ("row", *COLUMNS)})


def comparison_drawings(data: Any, _: Context) -> Iterator[Drawing]:
    """The rows that changed most."""
    unknown = int(np.count_nonzero(np.isnan(data["error"].values) & data["beyond"].values))
    yield Drawing(
        "comparison",
        lambda: comparison_figure(data),
        "The rows that changed most between the two results, each in units of its error.",
        f"Changes from A ({data.attrs['folder_a']}) to B ({data.attrs['folder_b']}), each over its error: half of the wider "
        "interval, one sigma, or the tolerance. To the right of the dashed line the change exceeds the error. The table also lists "
        f"{unknown} changed rows without a known error.",
    )


@styled
def comparison_figure(data: Any) -> Any:
    """The rows with a known error that changed most, in errors."""
    table = _table(data)
    table = table[table["error"].notna() & (table["change"] != 0)][:MOST_DRAWN]
    size, place = np.maximum(table["size"].to_numpy(), LEAST), np.arange(len(table))[::-1]
    figure, axes = axes_grid(10, 1.5 + 0.27 * max(len(table), 4), title="Changes from A to B")
    axes.hlines(place, LEAST, size, color="0.8", lw=1)
    axes.axvline(1.0, color="0.3", lw=1, ls="--")
    for k, (marker, label) in enumerate((("<", "smaller in B"), (">", "larger in B"))):
        use = (table["change"].to_numpy() > 0) == bool(k)
        axes.plot(size[use], place[use], marker, ms=7, color=COLOURS[k], label=label, zorder=3)
    right = max(10.0, 1.6 * float(size.max(initial=1.0)))
    axes.set(xscale="log", xlim=(LEAST * 0.8, right), ylim=(-0.8, max(len(table), 1) - 0.2))
    names = table["what" if data.attrs["command"] == "reproduce" else "row"]
    short = [name if len(name) <= LONGEST else f"{name[: LONGEST - 3]}..." for name in names]
    axes.set_yticks(place, [named(name) for name in short])
    axes.set_xlabel("change from A to B over its error (dashed: as large as the error)")
    axes.legend(loc="lower right", frameon=True)
    if not len(table):
        text = "no row with a known error changed"
        axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", color="0.3")
    return figure


def comparison_tables(data: Any) -> Iterator[Table]:
    """Every row."""
    shown = {name: name for name in ("row", "a", "b", "unit", "size", "words")}
    yield Table("comparison", _table(data), "Changes, the largest first", shown)


_comparison = (comparison_summary, comparison_drawings, comparison_tables)
KINDS.update(comparison=Kind("compare", "comparison", *_comparison))
