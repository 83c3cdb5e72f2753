"""Runs killed with SIGKILL at random moments, resumed until they get through, and compared with undisturbed ones to 1e-9."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sunspin.compute.store import LOCK

ROOT = Path(__file__).parents[1]
TELEMETRY = ROOT / "src" / "sunspin" / "cases" / "philae" / "telemetry.csv"
UNALIKE = ("seconds", "processor_s", "command", "folder")
"""Keys of summaries that say how long a run took and where it stood."""


@dataclass(frozen=True)
class Target:
    """A command, its share of the kills, its arguments in full and small (for a quick look)."""

    name: str
    share: float
    full: tuple[str, ...]
    small: tuple[str, ...]
    stored: bool = True

    def command(self, folder: Path, small: bool) -> list[str]:
        given = [*(self.small if small else self.full), "--out", str(folder / "out")]
        store = ["--store", str(folder / "store")] if self.stored else []
        return [sys.executable, "-m", "sunspin.cli", self.name, *given, *store]


SCAN = ("philae", str(TELEMETRY), "--from=90", "--to=2800", "--workers=2", "--lines=0")
KNOWN = ("--prior=inertia=0", "--prior=friction=0", "--prior=wheel_speed=0")
WINDOW = ("philae", *KNOWN, "--draws=1000", "--workers=2", "--from=100", "--to=1500")
TARGETS = (
    Target(
        "scan",
        0.3,
        (*SCAN, "--omega-x=-0.5:1:0.02", "--omega-y=-0.5:1:0.02", "--omega-z=-0.3:0.3:0.03"),
        (*SCAN, "--omega-x=-0.5:1:0.05", "--omega-y=-0.5:1:0.05", "--omega-z=-0.3:0.3:0.04"),
    ),
    Target(
        "posterior",
        0.2,
        (*WINDOW, "--prior=max_rate_rad_s=0.1"),
        (*WINDOW, "--prior=max_rate_rad_s=0.05"),
    ),
    Target(
        "outcomes",
        0.15,
        ("philae", "--runs=16000", "--workers=2"),
        ("philae", "--runs=5000", "--workers=2"),
    ),
    Target("reproduce", 0.1, ("--coarser=8",), ("--coarser=25",), stored=False),
)


@dataclass
class Told:
    """What became of one target."""

    name: str
    seconds: float = 0.0
    kills: int = 0
    runs_through: int = 0
    after_files: int = 0
    wrong: list[str] = field(default_factory=list)


def environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(ROOT / "src")}


def start(command: list[str]) -> subprocess.Popen:
    return subprocess.Popen(
        command,
        env=environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


def halves(folder: Path) -> list[str]:
    """Files under their final names that are not whole; a store's lock is empty."""
    files = [
        path
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.name.startswith(".") and path.name != LOCK
    ]
    return [path.name for path in files if not is_whole(path)]


def is_whole(path: Path) -> bool:
    """Whether a results file is complete, as far as its own form tells."""
    ends: dict[str, Callable[[bytes], bool]] = {
        ".html": lambda data: data.rstrip().endswith(b"</html>"),
        ".svg": lambda data: data.rstrip().endswith(b"</svg>"),
        ".png": lambda data: data.endswith(b"IEND\xaeB`\x82"),
        ".json": lambda data: json.loads(data) is not None,
    }
    try:
        if path.suffix == ".nc":
            content(path)
            return True
        return (
            ends[path.suffix](path.read_bytes()) if path.suffix in ends else path.stat().st_size > 0
        )
    except (OSError, ValueError, KeyError):
        return False


def content(path: Path) -> dict[str, Any]:
    """What a results file holds, to be compared; durations and the places of the run left out."""
    import xarray as xr

    if path.suffix != ".nc":
        read = json.loads(path.read_text("utf-8"))
        read = read if isinstance(read, dict) else {"": read}
        return {key: value for key, value in read.items() if key not in UNALIKE}
    held: dict[str, Any] = {}
    for group, data in xr.open_groups(path, engine="h5netcdf", decode_timedelta=False).items():
        held |= {f"{group}:{name}": variable.values for name, variable in data.variables.items()}
        held |= {f"{group}:{key}": str(v) for key, v in data.attrs.items() if key not in UNALIKE}
        data.close()
    return held


def alike(value: Any, wanted: Any) -> bool:
    """Whether two contents are the same, numbers to 1e-9."""
    if isinstance(value, dict) and isinstance(wanted, dict):
        return value.keys() == wanted.keys() and all(alike(value[k], wanted[k]) for k in value)
    if isinstance(value, list) and isinstance(wanted, list):
        return len(value) == len(wanted) and all(map(alike, value, wanted))
    a, b = np.asarray(value), np.asarray(wanted)
    if a.dtype.kind == b.dtype.kind == "f":
        return a.shape == b.shape and np.allclose(a, b, rtol=1e-9, atol=1e-15, equal_nan=True)
    return np.array_equal(a, b)


def results(folder: Path) -> dict[str, Any]:
    files = [path for path in sorted(folder.rglob("*")) if path.suffix in (".nc", ".json")]
    return {str(path.relative_to(folder)): content(path) for path in files}


def campaign(
    target: Target,
    kills: int,
    folder: Path,
    seed: int,
    small: bool = False,
    say: Callable[[str], None] = print,
) -> Told:
    """Kill one target so many times; what was wrong."""
    told, draw = Told(target.name), random.Random(f"{seed} {target.name}")
    calm = folder / "calm"
    for _ in range(2):  # the first compiles
        told.seconds = _undisturbed(target.command(calm, small), calm)
    wanted = results(calm / "out")
    say(f"{target.name}: undisturbed in {told.seconds:.1f} s")
    number = 0
    while told.kills < kills:
        place = folder / f"round{number}"
        number += 1
        while not _once(target, place, draw, told, small):
            if told.kills > 3 * kills + 20:
                told.wrong.append("no run gets through")
                return told
        told.runs_through += 1
        found = results(place / "out")
        names = [name for name in {*found, *wanted} if not alike(found.get(name), wanted.get(name))]
        if names:
            told.wrong.append(f"other results after kills: {', '.join(sorted(names))}")
        if left := [path.name for path in place.rglob("*.part")]:
            told.wrong.append(f"left behind: {', '.join(left[:3])}")
    return told


def _undisturbed(command: list[str], folder: Path) -> float:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    begun = time.monotonic()
    process = start(command)
    _, complaint = process.communicate()
    if process.returncode:
        raise RuntimeError(f"{' '.join(command)}: {complaint.decode()}")
    return time.monotonic() - begun


def _once(target: Target, place: Path, draw: random.Random, told: Told, small: bool) -> bool:
    """Start and kill at a random moment; whether it got through before."""
    place.mkdir(parents=True, exist_ok=True)
    process = start(target.command(place, small))
    try:
        process.communicate(timeout=draw.uniform(0.2, 1.4 * told.seconds))
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        told.kills += 1
        told.after_files += any((place / "out").glob("[!.]*")) if (place / "out").exists() else 0
        if half := halves(place / "out"):
            told.wrong.append(f"half written: {', '.join(half)}")
        return False
    if process.returncode:
        told.wrong.append(f"a resumed run ended with {process.returncode}")
        return True
    return True
