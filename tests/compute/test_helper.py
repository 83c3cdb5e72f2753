"""The process that works in the background: its answers, errors and end."""

import copyreg
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from multiprocessing import active_children
from multiprocessing.context import ForkProcess
from pathlib import Path
from threading import Lock, Thread, active_count

import pytest

from sunspin.base.errors import InputError
from sunspin.compute import helper as module
from sunspin.compute import pool
from sunspin.compute.helper import helper_process
from sunspin.compute.pool import EndedError, process_pool

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
    """It needs no thread of this process, which may still be copied."""
    before = active_count()
    with helper_process(2, prepare) as helper:
        helper.start(add, 1, 2)
        helper.start(add, "a", "b")
        assert active_count() == before
        assert [helper.result(), helper.result()] == [(3, ["prepared"]), ("ab", ["prepared"])]
    assert not PREPARED  # another process did it


@pytest.fixture
def no_child_stays():
    """Assert that a test leaves no process, and does not take a minute."""
    before, begin = set(active_children()), time.monotonic()
    yield
    assert time.monotonic() - begin < 60 and not set(active_children()) - before


def test_a_helper_at_work_ends_with_the_block_though_its_parent_is_interrupted(no_child_stays):
    with pytest.raises(KeyboardInterrupt), helper_process(2, prepare) as helper:
        helper.start(time.sleep, 1000.0)
        raise KeyboardInterrupt


def test_an_interruption_at_the_start_of_a_helper_ends_it_too(monkeypatch, no_child_stays):
    """It comes when the copy exists and nobody has noted it yet."""
    start, handler = ForkProcess.start, signal.default_int_handler

    def interrupted_start(process):
        start(process)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(ForkProcess, "start", interrupted_start)
    # Python does not install its own handler if whoever started it ignores Ctrl-C
    before = signal.signal(signal.SIGINT, handler)
    try:
        with pytest.raises(KeyboardInterrupt), helper_process(2, prepare):
            pass
        assert signal.getsignal(signal.SIGINT) is handler
    finally:
        signal.signal(signal.SIGINT, before)


def be_deaf(seconds):
    """Work on although asked to end, as a library does that catches every error."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        with suppress(BaseException):
            time.sleep(0.01)


class SlowEnd:
    """An object that takes its time to go; Python cannot raise an error of `__del__`, as of a callback of an import."""

    def __del__(self):
        time.sleep(1000.0)


def end_slowly():
    """Be asked to end where Python ignores the error of that, and work on."""
    SlowEnd()
    time.sleep(1000.0)


@pytest.mark.parametrize(
    ("work", "end_s", "within_s"),
    [
        ((be_deaf, 0.6), module.END_S, 60.0),  # ends after its call
        ((be_deaf, 1000.0), 0.5, 60.0),  # is killed
        ((end_slowly,), module.END_S, module.END_S / 2),  # is asked again
    ],
)
def test_a_helper_that_does_not_heed_the_request_to_end_ends(
    work, end_s, within_s, monkeypatch, capfd, no_child_stays
):
    monkeypatch.setattr(module, "END_S", end_s)
    with helper_process(2, prepare) as helper:
        helper.start(*work)
        time.sleep(0.3)
        begin = time.monotonic()
    assert time.monotonic() - begin < within_s
    assert capfd.readouterr().err == ""


def sleep_in_pool(seconds):
    """Sleep in a process of a pool."""
    with process_pool(2) as workers:
        workers.submit(os.getpid).result()
        workers.submit(time.sleep, seconds).result()


def runs(process_id):
    """Return whether a process exists and has not ended; its parent may not have asked yet how it ended."""
    try:
        return Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def all_end(process_ids, within_s=20.0):
    """Return whether no process runs any more after a time, in seconds; end those that do."""
    end = time.monotonic() + within_s
    while any(map(runs, process_ids)) and time.monotonic() < end:
        time.sleep(0.05)
    running = [process_id for process_id in process_ids if runs(process_id)]
    for process_id in running:
        os.kill(int(process_id), signal.SIGKILL)
    return not running


def two_workers_of(process_id):
    """Return the numbers of the two workers of a process, when both run."""
    children = Path(f"/proc/{process_id}/task/{process_id}/children")
    while len(workers := children.read_text().split()) < 2:
        time.sleep(0.05)
    return workers


def with_sleeping_pool(helper):
    """Let a helper start a pool that sleeps, and return the numbers of its process and of the workers."""
    helper.start(os.getpid)
    process_id = helper.result()
    helper.start(sleep_in_pool, 1000.0)
    return process_id, two_workers_of(process_id)


def test_a_killed_helper_whose_pool_holds_the_pipe_is_reported(monkeypatch):
    monkeypatch.setattr(pool, "KILL_WITH_PARENT", 0)  # no option of the system: the pool stays
    errors = []

    def wait():
        try:
            helper.result()
        except EndedError as error:
            errors.append(error)

    with helper_process(2, prepare) as helper:
        process_id, workers = with_sleeping_pool(helper)
        waiting = Thread(target=wait, daemon=True)
        waiting.start()
        os.kill(process_id, signal.SIGKILL)
        waiting.join(20.0)
        reported = len(errors) == 1
        assert not all_end(workers, within_s=0.0)  # which ends them
    assert reported


PARENT = """
import os
from sunspin.compute.helper import helper_process
from tests.compute.test_helper import sleep_in_pool

