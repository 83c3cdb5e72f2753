"""Times of competing pieces of work, taken in turn so that a machine that slows down slows all of them; tables of them."""

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
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass
class Timing:
    """Wall times (s) of one piece of work, round by round, and the processor's time in each (all threads together)."""

    wall: list[float] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)

    def take(self, call: Work) -> None:
        """Time one call."""
        start, used = time.perf_counter(), time.process_time()
        call()
        self.wall.append(time.perf_counter() - start)
        self.processor.append(time.process_time() - used)

    @property
    def median(self) -> float:
        return statistics.median(self.wall)

    @property
    def cores_used(self) -> float:
        """Less than the threads at work where one of them had nothing to do, or where other people's work took the core."""
        return sum(self.processor) / sum(self.wall)

    def against(self, other: Timing) -> float:
        """Median over the rounds of this time by the other's in the same round."""
        return statistics.median(a / b for a, b in zip(self.wall, other.wall, strict=True))


def timings(work: Mapping[Name, Work], repeats: int) -> dict[Name, Timing]:
    """Times of each piece of work over `repeats` rounds; a round runs every piece once.

    A round that does not count comes first: compilation, caches and first touches of memory.
    """
    for call in work.values():
        call()
    taken = {name: Timing() for name in work}
    for _ in range(repeats):
        for name, call in work.items():
            taken[name].take(call)
    return taken


def medians(work: Mapping[Name, Work], repeats: int) -> dict[Name, float]:
    """Median wall time in s of each piece of work."""
    return {name: timing.median for name, timing in timings(work, repeats).items()}


@dataclass
class Table:
    """Rows of a benchmark, a cell for each column, and the sentences without which they would mislead."""

    title: str
    columns: tuple[str, ...]
    rows: list[tuple[str | float | None, ...]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def text(self) -> str:
        """The table in Markdown: three digits, a dash for what was not measured."""
        lines = [self.columns, ("---",) * len(self.columns), *self.rows]
        cells = [[_shown(cell) for cell in line] for line in lines]
        return "\n".join(
            [self.title, "", *(f"| {' | '.join(line)} |" for line in cells), "", *self.notes]
        )


def _shown(cell: str | float | None) -> str:
    if cell is None or isinstance(cell, str):
        return cell or "-"
    return f"{cell:,.0f}" if abs(cell) >= 1000 else f"{cell:.3g}"
