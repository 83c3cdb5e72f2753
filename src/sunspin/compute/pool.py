"""Threads and processes on the cores of this machine.

Compiled kernels release Python's lock and run in threads (`ThreadPoolExecutor`). Python code runs in a `process_pool`. On Linux
its processes are copies of this one (`fork`), which start immediately with everything imported. But a lock that another thread
holds would stay locked in a copy, so a process with more than one thread is never copied.
"""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Generator
from concurrent.futures import (
    BrokenExecutor,
    Executor,
    InvalidStateError,
    ProcessPoolExecutor,
)
from contextlib import contextmanager
from functools import partial
from multiprocessing import active_children, get_context, parent_process
from typing import Any

from sunspin.base.errors import InputError

KILL_WITH_PARENT = 1
"""Option `PR_SET_PDEATHSIG` of the system call `prctl` of Linux: the signal that a process gets when its parent ends."""


class EndedError(InputError):
    """A process that worked for this one was ended from outside."""

    def __init__(self, *_: str) -> None:  # its text, if it comes from another process
        what = "a worker process was ended from outside, perhaps for lack of memory"
        super().__init__(what, do="free memory or use fewer workers")


def worker_count(workers: int | None) -> int:
    """Return the number of workers: the given one, by default one per core that this process may use."""
    if workers is None and hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return (os.cpu_count() or 1) if workers is None else positive_integer("workers", workers)


def positive_integer(name: str, value: Any) -> int:
    """Return a positive whole number as int; raise `InputError` for any other value."""
    if isinstance(value, bool) or not hasattr(value, "__index__") or value < 1:
        raise InputError(f"{name} must be a positive whole number", got=value)
    return int(value)


def may_fork() -> bool:
    """Return whether this process may be copied: on Linux, as long as it has one thread."""
    return sys.platform == "linux" and threading.active_count() == 1


@contextmanager
def process_pool(workers: int) -> Generator[Executor | None]:
    """Start worker processes for the duration of a `with` block; yield an executor, or None for fewer than two workers.

    If an error leaves the block, the processes are ended at once.
    """
    if workers < 2:
        yield None
        return
    children_before = set(active_children())
    method = "fork" if may_fork() else "spawn"
    pool = ProcessPoolExecutor(workers, get_context(method), prepare_worker)
    print_error = threading.excepthook
    threading.excepthook = partial(_print_unless_cancelled, print_error)
    try:
        # the idle threads of the linear algebra library do no harm: a copy starts its own
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "This process .* is multi-threaded")
            pool.submit(int)  # starts the copies now, before the pool adds a thread to this process
        yield pool
    except BaseException as error:
        for process in set(active_children()) - children_before:
            process.kill()  # right after it was copied Python may lose a request to end
        if not isinstance(error, BrokenExecutor):
            raise
        raise EndedError from None
    finally:
        pool.shutdown(cancel_futures=True)
        threading.excepthook = print_error


def _print_unless_cancelled(print_error: Callable[[Any], Any], error: Any) -> None:
    """Print the error of a thread with `print_error`, but not that a task was cancelled before its worker ended.

    A signal to the whole process group ends the workers too. The thread of the pool then reports this to every task, and before
    Python 3.13 it fails with a traceback at one that was cancelled meanwhile.
    """
    if not issubclass(error.exc_type, InvalidStateError):
        print_error(error)


def prepare_worker() -> None:
    """Set up a new worker process: it ignores Ctrl-C, as its parent ends it, and ends with a parent that is killed."""
    gc.freeze()  # garbage collection would touch, and so copy, the memory shared with the parent
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    # `nohup` lets a run outlast its terminal: a signal of the terminal that the parent ignores is ignored here too
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
    if sys.platform == "linux" and hasattr(signal, "SIGKILL"):
        # A killed parent cannot end its workers, and they would not notice, as each holds both ends of the pipes to the others.
        ctypes.CDLL(None).prctl(KILL_WITH_PARENT, signal.SIGKILL)
        parent = parent_process()
        if parent is not None and os.getppid() != parent.pid:  # it was killed before that
            os._exit(1)
