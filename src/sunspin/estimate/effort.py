"""How much a posterior may compute, counted in motions carried over one interval between two samples.

Never in seconds: a seed gives the same result anywhere. The equations of motion `spend`; a search asks `may_go_on` before what
could be left out, keeps the best so far, and notes that it was cut short.
"""

from __future__ import annotations

from contextvars import ContextVar, Token
from typing import Self

import numpy as np

BATCH = 250
"""Motions that go together take as long as so many more: about 6 microseconds each, and 1.5 ms for what surrounds them, within a
factor of two."""


class Effort:
    """What was spent while this was entered (`with effort: ...`, as often as one likes), of `most`; `cut`: something was left out.

    An effort that begins within another counts there too, and ends with it.
    """

    def __init__(self, most: float) -> None:
        self.most, self.outer, self.spent, self.cut = most, _now.get(), 0.0, False
        self._entered: list[Token[Effort | None]] = []

    def __enter__(self) -> Self:
        self._entered.append(_now.set(self))
        return self

    def __exit__(self, *_: object) -> None:
        _now.reset(self._entered.pop())

    def spend(self, count: float) -> None:
        """Count so many motions."""
        self.spent += count
        if self.outer is not None:
            self.outer.spend(count)

    @property
    def left(self) -> float:
        """What may still be spent."""
        own = self.most - self.spent
        return own if self.outer is None else min(own, self.outer.left)


_now: ContextVar[Effort | None] = ContextVar("effort", default=None)


def spend(count: float) -> None:
    """Count so many motions that are carried over their intervals together, where anybody counts."""
    if (effort := _now.get()) is not None:
        effort.spend(count + BATCH)


def may_go_on() -> bool:
    """Whether what could be left out may begin; if not, the search is cut short, and its effort notes it."""
    effort = _now.get()
    if effort is None or effort.left > 0:
        return True
    effort.cut = True
    return False


def share_of_left(share: float) -> Effort:
    """An effort within the present one, of a share of what is left there; without bound where nobody counts."""
    effort = _now.get()
    return Effort(np.inf if effort is None else share * effort.left)
