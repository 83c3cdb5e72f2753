"""Scan of initial body rates: a grid of motions, and the distance of each simulated track of Sun directions from the measured one.

There are two distances, as in the paper. EMD compares the distributions of r_z, the z component of the Sun direction (eq. 13).
Compiled code accumulates them without storing a track. E is the mean misfit of directions at the times of the samples (eq. 12).

`scan` runs each motion for one target, the measured directions. `make_table` keeps the histogram of r_z of each motion, which does
not depend on the measurement. The EMD to a target then takes a microsecond a motion, a fiftieth of the motion itself. So many
targets (simulated cases, thresholds, resampled telemetry) take little longer than one scan.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
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
from sunspin.estimate.scan.histogram import distances_to_target, target_segments
from sunspin.estimate.scan.rows import ScanRows, Start, track_rows
from sunspin.vehicle import Vehicle

MAX_ROWS = 50_000_000
"""Larger grids are refused."""

SECONDS_PER_ROW, BYTES_PER_ROW = 1e-4, 30
"""Rough time (s) and memory of a motion: 45 min of Philae take 42 to 189 microseconds of a core; two results with their copies."""

RATES = ("omega_x", "omega_y", "omega_z")
"""Dimensions of a volume."""


@dataclass(frozen=True)
class Propagation:
    """Options of the propagation of a scan's motions.

    Attributes
    ----------
    wheel_mode : "coast", "hold", "brake", or one per wheel
    direction_error : rad, allowed error of the simulated Sun direction at the end, in place of `emd_error`; for a track 1e-3
    environment, torques, B_from_N : as in :func:`sunspin.propagate`
    start_s : s, start of the motions on the environment's clock
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
    """Return the distance between simulation and measurement over a grid of initial body rates.

    Parameters
    ----------
    vehicle : Vehicle
    target_z : (n,) or Dataset
        For the EMD, the measured z components of the Sun direction. For E, a track: a Dataset with `sun_B (time, axis)` and `time`
        (s after the start of the run). Samples with NaN directions are left out.
    sun_B : (3,)
        Direction to the Sun at the start, body axes.
    omega_x, omega_y, omega_z : 1-D, rad/s
        Grid of body rates at the start.
    wheel_speed_rad_s : number, (n_wheel,) or None
    duration_s : s
        Length of the run for the EMD. For E it is the time of the last sample.
    weights : (n,), optional
        Weights of `target_z`.
    mask : "reconstructible" or None
        Count only directions that the panels allow to reconstruct, or all. Only for the EMD.
    emd_error : float, optional
        Allowed error of the EMD; default 1e-3. If a wheel's axis is no principal axis, at most one motion in 100 errs by more than
        2e-3, up to 7e-3; with 5e-4 none of 768 did. A value below 1e-3 makes the scan much slower.
    propagation : Propagation
        Wheel modes, torques, and the allowed error of directions.
    workers : int, optional
        Threads, or worker processes of the executor "local"; default one per core.
    store : path, optional
        Folder in which rows are kept as they are computed. After an interruption the same call resumes from it.
    executor : concurrent.futures.Executor, dask.distributed.Client, address or "local", optional
        Compute the rows there, as the `scheduler` of :func:`sunspin.compute.rows.ensemble`.
    progress : bool
        Show a progress bar on a terminal.

    Returns
    -------
    xarray.DataArray
        `emd` or `E` over (omega_x, omega_y, omega_z), with a coordinate `outcome` (0: computed with the allowed error). A motion
        whose Sun could never have been reconstructed has the largest EMD, 1.
    """
    axes = [
        _axis(values, name) for values, name in zip((omega_x, omega_y, omega_z), RATES, strict=True)
    ]
    check_size(*(len(axis) for axis in axes))
    # Parts on which neither motion nor light depend are left out, so that a stored scan stays valid if only they change.
    landing = {"mass_kg": None, "legs": (), "hull": (), "antenna": None}
    body = replace(vehicle, **landing, facts={}, changes=())
    torques = acting(propagation.torques, propagation.environment, propagation.start_s)
    start = Start.on_grid(body, axes, sun_B, wheel_speed_rad_s, torques, propagation.B_from_N)
    mode = propagation.wheel_mode
    options: dict[str, Any] = {
        "wheel_mode": mode if isinstance(mode, str) else tuple(mode),
        "direction_error": propagation.direction_error,
    }
    if isinstance(target_z, xr.Dataset):
        if emd_error is not None:
            what, got = "a track is compared by E, not by EMD", f"emd_error {emd_error}"
            raise InputError(what, got=got, do="give Propagation(direction_error=...)")
        rows, count = track_rows(body, start, target_z, **options), target_z.sizes["time"]
    else:
        if duration_s is None or not (np.isfinite(duration_s) and duration_s != 0):
            raise InputError("duration_s must be the length of the run in s", got=duration_s)
        target, count = target_segments(target_z, weights), np.size(target_z)
        rows = ScanRows(
            vehicle=body,
            start=start,
            t_s=float(duration_s),
            measure="emd",
            target=target,
            mask=mask,
            emd_error=emd_error,
            **options,
        )
    results = ensemble(
        rows, workers=workers, store=store, scheduler=executor, progress=progress, label="scan"
    )
    return as_volume(vehicle, rows, rows.measure, results, count)


