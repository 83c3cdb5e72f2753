"""``python -m validation fuzz``, and what it shares with ``corrupt``."""

from __future__ import annotations

import argparse
import time
from typing import Any

from validation import pool
from validation.fuzz import KINDS, Fuzz
from validation.suite import Suite


def common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--n", type=int, default=1000, help="cases")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--first", type=int, default=0, help="number of the first case: --first I --n 1 repeats one"
    )
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument(
        "--here",
        action="store_true",
        help="in this process, without limits, and say what each case is",
    )


def options(parser: argparse.ArgumentParser) -> None:
    common(parser)
    parser.add_argument("--only", choices=list(KINDS))


def run(options: Any) -> int:
    return run_suite(Fuzz, options)


def run_suite(suite: type[Suite], options: Any) -> int:
    """The cases that were asked for, in other processes or here; 1 if anything was found."""
    if options.here:
        return here(suite, options)
    return tell(
        pool.run(
            suite,
            options.n,
            first=options.first,
            workers=options.workers,
            say=lambda text: print(text, flush=True),
            seed=options.seed,
            only=options.only,
        )
    )


def here(suite: type[Suite], options: Any) -> int:
    """Cases in this process, each told in full."""
    with suite(seed=options.seed, only=options.only, memory=None) as case:
        for index in range(options.first, options.first + options.n):
            begun = time.process_time()
            verdict = case(index)
            told = verdict.shown or getattr(getattr(case, "told", None), "err", "")
            print(
                f"case {index}: {verdict.what}, {time.process_time() - begun:.1f} s: {case.last}\n{told}",
                flush=True,
            )
    return 0


def tell(report: pool.Report) -> int:
    """Print the figures; 1 if anything was found."""
    counts = ", ".join(f"{n} {what}" for what, n in report.counts.most_common())
    print(f"{report.n} cases in {report.seconds:.0f} s: {counts}")
    print(
        f"slowest {report.slowest_s:.1f} s of CPU (case {report.slowest}), largest process {report.peak_MB:.0f} MB"
    )
    print(f"{len(report.findings)} findings")
    return 1 if report.findings else 0
