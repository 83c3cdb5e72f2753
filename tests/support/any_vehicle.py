"""Simulated cases for `rates` and `posterior` whose vehicle, sensors, sampling and faults are all drawn. All of it is synthetic.

Nothing is drawn from the priors of the estimates, except that inertia, wheels and friction are off by as much as they assume.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import sunspin as ss
from sunspin.base.errors import SunspinError
from sunspin.estimate.verdict import DECIDED
from sunspin.vehicle import Friction, Panel, TelemetryForm, Vehicle, Wheel
from sunspin.vehicle.sensors import Attitude, Gyro, Magnetometer, Sensors
from tests.support.simulate import telemetry_of, uneven_times
from tests.support.vehicles import CUBE_NORMALS, unit_vector
from validation.calibrate import ASSUMED
from validation.truths import is_in_solutions, is_listed


def random_inertia(rng: np.random.Generator) -> np.ndarray:
    """Draw the inertia (3, 3) kg m2 of a dozen masses in random places of a box."""
    points = rng.normal(size=(12, 3)) * rng.uniform(0.3, 1.0, 3)
    points -= points.mean(axis=0)
    size = 10 ** rng.uniform(-2, 1.5)
    tensor = size * (np.eye(3) * (points**2).sum() - points.T @ points)
    return np.diag(np.diag(tensor)) if rng.random() < 0.5 else tensor


# -------------------------------------------------------------------------------------------------------------------------- rates

GYRO_SIGMAS: dict[str, Any] = {"zero_sigma": np.full(3, 2e-3), "scale_sigma": 0.01}
SENSORS = {
    "none": Sensors(),
    "gyro": Sensors(gyro=Gyro(("x", "y", "z"), 1.0, np.zeros(3), 2e-3, **GYRO_SIGMAS)),
    "field": Sensors(magnetometer=Magnetometer(("x", "y", "z"), np.zeros(3), 0.03)),
    "attitude": Sensors(attitude=Attitude(("a", "b", "c", "d"), "last", "N_to_B", 0.01)),
}
FAULTS = ("gains", "earth", "battery", "spikes", "quantised", "dead string")
MISSED_SIGMAS, MISSED_RAD_S = 5.0, np.radians(0.1)
"""A solution misses the truth if a component of its mean rate is off by more than both."""


def panels_of_kind(kind: str, rng: np.random.Generator) -> list[Panel]:
    """Return panels of gain one: "six" or "five" faces of a cube, four "sides", or six to nine that look "anywhere"."""
    five = np.delete(CUBE_NORMALS, rng.integers(6), axis=0)
    normals = {"six": CUBE_NORMALS, "five": five, "sides": CUBE_NORMALS[[0, 1, 3, 4]]}.get(kind)
    if normals is None:
        normals = np.array([unit_vector(rng) for _ in range(rng.integers(6, 10))])
    return [Panel(f"p{i}", normal, 1.0) for i, normal in enumerate(normals)]


def with_faults(
    power: np.ndarray,
    faults: list[str],
    normals: np.ndarray,
    attitude: Rotation,
    rng: np.random.Generator,
) -> np.ndarray:
    """Return powers (n, P) relative to full Sun with these faults; `attitude` takes N to B at each sample."""
    n, p = power.shape
    if "gains" in faults:
        power = power * np.exp(0.06 * rng.normal(size=p))
    if "dead string" in faults:
        power = power * np.where(np.arange(p) == rng.integers(p), 0.8, 1.0)
    if "earth" in faults:
        share = rng.uniform(0.02, 0.08)
        power = power + share * np.maximum(attitude.apply(unit_vector(rng)) @ normals.T, 0)
    if "battery" in faults:
        full = rng.uniform(size=(n, 1)) < 0.15
        power = np.where(full, power * rng.uniform(0.1, 0.75, (n, 1)), power)
    if "spikes" in faults:
        power = np.where(rng.uniform(size=power.shape) < 0.01, 30.0, power)
    return power


def sensor_readings(kind: str, run: xr.Dataset, rng: np.random.Generator) -> dict[str, Any]:
    """Return the variables that the other sensor of this kind adds to the telemetry."""
    n, attitude = run.sizes["time"], Rotation.from_quat(run["B_from_N"].values)
    if kind == "gyro":
        read = run["omega_B"].values * (1 + 0.01 * rng.normal()) + 2e-3 * rng.normal(size=3)
        return {"gyro_B": (("time", "axis"), read + 2e-3 * rng.normal(size=(n, 3)))}
    if kind == "field":
        field = attitude.apply(unit_vector(rng)) + 0.03 * rng.normal(size=(n, 3))
        return {"field_B": (("time", "axis"), field)}
    if kind == "attitude":
        read = (Rotation.from_rotvec(0.01 * rng.normal(size=(n, 3))) * attitude).as_quat()
        return {"attitude_B_from_N": (("time", "quaternion"), read)}
    return {}


def rates_case(seed: int, i: int) -> tuple[Vehicle, xr.Dataset, xr.Dataset, dict[str, Any]]:
    """Draw case `i` of a seed: the vehicle as its file states it, telemetry, the true motion, and whether the inertia is stated."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
    tensor = random_inertia(rng)
    rate = np.radians(10 ** rng.uniform(-0.5, 0.8))
    noise = 10 ** rng.uniform(-2.3, -1.3)
    kind = str(rng.choice(["six", "six", "five", "sides", "anywhere"]))
    sensor = str(rng.choice(["none", "none", *list(SENSORS)[1:]]))
    faults = [fault for fault in FAULTS if rng.random() < 0.25]
    stated = bool(rng.random() < 0.7)
    form = TelemetryForm(noise=noise if rng.random() < 0.7 else None)
    parts: dict[str, Any] = {"panels": panels_of_kind(kind, rng), "sensors": SENSORS[sensor]}
    inertia = tensor if stated else None
    vehicle = Vehicle("strange", inertia, gain_unit="W", telemetry=form, **parts)
    interval, n = float(np.clip(rng.uniform(0.1, 2.2) / rate, 1.0, 60.0)), int(rng.integers(15, 61))
    t = uneven_times(rng, n, interval, 0.2)
    moments = np.array(tensor)
    moments[np.diag_indices(3)] *= 1 + ASSUMED["inertia"] * rng.standard_normal(3)
    body = replace(vehicle, inertia_kg_m2=moments)
    run = ss.propagate(body, rate * unit_vector(rng), unit_vector(rng), None, t)
    attitude = Rotation.from_quat(run["B_from_N"].values)
    power = ss.panel_power(vehicle, run["sun_B"].values)
    power = with_faults(power, faults, vehicle.panel_normals_B, attitude, rng)
    power = power + noise * rng.normal(size=power.shape)
    power = np.round(power / 0.03) * 0.03 if "quantised" in faults else power
    power = np.maximum(power, 0.0) if rng.random() < 0.5 else power
    data = telemetry_of(vehicle, t, power, **sensor_readings(sensor, run, rng))
    return vehicle, data, run, {"inertia": stated}


