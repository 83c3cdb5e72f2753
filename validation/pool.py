"""Run cases in other processes under limits of time and memory: a hang or a crash is a finding, and the other cases continue.

A suite turns a case number into a verdict; number and seed alone determine the case. The suite is built in the process that runs
its cases, so that everything it opens, compiles and limits stays there.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import resource
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple, Self

CPU_S = 5.0
"""CPU time (s) after which a case counts as hanging."""

WALL_S = 60.0
"""Wall time (s) after which a case counts as hanging: a shorter time would blame the case for a busy machine."""

MORE_MEMORY = 2 * 1024**3
"""Address space (bytes) that a case may use in addition to that of the imports."""


class Verdict(NamedTuple):
    """Result of a case: one word ("fine", "refused", ...), whether that is a finding, and a text to show."""

    what: str
    bad: bool = False
    shown: str = ""


class Suite:
    """Function from case number to verdict. A context manager, as it makes files; `last` describes the last case."""

    last: object = ""

    def __init__(
        self, seed: int = 0, memory: int | None = MORE_MEMORY, only: str | None = None
    ) -> None:
        self.seed, self.memory, self.only = seed, memory, only

    def __enter__(self) -> Self:
        self.stack = ExitStack()
        home = tempfile.TemporaryDirectory(prefix="validation-")
        self.home = Path(self.stack.enter_context(home))
        self.stack.callback(os.chdir, os.getcwd())
        self.prepare()
        if self.memory is not None:
            # address space in use now, in pages
            pages = int(Path("/proc/self/statm").read_text("ascii").split()[0])
            limit = pages * resource.getpagesize() + self.memory
            resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        return self

    def __exit__(self, *exception: object) -> None:
        self.stack.close()

    def prepare(self) -> None:
        """Make everything that all cases share; `stack` undoes it."""
        raise NotImplementedError

    def __call__(self, index: int) -> Verdict:
        """Run one case."""
        raise NotImplementedError


@dataclass
class Report:
    """Results of all cases."""

    n: int
    counts: Counter = field(default_factory=Counter)
    findings: list[tuple[int, Verdict]] = field(default_factory=list)
    slowest_s: float = 0.0
    slowest: int = -1
    peak_MB: float = 0.0
    seconds: float = 0.0

    def take(self, index: int, verdict: Verdict, cpu_s: float, peak_MB: float) -> None:
        """Add the result of a case."""
        self.counts[verdict.what] += 1
        if verdict.bad:
            self.findings.append((index, verdict))
        if cpu_s > self.slowest_s:
            self.slowest_s, self.slowest = cpu_s, index
        self.peak_MB = max(self.peak_MB, peak_MB)


def _serve(suite: Callable[..., Any], options: dict[str, Any], pipe: Any, cpu_s: float) -> None:
    """Run the cases whose numbers come through the pipe, and send verdict, processor time (s) and peak memory (MB) of each.

    None as a number ends the process. The kernel ends it if a case computes for longer than `cpu_s`.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.setsid()  # what it starts is ended with it
    with suite(**options) as case:
        pipe.send("ready")
        while (index := pipe.recv()) is not None:
            begun = time.process_time()
            # the limit counts all time of the process, earlier cases included
            _, hard_limit = resource.getrlimit(resource.RLIMIT_CPU)
            resource.setrlimit(resource.RLIMIT_CPU, (int(begun + cpu_s) + 1, hard_limit))
            verdict = case(index)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            pipe.send((tuple(verdict), time.process_time() - begun, peak))


