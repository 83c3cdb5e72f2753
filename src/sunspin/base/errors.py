"""Errors that a person can act on: what is wrong, what was found, what to do.

Every error that sunspin raises on purpose derives from :class:`SunspinError`; the command line prints its text as one
sentence and exits with code 2 (130 after an interruption). Anything else that escapes is a defect of sunspin.
"""

from __future__ import annotations

from datetime import date, time


class SunspinError(ValueError):
    """Base of all errors raised on purpose; ``str(error)`` is one sentence for the user, built by :func:`sentence`."""

    def __init__(
        self, what: str, *, got: object = None, do: str | None = None, where: str | None = None
    ) -> None:
        super().__init__(sentence(what, got=got, do=do, where=where))


class VehicleError(SunspinError):
    """A vehicle, or the file that describes it, cannot be used."""


class TelemetryError(SunspinError):
    """A telemetry file or array cannot be used."""


class MotionError(SunspinError):
    """A trajectory was asked for that the model cannot give."""


class InputError(SunspinError):
    """An argument of a function or command does not make sense."""


class OutputError(SunspinError):
    """A result cannot be written where it was asked for."""


class Interrupted(SunspinError, KeyboardInterrupt):
    """A run of many rows was stopped by Ctrl-C; the text says what was kept and how to go on."""


def printable(text: str) -> str:
    """Text from outside on one line, without characters that a terminal obeys or does not show: they become escapes."""
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode("ascii")
        for c in " ".join(text.split())
    )


def sentence(
    what: str, *, got: object = None, do: str | None = None, where: str | None = None
) -> str:
    """Build the one-sentence text of an error: ``where: what, got ...; do``."""
    text = f"{where}: {what}" if where else what
    if got is not None:
        try:  # a date as the file has it
            shown = got.isoformat() if isinstance(got, date | time) else repr(got)
        except ValueError:
            shown = "a number too long to print"  # a whole one of thousands of digits
        shown = (got if isinstance(got, str) else shown) or "nothing"
        text += f" (found {shown if len(shown) <= 120 else shown[:117] + '...'})"
    if do:
        text += f"; {do}"
    return printable(text)
