"""Computation of rows on a Dask cluster, through Dask's own client.

A local cluster listens on 127.0.0.1 only, without a dashboard. Dask does not authenticate: other users of the same machine can
connect.
"""

from __future__ import annotations

import asyncio
import gc
import logging
import signal
from collections.abc import Generator, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from itertools import islice
from operator import call
from typing import TYPE_CHECKING, Any

import dask.config
import numpy as np
from distributed import Client, KilledWorker, LocalCluster, WorkerPlugin, as_completed, rpc

from sunspin.base.errors import InputError

if TYPE_CHECKING:
    from sunspin.compute.rows import RowFunction, Values

IN_FLIGHT = 4
"""Chunks in flight per thread of the cluster: enough that no thread waits, few enough for memory."""

CONNECT_S, FIRST_WORKER_S, RESTART_S = 5, 60, 300
"""Time limits: answer of an address, first worker of a cluster, restart of a worker that died.
Dask looks once, 15 s after each death; a second death at that moment would end the worker for good."""

CONNECT_ATTEMPTS = 10
"""Attempts to connect to a scheduler: 13 of 60 failed while another client cancelled tasks without a pause."""


def compute_on_cluster(
    function: RowFunction, chunks: Iterator[slice], scheduler: Any, n_workers: int
) -> Generator[tuple[slice, Values]]:
    """Yield each chunk of rows with its results as it is finished; chunks of a dead worker are computed again.

    `scheduler` and `n_workers` are those of :func:`sunspin.compute.rows.ensemble`. Raises `InputError` if the cluster cannot be
    used.
    """
    with ExitStack() as stack:
        client = _connect(scheduler, n_workers, stack)
        # sent once, as the result of a task, so that Dask can restore it if the worker that holds it dies
        remote_function = client.submit(lambda: function, pure=False)
        running, finished = dict[Any, slice](), as_completed(loop=client.loop)
        threads: Any = client.nthreads()  # no coroutine, as the client is not asynchronous
        free_slots = IN_FLIGHT * max(sum(threads.values()), 1)
        try:
            while True:
                for rows in islice(chunks, free_slots):
                    index = np.arange(rows.start, rows.stop)
                    # one retry, as a machine may be short of memory or disk for a moment
                    task = client.submit(call, remote_function, index, retries=1, pure=False)
                    running[task] = rows
                    finished.add(task)
                if not running:
                    return
                task = next(finished)
                yield running.pop(task), task.result()  # waits again if the result was lost
                free_slots = 1
        except (KilledWorker, CancelledError) as error:
            what = "the cluster has dropped a chunk of rows, perhaps as its workers ended for lack of memory"
            raise InputError(what, got=str(error), do="use a smaller chunk") from None
        finally:
            with suppress(Exception):  # the scheduler may be unreachable by now
                client.cancel([remote_function, *running])


class _IgnoreInterrupt(WorkerPlugin):
    """Plugin by which workers ignore Ctrl-C, which a terminal sends to all its processes.

    The client handles the interruption and ends the workers in order.
    """

    def setup(self, worker: Any) -> None:
        """Ignore the interrupt signal in a worker process."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _connect(scheduler: Any, n_workers: int, stack: ExitStack) -> Client:
    """Return a client with at least one worker; everything opened for it is closed with the stack.

    `scheduler` is a client, "local" for `n_workers` processes on this machine, or an address. Raises `InputError` if no scheduler
    with workers answers.
    """
    try:
        if isinstance(scheduler, Client):
            client = scheduler
        elif scheduler == "local":
            cluster = stack.enter_context(local_cluster(n_workers))
            client = stack.enter_context(Client(cluster, set_as_default=False))
            client.register_plugin(_IgnoreInterrupt())
        else:
            # tested before, as closing a Client that never connected raises errors; in a thread of its own, as a notebook
            # already runs an event loop in this one
            with ThreadPoolExecutor(1) as thread:
                kind = thread.submit(asyncio.run, _server_type(str(scheduler))).result()
            if kind != "Scheduler":
                raise ValueError(f"a {kind}")
            client = stack.enter_context(_connect_to_address(scheduler))
        client.wait_for_workers(1, timeout=FIRST_WORKER_S)
    except (OSError, ValueError, TimeoutError) as error:
        what = f"no Dask scheduler with workers answers at {scheduler}"
        do = 'start it, or give "local", an address like tcp://host:8786 or a Dask client'
        raise InputError(what, got=str(error) or "no answer", do=do) from None
    return client


def _connect_to_address(address: Any) -> Client:
    """Return a client that is connected to a scheduler; `TimeoutError` if no attempt connects.

    A scheduler sends all its clients the tasks that were cancelled. If this message arrives together with the first answer to a new
    client, Dask's client fails with `AssertionError` (version 2026.8, `Client._ensure_connected`); it can connect a moment later.
    """
    for _ in range(CONNECT_ATTEMPTS):
        with suppress(AssertionError):
            return Client(address, set_as_default=False)
        # closes the client that failed; left to a later collection, it may be closed while another client takes the lock that
        # closing needs, and both wait for ever
        gc.collect()
    raise TimeoutError(f"{CONNECT_ATTEMPTS} attempts to connect failed")


async def _server_type(address: str) -> str:
    """Return the type of the Dask server that listens at an address, such as "Scheduler"."""
    async with asyncio.timeout(CONNECT_S), rpc(address, timeout=CONNECT_S) as server:
        identity: Any = await server.identity()
        return identity["type"]


@contextmanager
def local_cluster(n_workers: int) -> Generator[LocalCluster]:
    """Start worker processes with one thread each on this machine, for the duration of a `with` block.

    Workers write no log: errors in a row are returned with its result, and a worker that loses its cluster would print a
    traceback over the message of an interruption.
    """
    options: dict[str, Any] = {  # no dashboard, a free port
        "host": "127.0.0.1",
        "dashboard_address": None,
        "scheduler_kwargs": {"dashboard": False, "dashboard_address": "127.0.0.1:0"},
        "silence_logs": logging.CRITICAL,
    }
    restart = dask.config.set({"distributed.deploy.lost-worker-timeout": f"{RESTART_S} s"})
    with restart, LocalCluster(n_workers=n_workers, threads_per_worker=1, **options) as cluster:
        yield cluster
