"""Twins for the posterior whose vehicles, sampling and noise are all drawn anew. All of it is synthetic.

Nothing is drawn as the posterior presumes it, but that the inertia, wheels and friction are off by as much as it assumes.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.stats import chi2

import sunspin as ss
from sunspin.base.errors import SunspinError
from sunspin.estimate.posterior.model import ASSUMED
from sunspin.vehicle import Friction, Panel, TelemetryForm, Vehicle, Wheel
from validation.truths import is_in_solutions

FACES = np.vstack([np.eye(3), -np.eye(3)])


class Twin(NamedTuple):
    """The vehicle as it is told, its telemetry, the true rate at the first sample (3) rad/s, the priors told, what was drawn."""

    vehicle: Vehicle
    telemetry: xr.Dataset
    omega_B: np.ndarray
    priors: dict[str, Any]
    about: dict[str, Any]


def unit(rng: np.random.Generator) -> np.ndarray:
    vector = rng.standard_normal(3)
    return vector / np.linalg.norm(vector)


def body(rng: np.random.Generator) -> np.ndarray:
    """Inertia (3, 3) kg m2 of a dozen masses in random places of a box."""
    points = rng.normal(size=(12, 3)) * rng.uniform(0.3, 1.0, 3)
    points -= points.mean(axis=0)
    size = 10 ** rng.uniform(-2, 1.5)
    tensor = size * (np.eye(3) * (points**2).sum() - points.T @ points)
    return np.diag(np.diag(tensor)) if rng.random() < 0.5 else tensor


def panels(rng: np.random.Generator) -> list[Panel]:
    """Faces of a cube, all or five of them, or four to eight panels that look anywhere; gains differ by a third."""
    kind = rng.choice(["six", "five", "anywhere"])
    normals = FACES if kind == "six" else np.delete(FACES, rng.integers(6), axis=0)
    if kind == "anywhere":
        normals = np.array([unit(rng) for _ in range(rng.integers(4, 9))])
    gains = rng.uniform(0.7, 1.0, len(normals))
    return [
        Panel(f"p{i}", normal, float(gain))
        for i, (normal, gain) in enumerate(zip(normals, gains, strict=True))
    ]


def wheels(rng: np.random.Generator, inertia: np.ndarray, rate: float) -> list[Wheel]:
    """None, one or two wheels with a momentum of 0.1 to 2 times the body's, and friction that stops them in 0.2 to 3 hours."""
    out = []
    for i in range(rng.choice([0, 0, 1, 1, 2])):
        momentum = rate * float(np.trace(inertia)) / 3 * rng.uniform(0.1, 2.0)
        speed = rng.uniform(100, 800) * rng.choice([-1, 1])
        own = momentum / abs(speed)
        lost = momentum / rng.uniform(700, 10_000)
        part = rng.uniform(0, 1)
        out.append(
            Wheel(
                f"w{i}",
                unit(rng),
                own,
                speed,
                Friction(lost * part, lost * (1 - part) / abs(speed)),
            )
        )
    return out


def true_body(vehicle: Vehicle, rng: np.random.Generator) -> Vehicle:
    """The same with moments, speeds and friction off by what the posterior assumes where the file says nothing."""
    tensor = np.array(vehicle.inertia_kg_m2)
    tensor[np.diag_indices(3)] *= 1 + ASSUMED["inertia"] * rng.standard_normal(3)
    moved = []
    for wheel in vehicle.wheels:
        dry, viscous = np.exp(ASSUMED["friction"] * rng.standard_normal(2))
        friction = Friction(
            wheel.friction.coulomb_N_m * dry, wheel.friction.viscous_N_m_s * viscous
        )
        speed = wheel.speed_rad_s * (1 + ASSUMED["wheel_speed"] * rng.standard_normal())
        moved.append(replace(wheel, speed_rad_s=speed, friction=friction))
    return replace(vehicle, inertia_kg_m2=tensor, wheels=moved)


def make(seed: int, i: int, turns: float = 0.24) -> Twin:
    """Twin i of a seed; it makes at most `turns` between two samples."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
    rate, inertia = 10 ** rng.uniform(-1.7, -0.4), body(rng)
    noise = 10 ** rng.uniform(-2.3, -1.3)
    stated = noise if rng.random() < 0.7 else None
    form = TelemetryForm(quantity="current_A", noise=stated)
    vehicle = Vehicle(
        "strange",
        inertia_kg_m2=inertia,
        panels=panels(rng),
        wheels=wheels(rng, inertia, rate),
        telemetry=form,
    )
    interval = min(rng.uniform(0.2, 2 * np.pi * turns) / rate, 120.0)
    n = int(rng.integers(10, 41))
    t = interval * np.arange(n) + np.concatenate(
        [[0.0], rng.uniform(-0.25, 0.25, n - 1) * interval * (rng.random() < 0.7)]
    )
    omega, dark = rate * unit(rng), str(rng.choice(["zero", "clipped", "below zero"]))
    truth = {
        "omega_B": omega,
        "sun_B": unit(rng),
        "t_s": t,
        "scale": float(10 ** rng.uniform(-1, 1)),
        "noise": 0.0,
    }
    telemetry = ss.twin(true_body(vehicle, rng), truth, seed=i)
    value = telemetry["current_A"].values
    noisy = value + noise * truth["scale"] * rng.standard_normal(value.shape)
    floor = {
        "zero": np.where(value > 0, noisy, 0.0),
        "clipped": np.maximum(noisy, 0.0),
        "below zero": noisy,
    }
    telemetry["current_A"].values[:] = floor[dark]
    if stated is not None:
        vehicle = replace(vehicle, telemetry=replace(form, noise=noise * truth["scale"]))
    told = {
        "max_rate_rad_s": float(rng.uniform(1.1, 2.0) * rate),
        "steady_torque": 0.0,
    }  # none acts
    about = {
        "rate": rate,
        "turns_between": rate * interval / 2 / np.pi,
        "samples": n,
        "panels": len(vehicle.panels),
        "wheels": len(vehicle.wheels),
        "noise": noise,
        "stated": stated is not None,
        "dark": dark,
    }
    return Twin(vehicle, telemetry, omega, told, about)


def judge(twin: Twin, workers: int | None) -> dict[str, Any]:
    """What the posterior says of a twin, and how far the truth is from it."""
    began = time.process_time()
    try:
        tree = ss.posterior(twin.vehicle, twin.telemetry, twin.priors, seed=0, workers=workers)
    except SunspinError as error:
        return twin.about | {"word": "refused", "verdict": str(error), "listed": False}
    modes = tree["solutions"]
    off = twin.omega_B - modes["omega_B"].values
    spread = modes["omega_cov_B"].values
    far = [float(np.sqrt(o @ np.linalg.solve(c, o))) for o, c in zip(off, spread, strict=True)]
    nearest = int(np.argmin(far))
    return twin.about | {
        "word": tree.attrs["verdict_word"],
        "verdict": tree.attrs["verdict"],
        "listed": is_in_solutions(modes.to_dataset(), twin.omega_B),
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
