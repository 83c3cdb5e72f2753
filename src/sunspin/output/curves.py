"""Motions of `sunspin rates` as they are shown on the page: on the even times between samples that the results hold."""

from __future__ import annotations

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin.environment.frames import J2000
from sunspin.estimate.rates.wheels import HELD, wheel_speeds
from sunspin.estimate.wheel_speeds import untold
from sunspin.vehicle import Vehicle

MOST_PASSES = 12
"""The longest passes are shown."""

CURVE = ("curve_B_from_N", "curve_omega_B", "curve_pass_of")
"""Variables of results that hold the motion between samples."""


def dense(rates: xr.Dataset) -> list[tuple[str, xr.Dataset]]:
    """Each pass as a Dataset like that of `propagate`, without momentum: (title, data); of results without curves, none."""
    if any(name not in rates for name in CURVE):
        return []
    pass_of, time = rates["curve_pass_of"].values, rates["curve_time"].values
    lengths = {int(k): float(np.ptp(time[pass_of == k])) for k in np.unique(pass_of)}
    chosen = sorted(sorted(lengths, key=lambda k: -lengths[k])[:MOST_PASSES])
    return [(f"Pass {int(rates['pass_id'].values[k])}", _dense(rates, k)) for k in chosen]


def with_wheels(
    run: xr.Dataset, vehicle: Vehicle, telemetry: xr.Dataset | None, doing: str
) -> xr.Dataset:
    """The motion `run` of :func:`dense` with the speeds of the wheels as `rates` took them, NaN where nothing says how fast one
    turns; `doing`: the attribute `wheels` of its result. Without telemetry only a speed that is held is known."""
    t = run["time"].values
    read = xr.Dataset(coords={"time": t}) if telemetry is None else telemetry
    known = wheel_speeds(vehicle, read, t) if telemetry is not None or HELD in doing else {}
    names = [name for name in known if doing.startswith(name) or len(known) == 1]
    speed = np.full((len(t), len(vehicle.wheels)), np.nan)
    if names:
        speed = np.array(known[max(names, key=len)])
    silent = untold(vehicle, read)
    speed[:, [wheel.name in silent for wheel in vehicle.wheels]] = np.nan
    return run.assign(wheel_speed_rad_s=(("time", "wheel"), speed))


def _dense(rates: xr.Dataset, k: int) -> xr.Dataset:
    samples, curve = (
        rates.isel({dim: np.flatnonzero(rates[name].values == k)})
        for dim, name in (("time", "pass_of"), ("curve_time", "curve_pass_of"))
    )
    start = Rotation.from_quat(samples["B_from_N"].values[0])
    attitude = Rotation.from_quat(curve["curve_B_from_N"].values)
    about = f"the likeliest motion of {samples.sizes['time']} samples; between samples as the equations of motion carry it"
    if rates.attrs.get("frame_N") != J2000:
        about += ", and the turn about the line to the Sun at its start is arbitrary"
    return xr.Dataset(
        {
            "omega_B": (("time", "axis"), curve["curve_omega_B"].values),
            "B_from_N": (("time", "quaternion"), curve["curve_B_from_N"].values),
            "sun_B": (
                ("time", "axis"),
                attitude.apply(start.inv().apply(samples["sun_B"].values[0])),
            ),
        },
        coords={"time": curve["curve_time"].values},
        attrs={"epoch_utc": str(rates.attrs.get("epoch_utc", "")), "about": about},
    )
