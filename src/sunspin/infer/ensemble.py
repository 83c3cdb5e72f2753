"""Many rows: a pure function of rows, run in chunks on all cores, with progress and a clean stop.

The kernel releases the GIL, so threads are enough. Results are written in place; memory is the result plus a chunk per
worker. What a row gives does not depend on how rows are cut into chunks or on the number of workers.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait

import numpy as np
from tqdm import tqdm

from sunspin.errors import InputError, sentence

CHUNK = 8192
"""Rows per chunk: large against a block of lanes (little padding), small against a second of work."""

ChunkFunction = Callable[[np.ndarray], dict[str, np.ndarray]]


def worker_count(workers: int | None) -> int:
    """The number of threads to use: as asked, else one per core that this process may use."""
    if workers is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not isinstance(workers, int) or workers < 1:
        raise InputError(sentence("workers must be a positive whole number", got=workers))
    return workers


def run_chunks(
    function: ChunkFunction,
    n_rows: int,
    out: dict[str, np.ndarray],
    *,
    workers: int | None = None,
    progress: bool = False,
    label: str = "rows",
    chunk: int = CHUNK,
) -> None:
    """Fill the arrays of `out` (each with first axis n_rows) with what `function(row indices)` returns, chunk by chunk."""
    starts = iter(range(0, n_rows, chunk))
    n_workers = worker_count(workers)
    bar = tqdm(total=n_rows, unit="row", unit_scale=True, desc=label, disable=None if progress else True, leave=False)
    pending: dict[Future, np.ndarray] = {}
    pool = ThreadPoolExecutor(n_workers, thread_name_prefix="sunspin")
    try:
        while True:
            while len(pending) < 2 * n_workers and (start := next(starts, None)) is not None:
                index = np.arange(start, min(start + chunk, n_rows))
                pending[pool.submit(function, index)] = index
            if not pending:
                return
            for future in wait(pending, return_when=FIRST_COMPLETED).done:
                index = pending.pop(future)
                for name, values in future.result().items():
                    out[name][index] = values
                bar.update(len(index))
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        bar.close()
