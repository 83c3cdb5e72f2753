"""Steps of the study: each runs in a thread and ends with a result and its rows, or with the reason why it has none."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from sunspin.base.errors import InputError, MotionError, SunspinError, TelemetryError
from sunspin.compute.pool import worker_count
from sunspin.philae.row import Row

T = TypeVar("T")

REPORTED = (TelemetryError, InputError, MotionError)
"""Errors of a step that are listed as the reason why it has no result. Any other error ends the study."""


class MissingResult(Exception):
    """A step takes a result that is missing because of the error in `args`, or because the study ends (None)."""


@dataclass(frozen=True)
class StepOutcome(Generic[T]):
    """Result and rows of a step, or the error because of which it has none. A step that has not ended has nothing.

    `key`: name of the step in `missing` of `summary.json`. `section`: a key of `study.SECTIONS`. If `inherited`, the error was
    raised by another step, on which this one rests.
    """

    key: str = ""
    title: str = ""
    section: str = ""
    result: T | None = None
    rows: tuple[Row, ...] = ()
    error: SunspinError | None = None
    inherited: bool = False

    def get(self) -> T:
        """Return the result; raise `MissingResult` if there is none."""
        if self.result is None:
            raise MissingResult(self.error)
        return self.result

    @property
    def reason(self) -> str:
        """Why the step has no result, in words."""
        if self.inherited:
            return f"{self.title}: not computed, as it rests on what is missing"
        return f"{self.title}: not reproduced, as {self.error}"


def run_step(
    key: str,
    title: str,
    compute: Callable[[], T],
    rows: Callable[[T], list[Row]] | None = None,
    section: str = "telemetry",
    fatal: tuple[type[SunspinError], ...] = (),
) -> StepOutcome[T]:
    """Return the outcome of a step: the result of `compute`, and the rows that `rows` returns for it.

    An error of `REPORTED` becomes the reason why the result is missing, but for the classes in `fatal`.
    """
    try:
        result = compute()
        return StepOutcome(key, title, section, result, tuple(rows(result)) if rows else ())
    except MissingResult as missing:
        return StepOutcome(key, title, section, error=missing.args[0], inherited=True)
    except fatal:
        raise
    except REPORTED as error:
        return StepOutcome(key, title, section, error=error)


class Steps:
    """Run steps in two threads, in the order in which they are submitted. When the context is left, no further step begins."""

    def __init__(self, workers: int | None = None) -> None:
        # the kernels of a step use all cores: more than two steps at a time would take memory and gain nothing
        self._pool = ThreadPoolExecutor(min(worker_count(workers), 2), thread_name_prefix="step")
        self._stopped, self.submitted = threading.Event(), list[Future[StepOutcome[Any]]]()

    def __enter__(self) -> Steps:
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._pool.shutdown(wait=False, cancel_futures=True)

    def run(
        self,
        key: str,
        title: str,
        compute: Callable[[], T],
        rows: Callable[[T], list[Row]] | None = None,
        **about: Any,
    ) -> Future[StepOutcome[T]]:
        """Submit the step whose outcome is that of `run_step` with these arguments."""
        step = self._pool.submit(lambda: run_step(key, title, compute, rows, **about))
        self.submitted.append(step)
        return step

    def of(self, step: Future[StepOutcome[T]]) -> StepOutcome[T]:
        """Return the outcome of a step to one that was submitted later, which waits for it."""
        wait([step])
        if self._stopped.is_set():
            raise MissingResult(None)
        return step.result()
