"""Twins with faults of known kinds, and whether the rates found for them cover the truth. All of it is synthetic.

A cube of six panels and known inertia tumbles at up to about 3 deg/s, seen 40 times about 10 s apart. Each fault is named and
acts on the readings, the gains or the clock; "everything" is all of them at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation
from scipy.stats import norm

import sunspin as ss
from sunspin.vehicle import Panel, TelemetryForm, Vehicle

NORMALS = np.vstack([np.eye(3), -np.eye(3)])
CUBE = Vehicle(
    "cube",
    inertia_kg_m2=np.diag([0.042, 0.05, 0.03]),
    gain_unit="W",
    panels=[
        Panel(name, normal, 1.0)
        for name, normal in zip(("+x", "+y", "+z", "-x", "-y", "-z"), NORMALS, strict=True)
    ],
    telemetry=TelemetryForm(noise=0.01),
)
SAMPLES = 40

FOUR = replace(
    CUBE, name="four", panels=tuple(panel for panel in CUBE.panels if not panel.normal_B[2])
)
"""The same body with panels on its sides only: their common brightness tells the Sun's height above them, but for its sign."""

Fault = Callable[..., np.ndarray]


def albedo(
    power: np.ndarray, rng: np.random.Generator, attitude: Rotation, normals: np.ndarray
) -> np.ndarray:
    """The Earth, which stays where it is while the body turns: up to a tenth of full Sun on what looks there, lit or not."""
    earth = rng.normal(size=3)
    return power + rng.uniform(0.02, 0.1) * np.maximum(
        attitude.apply(earth / np.linalg.norm(earth)) @ normals.T, 0
    )


def offset(power: np.ndarray, rng: np.random.Generator, normals: np.ndarray) -> np.ndarray:
    """Up to a tenth of full Sun too much on one side of the body, all the time: zeros of the converters that nobody subtracts."""
    side = rng.normal(size=3)
    return power + rng.uniform(0.02, 0.1) * np.maximum(normals @ side / np.linalg.norm(side), 0)


def battery(power: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    limited = rng.uniform(size=len(power)) < 0.15
    return np.where(limited[:, None], power * rng.uniform(0.1, 0.75, (len(power), 1)), power)


def dead_string(power: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return power * np.where(np.arange(power.shape[1]) == rng.integers(power.shape[1]), 0.8, 1.0)


def dead_panel(power: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return power * (np.arange(power.shape[1]) != rng.integers(power.shape[1]))


def gains(power: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return power * np.exp(0.08 * rng.normal(size=power.shape[1]))


def quantised(power: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.round(power / 0.04) * 0.04


def spikes(power: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.where(rng.uniform(size=power.shape) < 0.01, 65.535, power)


def stale(power: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    power = power.copy()
    for i in np.flatnonzero(rng.uniform(size=len(power)) < 0.05):
        power[i] = power[max(i - 1, 0)]
    return power


def warm(power: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Panels that warm up by 40 K after the eclipse, uncorrected, at -0.2 % a kelvin."""
    return power * (1.04 - 0.08 * (1 - np.exp(-np.arange(len(power)) / 15)))[:, None]


SINGLE = (albedo, offset, battery, dead_string, dead_panel, gains, quantised, spikes, stale, warm)
FAULTS: dict[str, tuple[Fault, ...]] = {
    "none": (),
    **{fault.__name__: (fault,) for fault in SINGLE},
}
FAULTS["sides"] = (dead_string, albedo, battery, quantised)
FAULTS["everything"] = (gains, dead_string, warm, albedo, battery, quantised, spikes, stale)


def twin(
    faults: tuple[Fault, ...], rng: np.random.Generator, craft: Vehicle = CUBE
) -> tuple[xr.Dataset, xr.Dataset]:
    """Telemetry and truth."""
    t = np.concatenate([[0.0], np.cumsum(10.0 * rng.uniform(0.8, 1.2, SAMPLES - 1))])
    sun = rng.normal(size=3)
    run = ss.propagate(craft, 0.025 * rng.normal(size=3), sun / np.linalg.norm(sun), None, t)
    power = ss.panel_power(craft, run["sun_B"].values)
    attitude = Rotation.from_quat(run["B_from_N"].values)
    for fault in faults:
        seen = {albedo: (attitude, craft.panel_normals_B), offset: (craft.panel_normals_B,)}
        power = fault(power, rng, *seen.get(fault, ()))
    power = np.maximum(
        power + (0.01 * rng.normal(size=power.shape) if quantised not in faults else 0.0), 0.0
    )
    if stale in faults:
        power = stale(power, rng)
    variables = {
        "power_W": (("time", "panel"), power),
        "flag": ("time", np.zeros(SAMPLES, dtype=np.uint8)),
    }
    attrs = {"epoch_utc": "2026-01-01T00:00:00Z", "synthetic": 1}
    return xr.Dataset(variables, {"time": t, "panel": list(craft.panel_names)}, attrs), run


def place(result: xr.Dataset, run: xr.Dataset) -> np.ndarray:
    """Where the true mean rate lies in the distribution told, all modes by their weights: (n_pass, 3), uniform if calibrated."""
    found = []
    for k in range(result.sizes["pass_id"]):
        at = (result["pass_of"] == k).values
        truth = run["omega_B"].sel(time=result["time"].values[at]).values.mean(axis=0)
        weight = np.nan_to_num(result["probability"].values[k])
        away = (truth - result["omega_mean_B"].values[k]) / result["omega_sigma_B"].values[k]
        found.append((weight[:, None] * np.nan_to_num(norm.cdf(away))).sum(axis=0) / weight.sum())
    return np.array(found)


class Coverage(NamedTuple):
    """Share of true mean rates inside the 50 and the 90 % interval, the median error (rad/s), and as a control the share
    inside the 90 % interval if the sigmas were a fifth of what is told."""

    half: float
    ninety: float
    error: float
    too_narrow: float


def coverage(faults: tuple[Fault, ...], count: int, seed: int, craft: Vehicle = CUBE) -> Coverage:
    """Over `count` twins with these faults."""
    places, narrow, errors = [], [], []
    for i in range(count):
        data, run = twin(
            faults, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,))), craft
        )
        result = ss.rates(craft, data, max_rate_rad_s=0.15)
        places.append(place(result, run))
        narrow.append(place(result.assign(omega_sigma_B=result["omega_sigma_B"] / 5), run))
        truth = run["omega_B"].sel(time=result["time"].values).values
        errors.append(np.median(np.linalg.norm(result["omega_B"].values - truth, axis=1)))
    away, control = (np.abs(np.concatenate(u) - 0.5) for u in (places, narrow))
    shares = (float(np.mean(away < 0.25)), float(np.mean(away < 0.45)))
    return Coverage(*shares, float(np.median(errors)), float(np.mean(control < 0.45)))
