"""Time to start: the command line, the import, the first scan with and without compiled kernels."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from bench.timing import Table

ROOT = Path(__file__).parents[1]

CHEAP = {
    "python -c pass": ("-c", "pass"),
    "import sunspin": ("-c", "import sunspin"),
    "sunspin --help": ("-m", "sunspin.cli", "--help"),
}
LIBRARIES = ("-c", "import numpy, pandas, xarray, scipy.special, numba, matplotlib.figure")
EXAMPLE = ("-m", "sunspin.cli", "init")
RATES = ("-m", "sunspin.cli", "rates", "vehicle.toml", "telemetry.csv", "--out", "rates")
SCAN = ("-c", "from bench.problem import philae; philae().scan(philae().axes(2, 2, 2))")


def run(quick: bool) -> Table:
    """Measure wall times of new processes."""
    repeats = 3 if quick else 5
    table = Table("start: wall time of fresh processes", ("what", "s", "processes"))
    for name, arguments in CHEAP.items():
        seconds = statistics.median(call(arguments) for _ in range(repeats))
        table.rows.append((name, seconds, repeats))
    with tempfile.TemporaryDirectory(prefix="sunspin-bench-") as folder:
        table.rows.append(("a first scan of 8 rows, nothing compiled", call(SCAN, folder), 1))
        kernels = compiled(folder)
        seconds = statistics.median(call(SCAN, folder) for _ in range(repeats))
        table.rows.append(("the same, kernels compiled", seconds, repeats))
        unchanged = kernels and compiled(folder) == kernels
    with tempfile.TemporaryDirectory(prefix="sunspin-bench-") as folder:
        call((*EXAMPLE, folder))
        # in turn, so that a machine that slows down slows both; the first command may compile
        call(RATES, cwd=folder)
        pairs = [(call(LIBRARIES), call(RATES, cwd=folder)) for _ in range(repeats)]
    libraries, rates = (statistics.median(each) for each in zip(*pairs, strict=True))
    table.rows.append(("import of the libraries that `rates` uses", libraries, repeats))
    table.rows.append(("sunspin rates on the example files, with figures", rates, repeats))
    ratio = statistics.median(command / imports for imports, command in pairs)
    table.notes.append(f"`rates` takes {ratio:.1f} times as long as the import of its libraries.")
    table.notes.append(f"Compiled anew although kernels are there: {'no' if unchanged else 'YES'}.")
    return table


def call(arguments: tuple[str, ...], cache: str | None = None, cwd: str | None = None) -> float:
    """Return the wall time (s) of ``python ARGUMENTS`` in a folder; `cache` is a folder for the kernels, if given."""
    # this repository first, so that `bench` can be imported from any folder
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = os.environ | {"PYTHONPATH": path} | ({"NUMBA_CACHE_DIR": cache} if cache else {})
    start = time.perf_counter()
    subprocess.run(
        [sys.executable, *arguments], env=environment, cwd=cwd, capture_output=True, check=True
    )
    return time.perf_counter() - start


def compiled(folder: str) -> dict[str, tuple[int, int]]:
    """Return the size and the modification time of each file of compiled code."""
    files = (path for path in Path(folder).rglob("*") if path.is_file())
    return {str(path): (path.stat().st_size, path.stat().st_mtime_ns) for path in files}
