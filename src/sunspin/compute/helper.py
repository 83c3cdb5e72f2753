"""A second process that works for this one in the background: what it imports costs no time here.

It is a copy of this process (`fork`), started while this one still has a single thread (:mod:`sunspin.compute.pool`). No thread
waits for its answers, so that this process may still be copied for a pool.
"""

from __future__ import annotations

import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from copy import copy
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from sunspin.compute.pool import EndedError, may_fork, prepare_worker

LOOK_S = 0.5
"""Interval, in seconds, at which a process that waits for its helper looks whether the helper still lives."""

END_S = 5.0
"""Time, in seconds, in which a helper may end itself and its pool; then it is killed, and its pool with it."""

INTERRUPTIONS = {
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
}
"""Signals of Ctrl-C, of a request to end, and of a terminal that is closed."""

AGAIN_S = 0.1
"""Seconds after which a helper that has not ended is asked once more: right after it was copied Python ignores errors."""


class Helper:
    """This process's end of the pipe to its helper, which computes calls one after the other.

    `workers`: processes that a call may use.
    """

    def __init__(self, pipe: Connection, process: BaseProcess, workers: int) -> None:
        self._pipe, self._process, self.workers = pipe, process, workers

    def start(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Let the helper compute a call; function and arguments are pickled. Raise `EndedError` if it was ended from outside."""
        with _ended_helper_reported():
            self._pipe.send((function, arguments))

    def result(self) -> Any:
        """Return the result of the call that was started first, or raise its error; wait until the helper has it.

        Raise `EndedError` if the helper was ended from outside.
        """
        with _ended_helper_reported():
            # The pipe alone would not tell: processes of the helper's own pool hold its other end.
            while not self._pipe.poll(LOOK_S):
                if not self._process.is_alive() and not self._pipe.poll():
                    raise EndedError
            value, error = self._pipe.recv()
        if error is not None:
            raise error
        return value


@contextmanager
def helper_process(workers: int, prepare: Callable[[], Any]) -> Generator[Helper | None]:
    """Start a helper for the duration of a `with` block; yield it, or None for one worker, or if this process may not be copied.

    `prepare` runs first: it imports what the calls will need. At the end of the block the helper is ended at once, also in the
    middle of a call, so it should leave files to this process.
    """
    if workers < 2 or not may_fork():
        yield None
        return
    fork = get_context("fork")
    ours, its = fork.Pipe()
    process = fork.Process(target=_serve, args=(ours, its, prepare))
    try:
        # An interruption waits until the helper is known here: else this process would end without it, or wait for it forever.
        with _interruptions_deferred(), warnings.catch_warnings():
            # the idle threads of the linear algebra library do no harm
            warnings.filterwarnings("ignore", "This process .* is multi-threaded")
            process.start()
        its.close()
        yield Helper(ours, process, workers)
    finally:
        ours.close()  # ends it at the latest after its call, even if a library catches the error of the signal
        end = time.monotonic() + END_S
        while process.is_alive():
            if time.monotonic() < end:
                process.terminate()
            else:
                process.kill()
            process.join(AGAIN_S)


def _serve(parents: Connection, own: Connection, prepare: Callable[[], Any]) -> None:
    """Compute calls and send value and error (one of them None) of each, until the parent ends."""
    prepare_worker()
    signal.signal(signal.SIGTERM, _end)
    sys.unraisablehook = _report_unraisable
    parents.close()  # else the pipe would stay open without the parent
    with suppress(Exception):  # a call that needs it will fail too, and say why
        prepare()
    with suppress(EOFError, OSError):  # the parent has ended
        while True:
            function, arguments = own.recv()
            value, error = None, None
            try:
                value = function(*arguments)
            except Exception as failure:
                failure.add_note("".join(traceback.format_exception(failure)))
                error = failure
            _answer(own, value, error)


def _answer(own: Connection, value: Any, error: Exception | None) -> None:
    """Send value and error; if one of them cannot be sent or restored, a `RuntimeError` with the reason instead."""
    try:
        copy(error)  # fails where restoring it at the other end would
        own.send((value, error))
    except Exception as failure:
        text = "".join(traceback.format_exception(error or failure))
        own.send((None, RuntimeError(text)))


def _end(*_: Any) -> None:
    """Handle the request to end by an error, which ends a pool of this process too; further requests do not disturb that."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.exit()


def _report_unraisable(unraisable: Any) -> None:
    """Report an error that Python cannot raise, as in a callback during an import.

    If it was the error of a request to end, the next request is heeded; they come every `AGAIN_S`.
    """
    if isinstance(unraisable.exc_value, SystemExit):
        signal.signal(signal.SIGTERM, _end)
    else:
        sys.__unraisablehook__(unraisable)


@contextmanager
def _interruptions_deferred() -> Generator[None]:
    """Handle the signals of an interruption only at the end of the block, where Python handles them.

    A signal mask would not do: the system gives a signal to any thread, also to those of the linear algebra library.
    """
    arrived: list[int] = []
    handlers = {kind: signal.getsignal(kind) for kind in INTERRUPTIONS}
    deferred = {kind: handler for kind, handler in handlers.items() if callable(handler)}
    for kind in deferred:
        signal.signal(kind, lambda number, _: arrived.append(number))
    try:
        yield
    finally:
        for kind, handler in deferred.items():
            signal.signal(kind, handler)
        for number in arrived[:1]:
            signal.raise_signal(number)


@contextmanager
def _ended_helper_reported() -> Generator[None]:
    """Turn the error of a pipe whose other end is gone into an `EndedError`."""
    try:
        yield
    except (EOFError, BrokenPipeError, ConnectionResetError):
        raise EndedError from None
