"""The scan: a grid of initial rates, the distance of each simulated Sun track from what was measured.

Two distances, as in the paper: EMD between the distributions of r_z (eq. 13), accumulated while the kernel runs and never
storing a track; and E, the mean misfit of directions at the times of the samples (eq. 12).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.errors import InputError, sentence
from sunspin.infer.ensemble import run_chunks
from sunspin.infer.mask import reconstructible_mask
from sunspin.infer.metrics import direction_error
from sunspin.motion import kernel as k
from sunspin.motion.codegen import Rows as Layout
from sunspin.motion.compiled import kernel
from sunspin.motion.propagate import SUN_LENGTH_TOLERANCE, wheel_speeds
from sunspin.vehicle import Vehicle

BINS = 256
"""Bins of r_z over [-1, 1]; the CDF is linear inside a bin, the measured one exact. Error below 1e-3, see the tests."""

EMD_DIRECTION_ERROR = 0.03
"""Direction error (rad) at the end of the window that an EMD can bear: a late phase error hardly moves a distribution."""

MAX_TARGET = 4096
"""Target samples beyond this are replaced by as many quantiles: measured tracks have tens, simulated ones 10^5."""

MAX_ROWS = 50_000_000
"""Grids beyond this are refused: at 115 microseconds a row this many run for an hour and a half on one core."""


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
    workers: int | None = None,
    store: str | None = None,
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
    wheel_mode : "coast", "hold", "brake", or one per wheel.
    workers : int, optional
        Threads; default one per core.
    store : path, optional
        Reserved for resumable runs, which this version does not have: anything but None is refused.
    progress : bool
        Show a progress bar on a terminal.

    Returns
    -------
    xarray.DataArray
        `emd` or `E` over (omega_x, omega_y, omega_z), with a coordinate `outcome` (0: computed as asked). A motion whose
        Sun could never have been reconstructed has EMD 1, the largest there is.
    """
    axes = [_axis(values, name) for values, name in ((omega_x, "omega_x"), (omega_y, "omega_y"), (omega_z, "omega_z"))]
    shape = tuple(len(axis) for axis in axes)
    n_rows = int(np.prod([float(size) for size in shape]))
    if n_rows > MAX_ROWS:
        raise InputError(
            sentence(
                f"the grid has {n_rows:.3g} points, more than {MAX_ROWS:.3g}",
                got=" x ".join(map(str, shape)),
                do="use a larger step or a smaller range",
            )
        )
    if store is not None:
        raise InputError(sentence("this version cannot resume a scan from a store", do="leave store out; save the result"))
    make_rows = _row_maker(vehicle, axes, sun_B, wheel_speed_rad_s)
    if isinstance(target_z, xr.Dataset):
        name, function = "E", _track_function(vehicle, target_z, make_rows, wheel_mode)
    else:
        name = "emd"
        function = _emd_function(vehicle, target_z, weights, make_rows, duration_s, mask, wheel_mode)
    out = {name: np.empty(n_rows), "outcome": np.empty(n_rows, dtype=np.int8)}
    run_chunks(function, n_rows, out, workers=workers, progress=progress, label="scan")
    dims = ("omega_x", "omega_y", "omega_z")
    result = xr.DataArray(
        out[name].reshape(shape),
        dims=dims,
        coords={dim: (dim, axis, {"units": "rad/s"}) for dim, axis in zip(dims, axes, strict=True)},
        name=name,
        attrs={"units": "1", "vehicle": vehicle.name, "mask": str(mask), "wheel_mode": str(wheel_mode)},
    )
    result = result.assign_coords(outcome=(dims, out["outcome"].reshape(shape)))
    result["outcome"].attrs = {
        "flag_values": [int(o) for o in k.Outcome],
        "flag_meanings": " ".join(o.name.lower() for o in k.Outcome),
    }
    return result


def _axis(values: npt.ArrayLike, name: str) -> np.ndarray:
    axis = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if axis.ndim != 1 or axis.size == 0 or not np.all(np.isfinite(axis)):
        raise InputError(sentence(f"{name} must be a list of finite rates in rad/s", got=f"shape {axis.shape}"))
    return axis


def _row_maker(vehicle: Vehicle, axes: list[np.ndarray], sun_B: npt.ArrayLike, wheel_speed_rad_s: Any):
    """Function from row numbers (C order of the grid) to initial states, made chunk by chunk so that no grid is stored."""
    sun = np.asarray(sun_B, dtype=np.float64)
    if sun.shape != (3,) or not abs(np.linalg.norm(sun) - 1) <= SUN_LENGTH_TOLERANCE:
        raise InputError(sentence("sun_B must be a unit vector of three components", got=sun_B))
    speeds = wheel_speeds(vehicle, wheel_speed_rad_s)
    shape = tuple(len(axis) for axis in axes)

    def make(index: np.ndarray) -> k.Rows:
        where = np.unravel_index(index, shape)
        omega = np.stack([axis[i] for axis, i in zip(axes, where, strict=True)], axis=-1)
        n = len(index)
        return k.Rows(omega, np.tile(sun, (n, 1)), np.tile(speeds, (n, 1)))

    return make