def judge_rates(seed: int, i: int) -> dict[str, Any]:
    """Return what `rates` prints of case `i`, or that it refuses, and how far the truth is from the nearest solution."""
    vehicle, data, run, about = rates_case(seed, i)
    try:
        result = ss.rates(vehicle, data)
    except SunspinError as error:
        return about | {"word": "refused", "verdict": str(error), "listed": False}
    return about | pass_against_truth(result, run, 0) | {"verdict": result.attrs["verdict"]}


def pass_against_truth(result: xr.Dataset, run: xr.Dataset, k: int) -> dict[str, Any]:
    """Return how far the true mean rate is from the nearest solution of pass `k`."""
    times = result["time"].values[result["pass_of"].values == k]
    truth = run["omega_B"].sel(time=times).values.mean(axis=0)
    sigma = result["omega_sigma_B"].values[k]
    miss = np.abs(result["omega_mean_B"].values[k] - truth)
    near = (miss < np.maximum(MISSED_SIGMAS * sigma, MISSED_RAD_S)).all(axis=1)
    probability = np.nan_to_num(result["probability"].values[k])
    far = np.linalg.norm(miss / sigma, axis=1)
    best = int(np.argmin(np.where(np.isnan(far), np.inf, far)))
    bad = bool(result["cost"].values[k, 0] > result["cost_limit"].values[k])
    word = "fits badly" if bad else "decided" if probability[0] >= DECIDED else "several"
    listed = is_listed(result["omega_mean_B"].values[k], sigma, probability, truth)
    about = {"word": word, "listed": listed, "best": bool(near[0])}
    about |= {"probability": float(probability[near].sum())}
    about |= {"pulls": (miss / sigma)[best].tolist(), "miss_deg_s": np.degrees(miss[best]).tolist()}
    return about


