"""Kill runs with SIGKILL at random moments, resume them until they finish, and compare them with undisturbed ones."""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sunspin.compute.store import LOCK

ROOT = Path(__file__).parents[1]
TELEMETRY = ROOT / "src" / "sunspin" / "cases" / "philae" / "telemetry.csv"
RUN_DEPENDENT = ("seconds", "processor_s", "command", "folder")
"""Keys of summaries that depend on the duration and the place of a run."""

RELATIVE_TOLERANCE = 1e-9
"""Largest relative difference between numbers of a resumed and an undisturbed run."""

STORE = "--store=STORE"
"""Folder of the rows in the arguments of `TARGETS`."""

TARGETS = {
    "scan": "scan philae TELEMETRY --from=90 --to=2800 --workers=2 --lines=0 --omega-x-deg-s=-30:60:3 --omega-y-deg-s=-30:60:3 "
    f"--omega-z-deg-s=-18:18:2.4 {STORE}",
    "outcomes": f"outcomes philae --runs=5000 --workers=2 {STORE}",
    "reproduce": "reproduce --coarser=25 --without posterior",
}
"""Name of each target -> arguments of a run of half a minute or less."""


@dataclass
class KillReport:
    """Result of one target: seconds of an undisturbed run, kills, finished runs, kills after the first results file, errors."""

    seconds: float = 0.0
    kills: int = 0
    runs_through: int = 0
    after_files: int = 0
    wrong: list[str] = field(default_factory=list)


def command(name: str, folder: Path) -> list[str]:
    """Return the command line of a target with its results and rows in a folder."""
    text = TARGETS[name].replace("TELEMETRY", str(TELEMETRY)).replace("STORE", f"{folder}/store")
    return [sys.executable, "-m", "sunspin.cli", *text.split(), "--out", f"{folder}/out"]


def environment() -> dict[str, str]:
    """Return the environment of a run, in which the package is imported from this repository."""
    return os.environ | {"PYTHONPATH": str(ROOT / "src")}


