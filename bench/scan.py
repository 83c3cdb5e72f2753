"""The scan against integrating its rows with heyoka and SciPy; how far its distances are from the reference's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import heyoka as hk
import numpy as np
from scipy.stats import wasserstein_distance

import sunspin as ss
from bench.baselines import Contestant, DormandPrince, TaylorBatch, TaylorScalar, on_cores
from bench.operations import operations_per_row
from bench.peak import FULL_S, QUICK_S, peak
from bench.problem import AXES, Problem, grid_sample, philae
from bench.table import Table
from bench.timing import cores, medians, say, timings
from sunspin.dynamics import ensemble as k
from sunspin.estimate.scan.mask import allows, reconstructible_mask

TOLERANCES = (1e-5, 1e-6, 1e-9)
"""heyoka's, per step: about what an EMD can bear, what directions good to 1e-3 need, and tight."""

SIZES = (1, 2, 4)
"""Batch sizes tried, in units of the one that heyoka recommends."""

SCIPY_RTOL = 1e-6
REFERENCE_STEP_S = 0.1
OURS = "sunspin scan, EMD to 1e-3"
DIRECTION_ERROR = 1e-5
OURS_DIRECTIONS = f"sunspin scan, directions to {DIRECTION_ERROR:g}"
COLUMNS = (
    "contestant",
    "cores",
    "in use",
    "rows",
    "us/row",
    "rows/s",
    "sunspin is faster by",
    "direction error, rad",
)


@dataclass(frozen=True)
class Entry:
    """A contestant: how to make one for a core, the states it is given, its batch size, the numbers of cores to try."""

    make: Callable[[], Contestant]
    starts: np.ndarray
    block: int
    teams: tuple[int, ...]


@dataclass(frozen=True)
class Size:
    """Repeats, and rows: in batches, one by one, with SciPy, for the direction's error, for the distance's error."""

    grid: tuple[int, int, int]
    repeats: int
    batch: int
    scalar: int
    scipy: int
    directions: int
    distances: int


FULL = Size((51, 51, 21), 5, 2048, 128, 4, 48, 40)
QUICK = Size((24, 24, 29), 1, 512, 32, 1, 8, 6)


def run(quick: bool) -> Table:
    """Rows per second, and the largest error of the Sun's direction at the end of the window."""
    problem, size = philae(), QUICK if quick else FULL
    axes = problem.axes(*size.grid)
    states = problem.starts(grid_sample(axes, size.batch))
    trials = {tol: batch_size_trial(problem, states, tol) for tol in TOLERANCES}
    entries = contestants(
        problem, axes, size, {tol: min(tried, key=tried.get) for tol, tried in trials.items()}
    )
    teams = tuple(sorted({cores(), 1}, reverse=True))
    work: dict[tuple[str, int], Callable] = {
        (OURS, n): lambda n=n: problem.scan(axes, workers=n) for n in teams
    }
    work |= {
        (OURS_DIRECTIONS, n): lambda n=n: problem.scan(axes, n, DIRECTION_ERROR) for n in teams
    }
    rows = dict.fromkeys((OURS, OURS_DIRECTIONS), int(np.prod(size.grid)))
    for name, entry in entries.items():
        rows[name] = len(entry.starts)
        for n in entry.teams:
            work[name, n] = on_cores([entry.make() for _ in range(n)], entry.starts, entry.block)
    say("scan: timing")
    times = timings(work, size.repeats)
    errors = direction_errors(problem, axes, entries, size.directions)
    errors[OURS_DIRECTIONS] = our_direction_error(problem, axes, size.directions)
    table = Table("scan", "initial rates of Philae followed over 45 minutes", COLUMNS)
    for (name, n), timing in times.items():
        per_row = timing.median / rows[name]
        ratio = timing.against(times[OURS, n]) * rows[OURS] / rows[name]
        table.add(
            name,
            n,
            timing.cores_used,
            rows[name],
            1e6 * per_row,
            1 / per_row,
            ratio,
            errors.get(name),
        )
    table.notes += [
        "sunspin's rows include mask, distribution and distance; the others' are the propagation only, which favours them.",
        *(
            f"us/row by batch size at tolerance {tol:g}, one core: {_line(tried)}"
            for tol, tried in trials.items()
        ),
        _distance_note(problem, axes, size.distances),
        _peak_note(problem, axes, times[OURS, 1].median / rows[OURS], quick),
    ]
    return table


def batch_size_trial(problem: Problem, starts: np.ndarray, tol: float) -> dict[int, float]:
    """Time per row (s) on one core for each batch size."""
    sizes = [hk.recommended_simd_size() * k for k in SIZES]
    say(f"scan: batch sizes {sizes} of heyoka at tolerance {tol:g}")
    part = starts[::2]
    work = {size: on_cores([TaylorBatch(problem, tol, size)], part) for size in sizes}
    return {size: seconds / len(part) for size, seconds in medians(work, 2).items()}


