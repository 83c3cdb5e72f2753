"""Files of several sparse passes, and passes with a period that was seen from outside. All telemetry is synthetic.

Samples are a minute apart, so that whole turns between them hardly show: neighbouring passes, or the period, tell them apart.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from sunspin import Period, rates
from sunspin.base.errors import SunspinError
from validation.passes import (
    FACES,
    MOMENTS,
    SimulatedPass,
    compare_with_truth,
    observe,
    spin,
    unit,
)

PASSES, APART_S = 4, 5600.0
"""Number of passes of a file, and the time from one to the next."""

WALK = np.radians(0.05)
"""Change of each component of the rate in rad/s from one pass to the next."""

REFUSED = {"decided": False, "wrong": True, "listed": False}
"""What is said of a pass that was refused."""

SEEN_S = 2.0
"""Instants of a motion whose periods are averaged are so far apart."""


def draw_sparse(rng: np.random.Generator, omega: np.ndarray, begin_s: float) -> SimulatedPass:
    """Make a pass of six panels that begins with a rate: four samples 60 s apart, to 2 %, noise of 5 %."""
    t = begin_s + np.cumsum(60.0 * rng.uniform(0.98, 1.02, 4))
    return observe(FACES, *spin(omega, t), t, 0.05, rng, max_rate_rad_s=0.12)


def make_several(seed: int, i: int) -> list[SimulatedPass]:
    """Return the passes of file `i`, whose rates at their beginnings differ little."""
    rng = np.random.default_rng([45, seed, i])
    omega, passes = np.radians(rng.uniform(0.5, 4.0)) * unit(rng), []
    for k in range(PASSES):
        passes.append(draw_sparse(rng, omega, k * APART_S))
        omega = omega + WALK * rng.normal(size=3)
    return passes


def make_period(seed: int, i: int) -> tuple[SimulatedPass, Period]:
    """Return pass `i` and a period of its precession that was seen in the middle of it, to 3 %."""
    rng = np.random.default_rng([46, seed, i])
    omega = np.radians(rng.uniform(1.0, 4.0)) * unit(rng)
    simulated = draw_sparse(rng, omega, 0.0)
    t_s = simulated.telemetry["time"].values
    middle_s = float(t_s[len(t_s) // 2])
    # The axis whose moment differs most from the others goes round the momentum with the precession: count its angle.
    instants = np.arange(0.0, t_s[-1], SEEN_S)
    motion, attitude = spin(omega, np.concatenate([[t_s[0]], t_s[0] + instants[1:]]))
    momentum_N = attitude[0].T @ (MOMENTS * motion[0])
    momentum_N /= np.linalg.norm(momentum_N)
    apart = [np.abs(np.delete(MOMENTS, k) - moment).min() for k, moment in enumerate(MOMENTS)]
    axis_N = attitude[:, int(np.argmax(apart))]
    across = np.cross(momentum_N, [1.0, 0.0, 0.0] if abs(momentum_N[0]) < 0.7 else [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    angle = np.unwrap(np.arctan2(axis_N @ np.cross(momentum_N, across), axis_N @ across))
    period_s = 2 * np.pi * instants[-1] / abs(angle[-1] - angle[0])
    return simulated, Period(middle_s, period_s * (1 + 0.03 * rng.normal()), 0.03 * period_s)


def judge(kind: str, seed: int, i: int) -> list[dict[str, Any]]:
    """Run `rates` on file `i` of a kind and return the comparison of each pass with the truth."""
    if kind == "period":
        simulated, period = make_period(seed, i)
        passes, options = [simulated], {"periods": [period]}
    else:
        passes, options = make_several(seed, i), {}
    data = xr.concat([one.telemetry for one in passes], "time", data_vars="minimal")
    vehicle, limit = passes[0].vehicle, passes[0].max_rate_rad_s
    try:
        result = rates(vehicle, data, max_rate_rad_s=limit, **options)
    except SunspinError as error:
        return [REFUSED | {"why": str(error)}]
    rows = []
    for k, one in enumerate(passes):
        of_pass = result.isel(pass_id=[k], time=result["pass_of"].values == k)
        of_pass["pass_of"] = of_pass["pass_of"] * 0
        row = compare_with_truth(of_pass, one)
        rows.append(row | {"wrong": row["wrong"] or row["mirrored"] or row["empty"]})
    return rows