# ---------------------------------------------------------------------------------------------------------------------- posterior


class PosteriorCase(NamedTuple):
    """The vehicle as its file states it, telemetry, true rate (3) rad/s at the first sample, the priors given, what was drawn."""

    vehicle: Vehicle
    telemetry: xr.Dataset
    omega_B: np.ndarray
    priors: dict[str, Any]
    about: dict[str, Any]


def random_panels(rng: np.random.Generator) -> list[Panel]:
    """Draw the panels of a cube, all or five, or four to eight with any normals; gains differ by a third."""
    kind = rng.choice(["six", "five", "anywhere"])
    normals = CUBE_NORMALS if kind == "six" else np.delete(CUBE_NORMALS, rng.integers(6), axis=0)
    if kind == "anywhere":
        normals = np.array([unit_vector(rng) for _ in range(rng.integers(4, 9))])
    gains = rng.uniform(0.7, 1.0, len(normals))
    return [
        Panel(f"p{i}", *each) for i, each in enumerate(zip(normals, gains.tolist(), strict=True))
    ]


def random_wheels(rng: np.random.Generator, inertia: np.ndarray, rate: float) -> list[Wheel]:
    """Draw none, one or two wheels with a momentum of 0.1 to 2 times the body's, stopped by friction in 0.2 to 3 hours."""
    out = []
    for i in range(rng.choice([0, 0, 1, 1, 2])):
        momentum = rate * float(np.trace(inertia)) / 3 * rng.uniform(0.1, 2.0)
        speed = rng.uniform(100, 800) * rng.choice([-1, 1])
        own = momentum / abs(speed)
        lost = momentum / rng.uniform(700, 10_000)
        part = rng.uniform(0, 1)
        friction = Friction(lost * part, lost * (1 - part) / abs(speed))
        out.append(Wheel(f"w{i}", unit_vector(rng), own, speed, friction))
    return out


def true_body(vehicle: Vehicle, rng: np.random.Generator) -> Vehicle:
    """Draw the true body: moments, speeds and friction off by what the posterior assumes if the file states no sigma."""
    tensor = np.array(vehicle.inertia_kg_m2)
    tensor[np.diag_indices(3)] *= 1 + ASSUMED["inertia"] * rng.standard_normal(3)
    moved = []
    for wheel in vehicle.wheels:
        stated = np.array([wheel.friction.coulomb_N_m, wheel.friction.viscous_N_m_s])
        friction = Friction(*stated * np.exp(ASSUMED["friction"] * rng.standard_normal(2)))
        speed = wheel.speed_rad_s * (1 + ASSUMED["wheel_speed"] * rng.standard_normal())
        moved.append(replace(wheel, speed_rad_s=speed, friction=friction))
    return replace(vehicle, inertia_kg_m2=tensor, wheels=moved)


