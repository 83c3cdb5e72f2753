"""A Dask cluster as an executor of pieces of rows; whatever a dead worker had is computed again by Dask.

A local cluster listens on 127.0.0.1 alone and without a dashboard. Dask does not ask who connects: other users of the same
machine could reach its port while it runs.
"""

from __future__ import annotations

import asyncio
import logging
import signal
from collections.abc import Generator, Iterable
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from typing import TYPE_CHECKING, Any
from weakref import WeakSet

import dask.config
from distributed import Client, KilledWorker, LocalCluster, WorkerPlugin, rpc

from sunspin.base.errors import InputError, sentence
from sunspin.compute.pieces import Place

if TYPE_CHECKING:
    from sunspin.compute.pieces import RowFunction

CHUNKS_PER_THREAD = 4
"""Chunks in flight for each thread of the cluster: enough that none waits for the next, few enough for memory."""

CONNECT_S = 5
"""How long an address is given to answer."""

FIRST_WORKER_S = 60
"""How long a cluster without workers is given to get one."""

RESTART_S = 300
"""How long a worker process that died is given to be there again. Dask looks once, 15 s after each death: a second death at that
moment would end the worker for good."""

SETTLE_S = 2
"""How long what was abandoned is given to be so."""


@contextmanager
def on_cluster(function: RowFunction, scheduler: Any, n_workers: int) -> Generator[Place]:
    """A Dask cluster as a place for pieces; what is opened for it is closed with it."""
    with ExitStack() as stack:
        client = _connect(scheduler, n_workers, stack)
        # sent once, as the result of a task: Dask knows how to get it again when the worker that has it dies
        shared = client.submit(_same, function, pure=False)
        executor = _Tasks(client)
        threads: Any = (
            client.nthreads()
        )  # a coroutine only where the client is asynchronous, which this is not

        def abandon(futures: Iterable[Future]) -> list[Future]:
            with suppress(Exception):  # they may already be out of reach
                executor.shutdown(wait=False)
                wait(
                    futures, SETTLE_S
                )  # results on their way would complain if the connection closed under them
            return []  # nothing may be expected of a cluster that the same Ctrl-C has reached

        try:
            yield Place(
                executor, CHUNKS_PER_THREAD * max(sum(threads.values()), 1), shared, abandon
            )
        except KilledWorker as error:
            raise InputError(
                sentence(
                    f"a chunk of rows ended {error.allowed_failures + 1} worker processes, perhaps for want of memory",
                    do="use a smaller chunk",
                )
            ) from None
        except CancelledError:
            raise InputError(
                sentence(
                    "the Dask scheduler has dropped the work", got=str(scheduler), do="run it again"
                )
            ) from None
        finally:
            with suppress(Exception):
                shared.cancel()


class _Tasks(Executor):
    """The cluster as an executor.

    Dask has one as well, which waits for the result of a task and then asks for its state: if the worker that holds the result dies
    between the two, neither result nor error is handed on, although Dask computes the task again.
    """

    def __init__(self, client: Client) -> None:
        self._client: Client = client
        self._waited_for: WeakSet[Any] = WeakSet()

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future:
        task, future = self._client.submit(fn, *args, pure=False, **kwargs), Future()
        self._waited_for.add(task)
        task.add_done_callback(partial(_hand_on, future))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Give up what has not ended, whatever is asked: nothing may be expected of a cluster any more."""
        self._client.cancel(list(self._waited_for))


def _hand_on(future: Future, task: Any) -> None:
    """The outcome of a task that has ended; one whose result is lost by now is waited for again."""
    try:
        future.set_result(task.result())
    except BaseException as error:
        future.set_exception(error)


def _same(function: RowFunction) -> RowFunction:
    return function


class _Undisturbed(WorkerPlugin):
    """Lets Ctrl-C, which a terminal sends to all its processes, reach the client alone: it ends the workers in good order."""

    def setup(self, worker: Any) -> None:
        with suppress(
            ValueError
        ):  # a worker whose loop is not in the main thread gets no signals anyway
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
            sentence(
                'scheduler must be "local", an address like tcp://host:8786, a Dask client or an executor',
                got=str(scheduler),
            )
        )
    try:
        client.wait_for_workers(1, timeout=FIRST_WORKER_S)
    except TimeoutError:
        raise InputError(
            sentence(
                f"the cluster got no worker within {FIRST_WORKER_S} s",
                got=str(scheduler),
                do="start workers",
            )
        ) from None
    return client


@contextmanager
def local_cluster(n_workers: int) -> Generator[LocalCluster]:
    """Worker processes of one thread each on this machine, to be reached from this machine only.

    Their logs are silent: what goes wrong in a row comes back with its result, and a worker whose heartbeat meets a cluster
    that is being closed would print a traceback over the sentence of an interruption.
    """
    # the ports of what would be the dashboards serve none, and are chosen by the system: the usual one may be taken
    quiet = {"dashboard": False, "dashboard_address": "127.0.0.1:0"}
    options: dict[str, Any] = {
        "dashboard_address": None
    }  # none is what Dask documents, though it declares text
    with dask.config.set({"distributed.deploy.lost-worker-timeout": f"{RESTART_S} s"}):
        cluster = LocalCluster(
            n_workers=n_workers,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            **options,
            scheduler_kwargs=quiet,
            silence_logs=logging.CRITICAL,
        )
        try:
            yield cluster
        finally:
            cluster.close()


def _client_at(address: str) -> Client:
    """A client of a running scheduler. The address is asked first: a Client that never connected cannot be closed in peace."""
    try:
        with ThreadPoolExecutor(
            1
        ) as aside:  # this thread may run an event loop of its own, as notebooks do
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
