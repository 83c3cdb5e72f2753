"""What telemetry says of the speeds of wheels, for `rates` and `posterior`, and which wheels nothing tells of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr

from sunspin.vehicle import Vehicle


def untold(vehicle: Vehicle, telemetry: xr.Dataset) -> list[str]:
    """Names of wheels of whose speed neither the vehicle file nor the telemetry says anything: taken for standing."""
    if vehicle.inertia_kg_m2 is None:
        return []
    read = (
        telemetry["wheel_speed_rad_s"].values
        if "wheel_speed_rad_s" in telemetry
        else np.full((1, len(vehicle.wheels)), np.nan)
    )
    return [
        wheel.name
        for k, wheel in enumerate(vehicle.wheels)
        if wheel.speed_rad_s == 0 and not np.isfinite(read[:, k]).any()
    ]


def filled(t: np.ndarray, telemetry: xr.Dataset, vehicle: Vehicle) -> np.ndarray:
    """Measured speeds (n, n_wheel) at times t (n, s) with gaps bridged linearly; a wheel never read keeps its nominal speed."""
    at, speed = (
        np.asarray(telemetry["time"], dtype=np.float64),
        telemetry["wheel_speed_rad_s"].values,
    )
    full = np.empty((len(t), len(vehicle.wheels)))
    for k, wheel in enumerate(vehicle.wheels):
        known = np.flatnonzero(np.isfinite(speed[:, k]))
        known = known[np.argsort(at[known], kind="stable")]
        full[:, k] = np.interp(t, at[known], speed[known, k]) if len(known) else wheel.speed_rad_s
    return full


def as_measured(vehicle: Vehicle, telemetry: xr.Dataset, at_s: float) -> Vehicle:
    """The vehicle whose wheels turn as the telemetry says at `at_s` (s from the epoch), where it has their speeds."""
    if "wheel_speed_rad_s" not in telemetry or not vehicle.wheels:
        return vehicle
    (speeds,) = filled(np.array([at_s]), telemetry, vehicle)
    return replace(
        vehicle,
        wheels=tuple(
            replace(w, speed_rad_s=float(v)) for w, v in zip(vehicle.wheels, speeds, strict=True)
        ),
    )
