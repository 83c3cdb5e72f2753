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


class Told(NamedTuple):
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


def sunspin(*arguments: str, piped: bytes = b"") -> Told:
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
    return Told(
        code,
        out.buffer.getvalue().decode("utf-8"),
        said.decode("utf-8", "replace"),
        escaped,
        accepted,
    )


BEGUN = re.compile(r"sunspin: rates: \d+ samples[^\n]*\n")
"""The line by which `rates` says without a terminal that its work has begun, and no error."""


def judge(told: Told) -> Verdict:
    """Exit code 0 and silence on stderr, or 2 and one printable sentence there and nothing printed; but for lines of `BEGUN`."""
    told = told._replace(err=BEGUN.sub("", told.err))
    if told.escaped:
        return Verdict("traceback", True, told.escaped)
    if told.accepted:
        return Verdict("accepted", bool(told.err), told.err)
    if told.code == 0:
        return Verdict("fine") if not told.err else Verdict("noise", True, told.err)
    if told.code != 2:
        return Verdict("exit code", True, f"{told.code}: {told.err}")
    one = (
        told.err.startswith("sunspin: error: ")
        and told.err.count("\n") == 1
        and told.err.endswith("\n")
    )
    if not one or told.out or len(told.err) > LONGEST or not told.err[:-1].isprintable():
        return Verdict("not one sentence", True, repr((told.out[:200], told.err[:2000])))
    return Verdict("out of memory" if "not enough memory" in told.err else "refused")
