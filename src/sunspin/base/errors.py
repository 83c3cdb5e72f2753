"""Errors that a user can act on: what is wrong, what was given, what to do.

Every error that sunspin raises on purpose derives from :class:`SunspinError`. The command line prints its text as one sentence and
exits with code 2 (130 after an interruption). Any other exception that reaches the user is a defect of sunspin.
"""

from __future__ import annotations

from datetime import date, time


class SunspinError(ValueError):
    """Base class of all errors raised on purpose; ``str(error)`` is one sentence, built by :func:`sentence`.

    `problem` is that sentence without the advice.
    """

    def __init__(
        self, what: str, *, got: object = None, do: str | None = None, where: str | None = None
    ) -> None:
        super().__init__(sentence(what, got=got, do=do, where=where))
        self.problem = sentence(what, got=got, where=where)


class VehicleError(SunspinError):
    """A vehicle, or the file that describes it, cannot be used."""


class TelemetryError(SunspinError):
    """A telemetry file or array cannot be used."""


class MotionError(SunspinError):
    """The model cannot compute the requested trajectory."""


class InputError(SunspinError):
    """An argument of a function or command is not valid."""


class OutputError(SunspinError):
    """A result cannot be written to the requested place."""


class Interrupted(SunspinError, KeyboardInterrupt):
    """A long run was stopped by Ctrl-C; the text says what was kept and how to resume."""


def printable(text: str) -> str:
    """Return a text on one line, with control and invisible characters replaced by escapes.

    Texts from files would otherwise reach the terminal, which obeys control characters.
    """
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode("ascii")
        for c in " ".join(text.split())
    )


def sentence(
    what: str, *, got: object = None, do: str | None = None, where: str | None = None
) -> str:
    """Return the one-sentence text of an error: ``where: what (found got); do``.

    `got` is the offending value, shown with at most 120 characters, an empty text as "nothing"; `do` is the advice.
    """
    text = f"{where}: {what}" if where else what
    if got is not None:
        if isinstance(got, str):
            value = got or "nothing"
        elif isinstance(got, date | time):
            value = got.isoformat()  # a TOML date as the file writes it
        else:
            try:
                value = repr(got)
            except ValueError:  # Python refuses to print integers of thousands of digits
                value = "a number too long to print"
        text += f" (found {value if len(value) <= 120 else value[:117] + '...'})"
    if do:
        text += f"; {do}"
    return printable(text)
