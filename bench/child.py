"""The first scan in a process of its own. Prints one line of JSON."""

from __future__ import annotations

import json
import os
import sys
import time


def main(*counts: str) -> None:
    """Points of the grid along each axis."""
    from bench.problem import philae

    problem = philae()
    axes = problem.axes(*map(int, counts))
    problem.target_z  # noqa: B018  (read before the clock starts)
    start = time.perf_counter()
    problem.scan(axes)
    print(json.dumps({"scan_s": time.perf_counter() - start}))


if __name__ == "__main__":
    main(*sys.argv[1:])
    sys.stdout.flush()
    os._exit(0)  # what the interpreter does at its end is not measured
