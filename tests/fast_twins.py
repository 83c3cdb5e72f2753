"""Twins that turn fast, seen by directions of the Sun. All of it is synthetic.

Rates of 5 to 30 deg/s of a long body, samples so far apart, give or take a fifth, that up to a turn hides between two of them; no
largest rate is told.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

import sunspin as ss
from sunspin.vehicle import TelemetryForm, Vehicle

LONG = Vehicle(
    "fast", inertia_kg_m2=np.diag([0.042, 0.041, 0.008]), telemetry=TelemetryForm(noise=0.01)
)
DIRECTION_SIGMA = 0.02


def twin(
    interval_s: float, rng: np.random.Generator, samples: int = 40
) -> tuple[Vehicle, xr.Dataset, xr.Dataset]:
    """Vehicle, telemetry and truth; samples are `interval_s` apart in the mean."""
    axis, sun = rng.normal(size=3), rng.normal(size=3)
    t = np.concatenate([[0.0], np.cumsum(interval_s * rng.uniform(0.8, 1.2, samples - 1))])
    omega = np.radians(rng.uniform(5, 30)) * axis / np.linalg.norm(axis)
    run = ss.propagate(LONG, omega, sun / np.linalg.norm(sun), None, t)
    off = run["sun_B"].values + DIRECTION_SIGMA * rng.normal(size=(samples, 3))
    variables = {
        "flag": ("time", np.zeros(samples, dtype=np.uint8)),
        "sun_B": (("time", "axis"), off / np.linalg.norm(off, axis=1, keepdims=True)),
        "sun_cov_B": (
            ("time", "axis", "axis2"),
            np.tile(DIRECTION_SIGMA**2 * np.eye(3), (samples, 1, 1)),
        ),
    }
    attrs = {"epoch_utc": "2026-01-01T00:00:00Z", "synthetic": 1}
    return LONG, xr.Dataset(variables, {"time": t}, attrs), run


def near(result: xr.Dataset, run: xr.Dataset) -> np.ndarray:
    """Which modes of the first pass have the true mean rate, within five sigma or 0.1 deg/s."""
    at = result["time"].values[result["pass_of"].values == 0]
    truth = run["omega_B"].sel(time=at).values.mean(axis=0)
    miss = np.abs(result["omega_mean_B"].values[0] - truth)
    return (miss < np.maximum(5 * result["omega_sigma_B"].values[0], np.radians(0.1))).all(axis=1)