class _Worker:
    """A process that runs a suite. Raises `RuntimeError` if the suite cannot be built there."""

    def __init__(self, suite: Callable[..., Any], options: dict[str, Any], cpu_s: float) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, child = context.Pipe()
        arguments = suite, options, child, cpu_s
        self.process = context.Process(target=_serve, args=arguments, daemon=False)
        self.process.start()
        child.close()
        try:
            self.pipe.recv()
        except EOFError:
            self.process.join()
            raise RuntimeError(
                f"a worker could not begin (exit code {self.process.exitcode})"
            ) from None

    def run(self, index: int) -> tuple[Verdict, float, float] | None:
        """Return verdict, processor time (s) and peak memory (MB) of a case; None if the process did not survive it, see `end`."""
        try:
            self.pipe.send(index)
            if self.pipe.poll(WALL_S):
                verdict, cpu_s, peak = self.pipe.recv()
                return Verdict(*verdict), cpu_s, peak
        except (EOFError, BrokenPipeError, ConnectionResetError):
            pass
        return None

    def end(self) -> Verdict:
        """Kill the process if it still runs, and return the verdict on its case."""
        self.process.join(0.5)
        code = self.process.exitcode
        if code is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.join()
            return Verdict("hang", True, f"still waiting after {WALL_S:.0f} s")
        if code == -signal.SIGXCPU:
            return Verdict("hang", True, "computes for too long")
        return Verdict("crash", True, f"the process ended with {code}")


def run(
    suite: Callable[..., Any],
    n: int,
    *,
    first: int = 0,
    workers: int = 2,
    cpu_s: float = CPU_S,
    say: Callable[[str], None] | None = None,
    **options: Any,
) -> Report:
    """Run cases first .. first + n - 1 of a suite in worker processes and return the report.

    `cpu_s` limits the processor time of a case; `options` are those of the suite; `say` is called with each finding.
    """
    report, numbers, begun = Report(n), SimpleQueue[int](), time.monotonic()
    for index in range(first, first + n):
        numbers.put(index)

    def work() -> None:
        """Run cases in a worker until there are no more."""
        worker = None
        try:
            while True:
                index = numbers.get_nowait()
                worker = worker or _Worker(suite, options, cpu_s)
                result = worker.run(index)
                if result is None:  # the process is lost; the next case gets a new one
                    result, worker = (worker.end(), cpu_s, 0.0), None
                report.take(index, *result)
                verdict = result[0]
                if verdict.bad and say is not None:
                    say(f"case {index}: {verdict.what}: {verdict.shown}")
        except Empty:  # no more numbers
            pass
        finally:
            if worker is not None:
                worker.pipe.send(None)
                worker.process.join()

    with ThreadPoolExecutor(workers) as threads:
        for done in [threads.submit(work) for _ in range(min(workers, n))]:
            done.result()
    report.seconds = time.monotonic() - begun
    return report


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options that campaigns of cases share."""
    parser.add_argument("--n", type=int, default=1000, help="cases")
    parser.add_argument("--seed", type=int, default=0)
    first = "number of the first case: --first I --n 1 repeats one"
    parser.add_argument("--first", type=int, default=0, help=first)
    parser.add_argument("--workers", type=int, default=2, help="processes")
    here = "in this process, without limits, and say what each case is"
    parser.add_argument("--here", action="store_true", help=here)


def main(suite: type[Suite], arguments: argparse.Namespace) -> int:
    """Run the requested cases and print the results; return 1 if there are findings, always 0 for cases in this process."""
    suite_options = {"seed": arguments.seed, "only": arguments.only}
    if arguments.here:
        with suite(memory=None, **suite_options) as case:
            for index in range(arguments.first, arguments.first + arguments.n):
                begun, verdict = time.process_time(), case(index)
                shown = verdict.shown or getattr(getattr(case, "result", None), "err", "")
                took = time.process_time() - begun
                print(f"case {index}: {verdict.what}, {took:.1f} s: {case.last}\n{shown}")
        return 0
    report = run(
        suite,
        arguments.n,
        first=arguments.first,
        workers=arguments.workers,
        say=print,
        **suite_options,
    )
    counts = ", ".join(f"{n} {what}" for what, n in report.counts.most_common())
    print(f"{report.n} cases in {report.seconds:.0f} s: {counts}")
    slowest = f"slowest {report.slowest_s:.1f} s of CPU (case {report.slowest})"
    print(f"{slowest}, largest process {report.peak_MB:.0f} MB; {len(report.findings)} findings")
    return int(bool(report.findings))
