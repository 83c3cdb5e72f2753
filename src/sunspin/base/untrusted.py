"""What comes from outside, within bounds: numbers of a size that can be squared, bytes of regular files, no more than was said."""

from __future__ import annotations

import math
import stat
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

from sunspin.base.errors import InputError, SunspinError

SMALLEST, LARGEST = 1e-30, 1e30
"""Sizes of numbers that files and options may give: far beyond any in use, and their squares and products are still numbers."""

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
    where = str(path)
    try:
        about = path.stat()
        if stat.S_ISDIR(about.st_mode):
            raise error_type(f"this is a folder, not a {kind}", where=where)
        if not stat.S_ISREG(about.st_mode):
            what, do = f"this is a device or a pipe, not a {kind}", "save its content to a file"
            raise error_type(what, do=do, where=where)
        content = b""
        if 0 < about.st_size <= most:
            with open(path, "rb") as file:
                content = file.read(most + 1)
    except OSError as error:
        what = f"the {kind} cannot be read ({error.strerror or error})"
        raise error_type(what, do=do, where=where) from None
    except ValueError as error:
        if isinstance(error, SunspinError):
            raise
        raise error_type(f"this is not a path ({error})", do=do, where=repr(where)) from None
    if max(about.st_size, len(content)) > most:
        what, got = f"a {kind} is smaller than {most / 1e6:g} MB", f"{about.st_size / 1e6:.0f} MB"
        do = "cut it into parts, or give the right file"
        raise error_type(what, got=got, do=do, where=where)
    return content


def decoded(
    content: bytes,
    where: str,
    error_type: type[SunspinError],
    do: str,
    what: str = "the file is not UTF-8 text",
) -> str:
    """The text of a file in UTF-8, with or without its mark; what is none is named with the line where it stops being so."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise error_type(what, do=do, where=f"{where}, line {line}") from None


def xml_root(text: str, kind: str, where: str) -> ElementTree.Element:
    """The root of an XML text, a `kind` of file, without entities: a few lines of those may stand for gigabytes."""
    if "<!" in text.replace("<!--", ""):
        raise InputError("the XML defines entities", do=f"give a plain {kind}", where=where)
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise InputError(
            f"this is not valid XML ({error})", do="give the whole file", where=where
        ) from None


def is_plain(path: Path) -> bool:
    """Whether this is, or leads to, a regular file that is not empty: no device, pipe or file of the kernel, which may not end."""
    try:
        about = path.stat()
    except (OSError, ValueError):
        return False
    return stat.S_ISREG(about.st_mode) and about.st_size > 0


def is_own(path: Path) -> bool:
    """Whether a folder has this as a file of its own: regular, and no link, which could lead to anybody's file."""
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except (OSError, ValueError):
        return False


MEMORY = 6_000_000_000
"""Bytes of address space of another process that reads a file from outside."""

BOOT = """
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


class Elsewhere(Exception):
    """Why a script in another process did not come to its end."""


def elsewhere(script: Path, *arguments: str, content: bytes = b"", seconds: int) -> bytes:
    """What a script prints that runs in another process, under limits of CPU time and memory, with `content` to read.

    For the C libraries that read other people's files: on damaged ones they may compute for ever, or end the process. The
    script imports nothing of ours, as it may not find it. Raises `Elsewhere` with the reason.
    """
    # -P: the folder of the script is no place to import from
    command = [sys.executable, "-P", "-c", BOOT, str(seconds), str(MEMORY), str(script), *arguments]
    try:
        done = subprocess.run(
            command, input=content, capture_output=True, timeout=60 + 20 * seconds
        )
    except subprocess.TimeoutExpired:
        raise Elsewhere("reading it does not end") from None
    if done.returncode < 0:
        raise Elsewhere(
            f"reading it takes more than {seconds} s or ends the program that reads it, with signal {-done.returncode}"
        )
    if done.returncode:
        lines = done.stderr.decode("utf-8", "replace").strip().splitlines()
        raise Elsewhere(lines[-1][:300] if lines else "no reason is known")
    return done.stdout
