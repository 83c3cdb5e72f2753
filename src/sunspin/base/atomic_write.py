"""Files that appear whole or not at all: written under a temporary name beside their place, then renamed."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

PART = re.compile(r"\..+\.(\d{1,9})\.part")
"""A temporary name, with the process that writes there."""


def write_whole(target: Path, write: Callable[[Path], Any]) -> Path:
    """Let `write` fill a temporary file, then give it its name. Raises what `write` raises, and OSError."""
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        write(part)
        with open(part, "rb") as file:
            os.fsync(file.fileno())  # or a power failure may leave an empty file under the final name
        os.replace(part, target)
    finally:
        part.unlink(missing_ok=True)
    return target


def is_left(entry: Path) -> bool:
    """Whether a file is what a killed run had begun to write: the process in its name is no more."""
    named = PART.fullmatch(entry.name)
    if named is None or int(named[1]) == os.getpid():
        return False
    try:
        os.kill(int(named[1]), 0)
    except ProcessLookupError:
        return True
    except OSError:
        pass
    return False


def sweep(folder: Path) -> None:
    """Remove what killed runs had begun to write in a folder."""
    for entry in folder.iterdir():
        if is_left(entry):
            entry.unlink(missing_ok=True)