def start(arguments: list[str]) -> subprocess.Popen:
    """Start a process in its own group, without output."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    return subprocess.Popen(arguments, env=environment(), start_new_session=True, **quiet)


def is_whole(path: Path) -> bool:
    """Return whether a results file is complete, as far as its format shows."""
    ends: dict[str, Callable[[bytes], bool]] = {
        ".html": lambda data: data.rstrip().endswith(b"</html>"),
        ".svg": lambda data: data.rstrip().endswith(b"</svg>"),
        ".png": lambda data: data.endswith(b"IEND\xaeB`\x82"),
        ".json": lambda data: json.loads(data) is not None,
    }
    try:
        if path.suffix == ".nc":
            return bool(content(path))
        data = path.read_bytes()
        return ends[path.suffix](data) if path.suffix in ends else bool(data)
    except (OSError, ValueError, KeyError):
        return False


def content(path: Path) -> dict[str, Any]:
    """Return the content of a JSON or NetCDF file of results by name; in NetCDF "GROUP:NAME" of variables and attributes."""
    import xarray as xr

    if path.suffix == ".json":
        summary = json.loads(path.read_text("utf-8"))
        return summary if isinstance(summary, dict) else {"": summary}
    values: dict[str, Any] = {"": ""}
    for group, data in xr.open_groups(path, engine="h5netcdf", decode_timedelta=False).items():
        values |= {f"{group}:{name}": variable.values for name, variable in data.variables.items()}
        values |= {f"{group}:{name}": str(value) for name, value in data.attrs.items()}
        data.close()
    return values


def differences(folder: Path, reference: Path) -> list[str]:
    """Return the names of files that differ between the results of two folders."""
    # path below each folder -> file
    files, reference_files = (
        {
            str(path.relative_to(at)): path
            for path in at.rglob("*")
            if path.suffix in (".nc", ".json")
        }
        for at in (folder, reference)
    )
    different = sorted(set(files) ^ set(reference_files))
    for name in set(files) & set(reference_files):
        ours, theirs = content(files[name]), content(reference_files[name])
        keys = [key for key in {**ours, **theirs} if key.split(":")[-1] not in RUN_DEPENDENT]
        if not all(agree_to_rounding(ours.get(key), theirs.get(key)) for key in keys):
            different.append(name)
    return different


def agree_to_rounding(ours: Any, theirs: Any) -> bool:
    """Return whether two values are equal, numbers to `RELATIVE_TOLERANCE`."""
    if isinstance(ours, dict) and isinstance(theirs, dict):
        return ours.keys() == theirs.keys() and all(
            agree_to_rounding(ours[key], theirs[key]) for key in ours if key not in RUN_DEPENDENT
        )
    if isinstance(ours, list) and isinstance(theirs, list):
        return len(ours) == len(theirs) and all(map(agree_to_rounding, ours, theirs))
    ours, theirs = np.asarray(ours), np.asarray(theirs)
    if ours.dtype.kind != "f":
        return bool(np.array_equal(ours, theirs))
    numeric = ours.shape == theirs.shape and theirs.dtype.kind in "fi"
    return numeric and np.allclose(
        ours, theirs, rtol=RELATIVE_TOLERANCE, atol=RELATIVE_TOLERANCE, equal_nan=True
    )


def campaign(
    name: str, kills: int, folder: Path, seed: int, say: Callable[[str], None] = print
) -> KillReport:
    """Kill runs of one target `kills` times, resume each until it finishes, and return the report.

    `report.wrong` has a sentence for each difference from an undisturbed run. If no run finishes, the campaign gives up.
    """
    report, draw, undisturbed = KillReport(), random.Random(f"{seed} {name}"), folder / "calm"
    for _ in range(2):  # the first compiles
        shutil.rmtree(undisturbed, ignore_errors=True)
        undisturbed.mkdir(parents=True)
        begun, process = time.monotonic(), start(command(name, undisturbed))
        _, complaint = process.communicate()
        if process.returncode:
            raise RuntimeError(f"{name}: {complaint.decode()}")
        report.seconds = time.monotonic() - begun
    say(f"{name}: undisturbed in {report.seconds:.1f} s")
    while report.kills < kills:
        place = folder / f"round{report.runs_through}"
        while not _run_or_kill(name, place, draw, report):
            if report.kills > 3 * kills + 20:
                report.wrong.append("no run gets through")
                return report
        report.runs_through += 1
        if different := differences(place / "out", undisturbed / "out"):
            report.wrong.append(f"other results after kills: {', '.join(different)}")
        if left := [path.name for path in place.rglob("*.part")]:
            report.wrong.append(f"left behind: {', '.join(left[:3])}")
    return report


def _run_or_kill(name: str, place: Path, draw: random.Random, report: KillReport) -> bool:
    """Start or resume a run in the folder `place` and kill it at a random moment; return whether it finished before.

    A kill is counted in `report`, which also gets what is wrong: files half written, or a failed run.
    """
    place.mkdir(parents=True, exist_ok=True)
    process = start(command(name, place))
    try:
        process.communicate(timeout=draw.uniform(0.2, 1.4 * report.seconds))
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        report.kills += 1
        files = [path for path in (place / "out").rglob("[!.]*") if path.is_file()]
        report.after_files += bool(files)
        half_written = [path.name for path in files if path.name != LOCK and not is_whole(path)]
        if half_written:
            report.wrong.append(f"half written: {', '.join(half_written)}")
        return False
    if process.returncode:
        report.wrong.append(f"a resumed run ended with {process.returncode}")
    return True


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this campaign."""
    parser.add_argument("--n", type=int, default=12, help="kills of each target")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=list(TARGETS))


def main(given: argparse.Namespace) -> int:
    """Print the report of each target; return 1 if anything was wrong."""
    wrong = 0
    for name in TARGETS if given.only is None else (given.only,):
        with tempfile.TemporaryDirectory(prefix="validation-") as folder:
            report = campaign(name, given.n, Path(folder), given.seed)
        ended = f"{report.kills} kills, {report.after_files} of them with results in place; {report.runs_through} runs got through"
        print(f"{name}: {ended}; {'; '.join(report.wrong) or 'the undisturbed result'}", flush=True)
        wrong += bool(report.wrong)
    return int(bool(wrong))