def as_volume(
    vehicle: Vehicle, rows: ScanRows, name: str, values: dict[str, np.ndarray], directions: int
) -> xr.DataArray:
    """Return the measure `name` of all rows over the grid of rates with their outcomes, as `scan` returns it.

    `vehicle`: that of the caller, with its changes, which `rows.vehicle` may lack. `name` is `rows.measure`, or "emd" if rows keep
    histograms. `values`: arrays (n_row) by name, among them `name` and "outcome"; `directions`: number of measured directions.
    """
    start = rows.start
    axes = {rate: (rate, getattr(start, rate), {"units": "rad s-1"}) for rate in RATES}
    flags = {
        "flag_values": [int(o) for o in Outcome],
        "flag_meanings": " ".join(o.name.lower() for o in Outcome),
    }
    return xr.DataArray(
        values[name].reshape(start.shape),
        dims=RATES,
        coords={**axes, "outcome": (RATES, values["outcome"].reshape(start.shape), flags)},
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
    """Raise `InputError`, with the cost, for a grid of more than `MAX_ROWS` points. `points`: number of points along each axis."""
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
    """Return the rates of one axis of the grid as an array; raise `InputError` if they are no list of different finite rates."""
    axis = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if axis.ndim != 1 or axis.size == 0 or not np.all(np.isfinite(axis)):
        raise InputError(
            f"{name} must be a list of finite rates in rad/s, not deg/s", got=f"shape {axis.shape}"
        )
    if len(np.unique(axis)) < len(axis):
        raise InputError(f"{name} has a rate twice", got=axis[:10].tolist(), do="give each once")
    return axis


@dataclass(frozen=True)
class Histograms:
    """Histograms of r_z, `hist` (n, BINS) in s, and `outcome` (n) of the n motions `rows` of a grid; 1 kB for each motion."""

    rows: ScanRows
    hist: np.ndarray
    outcome: np.ndarray

    def distances(
        self, target_z: npt.ArrayLike, weights: npt.ArrayLike | None = None, workers: int = 1
    ) -> np.ndarray:
        """Return the EMD (n) of each motion to measured z components (m), by the same arithmetic as `scan`."""
        return distances_to_target(self.hist, target_segments(target_z, weights), workers)

    def volume(
        self, target_z: npt.ArrayLike, weights: npt.ArrayLike | None = None, workers: int = 1
    ) -> xr.DataArray:
        """Return the EMD to measured z components (m) over (omega_x, omega_y, omega_z), as `scan` returns it."""
        values = {"emd": self.distances(target_z, weights, workers), "outcome": self.outcome}
        return as_volume(self.rows.vehicle, self.rows, "emd", values, np.size(target_z))


def make_table(
    vehicle: Vehicle,
    sun_B: npt.ArrayLike,
    axes: Mapping[str, np.ndarray],
    wheel_speed_rad_s: Any,
    duration_s: float,
    *,
    mask: str | None = "reconstructible",
    workers: int | None = None,
    progress: bool = False,
) -> Histograms:
    """Run each motion of a grid once and return the histograms of r_z.

    `axes`: the grid, 1-D rates (rad/s) by the names omega_x, omega_y, omega_z. `duration_s`: length of the runs, s. The other
    parameters are those of `scan`.
    """
    grid = [np.asarray(axes[rate], dtype=np.float64) for rate in RATES]
    start = Start.on_grid(vehicle, grid, sun_B, wheel_speed_rad_s)
    rows = ScanRows(vehicle, start, float(duration_s), "hist", mask=mask)
    results = ensemble(rows, workers=workers, progress=progress, label="scan")
    return Histograms(rows, results["hist"], results["outcome"])
