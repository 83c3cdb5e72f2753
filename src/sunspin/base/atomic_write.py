"""Files that appear whole or not at all: written under a temporary name beside their place, then renamed; and locks."""

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
"""A temporary name: the process that writes there, and what nobody guesses."""


def make_folder(folder: Path) -> None:
    """Make a folder and those above it, or leave them as they are. Whatever its name, only OSError is raised."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (RecursionError, ValueError):  # thousands of folders in each other; a NUL in a name
        raise OSError(errno.EINVAL, "no folder can have this name", str(folder)) from None


def write_atomically(target: Path, write: Callable[[Path], Any]) -> Path:
    """Let `write` fill a temporary file, then give it its name. Raises what `write` raises, and OSError."""
    part = target.with_name(f".sunspin-{os.getpid()}-{secrets.token_hex(8)}.part")
    try:
        write(part)
        with open(part, "rb") as file:  # or a power failure may leave an empty file
            os.fsync(file.fileno())
        os.replace(part, target)
    finally:
        part.unlink(missing_ok=True)
    return target


def remove_abandoned(folder: Path) -> None:
    """Remove what killed runs had begun to write in a folder: files with a temporary name of a process that is no more."""
    for entry in folder.iterdir() if os.name != "nt" else ():  # where a signal of 0 ends a process
        name = TEMPORARY_NAME.fullmatch(entry.name)
        if name and is_file_not_link(entry):
            try:
                os.kill(int(name[1]), 0)
            except ProcessLookupError:
                entry.unlink(missing_ok=True)
            except OSError:
                pass  # it runs, for somebody else


def lock_file(file: Any) -> None:
    """Hold an open file alone until it is closed; `BlockingIOError` where another process holds it.

    The system lets go of it when the process ends, however it ends.
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


def ensure_writable(folder: Path) -> bool:
    """Make a folder, for this user alone, where it is not there yet; whether files can be written into it."""
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    except OSError:
        return False
    return os.access(folder, os.W_OK)
