"""Copies of this process (`fork`): they begin at once, with all that it has imported and read.

Only where that is safe. A copy has one thread: a lock that another thread held would be locked in it for good.
"""

from __future__ import annotations

import gc
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any

from sunspin.compute.rows import worker_count


def may_copy() -> bool:
    """Whether this process may be copied: on Linux, while it has no other thread."""
    return sys.platform == "linux" and threading.active_count() == 1


@contextmanager
def copying() -> Generator[None]:
    """While copies are made: Python warns of the linear algebra's threads, which stand still and are made anew in a copy.

    What there is by now is no garbage: a copy that looked for some would have to copy all memory.
    """
    gc.freeze()
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings(
                "ignore", "This process .* is multi-threaded", DeprecationWarning
            )
            yield
    finally:
        gc.unfreeze()


def deaf() -> None:
    """In a copy: Ctrl-C reaches the process that waits for it, which then ends it, at once and without a word."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for kind in (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)):
        signal.signal(kind, signal.SIG_DFL)


def at_once(works: Sequence[Callable[[], Any]]) -> list[Any]:
    """What each of these gives, and what it leaves in files, done on as many cores as there are; the first in this process.

    What fails in a copy is done again here, where its error is seen.
    """
    count = max(1, min(worker_count(None), len(works)) if may_copy() else 1)
    shares = [works[k::count] for k in range(count)]
    found: list[Any] = [None] * len(works)
    copies: list[tuple[Any, Any]] = []
    with copying():
        for share in shares[1:]:
            here, there = get_context("fork").Pipe(duplex=False)
            copy = get_context("fork").Process(target=_in_copy, args=(share, there), daemon=True)
            copy.start()
            there.close()
            copies.append((copy, here))
    found[::count] = _all(shares[0])
    for k, (copy, here) in enumerate(copies, 1):
        with here:
            try:
                found[k::count] = here.recv()
            except (
                EOFError,
                OSError,
            ):  # it failed, or was ended from outside, perhaps while it told
                found[k::count] = _all(shares[k])
        copy.join()
    return found


def _all(works: Sequence[Callable[[], Any]]) -> list[Any]:
    return [work() for work in works]


def _in_copy(works: Sequence[Callable[[], Any]], to: Any) -> None:
    deaf()
    try:
        to.send(_all(works))
    except Exception:
        sys.exit(1)  # without a word: it is done again where that can be handled
