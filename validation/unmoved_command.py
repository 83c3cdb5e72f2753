"""``python -m validation unmoved COMMIT``: does the present state give the results of a commit, bit for bit?"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("commit", help="the state to compare with, as git names it")
    parser.add_argument("--passes", type=int, default=20, help="simulated passes, each with rates and a posterior")
    parser.add_argument("--coarser", type=int, default=3, help="every n-th grid point of the Philae study's scan")


def run(options: Any) -> int:
    """Print what differs; one if anything does."""
    with tempfile.TemporaryDirectory(prefix="unmoved-") as home:
        archive = subprocess.run(["git", "archive", options.commit], cwd=ROOT, capture_output=True, check=True).stdout
        subprocess.run(["tar", "-x", "-C", home], input=archive, check=True)
        probes = [_started(place, options) for place in (Path(home), ROOT)]
        before, now = (_answer(probe) for probe in probes)
    different = [name for name in sorted(before | now) if before.get(name) != now.get(name)]
    for name in different:
        print(f"{name}\n  {options.commit}: {_short(before.get(name))}\n  now: {_short(now.get(name))}")
    print(f"{len(before | now)} results compared with {options.commit}: {len(different)} differ")
    return 1 if different else 0


def _started(place: Path, options: Any) -> subprocess.Popen[str]:
    """The probe with the package at a place, with this environment's other packages; both states run at the same time."""
    environment = os.environ | {"PYTHONPATH": str(place / "src"), "COLUMNS": "120"}
    probe = Path(__file__).with_name("results_probe.py")
    command = [sys.executable, str(probe), str(options.passes), str(options.coarser)]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)


def _answer(probe: subprocess.Popen[str]) -> dict[str, Any]:
    printed = probe.communicate()[0]
    if probe.returncode:
        raise SystemExit("a probe failed; what it said stands above")
    return json.loads(printed.splitlines()[-1])


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 300 else f"{text[:150]} ... {text[-150:]}"
