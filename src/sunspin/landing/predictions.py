"""What a vehicle with a known collision did before and after it, as far as a posterior of its free motion tells.

Up to the collision the draws of the posterior run on; there each meets an impact of a leg, which sticks (paper, eqs. 8-11) unless
assumed otherwise, from a direction drawn as in section 3.3, and runs on after it. The impact takes the vehicle's nominal inertia:
1 % of it is nothing beside a blow from anywhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.dynamics import ensemble as k
from sunspin.dynamics.impact import impact
from sunspin.estimate.posterior.model import Model
from sunspin.estimate.posterior.predict import (
    carried,
    checked_times,
    drawn_rows,
    predictions,
    run_to,
)
from sunspin.landing import scenario as sc
from sunspin.telemetry.case import case_names, load_case
from sunspin.vehicle import Vehicle
from sunspin.vehicle.assumptions import Collision
from sunspin.vehicle.timeline import Timeline

STICKS = Collision()


def collision_s(
    vehicle: Vehicle, epoch_utc: str | None, timeline: Timeline | None = None
) -> float | None:
    """s from the epoch to the collision of a built-in case, by its timeline or the one given; None where there is none.

    Nor is there one if the epoch is another.
    """
    if vehicle.name not in case_names():
        return None
    timeline = timeline or load_case(vehicle.name).timeline
    if (
        timeline is None
        or epoch_utc is None
        or timeline.epoch_utc.rstrip("Z") != str(epoch_utc).rstrip("Z")
    ):
        return None
    return next((event.t_s for event in timeline.events if event.name == "collision"), None)


def predicted(
    vehicle: Vehicle,
    tree: xr.DataTree,
    times_s: npt.ArrayLike,
    seed: int = 0,
    timeline: Timeline | None = None,
    collision: Collision = STICKS,
    workers: int | None = None,
) -> xr.Dataset:
    """As :func:`sunspin.estimate.posterior.predict.predict`, through the collision where the built-in case has one.

    At the instant of the collision it is the motion before. Coordinate `after_collision (predicted_s)` says which times
    are behind it, `attrs["collision"]` in words how it was drawn. `seed` is that of legs and directions, `collision` what the blow
    does; `workers`: threads, one per core unless told, on which nothing of the result depends.
    """
    first = float(tree.attrs["t_first_s"])
    times = checked_times(times_s, first)
    blow = collision_s(vehicle, tree.attrs.get("epoch_utc"), timeline)
    unknown, rows = drawn_rows(vehicle, tree)
    behind = np.zeros(times.size, dtype=bool) if blow is None else times > blow
    parts = []
    if not behind.all():
        run = run_to(vehicle, rows, times[~behind] - first, unknown.wheel_mode, workers)
        parts.append(predictions(unknown, rows, run, times[~behind]))
    said = "none: free motion throughout" if blow is None else "later than all times"
    if blow is not None and behind.any():
        parts.append(_after(unknown, rows, first, times[behind], blow, seed, collision, workers))
        speed = _scenario(vehicle).collision_speed_m_s
        does = (
            "sticks for an instant"
            if collision == STICKS
            else (f"hits (restitution {collision.restitution:g}, damper {collision.damper:g})")
        )
        said = f"a leg drawn at random {does}, the centre of mass at {speed:g} m/s in any direction with a part along -z"
    found = xr.concat(parts, "predicted_s", data_vars="minimal").assign_coords(
        after_collision=("predicted_s", behind)
    )
    return found.assign_attrs(carried(tree), collision=said)


def with_predictions(
    vehicle: Vehicle,
    tree: xr.DataTree,
    times: Mapping[float, str],
    seed: int = 0,
    timeline: Timeline | None = None,
    collision: Collision = STICKS,
    workers: int | None = None,
) -> None:
    """Add the group `predictions` to a posterior: :func:`predicted` at `times`, s from the epoch -> as asked for."""
    found = predicted(vehicle, tree, list(times), seed, timeline, collision, workers)
    tree["predictions"] = xr.DataTree(
        found.assign_coords(asked=("predicted_s", list(times.values())))
    )


def _scenario(vehicle: Vehicle) -> sc.Scenario:
    return sc.paper_scenario(load_case(vehicle.name))


def _after(
    unknown: Model,
    rows: k.Rows,
    first_s: float,
    times_s: np.ndarray,
    blow_s: float,
    seed: int,
    collision: Collision,
    workers: int | None,
) -> xr.Dataset:
    """The draws (n), `rows` at the first sample, at times behind the blow."""
    vehicle = unknown.vehicle
    reached = run_to(vehicle, rows, [blow_s - first_s], unknown.wheel_mode, workers)
    omega, sun, speeds = (reached[name][:, 0] for name in ("omega_B", "sun_B", "wheel_speed_rad_s"))
    fine = np.all(np.isfinite(omega), axis=1)
    scenario, draw = _scenario(vehicle), sc.draws(seed, np.arange(len(rows)))
    axis = np.tile(scenario.collision_axis_B, (len(rows), 1))
    velocity = scenario.collision_speed_m_s * sc.about(axis, draw["polar"], draw["azimuth"])
    leg = (draw["leg"] * len(vehicle.legs)).astype(int)
    hit = impact(
        vehicle,
        np.nan_to_num(omega),
        np.nan_to_num(speeds),
        velocity,
        leg,
        unknown.wheel_mode,
        restitution=collision.restitution,
        damper=collision.damper,
    )
    bodies = rows.bodies_of(vehicle)
    start = k.Rows(
        hit["omega_B"].values,
        np.where(fine[:, None], sun, rows.sun_B),
        hit["wheel_speed_rad_s"].values,
        bodies=replace(
            bodies, steady_N_m=np.zeros_like(bodies.steady_N_m)
        ),  # of torques after the blow nothing is known
    )
    run = run_to(vehicle, start, times_s - blow_s, unknown.wheel_mode, workers)
    run = {name: np.where(fine[:, None, None], values, np.nan) for name, values in run.items()}
    return predictions(unknown, start, run, times_s)
