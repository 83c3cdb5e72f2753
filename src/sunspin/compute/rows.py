"""Many rows: a pure function of row numbers, computed in chunks by threads or a cluster, kept on disk if wanted.

The kernels release Python's lock, so that threads are enough on one machine. Only the calling thread writes the result: memory
is the result and the chunks in flight. A row is the same to 1e-9 for any chunks, workers and machines, resumed or not.
"""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, closing
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from tqdm import tqdm

from sunspin.base.errors import InputError, Interrupted
from sunspin.compute.pool import positive_integer, worker_count
from sunspin.compute.store import open_store

Values = dict[str, np.ndarray]

CHUNK = 8192
"""Rows per chunk: large against a block of lanes (little padding), small against a second of work."""

MIN_CHUNK = 64
"""Chunks are not made smaller than this so that all workers have one: two blocks of lanes."""

IN_FLIGHT = 2
"""Chunks in flight for each thread: the next one is there when one ends."""

MEMORY_SHARE = 0.5
"""Of the machine's memory that results may take."""


class RowFunction(Protocol):
    """A pure function of row numbers, called by several threads at once.

    A frozen dataclass of plain data, on whose fields its rows depend (:func:`sunspin.compute.identity.to_json`). It is sent to
    other processes and compiles there what it needs. `outputs`: name of each result -> its dtype (numbers or truth values)
    and its shape beyond the rows. Called with row numbers (n), it returns each of them with shape (n, ...).
    """

    @property
    def n_rows(self) -> int: ...
    @property
    def outputs(self) -> Mapping[str, tuple[str, tuple[int, ...]]]: ...
    def __call__(self, index: np.ndarray) -> Values: ...


def ensemble(
    function: RowFunction,
    *,
    workers: int | None = None,
    chunk: int = CHUNK,
    store: str | Path | None = None,
    scheduler: Any = None,
    progress: bool = False,
    label: str = "rows",
) -> Values:
    """All rows of a function: a dict of arrays, each (n_rows, ...).

    Parameters
    ----------
    workers : int, optional
        Threads on this machine, or worker processes of a "local" cluster; default one per core.
    chunk : int
        Rows per call of the function, at most. An interruption costs the chunks in flight.
    store : path, optional
        A folder, new or empty, in which finished chunks are kept: the same call resumes there after any interruption, be it
        kill -9 or a power failure; once complete it is simply read.
    scheduler : "local", address, dask.distributed.Client or concurrent.futures.Executor, optional
        An executor computes the rows and is not shut down. Else run on a Dask cluster: "local" starts worker processes on this
        machine (the script that asks for it needs `if __name__ == "__main__":`), "tcp://host:port" uses a running cluster
        whose workers have sunspin installed.
    progress : bool
        Show a progress bar on a terminal, called `label`.

    Raises
    ------
    InputError
        Arguments that make no sense, a store of other inputs, a cluster that does not answer.
    Interrupted
        After Ctrl-C; its text says what was kept. Whatever the function raises comes through at once.
    """
    n_workers, chunk, n_rows = (
        worker_count(workers),
        positive_integer("chunk", chunk),
        function.n_rows,
    )
    cluster = scheduler is not None and not isinstance(scheduler, Executor)
    if cluster and find_spec("distributed") is None:
        what = "a scheduler needs Dask, which is not installed"
        raise InputError(what, do='pip install "sunspin[cluster]"')
    outputs = function.outputs.items()
    size = n_rows * sum(np.dtype(kind).itemsize * int(np.prod(s)) for _, (kind, s) in outputs)
    if hasattr(os, "sysconf"):
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        if size > MEMORY_SHARE * memory:
            what = f"the results of {n_rows:.3g} rows would take {size / 1e9:.2g} GB of memory"
            got = f"a machine with {memory / 1e9:.2g} GB"
            raise InputError(what, got=got, do="ask for fewer rows")
    out = {name: np.zeros((n_rows, *shape), kind) for name, (kind, shape) in outputs}
    chunk = min(chunk, max(MIN_CHUNK, -(-n_rows // n_workers)))
    chunks = (slice(k, min(k + chunk, n_rows)) for k in range(0, n_rows, chunk))
    save, done = None, 0
    bar: dict[str, Any] = {"desc": label, "unit": "row", "unit_scale": True, "leave": False}
    bar["disable"] = None if progress else True  # None: shown on a terminal only
    try:
        with ExitStack() as stack:
            if store is not None and n_rows:
                save, missing = stack.enter_context(open_store(store, function, chunk, out))
                chunks, done = iter(missing), n_rows - sum(c.stop - c.start for c in missing)
            shown = stack.enter_context(tqdm(total=n_rows, initial=done, **bar))
            if not cluster or done == n_rows:
                executor = None if cluster else scheduler
                computed = _compute_on_executor(function, chunks, executor, n_workers)
            else:
                from sunspin.compute.cluster import compute_on_cluster

                computed = compute_on_cluster(function, chunks, scheduler, n_workers)
            for rows, values in stack.enter_context(closing(computed)):
                given = {name: (v.dtype.str, v.shape) for name, v in values.items()}
                wanted = {name: (v.dtype.str, v[rows].shape) for name, v in out.items()}
                if given != wanted:
                    what = f"the row function must return {wanted}"
                    raise InputError(what, got=str(given))
                for name, array in values.items():
                    out[name][rows] = array
                if save is not None:
                    save(rows)
                done += rows.stop - rows.start
                shown.update(rows.stop - rows.start)
    except KeyboardInterrupt:
        what = f"interrupted, {done} of {n_rows} rows are done and kept in {store}"
        do = "run the same command again to resume"
        if store is None:
            what = f"interrupted after {done} of {n_rows} rows, of which nothing is kept without a store"
            do = "give one to be able to resume"
        raise Interrupted(what, do=do) from None
    return out


def _compute_on_executor(
    function: RowFunction, chunks: Iterator[slice], executor: Executor | None, n_workers: int
) -> Generator[tuple[slice, Values]]:
    """Each chunk of rows with its results, as an executor finishes them; without one threads of this process do."""
    pool = executor or ThreadPoolExecutor(n_workers, "sunspin")
    running = dict[Future[Values], slice]()
    try:
        while True:
            for rows in islice(chunks, IN_FLIGHT * n_workers - len(running)):
                running[pool.submit(function, np.arange(rows.start, rows.stop))] = rows
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), future.result()
    finally:  # what still runs ends unheard: to wait for it would hold back an error
        for future in running:
            future.cancel()
        if executor is None:
            pool.shutdown(wait=False)