with helper_process(2, list) as helper:
    helper.start(os.getpid)
    print(helper.result(), flush=True)
    helper.start(sleep_in_pool, 1000.0)
    helper.result()
"""


def test_a_pool_ends_with_its_helper_and_both_with_a_killed_parent():
    with helper_process(2, prepare) as helper:
        _, workers = with_sleeping_pool(helper)
    assert all_end(workers)
    started = {"stdout": subprocess.PIPE, "text": True, "cwd": Path(__file__).parents[2]}
    with subprocess.Popen([sys.executable, "-c", PARENT], **started) as parent:
        process_id = parent.stdout.readline().strip()
        workers = two_workers_of(process_id)
        parent.kill()
        assert all_end([process_id, *workers])


class TwoPartsError(ValueError):
    """An error of which pickle cannot make a copy."""

    def __init__(self, first, second):
        super().__init__(f"{first} and {second}")


def fail_in_two_parts():
    raise TwoPartsError("a", "b")


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        ((int, "x"), ValueError, "invalid literal"),
        ((Lock,), RuntimeError, "pickle"),
        ((fail_in_two_parts,), RuntimeError, "TwoPartsError: a and b"),
    ],
)
def test_an_error_of_a_call_is_raised_here_and_the_next_one_answered(
    call, error, text, monkeypatch
):
    """Also if its result or its error cannot be sent back."""
    # Dask, which other tests import, may have told pickle how to copy any error
    monkeypatch.delitem(copyreg.dispatch_table, TwoPartsError, raising=False)
    with helper_process(2, prepare) as helper:
        helper.start(*call)
        helper.start(int, "5")
        with pytest.raises(error, match=text):
            helper.result()
        assert helper.result() == 5


def test_a_helper_or_a_worker_of_its_pool_that_was_killed_is_reported_in_one_sentence():
    words = r"ended from outside.*fewer workers"
    with pytest.raises(InputError, match=words), helper_process(2, prepare) as helper:
        helper.start(os.abort)
        helper.result()
    with helper_process(2, prepare) as helper:
        _, workers = with_sleeping_pool(helper)
        os.kill(int(workers[0]), signal.SIGKILL)
        with pytest.raises(EndedError, match=words):
            helper.result()


def test_there_is_no_helper_for_one_worker_or_where_a_process_may_not_be_copied(monkeypatch):
    with helper_process(1, prepare) as helper:
        assert helper is None
    monkeypatch.setattr(module, "may_fork", lambda: False)
    with helper_process(2, prepare) as helper:
        assert helper is None
