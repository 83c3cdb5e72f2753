"""``python -m validation scoreboard``: what must not get worse, case by case, beside another state."""

from __future__ import annotations

import argparse
import json
import os
from functools import partial
from pathlib import Path

from sunspin.base import atomic_write
from validation import speed
from validation.areas import AREAS
from validation.campaign import kept
from validation.scoreboard import ROOT, board, flips, rows_of, state_of_package, table, timed


def options(parser: argparse.ArgumentParser) -> None:
    level = parser.add_mutually_exclusive_group()
    level.add_argument(
        "--quick",
        dest="level",
        action="store_const",
        const="quick",
        help="20 minutes of two cores (default)",
    )
    level.add_argument(
        "--full",
        dest="level",
        action="store_const",
        const="full",
        help="at most 150 minutes of two cores",
    )
    parser.add_argument(
        "--only", choices=list(AREAS), action="append", help="repeatable; all unless given"
    )
    parser.add_argument(
        "--seed",
        type=int,
        action="append",
        help="repeatable; unless given 0, and with --full 7 too; 11 is kept for the end of a work",
    )
    parser.add_argument(
        "--rows",
        type=Path,
        default=ROOT / "results" / "scoreboard",
        help="where rows are kept: the run goes on there",
    )
    parser.add_argument(
        "--out", type=Path, default=ROOT / "validation" / "scoreboard.json", help="what is written"
    )
    parser.add_argument(
        "--against",
        type=Path,
        help="an earlier board: both side by side, and every case whose outcome differs",
    )
    parser.add_argument(
        "--before",
        metavar="COMMIT",
        help="measure processor times too, beside this commit in an environment of its own",
    )
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.set_defaults(level="quick")


def run(options: argparse.Namespace) -> int:
    """Print the table and the flips; one if any case is worse than in the earlier board, or wrong or a defect without one."""
    seeds = options.seed or ([0] if options.level == "quick" else [0, 7])
    tasks = [
        task
        for name in options.only or AREAS
        for seed in seeds
        for task in AREAS[name](options.level, seed)
    ]
    state = state_of_package()
    folder = options.rows / state
    rows = rows_of(tasks, folder, options.workers, lambda text: print(text, flush=True))
    if options.before is not None:  # alone on the machine, after all else
        path = folder / f"speed-{options.level}-{options.before}.json"
        run = partial(speed.row, options.before, options.level, options.rows / "environments")
        rows["speed: processor time"] = {"commands": kept(path, partial(timed, run))}
    now = board(rows, state, options.level, seeds)
    text = json.dumps(now, indent=1)
    atomic_write.write_whole(options.out, lambda part: part.write_text(text + "\n", "utf-8"))
    before = None if options.against is None else json.loads(options.against.read_text("utf-8"))
    print(table(now, before))
    if before is None:
        return int(
            any(
                outcome in ("wrong", "defect")
                for each in now["sets"].values()
                for outcome in each["cases"].values()
            )
        )
    turned = flips(before, now)
    print(f"{len(turned)} cases differ from {before['state']}")
    print("\n".join(sentence for _, sentence in turned))
    return int(any(worse > 0 for worse, _ in turned))
