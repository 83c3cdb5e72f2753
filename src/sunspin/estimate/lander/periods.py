"""Periods seen from outside as evidence about a lander: its draws are weighed by them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from sunspin.dynamics import gyrostat
from sunspin.estimate.lander.predict import DrawnMotions, checked_times
from sunspin.estimate.lander.tree import group
from sunspin.estimate.periods import (
    FAR_SIGMAS,
    HALF_SPAN,
    INSTANTS,
    LEAST_DRAWS,
    ROTATIONS,
    PeriodSeen,
    euler_rates,
    spin_axis,
    weigh_draws,
)
from sunspin.vehicle import Vehicle

LEVELS = (0.05, 0.5, 0.95)
"""Quantiles of the angular speed that are reported."""


def draws_by_periods(
    vehicle: Vehicle, tree: xr.DataTree, seen: Sequence[PeriodSeen], workers: int | None = None
) -> xr.DataTree:
    """Return the group `period`: draws of a posterior weighed by periods, and what these decide. The draws stay as they are.

    Variables: `log_weight` (chain, draw), `probability` (seen, reading), `solution_probability` (solution) and `rate_quantile`
    (level) in rad/s at the first sample, the last two also as they were before.
    """
    draws, count = group(tree, "posterior"), group(tree, "solutions").sizes["solution"]
    motions = DrawnMotions.of(vehicle, tree)
    even = np.full(len(motions.rows), 1 / len(motions.rows))
    weighed = weigh_draws(seen, [periods_of(motions, period, workers) for period in seen], even)
    solution_id = draws["solution_id"].values.ravel()
    speed = np.linalg.norm(draws["omega_B"].values.reshape(-1, 3), axis=1)
    order = np.argsort(speed)
    log_weight = np.log(np.maximum(weighed.weight, 1e-300))[None]
    variables: dict[str, Any] = {
        "log_weight": (("chain", "draw"), log_weight, {"units": "1"}),
        "probability": (("seen", "reading"), weighed.shares, {"units": "1"}),
    }
    for name, weight in (("", weighed.weight), ("_before", even)):
        shares = np.array([weight[solution_id == k].sum() for k in range(count)])
        quantiles = np.interp(LEVELS, np.cumsum(weight[order]), speed[order])
        variables[f"solution_probability{name}"] = ("solution", shares, {"units": "1"})
        variables[f"rate_quantile{name}"] = ("level", quantiles, {"units": "rad s-1"})
    decides = weighed.effective >= LEAST_DRAWS and weighed.nearest_sigmas <= FAR_SIGMAS
    attrs = {
        "effective_draws": weighed.effective,
        "told": int(decides),
        "nearest_sigmas": weighed.nearest_sigmas,
        "seen_s": [period.t_s for period in seen],
        "period_s": [period.period_s for period in seen],
        "sigma_s": [period.sigma_s for period in seen],
    }
    coords = {"reading": list(ROTATIONS), "level": np.array(LEVELS)}
    return xr.DataTree(xr.Dataset(variables, coords, attrs))


def periods_of(motions: DrawnMotions, seen: PeriodSeen, workers: int | None = None) -> np.ndarray:
    """Return periods (n, 3) in s by :data:`ROTATIONS` of draws when a period was seen; NaN for those that could not be computed."""
    instants = seen.t_s + np.linspace(-HALF_SPAN, HALF_SPAN, INSTANTS) * seen.period_s
    carried = motions.at(checked_times(instants, motions.start_s), workers)
    bodies = motions.rows.bodies_of(motions.vehicle)
    axis, rates = spin_axis(np.array(motions.vehicle.require_inertia())), []
    for k in range(INSTANTS):
        omega, speeds = carried.omega_B[:, k], carried.wheel_speed_rad_s[:, k]
        momentum = gyrostat.total_momentum(bodies, omega, speeds)
        rates.append(euler_rates(omega, momentum, axis))
    with np.errstate(divide="ignore"):
        return 2 * np.pi / np.abs(np.mean(rates, axis=0))
