"""``python -m validation corrupt``."""

from __future__ import annotations

import argparse
from typing import Any

from validation.corrupt import FORMATS, Corrupt, Unguarded
from validation.fuzz_command import common, run_suite


def options(parser: argparse.ArgumentParser) -> None:
    common(parser)
    parser.add_argument("--only", choices=FORMATS)
    about = "read in the same process what sunspin reads in another, and count crashes and hangs"
    parser.add_argument("--unguarded", action="store_true", help=about)


def run(options: Any) -> int:
    return run_suite(Unguarded if options.unguarded else Corrupt, options)
