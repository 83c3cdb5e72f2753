"""Many rows: a pure function of row numbers, run in chunks on threads or on a Dask cluster, kept on disk if wanted.

The kernels release the GIL, so threads are enough on one machine. Only the calling thread writes the result: memory is the
result plus the chunks in flight. What a row gives does not depend on how rows are cut into chunks, on the number of
workers, on where they run (as long as the machines compute alike) or on how often the run was killed and resumed.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from sunspin.base.errors import InputError, Interrupted, sentence
from sunspin.compute.pieces import Piece, RowFunction, Values, run_piece

CHUNK = 8192
"""Rows per chunk: large against a block of lanes (little padding), small against a second of work."""

MEMORY_SHARE = 0.5
"""Of the machine's memory that results may take."""

def worker_count(workers: int | None) -> int:
    """The number of threads to use: as asked, else one per core that this process may use."""
    if workers is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
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
        Threads on this machine, or worker processes of a "local" cluster; default one per core.
    chunk : int
        Rows per call of the function. A new store is cut into pieces of this size too, and keeps that size: it is what an
        interruption can cost, per worker.
    store : path, optional
        A folder (a Zarr group) in which finished chunks are kept. The same call resumes there after any interruption, be it
        kill -9 or a power failure; once complete it is simply read. The folder must be new, empty or of the same
        inputs.
    scheduler : "local", address or dask.distributed.Client, optional
        Run on a Dask cluster: "local" starts worker processes on this machine (the script that asks for it needs
        `if __name__ == "__main__":`), "tcp://host:port" uses a running cluster whose workers have sunspin installed.
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
        raise InputError(sentence("single rows are not kept in a store", do="leave out either index or store"))
    n = function.n_rows if rows is None else len(rows)
    _check_memory(n, function.outputs)
    out = {name: np.zeros((n, *shape), dtype) for name, (dtype, shape) in function.outputs.items()}
    taker = _Taker(function, out, store)
    try:
        with ExitStack() as stack:
            missing = [(0, n)] if n else []
            if store is not None and n:
                from sunspin.compute.store import open_store  # Zarr is imported only by those who keep results

                taker.kept, missing = stack.enter_context(open_store(store, function, chunk, out))
            taker.rows = n - sum(stop - start for start, stop in missing)
            hidden = None if progress else True  # None: shown on a terminal only
            taker.bar = stack.enter_context(
                tqdm(total=n, initial=taker.rows, unit="row", unit_scale=True, desc=label, disable=hidden, leave=False)
            )
            if missing:
                backend = stack.enter_context(_backend(function, rows, scheduler, n_workers))
                _run(backend, _pieces(missing, chunk), taker)
    except KeyboardInterrupt:
        raise Interrupted(taker.farewell()) from None
    return out


def _check_memory(n_rows: int, outputs: Mapping[str, tuple[str, tuple[int, ...]]]) -> None:
    """Refuse results that this machine cannot hold, with an estimate, rather than have it end for lack of memory."""
    row = sum(np.dtype(dtype).itemsize * int(np.prod(shape, dtype=int)) for dtype, shape in outputs.values())
    there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else np.inf
    if n_rows * row > MEMORY_SHARE * there:
        raise InputError(
            sentence(
                f"the results of {n_rows:.3g} rows would take {n_rows * row / 1e9:.2g} GB of memory",
                got=f"a machine with {there / 1e9:.2g} GB", do="ask for fewer rows",
            )
        )  # fmt: skip


def _row_numbers(index: npt.ArrayLike, n_rows: int) -> np.ndarray:
    try:
        rows = np.atleast_1d(np.asarray(index))
    except ValueError:  # lists of unequal length
        rows = np.empty((0, 0))
    whole = rows.ndim == 1 and (rows.size == 0 or rows.dtype.kind in "iu")
    if not whole or np.any((rows < 0) | (rows >= n_rows)):
        raise InputError(sentence(f"index must be a list of row numbers from 0 to {n_rows - 1}", got=str(index)))
    return rows.astype(np.int64)


def _pieces(missing: list[Piece], chunk: int) -> Iterator[Piece]:
    for start, stop in missing:
        for low in range(start, stop, chunk):
            yield low, min(low + chunk, stop)


