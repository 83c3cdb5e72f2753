"""Comparisons of two results."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sunspin.output.kind import Context, Drawing, Summary, Table, synthetic_note

MOST_LINES = 20
"""Rows that are printed; the table has all."""

OF = {
    "half of the wider interval": "half widths",
    "tolerance of the row": "tolerances",
    "one sigma of both together": "sigmas",
}
"""What a change is held against -> how it is counted."""

COLUMNS = ("what", "a", "b", "unit", "change", "error", "of", "size", "beyond", "words")


def comparison_summary(found: Any) -> Summary:
    """How many rows moved, beyond their errors, and which."""
    beyond, known = found["beyond"].values, np.isfinite(found["error"].values)
    numbers: dict[str, Any] = {
        "command": str(found.attrs["command"]),
        "a": str(found.attrs["folder_a"]),
        "b": str(found.attrs["folder_b"]),
        "rows": int(beyond.size),
        "beyond": int(np.count_nonzero(beyond & known)),
        "changed_without_error": int(np.count_nonzero(beyond & ~known)),
        "same_telemetry": bool(found.attrs["same_telemetry"]),
        "synthetic_telemetry": bool(found.attrs.get("synthetic", 0)),
        **{
            f"{what}_{letter}": str(found.attrs.get(f"{what}_{letter}", ""))
            for what in ("only", "said")
            for letter in "ab"
        },
        "moved": [
            _plain(found, i) for i in range(beyond.size) if beyond[i] or found["words"].values[i]
        ],
    }
    lines = []
    for letter in "ab":
        lines.append(f"{letter.upper()}: {found.attrs[f'folder_{letter}']}")
        lines += [
            f"   {line}" for line in str(found.attrs.get(f"changes_{letter}", "")).splitlines()
        ]
        lines += [
            f"   concludes: {line}"
            for line in str(found.attrs.get(f"said_{letter}", "")).splitlines()
        ]
        if only := str(found.attrs.get(f"only_{letter}", "")):
            lines.append(f"   alone has {only.count(', ') + 1} rows: {only}")
    lines.append(
        f"{numbers['beyond']} of {int(known.sum())} rows with a known error moved beyond it; of {int((~known).sum())} without one "
        f"{numbers['changed_without_error']} changed"
        + (
            "; both are of the same telemetry"
            if numbers["same_telemetry"]
            else ""
            if found.attrs["command"] == "outcomes"
            else "; the telemetry is not the same"
        )
    )
    chosen = [i for i in range(beyond.size) if beyond[i] or found["words"].values[i]]
    lines += [_line(found, i) for i in chosen[:MOST_LINES]]
    rest = len(chosen) - MOST_LINES
    return Summary(
        numbers, lines, [f"  and {rest} more: give --out for the whole table"] if rest > 0 else []
    )


def _line(found: Any, i: int) -> str:
    row = {name: found[name].values[i] for name in COLUMNS}
    unit = f" {row['unit']}" if row["unit"] else ""
    size = (
        f"{row['size']:7.2g} {OF[str(row['of'])]}"
        if np.isfinite(row["error"])
        else f"{100 * row['size']:7.2g} %"
    )
    words = f"; {row['words']}" if row["words"] else ""
    return f"  {size:22}{found['row'].values[i]}: {row['a']}, now {row['b']}{unit}{words}"


def _plain(found: Any, i: int) -> dict[str, Any]:
    return {"row": str(found["row"].values[i])} | {
        name: found[name].values[i].item() for name in COLUMNS
    }


def comparison_drawings(found: Any, _: Context) -> Iterator[Drawing]:
    from sunspin.output.figures.comparison import comparison_figure

    others = int(np.count_nonzero(~np.isfinite(found["error"].values) & found["beyond"].values))
    yield Drawing(
        "comparison",
        lambda: comparison_figure(found),
        "The rows that moved most between the two results, each in its own errors.",
        f"What moved from A ({found.attrs['folder_a']}) to B ({found.attrs['folder_b']}), in errors of each row: half of the wider "
        f"interval, or one sigma. Beyond the dashed line a row moved by more than its error. {others} more changed of which no "
        "error is known; the table has them." + synthetic_note(found),
    )


def comparison_tables(found: Any) -> Iterator[Table]:
    import pandas as pd

    frame = pd.DataFrame(
        {"row": found["row"].values} | {name: found[name].values for name in COLUMNS}
    )
    shown = {name: name for name in ("row", "a", "b", "unit", "size", "words")}
    yield Table("comparison", frame, "What moved, the largest first", shown)
