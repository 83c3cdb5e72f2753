"""Periods seen from outside, as evidence beside a posterior: its draws weighted by them, and what that decides."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from sunspin.dynamics import gyrostat as g
from sunspin.estimate.posterior.data import group
from sunspin.estimate.posterior.predict import checked_times, drawn_rows, run_to
from sunspin.estimate.terms.period import (
    FAR_SIGMAS,
    READINGS,
    Period,
    euler_rates,
    evidence,
    mean_periods,
    own_axis,
    reading_words,
    unheard,
)
from sunspin.vehicle import Vehicle


def periods_of(vehicle: Vehicle, tree: xr.DataTree, seen: Period) -> np.ndarray:
    """Periods (n, 3) in s by `READINGS` of the draws of a posterior at the time of a period; NaN where a run failed."""
    first = float(tree.attrs["t_first_s"])
    times = checked_times(seen.instants_s, first)
    unknown, rows = drawn_rows(vehicle, tree)
    run = run_to(vehicle, rows, times - first, unknown.wheel_mode)
    bodies, axis = rows.bodies_of(vehicle), own_axis(vehicle.require_inertia())
    at = zip(
        np.moveaxis(run["omega_B"], 1, 0), np.moveaxis(run["wheel_speed_rad_s"], 1, 0), strict=True
    )
    return mean_periods(
        [euler_rates(omega, g.total_momentum(bodies, omega, speeds), axis) for omega, speeds in at]
    )


def with_periods(vehicle: Vehicle, tree: xr.DataTree, seen: Sequence[Period]) -> None:
    """Add the group `period` to a posterior: its draws weighted by periods seen, and what these decide.

    `log_weight (chain, draw)`; `probability (seen, reading)` of what turned; `solution_probability (solution)` and
    `rate_quantile (level)`, rad/s at the first sample, with `solution_probability_before` and `rate_quantile_before`; attrs
    `effective_draws`, `told` (0: too few draws carry the weight), `nearest_sigmas`. The draws themselves stay as they are.
    """
    drawn, regions = group(tree, "posterior"), group(tree, "solutions")
    count, draws = regions.sizes["solution"], drawn.sizes["chain"] * drawn.sizes["draw"]
    even = np.full(draws, 1 / draws)
    found = evidence(seen, [periods_of(vehicle, tree, one) for one in seen], even)
    solution_id, rate = (
        drawn["solution_id"].values.ravel(),
        np.linalg.norm(drawn["omega_B"].values.reshape(-1, 3), axis=1),
    )
    levels = np.array([0.05, 0.5, 0.95])
    variables: dict[str, Any] = {
        "log_weight": (
            ("chain", "draw"),
            np.log(np.maximum(found.weight, 1e-300))[None],
            {"units": "1"},
        ),
        "probability": (("seen", "reading"), found.shares, {"units": "1"}),
    }
    for name, w in (("", found.weight), ("_before", even)):
        variables[f"solution_probability{name}"] = (
            "solution",
            np.array([w[solution_id == i].sum() for i in range(count)]),
            {"units": "1"},
        )
        variables[f"rate_quantile{name}"] = (
            "level",
            _quantiles(rate, w, levels),
            {"units": "rad s-1"},
        )
    attrs = {
        "effective_draws": found.effective,
        "told": int(found.told),
        "nearest_sigmas": found.nearest_sigmas,
        "seen_s": [one.t_s for one in seen],
        "period_s": [one.period_s for one in seen],
        "sigma_s": [one.sigma_s for one in seen],
    }
    tree["period"] = xr.DataTree(
        xr.Dataset(variables, {"reading": list(READINGS), "level": levels}, attrs)
    )


def _quantiles(values: np.ndarray, weight: np.ndarray, levels: np.ndarray) -> np.ndarray:
    order = np.argsort(values)
    return np.interp(levels, np.cumsum(weight[order]), values[order])


def period_sentences(found: xr.Dataset) -> list[str]:
    """What periods decide, in words."""
    about = found.attrs
    if why_not := unheard(about["nearest_sigmas"], about["effective_draws"], "this posterior"):
        return [
            f"{why_not}; ask for more --draws" if about["nearest_sigmas"] <= FAR_SIGMAS else why_not
        ]
    each = zip(
        *(np.atleast_1d(about[key]) for key in ("seen_s", "period_s", "sigma_s")),
        found["probability"].values,
        strict=True,
    )
    lines = [reading_words(*one) for one in each]
    (low, middle, high), (was_low, was, was_high) = (
        np.degrees(found[f"rate_quantile{when}"].values) for when in ("", "_before")
    )
    weights = [found[f"solution_probability{when}"].values.max() for when in ("_before", "")]
    lines.append(
        f"with periods the angular speed at the first sample is {middle:.3g} deg/s, 90 % in {low:.3g} to {high:.3g} (without: "
        f"{was:.3g}, {was_low:.3g} to {was_high:.3g}); the likeliest solution has {weights[1]:.1%} (without: {weights[0]:.1%}); "
        f"effective sample size {about['effective_draws']:.0f}"
    )
    return lines
