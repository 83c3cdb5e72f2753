"""``python -m validation witnesses``."""

from __future__ import annotations

import argparse
from typing import Any

from validation.witnesses import WITNESSES, table


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--only", choices=[witness.__name__ for witness in WITNESSES])


def run(options: Any) -> int:
    rows = [
        row
        for witness in WITNESSES
        if options.only in (None, witness.__name__)
        for row in witness()
    ]
    print(table(rows))
    failed = [row for row in rows if not row.holds]
    for row in failed:
        print(f"MISSED: {row.witness}, {row.what}: {row.error:.2e}, wanted {row.wanted:.0e}")
    return 1 if failed else 0
