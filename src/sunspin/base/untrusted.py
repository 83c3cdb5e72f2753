"""What comes from outside, within bounds: numbers of a size that can be squared, bytes of regular files, no more than was said."""

from __future__ import annotations

import math
import os
import stat
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

from sunspin.base.errors import SunspinError

SMALLEST, LARGEST = 1e-30, 1e30
"""Sizes of numbers that files and options may give: far beyond any in use, and their squares and products are still numbers."""

MAX_DOTS = 1000
"""In a line of TOML: Python's reader takes a time that grows with the square of the parts of a dotted key."""

SIZES = f"0 or a finite number between {SMALLEST:g} and {LARGEST:g} in size"


def is_sensible(value: float) -> bool:
    """Whether a number is zero or of a size that arithmetic stands."""
    return value == 0 or SMALLEST <= abs(value) <= LARGEST


def plain_number(text: str) -> float:
    """The number that a text from outside is: a plain decimal in ASCII digits, such as -1.5e-3; NaN for every other text.

    Python reads more as numbers, which nobody means by them: 1_000, digits of other scripts, inf, nan.
    """
    try:
        value = math.nan if "_" in text or not text.isascii() else float(text)
    except ValueError:
        value = math.nan
    return value if math.isfinite(value) else math.nan


def read_bytes(path: Path, most: int, kind: str, error_type: type[SunspinError], do: str) -> bytes:
    """The content of a file of at most `most` bytes; `kind` names it in messages, `do` says what to do where it cannot be read.

    A device never ends and a pipe without a writer never begins: they are refused before they are opened. Nor is a file opened
    that says that it is empty: the kernel's own, such as /proc/kmsg, say so and wait for ever.
    """
    where, content = str(path), b""
    try:
        about = path.stat()
        is_regular = stat.S_ISREG(about.st_mode)
        if is_regular and 0 < about.st_size <= most:
            with open(path, "rb") as file:
                content = file.read(most + 1)
    except (OSError, ValueError) as error:  # also of a NUL in the path
        what = f"the {kind} cannot be read ({getattr(error, 'strerror', None) or error})"
        raise error_type(what, do=do, where=where) from None
    if not is_regular:
        sort = "a folder" if stat.S_ISDIR(about.st_mode) else "a device or a pipe"
        do = "give a file, or save its content to one"
        raise error_type(f"this is {sort}, not a {kind}", do=do, where=where)
    if max(about.st_size, len(content)) > most:
        what, got = f"a {kind} is smaller than {most / 1e6:g} MB", f"{about.st_size / 1e6:.0f} MB"
        do = "cut it into parts, or give the right file"
        raise error_type(what, got=got, do=do, where=where)
    return content


def decode_text(content: bytes, where: str, error_type: type[SunspinError], do: str) -> str:
    """The text of a file in UTF-8, with or without its mark; what is none is named with the line where it stops being so."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        what, at = "the file is not UTF-8 text", f"{where}, line {line}"
        raise error_type(what, do=do, where=at) from None


def read_toml(
    text: str, where: str, error_type: type[SunspinError], do: str = "correct that line"
) -> dict[str, Any]:
    """The table of a TOML text; `where` names the file in messages, `do` says what to do where it is no TOML."""
    for number, line in enumerate(text.splitlines(), 1):
        if line.count(".") > MAX_DOTS:
            what, at = f"the line has more than {MAX_DOTS} dots", f"{where}, line {number}"
            raise error_type(what, do="write it as several lines", where=at)
    try:
        return tomllib.loads(text)
    except RecursionError:
        what, do = "the file is nested too deeply", "give the right file"
    except ValueError as error:
        what = f"this is not valid TOML: {error}"
        if not isinstance(error, tomllib.TOMLDecodeError):  # int() on thousands of digits
            do = "correct that number"
    raise error_type(what, do=do, where=where)


def is_nonempty_file(path: Path) -> bool:
    """Whether this is, or leads to, a regular file that is not empty: no device, pipe or file of the kernel, which may not end."""
    return os.path.isfile(path) and os.path.getsize(path) > 0


def is_file_not_link(path: Path) -> bool:
    """Whether a folder has this as a file of its own: regular, and no link, which could lead to anybody's file."""
    return os.path.isfile(path) and not os.path.islink(path)


MAX_MEMORY_BYTES = 6_000_000_000
"""Bytes of address space of another process that reads a file from outside."""

LIMITED_RUN = """
import resource, runpy, sys
for kind, wanted in ((resource.RLIMIT_CPU, int(sys.argv[1])), (resource.RLIMIT_AS, int(sys.argv[2]))):
    given = [limit for limit in resource.getrlimit(kind) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(kind, (min([wanted, *given]),) * 2)
sys.argv = sys.argv[3:]
try:
    runpy.run_path(sys.argv[0], run_name="__main__")
except Exception as error:
    sys.exit(" ".join(f"{type(error).__name__}: {error}".split()))
"""


class IsolatedRunError(Exception):
    """Why a script in another process did not come to its end."""


def run_isolated(script: Path, *arguments: str, content: bytes = b"", seconds: int) -> bytes:
    """What a script prints that runs in another process, under limits of CPU time and memory, with `content` to read.

    For the C libraries that read other people's files: on damaged ones they may compute for ever, or end the process. The
    script imports nothing of ours, as it may not find it. Raises `Elsewhere` with the reason.
    """
    # -P: the folder of the script is no place to import from
    command = [
        sys.executable,
        "-P",
        "-c",
        LIMITED_RUN,
        str(seconds),
        str(MAX_MEMORY_BYTES),
        str(script),
        *arguments,
    ]
    try:
        done = subprocess.run(
            command, input=content, capture_output=True, timeout=60 + 20 * seconds
        )
    except subprocess.TimeoutExpired:
        raise IsolatedRunError("reading it does not end") from None
    if done.returncode < 0:
        limit = f"reading it takes more than {seconds} s or ends the program that reads it"
        raise IsolatedRunError(f"{limit}, with signal {-done.returncode}")
    if done.returncode:
        lines = done.stderr.decode("utf-8", "replace").strip().splitlines()
        raise IsolatedRunError(lines[-1][:300] if lines else "no reason is known")
    return done.stdout
