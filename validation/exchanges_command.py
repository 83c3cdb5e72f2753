"""``python -m validation exchanges``: satellites whose file has two panel columns exchanged, and their right files."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Any

from sunspin.compute.campaign import kept, rows_folder
from validation.exchanges import MOST_ACCUSED, MOST_WRONG, SATELLITES, cases, table
from validation.exchanges import run as run_case


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "out", type=Path, help="where rows are kept: the same command goes on where it stopped"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--quick", action="store_true", help="a dozen satellites, and one exchange of each"
    )
    parser.add_argument("--first", type=int, default=SATELLITES, help="only so many satellites")


def run(options: Any) -> int:
    """Print the table; one if more than the targets are wrong or accused."""
    folder = rows_folder(options.out / f"exchanges-{options.seed}")
    rows = []
    for case in cases(options.seed, options.quick):
        _, satellite, which = case
        if satellite < options.first:
            rows.append(kept(folder / f"{satellite:03d}-{which + 1}.json", partial(run_case, case)))
            print(satellite, which, rows[-1]["outcome"], flush=True)
    print(table(rows))
    wrong = sum(
        row["outcome"] in ("a false change named", "decided wrongly") and row["exchange"] >= 0
        for row in rows
    )
    accused = sum(
        row["outcome"] in ("accused", "decided wrongly") and row["exchange"] < 0 for row in rows
    )
    return int(wrong > MOST_WRONG or accused > MOST_ACCUSED)
