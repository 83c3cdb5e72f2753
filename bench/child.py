"""What has to be measured in a process of its own: peak memory and the first scan. Prints one line of JSON."""

from __future__ import annotations

import json
import os
import sys
import time

BEGAN = time.perf_counter()


def main(what: str, *counts: str) -> None:
    """`growth` or `first`, then the points of the grid along each axis."""
    from bench.problem import philae

    problem = philae()
    axes = problem.axes(*map(int, counts))
    problem.target_z  # noqa: B018  (read before the clock starts)
    if what == "growth":
        problem.scan(problem.axes(2, 2, 2))
        before = _peak_mb()
    start = time.perf_counter()
    volume = problem.scan(axes)
    now = time.perf_counter()
    told = {"scan_s": now - start, "since_start_s": now - BEGAN, "rows": volume.size}
    if what == "growth":
        result_mb = (volume.nbytes + volume["outcome"].nbytes) / 1e6
        told |= {"before_MB": before, "peak_MB": _peak_mb(), "result_MB": result_mb}
    print(json.dumps(told))


def _peak_mb() -> float:
    """Largest resident memory so far; Linux counts in KiB, macOS in bytes."""
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6


if __name__ == "__main__":
    main(*sys.argv[1:])
    sys.stdout.flush()
    os._exit(0)  # what the interpreter does at its end is not measured
