"""Processor time of the commands compared with that of an earlier commit, each in its own environment, in one run."""

from __future__ import annotations

import os
import shutil
import statistics
import subprocess
import sys
import tarfile
import tempfile
from io import BytesIO
from pathlib import Path

from validation.scoreboard import ROOT

COMMANDS = {
    "rates": "rates cube/vehicle.toml cube/telemetry.csv --workers 1 --quiet --out OUT",
    "scan": "scan philae philae --from 25140 --to 27900 --omega-x-deg-s=-30:30:0.6 --omega-y-deg-s=-30:30:3 "
    "--omega-z-deg-s=-12:12:3 --workers 1 --quiet --out OUT",
    "posterior": "posterior philae --prior max_rate_rad_s=0.33 --workers 1 --quiet --out OUT",
    "reproduce": "reproduce --workers 1 --without posterior --quiet --out OUT",
}
"""Name of each command -> its arguments; OUT is a new folder each time."""

QUICK = ("rates", "scan")
FIRST_RUN = "first run after installation"

MOST_RATIO = 1.1
"""Largest ratio of the processor time of a command to that of the earlier commit."""


def install_commit(commit: str, folder: Path) -> Path:
    """Install a commit in its own environment below `folder`, unless that is done, and return its interpreter."""
    tree = folder / commit
    # the Makefile writes .venv/.ready last
    if not (tree / ".venv" / ".ready").is_file():
        shutil.rmtree(tree, ignore_errors=True)
        archive = subprocess.run(
            ["git", "archive", commit], cwd=ROOT, capture_output=True, check=True
        ).stdout
        with tarfile.open(fileobj=BytesIO(archive)) as files:
            files.extractall(tree, filter="data")
        subprocess.run(
            ["make", "--silent", f"PYTHON={sys.executable}", ".venv/.ready"], cwd=tree, check=True
        )
    return tree / ".venv" / "bin" / "python"


def measure_ratios(before: Path, level: str, repeats: int = 3) -> dict[str, float]:
    """Return the ratio of the processor time of each command to that of the earlier commit, and the sizes of both packages.

    `before` is the interpreter of the earlier commit; the other is that of this process. Each ratio is the median over rounds in
    which the two follow each other. One more is that of the first run with an empty cache of kernels.
    """
    here = Path(sys.executable)
    names = QUICK if level == "quick" else tuple(COMMANDS)
    numbers = {}
    with tempfile.TemporaryDirectory(prefix="speed-") as home:
        time_command(here, Path(home), "init cube")
        for name in names:
            rounds = [
                [time_command(python, Path(home), COMMANDS[name]) for python in (before, here)]
                for _ in range(repeats)
            ]
            numbers[f"{name}, now / before"] = statistics.median(
                now_s / before_s for before_s, now_s in rounds
            )
        before_s, now_s = (
            time_command(python, Path(home), COMMANDS["rates"], cache=f"{home}/{k}")
            for k, python in enumerate((before, here))
        )
        numbers[f"{FIRST_RUN}, now / before"] = now_s / before_s
    return numbers | {
        "installed package before, MB": size_MB(before),
        "installed package now, MB": size_MB(here),
    }


def time_command(python: Path, home: Path, arguments: str, cache: str | None = None) -> float:
    """Return the processor time (s) of one command in its own process, with all processes that it starts.

    `cache`: folder of its compiled kernels, default: that of the environment. Raises `RuntimeError` if the command fails.
    """
    out = tempfile.mkdtemp(dir=home)
    words = arguments.replace("OUT", out + "/results").split()
    # without PYTHONPATH each interpreter imports the package of its own environment
    variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    variables |= {"OPENBLAS_NUM_THREADS": "1"}
    variables |= {} if cache is None else {"NUMBA_CACHE_DIR": cache}
    begin = os.times()
    done = subprocess.run(
        [str(python), "-m", "sunspin.cli", *words],
        cwd=home,
        env=variables,
        capture_output=True,
        text=True,
    )
    end = os.times()
    if done.returncode:
        raise RuntimeError(f"sunspin {arguments}: {done.stderr.strip()[-500:]}")
    return end.children_user + end.children_system - begin.children_user - begin.children_system


def size_MB(python: Path) -> float:
    """Return the size in MB of the package that an interpreter imports."""
    code = "import pathlib, sunspin; print(pathlib.Path(sunspin.__file__).parent)"
    printed = subprocess.run([str(python), "-c", code], capture_output=True, text=True, check=True)
    files = [path for path in Path(printed.stdout.strip()).rglob("*") if path.is_file()]
    return sum(f.stat().st_size for f in files if "__pycache__" not in f.parts) / 1e6


def make_row(before: str, level: str, folder: Path) -> dict[str, object]:
    """Return the row of the scoreboard on processor times, compared with the commit `before` installed below `folder`.

    It is wrong if any ratio of processor times exceeds `MOST_RATIO`.
    """
    measured = measure_ratios(install_commit(before, folder), level)
    slower = [
        name for name, ratio in measured.items() if name.endswith("/ before") and ratio > MOST_RATIO
    ]
    outcome = "wrong" if slower else "right"
    return {"outcome": outcome, "says": "; ".join(slower), "measured": measured}
