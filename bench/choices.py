"""What decided the kernel's settings: each moved alone, its error and its cost, on random motions of the paper's grid."""

from __future__ import annotations

from contextlib import ExitStack
from unittest.mock import patch

import numpy as np

import sunspin as ss
from bench.accuracy import last_sun, states
from bench.problem import grid_sample, philae
from bench.table import Table
from bench.timing import medians, say
from sunspin.dynamics import ensemble as k
from sunspin.dynamics.ensemble import compiled, series_lanes, steps, tolerance
from sunspin.estimate.scan.rows import BINS, distances_to, target_segments

NODE_ANGLES = (0.45, 0.9, 1.3, 1.8)
PHASE_ERRORS = (0.02, 0.1, 0.5)
ORDERS = (8, 10, 12, 14, 18)
COLUMNS = ("setting", "value", "median error", "largest error", "us/row")


def run(quick: bool) -> Table:
    """EMD error against the spacing of nodes and the phase allowed; direction error (rad) against the order of the series."""
    n = 32 if quick else 512
    problem = philae()
    rows = states(
        problem.sun_B, grid_sample(problem.axes(101, 101, 41), n, seed=9), problem.wheel_speed_rad_s
    )
    table = Table("choices", "settings of the kernel, moved one at a time", COLUMNS)
    say("choices: reference distances")
    exact = np.array([distance(problem, rows, i) for i in range(n)])
    for name, values in (("NODE_ANGLE", NODE_ANGLES), ("PHASE_ERROR", PHASE_ERRORS)):
        for value in values[1:3] if quick else values:
            with (
                patch.object(tolerance, name, value),
                patch.object(steps, "NODE_ANGLE", value if name == "NODE_ANGLE" else 0.9),
            ):
                table.add(name, value, *of_distributions(problem, rows, exact, 1 if quick else 3))
    ends = np.array([last_sun(problem.vehicle, rows, i, problem.window_s) for i in range(n)])
    for order in ORDERS[3:4] if quick else ORDERS:
        say(f"choices: order {order}")
        with ExitStack() as changed:
            for module in (series_lanes, steps):
                changed.enter_context(patch.object(module, "ORDER", order))
            compiled.kernel.cache_clear()
            table.add("ORDER", order, *of_directions(problem, rows, ends, 1 if quick else 3))
    compiled.kernel.cache_clear()
    table.notes.append(
        "EMD error for the first two, asked 1e-3; direction error (rad) at the end for ORDER, asked 1e-5"
    )
    return table


def distance(problem, rows: k.Rows, i: int) -> float:
    """EMD of row i to the measured r_z, by 2^15 samples of the reference and SciPy."""
    times = np.linspace(0.0, problem.window_s, 2**15)
    track = ss.propagate(
        problem.vehicle, rows.omega_B[i], rows.sun_B[i], rows.wheel_speed_rad_s[i], times
    )
    return ss.emd(track["sun_B"].values[:, 2], problem.target_z)


def of_distributions(
    problem, rows: k.Rows, exact: np.ndarray, repeats: int
) -> tuple[float, float, float]:
    """Median and largest EMD error, microseconds of a core a row."""

    def go() -> np.ndarray:
        return k.run_rows(problem.vehicle, rows, problem.window_s, emd_error=1e-3, bins=BINS).hist

    found, _ = distances_to(go(), target_segments(problem.target_z))
    error = np.abs(found - exact)
    return (
        float(np.median(error)),
        float(error.max()),
        1e6 * medians({"run": go}, repeats)["run"] / len(rows),
    )


def of_directions(
    problem, rows: k.Rows, exact: np.ndarray, repeats: int
) -> tuple[float, float, float]:
    """Median and largest direction error, microseconds of a core a row."""

    def go() -> np.ndarray:
        return k.run_rows(problem.vehicle, rows, problem.window_s, direction_error=1e-5).sun_B[:, 0]

    error = np.linalg.norm(go() - exact, axis=1)
    return (
        float(np.median(error)),
        float(error.max()),
        1e6 * medians({"run": go}, repeats)["run"] / len(rows),
    )