def posterior_case(seed: int, i: int, revolutions: float = 0.24) -> PosteriorCase:
    """Draw case `i` of a seed, with at most this many revolutions between two samples."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
    rate, inertia = 10 ** rng.uniform(-1.7, -0.4), random_inertia(rng)
    noise = 10 ** rng.uniform(-2.3, -1.3)
    stated = noise if rng.random() < 0.7 else None
    form = TelemetryForm(quantity="current_A", noise=stated)
    parts: dict[str, Any] = {"panels": random_panels(rng), "telemetry": form}
    vehicle = Vehicle("strange", inertia, wheels=random_wheels(rng, inertia, rate), **parts)
    interval = min(rng.uniform(0.2, 2 * np.pi * revolutions) / rate, 120.0)
    n = int(rng.integers(10, 41))
    late = rng.uniform(-0.25, 0.25, n - 1) * interval * (rng.random() < 0.7)
    t = interval * np.arange(n) + np.concatenate([[0.0], late])
    omega, dark = rate * unit_vector(rng), str(rng.choice(["zero", "clipped", "below zero"]))
    truth = {"omega_B": omega, "sun_B": unit_vector(rng), "t_s": t, "noise": 0.0}
    truth["scale"] = float(10 ** rng.uniform(-1, 1))
    telemetry = ss.twin(true_body(vehicle, rng), truth, seed=i)
    value = telemetry["current_A"].values
    noisy = value + noise * truth["scale"] * rng.standard_normal(value.shape)
    clipped, zero = np.maximum(noisy, 0.0), np.where(value > 0, noisy, 0.0)
    floor = {"zero": zero, "clipped": clipped, "below zero": noisy}
    telemetry["current_A"].values[:] = floor[dark]
    if stated is not None:
        vehicle = replace(vehicle, telemetry=replace(form, noise=noise * truth["scale"]))
    # no torque acts
    priors = {"max_rate_rad_s": float(rng.uniform(1.1, 2.0) * rate), "steady_torque": 0.0}
    about = {"rate": rate, "turns_between": rate * interval / 2 / np.pi, "samples": n}
    about |= {"panels": len(vehicle.panels), "wheels": len(vehicle.wheels)}
    about |= {"noise": noise, "stated": stated is not None, "dark": dark}
    return PosteriorCase(vehicle, telemetry, omega, priors, about)


def judge_posterior(case: PosteriorCase, workers: int | None) -> dict[str, Any]:
    """Return the verdict of the posterior on a case, or that it refuses, and how far the truth is from the nearest solution."""
    began = time.process_time()
    try:
        tree = ss.posterior(case.vehicle, case.telemetry, case.priors, seed=0, workers=workers)
    except SunspinError as error:
        return case.about | {"word": "refused", "verdict": str(error), "listed": False}
    modes = tree["solutions"]
    off = case.omega_B - modes["omega_B"].values
    spread = modes["omega_cov_B"].values
    far = [float(np.sqrt(o @ np.linalg.solve(c, o))) for o, c in zip(off, spread, strict=True)]
    nearest = int(np.argmin(far))
    return case.about | {
        "word": tree.attrs["verdict_word"],
        "verdict": tree.attrs["verdict"],
        "listed": is_in_solutions(modes.to_dataset(), case.omega_B),
        "sigmas": far[nearest],
        "solutions": len(far),
        "probability": float(modes["probability"].values[nearest]),
        "level": float(chi2.cdf(far[nearest] ** 2, 3)),
        "error": float(np.linalg.norm(off[nearest])),
        "sigma": float(np.sqrt(np.trace(spread[nearest]))),
        "p": tree.attrs["p_value"],
        "noise_sigmas": tree.attrs["noise_sigmas"],
        "pareto_k": tree.attrs["pareto_k"],
        "effective": tree.attrs["effective_draws"],
        "processor_s": time.process_time() - began,
    }
