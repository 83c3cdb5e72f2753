"""Files that appear whole or not at all: written under a temporary name beside their place, then renamed.

The temporary names of a process are listed in a file beside them before they come into being, so that a later run removes what a
killed one left, and nothing else.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sunspin.base.untrusted import is_own

PART = re.compile(r"\.sunspin-(\d{1,9})-[0-9a-f]{16}\.part")
"""A temporary name: the process that writes there, and what nobody guesses."""

LIST = re.compile(r"\.sunspin-(\d{1,9})(?:-[0-9a-f]{16})?\.parts")
"""A list of temporary names of a process; it is there while the process writes there."""

MAX_LIST_BYTES = 1_000_000


def make_folder(folder: Path) -> None:
    """Make a folder and those above it, or leave them as they are. Whatever its name, only OSError is raised."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (RecursionError, ValueError):  # thousands of folders in each other; a NUL in a name
        raise OSError(errno.EINVAL, "no folder can have this name", str(folder)) from None


def write_whole(target: Path, write: Callable[[Path], Any]) -> Path:
    """Let `write` fill a temporary file, then give it its name. Raises what `write` raises, and OSError."""
    part = target.with_name(f".sunspin-{os.getpid()}-{secrets.token_hex(8)}.part")
    listed = part.with_suffix(
        ".parts"
    )  # one for each file: another thread's must stay listed while it is written
    try:
        listed.write_text(f"{part.name}\n", "ascii")
        write(part)
        with open(part, "rb") as file:
            os.fsync(
                file.fileno()
            )  # or a power failure may leave an empty file under the final name
        os.replace(part, target)
    finally:
        part.unlink(missing_ok=True)
        listed.unlink(missing_ok=True)
    return target


def left(folder: Path) -> set[Path]:
    """What killed runs had begun to write in a folder, with their lists: only what is listed, by a process that is no more."""
    found: set[Path] = set()
    for entry in folder.iterdir():
        named = LIST.fullmatch(entry.name)
        if named is not None and is_own(entry) and _is_over(int(named[1])):
            with open(entry, "rb") as file:
                names = file.read(MAX_LIST_BYTES).decode("ascii", "replace").splitlines()
            ours = (PART.fullmatch(name) for name in names)
            found |= {
                entry,
                *(folder / part[0] for part in ours if part is not None and part[1] == named[1]),
            }
    return found


def _is_over(process: int) -> bool:
    if os.name == "nt":  # where a signal of 0 ends the process
        return False
    try:
        os.kill(process, 0)
    except OSError as error:
        return isinstance(error, ProcessLookupError)
    return False


def sweep(folder: Path) -> None:
    """Remove what killed runs had begun to write in a folder."""
    for entry in left(folder):
        entry.unlink(missing_ok=True)
