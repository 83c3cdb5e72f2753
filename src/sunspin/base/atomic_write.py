"""Atomic writing of files, removal of abandoned temporary files, and file locks.

A file is written under a temporary name in its own folder and then renamed, so that it appears complete or not at all.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from sunspin.base.untrusted import is_file_not_link

TEMPORARY_NAME = re.compile(r"\.sunspin-(\d{1,9})-[0-9a-f]{16}\.part")
"""Temporary file name: the number of the writing process and 16 random hexadecimal digits."""


def make_folder(folder: Path) -> None:
    """Create a folder and its parents if they do not exist.

    Raises only OSError, for any name: pathlib raises RecursionError for very deep paths and ValueError for a NUL.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (RecursionError, ValueError):
        raise OSError(errno.EINVAL, "no folder can have this name", str(folder)) from None


def write_atomically(target: Path, write: Callable[[Path], Any]) -> Path:
    """Write a file through `write`, which gets a temporary path, and rename it to `target`; return `target`.

    The temporary file is removed if `write` or the renaming fails. Raises the errors of `write`, and OSError.
    """
    part = target.with_name(f".sunspin-{os.getpid()}-{secrets.token_hex(8)}.part")
    try:
        write(part)
        # on disk before the renaming: a power failure must not leave an empty file
        # open for writing too: Windows refuses to flush a file that is open for reading only
        with open(part, "r+b") as file:
            os.fsync(file.fileno())
        os.replace(part, target)
    finally:
        part.unlink(missing_ok=True)
    return target


def remove_abandoned(folder: Path) -> None:
    """Remove the temporary files in a folder whose writing process no longer exists."""
    # signal 0 only tests whether a process exists, but on Windows it would end that process
    for entry in folder.iterdir() if os.name != "nt" else ():
        name = TEMPORARY_NAME.fullmatch(entry.name)
        if name and is_file_not_link(entry):
            try:
                os.kill(int(name[1]), 0)
            except ProcessLookupError:
                entry.unlink(missing_ok=True)
            except OSError:
                pass  # the process exists and belongs to another user


def lock_file(file: Any) -> None:
    """Lock an open file for this process until the file is closed; raise BlockingIOError if another process has locked it.

    The system releases the lock when the process ends, also after a crash.
    """
    try:
        import fcntl
    except ModuleNotFoundError:  # Windows
        msvcrt: Any = import_module("msvcrt")
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError as error:
            raise BlockingIOError(*error.args) from None
    else:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
