"""What studies and campaigns share: errors as one sentence, and rows that are kept as files."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

from sunspin.base.atomic_write import sweep, write_whole


def command(work: Callable[[list[str] | None], None]) -> Callable[..., int]:
    """A `main` whose errors become one sentence on stderr and exit code 2, an interruption 130."""

    @wraps(work)
    def main(arguments: list[str] | None = None) -> int:
        try:
            work(arguments)
        except KeyboardInterrupt:
            print("interrupted; the same command goes on where it stopped", file=sys.stderr)
            return 130
        except (OSError, ValueError) as error:  # those of sunspin are values that make no sense
            print(error, file=sys.stderr)
            return 2
        return 0

    return main


def rows_folder(folder: Path) -> Path:
    """Make a folder of rows, without what killed runs had begun to write there."""
    folder.mkdir(parents=True, exist_ok=True)
    sweep(folder)
    return folder


def load_or_make(path: Path, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """A row from its JSON file; where there is none it is made, and the file written whole."""
    if not path.is_file():
        text = json.dumps(make())
        write_whole(path, lambda new: new.write_text(text, "utf-8"))
    try:
        row = json.loads(path.read_text("utf-8"))
    except ValueError:
        row = None
    if not isinstance(row, dict):
        raise ValueError(f"{path}: this is no row of results; delete the file")
    return row
