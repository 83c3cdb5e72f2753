"""How time and memory of a scan grow with its rows."""

from __future__ import annotations

import statistics

from bench.processes import child
from bench.table import Table
from bench.timing import say

GRIDS = ((22, 22, 9), (47, 47, 19), (101, 101, 41))
"""About 1, 10 and 100 times 4,200 rows over the same ranges; the last is the paper's grid and is run once."""

QUICK_GRIDS = ((7, 7, 4), (15, 15, 9), (32, 32, 20))
COLUMNS = (
    "rows",
    "s",
    "us/row",
    "against the first",
    "peak MB",
    "before MB",
    "result MB",
    "peak - result MB",
)


def run(quick: bool) -> Table:
    """Time per row and peak resident memory, each grid in a process of its own, on all cores."""
    table = Table("growth", "time and memory of a scan against its rows", COLUMNS)
    grids = QUICK_GRIDS if quick else GRIDS
    runs: dict[tuple[int, ...], list[dict]] = {counts: [] for counts in grids}
    for counts in grids if quick else (*grids, *grids[:-1], *grids[:-1]):
        say(f"growth: a grid of {' x '.join(map(str, counts))}")
        runs[counts].append(child("growth", *map(str, counts))[1])
    medians = [
        {key: statistics.median(run[key] for run in told) for key in told[0]}
        for told in runs.values()
    ]
    first = medians[0]["scan_s"] / medians[0]["rows"]
    for told in medians:
        per_row = told["scan_s"] / told["rows"]
        memory = (
            told["peak_MB"],
            told["before_MB"],
            told["result_MB"],
            told["peak_MB"] - told["result_MB"],
        )
        table.add(told["rows"], told["scan_s"], 1e6 * per_row, per_row / first, *memory)
    table.notes.append(
        "before: the peak once a scan of 8 rows has loaded libraries and kernel; result: distances and outcomes."
    )
    return table
