"""Many rows: a pure function of row numbers, run in chunks by any executor of concurrent.futures, kept on disk if wanted.

The kernels release the GIL, so threads are enough on one machine; a Dask cluster is reached through Dask's own executor. Only
the calling thread writes the result: memory is the result plus the chunks in flight. What a row gives does not depend on how
rows are cut into chunks, on the number of workers, on where they run (as long as the machines compute alike) or on how often
the run was killed and resumed.
"""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from sunspin.base.errors import InputError, Interrupted, sentence
from sunspin.compute.pieces import Piece, Place, RowFunction, Values, run_piece

CHUNK = 8192
"""Rows per chunk: large against a block of lanes (little padding), small against a second of work."""

LEAST_CHUNK = 64
"""Chunks are not made smaller than this so that all workers have one: two blocks of lanes."""

SLOTS = 2
"""Pieces in flight for each worker: the next one is there when one ends."""

MEMORY_SHARE = 0.5
"""Of the machine's memory that results may take."""


def worker_count(workers: int | None) -> int:
    """The number of threads to use: as asked, else one per core that this process may use."""
    if workers is None:
        return (
            len(os.sched_getaffinity(0))
            if hasattr(os, "sched_getaffinity")
            else os.cpu_count() or 1
        )
    return _whole("workers", workers)


