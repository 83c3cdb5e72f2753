"""``python -m validation spinners``: simulated spinners with a magnetometer, with and without elements."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Any

from sunspin.compute.campaign import kept, rows_folder
from validation.spinners import Case, cases, table
from validation.spinners import run as judged

CHECKS, RATES = ("check right", "check wrong"), ("rates none", "rates right")


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "out",
        type=Path,
        help="where files and rows are kept: the same command goes on where it stopped",
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--orbits", type=int, default=40, help="whole orbits through `check`")
    parser.add_argument(
        "--files", type=int, default=24, help="whole orbits and shorter files through `rates`"
    )


def run(options: argparse.Namespace) -> int:
    """Print the table; one if there is a defect, or wrong elements fit a whole orbit."""
    folder = rows_folder(options.out / f"spinners-{options.seed}")
    tasks = [
        (case, what) for case in cases(options.seed, options.orbits, whole=True) for what in CHECKS
    ]
    tasks += [(case, what) for case in cases(options.seed, options.files) for what in RATES]
    rows = [judge(folder, case, what) for case, what in tasks]
    print(table(rows))
    return int(
        any(
            row["defect"] or (row["what"] == "check wrong" and row["orbit"]["verdict"] == "fits")
            for row in rows
        )
    )


def judge(folder: Path, case: Case, what: str) -> dict[str, Any]:
    """The row of one run, kept."""
    name = f"{'whole' if case.whole_orbit else 'short'}-{case.number:03d}"
    row = kept(
        folder / f"{what.replace(' ', '-')}-{name}.json", partial(judged, case, folder / name, what)
    )
    decided = "".join(
        " decided" if one["decided"] else " undecided" for one in row.get("passes", ())
    )
    said = row.get("error") or row.get("orbit", {}).get("verdict", "") + decided
    print(f"{what} of {name}: {said} ({row['processor_s']:.0f} s)", flush=True)
    return row
