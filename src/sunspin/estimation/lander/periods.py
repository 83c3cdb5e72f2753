"""Periods seen from outside as evidence about a lander: its draws are weighed by them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from sunspin.dynamics import gyrostat
from sunspin.estimation.lander.fit import SEARCH_ERROR
from sunspin.estimation.lander.mixture import Mixture
from sunspin.estimation.lander.model import LanderModel
from sunspin.estimation.lander.motions import Shots
from sunspin.estimation.lander.tree import group
from sunspin.estimation.periods import (
    FAR_SIGMAS,
    HALF_SPAN,
    INSTANTS,
    LEAST_DRAWS,
    READINGS,
    PeriodSeen,
    euler_rates,
    own_axis,
    weigh_draws,
)

LEVELS = (0.05, 0.5, 0.95)
"""Quantiles of the angular speed that are reported."""


def draws_by_periods(
    mix: Mixture,
    picked: np.ndarray,
    tree: xr.DataTree,
    seen: Sequence[PeriodSeen],
    reference_s: float,
) -> xr.DataTree:
    """Return the group `period`: draws of equal weight weighed by periods, and what these decide. The draws stay as they are.

    `picked`: which draws those of the tree are; `reference_s`: time of the reference, s from the epoch. Variables: `log_weight`
    (chain, draw), `probability` (seen, reading), `solution_probability` (solution) and `rate_quantile` (level) in rad/s at the
    first sample, the last two also as they were before.
    """
    draws, count = group(tree, "posterior"), group(tree, "solutions").sizes["solution"]
    even = np.full(len(picked), 1 / len(picked))
    weighed = weigh_draws(seen, [_periods(mix, picked, one, reference_s) for one in seen], even)
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
        "seen_s": [one.t_s for one in seen],
        "period_s": [one.period_s for one in seen],
        "sigma_s": [one.sigma_s for one in seen],
    }
    coords = {"reading": list(READINGS), "level": np.array(LEVELS)}
    return xr.DataTree(xr.Dataset(variables, coords, attrs))


def _periods(mix: Mixture, picked: np.ndarray, seen: PeriodSeen, reference_s: float) -> np.ndarray:
    """Return periods (n, 3) in s by :data:`READINGS` of draws when a period was seen; NaN for runs that failed."""
    instants = np.linspace(-HALF_SPAN, HALF_SPAN, INSTANTS) * seen.period_s
    after_s = seen.t_s + instants - reference_s
    rates = np.full((len(picked), 3), np.nan)
    for model, places, shots in mix.by_model(picked):
        rates[places] = _mean_rates(model, shots, after_s)
    with np.errstate(divide="ignore"):
        return 2 * np.pi / np.abs(rates)


def _mean_rates(model: LanderModel, shots: Shots, after_s: np.ndarray) -> np.ndarray:
    """Return Euler's rates (n, 3) in rad/s of motions, in the mean over times (m), s after the reference."""
    rows, bodies = model.rows(shots), model.bodies(shots.u)
    axis, parts = own_axis(np.array(model.vehicle.require_inertia())), []
    for times in (after_s[after_s < 0][::-1], after_s[after_s >= 0]):
        if len(times):
            run = model.run(rows, times, SEARCH_ERROR)
            for k in range(len(times)):
                omega, speeds = run.omega_B[:, k], run.wheel_speed_rad_s[:, k]
                momentum = gyrostat.total_momentum(bodies, omega, speeds)
                parts.append(euler_rates(omega, momentum, axis))
    return np.mean(parts, axis=0)
