"""Safe reading of input from outside: plain numbers, files of limited size, TOML, scripts in limited processes."""

from __future__ import annotations

import codecs
import math
import os
import re
import stat
import subprocess
import sys
import tomllib
from numbers import Integral
from pathlib import Path
from typing import Any

from sunspin.base.errors import InputError, SunspinError

SMALLEST, LARGEST = 1e-30, 1e30
"""Range of the sizes of numbers in files and options: beyond any in use, while squares and products stay finite."""

MAX_DOTS = 1000
"""Dots in a line of TOML: the time of Python's reader grows with the square of the parts of a dotted key."""

SIZES = f"0 or a finite number between {SMALLEST:g} and {LARGEST:g} in size"
"""The range of numbers in words, for errors."""


def is_sensible(value: float) -> bool:
    """Return whether a number is zero or of a size between `SMALLEST` and `LARGEST`."""
    return value == 0 or SMALLEST <= abs(value) <= LARGEST


def require_whole(name: str, value: object, least: int) -> None:
    """Raise `InputError` if an argument, called `name` in the message, is no whole number or below `least`."""
    if isinstance(value, bool) or not isinstance(value, Integral) or int(value) < least:
        raise InputError(f"{name} must be a whole number of at least {least}", got=value)


def plain_number(text: str) -> float:
    """Return the number that a text contains, a plain decimal in ASCII digits such as -1.5e-3; NaN for any other text.

    Python's `float` also accepts 1_000, digits of other scripts, inf and nan, which are errors in a data file.
    """
    try:
        value = math.nan if "_" in text or not text.isascii() else float(text)
    except ValueError:
        value = math.nan
    return value if math.isfinite(value) else math.nan


