"""``python -m trust fuzz``."""

from __future__ import annotations

import argparse
import time
from typing import Any

from trust import pool
from trust.fuzz import Fuzz


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--n", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first case: one finding is repeated with --first I --n 1")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--here", action="store_true", help="in this process, without limits, and say what each case is")
    parser.add_argument("--only", choices=["vehicle", "telemetry", "options"])


def run(options: Any) -> int:
    if options.here:
        with Fuzz(seed=options.seed, only=options.only, memory=None) as suite:
            for index in range(options.first, options.first + options.n):
                begun = time.process_time()
                verdict = suite(index)
                print(f"case {index}: {verdict.what}, {time.process_time() - begun:.1f} s: {suite.last}\n{verdict.shown or suite.told.err}", flush=True)
        return 0
    report = pool.run(
        Fuzz, options.n, first=options.first, workers=options.workers, say=lambda text: print(text, flush=True),
        seed=options.seed, only=options.only,
    )  # fmt: skip
    return tell(report)


def tell(report: pool.Report) -> int:
    """Print the figures; 1 if anything was found."""
    counts = ", ".join(f"{n} {what}" for what, n in report.counts.most_common())
    print(f"{report.n} cases in {report.seconds:.0f} s: {counts}")
    print(f"slowest {report.slowest_s:.1f} s of CPU (case {report.slowest}), largest process {report.peak_MB:.0f} MB")
    print(f"{len(report.findings)} findings")
    return 1 if report.findings else 0
