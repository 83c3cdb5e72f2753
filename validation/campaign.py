"""Shared functions of studies and campaigns: errors as one sentence, and results that are kept as files."""

from __future__ import annotations

import argparse
import json
import sys
import textwrap
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

from sunspin.base.atomic_write import remove_abandoned, write_atomically


def command(work: Callable[[list[str] | None], None]) -> Callable[..., int]:
    """Make a `main` that prints an error as one sentence and returns exit code 2, or 130 if it is interrupted."""

    @wraps(work)
    def main(arguments: list[str] | None = None) -> int:
        """Run `work` and return its exit code."""
        try:
            work(arguments)
        except KeyboardInterrupt:
            print("interrupted; the same command goes on where it stopped", file=sys.stderr)
            return 130
        except (OSError, ValueError) as error:  # sunspin's own errors are ValueErrors
            print(error, file=sys.stderr)
            return 2
        return 0

    return main


def study_parser(name: str, doc: str | None) -> argparse.ArgumentParser:
    """Return the parser of `python -m studies.NAME`, whose help shows the paragraphs of the module's docstring."""
    command = f"python -m studies.{name}"
    paragraphs = [
        text for text in (doc or "").split("\n\n") if not text.strip().startswith(command)
    ]
    return argparse.ArgumentParser(
        prog=command,
        description="\n\n".join(map(textwrap.fill, paragraphs)),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def rows_folder(folder: Path) -> Path:
    """Create a folder of results and delete the unfinished files that killed runs left there."""
    folder.mkdir(parents=True, exist_ok=True)
    remove_abandoned(folder)
    return folder


def load_or_make(path: Path, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return a row of results from its JSON file; if there is none, make it and write the file.

    Raises ValueError if the file has something else.
    """
    if not path.is_file():
        text = json.dumps(make())
        write_atomically(path, lambda new: new.write_text(text, "utf-8"))
    try:
        row = json.loads(path.read_text("utf-8"))
    except ValueError:
        row = None
    if not isinstance(row, dict):
        raise ValueError(f"{path}: this is no row of results; delete the file")
    return row
