"""Error against cost: what the kernels reach for the error asked for, on motions of several kinds, against the reference."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

import sunspin as ss
from bench.problem import grid_sample, philae
from bench.timing import Table, medians
from sunspin.dynamics import ensemble as k
from sunspin.vehicle import Vehicle

DIRECTION_ERRORS = (1e-2, 1e-3, 1e-5, 1e-8)
COLUMNS = ("motions", "asked, rad", "median", "99 %", "largest", "us/row")


def run(quick: bool) -> Table:
    """Errors (rad) of the Sun's direction at the end, on one core."""
    n, refused = 24 if quick else 256, 0
    table = Table("accuracy: error of directions against the error asked for", COLUMNS)
    for name, vehicle, rows, window in cases(n):
        exact = np.array([last_sun(vehicle, rows, i, window) for i in range(n)])
        for asked in DIRECTION_ERRORS[1:3] if quick else DIRECTION_ERRORS:
            found = k.run_rows(vehicle, rows, window, direction_error=asked)
            fine = found.outcome == k.Outcome.FINE
            refused += int((~fine).sum())
            error = np.linalg.norm(found.sun_B[fine, 0] - exact[fine], axis=1)
            run = partial(k.run_rows, vehicle, rows, window, direction_error=asked)
            seconds = medians({"run": run}, 1 if quick else 3)["run"]
            quantiles = np.quantile(error, [0.5, 0.99, 1.0])
            table.rows.append((name, asked, *quantiles, 1e6 * seconds / n))
    table.notes.append(f"Rows that are not counted, as their outcome is not FINE: {refused}")
    table.notes.append("Few rows fill few lanes; see `scan` for speed.")
    return table


def cases(n: int) -> list[tuple[str, Vehicle, k.Rows, float]]:
    """Name, vehicle, states (n) and window (s)."""
    problem = philae()
    axes, vehicle, speed = problem.axes(101, 101, 41), problem.vehicle, problem.wheel_speed_rad_s
    grid = grid_sample(axes, n, seed=5)
    corners = np.sign(grid - 0.2) * [0.9, 0.9, 0.3]
    (wheel,) = vehicle.wheels
    across = replace(wheel, name="across", axis_B=np.array([1.0, 0.0, 0.0]))
    two, none = replace(vehicle, wheels=(wheel, across)), replace(vehicle, wheels=())
    window = problem.window_s
    return [
        ("grid of the paper, wheel stops", vehicle, states(problem.sun_B, grid, speed), window),
        ("its fast corners", vehicle, states(problem.sun_B, corners, speed), window),
        ("no wheel", none, states(problem.sun_B, grid, []), window),
        (
            "two wheels, both stop",
            two,
            states(problem.sun_B, grid, [float(speed[0]), -0.7 * float(speed[0])]),
            window,
        ),
        ("backward, the wheel gains speed", vehicle, states(problem.sun_B, grid, speed), -window),
    ]


def states(sun_B: np.ndarray, omega_B: np.ndarray, speeds: object) -> k.Rows:
    n = len(omega_B)
    return k.Rows(omega_B, np.tile(sun_B, (n, 1)), np.tile(np.asarray(speeds, dtype=float), (n, 1)))


def last_sun(vehicle: Vehicle, rows: k.Rows, i: int, window_s: float) -> np.ndarray:
    """The reference's direction to the Sun (3) at the end of row i."""
    speeds = rows.wheel_speed_rad_s[i] if len(vehicle.wheels) else None
    return ss.propagate(vehicle, rows.omega_B[i], rows.sun_B[i], speeds, [0.0, window_s])[
        "sun_B"
    ].values[-1]
