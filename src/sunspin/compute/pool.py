"""The cores of this machine.

Compiled kernels release Python's lock: threads serve them (`ThreadPoolExecutor`). Work in Python goes to `processes`. On Linux
these are copies of this process (`fork`), which begin at once with all that it has imported and read; but a lock that another
thread holds would stay locked in a copy, so that a process with more than one thread is never copied.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
import warnings
from collections.abc import Generator
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, get_context
from typing import Any

from sunspin.base.errors import InputError


def worker_count(workers: int | None) -> int:
    """The number of workers to use: as given, else one per core that this process may use."""
    if workers is None and hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return (os.cpu_count() or 1) if workers is None else positive_integer("workers", workers)


def positive_integer(name: str, value: Any) -> int:
    """A positive whole number, or `InputError`."""
    if isinstance(value, bool) or not hasattr(value, "__index__") or value < 1:
        raise InputError(f"{name} must be a positive whole number", got=value)
    return int(value)


def may_fork() -> bool:
    """Whether this process may be copied: on Linux, while it has one thread."""
    return sys.platform == "linux" and threading.active_count() == 1


@contextmanager
def process_pool(workers: int) -> Generator[Executor | None]:
    """Processes as an executor, or None where one suffices. They end with the block, at once if an error leaves it."""
    if workers < 2:
        yield None
        return
    before, method = set(active_children()), "fork" if may_fork() else "spawn"
    pool = ProcessPoolExecutor(workers, get_context(method), _prepare_worker)
    try:
        # the linear algebra's threads stand still and are made again in a copy
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "This process .* is multi-threaded")
            pool.submit(int)  # copies are made now, before the pool has a thread here
        yield pool
    except BaseException as error:
        for process in set(active_children()) - before:
            process.terminate()
        if not isinstance(error, BrokenExecutor):
            raise
        what = "a worker process was ended from outside, perhaps for lack of memory"
        raise InputError(what, do="free memory or use fewer workers") from None
    finally:
        pool.shutdown(cancel_futures=True)


def _prepare_worker() -> None:
    """In a new process, which the process that waits for it ends: Ctrl-C reaches that one alone."""
    gc.freeze()  # to look for garbage among what was copied would copy the memory
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for kind in (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)):
        signal.signal(kind, signal.SIG_DFL)
