"""Times of competing functions, and tables of them. Rounds alternate, so that a machine that slows down slows all of them."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

Work = Callable[[], object]
Name = TypeVar("Name", bound=Hashable)


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass
class Timing:
    """Wall times (s) of one function, round by round, and the processor times (s) of all its threads."""

    wall: list[float] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)

    def take(self, call: Work) -> None:
        """Measure one call."""
        start, used = time.perf_counter(), time.process_time()
        call()
        self.wall.append(time.perf_counter() - start)
        self.processor.append(time.process_time() - used)

    @property
    def median(self) -> float:
        """Median wall time in s."""
        return statistics.median(self.wall)

    @property
    def cores_used(self) -> float:
        """Mean number of cores in use: less than the threads if one of them was idle, or if other work took the core."""
        return sum(self.processor) / sum(self.wall)

    def against(self, other: Timing) -> float:
        """Return the median over the rounds of this time divided by the other's in the same round."""
        return statistics.median(a / b for a, b in zip(self.wall, other.wall, strict=True))


def timings(work: Mapping[Name, Work], repeats: int) -> dict[Name, Timing]:
    """Return the times of each function over `repeats` rounds; a round calls every function once.

    A first round is not counted: it compiles, and fills caches and memory.
    """
    for call in work.values():
        call()
    taken = {name: Timing() for name in work}
    for _ in range(repeats):
        for name, call in work.items():
            taken[name].take(call)
    return taken


def medians(work: Mapping[Name, Work], repeats: int) -> dict[Name, float]:
    """Return the median wall time in s of each function."""
    return {name: timing.median for name, timing in timings(work, repeats).items()}


@dataclass
class Table:
    """Rows of a benchmark with a cell for each column, and notes for their interpretation."""

    title: str
    columns: tuple[str, ...]
    rows: list[tuple[str | float | None, ...]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def text(self) -> str:
        """Return the table in Markdown, with three digits, and a dash for values that were not measured."""
        lines = [self.columns, ("---",) * len(self.columns), *self.rows]
        cells = [[_format_cell(cell) for cell in line] for line in lines]
        return "\n".join(
            [self.title, "", *(f"| {' | '.join(line)} |" for line in cells), "", *self.notes]
        )


def _format_cell(cell: str | float | None) -> str:
    """Return a cell as text: a number with three digits, or in whole numbers from 1000 on; "-" for None and empty text."""
    if cell is None or isinstance(cell, str):
        return cell or "-"
    return f"{cell:,.0f}" if abs(cell) >= 1000 else f"{cell:.3g}"
