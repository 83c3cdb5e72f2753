"""How long it takes to start: the command line, the import, the first scan with and without compiled kernels."""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path

from bench.processes import call, child
from bench.table import Table
from bench.timing import say

CHEAP = {
    "python -c pass": ("-c", "pass"),
    "import sunspin": ("-c", "import sunspin"),
    "sunspin --help": ("-m", "sunspin.cli", "--help"),
}
FIRST_GRID = ("2", "2", "2")


def run(quick: bool) -> Table:
    """Wall times of fresh processes."""
    repeats = 3 if quick else 5
    table = Table(
        "start", "wall time of fresh processes", ("what", "s", "of which the scan", "processes")
    )
    taken: dict[str, list[float]] = {name: [] for name in CHEAP}
    say(f"start: {', '.join(CHEAP)}")
    for _ in range(repeats):
        for name, arguments in CHEAP.items():
            taken[name].append(call(*arguments)[0])
    for name, values in taken.items():
        table.add(name, statistics.median(values), None, repeats)
    with tempfile.TemporaryDirectory(prefix="sunspin-bench-") as folder:
        say("start: first scan with an empty cache")
        seconds, told = child(*FIRST_GRID, cache=folder)
        table.add("first scan, empty cache", seconds, told["scan_s"], 1)
        before = _files(folder)
        say("start: first scan with a warm cache")
        again = [child(*FIRST_GRID, cache=folder) for _ in range(repeats)]
        seconds = statistics.median(wall for wall, _ in again)
        table.add(
            "first scan, warm cache",
            seconds,
            statistics.median(told["scan_s"] for _, told in again),
            repeats,
        )
        unchanged = before and _files(folder) == before
    table.notes.append(
        f"The scan has 8 rows. Compiled anew with the warm cache: {'no' if unchanged else 'YES'}."
    )
    return table


def _files(folder: str) -> dict[str, tuple[int, int]]:
    """Size and time of change of each file of compiled code."""
    found = (path for path in Path(folder).rglob("*") if path.is_file())
    return {str(path): (path.stat().st_size, path.stat().st_mtime_ns) for path in found}
