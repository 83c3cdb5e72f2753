"""Periods seen by others (radio fading, a light curve) as evidence about a lander: the draws of its posterior are weighted by them.

The method is that of :mod:`sunspin.estimate.periods`.
"""

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
    """Return the group `period` of a posterior: weights of its draws given the periods `seen`. The draws stay as they are.

    Variables: `log_weight` (chain, draw); `probability` (seen, reading) that each period is of precession, spin or their sum;
    `solution_probability` (solution) and `rate_quantile` (level), angular speed in rad/s at the first sample, and both without the
    periods (`..._before`). The attribute `told` is 1 if the periods count: enough draws have them, and one is near.
    """
    draws, solutions = group(tree, "posterior"), group(tree, "solutions").sizes["solution"]
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
        probability = np.array([weight[solution_id == k].sum() for k in range(solutions)])
        quantiles = np.interp(LEVELS, np.cumsum(weight[order]), speed[order])
        variables[f"solution_probability{name}"] = ("solution", probability, {"units": "1"})
        variables[f"rate_quantile{name}"] = ("level", quantiles, {"units": "rad s-1"})
    counts = weighed.effective >= LEAST_DRAWS and weighed.nearest_sigmas <= FAR_SIGMAS
    attrs = {
        "effective_draws": weighed.effective,
        "told": int(counts),
        "nearest_sigmas": weighed.nearest_sigmas,
        "seen_s": [period.t_s for period in seen],
        "period_s": [period.period_s for period in seen],
        "sigma_s": [period.sigma_s for period in seen],
    }
    coords = {"reading": list(ROTATIONS), "level": np.array(LEVELS)}
    return xr.DataTree(xr.Dataset(variables, coords, attrs))


def periods_of(motions: DrawnMotions, seen: PeriodSeen, workers: int | None = None) -> np.ndarray:
    """Return the periods (n, 3), s, of precession, spin and their sum of n draws at the time at which a period was seen.

    Rates are averaged over `HALF_SPAN` of the seen periods before and after. NaN for motions that could not be computed.
    """
    instants_s = seen.t_s + np.linspace(-HALF_SPAN, HALF_SPAN, INSTANTS) * seen.period_s
    propagated = motions.at(checked_times(instants_s, motions.start_s), workers)
    bodies = motions.rows.bodies_of(motions.vehicle)
    axis, rates = spin_axis(np.array(motions.vehicle.require_inertia())), []
    for k in range(INSTANTS):
        omega, speeds = propagated.omega_B[:, k], propagated.wheel_speed_rad_s[:, k]
        momentum = gyrostat.total_momentum(bodies, omega, speeds)
        rates.append(euler_rates(omega, momentum, axis))
    with np.errstate(divide="ignore"):
        return 2 * np.pi / np.abs(np.mean(rates, axis=0))
