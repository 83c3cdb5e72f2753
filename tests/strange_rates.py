"""Twins for `rates` whose vehicles, sensors, sampling and faults are all drawn anew. All of it is synthetic."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

import sunspin as ss
from strange_twins import FACES, body, unit
from sunspin.base.errors import SunspinError
from sunspin.estimate.inertia import ASSUMED
from sunspin.estimate.rates.result import DECIDED
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from sunspin.vehicle.sensors import Attitude, Gyro, Magnetometer, Sensors
from validation.truths import is_listed

SENSORS = {
    "none": Sensors(),
    "gyro": Sensors(
        gyro=Gyro(
            ("x", "y", "z"), 1.0, np.zeros(3), 2e-3, zero_sigma=np.full(3, 2e-3), scale_sigma=0.01
        )
    ),
    "field": Sensors(magnetometer=Magnetometer(("x", "y", "z"), np.zeros(3), 0.03)),
    "attitude": Sensors(attitude=Attitude(("a", "b", "c", "d"), "last", "N_to_B", 0.01)),
}
FAULTS = ("gains", "earth", "battery", "spikes", "quantised", "dead string")
MISSED_SIGMAS, MISSED_RAD_S = 5.0, np.radians(0.1)
"""A motion is missed where a component of its mean rate is off by more than both."""


def panels(kind: str, rng: np.random.Generator) -> list[Panel]:
    normals = {
        "six": FACES,
        "five": np.delete(FACES, rng.integers(6), axis=0),
        "sides": FACES[[0, 1, 3, 4]],
    }.get(kind)
    if normals is None:
        normals = np.array([unit(rng) for _ in range(rng.integers(6, 10))])
    return [Panel(f"p{i}", normal, 1.0) for i, normal in enumerate(normals)]


def spoilt(
    power: np.ndarray,
    faults: list[str],
    normals: np.ndarray,
    attitude: Rotation,
    rng: np.random.Generator,
) -> np.ndarray:
    """Powers (n, P) of full Sun one, with faults; those of `tests/coverage_twins.py`, for any panels."""
    n, p = power.shape
    if "gains" in faults:
        power = power * np.exp(0.06 * rng.normal(size=p))
    if "dead string" in faults:
        power = power * np.where(np.arange(p) == rng.integers(p), 0.8, 1.0)
    if "earth" in faults:
        power = power + rng.uniform(0.02, 0.08) * np.maximum(
            attitude.apply(unit(rng)) @ normals.T, 0
        )
    if "battery" in faults:
        power = np.where(
            rng.uniform(size=(n, 1)) < 0.15, power * rng.uniform(0.1, 0.75, (n, 1)), power
        )
    return (
        np.where(rng.uniform(size=power.shape) < 0.01, 30.0, power) if "spikes" in faults else power
    )


def seen(kind: str, run: xr.Dataset, rng: np.random.Generator) -> dict[str, Any]:
    """What the other sensor reads."""
    n, turned = run.sizes["time"], Rotation.from_quat(run["B_from_N"].values)
    if kind == "gyro":
        read = (
            run["omega_B"].values * (1 + 0.01 * rng.normal())
            + 2e-3 * rng.normal(size=3)
            + 2e-3 * rng.normal(size=(n, 3))
        )
        return {"gyro_B": (("time", "axis"), read)}
    if kind == "field":
        return {
            "field_B": (("time", "axis"), turned.apply(unit(rng)) + 0.03 * rng.normal(size=(n, 3)))
        }
    if kind == "attitude":
        read = (Rotation.from_rotvec(0.01 * rng.normal(size=(n, 3))) * turned).as_quat()
        return {"attitude_B_from_N": (("time", "quaternion"), read)}
    return {}


def make(seed: int, i: int) -> tuple[Vehicle, xr.Dataset, xr.Dataset, dict[str, Any]]:
    """The vehicle as it is told, telemetry, the true motion, and whether its inertia is told."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
    tensor, rate, noise = (
        body(rng),
        np.radians(10 ** rng.uniform(-0.5, 0.8)),
        10 ** rng.uniform(-2.3, -1.3),
    )
    kind = str(rng.choice(["six", "six", "five", "sides", "anywhere"]))
    sensor = str(rng.choice(["none", "none", *list(SENSORS)[1:]]))
    faults = [fault for fault in FAULTS if rng.random() < 0.25]
    told = bool(rng.random() < 0.7)
    form = TelemetryForm(noise=noise if rng.random() < 0.7 else None)
    vehicle = Vehicle(
        "strange",
        inertia_kg_m2=tensor if told else None,
        gain_unit="W",
        panels=panels(kind, rng),
        telemetry=form,
        sensors=SENSORS[sensor],
    )
    interval, n = float(np.clip(rng.uniform(0.1, 2.2) / rate, 1.0, 60.0)), int(rng.integers(15, 61))
    t = np.concatenate([[0.0], np.cumsum(interval * rng.uniform(0.8, 1.2, n - 1))])
    moments = np.array(tensor)
    moments[np.diag_indices(3)] *= 1 + ASSUMED * rng.standard_normal(3)
    run = ss.propagate(
        replace(vehicle, inertia_kg_m2=moments), rate * unit(rng), unit(rng), None, t
    )
    normals = vehicle.panel_normals_B
    power = spoilt(
        ss.panel_power(vehicle, run["sun_B"].values),
        faults,
        normals,
        Rotation.from_quat(run["B_from_N"].values),
        rng,
    )
    power = power + noise * rng.normal(size=power.shape)
    power = np.round(power / 0.03) * 0.03 if "quantised" in faults else power
    power = np.maximum(power, 0.0) if rng.random() < 0.5 else power
    variables = {
        "power_W": (("time", "panel"), power),
        "flag": ("time", np.zeros(n, dtype=np.uint8)),
        **seen(sensor, run, rng),
    }
    attrs = {"epoch_utc": "2026-01-01T00:00:00Z", "synthetic": 1}
    about = {"inertia": told}
    return (
        vehicle,
        xr.Dataset(variables, {"time": t, "panel": list(vehicle.panel_names)}, attrs),
        run,
        about,
    )


