"""Rows on a Dask cluster, through Dask's own client.

A local cluster listens on 127.0.0.1 alone, without a dashboard; Dask does not ask which user of this machine connects.
"""

from __future__ import annotations

import asyncio
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
"""Chunks in flight for each thread of the cluster: enough that none waits for the next, few enough for memory."""

CONNECT_S, FIRST_WORKER_S, RESTART_S = 5, 60, 300
"""How long an address has to answer, a cluster to get its first worker, and a worker that died to be there again: Dask looks
once, 15 s after each death, and a second death at that moment would end the worker for good."""


def compute_on_cluster(
    function: RowFunction, chunks: Iterator[slice], scheduler: Any, n_workers: int
) -> Generator[tuple[slice, Values]]:
    """Each chunk of rows with its results, as they are finished; what a dead worker had is computed again."""
    with ExitStack() as stack:
        client = _connect(scheduler, n_workers, stack)
        # sent once, as the result of a task: Dask gets it again when the worker that has it dies
        shared = client.submit(lambda: function, pure=False)
        running, finished = dict[Any, slice](), as_completed(loop=client.loop)
        threads: Any = client.nthreads()  # no coroutine, as the client is not asynchronous
        free = IN_FLIGHT * max(sum(threads.values()), 1)
        try:
            while True:
                for rows in islice(chunks, free):
                    index = np.arange(rows.start, rows.stop)
                    # once more if it fails: a machine may be short of memory or disk for a moment
                    task = client.submit(call, shared, index, retries=1, pure=False)
                    running[task] = rows
                    finished.add(task)
                if not running:
                    return
                task, free = next(finished), 1
                yield running.pop(task), task.result()  # waited for anew if it is lost by now
        except (KilledWorker, CancelledError) as error:
            what = "the cluster has dropped a chunk of rows, perhaps as its workers ended for lack of memory"
            raise InputError(what, got=str(error), do="use a smaller chunk") from None
        finally:
            with suppress(Exception):  # they may already be out of reach
                client.cancel([shared, *running])


class _IgnoreInterrupt(WorkerPlugin):
    """Lets Ctrl-C, which a terminal sends to all its processes, reach the client alone: it ends the workers in good order."""

    def setup(self, worker: Any) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _connect(scheduler: Any, n_workers: int, stack: ExitStack) -> Client:
    """A client with at least one worker; what is opened for it is closed with the stack."""
    try:
        if isinstance(scheduler, Client):
            client = scheduler
        elif scheduler == "local":
            cluster = stack.enter_context(local_cluster(n_workers))
            client = stack.enter_context(Client(cluster, set_as_default=False))
            client.register_plugin(_IgnoreInterrupt())
        else:  # asked first, as a Client that never connected cannot be closed in peace
            with ThreadPoolExecutor(1) as aside:  # a notebook runs an event loop in this thread
                kind = aside.submit(asyncio.run, _server_type(str(scheduler))).result()
            if kind != "Scheduler":
                raise ValueError(f"a {kind}")
            client = stack.enter_context(Client(scheduler, set_as_default=False))
        client.wait_for_workers(1, timeout=FIRST_WORKER_S)
    except (OSError, ValueError, TimeoutError) as error:
        what = f"no Dask scheduler with workers answers at {scheduler}"
        do = 'start it, or give "local", an address like tcp://host:8786 or a Dask client'
        raise InputError(what, got=str(error) or "no answer", do=do) from None
    return client


async def _server_type(address: str) -> str:
    """What kind of Dask server listens at the address."""
    async with asyncio.timeout(CONNECT_S), rpc(address, timeout=CONNECT_S) as server:
        identity: Any = await server.identity()
        return identity["type"]


@contextmanager
def local_cluster(n_workers: int) -> Generator[LocalCluster]:
    """Worker processes of one thread each. They are silent: what goes wrong in a row comes back with its result, and a worker
    that finds its cluster closed would print a traceback over the sentence of an interruption."""
    options: dict[str, Any] = {  # no pages, a port of the system's choice
        "host": "127.0.0.1",
        "dashboard_address": None,
        "scheduler_kwargs": {"dashboard": False, "dashboard_address": "127.0.0.1:0"},
        "silence_logs": logging.CRITICAL,
    }
    lost = dask.config.set({"distributed.deploy.lost-worker-timeout": f"{RESTART_S} s"})
    with lost, LocalCluster(n_workers=n_workers, threads_per_worker=1, **options) as cluster:
        yield cluster
