"""The command line called in this process as a shell would call it, and the rule that everything it says has to obey."""

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
"""Characters that one sentence may have."""


class Accepted(BaseException):
    """Raised in the place of work that would take long: the input has passed the border."""


class CommandResult(NamedTuple):
    """Exit code (None: nothing was returned), what was printed and complained, what escaped."""

    code: int | None
    out: str
    err: str
    escaped: str = ""
    accepted: bool = False


@contextmanager
def _quiet_descriptor():
    """Standard error of the C libraries below goes to a file."""
    with tempfile.TemporaryFile() as file:
        kept = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield file
        finally:
            os.dup2(kept, 2)
            os.close(kept)


def sunspin(*arguments: str, piped: bytes = b"") -> CommandResult:
    """The entry point on these arguments. Output is strict UTF-8, warnings are shown each time: as on a terminal, but worse."""
    from sunspin import cli

    kept = sys.argv, sys.stdin, sys.stdout, sys.stderr, sys.unraisablehook
    out = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True)
    err = io.TextIOWrapper(
        io.BytesIO(), encoding="utf-8", errors="backslashreplace", write_through=True
    )
    code, escaped, accepted = None, "", False
    with _quiet_descriptor() as below, warnings.catch_warnings():
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
            sys.argv, sys.stdin, sys.stdout, sys.stderr, sys.unraisablehook = kept
        below.seek(0)
        said = err.buffer.getvalue() + below.read()
    return CommandResult(
        code,
        out.buffer.getvalue().decode("utf-8"),
        said.decode("utf-8", "replace"),
        escaped,
        accepted,
    )


BEGUN = re.compile(r"sunspin: rates: \d+ samples[^\n]*\n")
"""The line by which `rates` says without a terminal that its work has begun, and no error."""


def judge(result: CommandResult) -> Verdict:
    """Exit code 0 and silence on stderr, or 2 and one printable sentence there and nothing printed; but for lines of `BEGUN`."""
    result = result._replace(err=BEGUN.sub("", result.err))
    if result.escaped:
        return Verdict("traceback", True, result.escaped)
    if result.accepted:
        return Verdict("accepted", bool(result.err), result.err)
    if result.code == 0:
        return Verdict("fine") if not result.err else Verdict("noise", True, result.err)
    if result.code != 2:
        return Verdict("exit code", True, f"{result.code}: {result.err}")
    one = (
        result.err.startswith("sunspin: error: ")
        and result.err.count("\n") == 1
        and result.err.endswith("\n")
    )
    if not one or result.out or len(result.err) > LONGEST or not result.err[:-1].isprintable():
        return Verdict("not one sentence", True, repr((result.out[:200], result.err[:2000])))
    return Verdict("out of memory" if "not enough memory" in result.err else "refused")
