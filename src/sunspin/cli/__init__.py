"""The command line: each command turns its arguments into calls, and imports heavy modules only when it runs."""

from __future__ import annotations

import atexit
import errno
import gc
import io
import os
import re
import sys
import warnings
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

INTERRUPTED = "interrupted; nothing half-written was left behind, run the same command again"

try:
    import click

    from sunspin.base.errors import SunspinError, printable
    from sunspin.cli.common import Group
    from sunspin.cli.interruption import (
        STOPPED,
        accept_interruption,
        catch_signals,
        end_with_threads,
    )
except KeyboardInterrupt:  # Ctrl-C before `main` has set the handlers of signals
    sys.stderr.write(f"sunspin: {INTERRUPTED}\n")
    sys.exit(130)

GARBAGE = 200_000
"""Objects that may become garbage before it is collected: small ones take some 20 MB. Python collects after 700. Imports take
0.05 s more with 50,000."""


@click.group(
    cls=Group,
    invoke_without_command=True,
    context_settings={
        "help_option_names": ["-h", "--help"],
        "max_content_width": 110,
        "show_default": True,
    },
    epilog="Start with `sunspin init my-satellite`. Every command has --help with examples that run, --json and --quiet.",
)
@click.version_option(package_name="sunspin")
@click.pass_context
def cli(ctx: click.Context) -> None:
    """Estimate spacecraft rotation from solar-panel power and other sparse attitude data."""
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


def main() -> None:
    """Run the command line; errors become one sentence on stderr and an exit code.

    Exit codes: 0 done, 1 defect of sunspin, 2 bad input, 130 interrupted.
    """
    _prepare_streams()
    if not (sys.warnoptions or os.environ.get("SUNSPIN_TRACEBACK")):
        # warnings of libraries are for programmers, who can set PYTHONWARNINGS to see them
        warnings.simplefilter("ignore")
    catch_signals()
    # at its end Python would look for garbage in all that was imported, several times, although the memory is freed anyway
    atexit.register(gc.freeze)
    try:
        try:
            with _seldom_collecting(), _without_dask():
                code = cli.main(prog_name="sunspin", standalone_mode=False)
        finally:
            accept_interruption()
        sys.stdout.flush()
        sys.exit(code if isinstance(code, int) else 0)
    except (click.Abort, KeyboardInterrupt) as stop:
        # before SunspinError, of which an interruption may be a subclass
        text, code = str(stop) or INTERRUPTED, 130
    except SunspinError as error:
        text, code = f"error: {error}", 2
    except click.ClickException as error:
        text = " ".join(error.format_message().split()).rstrip(".")
        text = re.sub("is not a valid float( range)?", "is not a number such as -1.5e-3", text)
        text = re.sub("is not a valid integer( range)?", "is not a whole number", text)
        context = getattr(error, "ctx", None)
        text += f"; see `{context.command_path} --help`" if context is not None else ""
        text, code = f"error: {text}", 2
    except BrokenPipeError:
        # the program that reads the output has ended, as in `sunspin ... | head`
        text, code = "", 0
    except MemoryError:
        text, code = "error: not enough memory; use a coarser grid or a shorter file", 2
    except OSError as error:  # of files for which no function raises a more specific error
        target = error.filename or "a file or the output"
        do = "free space" if error.errno in (errno.ENOSPC, errno.EDQUOT) else "check the path"
        text, code = f"error: {target} cannot be used ({error.strerror or error}); {do}", 2
    except Exception as error:
        if STOPPED.is_set():
            # a library has caught the interruption and failed later: that is no defect
            text, code = INTERRUPTED, 130
        elif os.environ.get("SUNSPIN_TRACEBACK"):
            raise
        else:
            fault = f"a fault of sunspin and not of its input ({type(error).__name__}: {str(error)[:200]})"
            do = "set SUNSPIN_TRACEBACK=1 to see where, and please report it"
            text, code = f"defect: this is {fault}; {do}", 1
    text = printable(text)
    text = text if len(text) <= 1200 else f"{text[:600]} ... {text[-600:]}"  # names may be long
    # stdout gets no message; it is only flushed
    for stream, message in ((sys.stderr, f"sunspin: {text}\n" if text else ""), (sys.stdout, "")):
        try:
            stream.write(message)
            stream.flush()
        except OSError:
            # The disk is full, for example. Python would flush again at exit and print an error, so the output is discarded.
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    if code == 130:
        end_with_threads(code)
    sys.exit(code)


@contextmanager
def _seldom_collecting() -> Generator[None]:
    """Collect garbage less often: imports make many objects and little garbage."""
    threshold = gc.get_threshold()
    gc.set_threshold(GARBAGE, *threshold[1:])
    try:
        yield
    finally:
        gc.set_threshold(*threshold)


@contextmanager
def _without_dask() -> Generator[None]:
    """Hide dask from xarray, which would import it wherever it is installed, for half a second; a scheduler alone needs it."""
    modules: dict[str, Any] = sys.modules
    scheduled = any(word.startswith("--scheduler") for word in sys.argv)
    # xarray looks for dask when it is imported: after that it must find the same
    hidden = not scheduled and "dask" not in modules and "xarray" not in modules
    if hidden:
        modules["dask"] = None  # an import of it raises ModuleNotFoundError
    try:
        yield
    finally:
        if hidden:
            del modules["dask"]


def _prepare_streams() -> None:
    """Make stdout and stderr writable: discard output if a stream is closed, and escape characters that its encoding lacks."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the caller, as with >&-
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))
        stream = getattr(sys, name)
        if isinstance(stream, io.TextIOWrapper):
            # names of files may have characters that the encoding of the terminal lacks
            stream.reconfigure(errors="backslashreplace")
