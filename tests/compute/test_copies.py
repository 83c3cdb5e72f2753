"""Work shared among copies of this process: all of it is done, in copies where that is safe, and errors are seen here."""

import gc
import subprocess
import sys
import threading

import pytest

from sunspin.compute import copies

WORK = """
import os, sys, threading, time
from multiprocessing import active_children
from pathlib import Path
from sunspin.compute import copies
copies.worker_count = lambda _: 2
folder, here = Path(sys.argv[1]), os.getpid()
def note(name):
    (folder / name).write_text(str(os.getpid() == here))
def only_here():
    if os.getpid() != here:
        raise OSError("a copy cannot do this")
    note("again")
    return "here"
assert copies.at_once([lambda: note("first"), lambda: note("second"), lambda: note("third") or 3]) == [None, None, 3]
assert copies.at_once([int, only_here, lambda: 2, lambda: 3]) == [0, "here", 2, 3]
assert copies.at_once([int, threading.Lock])[1].acquire()  # which no copy can hand over
assert copies.at_once([]) == []
def ended():
    time.sleep(0.5)  # by then the copy is telling more than a pipe holds
    active_children()[0].kill()
assert copies.at_once([ended, lambda: b"x" * 10**7]) == [None, b"x" * 10**7]
threading.Thread(target=threading.Event().wait, daemon=True).start()
copies.at_once([lambda: note("fourth"), lambda: note("fifth")])
"""


@pytest.mark.skipif(sys.platform != "linux", reason="processes are copied on Linux alone")
def test_work_is_shared_with_a_copy_and_done_here_where_that_fails_or_is_not_safe(tmp_path):
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", WORK, str(tmp_path)], capture_output=True, text=True
    )
    assert done.returncode == 0 and not done.stdout + done.stderr
    where = {file.name: file.read_text() for file in tmp_path.iterdir()}
    expected = {
        "first": "True",
        "second": "False",
        "third": "True",
        "again": "True",
        "fourth": "True",
        "fifth": "True",
    }
    assert where == expected


def test_an_error_is_raised_here():
    def fails():
        raise OSError("no room")

    with pytest.raises(OSError, match="no room"):
        copies.at_once([int, fails])


def test_no_copy_beside_other_threads():
    wait = threading.Event()
    other = threading.Thread(target=wait.wait)
    other.start()
    try:
        assert not copies.may_copy()
    finally:
        wait.set()
        other.join()


def test_garbage_is_collected_again_where_a_copy_could_not_be_made():
    before = gc.get_freeze_count()
    with pytest.raises(OSError, match="no room"), copies.copying():
        raise OSError("no room for another process")
    assert gc.get_freeze_count() == before
