"""A period seen from outside as evidence: radio fading, a light curve, a magnetometer's swing.

Who sees a period does not know what turned: the body's axis about the momentum (precession), the body about its axis (spin), or
both together (the sum). Each of the three is as likely before; a posterior's draws are weighted by the mean of the three densities.
The rates are those of Euler's angles about the total momentum, wheels included, averaged over four of the periods seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError, sentence
from sunspin.dynamics import gyrostat as g
from sunspin.estimate.posterior.data import group
from sunspin.estimate.posterior.predict import checked_times, drawn_rows, run_to
from sunspin.estimate.posterior.prior_widths import LEAST_DRAWS
from sunspin.vehicle import Vehicle

READINGS = ("precession", "spin", "sum")

HALF_SPAN, INSTANTS = 2.0, 9
"""Periods before and after the instant over which rates are averaged, and at how many instants."""

PARALLEL = 1e-6
"""Squared sine between momentum and axis below which precession and spin cannot be told apart; their sum can."""

FAR_SIGMAS = 4.0
"""Where no draw has a period as near as this, the period contradicts the posterior."""


@dataclass(frozen=True)
class Period:
    """A period (s) with one sigma (s), seen at `t_s` (s from the epoch of the telemetry)."""

    t_s: float
    period_s: float
    sigma_s: float

    def __post_init__(self) -> None:
        for name in ("t_s", "period_s", "sigma_s"):
            value = getattr(self, name)
            if not np.isfinite(value) or (name != "t_s" and not value > 0):
                raise InputError(sentence(f"{name} of a period must be a positive number of seconds", got=value))

    def density(self, periods_s: np.ndarray) -> np.ndarray:
        """Of periods (n, 3) by `READINGS`: density (n, 3) of what was seen; 0 where there is no such period."""
        apart = (np.nan_to_num(periods_s, nan=np.inf) - self.period_s) / self.sigma_s
        return np.exp(-0.5 * apart**2) / (self.sigma_s * np.sqrt(2 * np.pi))

    def nearest_sigmas(self, density: np.ndarray) -> float:
        """How many sigma the nearest of all periods, of these densities, is away."""
        highest = float(density.max()) * self.sigma_s * np.sqrt(2 * np.pi)
        return float(np.sqrt(-2 * np.log(np.clip(highest, 1e-300, 1.0))))


def own_axis(vehicle: Vehicle) -> np.ndarray:
    """The principal axis (3) whose moment of inertia differs most from the other two: a body's own, about which it spins."""
    moments, axes = np.linalg.eigh(vehicle.require_inertia())
    apart = [min(abs(moments[i] - other) for other in np.delete(moments, i)) for i in range(3)]
    return axes[:, int(np.argmax(apart))]


def euler_rates(omega_B: np.ndarray, momentum_B: np.ndarray, axis_B: np.ndarray) -> np.ndarray:
    """Precession, spin and their sum (..., 3), rad/s, of rates omega_B (..., 3) with momentum (..., 3), about a body axis (3).

    omega = precession h + spin e + (nutation across both), h along the momentum, e the axis; NaN for the first two where h and e
    are parallel.
    """
    along = momentum_B / np.linalg.norm(momentum_B, axis=-1, keepdims=True)
    cosine, about_h, about_e = along @ axis_B, np.sum(omega_B * along, axis=-1), omega_B @ axis_B
    square = np.where(1 - cosine**2 > PARALLEL, 1 - cosine**2, np.nan)
    opposite = cosine < 0  # the sum of turns about opposite directions is their difference
    total = np.where(opposite, about_h - about_e, about_h + about_e) / (1 + np.abs(cosine))
    return np.stack([(about_h - cosine * about_e) / square, (about_e - cosine * about_h) / square, total], axis=-1)


def periods_of(vehicle: Vehicle, tree: xr.DataTree, seen: Period) -> np.ndarray:
    """Periods (n, 3) in s by `READINGS` of the draws of a posterior at the time of a period; NaN where a run failed."""
    first = float(tree.attrs["t_first_s"])
    times = checked_times(seen.t_s + np.linspace(-HALF_SPAN, HALF_SPAN, INSTANTS) * seen.period_s, first)
    unknown, rows = drawn_rows(vehicle, tree)
    run = run_to(vehicle, rows, times - first, unknown.wheel_mode)
    bodies, axis = rows.bodies_of(vehicle), own_axis(vehicle)
    at = zip(np.moveaxis(run["omega_B"], 1, 0), np.moveaxis(run["wheel_speed_rad_s"], 1, 0), strict=True)
    rates = np.mean([euler_rates(omega, g.total_momentum(bodies, omega, speeds), axis) for omega, speeds in at], axis=0)
    with np.errstate(divide="ignore"):
        return 2 * np.pi / np.abs(rates)