def judge(seed: int, i: int) -> dict[str, Any]:
    """What `rates` says of a twin, or that it refuses, and how far the truth is from the nearest of its motions."""
    vehicle, data, run, about = make(seed, i)
    try:
        result = ss.rates(vehicle, data)
    except SunspinError as error:
        return about | {"word": "refused", "verdict": str(error), "listed": False}
    return about | judged(result, run, 0) | {"verdict": result.attrs["verdict"]}


def judged(result: xr.Dataset, run: xr.Dataset, k: int) -> dict[str, Any]:
    """How far the true mean rate is from the nearest motion of pass `k`."""
    truth = (
        run["omega_B"]
        .sel(time=result["time"].values[result["pass_of"].values == k])
        .values.mean(axis=0)
    )
    sigma = result["omega_sigma_B"].values[k]
    miss = np.abs(result["omega_mean_B"].values[k] - truth)
    near = (miss < np.maximum(MISSED_SIGMAS * sigma, MISSED_RAD_S)).all(axis=1)
    weight = np.nan_to_num(result["probability"].values[k])
    best = int(
        np.nanargmin(
            np.where(np.isnan(miss).any(axis=1), np.inf, np.linalg.norm(miss / sigma, axis=1))
        )
    )
    bad = bool(result["cost"].values[k, 0] > result["cost_limit"].values[k])
    word = "fits badly" if bad else "decided" if weight[0] >= DECIDED else "several"
    return {
        "word": word,
        "listed": is_listed(result["omega_mean_B"].values[k], sigma, weight, truth),
        "best": bool(near[0]),
        "probability": float(weight[near].sum()),
        "pulls": (miss / sigma)[best].tolist(),
        "miss_deg_s": np.degrees(miss[best]).tolist(),
    }
