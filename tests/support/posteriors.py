"""Posteriors made by hand, in the form of `sunspin.posterior`, for tests of what uses one."""

from __future__ import annotations

import json

import numpy as np
import xarray as xr

from sunspin.estimate.posterior.model import State, model
from sunspin.vehicle import Vehicle


def tree_of(
    vehicle: Vehicle,
    state: State,
    priors: dict,
    first_s: float = 0.0,
    last_s: float = 600.0,
    samples: int = 5,
    **attrs,
) -> xr.DataTree:
    """Return a posterior whose draws (n) are `state` at the first sample, `u` in the order of the model's unknowns."""
    unknown, _ = model(vehicle, priors, 1.0)
    n, each = len(state), ("chain", "draw")
    values = unknown.values(state.u)
    variables = {
        "omega_B": ((*each, "axis"), state.omega[None]),
        "sun_B": ((*each, "axis"), state.sun[None]),
        "wheel_speed_rad_s": ((*each, "wheel"), unknown.wheel_speeds(state.u)[None]),
        "solution_id": (each, np.zeros((1, n), dtype=int)),
        "log_likelihood_sum": (each, -np.arange(n, dtype=float)[None]),
    }
    for i, x in enumerate(unknown.unknowns):
        if x.kind != "wheel_speed":
            variables[x.name] = (
                each,
                values[:, i][None],
                {"prior_centre": x.centre, "prior_sigma": x.sigma},
            )
    coords = {
        "chain": [0],
        "draw": np.arange(n),
        "axis": ["x", "y", "z"],
        "wheel": [w.name for w in vehicle.wheels],
    }
    cov = np.cov(state.omega.T) if n > 1 else 1e-6 * np.eye(3)
    modes = xr.Dataset(
        {
            "probability": ("solution", [1.0]),
            "omega_B": (("solution", "axis"), state.omega.mean(axis=0)[None]),
            "omega_cov_B": (("solution", "axis", "axis2"), cov[None]),
        }
    )
    tree = xr.DataTree.from_dict({"posterior": xr.Dataset(variables, coords), "solutions": modes})
    tree.attrs |= {
        "vehicle": vehicle.name,
        "t_first_s": first_s,
        "t_last_s": last_s,
        "samples": samples,
        "synthetic": 1,
        "priors_given": json.dumps(priors),
        "wheel_mode": '"coast"',
        "verdict_word": "unique",
    } | attrs
    return tree