def read_bytes(
    path: Path, max_bytes: int, kind: str, error_type: type[SunspinError], do: str
) -> bytes:
    """Read a file of at most `max_bytes` bytes.

    `kind` names the file in messages; `do` is the advice if it cannot be read. Devices and pipes are refused before they are
    opened, as reading them may not end. A file that states a size of zero is not opened either, and returned as empty: files of
    the kernel such as /proc/kmsg state zero and block.
    """
    where, content = str(path), b""
    try:
        status = path.stat()
        is_regular = stat.S_ISREG(status.st_mode)
        if is_regular and 0 < status.st_size <= max_bytes:
            with open(path, "rb") as file:
                content = file.read(max_bytes + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        what = f"the {kind} cannot be read ({getattr(error, 'strerror', None) or error})"
        raise error_type(what, do=do, where=where) from None
    if not is_regular:
        found = "a folder" if stat.S_ISDIR(status.st_mode) else "a device or a pipe"
        do = "give a file, or save its content to one"
        raise error_type(f"this is {found}, not a {kind}", do=do, where=where)
    # the file may have grown since its size was read
    if max(status.st_size, len(content)) > max_bytes:
        what = f"a {kind} is smaller than {max_bytes / 1e6:g} MB"
        got = f"{status.st_size / 1e6:.0f} MB"
        do = "cut it into parts, or give the right file"
        raise error_type(what, got=got, do=do, where=where)
    return content


def decode_text(content: bytes, where: str, error_type: type[SunspinError], do: str) -> str:
    """Decode UTF-8, or UTF-16 with a byte order mark, as Excel and PowerShell write it.

    Raises `error_type` with the line of the first invalid byte.
    """
    is_utf16 = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        return content.decode("utf-16" if is_utf16 else "utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        encoding = "UTF-16" if is_utf16 else "UTF-8"
        what, at = f"the file is not {encoding} text", f"{where}, line {line}"
        raise error_type(what, do=do, where=at) from None


LETTERS = {chr(code) for code in range(0xC0, 0xFF)} - {*"×÷ÐÞðþ"}  # 0xFF is erased memory

WESTERN = LETTERS | {*"°µ²³±·§–—€\u00a0ßœŒ"}
"""Characters beyond ASCII in names of columns in Western languages: signs of units, and letters with accents."""

UTF_8_PAIR = re.compile(rb"[\xc2-\xf4][\x80-\xbf]")
"""Bytes that begin a character of UTF-8, and a pair of Chinese or Japanese encodings; no pair of a Western text."""


def decode_western(content: bytes) -> str | None:
    """Decode the encoding of Western Windows (cp1252), as spreadsheets write CSV there; None if the text may be another one.

    Letters of other alphabets would become runs of letters with accents, or signs that no name of a column has.
    """
    if UTF_8_PAIR.search(content) or re.search(rb"[\x80-\xff]{3}", content):
        return None
    try:
        text = content.decode("cp1252")
    except UnicodeDecodeError:
        return None
    # side by side, Western names have small letters only (Größe); a Chinese character is a pair that begins with a capital
    pairs = re.findall("[^\\x00-\\x7f]{2}", text)
    is_western = {letter for letter in text if letter > "\x7f"} <= WESTERN
    return text if is_western and all(map(str.islower, pairs)) else None


def read_toml(
    text: str, where: str, error_type: type[SunspinError], do: str = "correct that line"
) -> dict[str, Any]:
    """Parse a TOML text into a table; raise `error_type` if it is not valid.

    `where` names the file in messages, `do` is the advice.
    """
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
    """Return whether a path is a regular file, or a link to one, that states a size above zero.

    Excludes devices, pipes and files of the kernel, which may block a reader for ever.
    """
    return os.path.isfile(path) and os.path.getsize(path) > 0


def is_file_not_link(path: Path) -> bool:
    """Return whether a path is a regular file and not a link, which could point to a file of another owner."""
    return os.path.isfile(path) and not os.path.islink(path)


MAX_MEMORY_BYTES = 6_000_000_000
"""Address space of a separate process that reads a file from outside."""

LIMITED_RUN = """
import runpy, sys
try:
    import resource
except ModuleNotFoundError:  # Windows
    limits = []
else:
    limits = [(resource.RLIMIT_CPU, int(sys.argv[1]))]
    if sys.platform != "darwin":  # which refuses limits of the address space
        limits.append((resource.RLIMIT_AS, int(sys.argv[2])))
for kind, wanted in limits:
    given = [limit for limit in resource.getrlimit(kind) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(kind, (min([wanted, *given]),) * 2)
sys.argv = sys.argv[3:]
try:
    runpy.run_path(sys.argv[0], run_name="__main__")
except Exception as error:
    sys.exit(" ".join(f"{type(error).__name__}: {error}".split()))
"""
"""Program of the separate process: set the limits of CPU time (s) and memory (bytes), then run the script.

Its arguments are both limits, the script and the script's own arguments. macOS has no limit of memory, and Windows has neither: the
elapsed time, which :func:`run_isolated` limits, is the only limit there."""


class IsolatedRunError(Exception):
    """A script in a separate process failed; the text says why."""


def run_isolated(script: Path, *arguments: str, content: bytes = b"", seconds: int) -> bytes:
    """Run a script in a separate process with limited CPU time (s) and memory; return what it prints.

    `content` is its standard input. This protects against C libraries that read files from outside: on damaged files they may
    compute for ever or end the process. The script must not import sunspin, which the new process may not find.

    Raises
    ------
    IsolatedRunError
        If the script fails, exceeds a limit or crashes.
    """
    # -P: nothing is imported from the folder of the script
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
        # elapsed time is limited as well, generously for a busy machine: a process that waits uses no CPU time
        done = subprocess.run(
            command, input=content, capture_output=True, timeout=60 + 20 * seconds
        )
    except subprocess.TimeoutExpired:
        raise IsolatedRunError("reading it does not end") from None
    if done.returncode < 0:  # ended by a signal: that of the CPU limit, or of a crash
        limit = f"reading it takes more than {seconds} s or ends the program that reads it"
        raise IsolatedRunError(f"{limit}, with signal {-done.returncode}")
    if done.returncode:
        lines = done.stderr.decode("utf-8", "replace").strip().splitlines()
        raise IsolatedRunError(lines[-1][:300] if lines else "no reason is known")
    return done.stdout
