"""What the studies that run as `python -m` share: errors as one sentence, and rows that are kept as files."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

from sunspin.base import atomic_write
from sunspin.base.errors import OutputError, SunspinError, sentence


def command(work: Callable[[list[str] | None], None]) -> Callable[..., int]:
    """A `main` whose errors become one sentence on stderr and exit code 2, an interruption 130."""

    @wraps(work)
    def main(arguments: list[str] | None = None) -> int:
        try:
            work(arguments)
        except (KeyboardInterrupt, SunspinError) as error:
            stopped = isinstance(error, KeyboardInterrupt)
            print(
                str(error) or "interrupted; the same command goes on where it stopped",
                file=sys.stderr,
            )
            return 130 if stopped else 2
        return 0

    return main


def rows_folder(folder: Path) -> Path:
    """Make a folder of rows, without what killed runs had begun to write there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        atomic_write.sweep(folder)
    except OSError as error:
        raise OutputError(
            sentence(
                f"results cannot be written here ({error.strerror or error})",
                do="choose another folder",
                where=str(folder),
            )
        ) from None
    return folder


def kept(path: Path, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """A row from its JSON file; where there is none it is made, and the file written whole."""
    made = None if path.is_file() else json.dumps(make())
    try:
        if made is not None:
            atomic_write.write_whole(path, lambda part: part.write_text(made, "utf-8"))
        row = json.loads(path.read_text("utf-8"))
    except SunspinError:
        raise
    except (OSError, ValueError) as error:
        raise OutputError(
            sentence(
                f"the row cannot be kept or read ({error})",
                do="delete the file or choose another folder",
                where=str(path),
            )
        ) from None
    if not isinstance(row, dict):
        raise OutputError(
            sentence("this is no row of results", do="delete the file", where=str(path))
        )
    return row
