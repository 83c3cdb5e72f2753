"""Posteriors made by hand, in the form of `sunspin.posterior`, for tests of what uses one."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np
import xarray as xr

from sunspin.vehicle import Vehicle


def tree_of(
    vehicle: Vehicle,
    omega_B: np.ndarray,
    sun_B: np.ndarray,
    unknowns: Mapping[str, np.ndarray] | None = None,
    span_s: tuple[float, float] = (0.0, 600.0),
    **attrs,
) -> xr.DataTree:
    """Return a posterior whose draws (n) have these rates and directions (n, 3) at the first sample.

    `unknowns`: their values (n) in their own units by name, `wheel_speed_rad_s` (n, n_wheel) and `steady_torque` (n, 2, 3) among
    them; what is missing is as in the vehicle. `span_s`: first and last sample.
    """
    n, each, wheels = len(omega_B), ("chain", "draw"), vehicle.wheels
    speeds = np.tile([wheel.speed_rad_s for wheel in wheels], (n, 1)).reshape(n, len(wheels))
    values = {"wheel_speed_rad_s": speeds, "steady_torque": np.zeros((n, 2, 3))}
    values |= {"log_likelihood_sum": -np.arange(n, dtype=float), **(unknowns or {})}
    dims = {"wheel_speed_rad_s": ("wheel",), "steady_torque": ("stays_in", "axis")}
    inertia = vehicle.require_inertia()
    variables = {
        "omega_B": ((*each, "axis"), omega_B[None]),
        "sun_B": ((*each, "axis"), sun_B[None]),
        "solution_id": (each, np.zeros((1, n), dtype=int)),
    }
    for name, value in values.items():
        a, b = ("xyz".find(letter) for letter in name[-2:])
        centre = inertia[a][b] if name.startswith("inertia_") else 0.0
        about = {"prior_centre": centre, "prior_sigma": 1.0}
        variables[name] = ((*each, *dims.get(name, ())), value[None], about)
    coords = {"chain": [0], "draw": np.arange(n), "axis": ["x", "y", "z"]}
    coords |= {"wheel": [wheel.name for wheel in wheels], "stays_in": ["body", "space"]}
    covariance = np.cov(omega_B.T) if n > 1 else 1e-6 * np.eye(3)
    solutions = xr.Dataset({"probability": ("solution", [1.0])})
    solutions["omega_B"] = ("solution", "axis"), omega_B.mean(axis=0)[None]
    solutions["omega_cov_B"] = ("solution", "axis", "axis2"), covariance[None]
    draws = xr.Dataset(variables, coords)
    tree = xr.DataTree.from_dict({"posterior": draws, "solutions": solutions})
    tree.attrs |= {"vehicle": vehicle.name, "t_first_s": span_s[0], "t_last_s": span_s[1]}
    tree.attrs |= {"samples": 23, "synthetic": 1, "wheel_mode": json.dumps("coast")}
    tree.attrs |= {"verdict_word": "unique"} | attrs
    return tree
