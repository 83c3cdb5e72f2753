"""``python -m validation mutants``."""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

from validation.mutants import MODULES, drawn, is_seen


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--n", type=int, default=25, help="mutants of each file")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=list(MODULES))


def run(options: Any) -> int:
    survivors = 0
    for file in MODULES if options.only is None else (options.only,):
        begun, chosen, unseen = time.monotonic(), drawn(file, options.n, options.seed), []
        with tempfile.TemporaryDirectory(prefix="validation-") as home:
            for mutant in chosen:
                if not is_seen(mutant, Path(home)):
                    unseen.append(mutant)
                    print(
                        f"{file}, line {mutant.line}: survived: {mutant.before}  ->  {mutant.after}",
                        flush=True,
                    )
        took = time.monotonic() - begun
        print(
            f"{file}: {len(chosen)} mutants, {len(chosen) - len(unseen)} seen, {len(unseen)} survived, {took:.0f} s",
            flush=True,
        )
        survivors += len(unseen)
    return 1 if survivors else 0
