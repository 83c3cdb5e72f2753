"""Predictions from a posterior of the free motion for a vehicle with a known collision, before and after it.

The draws of the posterior are propagated up to the collision. There each undergoes an impact of a leg, which sticks (paper, eqs. 8
to 11) unless assumed otherwise. The direction of the impact is drawn as in section 3.3. The impact uses the vehicle's nominal
inertia, because its uncertainty of 1 % is negligible compared with the unknown direction.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.cases import case_names, load_case
from sunspin.dynamics.batch import Rows
from sunspin.estimate.lander.predict import (
    DrawnMotions,
    PredictedStates,
    attributes_of,
    checked_times,
    predictions,
)
from sunspin.landing.outcomes import collide
from sunspin.landing.scenario import draw_uniform, paper_scenario
from sunspin.vehicle import Vehicle
from sunspin.vehicle.assumptions import Collision
from sunspin.vehicle.timeline import Timeline

STICKS = Collision()
"""Law of the collision without changes: the leg sticks for an instant."""


def collision_time_s(
    vehicle: Vehicle, epoch_utc: str | None, timeline: Timeline | None = None
) -> float | None:
    """Return the time of the collision of a built-in case, s from the epoch, from `timeline` or else the case's own.

    None if the vehicle is not that of a built-in case, its timeline has no collision, or the timeline has another epoch.
    """
    if vehicle.name in case_names():
        timeline = timeline or load_case(vehicle.name).timeline
    else:
        timeline = None
    if timeline is None or timeline.epoch_utc.rstrip("Z") != str(epoch_utc).rstrip("Z"):
        return None
    return next((event.t_s for event in timeline.events if event.name == "collision"), None)


def predict_through_collision(
    vehicle: Vehicle,
    tree: xr.DataTree,
    times_s: npt.ArrayLike,
    seed: int = 0,
    timeline: Timeline | None = None,
    collision: Collision = STICKS,
    workers: int | None = None,
) -> xr.Dataset:
    """Predict the motion as :func:`sunspin.estimate.lander.predict.predict` does, also through the collision of a built-in case.

    Parameters
    ----------
    tree : DataTree
        A posterior.
    times_s : (n_t)
        Times of the predictions, s from the epoch. A time equal to that of the collision gives the motion just before it.
    seed : int
        Seed of the legs that hit and of the directions of the impact.
    timeline : Timeline, optional
        Gives the time of the collision; default: that of the case.
    collision : Collision
        Law of the collision.
    workers : int, optional
        Number of threads, by default one per core; the result does not depend on it.

    Returns
    -------
    xarray.Dataset
        Over `predicted_s`, as of `predict`, with the coordinate `after_collision (predicted_s)`. ``attrs["collision"]`` states in
        words how the collision was drawn.
    """
    motions = DrawnMotions.of(vehicle, tree)
    times = checked_times(times_s, motions.start_s)
    impact_s = collision_time_s(vehicle, tree.attrs.get("epoch_utc"), timeline)
    description = "none: free motion throughout" if impact_s is None else "later than all times"
    later = np.zeros(times.size, dtype=bool) if impact_s is None else times > impact_s
    parts = []
    if not later.all():
        before_s = times[~later]
        parts.append(predictions(motions, motions.at(before_s, workers), before_s))
    if impact_s is not None and later.any():
        rows, at_impact = motions.rows, motions.at([impact_s], workers)
        # Draws whose motion could not be computed get stand-in numbers, as the impact needs finite ones; below they become NaN.
        computed = np.all(np.isfinite(at_impact.omega_B), axis=(1, 2))
        before = Rows(
            np.nan_to_num(at_impact.omega_B[:, 0]),
            np.where(computed[:, None], at_impact.sun_B[:, 0], rows.sun_B),
            np.nan_to_num(at_impact.wheel_speed_rad_s[:, 0]),
        )
        law = {"restitution": collision.restitution, "damper": collision.damper}
        scenario = replace(paper_scenario(load_case(vehicle.name)), **law)
        draw = draw_uniform(seed, np.arange(len(rows)))
        _, hit = collide(vehicle, scenario, draw, before, motions.wheel_mode)
        bodies = rows.bodies_of(vehicle)
        # torques after the impact are not known
        bodies = replace(bodies, steady_N_m=np.zeros_like(bodies.steady_N_m))
        speeds = hit["wheel_speed_rad_s"].values
        after = Rows(hit["omega_B"].values, before.sun_B, speeds, bodies)
        moving = replace(motions, rows=after, start_s=impact_s)
        reached = (
            np.where(computed[:, None, None], values, np.nan)
            for values in moving.at(times[later], workers)
        )
        parts.append(predictions(moving, PredictedStates(*reached), times[later]))
        action = "sticks for an instant"
        if collision != STICKS:
            action = f"hits (restitution {collision.restitution:g}, damper {collision.damper:g})"
        description = (
            f"a leg drawn at random {action}, the centre of mass at {scenario.collision_speed_m_s:g} m/s in any direction with a "
            "part along -z"
        )
    return (
        xr.concat(parts, "predicted_s", data_vars="minimal")
        .assign_coords(after_collision=("predicted_s", later))
        .assign_attrs(attributes_of(tree), collision=description)
    )


def add_predictions(
    vehicle: Vehicle, tree: xr.DataTree, times: Mapping[float, str], *options: Any
) -> None:
    """Add the group `predictions` of :func:`predict_through_collision` to a posterior, in place.

    Parameters
    ----------
    times : mapping
        Time of each prediction, s from the epoch -> text with which the user asked for it.
    *options
        `seed`, `timeline` and so on of `predict_through_collision`, in its order.
    """
    predicted = predict_through_collision(vehicle, tree, list(times), *options)
    tree["predictions"] = xr.DataTree(
        predicted.assign_coords(asked=("predicted_s", list(times.values())))
    )
