"""The scan: a grid of initial rates, the distance of each simulated Sun track from what was measured.

Two distances, as in the paper: EMD between the distributions of r_z (eq. 13), accumulated while the kernel runs and never
storing a track; and E, the mean misfit of directions at the times of the samples (eq. 12).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.base.provenance import provenance
from sunspin.compute.rows import ensemble
from sunspin.dynamics.batch import Outcome
from sunspin.dynamics.torques import Steady, acting
from sunspin.environment import Environment
from sunspin.estimate.scan.rows import (
    ScanRows,
    Start,
    target_segments,
    track_rows,
)
from sunspin.vehicle import Vehicle

MAX_ROWS = 50_000_000
"""Grids beyond this are refused."""

SECONDS_PER_ROW, BYTES_PER_ROW = 1e-4, 30
"""For estimates: 42 to 189 microseconds of a core for 45 min of Philae, and two results with their copies."""


@dataclass(frozen=True)
class Propagation:
    """How the motions of a scan are propagated.

    Attributes
    ----------
    wheel_mode : "coast", "hold", "brake", or one per wheel.
    direction_error : rad
        Error wanted of the simulated Sun's direction at the end, in the place of `emd_error`; for a track 1e-3 unless given.
    environment, torques, B_from_N
        As in :func:`sunspin.propagate`; such a scan runs by series.
    start_s : s
        When the motions begin, on the environment's clock.
    """

    wheel_mode: str | Sequence[str] = "coast"
    direction_error: float | None = None
    environment: Environment | None = None
    torques: Sequence[str | Steady] = ()
    B_from_N: npt.ArrayLike | None = None
    start_s: float = 0.0


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
    emd_error: float | None = None,
    propagation: Propagation = Propagation(),
    workers: int | None = None,
    store: str | Path | None = None,
    executor: Any = None,
    progress: bool = False,
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
    emd_error : float, optional
        Error wanted of the EMD; 1e-3 unless given. Of bodies with wheels across their principal axes at most one motion in 100
        errs by more than 2e-3, up to 7e-3; with 5e-4 none of 768 did. Anything tighter than 1e-3 is much slower.
    propagation : Propagation
        Wheel modes, torques, and the error wanted of directions.
    workers : int, optional
        Threads, or worker processes of the executor "local"; default one per core.
    store : path, optional
        Folder in which rows are kept as they are computed; the same call resumes there after any interruption.
    executor : concurrent.futures.Executor, dask.distributed.Client, address or "local", optional
        Compute the rows there, as the `scheduler` of :func:`sunspin.compute.rows.ensemble`.
    progress : bool
        Show a progress bar on a terminal.

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
    check_size(*(len(axis) for axis in axes))
    # what free motion and light do not depend on: a store stays good if it changes
    landing = {"mass_kg": None, "legs": (), "hull": (), "antenna": None}
    body = replace(vehicle, **landing, facts={}, changes=())
    forces = acting(propagation.torques, propagation.environment, propagation.start_s)
    start = Start.on_grid(body, axes, sun_B, wheel_speed_rad_s, forces, propagation.B_from_N)
    mode = propagation.wheel_mode
    how: dict[str, Any] = {
        "wheel_mode": mode if isinstance(mode, str) else tuple(mode),
        "direction_error": propagation.direction_error,
    }
    if isinstance(target_z, xr.Dataset):
        if emd_error is not None:
            what, got = "a track is compared by E, not by EMD", f"emd_error {emd_error}"
            raise InputError(what, got=got, do="give Propagation(direction_error=...)")
        rows, count = track_rows(body, start, target_z, **how), target_z.sizes["time"]
    else:
        if duration_s is None or not (np.isfinite(duration_s) and duration_s != 0):
            raise InputError("duration_s must be the length of the run in s", got=duration_s)
        target, count = target_segments(target_z, weights), np.size(target_z)
        rows = ScanRows(
            body, start, float(duration_s), "emd", target, mask, emd_error=emd_error, **how
        )
    out = ensemble(
        rows, workers=workers, store=store, scheduler=executor, progress=progress, label="scan"
    )
    return volume(vehicle, rows, rows.measure, out, count)


def volume(
    vehicle: Vehicle, rows: ScanRows, name: str, values: dict[str, np.ndarray], directions: int
) -> xr.DataArray:
    """The variable `name` of all rows of a grid, with their outcomes, as `scan` returns them."""
    start, dims = rows.start, ("omega_x", "omega_y", "omega_z")
    axes = {dim: (dim, getattr(start, dim), {"units": "rad s-1"}) for dim in dims}
    flags = {
        "flag_values": [int(o) for o in Outcome],
        "flag_meanings": " ".join(o.name.lower() for o in Outcome),
    }
    return xr.DataArray(
        values[name].reshape(start.shape),
        dims=dims,
        coords={**axes, "outcome": (dims, values["outcome"].reshape(start.shape), flags)},
        name=name,
        attrs=provenance("scan", **vehicle.result_attributes)
        | {
            "units": "1",
            "mask": str(rows.mask),
            "wheel_mode": str(rows.wheel_mode),
            "directions": directions,
        },
    )


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
        A factor that is not above 1; nothing could be computed.
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
    """Return the grid points (n, 3) in rad/s with EMD below a threshold; rows that could not be computed take no part."""
    chosen = np.nonzero(_computed(emd) < threshold)
    axes = emd["omega_x"], emd["omega_y"], emd["omega_z"]
    return np.stack([axis.values[i] for axis, i in zip(axes, chosen, strict=True)], axis=-1)


def _computed(emd: xr.DataArray) -> np.ndarray:
    if "outcome" in emd.coords:
        emd = emd.where(emd["outcome"] == Outcome.FINE)
    return emd.transpose("omega_x", "omega_y", "omega_z").values
