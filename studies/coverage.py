"""How often the paper's method finds the truth: it is repeated on simulated rebounds (twins) whose rates are known.

    python -m studies.coverage OUT

The direction at the first sample is the published one; sample times, noise and panel misalignments are drawn as for the synthetic
telemetry of the case. Each twin is scanned on the paper's grid. OUT keeps a file for each twin, so that the same command goes on
where it stopped, and holds the table, the picture and `worth.json`, which `sunspin reproduce` reads from the folder of the case.
"""

from __future__ import annotations

import argparse
import json
import sys
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sunspin.base.provenance import version
from sunspin.compute.campaign import command, kept, rows_folder
from sunspin.compute.rows import ensemble
from sunspin.dynamics.ensemble import Outcome, Rows
from sunspin.dynamics.propagate import propagate
from sunspin.estimate.scan.lines import distances, point_at
from sunspin.estimate.scan.table import Table, make_table
from sunspin.philae import coverage
from sunspin.philae import rebound as rb
from sunspin.philae.carries import LEAST_DIRECTIONS
from sunspin.philae.figures.coverage import draw
from sunspin.philae.threshold import CONFIDENCE, check_confidence, holding, reached
from sunspin.philae.twin_philae import CELL_W, drawn_panels, keep_direction, rebound_times
from sunspin.telemetry.case import Case, load_case
from sunspin.telemetry.sun import is_reconstructed, sun_directions
from sunspin.telemetry.synthetic import noisy_power

FACTOR = 1.1
"""Of the near-minimum set (paper, eq. 14)."""

LEVELS = np.round(np.arange(0.005, 0.1505, 0.001), 3)
"""Thresholds on EMD at which the size of the set and its smallest speed are kept."""

FACTORS = np.round(np.geomspace(1.05, 12.0, 80), 4)
"""The same as multiples of the smallest EMD."""

LINE_STEPS = 51
"""Points of a fitted line whose speed at the touchdown is computed."""


class Grid(NamedTuple):
    """The scan that all twins share, and the speed (n) in rad/s of each of its motions at the touchdown."""

    case: Case
    table: Table
    speed: np.ndarray


def make_grid(case: Case, coarser: int) -> Grid:
    """Run every motion of the grid once."""
    speeds, mask = rb.nominal_speed(case.vehicle), rb.counted(case) and "reconstructible"
    scan = case.vehicle, rb.first_sun(case), rb.grid(case, coarser), speeds, rb.window_s(case)
    table = make_table(*scan, mask=mask)
    back = rb.speeds_back(case, table.rows.start, rb.after_touchdown_s(case))
    return Grid(case, table, ensemble(back)["speed"])


