"""How much an estimate may compute, counted in motions carried over one interval between two samples.

Never in seconds: a seed gives the same result anywhere. The equations of motion `spend`; a search asks `may_go_on` before what
could be left out, keeps the best so far, and notes that it was cut short.
"""

from __future__ import annotations

import sys
from contextvars import ContextVar, Token
from typing import Any, Self

import numpy as np
from tqdm import tqdm

from sunspin.base.errors import InputError

USUAL = 1.5e7
"""What an estimate may take unless it is told otherwise: about a minute and a half of one core."""

BATCH = 250
"""Motions that go together take as long as so many more: about 6 microseconds each, and 1.5 ms for what surrounds them. Measured on
the template, skCUBE and four faces: of smoothing and shooting, of few and of many hypotheses, within a factor of two."""


class _Bar(tqdm):
    """Without a thread that watches it: beside another thread no process is copied (:mod:`sunspin.compute.pool`)."""

    monitor_interval = 0


class Effort:
    """What was spent while this was entered (`with effort: ...`, as often as one likes), of `most`; `cut`: something was left out.

    An effort that begins within another counts there too, and ends with it unless it is `alone`. `label` of a progress line, if
    one is shown.
    """

    def __init__(self, most: float, label: str | None = None, alone: bool = False) -> None:
        self.most, self.outer, self.alone, self.spent, self.cut = (
            most,
            _now.get(),
            alone,
            0.0,
            False,
        )
        self._entered: list[Token[Effort | None]] = []
        self._said: set[str] = set()
        total = most if np.isfinite(most) else None
        bar: Any = _Bar(
            total=total,
            desc=label,
            unit="motion",
            unit_scale=True,
            miniters=1,
            leave=False,
            disable=label is None,
        )
        self.bar = bar

    def __enter__(self) -> Self:
        self._entered.append(_now.set(self))
        return self

    def __exit__(self, failed: type[BaseException] | None, *_: object) -> None:
        _now.reset(self._entered.pop())
        around: Effort | None = self if failed is not None else None
        while around is not None:  # the sentence on what is wrong begins on a line of its own
            around.close()
            around = around.outer

    def part(self, most: float, alone: bool = False) -> Effort:
        """Another effort within this one; `alone`: it may go on though this one is spent."""
        with self:
            return Effort(most, alone=alone)

    def close(self) -> bool:
        """End the progress line; whether something was left out."""
        self.bar.close()
        return self.cut

    def doing(self, what: str) -> None:
        """Say in the progress line what is being done."""
        self.bar.set_postfix_str(what)

    def say(self, line: str) -> None:
        """Print a line above the progress line, once, where one is shown."""
        if line and not self.bar.disable and line not in self._said:
            self._said.add(line)
            self.bar.write(line, file=sys.stderr)

    def spend(self, count: float) -> None:
        """Count so many motions."""
        self.spent += count
        self.bar.update(count)
        if self.outer is not None:
            self.outer.spend(count)

    @property
    def left(self) -> float:
        """What may still be spent."""
        own = self.most - self.spent
        return own if self.outer is None or self.alone else min(own, self.outer.left)


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


def allowed(effort: float) -> float:
    """Motions for an effort as a caller gives it, in units of the usual one."""
    if (
        isinstance(effort, bool)
        or not isinstance(effort, int | float | np.number)
        or not effort > 0
    ):
        raise InputError(
            "effort must be a positive number, or infinity", got=effort, do="1 is the usual effort"
        )
    return USUAL * float(effort)
