"""Predictions for other times: draws of a posterior propagated, each with its own inertia, friction and wheel speed."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.base.provenance import provenance
from sunspin.compute.pool import worker_count
from sunspin.dynamics import batch, gyrostat
from sunspin.dynamics.bodies import Bodies
from sunspin.dynamics.propagate import propagate
from sunspin.dynamics.torques import NOTHING, Acting, Steady
from sunspin.estimate.lander.model import WHEEL_FACTORS
from sunspin.estimate.lander.priors import wheel_unknown
from sunspin.estimate.lander.tree import EACH, group
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import panel_power

DIRECTION_ERROR = 1e-4
"""Error of directions (rad) of propagated draws, far below the uncertainty of any posterior."""

RUNS_AT_ONCE = 64, 8192
"""Fewest and most draws that one thread propagates together: fewer waste the width of compiled code, more need much memory."""

LONGEST_S = 7 * 86400.0
"""Times further than this from the first sample are an error: the attitude is unknown long before."""

MOST_MOTIONS = 4
"""Solutions of the largest probability whose best motion is computed."""

TURN_RAD, FEWEST_INSTANTS, MOST_INSTANTS = 0.3, 200, 6000
"""Rotation (rad) between two instants of a best motion, and limits of their number."""

BEST_RTOL = 1e-9
"""Relative error of a best motion."""


class PredictedStates(NamedTuple):
    """States of n motions at n_t times, NaN for motions that could not be computed; body axes.

    `omega_B` (n, n_t, 3) in rad/s, `sun_B` (n, n_t, 3), `wheel_speed_rad_s` (n, n_t, n_wheel). The names are those of the variables
    of predictions, and of :class:`batch.Rows` and :class:`batch.Motion`.
    """

    omega_B: np.ndarray
    sun_B: np.ndarray
    wheel_speed_rad_s: np.ndarray


@dataclass(frozen=True)
class DrawnMotions:
    """The n draws of a posterior as motions: `rows` are their states at `start_s` (s from the epoch), each with its own body."""

    vehicle: Vehicle
    rows: batch.Rows
    start_s: float
    wheel_mode: str | tuple[str, ...] = "coast"

    @classmethod
    def of(cls, vehicle: Vehicle, tree: xr.DataTree) -> DrawnMotions:
        """Return the draws of a posterior at its first sample; `vehicle` is the one that it was made with."""
        draws, mode = group(tree, "posterior"), json.loads(tree.attrs["wheel_mode"])
        bodies = _bodies_of(vehicle, draws)
        count = draws.sizes["chain"] * draws.sizes["draw"]
        state = (draws[name].values.reshape(count, -1) for name in ("omega_B", "sun_B"))
        speeds = draws["wheel_speed_rad_s"].values.reshape(count, len(vehicle.wheels))
        rows = batch.Rows(*state, speeds, bodies=bodies)
        mode = mode if isinstance(mode, str) else tuple(mode)
        return cls(vehicle, rows, float(tree.attrs["t_first_s"]), mode)

    def at(self, times_s: npt.ArrayLike, workers: int | None = None) -> PredictedStates:
        """Return the states at times (n_t) in s from the epoch; times before the start are reached backward in time.

        Wheels run down, stop and stay at rest on the way, and constant torques act all the time. `workers`: threads, by default one
        per core; the result does not depend on it.
        """
        after_s = np.asarray(times_s, dtype=np.float64) - self.start_s
        # the states at the start, which stay for times equal to the start
        names = PredictedStates._fields
        starts = (getattr(self.rows, name) for name in names)
        states = PredictedStates(*(np.repeat(x[:, None], len(after_s), axis=1) for x in starts))
        with_torque = self.rows.bodies_of(self.vehicle).steady_N_m.any()
        acting = Acting((Steady(),)) if with_torque else NOTHING

        def run(ends_s: np.ndarray, index: np.ndarray) -> list[np.ndarray]:
            """Return each quantity of the motions `index` at times from the start, NaN for those that could not be computed."""
            motion = batch.run(
                self.vehicle,
                self.rows.take(index),
                ends_s,
                command=self.wheel_mode,
                error=DIRECTION_ERROR,
                acting=acting,
            )
            computed = (motion.outcome == batch.Outcome.FINE)[:, None, None]
            return [np.where(computed, getattr(motion, name), np.nan) for name in names]

        count, workers = len(self.rows), worker_count(workers)
        size = int(np.clip(-(-count // workers), *RUNS_AT_ONCE))
        pieces = [np.arange(k, min(k + size, count)) for k in range(0, count, size)]
        for side in (after_s < 0, after_s > 0):
            if side.any():
                # each time once, by its distance from the start; `inverse` leads from these back to all times
                distance_s, inverse = np.unique(np.abs(after_s[side]), return_inverse=True)
                ends_s = np.copysign(distance_s, after_s[side][0])
                with ThreadPoolExecutor(workers) as pool:
                    runs = list(pool.map(partial(run, ends_s), pieces))
                for values, parts in zip(states, zip(*runs, strict=True), strict=True):
                    values[:, side] = np.concatenate(parts)[:, inverse]
        return states


def _bodies_of(vehicle: Vehicle, draws: xr.Dataset) -> Bodies:
    """Return inertia, wheels, friction and constant torque of each draw; numbers that were no unknowns are those of the vehicle.

    Raise InputError if the names of wheels, or the centres of the inertia's priors, are not those of the vehicle.
    """
    mean_moment = np.trace(vehicle.require_inertia()) / 3
    bodies = Bodies.of(vehicle, draws.sizes["chain"] * draws.sizes["draw"])
    tensor = np.array(bodies.inertia_kg_m2)
    same_vehicle = [wheel.name for wheel in vehicle.wheels] == draws["wheel"].values.tolist()
    for a, b in combinations_with_replacement(range(3), 2):
        if (name := f"inertia_{'xyz'[a]}{'xyz'[b]}") in draws:
            centre = draws[name].attrs["prior_centre"]
            same_vehicle &= bool(np.isclose(centre, tensor[0, a, b], rtol=1e-9, atol=1e-12))
            tensor[:, a, b] = tensor[:, b, a] = draws[name].values.ravel()
    if not same_vehicle:
        raise InputError(
            "the posterior is not of this vehicle",
            got=vehicle.name,
            do="give the vehicle file that it was made with",
        )
    wheel_numbers = {}
    for kind, field_name in WHEEL_FACTORS.items():
        wheel_numbers[field_name] = np.array(getattr(bodies, field_name))
        for i, wheel in enumerate(vehicle.wheels):
            if (name := wheel_unknown(f"log_{kind}", vehicle, wheel)) in draws:
                wheel_numbers[field_name][:, i] *= np.exp(draws[name].values.ravel())
    # the draws hold torques divided by the mean moment of inertia, rad/s2
    steady = mean_moment * draws["steady_torque"].values.reshape(-1, 2, 3)
    return replace(bodies, inertia_kg_m2=tensor, steady_N_m=steady, **wheel_numbers)


def predict(
    vehicle: Vehicle, tree: xr.DataTree, times_s: npt.ArrayLike, workers: int | None = None
) -> xr.Dataset:
    """Return the motion at other times, before the first sample or after the last, by the draws of a posterior.

    Parameters
    ----------
    vehicle : Vehicle
        The one that the posterior was made with.
    tree : DataTree
        Result of :func:`sunspin.posterior`.
    times_s : (n_t,)
        s from the epoch of the telemetry. From the samples to these times the motion must be free of impacts and thrust; wheels run
        down and stop.
    workers : int, optional
        Threads; default one per core. The result does not depend on it.

    Returns
    -------
    xarray.Dataset
        Over (chain, draw, predicted_s), draw by draw that of the posterior: `omega_B` and its size `rate` (rad/s), `sun_B`,
        `z_to_sun` and `z_to_momentum` (rad), `wheel_speed_rad_s`. NaN if a motion could not be computed.

    Raises
    ------
    InputError
        Times that are no numbers or more than a week away, a posterior of another vehicle, or no posterior.
    """
    if not isinstance(tree, xr.DataTree) or "t_first_s" not in tree.attrs:
        what, do = "predictions need the DataTree that `posterior` returned", "give it whole"
        raise InputError(what, got=type(tree).__name__, do=do)
    times = checked_times(times_s, float(tree.attrs["t_first_s"]))
    motions = DrawnMotions.of(vehicle, tree)
    return predictions(motions, motions.at(times, workers), times).assign_attrs(attributes_of(tree))


def predictions(motions: DrawnMotions, states: PredictedStates, times_s: np.ndarray) -> xr.Dataset:
    """Return the Dataset of :func:`predict` for the `states` of motions at times (n_t) in s from the epoch.

    H in the result is the angular momentum of body and wheels.
    """
    omega, speeds = states.omega_B, states.wheel_speed_rad_s
    bodies = motions.rows.bodies_of(motions.vehicle)
    momentum = np.stack(
        [gyrostat.total_momentum(bodies, omega[:, k], speeds[:, k]) for k in range(omega.shape[1])],
        axis=1,
    )
    cosine_to_H = momentum[..., 2] / np.linalg.norm(momentum, axis=-1)
    rate = np.linalg.norm(omega, axis=-1)

    def variable(values: np.ndarray, units: str, long_name: str, *dims: str) -> Any:
        """Return a variable over the one chain, draws, times and further `dims`."""
        attrs = {"units": units, "long_name": long_name}
        return (*EACH, "predicted_s", *dims), values[None], attrs

    z_to_sun, z_to_momentum = (
        np.arccos(np.clip(cosine, -1.0, 1.0)) for cosine in (states.sun_B[..., 2], cosine_to_H)
    )
    variables = {
        "omega_B": variable(omega, "rad s-1", "body rate", "axis"),
        "rate": variable(rate, "rad s-1", "angular speed"),
        "sun_B": variable(states.sun_B, "1", "direction to the Sun", "axis"),
        "z_to_sun": variable(z_to_sun, "rad", "angle between z and the Sun"),
        "z_to_momentum": variable(z_to_momentum, "rad", "angle between z and H"),
        "wheel_speed_rad_s": variable(speeds, "rad s-1", "speed of each wheel", "wheel"),
    }
    coords = {
        "chain": [0],
        "draw": np.arange(len(omega)),
        "axis": ["x", "y", "z"],
        "wheel": [wheel.name for wheel in motions.vehicle.wheels],
        "predicted_s": (
            "predicted_s",
            np.asarray(times_s),
            {"units": "s", "long_name": "time from the epoch"},
        ),
    }
    return xr.Dataset(variables, coords)


def attributes_of(tree: xr.DataTree) -> dict[str, Any]:
    """Return the attributes of predictions: their provenance, and the vehicle and verdict of the posterior."""
    names = ("vehicle", "changes", "verdict_word")
    of_posterior = {name: tree.attrs[name] for name in names if name in tree.attrs}
    return provenance("predictions", tree, **of_posterior)


def checked_times(times_s: npt.ArrayLike, first_s: float) -> np.ndarray:
    """Return times (n_t), s from the epoch, in increasing order and each once.

    InputError if there are none, if some are not finite, or if some are more than a week from the first sample at `first_s`.
    """
    try:
        times = np.unique(np.asarray(times_s, dtype=np.float64))
    except (TypeError, ValueError):
        what, do = "times to predict must be numbers", "give s from the epoch"
        raise InputError(what, got=str(times_s)[:60], do=do) from None
    if not (times.size and np.isfinite(times).all() and np.abs(times - first_s).max() <= LONGEST_S):
        raise InputError(
            "times to predict must be numbers, at most a week from the first sample",
            got=times.tolist(),
            do=f"give s from the epoch; the first sample is at {first_s:g}",
        )
    return times


def best_motions(vehicle: Vehicle, tree: xr.DataTree) -> list[xr.Dataset]:
    """Return trajectories from the first sample to the last: the likeliest draw of each of the most probable solutions.

    Parameters
    ----------
    vehicle : Vehicle
        The one that the posterior was made with.
    tree : DataTree
        Result of :func:`sunspin.posterior`.

    Returns
    -------
    list of xarray.Dataset
        As of :func:`sunspin.propagate` with the draw's own inertia, friction, wheel speeds and constant torque; `time` in s from
        the epoch, and `panel_signal (time, panel)` for a brightness of one. attrs: `title` and `about` in words, `solution`,
        `probability`.

    Raises
    ------
    InputError
        A posterior of another vehicle.
    """
    motions, draws = DrawnMotions.of(vehicle, tree), group(tree, "posterior")
    probability = group(tree, "solutions")["probability"].values
    solution = draws["solution_id"].values.ravel()
    likelihood = draws["log_likelihood_sum"].values.ravel()
    shared = {name: tree.attrs[name] for name in ("epoch_utc", "synthetic") if name in tree.attrs}
    runs = []
    for number in np.argsort(-probability, kind="stable")[:MOST_MOTIONS]:
        if not (solution == number).any():
            continue
        draw = int(np.argmax(np.where(solution == number, likelihood, -np.inf)))
        run = _trajectory(motions, draw, float(tree.attrs["t_last_s"]))
        signal = panel_power(vehicle, run["sun_B"].values)
        holds = f"holds {probability[number]:.0%} of the probability"
        attrs = {
            "title": f"Solution {number + 1}",
            "about": f"The likeliest draw of solution {number + 1}, which {holds}",
            "solution": int(number) + 1,
            "probability": float(probability[number]),
        }
        run = run.assign(panel_signal=(("time", "panel"), signal, {"units": "1"}))
        runs.append(run.assign_attrs(attrs | shared))
    return runs


def _trajectory(motions: DrawnMotions, draw: int, end_s: float) -> xr.Dataset:
    """Return the motion of one draw from its start to `end_s` (s from the epoch), at instants about `TURN_RAD` apart."""
    rows, duration_s = motions.rows, end_s - motions.start_s
    bodies = rows.bodies_of(motions.vehicle)
    craft, steady = bodies.vehicle(motions.vehicle, draw), bodies.steady_N_m[draw]

    def at_instants(count: int) -> xr.Dataset:
        """Return the motion at `count` evenly spaced instants up to `end_s`."""
        return propagate(
            craft,
            rows.omega_B[draw],
            rows.sun_B[draw],
            rows.wheel_speed_rad_s[draw],
            np.linspace(0.0, duration_s, count),
            motions.wheel_mode,
            rtol=BEST_RTOL,
            torques=[Steady(steady)] if steady.any() else [],
        )

    fastest = np.linalg.norm(at_instants(FEWEST_INSTANTS)["omega_B"].values, axis=1).max()
    run = at_instants(int(np.clip(duration_s * fastest / TURN_RAD, FEWEST_INSTANTS, MOST_INSTANTS)))
    # times from the epoch instead of from the start
    from_epoch = {"time": run["time"] + motions.start_s}
    return run.assign_coords(from_epoch).assign(event_time_s=run["event_time_s"] + motions.start_s)