def target_segments(target_z: npt.ArrayLike, weights: npt.ArrayLike | None = None) -> tuple[np.ndarray, ...]:
    """The target's CDF as constant pieces inside the kernel's bins: (bin, low, high, level); low, high are fractions."""
    z = np.asarray(target_z, dtype=np.float64).ravel()
    w = np.ones_like(z) if weights is None else np.asarray(weights, dtype=np.float64).ravel()
    if z.size == 0 or w.shape != z.shape or not np.all(np.isfinite(z)) or np.abs(z).max() > 1 + 1e-6:
        raise InputError(sentence("target_z must be one or more values in [-1, 1], with as many weights if any"))
    if not (np.all(w >= 0) and w.sum() > 0):
        raise InputError(sentence("weights must not be negative and not all zero"))
    if z.size > MAX_TARGET:
        z, w = _thinned(z, w)
    order = np.argsort(z, kind="stable")
    place = np.clip((z[order] + 1) * BINS / 2, 0, BINS)
    knots = np.concatenate([np.arange(BINS + 1, dtype=float), place])
    knots = np.unique(knots)
    cdf = np.concatenate([[0.0], np.cumsum(w[order])]) / w.sum()
    bin_of = np.minimum(np.floor(knots[:-1]).astype(np.int64), BINS - 1)
    level = cdf[np.searchsorted(place, knots[:-1], side="right")]
    return bin_of, knots[:-1] - bin_of, knots[1:] - bin_of, level


def _thinned(z: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """MAX_TARGET quantiles in the place of a larger sample: the distribution moves by less than 1 / MAX_TARGET."""
    order = np.argsort(z, kind="stable")
    cdf = np.cumsum(w[order]) / w.sum()
    levels = (np.arange(MAX_TARGET) + 0.5) / MAX_TARGET
    return z[order][np.searchsorted(cdf, levels)], np.ones(MAX_TARGET)


def _emd_function(vehicle, target_z, weights, make_rows, duration_s, mask, wheel_mode):
    if duration_s is None or not (np.isfinite(duration_s) and duration_s != 0):
        raise InputError(sentence("duration_s must be the length of the run in s", got=duration_s))
    if mask not in ("reconstructible", None):
        raise InputError(sentence('mask must be "reconstructible" or None', got=mask))
    condition = reconstructible_mask(vehicle) if mask else None
    segments = target_segments(target_z, weights)
    module = kernel(k.structure_of(vehicle, condition, BINS))

    def function(index: np.ndarray) -> dict[str, np.ndarray]:
        result = k.run_rows(
            vehicle,
            make_rows(index),
            float(duration_s),
            wheel_mode=wheel_mode,
            direction_error=EMD_DIRECTION_ERROR,
            mask=condition,
            bins=BINS,
        )
        emd, seen = np.empty(len(index)), np.empty(len(index), dtype=np.int64)
        module.emd_rows(result.hist, *segments, emd, seen)
        return {"emd": np.where(seen == 0, 1.0, emd), "outcome": result.outcome}

    return function


def _track_function(vehicle, track: xr.Dataset, make_rows, wheel_mode):
    measured = np.asarray(track["sun_B"], dtype=np.float64)
    known = np.all(np.isfinite(measured), axis=1)
    if not known.any():
        raise InputError(sentence("the track holds no direction to compare with"))
    measured, times = measured[known], np.asarray(track["time"], dtype=np.float64)[known]
    first = Layout(len(vehicle.wheels)).r

    def function(index: np.ndarray) -> dict[str, np.ndarray]:
        result = k.run_rows(vehicle, make_rows(index), times, wheel_mode=wheel_mode, direction_error=1e-3)
        simulated = result.track[:, :, first : first + 3]
        return {"E": direction_error(simulated, measured), "outcome": result.outcome}

    return function


def near_minimum(emd: xr.DataArray, factor: float = 1.1) -> np.ndarray:
    """Grid points (n, 3) in rad/s with EMD below `factor` times the smallest (paper, eq. 14 with factor 1.1).

    Rows whose `outcome` says that they could not be computed take no part.
    """
    if not factor > 1:
        raise InputError(sentence("the factor of the near-minimum set must exceed 1", got=factor))
    if "outcome" in emd.coords:
        emd = emd.where(emd["outcome"] == k.Outcome.FINE)
    values = emd.transpose("omega_x", "omega_y", "omega_z").values
    if not np.isfinite(values).any():
        raise InputError(sentence("no motion of the grid could be computed", do="see its coordinate `outcome`"))
    i, j, l = np.nonzero(values < factor * np.nanmin(values))
    return np.stack([emd["omega_x"].values[i], emd["omega_y"].values[j], emd["omega_z"].values[l]], axis=-1)
