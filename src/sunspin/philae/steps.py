"""Steps of the study: each runs in a thread, waits for the results that it takes, and ends with a result or the reason for none."""

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

WAITING = 32
"""Number of threads: as many steps can wait for others or compute."""


@dataclass(frozen=True)
class Outcome(Generic[T]):
    """A step that has ended, with its result and rows, or with the error because of which it has none.

    `key`: name of the step in `missing` of `summary.json`. `section`: a key of `study.SECTIONS`. If `inherited`, `error` was raised
    by another step, on which this one rests. A step that was not begun has neither result nor error.
    """

    key: str
    title: str
    section: str = "telemetry"
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
    """A step that runs in a thread. Other steps take its result by `get` or `get_if_computed`, which wait until it has ended.

    `computing` and `stopped` are those of :class:`Steps`.
    """

    future: Future[Outcome[T]]
    computing: threading.Semaphore
    stopped: threading.Event

    @property
    def outcome(self) -> Outcome[T] | None:
        """Outcome of the step; None if it has not ended, or ended the study."""
        ended = self.future.done() and self.future.exception() is None
        return self.future.result() if ended else None

    @property
    def result(self) -> T | None:
        """Result of the step; None if it has not ended or its result is missing."""
        return None if self.outcome is None else self.outcome.result

    def get(self) -> T:
        """Return the result to another step. Raises `MissingResult` if it is missing."""
        outcome = self._wait()
        if outcome.result is None:
            raise MissingResult(outcome.error)
        return outcome.result

    def get_if_computed(self) -> T | None:
        """Return the result to another step; None if it is missing."""
        return self._wait().result

    def _wait(self) -> Outcome[T]:
        """Return the outcome when the step has ended; while this thread waits, another step may compute in its place."""
        if not self.future.done():
            self.computing.release()
            wait([self.future])
            self.computing.acquire()
        if self.stopped.is_set():
            raise MissingResult(None)
        return self.future.result()


class Steps:
    """Run steps in threads, two at a time. When the context is left, no further step begins."""

    def __init__(self, workers: int | None = None) -> None:
        self._steps: list[Step[Any]] = []
        self._pool = ThreadPoolExecutor(WAITING, thread_name_prefix="step")
        # the kernels of a step use all cores: more than two steps at a time would take memory and gain nothing
        self._computing = threading.Semaphore(min(worker_count(workers), 2))
        self._stopped = threading.Event()

    def __enter__(self) -> Steps:
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._pool.shutdown(wait=False)

    def run(
        self,
        key: str,
        title: str,
        compute: Callable[[], T],
        rows: Callable[[T], list[Row]] | None = None,
        **about: Any,
    ) -> Step[T]:
        """Return at once a step whose outcome is that of `run_step` with these arguments."""

        def run_in_turn() -> Outcome[T]:
            """Run the step when at most one other computes, unless the study has ended."""
            with self._computing:
                if self._stopped.is_set():
                    return Outcome(key, title)
                try:
                    return run_step(key, title, compute, rows, **about)
                except BaseException:
                    self._stopped.set()
                    raise

        step = Step(self._pool.submit(run_in_turn), self._computing, self._stopped)
        self._steps.append(step)
        return step

    def as_they_end(self) -> Iterator[None]:
        """Yield each time a step has ended. Raises the error of a step that ends the study."""
        for future in as_completed([step.future for step in self._steps]):
            future.result()
            yield

    def outcomes(self) -> list[Outcome[Any]]:
        """Return the outcomes of the steps that have ended so far, in the order in which they were submitted."""
        return [step.outcome for step in self._steps if step.outcome is not None]
