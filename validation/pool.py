"""Cases in other processes under limits of time and memory, watched from here: one that hangs or crashes is a finding.

A suite is a class whose instances turn a case number into a finding or None. It is built in the worker, so that what it opens,
compiles and limits stays there; the number alone decides what the case is, and the seed.
"""

from __future__ import annotations

import multiprocessing as mp
import os
import resource
import signal
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

CPU_S = 5.0
"""A case that computes for longer hangs."""

WALL_S = 60.0
"""A case that waits for longer hangs: wall time alone would blame the case for a busy machine."""

POLL_S = 0.2
TICKS = os.sysconf("SC_CLK_TCK")


class Verdict(NamedTuple):
    """How a case ended ("fine", "refused", ...), whether that is a finding, and what to show of it."""

    what: str
    bad: bool = False
    shown: str = ""


@dataclass
class Report:
    """What became of all cases."""

    n: int
    counts: Counter = field(default_factory=Counter)
    findings: list[tuple[int, Verdict]] = field(default_factory=list)
    slowest_s: float = 0.0
    slowest: int = -1
    peak_MB: float = 0.0
    seconds: float = 0.0

    def take(self, index: int, verdict: Verdict, cpu_s: float) -> None:
        self.counts[verdict.what] += 1
        if verdict.bad:
            self.findings.append((index, verdict))
        if cpu_s > self.slowest_s:
            self.slowest_s, self.slowest = cpu_s, index


def limit_memory(more_bytes: int) -> None:
    """Let this process take so much address space beyond what it has."""
    with open("/proc/self/statm", encoding="ascii") as file:
        now = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + more_bytes, now + more_bytes))


def _cpu_s(pid: int) -> float:
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii") as file:
            fields = file.read().rsplit(")", 1)[1].split()
    except (OSError, IndexError):
        return 0.0
    return (int(fields[11]) + int(fields[12])) / TICKS


def _serve(suite: Callable[..., Any], options: dict[str, Any], numbers: Any, pipe: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.setsid()  # what it starts is ended with it
    try:
        with suite(**options) as case:
            pipe.send(("ready", None, 0.0, 0.0))
            while (index := numbers.recv()) is not None:
                begun = time.process_time()
                verdict = case(index)
                peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
                pipe.send((index, tuple(verdict), time.process_time() - begun, peak))
    except (EOFError, BrokenPipeError):
        pass


class _Worker:
    def __init__(self, suite: Callable[..., Any], options: dict[str, Any]) -> None:
        context = mp.get_context("spawn")
        theirs, self.numbers = context.Pipe(duplex=False)
        self.pipe, back = context.Pipe(duplex=False)
        self.process = context.Process(
            target=_serve, args=(suite, options, theirs, back), daemon=False
        )
        self.process.start()
        theirs.close()
        back.close()
        self.index: int | None = None
        self.ready = False

    def give(self, index: int | None) -> None:
        self.index, self.cpu, self.since = index, _cpu_s(self.process.pid), time.monotonic()
        self.numbers.send(index)

    def overdue(self, cpu_s: float) -> str | None:
        if self.index is None:
            return None
        used, waited = _cpu_s(self.process.pid) - self.cpu, time.monotonic() - self.since
        if used > cpu_s:
            return f"still computing after {used:.0f} s"
        return f"still waiting after {waited:.0f} s" if waited > WALL_S + cpu_s else None

    def kill(self) -> None:
        try:
            os.killpg(self.process.pid, signal.SIGKILL)
        except (ProcessLookupError, PermissionError):
            self.process.kill()
        self.process.join()


def run(
    suite: Callable[..., Any],
    n: int,
    *,
    first: int = 0,
    workers: int = 2,
    cpu_s: float = CPU_S,
    say: Any = None,
    **options: Any,
) -> Report:
    """All cases first .. first + n - 1 of a suite; `say` (a function of text) hears of findings as they come."""
    report, todo, begun = Report(n), iter(range(first, first + n)), time.monotonic()
    crew = [_Worker(suite, options) for _ in range(min(workers, n))]
    try:
        while crew:
            mp.connection.wait([worker.pipe for worker in crew], timeout=POLL_S)
            for worker in list(crew):
                heard = _heard(worker, cpu_s)
                if heard is None:
                    continue
                index, verdict, cpu, peak = heard
                if index is not None:
                    report.take(index, verdict, cpu)
                    report.peak_MB = max(report.peak_MB, peak)
                    if verdict.bad and say is not None:
                        say(f"case {index}: {verdict.what}: {verdict.shown}")
                if not worker.process.is_alive():
                    crew.remove(worker)
                    worker = _Worker(suite, options)
                    crew.append(worker)
                    continue
                if worker.ready and worker.index is None:
                    if (number := next(todo, None)) is None:
                        worker.give(None)
                        worker.process.join()
                        crew.remove(worker)
                    else:
                        worker.give(number)
    finally:
        for worker in crew:
            worker.kill()
    report.seconds = time.monotonic() - begun
    return report


def _heard(worker: _Worker, cpu_s: float) -> tuple[int | None, Verdict, float, float] | None:
    """News of a worker: (case, verdict, CPU time in s, peak in MB), case None when it has only begun; None: no news."""
    if worker.pipe.poll():
        try:
            index, verdict, cpu, peak = worker.pipe.recv()
        except EOFError:
            return _died(worker)
        if index == "ready":
            worker.ready = True
            return None, Verdict("ready"), 0.0, 0.0
        worker.index = None
        return index, Verdict(*verdict), cpu, peak
    if (late := worker.overdue(cpu_s)) is not None:
        index = worker.index
        worker.kill()
        return index, Verdict("hang", True, late), cpu_s, 0.0
    return None if worker.process.is_alive() else _died(worker)


def _died(worker: _Worker) -> tuple[int | None, Verdict, float, float]:
    worker.process.join()
    index, code = worker.index, worker.process.exitcode
    if not worker.ready:
        raise RuntimeError(f"a worker could not begin (exit code {code})")
    return index, Verdict("crash", True, f"the process ended with {code}"), 0.0, 0.0
