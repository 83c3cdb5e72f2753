"""The same scan on threads and on worker processes of a local Dask cluster."""

from __future__ import annotations

import time

import numpy as np

from bench.problem import Problem, philae
from bench.table import Table
from bench.timing import say
from sunspin.estimate.scan.volume import scan

GRID, QUICK_GRID = (101, 101, 21), (31, 31, 11)
COLUMNS = ("on", "workers", "rows", "s", "us of a core a row", "against one thread")


def run(quick: bool) -> Table:
    """Wall time of a scan by 1 and 2 threads and worker processes that have their kernels already."""
    table = Table("cluster", "threads and worker processes", COLUMNS)
    problem, first = philae(), None
    axes = problem.axes(*(QUICK_GRID if quick else GRID))
    n = int(np.prod([len(axis) for axis in axes.values()]))
    for kind in ("threads", "processes"):
        for workers in (1, 2):
            say(f"cluster: {workers} {kind}")
            seconds = timed(problem, axes, kind, workers)
            first = first or seconds
            table.add(kind, workers, n, seconds, 1e6 * seconds * workers / n, first / seconds)
    table.notes.append("on a machine with more to do than this, two workers gain less than here")
    return table


def timed(problem: Problem, axes: dict[str, np.ndarray], kind: str, workers: int) -> float:
    """Seconds of one scan, after a small one that has loaded libraries and kernels."""
    small = {name: axis[:: max(len(axis) // 6, 1)] for name, axis in axes.items()}
    if kind == "threads":
        go(problem, small, workers=workers)
        return go(problem, axes, workers=workers)
    from distributed import Client, LocalCluster

    options = {
        "n_workers": workers,
        "threads_per_worker": 1,
        "processes": True,
        "dashboard_address": None,
    }
    with LocalCluster(host="127.0.0.1", **options) as cluster, Client(cluster) as client:
        go(problem, small, scheduler=client)
        return go(problem, axes, scheduler=client)


def go(problem: Problem, axes: dict[str, np.ndarray], **where: object) -> float:
    start = time.perf_counter()
    scan(
        problem.vehicle,
        problem.target_z,
        problem.sun_B,
        *axes.values(),
        problem.wheel_speed_rad_s,
        problem.window_s,
        **where,
    )
    return time.perf_counter() - start
