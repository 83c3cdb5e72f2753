"""Synthetic telemetry of any vehicle that moves as a known truth says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.dynamics.propagate import propagate
from sunspin.dynamics.torques import Steady
from sunspin.telemetry.sun import per_panel
from sunspin.telemetry.synthetic import (
    draw_tilts,
    generator,
    noisy_power,
    on_time_grid,
    telemetry_dataset,
)
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import panel_power

EPOCH_UTC = "2000-01-01T12:00:00Z"
"""Epoch of a twin whose vehicle names none: a twin need not happen on any day."""

NOISE_OF_LARGEST = 0.02
"""Where gains are relative, the scale makes the vehicle's noise this part of the largest panel's full signal."""


@dataclass(frozen=True)
class Truth:
    """The motion behind a twin: the state at ``t_s[0]``, the sample times, and how the panels see it.

    `omega_B` (3) rad/s and `sun_B` (3) in body axes; `t_s` (n) s from the epoch; `wheel_speed_rad_s` as in `propagate`
    (default: the vehicle's nominal speeds); `scale` the signal of a panel of gain one at normal incidence (default: 1,
    or with relative gains what makes the vehicle's noise `NOISE_OF_LARGEST`); `noise` one sigma, or that of each input, in the
    unit of the signal (default: the vehicle's, zero where it states none); `tilt_B_rad` (n_panel, 3) turns of the panels' normals,
    or one number, the sigma of their angles to each side, by which they are then drawn from the seed; `torques` as in
    `propagate`.
    """

    omega_B: npt.ArrayLike
    sun_B: npt.ArrayLike
    t_s: npt.ArrayLike
    wheel_speed_rad_s: npt.ArrayLike | None = None
    wheel_mode: Any = "coast"
    scale: float | None = None
    noise: npt.ArrayLike | None = None
    tilt_B_rad: npt.ArrayLike = 0.0
    torques: Sequence[str | Steady] = ()


def synthetic_telemetry(
    vehicle: Vehicle, truth: Truth | Mapping[str, Any], seed: int = 0
) -> xr.Dataset:
    """Telemetry of a vehicle that moves as `truth` says; see :func:`sunspin.twin`, which passes a vehicle on to here."""
    vehicle.require_panels()
    known = _truth(truth)
    noise = vehicle.input_noise if known.noise is None else known.noise
    be = "the noise of a twin must be zero or positive"
    noise = per_panel(vehicle, 0.0 if noise is None else noise, np.greater_equal, be)
    scale = _scale(known, vehicle)
    speeds = known.wheel_speed_rad_s
    if speeds is None:
        speeds = [wheel.speed_rad_s for wheel in vehicle.wheels]
    t = on_time_grid(np.atleast_1d(known.t_s))
    track = propagate(
        vehicle,
        known.omega_B,
        known.sun_B,
        speeds,
        t,
        wheel_mode=known.wheel_mode,
        torques=known.torques,
    )
    sun = track["sun_B"].values
    tilt = _tilt(known, vehicle, generator(seed, 1))
    exact = (
        panel_power(vehicle, sun) if tilt is None else vehicle.response_in().power(sun, tilt=tilt)
    )
    power = noisy_power(vehicle, scale * exact, noise, generator(seed, 0))
    told = {
        "omega_B": np.array(known.omega_B, dtype=np.float64),
        "sun_B": np.array(known.sun_B, dtype=np.float64),
        "wheel_speed_rad_s": np.atleast_1d(np.array(speeds, dtype=np.float64)),
        "wheel_mode": str(known.wheel_mode),
        "scale": scale,
        "noise": float(noise[0]) if (noise == noise[0]).all() else noise,
        "seed": seed,
    } | ({} if tilt is None else {"tilt_B_rad": tilt.ravel()})  # NetCDF's attributes are lists
    return telemetry_dataset(vehicle, t, power, sun, vehicle.telemetry.epoch_utc or EPOCH_UTC, told)


def _truth(truth: Truth | Mapping[str, Any]) -> Truth:
    if isinstance(truth, Truth):
        return truth
    names = [field.name for field in fields(Truth)]
    unknown = sorted(set(truth) - set(names))
    missing = [name for name in ("omega_B", "sun_B", "t_s") if name not in truth]
    if unknown or missing:
        raise InputError(
            f"a truth has the fields {', '.join(names)}",
            got=", ".join(
                [f"unknown {name}" for name in unknown] + [f"no {name}" for name in missing]
            ),
        )
    return Truth(**truth)


def _scale(truth: Truth, vehicle: Vehicle) -> float:
    if truth.scale is None:
        noise, gains = vehicle.input_noise, vehicle.input_gains
        if vehicle.gain_unit is not None or noise is None:
            return 1.0
        return float(noise[np.argmax(gains)] / (NOISE_OF_LARGEST * gains.max()))
    if not (np.isfinite(truth.scale) and truth.scale > 0):
        raise InputError("the scale of a twin must be positive", got=truth.scale)
    return float(truth.scale)


def _tilt(truth: Truth, vehicle: Vehicle, rng: np.random.Generator) -> np.ndarray | None:
    """Turns (n_panel, 3) of the panels; None where they stand as drawn."""
    given = np.asarray(truth.tilt_B_rad, dtype=np.float64)
    if not np.any(given):
        return None
    many = (len(vehicle.panels), 3)
    if (
        given.shape not in ((), many)
        or not np.all(np.isfinite(given))
        or (given.ndim == 0 and given < 0)
    ):
        what = f"tilt_B_rad of a twin is one sigma, or turns of shape {many}, in rad"
        raise InputError(what, got=given.shape or float(given))
    return given if given.ndim else draw_tilts(vehicle, float(given), rng)
