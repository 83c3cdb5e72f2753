"""Chunks of rows on a Dask cluster: tasks out, results in; whatever a dead worker had is computed again by Dask.

A local cluster listens on 127.0.0.1 alone and without a dashboard. Dask does not ask who connects: other users of the same
machine could reach its port while it runs.
"""

from __future__ import annotations

import asyncio
import logging
import signal
import time
import uuid
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING, Any

import numpy as np
from distributed import Client, KilledWorker, LocalCluster, WorkerPlugin, as_completed, rpc

from sunspin.base.errors import InputError, sentence
from sunspin.compute.pieces import run_piece

if TYPE_CHECKING:
    from sunspin.compute.pieces import Piece, RowFunction, Values

CHUNKS_PER_THREAD = 4
"""Chunks in flight for each thread of the cluster: enough that none waits for the next, few enough for memory."""

CONNECT_S = 5
"""How long an address is given to answer."""

FIRST_WORKER_S = 60
"""How long a cluster without workers is given to get one."""

SETTLE_S = 2
"""How long what was abandoned is given to be so."""


class Cluster:
    """Chunks as tasks of a Dask cluster."""

    def __init__(self, function: RowFunction, rows: np.ndarray | None, scheduler: Any, n_workers: int) -> None:
        self._function, self._rows = function, rows
        self._scheduler, self._n_workers = scheduler, n_workers
        self._pending: dict[Any, Piece] = {}
        self._stack = ExitStack()
        self.slots: int = 0

    def __enter__(self) -> Cluster:
        with ExitStack() as stack:
            self._client = _connect(self._scheduler, self._n_workers, stack)
            self._completed = as_completed(loop=self._client.loop, with_results=True, raise_errors=False)
            self._key = f"sunspin-{uuid.uuid4().hex}"
            # sent once, as the result of a task: Dask knows how to get it again when the worker that has it dies
            self._shared = self._client.submit(_same, self._function, key=f"{self._key}-function")
            threads: Any = self._client.nthreads()  # a coroutine only where the client is asynchronous, which this is not
            self.slots = CHUNKS_PER_THREAD * max(sum(threads.values()), 1)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *exception: object) -> None:
        with self._stack, suppress(Exception):  # what is abandoned may already be out of reach
            self._client.cancel([*self._pending, self._shared], force=True)
            deadline = time.monotonic() + SETTLE_S
            while not self._completed.is_empty() and time.monotonic() < deadline:
                if self._completed.has_ready():  # results on their way would complain if the connection closed under them
                    next(self._completed)
                else:
                    time.sleep(0.01)

    def in_flight(self) -> int:
        return len(self._pending)

    def submit(self, piece: Piece) -> None:
        rows, place = (None, piece) if self._rows is None else (self._rows[slice(*piece)], (0, piece[1] - piece[0]))
        future = self._client.submit(run_piece, self._shared, rows, place, key=f"{self._key}-{piece[0]}")
        self._pending[future] = piece
        self._completed.add(future)

    def finished(self) -> list[tuple[Piece, Values]]:
        future, values = next(self._completed)
        if future.status == "error":
            _, error, trace = values
            if isinstance(error, KilledWorker):
                raise InputError(
                    sentence(
                        f"a chunk of rows ended {error.allowed_failures + 1} worker processes, perhaps for want of memory",
                        do="use a smaller chunk",
                    )
                )
            raise error.with_traceback(trace)
        if isinstance(values, CancelledError):
            raise InputError(sentence("the Dask scheduler has dropped the work", got=str(self._scheduler), do="run it again"))
        piece = self._pending.pop(future)
        future.release()
        return [(piece, values)]

    def drain(self) -> list[tuple[Piece, Values]]:
        return []  # nothing may be expected of a cluster that the same Ctrl-C has reached


def _same(function: RowFunction) -> RowFunction:
    return function


class _Undisturbed(WorkerPlugin):
    """Lets Ctrl-C, which a terminal sends to all its processes, reach the client alone: it ends the workers in good order."""

    def setup(self, worker: Any) -> None:
        with suppress(ValueError):  # a worker whose loop is not in the main thread gets no signals anyway
            signal.signal(signal.SIGINT, signal.SIG_IGN)


def _connect(scheduler: Any, n_workers: int, stack: ExitStack) -> Client:
    """A client with at least one worker; what is opened for it is closed with the stack."""
    if isinstance(scheduler, Client):
        client = scheduler
    elif scheduler == "local":
        cluster = stack.enter_context(local_cluster(n_workers))
        client = stack.enter_context(Client(cluster, set_as_default=False))
        client.register_plugin(_Undisturbed())
    elif isinstance(scheduler, str) and "://" in scheduler:
        client = stack.enter_context(_client_at(scheduler))
    else:
        raise InputError(
            sentence('scheduler must be "local", an address like tcp://host:8786 or a Dask client', got=str(scheduler))
        )
    try:
        client.wait_for_workers(1, timeout=FIRST_WORKER_S)
    except TimeoutError:
        raise InputError(
            sentence(f"the cluster got no worker within {FIRST_WORKER_S} s", got=str(scheduler), do="start workers")
        ) from None
    return client


def local_cluster(n_workers: int) -> LocalCluster:
    """Worker processes of one thread each on this machine, to be reached from this machine only.

    Their logs are silent: what goes wrong in a row comes back with its result, and a worker whose heartbeat meets a cluster
    that is being closed would print a traceback over the sentence of an interruption.
    """
    # the ports of what would be the dashboards serve none, and are chosen by the system: the usual one may be taken
    quiet = {"dashboard": False, "dashboard_address": "127.0.0.1:0"}
    options: dict[str, Any] = {"dashboard_address": None}  # none is what Dask documents, though it declares text
    return LocalCluster(
        n_workers=n_workers, threads_per_worker=1, processes=True, host="127.0.0.1", **options,
        scheduler_kwargs=quiet, silence_logs=logging.CRITICAL,
    )  # fmt: skip


def _client_at(address: str) -> Client:
    """A client of a running scheduler. The address is asked first: a Client that never connected cannot be closed in peace."""
    try:
        with ThreadPoolExecutor(1) as aside:  # this thread may run an event loop of its own, as notebooks do
            kind = aside.submit(asyncio.run, _kind_at(address)).result()
        if kind != "Scheduler":
            raise ValueError(f"a {kind}")
        return Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(
            sentence(
                f"no Dask scheduler answers at {address}",
                got=str(error) or f"nothing within {CONNECT_S} s",
                do="check the address and that it runs",
            )
        ) from None


async def _kind_at(address: str) -> str:
    """What kind of Dask server listens at the address."""
    async with asyncio.timeout(CONNECT_S), rpc(address, timeout=CONNECT_S) as server:
        identity: Any = await server.identity()
        return identity["type"]