def with_periods(vehicle: Vehicle, tree: xr.DataTree, seen: Sequence[Period]) -> None:
    """Add the group `period` to a posterior: its draws weighted by periods seen, and what these decide.

    `log_weight (chain, draw)`; `probability (seen, reading)` of what turned; `region_weight (mode)` and `rate_quantile (level)`,
    rad/s at the first sample, with `region_weight_before` and `rate_quantile_before`; attrs `effective_draws`, `told` (0: too few
    draws carry the weight), `nearest_sigmas`. The draws themselves stay as they are.
    """
    drawn, regions = group(tree, "posterior"), group(tree, "modes")
    each = [one.density(periods_of(vehicle, tree, one)) for one in seen]
    density = np.prod([one.mean(axis=1) for one in each], axis=0)
    nearest = max(one.nearest_sigmas(found) for one, found in zip(seen, each, strict=True))
    total = density.sum()
    weight = density / total if total > 0 else np.full(len(density), 1 / len(density))
    effective = float(1 / np.sum(weight**2)) if total > 0 else 0.0
    shares = [(weight[:, None] * one / np.maximum(one.sum(axis=1, keepdims=True), 1e-300)).sum(axis=0) for one in each]
    mode_id, rate = drawn["mode_id"].values.ravel(), np.linalg.norm(drawn["omega_B"].values.reshape(-1, 3), axis=1)
    count, even = regions.sizes["mode"], np.full(len(weight), 1 / len(weight))
    levels = np.array([0.05, 0.5, 0.95])
    variables: dict[str, Any] = {
        "log_weight": (("chain", "draw"), np.log(np.maximum(weight, 1e-300))[None], {"units": "1"}),
        "probability": (("seen", "reading"), np.array(shares), {"units": "1"}),
    }
    for name, w in (("", weight), ("_before", even)):
        variables[f"region_weight{name}"] = ("mode", np.array([w[mode_id == i].sum() for i in range(count)]), {"units": "1"})
        variables[f"rate_quantile{name}"] = ("level", _quantiles(rate, w, levels), {"units": "rad s-1"})
    attrs = {
        "effective_draws": effective, "told": int(effective >= LEAST_DRAWS and nearest <= FAR_SIGMAS), "nearest_sigmas": nearest,
        "seen_s": [one.t_s for one in seen], "period_s": [one.period_s for one in seen], "sigma_s": [one.sigma_s for one in seen],
    }  # fmt: skip
    tree["period"] = xr.DataTree(xr.Dataset(variables, {"reading": list(READINGS), "level": levels}, attrs))


def _quantiles(values: np.ndarray, weight: np.ndarray, levels: np.ndarray) -> np.ndarray:
    order = np.argsort(values)
    return np.interp(levels, np.cumsum(weight[order]), values[order])


def period_sentences(found: xr.Dataset) -> list[str]:
    """What periods decide, in words."""
    about = found.attrs
    if about["nearest_sigmas"] > FAR_SIGMAS:
        return [f"periods: no motion of this posterior has them; the nearest is {about['nearest_sigmas']:.1f} sigma away"]
    if not about["told"]:
        return [f"periods: not told by these draws, of which only {about['effective_draws']:.0f} carry them; ask for more --draws"]
    lines = []
    for i, (t, period, sigma) in enumerate(zip(*(np.atleast_1d(about[k]) for k in ("seen_s", "period_s", "sigma_s")), strict=True)):
        each = ", ".join(f"{name} {p:.0%}" for name, p in zip(READINGS, found["probability"].values[i], strict=True))
        lines.append(f"period {period:g} +- {sigma:g} s at {t:g} s: {each}")
    (low, middle, high), (was_low, was, was_high) = (
        np.degrees(found[f"rate_quantile{when}"].values) for when in ("", "_before")
    )  # fmt: skip
    weights = [found[f"region_weight{when}"].values.max() for when in ("_before", "")]
    lines.append(
        f"with periods the angular speed at the first sample is {middle:.3g} deg/s, 90 % in {low:.3g} to {high:.3g} (without: "
        f"{was:.3g}, {was_low:.3g} to {was_high:.3g}); the likeliest region holds {weights[1]:.1%} (without: {weights[0]:.1%}); "
        f"{about['effective_draws']:.0f} effective draws"
    )  # fmt: skip
    return lines
