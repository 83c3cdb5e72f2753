"""Motions of `sunspin rates` as the page shows them: at the times between samples that the results hold."""

from __future__ import annotations

import numpy as np
import xarray as xr

from sunspin.environment.frames import J2000
from sunspin.estimate.observe import HELD, wheel_speeds, wheels_of_unknown_speed
from sunspin.solve.rotations import matrix_from_quaternion
from sunspin.vehicle import Vehicle

MOST_PASSES = 12
"""Passes that are shown: those that last longest."""

CURVE = ("curve_B_from_N", "curve_omega_B", "curve_pass_of")
"""Variables of a result of `rates` that hold the motion between samples."""


GAIN = "gain_"
"""Begin of the name of an estimate that is the gain of a panel, as a factor on that of the vehicle file."""


def pass_motions(rates: xr.Dataset) -> list[tuple[str, xr.Dataset]]:
    """Return (title, motion) of each of the longest passes of a result of `rates`, in their order.

    A motion is a Dataset like that of `propagate`, without momentum, on the times of the curves. Without curves the list is empty.
    `gain_factor` (panel) are the gains estimated with the motion over those of the vehicle file, for panels that have one.
    The longest passes are those of the longest time, at most `MOST_PASSES`.
    """
    if any(name not in rates for name in CURVE):
        return []
    pass_of, time = rates["curve_pass_of"].values, rates["curve_time"].values
    duration_s = {int(k): float(np.ptp(time[pass_of == k])) for k in np.unique(pass_of)}
    longest = sorted(duration_s, key=lambda k: -duration_s[k])[:MOST_PASSES]
    pass_id = rates["pass_id"].values
    return [(f"Pass {int(pass_id[k])}", _pass_motion(rates, k)) for k in sorted(longest)]


def with_wheel_speeds(
    motion: xr.Dataset, vehicle: Vehicle, telemetry: xr.Dataset | None, wheel_use: str
) -> xr.Dataset:
    """Return a motion of :func:`pass_motions` with the wheel speeds (rad/s) that `rates` used, NaN for unknown speeds.

    `wheel_use` is the attribute `wheels` of the result: in words, how `rates` treated the wheels. Without telemetry only a speed
    that is held constant is known.
    """
    t = motion["time"].values
    samples = xr.Dataset(coords={"time": t}) if telemetry is None else telemetry
    # source of the speeds in words -> speeds (n, wheel)
    speeds_by_source: dict[str, np.ndarray] = {}
    if telemetry is not None or HELD in wheel_use:
        speeds_by_source = wheel_speeds(vehicle, samples, t)
    # `wheel_use` begins with the words of the source that `rates` used; if one begins like another, the longer one is meant
    sources = [
        source
        for source in speeds_by_source
        if wheel_use.startswith(source) or len(speeds_by_source) == 1
    ]
    speed = np.full((len(t), len(vehicle.wheels)), np.nan)
    if sources:
        speed = np.array(speeds_by_source[max(sources, key=len)])
    # names of wheels whose speed neither file nor telemetry gives
    unknown = wheels_of_unknown_speed(vehicle, samples)
    speed[:, [wheel.name in unknown for wheel in vehicle.wheels]] = np.nan
    return motion.assign(wheel_speed_rad_s=(("time", "wheel"), speed))


def _pass_motion(rates: xr.Dataset, k: int) -> xr.Dataset:
    """Return the motion of pass number `k` on the times of its curve, as in :func:`pass_motions`."""
    samples, curve = (
        rates.isel({dim: np.flatnonzero(rates[name].values == k)})
        for dim, name in (("time", "pass_of"), ("curve_time", "curve_pass_of"))
    )
    first_attitude = matrix_from_quaternion(samples["B_from_N"].values[0])
    attitude = matrix_from_quaternion(curve["curve_B_from_N"].values)
    # the Sun is fixed in N during a pass: its direction at the first sample, rotated with the body
    sun_N = first_attitude.T @ samples["sun_B"].values[0]
    count = samples.sizes["time"]
    about = f"the likeliest motion of {count} samples; between samples it is propagated with the equations of motion"
    if rates.attrs.get("frame_N") != J2000:
        about += ", and the rotation about the Sun direction at its start is arbitrary"
    variables = {
        "omega_B": (("time", "axis"), curve["curve_omega_B"].values),
        "B_from_N": (("time", "quaternion"), curve["curve_B_from_N"].values),
        "sun_B": (("time", "axis"), attitude @ sun_N),
    }
    # panels whose gain was not estimated are not listed
    names = rates["estimate"].values.astype(str) if "estimate" in rates else np.array([], str)
    gains = np.char.startswith(names, GAIN)
    if gains.any():
        variables["gain_factor"] = ("panel", rates["estimate_value"].values[k, gains])
    panels = [name.removeprefix(GAIN) for name in names[gains].tolist()]
    return xr.Dataset(
        variables,
        coords={"time": curve["curve_time"].values, "panel": panels},
        attrs={"epoch_utc": str(rates.attrs.get("epoch_utc", "")), "about": about},
    )