def twin(grid: Grid, kind: str, number: int, seed: int) -> dict[str, Any]:
    """A twin of this kind, its scan, and what the method makes of it."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    case, z = grid.case, np.array([])
    while z.size < LEAST_DIRECTIONS:
        truth = true_rate(case, kind, rng)
        z = measured_z(case, truth, rng)
    volume = grid.table.volume(z)
    emd = np.where(grid.table.outcome == Outcome.FINE, volume.values.ravel(), np.inf)
    smallest = float(emd.min())
    order = np.argsort(emd, kind="stable")
    slowest = np.minimum.accumulate(grid.speed[order])
    sets = {}
    for name, limits in (("level", LEVELS), ("factor", FACTORS * smallest)):
        count = np.searchsorted(emd[order], limits, side="left")
        speed = np.where(count > 0, slowest[np.maximum(count, 1) - 1], np.nan)
        sets |= {f"{name}_count": count.tolist(), f"{name}_speed": speed.tolist()}
    setup = case.vehicle, rows_of(case, truth[None]), rb.window_s(case), rb.counted(case)
    near = rb.families(case, volume, FACTOR, seed=0)
    return {
        "truth_touchdown_speed": float(speeds_at_touchdown(case, truth[None])[0]),
        "n_told": z.size,
        "emd_min": smallest,
        "emd_truth": float(reached(*setup, [(z, None)])[0]),
        "points": len(near.points),
        "truth_to_set": float(np.linalg.norm(near.points - truth, axis=1).min()),
        "bound_set": float(grid.speed[emd < FACTOR * smallest].min()),
        **lines(case, near, truth),
        **sets,
    }


def true_rate(case: Case, kind: str, rng: np.random.Generator) -> np.ndarray:
    """A rate (3) in rad/s at the first sample."""
    if kind == "grid":
        return rng.uniform(*box(case).T)
    published = rb.published_lines(case)
    point, direction = published[int(rng.integers(len(published)))]
    return point_at(point, direction, 2, np.array([rng.uniform(*rb.LINE_RANGE)]))[0]


def measured_z(case: Case, truth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The z components (n) of the directions that the simulated readings of this motion give."""
    vehicle = case.vehicle
    t = rebound_times(case, rng)
    tilt, first = drawn_panels(vehicle, rb.first_sun(case), rng)
    run = propagate(vehicle, truth, first, rb.nominal_speed(vehicle), t - t[0], rtol=1e-9)
    true = run["sun_B"].values
    exact = CELL_W * vehicle.response_in().power(true, tilt=tilt)
    power = noisy_power(vehicle, exact, vehicle.require_noise(), rng)
    power[0] = keep_direction(vehicle, true[0], exact[0], power[0])
    sun = sun_directions(vehicle, power)
    return sun["sun_B"].values[is_reconstructed(sun["status"]), 2]


def lines(case: Case, near: rb.Families, truth: np.ndarray) -> dict[str, Any]:
    """The lines fitted to the near-minimum set: how far from the truth and the published lines, smallest speed."""
    nan, four = float("nan"), [float("nan")] * 4
    if near.lines is None:  # too few points
        return dict(truth_to_line=nan, line_angle=four, line_distance=four, bound_lines=nan)
    points, directions = near.lines["point"].values, near.lines["direction"].values
    limits, starts = box(case), []
    for point, direction in zip(points, directions, strict=True):
        reach = np.linalg.norm(np.ptp(limits, axis=1)) + np.linalg.norm(point - limits.mean(axis=1))
        along = point + np.linspace(-reach, reach, 4001)[:, None] * direction
        inside = along[np.all((along >= limits[:, 0]) & (along <= limits[:, 1]), axis=1)]
        if len(inside):
            starts.append(inside[np.linspace(0, len(inside) - 1, LINE_STEPS).round().astype(int)])
    speeds = speeds_at_touchdown(case, np.concatenate(starts)) if starts else [np.nan]
    return {
        "truth_to_line": float(distances(truth[None], points, directions).min()),
        "line_angle": [apart["angle_rad"] for apart in near.deviation],
        "line_distance": [apart["mean"] for apart in near.deviation],
        "bound_lines": float(np.min(speeds)),
    }


def box(case: Case) -> np.ndarray:
    """Ends (3, 2) of the scanned range in rad/s."""
    return np.array([case.published[f"scan_omega_{axis}"].value for axis in "xyz"])


def rows_of(case: Case, omega_B: np.ndarray) -> Rows:
    """States with these rates (n, 3) at the first sample."""
    n, speeds = len(omega_B), np.array(rb.nominal_speed(case.vehicle), dtype=np.float64)
    return Rows(omega_B, np.tile(rb.first_sun(case), (n, 1)), np.tile(speeds, (n, 1)))


def speeds_at_touchdown(case: Case, omega_B: np.ndarray) -> np.ndarray:
    """Angular speeds (n) in rad/s at the first touchdown of motions with these rates (n, 3) at the first sample."""
    back = rb.run_back(case, rows_of(case, omega_B), rb.after_touchdown_s(case))
    return np.linalg.norm(back, axis=1)


