"""What the body did at other times: the draws of a posterior run there, each with its own inertia, friction and wheel speed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.base.provenance import provenance
from sunspin.compute.rows import ensemble
from sunspin.dynamics import batch
from sunspin.dynamics import gyrostat as g
from sunspin.dynamics.torques import NOTHING, Acting, Steady
from sunspin.estimate.posterior.data import group
from sunspin.estimate.posterior.model import Model, model
from sunspin.vehicle import Vehicle

DIRECTION_ERROR = 1e-4
"""Error of directions (rad): far below what any posterior leaves open."""

LONGEST_S = 7 * 86400.0
"""Times further than this from the first sample are refused: phases are lost long before."""

LEVELS = (0.5, 0.9)
"""Intervals told, as shares of the draws, both tails alike."""


def drawn_rows(vehicle: Vehicle, tree: xr.DataTree) -> tuple[Model, batch.Rows]:
    """The model behind a posterior and its draws (n) at the first sample as rows for the kernel."""
    if json.loads(tree.attrs.get("torques", "[]")):
        raise InputError(
            "draws of a posterior under torques cannot be carried on yet", got=tree.attrs["torques"]
        )
    posterior, mode = group(tree, "posterior"), json.loads(tree.attrs.get("wheel_mode", '"coast"'))
    unknown, _ = model(vehicle, json.loads(tree.attrs["priors_given"]), 1.0, mode)
    omega, sun, speeds = (
        np.asarray(posterior[name].values).reshape(
            posterior.sizes["chain"] * posterior.sizes["draw"], size
        )
        for name, size in (("omega_B", 3), ("sun_B", 3), ("wheel_speed_rad_s", len(vehicle.wheels)))
    )
    u = np.zeros((len(omega), len(unknown.unknowns)))
    for i, x in enumerate(unknown.unknowns):
        if x.kind in (
            "wheel_speed",
            "scale",
        ):  # told by the wheels' speeds, or of no effect on the motion
            continue
        if x.name not in posterior or not np.isclose(
            posterior[x.name].attrs["prior_centre"], x.centre, rtol=1e-9, atol=1e-12
        ):
            raise InputError(
                "the posterior is not of this vehicle",
                got=vehicle.name,
                do="give the file it came from",
            )
        u[:, i] = (posterior[x.name].values.ravel() - x.centre) / x.sigma
    bodies = unknown.bodies(u)
    if "steady_torque" in posterior:
        mean = np.trace(vehicle.require_inertia()) / 3
        bodies = replace(
            bodies, steady_N_m=mean * posterior["steady_torque"].values.reshape(-1, 2, 3)
        )
    return unknown, batch.Rows(omega, sun, speeds, bodies=bodies)


@dataclass(frozen=True)
class AtTimes:
    """Row -> a motion, with its own body, at times all later or all earlier (s from the row's)."""

    vehicle: Vehicle
    rows: batch.Rows = field(repr=False)
    ends_s: np.ndarray
    wheel_mode: Any
    acting: Acting

    @property
    def outputs(self) -> Mapping[str, Any]:
        count, wheels = len(self.ends_s), len(self.vehicle.wheels)
        return {
            "omega_B": ("float64", (count, 3)),
            "sun_B": ("float64", (count, 3)),
            "wheel_speed_rad_s": ("float64", (count, wheels)),
        }

    @property
    def n_rows(self) -> int:
        return len(self.rows)

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        run = batch.run(
            self.vehicle,
            self.rows.take(index),
            self.ends_s,
            command=self.wheel_mode,
            error=DIRECTION_ERROR,
            acting=self.acting,
        )
        fine = (run.outcome == batch.Outcome.FINE)[:, None, None]
        return {name: np.where(fine, getattr(run, name), np.nan) for name in self.outputs}


def run_to(
    vehicle: Vehicle,
    rows: batch.Rows,
    after_s: npt.ArrayLike,
    wheel_mode: Any = "coast",
    workers: int | None = None,
) -> dict[str, np.ndarray]:
    """Rows run to times (n_t), s after theirs, earlier ones backward: `omega_B`, `sun_B` (n, n_t, 3), `wheel_speed_rad_s`.

    Wheels run down, stop and stay through all of it, and steady torques go on. NaN where a run could not be computed. `workers` as
    in :func:`sunspin.compute.rows.ensemble`.
    """
    times = np.asarray(after_s, dtype=np.float64)
    n, wheels = len(rows), len(vehicle.wheels)
    pushed = rows.bodies is not None and rows.bodies.steady_N_m.any()
    acting = Acting((Steady(),)) if pushed else NOTHING
    out = {
        "omega_B": np.empty((n, times.size, 3)),
        "sun_B": np.empty((n, times.size, 3)),
        "wheel_speed_rad_s": np.empty((n, times.size, wheels)),
    }
    for name, values in out.items():
        values[:, times == 0] = getattr(rows, name)[:, None]
    for side in (times < 0, times > 0):
        if not side.any():
            continue
        ends, place = np.unique(times[side], return_inverse=True)
        ends = ends[::-1] if ends[0] < 0 else ends
        place = len(ends) - 1 - place if ends[0] < 0 else place
        run = ensemble(AtTimes(vehicle, rows, ends, wheel_mode, acting), workers=workers)
        for name, values in out.items():
            values[:, side] = run[name][:, place]
    return out


def predictions(
    unknown: Model, rows: batch.Rows, run: dict[str, np.ndarray], times_s: np.ndarray
) -> xr.Dataset:
    """What runs (n, n_t, ...) say, over (chain, draw, predicted_s); the times are s from the epoch."""
    speed = np.linalg.norm(run["omega_B"], axis=-1)
    bodies = rows.bodies_of(unknown.vehicle)
    at = zip(
        np.moveaxis(run["omega_B"], 1, 0), np.moveaxis(run["wheel_speed_rad_s"], 1, 0), strict=True
    )
    momentum = np.stack([g.total_momentum(bodies, omega, speeds) for omega, speeds in at], axis=1)
    cosine = momentum[..., 2] / np.linalg.norm(momentum, axis=-1)
    each = ("chain", "draw", "predicted_s")
    return xr.Dataset(
        {
            "omega_B": (
                (*each, "axis"),
                run["omega_B"][None],
                {"units": "rad s-1", "long_name": "body rate"},
            ),
            "rate": (each, speed[None], {"units": "rad s-1", "long_name": "angular speed"}),
            "sun_B": (
                (*each, "axis"),
                run["sun_B"][None],
                {"units": "1", "long_name": "direction to the Sun"},
            ),
            "z_to_sun": (
                each,
                _angle(run["sun_B"][..., 2])[None],
                {"units": "rad", "long_name": "angle between z and the Sun"},
            ),
            "z_to_momentum": (
                each,
                _angle(cosine)[None],
                {"units": "rad", "long_name": "angle between z and H"},
            ),
            "wheel_speed_rad_s": (
                (*each, "wheel"),
                run["wheel_speed_rad_s"][None],
                {"units": "rad s-1"},
            ),
        },
        coords={
            "chain": [0],
            "draw": np.arange(len(rows)),
            "axis": ["x", "y", "z"],
            "wheel": [wheel.name for wheel in unknown.vehicle.wheels],
            "predicted_s": (
                "predicted_s",
                np.asarray(times_s),
                {"units": "s", "long_name": "time from the epoch"},
            ),
        },
    )


def _angle(cosine: np.ndarray) -> np.ndarray:
    return np.arccos(np.clip(cosine, -1.0, 1.0))


def predict(
    vehicle: Vehicle, tree: xr.DataTree, times_s: npt.ArrayLike, workers: int | None = None
) -> xr.Dataset:
    """The posterior predictive of the motion at other times, before the first sample or after the last.

    Parameters
    ----------
    vehicle : Vehicle
        The one the posterior was made with.
    tree : DataTree
        Of :func:`sunspin.estimate.posterior.posterior`.
    times_s : (n_t,)
        s from the epoch of the telemetry. Nothing but free motion may lie between them and the samples; the wheels do what they
        did there, run down and stop.
    workers : int, optional
        Threads; default one per core. The result does not depend on it.

    Returns
    -------
    xarray.Dataset
        Over (chain, draw, predicted_s), draw by draw that of the posterior: `omega_B` and its size `rate` (rad/s), `sun_B`,
        `z_to_sun` and `z_to_momentum` (rad), `wheel_speed_rad_s`. NaN where a run could not be computed.

    Raises
    ------
    InputError
        Times that are no numbers or more than a week away, a posterior of another vehicle.
    """
    first = float(tree.attrs["t_first_s"])
    times = checked_times(times_s, first)
    unknown, rows = drawn_rows(vehicle, tree)
    run = run_to(vehicle, rows, times - first, unknown.wheel_mode, workers)
    return predictions(unknown, rows, run, times).assign_attrs(carried(tree))


def carried(tree: xr.DataTree) -> dict[str, Any]:
    """What predictions take over from the posterior's attributes."""
    told = {
        key: tree.attrs[key] for key in ("vehicle", "changes", "verdict_word") if key in tree.attrs
    }
    return provenance("predictions", tree, **told)


def checked_times(times_s: npt.ArrayLike, first_s: float) -> np.ndarray:
    """Times (n_t) that can be predicted, in order and each once."""
    times = np.unique(np.asarray(times_s, dtype=np.float64))
    if (
        not times.size
        or not np.all(np.isfinite(times))
        or np.abs(times - first_s).max() > LONGEST_S
    ):
        raise InputError(
            "times to predict must be numbers, at most a week from the first sample",
            got=times.tolist(),
            do=f"give s from the epoch; the first sample is at {first_s:g}",
        )
    return times


def intervals(found: xr.Dataset) -> list[dict[str, Any]]:
    """Median, 50 and 90 % intervals of what is predicted, a row for each time and quantity; rates in rad/s, angles in rad.

    `sun_off`: the angle from the mean direction of the Sun, whose upper ends are the radii of the circles that hold 50 and 90 %.
    """
    table = []
    for i, t in enumerate(found["predicted_s"].values):
        at = found.isel(predicted_s=i, chain=0)
        omega, sun = at["omega_B"].values, at["sun_B"].values
        mean = np.nanmean(sun, axis=0)
        mean = mean / max(float(np.linalg.norm(mean)), 1e-12)
        quantities = {
            "omega_x": (omega[:, 0], "rad/s"),
            "omega_y": (omega[:, 1], "rad/s"),
            "omega_z": (omega[:, 2], "rad/s"),
            "rate": (at["rate"].values, "rad/s"),
            "sun_x": (sun[:, 0], "1"),
            "sun_y": (sun[:, 1], "1"),
            "sun_z": (sun[:, 2], "1"),
            "z_to_sun": (at["z_to_sun"].values, "rad"),
            "z_to_momentum": (at["z_to_momentum"].values, "rad"),
        }
        for name, (values, unit) in quantities.items():
            row = {
                "t_s": float(t),
                "quantity": name,
                "unit": unit,
                "median": float(np.nanmedian(values)),
            }
            for level in LEVELS:
                low, high = np.nanquantile(values, [0.5 - level / 2, 0.5 + level / 2])
                row |= {
                    f"low_{100 * level:.0f}": float(low),
                    f"high_{100 * level:.0f}": float(high),
                }
            table.append(row)
        off = _angle(sun @ mean)
        row = {
            "t_s": float(t),
            "quantity": "sun_off",
            "unit": "rad",
            "median": float(np.nanmedian(off)),
        }
        for level in LEVELS:
            row |= {
                f"low_{100 * level:.0f}": 0.0,
                f"high_{100 * level:.0f}": float(np.nanquantile(off, level)),
            }
        table.append(row)
    return table
