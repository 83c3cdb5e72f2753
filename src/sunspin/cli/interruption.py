"""Ctrl-C and requests to end: an exception that reaches :func:`sunspin.cli.main`, even if a library swallows the first one."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import weakref
from functools import partial
from typing import Any

AGAIN_S = 0.5
"""Seconds after which an interruption that a library has swallowed is raised again."""

WAIT_S = 1.0
"""Seconds that threads get to end after an interruption; chunks of a scan take up to half a minute."""

THREADS = "sunspin"
"""Beginning of the names of threads that compute rows (:mod:`sunspin.compute.rows`)."""

STOPPED = threading.Event()
"""Set once a signal has asked the process to end."""


class Stop(KeyboardInterrupt):
    """An interruption by a signal.

    It is not `KeyboardInterrupt` itself: if that leaves code compiled from a text, as of a dataclass, Python ends by the signal.
    Then the exit code is lost, even if the error was caught.
    """


def catch_signals() -> None:
    """Make signals that would end the process raise `Stop`, so that worker processes are ended too.

    A signal that is ignored, as SIGHUP under nohup, stays ignored. Only the main thread can set handlers. An interruption of an
    earlier command in the same process is forgotten.
    """
    STOPPED.clear()
    if threading.current_thread() is not threading.main_thread():
        return
    for number in (signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)):
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, stop)
    sys.unraisablehook = _report_unraisable


def stop(*_: object) -> None:
    """Handle a signal: remember it, and raise `Stop`; raise another one if a library has swallowed it."""
    STOPPED.set()
    error = Stop()
    _set_alarm(AGAIN_S, partial(_stop_again, weakref.ref(error)))
    try:
        raise error
    finally:
        del error  # the traceback has this frame, which would keep the error alive


def _stop_again(error: weakref.ref[Stop], *_: object) -> None:
    """Handle an alarm after an interruption: raise another one, unless the first is still on its way."""
    if error() is None:
        stop()


def accept_interruption() -> None:
    """Raise no interruption again: the work that follows keeps what the command has, or ends the process."""
    _set_alarm(0.0)


def _set_alarm(every_s: float, handler: Any = None) -> None:
    """Call a handler every so many seconds, never for 0; without effect on Windows, which has no alarms.

    An alarm is repeated because one that comes just before a call that waits is handled only after that call.
    """
    kinds = hasattr(signal, "SIGALRM"), hasattr(signal, "setitimer"), hasattr(signal, "ITIMER_REAL")
    if all(kinds):
        if every_s:
            signal.signal(signal.SIGALRM, handler)
        signal.setitimer(signal.ITIMER_REAL, every_s, every_s)


def end_with_threads(code: int) -> None:
    """End the process with an exit code if threads of this package still compute after `WAIT_S`; else return.

    A compiled loop cannot be interrupted, and Python would wait for its thread. Nothing that such threads compute is kept.
    """
    end = time.monotonic() + WAIT_S
    threads = [one for one in threading.enumerate() if one.name.startswith(THREADS)]
    for thread in threads:
        thread.join(max(0.0, end - time.monotonic()))
    if any(thread.is_alive() for thread in threads):
        os._exit(code)


def _report_unraisable(unraisable: Any) -> None:
    """Report an error that Python cannot raise, as in a callback of a C library; not `Stop`, which is raised again."""
    if not isinstance(unraisable.exc_value, Stop):
        sys.__unraisablehook__(unraisable)
