"""``python -m validation kill``."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

from validation.kill import TARGETS, campaign


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--n", type=int, default=50, help="kills in all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--small", action="store_true", help="shorter runs")
    parser.add_argument("--only", choices=[target.name for target in TARGETS])


def run(options: Any) -> int:
    chosen = [target for target in TARGETS if options.only in (None, target.name)]
    total, wrong = sum(target.share for target in chosen), 0
    for target in chosen:
        with tempfile.TemporaryDirectory(prefix="validation-") as folder:
            told = campaign(
                target,
                max(1, round(options.n * target.share / total)),
                Path(folder),
                options.seed,
                options.small,
            )
        ended = f"{told.after_files} of them with results in place; {told.runs_through} runs got through"
        print(
            f"{told.name}: {told.kills} kills, {ended}; "
            + ("; ".join(told.wrong) or "the undisturbed result"),
            flush=True,
        )
        wrong += bool(told.wrong)
    return 1 if wrong else 0