class _Taker:
    """Puts results in their places, in memory and on disk, and knows how many rows are done."""

    def __init__(self, function: RowFunction, out: Values, store: Any) -> None:
        self.n_rows, self.outputs, self.out, self.store = function.n_rows, function.outputs, out, store
        self.kept: Any = None
        self.bar: Any = None
        self.rows = 0

    def __call__(self, piece: Piece, values: Values) -> None:
        start, stop = piece
        if set(values) != set(self.outputs):
            raise InputError(sentence(f"the row function must return {sorted(self.outputs)}", got=str(sorted(values))))
        for name, array in values.items():
            target, given = self.out[name][start:stop], np.asarray(array)
            if given.shape != target.shape or given.dtype != target.dtype:
                wanted = f"{target.dtype} of shape {target.shape}"
                raise InputError(
                    sentence(f"the row function must return {name} as {wanted}", got=f"{given.dtype} of shape {given.shape}")
                )
            target[...] = given
        if self.kept is not None:
            self.kept.filled(start, stop, self.out)
        self.rows += stop - start
        self.bar.update(stop - start)

    def farewell(self) -> str:
        """What an interrupted run leaves behind, and how to go on."""
        if self.store is None:
            done = f"interrupted after {self.rows} of {self.n_rows} rows, of which nothing is kept without a store"
            return sentence(done, do="give one to be able to resume")
        rows = 0 if self.kept is None else self.kept.rows_kept
        done = f"interrupted, {rows} of {self.n_rows} rows are done and kept in {self.store}"
        return sentence(done, do="run the same command again to resume")


class Backend(Protocol):
    """Where chunks run. A context: leaving it abandons what is still in flight."""

    slots: int
    """Chunks in flight at most."""

    def __enter__(self) -> Backend: ...

    def __exit__(self, *exception: object) -> None: ...

    def in_flight(self) -> int:
        """Chunks handed in and not yet given back."""
        ...

    def submit(self, piece: Piece) -> None:
        """Begin with the rows at these places."""

    def finished(self) -> list[tuple[Piece, Values]]:
        """Wait until something is finished and give it back; raises what the function raised."""
        ...

    def drain(self) -> list[tuple[Piece, Values]]:
        """Begin nothing more and give back what finishes soon."""
        ...


def _run(backend: Backend, pieces: Iterator[Piece], take: _Taker) -> None:
    try:
        while True:
            while backend.in_flight() < backend.slots and (piece := next(pieces, None)) is not None:
                backend.submit(piece)
            if not backend.in_flight():
                return
            for piece, values in backend.finished():
                take(piece, values)
    except KeyboardInterrupt:
        for piece, values in backend.drain():
            take(piece, values)
        raise


def _backend(function: RowFunction, rows: np.ndarray | None, scheduler: Any, n_workers: int) -> Backend:
    if scheduler is None:
        return Threads(function, rows, n_workers)
    try:
        from sunspin.compute.cluster import Cluster
    except ModuleNotFoundError as error:
        if error.name not in ("dask", "distributed"):
            raise
        raise InputError(
            sentence("a scheduler needs Dask, which is not installed", do='pip install "sunspin[cluster]"')
        ) from None
    return Cluster(function, rows, scheduler, n_workers)


class Threads:
    """Chunks on threads of this process."""

    def __init__(self, function: RowFunction, rows: np.ndarray | None, n_workers: int) -> None:
        self._function, self._rows = function, rows
        self._pool = ThreadPoolExecutor(n_workers, thread_name_prefix="sunspin")
        self._pending: dict[Future, Piece] = {}
        self.slots: int = 2 * n_workers

    def __enter__(self) -> Threads:
        return self

    def __exit__(self, *exception: object) -> None:
        # chunks that are running end unheard: waiting for them would hold back the error
        self._pool.shutdown(wait=False, cancel_futures=True)

    def in_flight(self) -> int:
        return len(self._pending)

    def submit(self, piece: Piece) -> None:
        self._pending[self._pool.submit(run_piece, self._function, self._rows, piece)] = piece

    def finished(self) -> list[tuple[Piece, Values]]:
        done = wait(self._pending, return_when=FIRST_COMPLETED).done
        return [(self._pending.pop(future), future.result()) for future in done]

    def drain(self) -> list[tuple[Piece, Values]]:
        self._pool.shutdown(wait=True, cancel_futures=True)
        good = [future for future in self._pending if not future.cancelled() and future.exception() is None]
        return [(self._pending.pop(future), future.result()) for future in good]
