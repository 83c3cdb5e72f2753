"""Simulated passes by a few numbers, their models, and what `rates` gives of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr

from sunspin.estimate.model import Body, Model, Noise
from sunspin.estimate.observe import observe
from sunspin.estimate.rates import rates
from sunspin.telemetry.assess import assess
from sunspin.vehicle import Vehicle
from tests.support.simulate import simulated_pass, uneven_times
from validation.passes import SimulatedPass, compare_with_truth, make

OMEGA = np.array([0.02, -0.03, 0.04])
"""Rate (rad/s) of a body that turns once in two minutes about no axis of its own."""


def tumbling_pass(
    vehicle: Vehicle,
    samples: int,
    interval_s: float,
    seed: int,
    omega_B: Any = OMEGA,
    spread: float = 0.2,
    **light: Any,
) -> tuple[xr.Dataset, xr.Dataset]:
    """Return telemetry and truth of a body that begins with a rate (3), rad/s, read without stray light.

    Intervals are `interval_s`, more or less by the share `spread`.
    """
    rng = np.random.default_rng(seed)
    t_s = interval_s * np.arange(samples)
    if spread:
        t_s = uneven_times(rng, samples, interval_s, spread)
    return simulated_pass(vehicle, omega_B, t_s, rng, **{"albedo": 0.0} | light)


def stated_model(
    vehicle: Vehicle, telemetry: xr.Dataset, noise: float = 1e-4, rate_sigma: float = 0.075
) -> Model:
    """Return the model of all samples as the vehicle file has it, under torques of this strength (rad/s^1.5)."""
    obs = observe(assess(vehicle, telemetry)).obs
    return Model(obs, Body.of(vehicle), Noise(noise), rate_sigma)


def estimate(simulated: SimulatedPass, **options: Any) -> xr.Dataset:
    """Return the result of `rates` for a drawn pass, up to its own largest rate."""
    options = {"max_rate_rad_s": simulated.max_rate_rad_s} | options
    return rates(simulated.vehicle, simulated.telemetry, **options)


def judged(kind: str, seed: int, i: int) -> tuple[xr.Dataset, dict[str, Any]]:
    """Return the result of a drawn pass, and how it compares with the truth."""
    simulated = make(kind, seed, i)
    result = estimate(simulated)
    return result, compare_with_truth(result, simulated)


def printed_rates(result: xr.Dataset, k: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return rates and sigmas (K, 3) of all solutions of a pass, rad/s, as they are printed; those not listed are NaN."""
    omega, sigma = (
        np.stack([result[f"{name}_{axis}"].values[k] for axis in "xyz"], axis=1)
        for name in ("omega", "sigma")
    )
    return omega, sigma


def errors_in_sigmas(result: xr.Dataset, omega_B: np.ndarray) -> np.ndarray:
    """Return the errors (n, 3) of the best solution's rates, against true ones (n, 3) at its samples, in their own sigmas."""
    sigma = np.sqrt(np.diagonal(result["omega_cov_B"].values, axis1=1, axis2=2))
    return (result["omega_B"].values - omega_B) / sigma


def slope_of(function: Callable[[Any], Any], step: np.ndarray, size: float) -> Any:
    """Return the derivative of a function of a change, along a step of this size, by the difference of both sides."""
    return (function(step) - function(-step)) / (2 * size)