def _whole(name: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise InputError(sentence(f"{name} must be a positive whole number", got=value))
    return int(value)


def ensemble(
    function: RowFunction,
    *,
    workers: int | None = None,
    chunk: int = CHUNK,
    store: str | Path | None = None,
    scheduler: Any = None,
    progress: bool = False,
    label: str = "rows",
    index: npt.ArrayLike | None = None,
) -> Values:
    """All rows of a function, or some.

    Parameters
    ----------
    function : RowFunction
    workers : int, optional
        Threads on this machine, worker processes of a "local" cluster, or workers that an executor has; default one per core.
    chunk : int
        Rows per call of the function, at most: fewer where some workers would have none. A new store is cut into pieces of this
        size too, and keeps that size: it is what an interruption can cost, per worker.
    store : path, optional
        A folder in which finished chunks are kept. The same call resumes there after any interruption, be it
        kill -9 or a power failure; once complete it is simply read. The folder must be new, empty or of the same
        inputs.
    scheduler : "local", address, dask.distributed.Client or concurrent.futures.Executor, optional
        Run on a Dask cluster: "local" starts worker processes on this machine (the script that asks for it needs
        `if __name__ == "__main__":`), "tcp://host:port" uses a running cluster whose workers have sunspin installed. An
        executor runs the rows as it runs anything else and is not shut down.
    progress : bool
        Show a progress bar on a terminal, called `label`.
    index : list of row numbers, optional
        Run only these rows, alone.

    Returns
    -------
    dict of arrays, each (n_rows, ...) or (len(index), ...).

    Raises
    ------
    InputError
        For arguments that make no sense, a store of other inputs, a cluster that does not answer.
    Interrupted
        After Ctrl-C; its text says what was kept. Whatever the function raises comes through at once.
    """
    n_workers, chunk = worker_count(workers), _whole("chunk", chunk)
    rows = None if index is None else _row_numbers(index, function.n_rows)
    if rows is not None and store is not None:
        raise InputError(
            sentence("single rows are not kept in a store", do="leave out either index or store")
        )
    n = function.n_rows if rows is None else len(rows)
    _check_memory(n, function.outputs)
    chunk = min(chunk, max(LEAST_CHUNK, -(-n // n_workers)))
    out = {name: np.zeros((n, *shape), dtype) for name, (dtype, shape) in function.outputs.items()}
    taker = _Taker(function, out, store)
    try:
        with ExitStack() as stack:
            missing = [(0, n)] if n else []
            if store is not None and n:
                from sunspin.compute.store import open_store

                taker.kept, missing = stack.enter_context(open_store(store, function, chunk, out))
            taker.rows = n - sum(stop - start for start, stop in missing)
            hidden = None if progress else True  # None: shown on a terminal only
            taker.bar = stack.enter_context(
                tqdm(
                    total=n,
                    initial=taker.rows,
                    unit="row",
                    unit_scale=True,
                    desc=label,
                    disable=hidden,
                    leave=False,
                )
            )
            if missing:
                place = stack.enter_context(_place(function, scheduler, n_workers))
                _run(place, rows, _pieces(missing, chunk), taker)
    except KeyboardInterrupt:
        raise Interrupted(taker.interrupt_message()) from None
    return out


def _check_memory(n_rows: int, outputs: Mapping[str, tuple[str, tuple[int, ...]]]) -> None:
    """Refuse results that this machine cannot hold, with an estimate, rather than have it end for lack of memory."""
    row = sum(
        np.dtype(dtype).itemsize * int(np.prod(shape, dtype=int))
        for dtype, shape in outputs.values()
    )
    there = (
        os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        if hasattr(os, "sysconf")
        else np.inf
    )
    if n_rows * row > MEMORY_SHARE * there:
        raise InputError(
            sentence(
                f"the results of {n_rows:.3g} rows would take {n_rows * row / 1e9:.2g} GB of memory",
                got=f"a machine with {there / 1e9:.2g} GB",
                do="ask for fewer rows",
            )
        )


def _row_numbers(index: npt.ArrayLike, n_rows: int) -> np.ndarray:
    try:
        rows = np.atleast_1d(np.asarray(index))
    except ValueError:  # lists of unequal length
        rows = np.empty((0, 0))
    whole = rows.ndim == 1 and (rows.size == 0 or rows.dtype.kind in "iu")
    if not whole or np.any((rows < 0) | (rows >= n_rows)):
        raise InputError(
            sentence(f"index must be a list of row numbers from 0 to {n_rows - 1}", got=str(index))
        )
    return rows.astype(np.int64)


def _pieces(missing: list[Piece], chunk: int) -> Iterator[Piece]:
    for start, stop in missing:
        for low in range(start, stop, chunk):
            yield low, min(low + chunk, stop)


class _Taker:
    """Puts results in their places, in memory and on disk, and knows how many rows are done."""

    def __init__(self, function: RowFunction, out: Values, store: Any) -> None:
        self.n_rows, self.outputs, self.out, self.store = (
            function.n_rows,
            function.outputs,
            out,
            store,
        )
        self.kept: Any = None
        self.bar: Any = None
        self.rows = 0

    def __call__(self, piece: Piece, values: Values) -> None:
        start, stop = piece
        if set(values) != set(self.outputs):
            raise InputError(
                sentence(
                    f"the row function must return {sorted(self.outputs)}", got=str(sorted(values))
                )
            )
        for name, array in values.items():
            target, given = self.out[name][start:stop], np.asarray(array)
            if given.shape != target.shape or given.dtype != target.dtype:
                wanted = f"{target.dtype} of shape {target.shape}"
                raise InputError(
                    sentence(
                        f"the row function must return {name} as {wanted}",
                        got=f"{given.dtype} of shape {given.shape}",
                    )
                )
            target[...] = given
        if self.kept is not None:
            self.kept.filled(start, stop, self.out)
        self.rows += stop - start
        self.bar.update(stop - start)

    def interrupt_message(self) -> str:
        """What an interrupted run leaves behind, and how to go on."""
        if self.store is None:
            done = f"interrupted after {self.rows} of {self.n_rows} rows, of which nothing is kept without a store"
            return sentence(done, do="give one to be able to resume")
        rows = 0 if self.kept is None else self.kept.rows_kept
        done = f"interrupted, {rows} of {self.n_rows} rows are done and kept in {self.store}"
        return sentence(done, do="run the same command again to resume")


def _run(place: Place, rows: np.ndarray | None, pieces: Iterator[Piece], take: _Taker) -> None:
    """Keep `place.slots` pieces in flight until all are taken. Ctrl-C keeps what this machine finishes soon."""
    pending: dict[Future, Piece] = {}
    try:
        while True:
            while len(pending) < place.slots and (piece := next(pieces, None)) is not None:
                some, span = (
                    (None, piece)
                    if rows is None
                    else (rows[slice(*piece)], (0, piece[1] - piece[0]))
                )
                pending[place.executor.submit(run_piece, place.function, some, span)] = piece
            if not pending:
                return
            for future in wait(pending, return_when=FIRST_COMPLETED).done:
                take(pending.pop(future), future.result())
    except KeyboardInterrupt:
        running = place.abandon(pending)
        for future in wait(running).done:
            if future.exception() is None:
                take(pending[future], future.result())
        raise
    except BaseException:
        place.abandon(
            pending
        )  # what is running ends unheard: waiting for it would hold back the error
        raise


@contextmanager
def _place(function: RowFunction, scheduler: Any, n_workers: int) -> Generator[Place]:
    """Where the pieces run; what is opened for it here is closed with it."""
    if isinstance(scheduler, Executor):
        yield Place(scheduler, SLOTS * n_workers, function)
    elif scheduler is None:
        pool = ThreadPoolExecutor(n_workers, thread_name_prefix="sunspin")
        try:
            yield Place(pool, SLOTS * n_workers, function)
        finally:
            pool.shutdown(wait=False)
    else:
        try:
            from sunspin.compute.cluster import on_cluster
        except ModuleNotFoundError as error:
            if error.name not in ("dask", "distributed"):
                raise
            raise InputError(
                sentence(
                    "a scheduler needs Dask, which is not installed",
                    do='pip install "sunspin[cluster]"',
                )
            ) from None
        with on_cluster(function, scheduler, n_workers) as place:
            yield place
