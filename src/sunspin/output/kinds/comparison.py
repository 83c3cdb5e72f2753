"""Results of `sunspin compare`: the changes between two results."""

from __future__ import annotations

from collections.abc import Iterator
from textwrap import shorten
from typing import Any

import numpy as np

from sunspin.output.compare import INTERVAL, SIGMA, TOLERANCE
from sunspin.output.figures import axes_grid, escape_name, styled
from sunspin.output.kind import KINDS, Context, Drawing, Kind, Summary, Table

MOST_LINES = 20
"""Number of rows that are printed; the table has all."""

UNITS = {INTERVAL: "half widths", TOLERANCE: "tolerances", SIGMA: "sigmas"}
"""Kind of error with which a change is compared -> unit of the size of the change."""


def comparison_summary(data: Any) -> Summary:
    """Return the summary of a comparison of results A and B.

    It has changed inputs, conclusions and rows that only one of them has, the number of rows that changed by more than their
    error, and the largest changes.
    """
    attrs, table = data.attrs, data.to_dataframe().reset_index()
    has_error = table["error"].notna()
    changed = table[table["beyond"] | (table["words"] != "")]
    numbers: dict[str, Any] = {
        "command": attrs["command"],
        "a": attrs["folder_a"],
        "b": attrs["folder_b"],
        "rows": len(table),
        "beyond": int((table["beyond"] & has_error).sum()),
        "changed_without_error": int((table["beyond"] & ~has_error).sum()),
        "same_telemetry": bool(attrs["same_telemetry"]),
        "synthetic_telemetry": bool(attrs["synthetic"]),
        **{name: attrs[name].splitlines() for name in ("only_a", "only_b", "said_a", "said_b")},
        "moved": changed.to_dict("records"),
    }
    lines = []
    for letter in "ab":
        lines.append(f"{letter.upper()}: {numbers[letter]}")
        lines += [f"   {line}" for line in attrs[f"changes_{letter}"].splitlines()]
        lines += [f"   concludes: {line}" for line in numbers[f"said_{letter}"]]
        if only := numbers[f"only_{letter}"]:
            names = ", ".join(only[:MOST_LINES]) + (", ..." if len(only) > MOST_LINES else "")
            lines.append(f"   {len(only)} rows are in this result alone: {names}")
    lines.append(
        f"{numbers['beyond']} of {has_error.sum()} rows with a known error changed by more than it; "
        f"of {(~has_error).sum()} without one {numbers['changed_without_error']} changed"
    )
    if attrs["command"] != "outcomes":
        same = "both are" if numbers["same_telemetry"] else "not"
        lines[-1] += f"; {same} of the same telemetry"
    for row in changed[:MOST_LINES].itertuples():
        # without a known error, the size of a change is relative to the value
        size, units = (row.size, UNITS[row.of]) if row.of in UNITS else (100 * row.size, "%")
        unit = f" {row.unit}" if row.unit else ""
        other_changes = f"; {row.words}" if row.words else ""
        change = f"{row.row}: {row.a}, now {row.b}{unit}{other_changes}"
        lines.append(f"  {f'{size:7.2g} {units}':22}{change}")
    rest = len(changed) - MOST_LINES
    notes = [f"  and {rest} more: --out writes the whole table"] if rest > 0 else []
    return Summary(numbers, lines, notes)


def comparison_drawings(data: Any, _: Context) -> Iterator[Drawing]:
    """Yield the figure of the rows that changed most."""
    unknown = int((data["error"].isnull() & data["beyond"]).sum())
    yield Drawing(
        "comparison",
        lambda: comparison_figure(data),
        "The rows that changed most between the two results, each in units of its error.",
        f"Changes from A ({data.attrs['folder_a']}) to B ({data.attrs['folder_b']}), each over its error: half of the wider "
        "interval, one sigma, or the tolerance. Beyond the dashed lines the change exceeds the error; bars end at 100 errors. "
        f"The table also lists {unknown} changed rows without a known error.",
    )


@styled
def comparison_figure(data: Any) -> Any:
    """Draw the 30 rows with a known error that changed most, in units of their errors."""
    table = data.to_dataframe().reset_index()
    table = table[table["error"].notna() & (table["change"] != 0)][:30]
    size = np.sign(table["change"]) * table["size"]
    height = 1.5 + 0.27 * max(len(table), 4)
    figure, axes = axes_grid(10, height, title="Changes from A to B over their errors")
    axes.barh(range(len(table)), size, height=0.5)
    for one_error in (-1, 1):
        axes.axvline(one_error, color="0.3", lw=1, ls="--")
    axes.set(xscale="symlog", xlim=(-100, 100))
    # the rows of a study are named by ids, which say less than what they are
    names = table["what" if data.attrs["command"] == "reproduce" else "row"]
    labels = [escape_name(shorten(name, 72, placeholder="...")) for name in names]
    axes.set_yticks(range(len(table)), labels)
    axes.invert_yaxis()
    axes.set_xlabel("change over error (dashed: as large as the error)")
    return figure


def comparison_tables(data: Any) -> Iterator[Table]:
    """Yield the table of all rows."""
    headings = {name: name for name in ("row", "a", "b", "unit", "size", "words")}
    frame = data.to_dataframe().reset_index()
    yield Table("comparison", frame, "Changes, the largest first", headings)


_comparison = (comparison_summary, comparison_drawings, comparison_tables)
KINDS.update(comparison=Kind("compare", "comparison", *_comparison))
