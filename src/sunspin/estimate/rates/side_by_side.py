"""What is done with each pass by itself, in this process or in several: the same result in either case.

Each may spend so much, counted by itself; what was spent is added up in the order of the passes.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import active_children, get_context
from typing import Any

from sunspin.base.errors import InputError, sentence
from sunspin.compute.copies import copying, deaf, may_copy
from sunspin.estimate.effort import Effort


@contextmanager
def processes(workers: int) -> Generator[Executor | None]:
    """So many processes, which end with this, at once if it is left by an error; none where one suffices."""
    if workers < 2:
        yield None
        return
    others = set(active_children())
    pool = ProcessPoolExecutor(
        workers, mp_context=get_context("fork" if may_copy() else "spawn"), initializer=deaf
    )
    try:
        with copying():  # before this process has threads of its own
            pool.submit(int)
        yield pool
    except BaseException:
        for child in set(active_children()) - others:
            child.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def each(
    work: Callable[..., Any],
    tasks: Sequence[tuple[Any, ...]],
    share: float,
    spent: Effort,
    pool: Executor | None,
) -> Iterator[tuple[Any, bool]]:
    """What `work` makes of each task, in order, and whether it was cut short, each having a `share` of the effort to spend."""
    return begun(work, tasks, share, pool if len(tasks) > 1 else None)(spent)


def begun(
    work: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], share: float, pool: Executor | None
) -> Callable[[Effort], Iterator[tuple[Any, bool]]]:
    """The same of tasks that other processes, where there are some, begin with now: taken later, by the effort that counts them."""
    if pool is None:
        return partial(_here, work, tasks, share)
    with _whole():
        return partial(_taken, [pool.submit(_counted, work, task, share) for task in tasks])


def _here(
    work: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], share: float, spent: Effort
) -> Iterator[tuple[Any, bool]]:
    for task in tasks:
        with spent.part(share, alone=True) as own:
            made = work(*task)
        yield made, own.cut


def _taken(futures: Sequence[Future], spent: Effort) -> Iterator[tuple[Any, bool]]:
    with _whole():
        for future in futures:
            made, count, cut = future.result()
            spent.spend(count)
            yield made, cut


@contextmanager
def _whole() -> Generator[None]:
    """While processes are asked: a sentence where one is no more."""
    try:
        yield
    except BrokenExecutor:
        raise InputError(
            sentence(
                "a process that estimated a pass was ended from outside, for lack of memory perhaps",
                do="give a smaller number of workers, 1 say",
            )
        ) from None


def _counted(
    work: Callable[..., Any], task: tuple[Any, ...], share: float
) -> tuple[Any, float, bool]:
    with Effort(share) as own:
        made = work(*task)
    return made, own.spent, own.cut
