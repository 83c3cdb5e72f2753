"""Processes on this machine: forking only if it is safe, errors and interruptions."""

import os
import signal
import sys
import threading
import time
from concurrent.futures import wait
from multiprocessing import active_children

import pytest

from sunspin.base.errors import InputError
from sunspin.compute.pool import may_fork, process_pool


def test_a_pool_of_one_computes_in_this_process():
    with process_pool(1) as pool:
        assert pool is None


def test_an_exception_in_one_process_ends_all_at_once():
    before, begin = set(active_children()), time.monotonic()
    with pytest.raises(KeyboardInterrupt), process_pool(2) as pool:
        running = pool.submit(time.sleep, 1000.0)
        while not running.running():
            time.sleep(0.05)
        raise KeyboardInterrupt
    assert time.monotonic() - begin < 60 and not set(active_children()) - before


def test_a_process_killed_from_outside_is_reported_in_one_sentence():
    with (
        pytest.raises(InputError, match=r"ended from outside.*fewer workers"),
        process_pool(2) as pool,
    ):
        pool.submit(os.abort).result()


def test_a_task_cancelled_before_its_worker_is_ended_from_outside_prints_no_traceback(monkeypatch):
    """`timeout` and a terminal that closes end the workers at the same moment as this process."""
    errors = []
    monkeypatch.setattr(threading, "excepthook", errors.append)
    with pytest.raises(KeyboardInterrupt), process_pool(2) as pool:
        workers = active_children()
        tasks = [pool.submit(time.sleep, 1000.0) for _ in range(20)]
        assert tasks[-1].cancel()
        for worker in workers:
            worker.kill()
        wait([tasks[0]])
        raise KeyboardInterrupt
    assert not errors


def test_processes_are_not_forked_while_other_threads_run():
    wait = threading.Event()
    other = threading.Thread(target=wait.wait)
    other.start()
    try:
        assert not may_fork()
    finally:
        wait.set()
        other.join()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signal")
@pytest.mark.parametrize(
    ("here", "in_workers"),
    [(signal.SIG_IGN, signal.SIG_IGN), (lambda *_: None, signal.SIG_DFL)],
)
def test_workers_ignore_the_end_of_the_terminal_if_their_parent_does(here, in_workers):
    before = signal.signal(signal.SIGHUP, here)
    try:
        with process_pool(2) as pool:
            assert pool.submit(signal.getsignal, signal.SIGHUP).result() == in_workers
    finally:
        signal.signal(signal.SIGHUP, before)
