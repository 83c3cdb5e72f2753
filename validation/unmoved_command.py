"""``python -m validation unmoved COMMIT``: does the present state give the results of a commit, bit for bit?"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from sunspin.compute.campaign import kept, rows_folder

ROOT = Path(__file__).parents[1]
PARTS = ("kernels", "golden", "face", "estimates", "study")


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("commit", help="the state to compare with, as git names it")
    parser.add_argument(
        "--now", metavar="COMMIT", help="another state in the place of the present one"
    )
    parser.add_argument(
        "--part", choices=PARTS, action="append", help="repeatable; all unless given"
    )
    parser.add_argument(
        "--passes", type=int, default=20, help="simulated passes, each with rates and a posterior"
    )
    parser.add_argument(
        "--coarser", type=int, default=3, help="every n-th grid point of the Philae study's scan"
    )
    parser.add_argument(
        "--keep",
        type=Path,
        help="folder that keeps what a state gave: the same command goes on where it stopped",
    )


def run(options: Any) -> int:
    """Print what differs; one if anything does."""
    sizes = {"estimates": range(options.passes), "study": [options.coarser]}
    wanted = [(part, n) for part in options.part or PARTS for n in sizes.get(part, [0])]
    with tempfile.TemporaryDirectory(prefix="unmoved-") as home:
        folder = options.keep or Path(home) / "kept"
        before, now = (_results(commit, wanted, folder) for commit in (options.commit, options.now))
    different = [name for name in sorted(before | now) if before.get(name) != now.get(name)]
    for name in different:
        print(
            f"{name}\n  {options.commit}: {_short(before.get(name))}\n  {options.now or 'now'}: {_short(now.get(name))}"
        )
    print(f"{len(before | now)} results compared with {options.commit}: {len(different)} differ")
    return 1 if different else 0


def _results(commit: str | None, wanted: list[tuple[str, int]], folder: Path) -> dict[str, Any]:
    """What a commit, or the present state, gives: name -> value or digest."""
    found: dict[str, Any] = {}
    with _sources(commit) as place:
        rows = rows_folder(folder / _fingerprint(place / "src"))
        for part, n in wanted:
            found |= kept(rows / f"{part}-{n}.json", partial(_probed, place, part, n))
    return found


@contextmanager
def _sources(commit: str | None) -> Any:
    """The folder with the sources of a commit, unpacked, or of the present state."""
    if commit is None:
        yield ROOT
        return
    with tempfile.TemporaryDirectory(prefix="unmoved-") as home:
        archive = subprocess.run(
            ["git", "archive", commit], cwd=ROOT, capture_output=True, check=True
        ).stdout
        subprocess.run(["tar", "-x", "-C", home], input=archive, check=True)
        yield Path(home)


def _fingerprint(folder: Path) -> str:
    found = hashlib.sha256()
    for file in sorted(
        path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts
    ):
        found.update(str(file.relative_to(folder)).encode() + file.read_bytes())
    return found.hexdigest()[:12]


def _probed(place: Path, part: str, n: int) -> dict[str, Any]:
    """A part of the probe with the package at a place, with this environment's other packages."""
    environment = os.environ | {"PYTHONPATH": str(place / "src"), "COLUMNS": "120"}
    command = [sys.executable, str(Path(__file__).with_name("results_probe.py")), part, str(n)]
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"the part {part} failed; what it said stands above")
    return json.loads(done.stdout.splitlines()[-1])


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 300 else f"{text[:150]} ... {text[-150:]}"
