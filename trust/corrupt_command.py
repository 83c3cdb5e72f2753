"""``python -m trust corrupt``."""

from __future__ import annotations

import argparse
from typing import Any

from trust import pool
from trust.corrupt import FORMATS, Corrupt
from trust.fuzz_command import common, here, tell


def options(parser: argparse.ArgumentParser) -> None:
    common(parser)
    parser.add_argument("--only", choices=FORMATS)


def run(options: Any) -> int:
    if options.here:
        return here(Corrupt, options)
    return tell(
        pool.run(Corrupt, options.n, first=options.first, workers=options.workers, say=lambda text: print(text, flush=True),
                 seed=options.seed, only=options.only)
    )  # fmt: skip
