"""The scan compared with integrating its rows by heyoka and SciPy, and its EMD compared with that of the reference integrator.

The other integrators only propagate. The scan also checks at each step whether the Sun can be reconstructed, and computes
distribution and distance, which favours the others.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import heyoka as hk
import numpy as np
from scipy.stats import wasserstein_distance

import sunspin as ss
from bench.accuracy import last_sun, states
from bench.baselines import Contestant, DormandPrince, TaylorBatch, on_cores
from bench.problem import AXES, Problem, grid_sample, philae
from bench.timing import Table, cores, timings
from sunspin.dynamics import batch
from sunspin.estimate.scan.directions import reconstructible_mask

TOLERANCES = (1e-5, 1e-6, 1e-9)
"""heyoka's tolerances per step: about what an EMD needs, what directions good to 1e-3 need, and a tight one."""

SCIPY_RTOL = 1e-6
REFERENCE_STEP_S = 0.1
DIRECTION_ERROR = 1e-5
OURS, OURS_DIRECTIONS = "ss.scan, EMD to 1e-3", f"ss.scan, directions to {DIRECTION_ERROR:g}"
COLUMNS = (
    "by",
    "cores",
    "in use",
    "rows",
    "us/row",
    "ss.scan is faster by",
    "direction error, rad",
)


class Entry(NamedTuple):
    """An integrator in the table: function that makes it, states that it propagates, rows in a block, numbers of threads."""

    make: Callable[[], Contestant]
    starts: np.ndarray
    block: int
    teams: tuple[int, ...]


def run(quick: bool) -> Table:
    """Measure the time of a row, and the largest error of the Sun direction at the end of the window."""
    problem, repeats = philae(), 1 if quick else 5
    n_judged = 8 if quick else 48  # motions whose final direction is compared with the reference
    axes = problem.axes(*((24, 24, 29) if quick else (51, 51, 21)))
    many = problem.starts(grid_sample(axes, 512 if quick else 2048))
    lanes = hk.recommended_simd_size()
    teams = tuple(sorted({cores(), 1}, reverse=True))  # numbers of threads
    entries = {
        f"heyoka {tol:g}, batches of {lanes}": Entry(
            partial(TaylorBatch, problem, tol, lanes), many, lanes, teams
        )
        for tol in TOLERANCES
    }
    few = problem.starts(grid_sample(axes, 1 if quick else 4))
    entries[f"SciPy DOP853 {SCIPY_RTOL:g}"] = Entry(
        partial(DormandPrince, problem, SCIPY_RTOL), few, 1, (1,)
    )

    work: dict[tuple[str, int], Callable] = {}
    rows = dict.fromkeys(
        (OURS, OURS_DIRECTIONS), int(np.prod([len(axis) for axis in axes.values()]))
    )
    for n in teams:
        work[OURS, n] = partial(problem.scan, axes, n)
        work[OURS_DIRECTIONS, n] = partial(problem.scan, axes, n, DIRECTION_ERROR)
    errors = {OURS_DIRECTIONS: our_direction_error(problem, axes, n_judged)}
    for name, entry in entries.items():
        rows[name] = len(entry.starts)
        for n in entry.teams:
            # an integrator for each thread, as they keep their state
            team = [entry.make() for _ in range(n)]
            work[name, n] = on_cores(team, entry.starts, entry.block)
        sample = problem.starts(grid_sample(axes, min(n_judged, len(entry.starts)), seed=2))
        reference = last_suns(problem, problem.rates(sample))
        error = np.linalg.norm(entry.make()(sample).sun_B - reference, axis=1)
        errors[name] = float(error.max())

    times = timings(work, repeats)
    table = Table("scan: initial rates of Philae followed over 45 minutes", COLUMNS)
    for (name, n), timing in times.items():
        ratio = timing.against(times[OURS, n]) * rows[OURS] / rows[name]
        cells = rows[name], 1e6 * timing.median / rows[name], ratio, errors.get(name)
        table.rows.append((name, n, timing.cores_used, *cells))
    omegas = grid_sample(axes, 6 if quick else 40, seed=3)
    largest = max(
        abs(scanned_emd(problem, omega) - reference_emd(problem, omega)) for omega in omegas
    )
    table.notes.append(
        f"Largest difference of EMD between the scan and the reference over {len(omegas)} rows: {largest:.2g} "
        f"(heyoka, a sample each {REFERENCE_STEP_S:g} s, scipy.stats.wasserstein_distance)."
    )
    return table


def our_direction_error(problem: Problem, axes: dict[str, np.ndarray], n: int) -> float:
    """Return the largest error (rad) of the kernel's last direction over n random rows, for a requested DIRECTION_ERROR."""
    rates = grid_sample(axes, n, seed=2)
    rows = states(problem.sun_B, rates, problem.wheel_speed_rad_s)
    ends = batch.run(problem.vehicle, rows, problem.window_s, error=DIRECTION_ERROR)
    error = ends.sun_B[:, 0] - last_suns(problem, rates)
    return float(np.linalg.norm(error, axis=1).max())


def last_suns(problem: Problem, omega_B: np.ndarray) -> np.ndarray:
    """Return the reference's Sun directions (n, 3) at the end of the window, from rates (n, 3)."""
    rows = states(problem.sun_B, omega_B, problem.wheel_speed_rad_s)
    return np.array(
        [last_sun(problem.vehicle, rows, i, problem.window_s) for i in range(len(rows))]
    )


def scanned_emd(problem: Problem, omega_B: np.ndarray) -> float:
    """Return the scan's EMD of one motion."""
    return problem.scan(dict(zip(AXES, omega_B[:, None], strict=True)), workers=1).item()


def reference_emd(problem: Problem, omega_B: np.ndarray) -> float:
    """Return the EMD of one motion from a densely sampled track, with numpy's mask and SciPy's distance."""
    times = np.linspace(0.0, problem.window_s, round(problem.window_s / REFERENCE_STEP_S) + 1)
    start = problem.vehicle, omega_B, problem.sun_B, problem.wheel_speed_rad_s
    track = ss.propagate(*start, times, rtol=1e-9)["sun_B"].values
    seen = track[reconstructible_mask(problem.vehicle).contains(track), 2]
    return float(wasserstein_distance(seen, problem.target_z)) / 2
