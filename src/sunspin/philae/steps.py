"""Steps of the study: each runs in a thread, takes results of steps before it, and ends with a result or the reason for none."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, as_completed, wait
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from sunspin.base.errors import InputError, MotionError, SunspinError, TelemetryError
from sunspin.compute.pool import worker_count
from sunspin.philae.row import Row

T = TypeVar("T")

REPORTED = (TelemetryError, InputError, MotionError)
"""Errors of a step that are listed as the reason why it has no result. Any other error ends the study."""


@dataclass(frozen=True)
class Outcome(Generic[T]):
    """A step that has ended, with its result and rows, or with the error because of which it has none.

    `key`: name of the step in `missing` of `summary.json`. `section`: a key of `study.SECTIONS`. If `inherited`, `error` was raised
    by another step, on which this one rests. A step that was stopped has neither result nor error.
    """

    key: str
    title: str
    section: str
    result: T | None = None
    rows: tuple[Row, ...] = ()
    error: SunspinError | None = None
    inherited: bool = False

    @property
    def reason(self) -> str:
        """Why the step has no result, in words."""
        if self.inherited:
            return f"{self.title}: not computed, as it rests on what is missing"
        return f"{self.title}: not reproduced, as {self.error}"


class MissingResult(Exception):
    """A step takes a result that is missing because of the error in `args`, or because the study ends (None)."""


def run_step(
    key: str,
    title: str,
    compute: Callable[[], T],
    rows: Callable[[T], list[Row]] | None = None,
    section: str = "telemetry",
    fatal: tuple[type[SunspinError], ...] = (),
) -> Outcome[T]:
    """Return the outcome of a step: the result of `compute`, and the rows that `rows` returns for it.

    An error of `REPORTED` becomes the reason why the result is missing, but for the classes in `fatal`.
    """
    try:
        result = compute()
        return Outcome(key, title, section, result, tuple(rows(result)) if rows else ())
    except MissingResult as missing:
        return Outcome(key, title, section, error=missing.args[0], inherited=True)
    except REPORTED as error:
        if isinstance(error, fatal):
            raise
        return Outcome(key, title, section, error=error)


@dataclass(frozen=True)
class Step(Generic[T]):
    """A step that was submitted: its outcome when it has ended, and whether the study has been `stopped`."""

    future: Future[Outcome[T]]
    stopped: threading.Event

    @property
    def outcome(self) -> Outcome[T] | None:
        """Outcome of the step; None if it has not ended."""
        return self.future.result() if self.future.done() else None

    @property
    def result(self) -> T | None:
        """Result of the step; None if it has not ended or its result is missing."""
        return None if self.outcome is None else self.outcome.result

    def get(self) -> T:
        """Return the result to a later step, which waits for it. Raises `MissingResult` if it is missing."""
        if (result := self.get_if_computed()) is None:
            raise MissingResult(self.future.result().error)
        return result

    def get_if_computed(self) -> T | None:
        """Return the result to a later step, which waits for it; None if it is missing."""
        wait([self.future])
        if self.stopped.is_set():
            raise MissingResult(None)
        return self.future.result().result


class Steps:
    """Run steps in two threads, in the order in which they are submitted; a step takes results of steps before it only.

    When the context is left, no further step begins.
    """

    def __init__(self, workers: int | None = None) -> None:
        # the kernels of a step use all cores: more than two steps at a time would take memory and gain nothing
        self._pool = ThreadPoolExecutor(min(worker_count(workers), 2), thread_name_prefix="step")
        self._futures, self._stopped = list[Future[Any]](), threading.Event()

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
    ) -> Step[T]:
        """Return at once a step whose outcome is that of `run_step` with these arguments."""
        future = self._pool.submit(lambda: run_step(key, title, compute, rows, **about))
        self._futures.append(future)
        return Step(future, self._stopped)

    def as_they_end(self) -> Iterator[None]:
        """Yield each time a step has ended. Raises the error of a step that ends the study."""
        for future in as_completed(self._futures):
            future.result()
            yield
