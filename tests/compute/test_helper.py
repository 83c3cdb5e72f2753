"""The process that works in the background: its answers, errors and end."""

import os
import sys
import time
from contextlib import suppress
from multiprocessing import active_children
from pathlib import Path
from threading import active_count

import pytest

from sunspin.base.errors import InputError
from sunspin.compute import helper as module
from sunspin.compute.helper import helper_process
from sunspin.compute.pool import process_pool

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are copied on Linux")

PREPARED = []


@pytest.fixture(autouse=True)
def one_thread(monkeypatch) -> None:
    """Let this process be copied although other tests, or what runs them, have left idle threads."""
    monkeypatch.setattr(module, "may_fork", lambda: True)


def prepare() -> None:
    """Leave a trace in the process that runs it."""
    PREPARED.append("prepared")


def add(a, b):
    """Return a sum and what was prepared in the process that computes it."""
    return a + b, PREPARED


def test_a_helper_prepares_itself_and_answers_calls_in_their_order():
    with helper_process(2, prepare) as helper:
        helper.start(add, 1, 2)
        helper.start(add, "a", "b")
        assert [helper.result(), helper.result()] == [(3, ["prepared"]), ("ab", ["prepared"])]
    assert not PREPARED  # another process did it


def test_an_error_of_a_call_is_raised_here_and_the_next_call_is_answered():
    with helper_process(2, prepare) as helper:
        helper.start(int, "x")
        helper.start(int, "5")
        with pytest.raises(ValueError, match="invalid literal"):
            helper.result()
        assert helper.result() == 5


def test_a_helper_killed_from_outside_is_reported_in_one_sentence():
    with (
        pytest.raises(InputError, match=r"ended from outside.*fewer workers"),
        helper_process(2, prepare) as helper,
    ):
        helper.start(os.abort)
        helper.result()


def test_a_helper_ends_with_the_block_although_it_works_and_its_parent_is_interrupted():
    before, begin = set(active_children()), time.monotonic()
    with pytest.raises(KeyboardInterrupt), helper_process(2, prepare) as helper:
        helper.start(time.sleep, 1000.0)
        raise KeyboardInterrupt
    assert time.monotonic() - begin < 60 and not set(active_children()) - before


def be_deaf(seconds):
    """Work on although asked to end, as a library does that catches every error."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        with suppress(BaseException):
            time.sleep(0.01)


def test_a_helper_that_catches_the_request_to_end_ends_after_its_call():
    before = set(active_children())
    with helper_process(2, prepare) as helper:
        helper.start(be_deaf, 1.0)
        time.sleep(0.5)
    assert not set(active_children()) - before


def sleep_in_pool(seconds):
    """Sleep in a process of a pool."""
    with process_pool(2) as pool:
        pool.submit(os.getpid).result()
        pool.submit(time.sleep, seconds).result()


def children_of(process_id):
    """Return the ids of the children of a process."""
    return Path(f"/proc/{process_id}/task/{process_id}/children").read_text().split()


def test_a_pool_of_a_helper_ends_with_it():
    with helper_process(2, prepare) as helper:
        helper.start(os.getpid)
        process_id = helper.result()
        helper.start(sleep_in_pool, 1000.0)
        while len(workers := children_of(process_id)) < 2:
            time.sleep(0.05)
    assert not any(Path(f"/proc/{worker}").exists() for worker in workers)


def test_a_helper_needs_no_thread_of_this_process_so_that_it_may_still_be_copied():
    before = active_count()
    with helper_process(2, prepare) as helper:
        helper.start(add, 2, 2)
        assert active_count() == before
        assert helper.result()[0] == 4


def test_there_is_no_helper_for_one_worker_or_where_a_process_may_not_be_copied(monkeypatch):
    with helper_process(1, prepare) as helper:
        assert helper is None
    monkeypatch.setattr(module, "may_fork", lambda: False)
    with helper_process(2, prepare) as helper:
        assert helper is None
