"""The likeliest motions of a posterior as trajectories: one for each region, to be looked at."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from sunspin.dynamics.propagate import propagate
from sunspin.dynamics.torques import Steady
from sunspin.estimate.posterior.data import group
from sunspin.estimate.posterior.predict import drawn_rows
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import panel_power

MOST_REGIONS = 4
"""Regions of the most weight whose best motion is computed."""

TURN = 0.3
"""rad between two instants, where that is not more than `MOST_INSTANTS`."""

MOST_INSTANTS = 6000

RTOL = 1e-9
"""Relative error of a trajectory that is looked at."""


def best_motions(vehicle: Vehicle, tree: xr.DataTree) -> list[xr.Dataset]:
    """The draw of the highest likelihood of each of the most probable solutions, from the first sample to the last.

    Parameters
    ----------
    vehicle : Vehicle
        The one the posterior was made with.
    tree : DataTree
        Of :func:`sunspin.estimate.posterior.posterior`.

    Returns
    -------
    list of xarray.Dataset
        As of :func:`sunspin.propagate` with the draw's own inertia, friction and wheel speeds, `time` in s from the epoch, and
        `panel_signal` (time, panel) for a brightness of one. attrs: `title` and `about` in words, `solution`, `probability`.

    Raises
    ------
    InputError
        A posterior of another vehicle.
    """
    unknown, rows = drawn_rows(vehicle, tree)
    draws, weight = group(tree, "posterior"), group(tree, "solutions")["probability"].values
    region, height = draws["solution_id"].values.ravel(), draws["log_likelihood_sum"].values.ravel()
    bodies, found = rows.bodies_of(vehicle), []
    for number in np.argsort(-weight, kind="stable")[:MOST_REGIONS]:
        if not (region == number).any():
            continue
        best = int(np.argmax(np.where(region == number, height, -np.inf)))
        start = (rows.omega_B[best], rows.sun_B[best], rows.wheel_speed_rad_s[best])
        steady = bodies.steady_N_m[best]
        run = _run(
            bodies.vehicle(vehicle, best),
            start,
            tree,
            unknown.wheel_mode,
            [Steady(steady)] if steady.any() else [],
        )
        signal = panel_power(vehicle, run["sun_B"].values)
        about = f"The likeliest draw of solution {number + 1}, which holds {weight[number]:.0%} of the probability"
        attrs = {
            "title": f"Solution {number + 1}",
            "about": about,
            "solution": int(number) + 1,
            "probability": float(weight[number]),
        }
        carried = {key: tree.attrs[key] for key in ("epoch_utc", "synthetic") if key in tree.attrs}
        found.append(
            run.assign(panel_signal=(("time", "panel"), signal, {"units": "1"})).assign_attrs(
                attrs | carried
            )
        )
    return found


def _run(
    vehicle: Vehicle,
    start: tuple[np.ndarray, ...],
    tree: Any,
    wheel_mode: Any,
    torques: list[Steady],
) -> xr.Dataset:
    """From the first sample to the last, times in s from the epoch."""
    omega, sun, speeds = start
    first, last = float(tree.attrs["t_first_s"]), float(tree.attrs["t_last_s"])
    coarse = propagate(
        vehicle,
        omega,
        sun,
        speeds,
        np.linspace(0.0, last - first, 200),
        wheel_mode,
        rtol=RTOL,
        torques=torques,
    )
    fastest = float(np.linalg.norm(coarse["omega_B"].values, axis=1).max())
    count = int(np.clip((last - first) * fastest / TURN, 200, MOST_INSTANTS))
    run = propagate(
        vehicle,
        omega,
        sun,
        speeds,
        np.linspace(0.0, last - first, count),
        wheel_mode,
        rtol=RTOL,
        torques=torques,
    )
    return run.assign_coords(time=run["time"] + first).assign(
        event_time_s=run["event_time_s"] + first
    )
