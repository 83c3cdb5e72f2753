"""The scan: a grid of initial rates, the distance of each simulated Sun track from what was measured.

Two distances, as in the paper: EMD between the distributions of r_z (eq. 13), accumulated while the kernel runs and never
storing a track; and E, the mean misfit of directions at the times of the samples (eq. 12).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.base.provenance import provenance
from sunspin.compute.rows import CHUNK, ensemble
from sunspin.dynamics import ensemble as k
from sunspin.dynamics.torques import acting
from sunspin.environment import Environment
from sunspin.estimate.scan.mask import reconstructible_mask
from sunspin.estimate.scan.rows import (
    BINS,
    TRACK_DIRECTION_ERROR,
    EmdRows,
    Start,
    TrackRows,
    distances_to,
    target_segments,
)
from sunspin.vehicle import Vehicle

MAX_ROWS = 50_000_000
"""Grids beyond this are refused."""

SECONDS_PER_ROW, BYTES_PER_ROW = 1e-4, 30
"""For estimates: 42 to 189 microseconds of a core for 45 min of Philae, and two results with their copies."""

MANY_ROWS = 5_000
"""Grids from here on nearly always hold motions near an unstable spin, which are run again by the other method: its kernel is
compiled beside the first."""


def scan(
    vehicle: Vehicle,
    target_z: Any,
    sun_B: npt.ArrayLike,
    omega_x: npt.ArrayLike,
    omega_y: npt.ArrayLike,
    omega_z: npt.ArrayLike,
    wheel_speed_rad_s: npt.ArrayLike | None,
    duration_s: float | None = None,
    *,
    weights: npt.ArrayLike | None = None,
    mask: str | None = "reconstructible",
    wheel_mode: str | Sequence[str] = "coast",
    emd_error: float | None = None,
    direction_error: float | None = None,
    workers: int | None = None,
    store: str | Path | None = None,
    scheduler: Any = None,
    progress: bool = False,
    environment: Environment | None = None,
    torques: Sequence[str] = (),
    B_from_N: npt.ArrayLike | None = None,
    start_s: float = 0.0,
) -> xr.DataArray:
    """Distance between simulation and measurement over a grid of initial body rates.

    Parameters
    ----------
    vehicle : Vehicle
    target_z : (n,) or Dataset
        Measured z components of the Sun's direction: the distance is EMD. Or a track, a Dataset with `sun_B (time, axis)`
        and `time` (s after the start of the run): the distance is E. Samples with NaN directions are left out.
    sun_B : (3,)
        Direction to the Sun at the start, body axes.
    omega_x, omega_y, omega_z : 1-D, rad/s
        Grid of body rates at the start.
    wheel_speed_rad_s : number, (n_wheel,) or None
    duration_s : s
        Length of the run (EMD); for E it is the time of the last sample.
    weights : (n,), optional
        Weights of `target_z`.
    mask : "reconstructible" or None
        Count only directions that the panels allow to reconstruct, or all. Only for EMD.
    wheel_mode : "coast", "hold", "brake", or one per wheel.
    emd_error : float, optional
        Error wanted of the EMD; 1e-3 unless given. Anything tighter is much slower.
    direction_error : float, optional
        Instead, error wanted (rad) of the simulated Sun's direction at the end; for a track 1e-3 unless given.
    workers : int, optional
        Threads, or worker processes of the scheduler "local"; default one per core.
    store : path, optional
        Folder in which rows are kept as they are computed; the same call resumes there after any interruption.
    scheduler : "local", address, dask.distributed.Client or concurrent.futures.Executor, optional
        Compute the rows on a Dask cluster or an executor. Both as in :func:`sunspin.compute.rows.ensemble`.
    progress : bool
        Show a progress bar on a terminal.
    environment, torques, B_from_N
        As in :func:`sunspin.propagate`; such a scan runs by series.
    start_s : float
        When the motions begin, on the environment's clock.

    Returns
    -------
    xarray.DataArray
        `emd` or `E` over (omega_x, omega_y, omega_z), with a coordinate `outcome` (0: computed as asked). A motion whose
        Sun could never have been reconstructed has EMD 1, the largest there is.
    """
    axes = [
        _axis(values, name)
        for values, name in ((omega_x, "omega_x"), (omega_y, "omega_y"), (omega_z, "omega_z"))
    ]
    n_rows = math.prod(len(axis) for axis in axes)
    check_size(*(len(axis) for axis in axes))
    forces = acting(torques, environment, start_s)
    # what free motion and light do not depend on: a store stays good if it changes
    landing = {"mass_kg": None, "legs": (), "hull": (), "antenna": None}
    body = replace(vehicle, **landing, facts={}, changes=())
    start = Start.on_grid(vehicle, axes, sun_B, wheel_speed_rad_s, forces, B_from_N)
    mode = wheel_mode if isinstance(wheel_mode, str) else tuple(wheel_mode)
    rows: EmdRows | TrackRows
    if isinstance(target_z, xr.Dataset):
        name, rows = (
            "E",
            _track_rows(body, start, target_z, mode, emd_error, direction_error),
        )
    else:
        length = np.nan if duration_s is None else duration_s  # refused there
        name, rows = (
            "emd",
            EmdRows(
                body,
                start,
                target_z,
                weights,
                length,
                mask,
                mode,
                emd_error,
                direction_error,
            ),
        )
    if scheduler is None and isinstance(rows, EmdRows) and n_rows >= MANY_ROWS:
        k.prepare(vehicle, [(rows.condition, BINS)], forces.torques)
    settings: dict[str, Any] = {
        "workers": workers,
        "chunk": CHUNK,
        "store": store,
        "scheduler": scheduler,
        "progress": progress,
    }
    count = target_z.sizes["time"] if isinstance(target_z, xr.Dataset) else np.size(target_z)
    out = ensemble(rows, label="scan", **settings)
    return volume(
        vehicle, start, name, out[name], out["outcome"], mask, wheel_mode, directions=count
    )


def compile_kernels(vehicles: Iterable[Vehicle]) -> Path:
    """Compile what scans of these vehicles run and is not kept yet, and return the folder that keeps it."""
    runs = [(vehicle, [(reconstructible_mask(vehicle), BINS), (None, 0)]) for vehicle in vehicles]
    folder = k.compile_all(
        structure for vehicle, some in runs for structure in k.structures(vehicle, some)
    )
    distances_to(np.zeros((1, BINS), np.float32), target_segments([0.0]))
    return folder


def volume(
    vehicle: Vehicle,
    start: Start,
    name: str,
    values: np.ndarray,
    outcome: np.ndarray,
    mask: Any,
    wheel_mode: Any,
    *,
    directions: int,
) -> xr.DataArray:
    """Values of all rows of a grid, and their outcomes, as `scan` returns them."""
    dims = ("omega_x", "omega_y", "omega_z")
    axes = (start.omega_x, start.omega_y, start.omega_z)
    result = xr.DataArray(
        values.reshape(start.shape),
        dims=dims,
        coords={
            dim: (dim, axis, {"units": "rad s-1"}) for dim, axis in zip(dims, axes, strict=True)
        },
        name=name,
        attrs=provenance("scan", **vehicle.said)
        | {
            "units": "1",
            "mask": str(mask),
            "wheel_mode": str(wheel_mode),
            "directions": directions,
        },
    )
    result = result.assign_coords(outcome=(dims, outcome.reshape(start.shape)))
    result["outcome"].attrs = {
        "flag_values": [int(o) for o in k.Outcome],
        "flag_meanings": " ".join(o.name.lower() for o in k.Outcome),
    }
    return result


def check_size(*points: float) -> None:
    """Refuse a grid of so many points along each axis that it would take unreasonably long, with an estimate."""
    n_rows = math.prod(float(n) for n in points)
    if n_rows > MAX_ROWS:
        hours, memory = n_rows * SECONDS_PER_ROW / 3600, n_rows * BYTES_PER_ROW / 1e9
        raise InputError(
            f"the grid has {n_rows:.3g} points, more than {MAX_ROWS:.3g}: it would take some {hours:.2g} h of one core and "
            f"{memory:.2g} GB of memory",
            got=" x ".join(f"{n:.0f}" for n in points),
            do="use a larger step or a smaller range",
        )


def _axis(values: npt.ArrayLike, name: str) -> np.ndarray:
    axis = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if axis.ndim != 1 or axis.size == 0 or not np.all(np.isfinite(axis)):
        raise InputError(
            f"{name} must be a list of finite rates in rad/s, not deg/s", got=f"shape {axis.shape}"
        )
    if len(np.unique(axis)) < len(axis):
        raise InputError(f"{name} has a rate twice", got=axis[:10].tolist(), do="give each once")
    return axis


def _track_rows(
    vehicle: Vehicle,
    start: Start,
    track: xr.Dataset,
    wheel_mode: str | tuple[str, ...],
    emd_error: float | None,
    direction_error: float | None,
) -> TrackRows:
    if emd_error is not None:
        raise InputError(
            "a track is compared by E, not by EMD",
            got=f"emd_error {emd_error}",
            do="give direction_error",
        )
    measured = np.asarray(track["sun_B"], dtype=np.float64)
    known = np.all(np.isfinite(measured), axis=1)
    if not known.any():
        raise InputError("the track holds no direction to compare with")
    times = np.asarray(track["time"], dtype=np.float64)[known]
    error = TRACK_DIRECTION_ERROR if direction_error is None else direction_error
    return TrackRows(vehicle, start, measured[known], times, wheel_mode, error)


def near_minimum(emd: xr.DataArray, factor: float = 1.1) -> np.ndarray:
    """Grid points (n, 3) in rad/s with `emd` below `factor` times the smallest (paper, eq. 14 with factor 1.1).

    Parameters
    ----------
    emd : DataArray over omega_x, omega_y, omega_z
        Of `scan`; its coordinates are rates in body axes.

    Rows whose `outcome` says that they could not be computed take no part.

    Raises
    ------
    InputError
        A factor that is not above 1; nothing could be computed; a scan of an earlier version that interpolated motions.
    """
    if not factor > 1:
        raise InputError("the factor of the near-minimum set must exceed 1", got=factor)
    values = _computed(emd)
    if not np.isfinite(values).any():
        raise InputError(
            "no motion of the grid could be computed", do="see its coordinate `outcome`"
        )
    return below(emd, factor * np.nanmin(values))


def below(emd: xr.DataArray, threshold: float) -> np.ndarray:
    """Grid points (n, 3) in rad/s with EMD below a threshold; rows that could not be computed take no part.

    Raises
    ------
    InputError
        A scan of an earlier version that interpolated motions.
    """
    if "emd_bound" in emd.coords and (emd["emd_bound"] > 0).any():
        raise InputError(
            "motions of this scan are interpolated, as earlier versions could", do="scan again"
        )
    return _points(emd, _computed(emd) < threshold)


def _computed(emd: xr.DataArray) -> np.ndarray:
    if "outcome" in emd.coords:
        emd = emd.where(emd["outcome"] == k.Outcome.FINE)
    return emd.transpose("omega_x", "omega_y", "omega_z").values


def _points(emd: xr.DataArray, chosen: np.ndarray) -> np.ndarray:
    i, j, l = np.nonzero(chosen)
    return np.stack(
        [emd["omega_x"].values[i], emd["omega_y"].values[j], emd["omega_z"].values[l]], axis=-1
    )
