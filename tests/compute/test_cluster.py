"""Rows on a Dask cluster: the same result with killed workers, no socket open to other machines, errors in one sentence."""

import asyncio
import gc
import os
import signal
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import sunspin as ss
from sunspin.compute.rows import ensemble
from tests.support.rows import ELSEWHERE, Waves, heed_interrupts, same

distributed = pytest.importorskip(
    "distributed", reason='needs Dask: pip install "sunspin[cluster]"'
)

from sunspin.compute import cluster as dask  # noqa: E402

ROWS = Waves()
WHOLE = ROWS(np.arange(1000))


def whole(rows=ROWS, **options) -> bool:
    """Whether an ensemble gives the rows."""
    return same(ensemble(rows, **options), WHOLE)


@pytest.fixture(scope="module")
def client():
    """Two worker processes, as scheduler="local" starts them."""
    with (
        dask.local_cluster(2) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield client


@pytest.mark.evidence("scan", "verified", "the same rows on two processes of a Dask cluster")
def test_rows_computed_on_a_cluster_equal_those_computed_here(client):
    for chunk in (1000, 33):
        assert whole(scheduler=client, chunk=chunk)
    assert whole(scheduler=client.scheduler.address)
    assert client.status == "running"  # what was not opened here is not closed here


def test_a_local_cluster_computes_the_rows_and_leaves_no_thread():
    before = set(threading.enumerate())
    assert whole(scheduler="local", workers=2, chunk=50)
    added = set(threading.enumerate()) - before
    assert not [thread for thread in added if thread.name.startswith("sunspin")]


def test_a_local_cluster_listens_only_on_this_machine(client):
    pids = {os.getpid(), *client.run(os.getpid).values()}
    files = ((pid, fd) for pid in pids for fd in os.listdir(f"/proc/{pid}/fd"))
    inodes = {os.readlink(f"/proc/{pid}/fd/{fd}") for pid, fd in files if is_socket(pid, fd)}
    addresses = []
    for table in ("tcp", "tcp6"):
        with open(f"/proc/net/{table}") as file:
            for line in list(file)[1:]:
                fields = line.split()
                if fields[3] == "0A" and f"socket:[{fields[9]}]" in inodes:  # 0A: listening
                    addresses.append(fields[1].split(":")[0])
    assert len(addresses) >= 3 and set(addresses) == {"0100007F"}  # 127.0.0.1


def is_socket(pid: int, fd: str) -> bool:
    try:
        return os.readlink(f"/proc/{pid}/fd/{fd}").startswith("socket:")
    except OSError:
        return False


@pytest.mark.evidence("scan", "verified", "a worker killed during the computation")
def test_the_rows_of_a_killed_worker_are_computed_again(client, tmp_path):
    """Result and store, with one of the two processes killed in the middle of the work."""
    log, store = tmp_path / "rows", tmp_path / "store"
    rows = Waves(n_rows=1000, seconds_per_row=0.001, log=str(log))
    victim = next(iter(client.run(os.getpid).values()))

    def kill() -> None:
        while not (log.exists() and log.read_text().count("\n") > 200):
            time.sleep(0.01)
        os.kill(victim, signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        assert whole(rows, scheduler=client, chunk=20, store=store)
    finally:
        log.write_text("\n" * 1000)
        killer.join()
    assert victim not in client.run(os.getpid).values()
    assert whole(store=store)


LONGEST_NEWS_S = 30.0
"""How long the news of a lost result may take; after that the test fails and does not wait for ever."""


def test_no_row_is_lost_if_a_worker_dies_while_sending_its_result(monkeypatch):
    """The result is here and its state is not asked for yet: Dask's own executor takes the state that follows for the outcome."""
    gather, states = distributed.Client._gather, []
    few = {"n_workers": 2, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with (
        distributed.LocalCluster(**few) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):

        async def die_after(self, futures, **options):
            result = await gather(self, futures, **options)
            if not states:
                (task,) = futures
                workers = cluster.workers.values()
                (holder,) = (worker for worker in workers if task.key in worker.data)
                await holder.close()
                until = time.monotonic() + LONGEST_NEWS_S
                while task.status == "finished" and time.monotonic() < until:
                    await asyncio.sleep(0)
                states.append(task.status)
            return result

        monkeypatch.setattr(distributed.Client, "_gather", die_after)
        # longer than the news of a loss takes, on a busy machine too
        rows = Waves(n_rows=1000, seconds_per_row=2e-3)
        assert whole(rows, scheduler=client, chunk=500)
    assert states == ["lost"]


def test_an_exception_of_a_row_reaches_the_caller_of_the_cluster(client):
    with pytest.raises(ArithmeticError, match="row 500 is bad"):
        ensemble(Waves(bad_row=500), scheduler=client, chunk=10)
    assert whole(scheduler=client)


class Deadly(Waves):
    """A row that ends its process."""

    def __call__(self, index):
        os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.long
def test_rows_that_kill_every_worker_are_given_up(client):
    with pytest.raises(ss.InputError, match="smaller chunk"):
        ensemble(Deadly(), scheduler=client)
    client.wait_for_workers(2, timeout=120)
    assert whole(scheduler=client)


@pytest.mark.parametrize("scheduler", ["here", 8786, "tcp://127.0.0.1", "bad://127.0.0.1:1"])
def test_an_address_that_is_no_scheduler_is_refused(scheduler):
    with pytest.raises(ss.InputError, match="scheduler") as said:
        ensemble(ROWS, scheduler=scheduler)
    assert "\n" not in str(said.value)


def test_a_scheduler_that_does_not_answer_is_refused_within_seconds(monkeypatch, client):
    monkeypatch.setattr(dask, "CONNECT_S", 0.5)
    with (
        socket.create_server(("127.0.0.1", 0)) as deaf,
        socket.create_server(("127.0.0.1", 0)) as gone,
    ):
        ports = deaf.getsockname()[1], gone.getsockname()[1]
        gone.close()
        worker = next(iter(client.scheduler_info()["workers"]))
        for address in (*(f"tcp://127.0.0.1:{port}" for port in ports), worker):
            begun, words = time.monotonic(), f"no Dask scheduler with workers answers at {address}"
            with pytest.raises(ss.InputError, match=words):
                ensemble(ROWS, scheduler=address)
            assert time.monotonic() - begun < 2


def test_a_connection_that_another_client_disturbs_is_made_again(monkeypatch, client):
    """Dask's client fails if a message to all clients arrives with the scheduler's first answer.

    A failed client that garbage collection closes while the next one connects would make both wait for ever.
    """
    attempts, thresholds = [], gc.get_threshold()

    class Disturbed(distributed.Client):
        async def _ensure_connected(self, timeout=None):
            attempts.append(self.id)
            if len(attempts) % 2:
                raise AssertionError
            await super()._ensure_connected(timeout)

    monkeypatch.setattr(dask, "Client", Disturbed)
    gc.set_threshold(50, 2, 2)  # collects often: without the collection after a failure it hangs
    try:
        for _ in range(10):
            dask._connect_to_address(client.scheduler.address).close()
        assert whole(scheduler=client.scheduler.address)
    finally:
        gc.set_threshold(*thresholds)
    assert len(attempts) == 22


def test_without_dask_a_cluster_is_refused_with_the_command_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.delitem(sys.modules, "sunspin.compute.cluster")
    monkeypatch.delattr("sunspin.compute.cluster")
    with pytest.raises(ss.InputError, match=r'pip install "sunspin\[cluster\]"'):
        ensemble(ROWS, scheduler="local")


SCRIPT = """
import sys
from tests.support.rows import Waves
from sunspin.base.errors import Interrupted
from sunspin.compute.rows import ensemble
if __name__ == "__main__":
    try:
        ensemble(Waves(seconds_per_row=0.01, log=sys.argv[1]), scheduler="local", workers=2, chunk=10, store=sys.argv[2])
    except Interrupted as stop:
        print(stop)
        sys.exit(130)
"""


@pytest.mark.long
def test_an_interruption_ends_the_processes_of_the_cluster(tmp_path):
    """Ctrl-C as a terminal sends it, to every process of the group."""
    log, store, script = tmp_path / "rows", tmp_path / "store", tmp_path / "run.py"
    script.write_text(SCRIPT)
    command = [sys.executable, str(script), str(log), str(store)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    own = {"env": ELSEWHERE, "start_new_session": True, "preexec_fn": heed_interrupts}
    process = subprocess.Popen(command, **pipes, **own)
    try:
        while process.poll() is None and not (log.exists() and log.read_text().count("\n") > 100):
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGINT)
        said, complaint = process.communicate(timeout=30)
    finally:
        process.kill()
    assert (process.returncode, complaint) == (130, "")
    assert said.count("\n") == 1 and "run the same command again" in said
    assert whole(store=store)
