"""What comes from outside, within bounds: numbers of a size that can be squared, bytes of regular files, no more than was said."""

from __future__ import annotations

import stat
from pathlib import Path

from sunspin.errors import SunspinError, sentence

SMALLEST, LARGEST = 1e-30, 1e30
"""Sizes of numbers that files and options may give: far beyond any in use, and their squares and products are still numbers."""

SIZES = f"0 or a finite number between {SMALLEST:g} and {LARGEST:g} in size"


def is_sensible(value: float) -> bool:
    """Whether a number is zero or of a size that arithmetic stands."""
    return value == 0 or SMALLEST <= abs(value) <= LARGEST


def read_bytes(path: Path, most: int, kind: str, error_type: type[SunspinError], do: str) -> bytes:
    """The content of a file of at most `most` bytes; `kind` names it in messages, `do` says what to do where it cannot be read.

    A device never ends and a pipe without a writer never begins: they are refused before they are opened.
    """
    where = str(path)
    try:
        about = path.stat()
        if stat.S_ISDIR(about.st_mode):
            raise error_type(sentence(f"this is a folder, not a {kind}", where=where))
        if not stat.S_ISREG(about.st_mode):
            raise error_type(sentence(f"this is a device or a pipe, not a {kind}", do="save its content to a file", where=where))
        with open(path, "rb") as file:
            content = file.read(most + 1) if about.st_size <= most else b""
    except OSError as error:
        raise error_type(sentence(f"the {kind} cannot be read ({error.strerror or error})", do=do, where=where)) from None
    except ValueError as error:
        if isinstance(error, SunspinError):
            raise
        raise error_type(sentence(f"this is not a path ({error})", do=do, where=repr(where))) from None
    if max(about.st_size, len(content)) > most:
        raise error_type(
            sentence(f"a {kind} is smaller than {most / 1e6:g} MB", got=f"{about.st_size / 1e6:.0f} MB",
                     do="cut it into parts, or give the right file", where=where)
        )  # fmt: skip
    return content