def _line(times: dict[int, float]) -> str:
    return ", ".join(f"{size}: {1e6 * seconds:.0f}" for size, seconds in times.items())


def contestants(
    problem: Problem, axes: dict[str, np.ndarray], size: Size, batch: dict[float, int]
) -> dict[str, Entry]:
    """All but sunspin, `batch` giving the batch size for each tolerance. The slow ones run on one core and fewer rows."""
    many, few, fewest = (
        problem.starts(grid_sample(axes, n)) for n in (size.batch, size.scalar, size.scipy)
    )
    teams = tuple(sorted({cores(), 1}, reverse=True))
    entries = {}
    for tol, lanes in batch.items():
        make = _maker(TaylorBatch, problem, tol, lanes)
        entries[f"heyoka {tol:g}, batches of {lanes}"] = Entry(make, many, lanes, teams)
    for tol in batch:
        entries[f"heyoka {tol:g}, one by one"] = Entry(
            _maker(TaylorScalar, problem, tol), few, 1, (1,)
        )
    entries[f"SciPy DOP853 {SCIPY_RTOL:g}"] = Entry(
        _maker(DormandPrince, problem, SCIPY_RTOL), fewest, 1, (1,)
    )
    return entries


def _maker(kind: Callable[..., Contestant], *arguments: object) -> Callable[[], Contestant]:
    return lambda: kind(*arguments)


def direction_errors(
    problem: Problem, axes: dict[str, np.ndarray], entries: dict[str, Entry], n: int
) -> dict[str, float]:
    """Largest error (rad) of the last direction over n random rows; contestants with few rows get fewer here too."""
    say(f"scan: directions of {n} rows against the reference")
    starts = problem.starts(grid_sample(axes, n, seed=2))
    reference = np.array([last_sun(problem, omega) for omega in problem.rates(starts)])
    errors = {}
    for name, entry in entries.items():
        some = slice(None, None, max(1, n // len(entry.starts)))
        gap = entry.make()(starts[some]).sun_B - reference[some]
        errors[name] = float(np.linalg.norm(gap, axis=1).max())
    return errors


def our_direction_error(problem: Problem, axes: dict[str, np.ndarray], n: int) -> float:
    """The same of the kernel, asked for DIRECTION_ERROR."""
    rates = grid_sample(axes, n, seed=2)
    rows = k.Rows(rates, np.tile(problem.sun_B, (n, 1)), np.tile(problem.wheel_speed_rad_s, (n, 1)))
    ends = k.run_rows(
        problem.vehicle, rows, problem.window_s, direction_error=DIRECTION_ERROR
    ).sun_B[:, 0]
    return float(
        max(
            np.linalg.norm(end - last_sun(problem, omega))
            for end, omega in zip(ends, rates, strict=True)
        )
    )


def _peak_note(problem: Problem, axes: dict[str, np.ndarray], per_row: float, quick: bool) -> str:
    operations = operations_per_row(problem, grid_sample(axes, 64 if quick else 512, seed=4))
    reached, roof = (
        operations / per_row / 1e9,
        peak("float32", seconds=QUICK_S if quick else FULL_S),
    )
    return (
        f"{operations:.3g} operations a row on one core: {reached:.0f} GFLOP/s, {100 * reached / roof:.0f} % of the measured peak "
        f"of fused multiply-adds in float32 ({roof:.0f})"
    )


def last_sun(problem: Problem, omega_B: np.ndarray) -> np.ndarray:
    """The reference's direction to the Sun (3) at the end of the window."""
    times = [0.0, problem.window_s]
    run = ss.propagate(problem.vehicle, omega_B, problem.sun_B, problem.wheel_speed_rad_s, times)
    return run["sun_B"].values[-1]


def _distance_note(problem: Problem, axes: dict[str, np.ndarray], n: int) -> str:
    say(f"scan: distances of {n} rows against the reference")
    largest = 0.0
    for omega in grid_sample(axes, n, seed=3):
        scanned = problem.scan(dict(zip(AXES, omega[:, None], strict=True)), workers=1).item()
        largest = max(largest, abs(scanned - reference_emd(problem, omega)))
    return (
        f"largest difference of EMD between the scan and the reference, {n} random rows: {largest:.2g} "
        f"(reference: heyoka, a sample each {REFERENCE_STEP_S:g} s, scipy.stats.wasserstein_distance)"
    )


def reference_emd(problem: Problem, omega_B: np.ndarray) -> float:
    """The scan's distance the long way: a densely sampled track, the mask as numpy, SciPy's distance."""
    times = np.linspace(0.0, problem.window_s, round(problem.window_s / REFERENCE_STEP_S) + 1)
    run = ss.propagate(
        problem.vehicle, omega_B, problem.sun_B, problem.wheel_speed_rad_s, times, rtol=1e-9
    )
    track = run["sun_B"].values
    seen = track[allows(reconstructible_mask(problem.vehicle), track), 2]
    return float(wasserstein_distance(seen, problem.target_z)) / 2
