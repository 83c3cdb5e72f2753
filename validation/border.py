"""Run the command line in this process as a shell would, and check the rule that all its output has to obey."""

from __future__ import annotations

import io
import os
import re
import sys
import tempfile
import traceback
import warnings
from contextlib import contextmanager
from typing import NamedTuple

from validation.pool import Verdict

LONGEST = 1500
"""Largest number of characters in an error message."""


class Accepted(BaseException):
    """Raised instead of long work: the input has passed all checks."""


class CommandResult(NamedTuple):
    """Result of a command: exit code (None if nothing was returned), standard output, standard error, escaped traceback."""

    code: int | None
    out: str
    err: str
    escaped: str = ""
    accepted: bool = False


@contextmanager
def _quiet_descriptor():
    """Redirect file descriptor 2, to which C libraries write their errors, to a file, and yield the file."""
    with tempfile.TemporaryFile() as file:
        saved = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield file
        finally:
            os.dup2(saved, 2)
            os.close(saved)


def sunspin(*arguments: str, piped: bytes = b"") -> CommandResult:
    """Run the entry point with these arguments and `piped` on standard input, and return the result.

    Output is strict UTF-8 and every warning is shown, as on a strict terminal. Standard error includes that of C libraries.
    """
    from sunspin import cli

    saved = sys.argv, sys.stdin, sys.stdout, sys.stderr, sys.unraisablehook
    out = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True)
    err = io.TextIOWrapper(
        io.BytesIO(), encoding="utf-8", errors="backslashreplace", write_through=True
    )
    code, escaped, accepted = None, "", False
    with _quiet_descriptor() as c_errors, warnings.catch_warnings():
        warnings.simplefilter("always")
        for kind in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
            warnings.simplefilter("ignore", kind)
        sys.argv, sys.stdout, sys.stderr = ["sunspin", *arguments], out, err
        sys.stdin = io.TextIOWrapper(io.BytesIO(piped))
        sys.unraisablehook = lambda hint: err.write(f"unraisable: {hint.exc_value!r}\n")
        try:
            cli.main()
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else None
        except Accepted:
            accepted = True
        except BaseException:
            escaped = traceback.format_exc(limit=-4)
        finally:
            sys.argv, sys.stdin, sys.stdout, sys.stderr, sys.unraisablehook = saved
        c_errors.seek(0)
        errors = err.buffer.getvalue() + c_errors.read()
    return CommandResult(
        code,
        out.buffer.getvalue().decode("utf-8"),
        errors.decode("utf-8", "replace"),
        escaped,
        accepted,
    )


BEGUN = re.compile(r"sunspin: rates: \d+ samples[^\n]*\n|compiling the [^\n]*, once[^\n]*\n")
"""Lines by which `rates` announces without a terminal that its work has begun, and the first run that it compiles: no errors."""

SUGGESTION = "A [telemetry] section that would read"
"""Begin of the line that `check` prints before it refuses a file of which it knows no column."""


def judge(result: CommandResult) -> Verdict:
    """Return the verdict on a result: exit code 0 without a message, or 2 with one printable sentence on stderr and no output.

    A `SUGGESTION` is allowed as output. Lines that match `BEGUN` are ignored. `accepted` work (see `Accepted`) must have printed
    no error.
    """
    result = result._replace(err=BEGUN.sub("", result.err))
    if result.escaped:
        return Verdict("traceback", True, result.escaped)
    if result.accepted:
        return Verdict("accepted", bool(result.err), result.err)
    if result.code == 0:
        return Verdict("fine") if not result.err else Verdict("noise", True, result.err)
    if result.code != 2:
        return Verdict("exit code", True, f"{result.code}: {result.err}")
    is_sentence = (
        result.err.startswith("sunspin: error: ")
        and result.err.count("\n") == 1
        and result.err.endswith("\n")
    )
    if (
        not is_sentence
        or (result.out and SUGGESTION not in result.out)
        or len(result.err) > LONGEST
        or not result.err[:-1].isprintable()
    ):
        return Verdict("not one sentence", True, repr((result.out[:200], result.err[:2000])))
    return Verdict("out of memory" if "not enough memory" in result.err else "refused")
