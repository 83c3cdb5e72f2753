"""Twins that turn fast, and whether the motions found for them hold the true one. All of it is synthetic.

Rates of 5 to 30 deg/s, samples 1 to 10 s apart give or take a fifth, so that up to a turn hides between two of them; no largest
rate is told.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
import xarray as xr

import sunspin as ss
from sunspin.estimate.rates.result import DECIDED
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from sunspin.vehicle.sensors import Gyro, Sensors

NORMALS = np.vstack([np.eye(3), -np.eye(3)])
GYRO = Gyro(("x", "y", "z"), 1.0, np.zeros(3), 3e-3, zero_sigma=np.full(3, 2e-3), scale_sigma=0.01)
BODIES = {
    "sphere": None,
    "triaxial": np.diag([0.042, 0.05, 0.03]),
    "long": np.diag([0.042, 0.041, 0.008]),
}
DIRECTION_SIGMA = 0.02


class Kind(NamedTuple):
    """What is seen of a twin: mean interval (s), body, whether it has a gyro, `"directions"` or `"panels"`."""

    interval_s: float
    body: str
    gyro: bool
    source: str


class Tally(NamedTuple):
    """Of `count` twins: in how many the truth is a mode, holds 90 % of the weight, is missing although one motion is called
    decided, and is missing but the pass is said to fit badly."""

    count: int
    listed: int
    decided: int
    wrong: int
    refused: int


def craft(kind: Kind) -> Vehicle:
    """The vehicle as it is told; a sphere without inertia."""
    panels = [
        Panel(name, normal, 1.0)
        for name, normal in zip(("+x", "+y", "+z", "-x", "-y", "-z"), NORMALS, strict=True)
    ]
    sensors = Sensors(gyro=GYRO) if kind.gyro else Sensors()
    form = TelemetryForm(noise=0.01)
    inertia = BODIES[kind.body]
    return Vehicle(
        "fast", inertia_kg_m2=inertia, gain_unit="W", panels=panels, telemetry=form, sensors=sensors
    )


def twin(
    kind: Kind, rng: np.random.Generator, samples: int = 40
) -> tuple[Vehicle, xr.Dataset, xr.Dataset]:
    """Vehicle, telemetry and truth."""
    vehicle = craft(kind)
    axis, sun = rng.normal(size=3), rng.normal(size=3)
    t = np.concatenate([[0.0], np.cumsum(kind.interval_s * rng.uniform(0.8, 1.2, samples - 1))])
    omega = np.radians(rng.uniform(5, 30)) * axis / np.linalg.norm(axis)
    body = (
        replace(vehicle, inertia_kg_m2=np.eye(3) * 0.04)
        if vehicle.inertia_kg_m2 is None
        else vehicle
    )
    run = ss.propagate(body, omega, sun / np.linalg.norm(sun), None, t)
    variables = {"flag": ("time", np.zeros(samples, dtype=np.uint8))}
    if kind.source == "panels":
        power = ss.panel_power(vehicle, run["sun_B"].values)
        power += 0.01 * rng.normal(size=power.shape) + 0.05 * rng.uniform(size=power.shape) * (
            power == 0
        )
        variables["power_W"] = (("time", "panel"), np.maximum(power, 0))
    else:
        off = run["sun_B"].values + DIRECTION_SIGMA * rng.normal(size=(samples, 3))
        variables["sun_B"] = (("time", "axis"), off / np.linalg.norm(off, axis=1, keepdims=True))
        variables["sun_cov_B"] = (
            ("time", "axis", "axis2"),
            np.tile(DIRECTION_SIGMA**2 * np.eye(3), (samples, 1, 1)),
        )
    if kind.gyro:
        scale, zero = 1 + GYRO.scale_sigma * rng.normal(), GYRO.zero_sigma * rng.normal(size=3)
        rate = (
            run["omega_B"].values * scale + zero + GYRO.noise_rad_s * rng.normal(size=(samples, 3))
        )
        variables["gyro_B"] = (("time", "axis"), rate)
    attrs = {"epoch_utc": "2026-01-01T00:00:00Z", "synthetic": 1}
    return (
        vehicle,
        xr.Dataset(variables, {"time": t, "panel": list(vehicle.panel_names)}, attrs),
        run,
    )


def near(result: xr.Dataset, run: xr.Dataset, k: int = 0) -> np.ndarray:
    """Which modes of pass `k` have the true mean rate, within five sigma or 0.1 deg/s."""
    truth = (
        run["omega_B"]
        .sel(time=result["time"].values[result["pass_of"].values == k])
        .values.mean(axis=0)
    )
    miss = np.abs(result["omega_mean_B"].values[k] - truth)
    return (miss < np.maximum(5 * result["omega_sigma_B"].values[k], np.radians(0.1))).all(axis=1)


@cache
def found(kind: Kind, seed: int, i: int, **options) -> tuple[xr.Dataset, xr.Dataset]:
    """What `rates` finds of twin i of a kind, and its true motion; to be read only."""
    vehicle, data, run = twin(
        kind, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
    )
    return ss.rates(vehicle, data, **options), run


def tally(kind: Kind, count: int, seed: int, **options) -> Tally:
    """What becomes of `count` twins of a kind."""
    listed = decided = wrong = refused = 0
    for i in range(count):
        result, run = found(kind, seed, i, **options)
        true = near(result, run)
        weight = result["probability"].values[0]
        bad = result["cost"].values[0, 0] > result["cost_limit"].values[0]
        listed += bool(true.any())
        decided += bool(np.nansum(weight[true]) > DECIDED and not bad)
        wrong += bool(not true.any() and weight[0] >= DECIDED and not bad)
        refused += bool(not true.any() and bad)
    return Tally(count, listed, decided, wrong, refused)
