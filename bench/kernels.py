"""Nanoseconds that each part of the kernels of motion takes for one lane, against limits.

LLVM's vectoriser decides the speed of these loops, and a harmless edit can cost a factor of three. The limits are about twice
the times of a busy Xeon with AVX-512; a part above its limit is marked.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from bench.timing import Table
from sunspin.dynamics.kernels import flow, histogram, nodes, rows, split, wheels
from sunspin.dynamics.kernels.rows import L
from sunspin.dynamics.processor import njit

ORDER = 17

LIMITS_NS = {
    "series": 400.0,
    "length of the step": 12.0,
    "bound on events": 40.0,
    "state": 40.0,
    "state at a node": 40.0,
    "node": 15.0,
    "way and bins": 50.0,
    "split step": 45.0,
}


@njit
def repeat_series(count, lanes):
    """Write the series `count` times."""
    for _ in range(count):
        flow.write_series(lanes, 1, ORDER, 0, False)


@njit
def repeat_longest(count, lanes):
    """Write the lengths of steps."""
    for _ in range(count):
        flow.write_share(lanes, ORDER)


@njit
def repeat_watch(count, lanes):
    """Write the bounds on events."""
    margin = np.zeros(L)
    for _ in range(count):
        wheels.are_watched(lanes, 1, ORDER, margin)


@njit
def repeat_move(count, lanes):
    """Advance the state."""
    for _ in range(count):
        flow.move(lanes, ORDER, 7)


@njit
def repeat_state(count, lanes, work):
    """Write the states at a node."""
    for _ in range(count):
        nodes.write_state_at(lanes, work, 1, ORDER, 0.5)


@njit
def repeat_node(count, lanes, work):
    """Write a node."""
    for _ in range(count):
        nodes.write_node(
            lanes, work, 1, work.at[histogram.NODE : histogram.NODE + histogram.PER_NODE]
        )


@njit
def repeat_way(count, work):
    """Add a way to the histograms."""
    for _ in range(count):
        histogram.add_way(work, 0)


@njit
def repeat_split(count, lanes, work):
    """Take steps of the split kernel."""
    for _ in range(count):
        split.take_step(lanes, work.at, 1)


def run(quick: bool) -> Table:
    """Measure every part on numbers of the usual size."""
    random = np.random.default_rng(0).random
    orders = 4 * ((ORDER + 3) // 4) + 2
    c = 1e-3 * (0.3 + 0.3 * random((orders, rows.ROWS * L)))
    c[ORDER + 1 :] = 0.0
    lanes = rows.Lanes(
        c,
        0.3 + 0.3 * random(rows.ROWS * L),
        0.1 + 0.1 * random(rows.NUMBERS * L),
        0.1 + 0.1 * random(rows.WHEELS * rows.PER_WHEEL),
        0.1 * random(rows.STATE_ROWS * L),
        np.zeros(L),
        np.zeros(6 * L),
        np.zeros(rows.ROWS * L),
        np.zeros(orders),
        np.zeros(rows.ROWS * L),
    )
    normals = np.array([[0.6, 0.8, 0.0], [0.0, 0.6, 0.8], [0.8, 0.0, 0.6], [0.5, 0.5, 0.7]])
    work = histogram.new_nodes(normals, np.array([2, 4]), 0.9, 256)
    work.at[:] = 0.3 * random(len(work.at))
    work.state[:] = 0.3 * random(len(work.state))
    fast = split.new_lanes()
    fast.w[:] = 0.1 * random(len(fast.w))
    fast.u[:] = 0.1 + 0.1 * random(len(fast.u))
    parts: dict[str, tuple[Callable[..., Any], tuple[Any, ...]]] = {
        "series": (repeat_series, (lanes,)),
        "length of the step": (repeat_longest, (lanes,)),
        "bound on events": (repeat_watch, (lanes,)),
        "state": (repeat_move, (lanes,)),
        "state at a node": (repeat_state, (lanes, work)),
        "node": (repeat_node, (lanes, work)),
        "way and bins": (repeat_way, (work,)),
        "split step": (repeat_split, (fast, work)),
    }
    table = Table("kernels: time of one lane", ("part", "ns", "limit", "within"))
    count, repeats = (500, 3) if quick else (3000, 7)
    for name, (function, given) in parts.items():
        function(1, *given)
        best = np.inf
        for _ in range(repeats):
            begin = time.thread_time()
            function(count, *given)
            best = min(best, (time.thread_time() - begin) / count / L * 1e9)
        table.rows.append((name, best, LIMITS_NS[name], "yes" if best < LIMITS_NS[name] else "NO"))
    return table
