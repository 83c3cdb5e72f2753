"""Computation of many rows: a pure function of row numbers, evaluated in chunks by threads or a cluster, stored if wanted.

The kernels release Python's lock, so that threads suffice on one machine. Only the calling thread writes the result: the memory
is that of the result and of the chunks in flight. A row agrees to 1e-9 for all chunk sizes, workers and machines, resumed or
not.
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
"""Name of each result -> its array, whose first axis is the row."""

CHUNK = 8192
"""Rows per chunk: many against a block of lanes (little padding), few against a second of work."""

MIN_CHUNK = 64
"""Smallest chunk size to which chunks are reduced so that every worker has one: two blocks of lanes."""

IN_FLIGHT = 2
"""Chunks in flight per thread: the next one is waiting when one ends."""

MEMORY_SHARE = 0.5
"""Largest share of the machine's memory for results."""


class RowFunction(Protocol):
    """A pure function of row numbers, called by several threads at once.

    Implement it as a frozen dataclass of plain data, all fields of which identify its rows
    (:func:`sunspin.compute.identity.to_json`). It is sent to other processes and compiles there what it needs. `outputs`: name
    of each result -> its dtype (numbers or truth values) and its shape without the rows. A call with row numbers (n) returns
    each result with shape (n, ...).
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
    """Compute all rows of a function and return a dict of arrays, each (n_rows, ...).

    Parameters
    ----------
    function : RowFunction
    workers : int, optional
        Threads on this machine, or worker processes of a "local" cluster; default one per core.
    chunk : int
        Largest number of rows per call of the function. An interruption loses the chunks in flight.
    store : path, optional
        A folder, new or empty, in which finished chunks are kept. The same call resumes there after any interruption, including
        kill -9 and power failure; a complete store is only read.
    scheduler : "local", address, dask.distributed.Client or concurrent.futures.Executor, optional
        An executor computes the rows and is not shut down. Other values use a Dask cluster: "local" starts worker processes on this
        machine (the calling script needs `if __name__ == "__main__":`), "tcp://host:port" uses a running cluster whose workers have
        sunspin installed.
    progress : bool
        Show a progress bar on a terminal, labelled `label`.

    Raises
    ------
    InputError
        For invalid arguments, a store of other inputs, or a cluster that does not answer.
    Interrupted
        After Ctrl-C; its text says what was kept. Errors of the function are raised unchanged and at once.
    """
    n_workers, n_rows = worker_count(workers), function.n_rows
    chunk = positive_integer("chunk", chunk)
    on_cluster = scheduler is not None and not isinstance(scheduler, Executor)
    if on_cluster and find_spec("distributed") is None:
        what = "a scheduler needs Dask, which is not installed"
        raise InputError(what, do='pip install "sunspin[cluster]"')
    out = _allocate_results(function)
    # enough chunks that every worker gets one
    chunk = min(chunk, max(MIN_CHUNK, -(-n_rows // n_workers)))
    chunks = (slice(k, min(k + chunk, n_rows)) for k in range(0, n_rows, chunk))
    save, done = None, 0  # function that stores a chunk; number of finished rows
    bar: dict[str, Any] = {"desc": label, "unit": "row", "unit_scale": True, "leave": False}
    bar["disable"] = None if progress else True  # None: shown on a terminal only
    try:
        with ExitStack() as stack:
            if store is not None and n_rows:
                save, missing = stack.enter_context(open_store(store, function, chunk, out))
                chunks = iter(missing)
                done = n_rows - sum(rows.stop - rows.start for rows in missing)
            progress_bar = stack.enter_context(tqdm(total=n_rows, initial=done, **bar))
            if not on_cluster or done == n_rows:  # for a complete store no cluster is needed
                executor = None if on_cluster else scheduler
                computed = _compute_on_executor(function, chunks, executor, n_workers)
            else:
                from sunspin.compute.cluster import compute_on_cluster

                computed = compute_on_cluster(function, chunks, scheduler, n_workers)
            for rows, values in stack.enter_context(closing(computed)):
                returned = {name: (v.dtype.str, v.shape) for name, v in values.items()}
                declared = {name: (v.dtype.str, v[rows].shape) for name, v in out.items()}
                if returned != declared:
                    what = f"the row function must return {declared}"
                    raise InputError(what, got=str(returned))
                for name, array in values.items():
                    out[name][rows] = array
                if save is not None:
                    save(rows)
                done += rows.stop - rows.start
                progress_bar.update(rows.stop - rows.start)
    except KeyboardInterrupt:
        what = f"interrupted, {done} of {n_rows} rows are done and kept in {store}"
        do = "run the same command again to resume"
        if store is None:
            what = f"interrupted after {done} of {n_rows} rows, of which nothing is kept without a store"
            do = "give one to be able to resume"
        raise Interrupted(what, do=do) from None
    return out


def _allocate_results(function: RowFunction) -> Values:
    """Return arrays of zeros for all results of a function.

    Raises `InputError` if they would take more than `MEMORY_SHARE` of the machine's memory: the system would otherwise end the
    process later, when the arrays are filled.
    """
    n_rows, outputs = function.n_rows, function.outputs.items()
    row_bytes = sum(np.dtype(kind).itemsize * int(np.prod(shape)) for _, (kind, shape) in outputs)
    size = n_rows * row_bytes
    if hasattr(os, "sysconf"):
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        if size > MEMORY_SHARE * memory:
            what = f"the results of {n_rows:.3g} rows would take {size / 1e9:.2g} GB of memory"
            got = f"a machine with {memory / 1e9:.2g} GB"
            raise InputError(what, got=got, do="ask for fewer rows")
    return {name: np.zeros((n_rows, *shape), kind) for name, (kind, shape) in outputs}


def _compute_on_executor(
    function: RowFunction, chunks: Iterator[slice], executor: Executor | None, n_workers: int
) -> Generator[tuple[slice, Values]]:
    """Yield each chunk of rows with its results as the executor finishes it; without an executor, threads compute them."""
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
    finally:
        # chunks that still run are abandoned: waiting for them would delay an error
        for future in running:
            future.cancel()
        if executor is None:
            pool.shutdown(wait=False)
