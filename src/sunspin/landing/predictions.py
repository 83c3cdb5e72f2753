"""What a vehicle with a known collision did before and after it, as far as a posterior of its free motion tells.

Up to the collision the draws of the posterior run on; there each meets an impact of a leg, which sticks (paper, eqs. 8-11) unless
assumed otherwise, from a direction drawn as in section 3.3, and runs on after it. The impact takes the vehicle's nominal inertia:
1 % of it is nothing beside a blow from anywhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.cases import case_names, load_case
from sunspin.dynamics import ensemble as k
from sunspin.estimate.posterior.predict import (
    carried,
    checked_times,
    drawn_rows,
    predictions,
    run_to,
)
from sunspin.landing.outcomes import collide
from sunspin.landing.scenario import draws, paper_scenario
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
    if vehicle.name in case_names():
        timeline = timeline or load_case(vehicle.name).timeline
    else:
        timeline = None
    if timeline is None or timeline.epoch_utc.rstrip("Z") != str(epoch_utc).rstrip("Z"):
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
    mode, parts, said = unknown.wheel_mode, [], "none: free motion throughout"
    behind = np.zeros(times.size, dtype=bool) if blow is None else times > blow
    if not behind.all():
        run = run_to(vehicle, rows, times[~behind] - first, mode, workers)
        parts.append(predictions(unknown, rows, run, times[~behind]))
    if blow is not None:
        said = "later than all times"
    if blow is not None and behind.any():
        at = run_to(vehicle, rows, [blow - first], mode, workers)
        fine = np.all(np.isfinite(at["omega_B"]), axis=(1, 2))
        before = k.Rows(
            np.nan_to_num(at["omega_B"][:, 0]),
            np.where(fine[:, None], at["sun_B"][:, 0], rows.sun_B),
            np.nan_to_num(at["wheel_speed_rad_s"][:, 0]),
        )
        law = {"restitution": collision.restitution, "damper": collision.damper}
        scenario = replace(paper_scenario(load_case(vehicle.name)), **law)
        _, hit = collide(vehicle, scenario, draws(seed, np.arange(len(rows))), before, mode)
        bodies = rows.bodies_of(vehicle)  # of torques after the blow nothing is known
        bodies = replace(bodies, steady_N_m=np.zeros_like(bodies.steady_N_m))
        speeds = hit["wheel_speed_rad_s"].values
        after = k.Rows(hit["omega_B"].values, before.sun_B, speeds, bodies)
        run = run_to(vehicle, after, times[behind] - blow, mode, workers)
        run = {name: np.where(fine[:, None, None], x, np.nan) for name, x in run.items()}
        parts.append(predictions(unknown, after, run, times[behind]))
        does = f"hits (restitution {collision.restitution:g}, damper {collision.damper:g})"
        does = "sticks for an instant" if collision == STICKS else does
        said = (
            f"a leg drawn at random {does}, the centre of mass at {scenario.collision_speed_m_s:g} m/s in any direction with a "
            "part along -z"
        )
    return (
        xr.concat(parts, "predicted_s", data_vars="minimal")
        .assign_coords(after_collision=("predicted_s", behind))
        .assign_attrs(carried(tree), collision=said)
    )


def with_predictions(
    vehicle: Vehicle, tree: xr.DataTree, times: Mapping[float, str], *options: Any
) -> None:
    """Add the group `predictions` to a posterior: :func:`predicted` at `times`, s from the epoch -> as asked for."""
    at_times = predicted(vehicle, tree, list(times), *options)
    asked = ("predicted_s", list(times.values()))
    tree["predictions"] = xr.DataTree(at_times.assign_coords(asked=asked))