def condensed(twins: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """All twins of a kind as `worth.json` has them: what is known of each, and quantiles over the twins for each threshold."""
    each = {name: np.array([row[name] for row in twins], dtype=float) for name in twins[0]}
    parts, quantiles = {}, (0.05, 0.5, 0.95)
    for name, at in (("level", LEVELS), ("factor", FACTORS)):
        count, speed = each.pop(f"{name}_count"), each.pop(f"{name}_speed")
        speed = np.where(np.isnan(speed), np.inf, speed)  # an empty set is a bound that fails
        parts[f"{name}s"] = {
            "at": at,
            "count": np.quantile(count, quantiles, axis=0).T,
            "speed": np.quantile(speed, quantiles, axis=0, method="higher").T,
            "holds": (speed <= each["truth_touchdown_speed"][:, None]).sum(axis=0),
        }
    return {
        part: {name: digits(values) for name, values in arrays.items()}
        for part, arrays in ({"twin": each} | parts).items()
    }


def digits(values: np.ndarray) -> list[Any]:
    """Numbers with six digits; None for those that are not finite."""
    if values.ndim > 1:
        return [digits(row) for row in values]
    return [float(f"{x:.6g}") if np.isfinite(x) else None for x in values.tolist()]


def table(study: coverage.Coverage) -> str:
    """The findings in Markdown, a line for each kind of truth."""
    limit = f"{study.factor:g} EMD_min"
    text = (
        f"| | rebounds | truth below {limit} | speed bound of the set below {limit} holds | factor of the 90 % set "
        "| truth in the 90 % set | its share of the box | its smallest speed, rad/s |\n"
        + "|---"
        * 8
    )
    for kind, twins in study.twins.items():
        factor, low, high = twins.threshold(CONFIDENCE, relative=True)
        on_half = holding(twins.ratio[::2], CONFIDENCE)[0]  # judged by the others
        in_region = coverage.Share(int((twins.ratio[1::2] < on_half).sum()), twins.n // 2)
        holds = twins.twin["bound_set"] <= twins.twin["truth_touchdown_speed"]
        region = twins.at(factor, relative=True)
        text += (
            f"|\n| {coverage.KINDS[kind]} | {twins.n} | {twins.in_set(study.factor)} "
            f"| {coverage.Share(int(holds.sum()), twins.n)} | {factor:.2f} ({low:.2f} to {high:.2f}) "
            f"| {in_region} | {region['count'][1] / study.grid_points:.0%} | {region['speed'][1]:.3f} "
        )
    return text + "|"


@command
def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m studies.coverage", description=__doc__)
    parser.add_argument("out", type=Path, help="folder of the results")
    parser.add_argument("--twins", type=int, default=300, help="simulated rebounds of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--coarser", type=int, default=1, help="every n-th point of the grid only")
    given = parser.parse_args(arguments)
    check_confidence(given.twins // 2, CONFIDENCE)
    case = load_case("philae")
    grid, each = make_grid(case, given.coarser), {}
    for kind in coverage.KINDS:
        folder = rows_folder(given.out / f"{kind}-seed{given.seed}-coarser{given.coarser}")
        make = [partial(twin, grid, kind, k, given.seed) for k in range(given.twins)]
        each[kind] = condensed([kept(folder / f"{k}.json", m) for k, m in enumerate(make)])
    more = "" if given.coarser == 1 else f" --coarser {given.coarser}"
    data = {
        "what": "the paper's method repeated on synthetic rebounds of known truth",
        "synthetic": True,
        "command": f"python -m studies.coverage OUT --twins {given.twins} --seed {given.seed}{more}",
        "sunspin_version": version(),
        "factor": FACTOR,
        "grid_points": len(grid.speed),
        "twins": each,
    }
    text = json.dumps(data)
    study = coverage.from_json(text, str(given.out))
    (given.out / coverage.SHIPPED).write_text(text + "\n", "utf-8")
    (given.out / "coverage.md").write_text(table(study) + "\n", "utf-8")
    draw(case, study).savefig(given.out / "coverage.png", dpi=150)
    print(table(study))


if __name__ == "__main__":
    sys.exit(main())
