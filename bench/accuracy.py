"""Error and cost of the kernels for each requested error, on motions of several kinds, compared with the reference integrator."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

import sunspin as ss
from bench.problem import grid_sample, philae
from bench.timing import Table, medians
from sunspin.dynamics import batch
from sunspin.dynamics.batch import Outcome, Rows
from sunspin.vehicle import Vehicle

DIRECTION_ERRORS = (1e-2, 1e-3, 1e-5, 1e-8)
COLUMNS = ("motions", "asked, rad", "median", "99 %", "largest", "us/row")


def run(quick: bool) -> Table:
    """Measure the errors (rad) of the Sun direction at the end of the window, on one core."""
    n, refused = 24 if quick else 256, 0
    table = Table("accuracy: error of directions against the error asked for", COLUMNS)
    for name, vehicle, rows, window in cases(n):
        exact = np.array([last_sun(vehicle, rows, i, window) for i in range(n)])
        for requested in DIRECTION_ERRORS[1:3] if quick else DIRECTION_ERRORS:
            result = batch.run(vehicle, rows, window, error=requested)
            fine = result.outcome == Outcome.FINE
            refused += int((~fine).sum())
            error = np.linalg.norm(result.sun_B[fine, 0] - exact[fine], axis=1)
            propagation = partial(batch.run, vehicle, rows, window, error=requested)
            seconds = medians({"rows": propagation}, 1 if quick else 3)["rows"]
            quantiles = np.quantile(error, [0.5, 0.99, 1.0])
            table.rows.append((name, requested, *quantiles, 1e6 * seconds / n))
    table.notes.append(f"Rows that are not counted, as their outcome is not FINE: {refused}")
    table.notes.append("Few rows fill few lanes; see `scan` for speed.")
    return table


class Case(NamedTuple):
    """One kind of motion: name, vehicle, initial states (n), window in s (negative: backward)."""

    name: str
    vehicle: Vehicle
    rows: Rows
    window_s: float


def cases(n: int) -> list[Case]:
    """Return the kinds of motion that are measured, each with n initial states."""
    problem = philae()
    axes, vehicle, speed = problem.axes(101, 101, 41), problem.vehicle, problem.wheel_speed_rad_s
    grid = grid_sample(axes, n, seed=5)
    # rates (rad/s) at corners beyond the grid, where the body rotates fast
    corners = np.sign(grid - 0.2) * [0.9, 0.9, 0.3]
    (wheel,) = vehicle.wheels
    across = replace(wheel, name="across", axis_B=np.array([1.0, 0.0, 0.0]))
    two_wheels = replace(vehicle, wheels=(wheel, across))
    no_wheel = replace(vehicle, wheels=())
    window = problem.window_s
    return [
        Case("grid of the paper, wheel stops", vehicle, states(problem.sun_B, grid, speed), window),
        Case("its fast corners", vehicle, states(problem.sun_B, corners, speed), window),
        Case("no wheel", no_wheel, states(problem.sun_B, grid, []), window),
        Case(
            "two wheels, both stop",
            two_wheels,
            states(problem.sun_B, grid, [float(speed[0]), -0.7 * float(speed[0])]),
            window,
        ),
        Case(
            "backward, the wheel gains speed", vehicle, states(problem.sun_B, grid, speed), -window
        ),
    ]


def states(sun_B: np.ndarray, omega_B: np.ndarray, speeds: object) -> Rows:
    """Return initial states with rates omega_B (n, 3), one Sun direction (3) and the same wheel speeds."""
    n = len(omega_B)
    return Rows(omega_B, np.tile(sun_B, (n, 1)), np.tile(np.asarray(speeds, dtype=float), (n, 1)))


def last_sun(vehicle: Vehicle, rows: Rows, i: int, window_s: float) -> np.ndarray:
    """Return the reference's Sun direction (3) at the end of row i."""
    speeds = rows.wheel_speed_rad_s[i] if len(vehicle.wheels) else None
    return ss.propagate(vehicle, rows.omega_B[i], rows.sun_B[i], speeds, [0.0, window_s])[
        "sun_B"
    ].values[-1]
