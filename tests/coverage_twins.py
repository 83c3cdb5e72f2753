"""Twins with faults of known kinds. All of it is synthetic.

A cube of six panels and known inertia tumbles at up to about 3 deg/s, seen 40 times about 10 s apart. Each fault is named and
acts on the readings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

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


def battery(power: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    limited = rng.uniform(size=len(power)) < 0.15
    return np.where(limited[:, None], power * rng.uniform(0.1, 0.75, (len(power), 1)), power)


def dead_string(power: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return power * np.where(np.arange(power.shape[1]) == rng.integers(power.shape[1]), 0.8, 1.0)


def quantised(power: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.round(power / 0.04) * 0.04


SIDES = (dead_string, albedo, battery, quantised)
"""What is wrong with files of panels on the sides only."""


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
        power = fault(power, rng, *((attitude, craft.panel_normals_B) if fault is albedo else ()))
    power = np.maximum(
        power + (0.01 * rng.normal(size=power.shape) if quantised not in faults else 0.0), 0.0
    )
    variables = {
        "power_W": (("time", "panel"), power),
        "flag": ("time", np.zeros(SAMPLES, dtype=np.uint8)),
    }
    attrs = {"epoch_utc": "2026-01-01T00:00:00Z", "synthetic": 1}
    return xr.Dataset(variables, {"time": t, "panel": list(craft.panel_names)}, attrs), run
