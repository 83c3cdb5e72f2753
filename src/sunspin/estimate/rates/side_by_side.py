"""What is done with each pass by itself, in this process or in several: the same result in either case.

Each may spend so much, counted by itself; what was spent is added up in the order of the passes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from typing import Any

from sunspin.estimate.effort import Effort

Task = tuple[Any, ...]


def each(
    work: Callable[..., Any],
    tasks: Sequence[Task],
    share: float,
    spent: Effort,
    pool: Executor | None,
) -> Iterator[tuple[Any, bool]]:
    """What `work` makes of each task, in order, and whether it was cut short, each having a `share` of the effort to spend."""
    return begun(work, tasks, share, pool if len(tasks) > 1 else None)(spent)


def begun(
    work: Callable[..., Any], tasks: Sequence[Task], share: float, pool: Executor | None
) -> Callable[[Effort], Iterator[tuple[Any, bool]]]:
    """The same, begun now in other processes if there are some, and taken later by the effort that counts it."""
    futures = [pool.submit(_counted, work, task, share) for task in tasks] if pool else []

    def results(spent: Effort) -> Iterator[tuple[Any, bool]]:
        for future in futures:
            result, count, cut = future.result()
            spent.spend(count)
            yield result, cut
        for task in () if pool else tasks:
            with spent.part(share, alone=True) as own:
                result = work(*task)
            yield result, own.cut

    return results


def _counted(work: Callable[..., Any], task: Task, share: float) -> tuple[Any, float, bool]:
    with Effort(share) as own:
        result = work(*task)
    return result, own.spent, own.cut
