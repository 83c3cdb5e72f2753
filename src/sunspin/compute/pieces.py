"""What is computed in many rows, and the pieces into which they are cut."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

Values = dict[str, np.ndarray]
Piece = tuple[int, int]
"""Half-open range of places in the result."""


class RowFunction(Protocol):
    """A pure function of row numbers.

    Make it a frozen dataclass of plain data: it is sent to other processes, and what it compiles or looks up it makes there
    when first called. Several threads call it at once.
    """

    @property
    def n_rows(self) -> int:
        """Rows there are; they are numbered from 0."""
        ...

    @property
    def outputs(self) -> Mapping[str, tuple[str, tuple[int, ...]]]:
        """Name of each result -> its dtype as text and its shape beyond the rows; numbers and truth values only."""
        ...

    def identity(self) -> dict[str, Any]:
        """Everything the result depends on, code included, as JSON knows it (see :mod:`sunspin.compute.identity`)."""
        ...

    def __call__(self, index: np.ndarray) -> Values:
        """Results of the rows `index` (n): each of `outputs` with shape (n, ...). The same to 1e-9 in whatever company."""
        ...


def run_piece(function: RowFunction, rows: np.ndarray | None, piece: Piece) -> Values:
    """The results at these places: of the rows with those numbers, or of those places in `rows`."""
    return function(np.arange(*piece) if rows is None else rows[slice(*piece)])


def cancel_waiting(futures: Iterable[Future]) -> list[Future]:
    """Cancel what has not begun and return what is running."""
    return [future for future in futures if not future.cancel()]


@dataclass(frozen=True)
class Place:
    """Where pieces run."""

    executor: Executor
    slots: int
    """Pieces in flight at most."""
    function: Any
    """What the executor is given for the row function: itself, or what stands for it where the rows run."""
    abandon: Callable[[Iterable[Future]], list[Future]] = cancel_waiting
    """Give up futures; returns those that still finish."""
