"""``python -m validation corrupt``."""

from __future__ import annotations

import argparse
from typing import Any

from validation.corrupt import FORMATS, Corrupt
from validation.fuzz_command import common, run_suite


def options(parser: argparse.ArgumentParser) -> None:
    common(parser)
    parser.add_argument("--only", choices=FORMATS)


def run(options: Any) -> int:
    return run_suite(Corrupt, options)
