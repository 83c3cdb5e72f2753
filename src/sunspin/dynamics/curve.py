"""A simulated motion at instants between its output times, so close that interpolation does not miss a part of a rotation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr

from sunspin.solve.rotations import matrix_from_quaternion

CURVE_RAD = 0.45
"""Largest rotation of the body, and of its rate by nutation, between instants of a curve, rad: below 30 degrees. Cubics through
attitudes and rates are then off by at most 0.002 degrees (ten tumbling bodies), a line between two rates by 2.5 % of the part that
nutates."""

UNSEEN_RAD = 1e-3
"""Nutation is not followed if the body rotates by less than this, rad, in every interval."""

MOST_INSTANTS = 500_000
"""Instants of a curve: 150 MB while they are computed and 32 MB in the file, 59 hours at 60 deg/s."""

ROUNDS = 8
"""Most times that a curve is refined. A tumbling body needs two to four: its rate is known only where it was computed."""


def rotations(t_s: np.ndarray, omega_B: np.ndarray, attitude: np.ndarray) -> np.ndarray:
    """Return by how much the body rotates (n - 1), rad, between times `t_s` (n) with rates (n, 3) and quaternions (n, 4).

    It is the larger one of the angle between the attitudes, which leaves out whole revolutions, and of rate times interval.
    """
    speed = np.linalg.norm(omega_B, axis=1)
    cosine = np.abs(np.einsum("ni,ni->n", attitude[1:], attitude[:-1]))
    between_attitudes = 2 * np.arccos(np.minimum(cosine, 1.0))
    return np.maximum(between_attitudes, np.maximum(speed[1:], speed[:-1]) * np.abs(np.diff(t_s)))


def with_curve(
    run: xr.Dataset, inertia: np.ndarray, motion: Callable[[np.ndarray], xr.Dataset]
) -> xr.Dataset:
    """Return a trajectory with its motion between the output times, in variables `curve_...` as in results of `rates`.

    Parameters
    ----------
    run : xarray.Dataset
        Result of :func:`sunspin.propagate`.
    inertia : (3, 3) kg m2
    motion : callable
        Function of times (n), in the order of `run`, that returns the same motion at these times.

    Returns
    -------
    xarray.Dataset
        With `curve_time`, `curve_omega_B` and `curve_B_from_N`: the output times, the events of the wheels, and instants between
        them at most `CURVE_RAD` apart. `run` itself if its output times are as close, or if `MOST_INSTANTS` are not enough.
    """
    t = run["time"].values
    # the rate has a kink where a wheel stops or breaks away: no cubic may run across it
    events = run["event_time_s"].values
    events = events[(events > t.min()) & (events < t.max())]
    instants = np.union1d(t, events)
    if t[-1] < t[0]:
        instants = instants[::-1]
    curve = run if instants.size == t.size else motion(instants)
    for _ in range(ROUNDS):
        at, speed = curve["time"].values, _fastest_rotation(curve, inertia)
        # number of parts into which each interval has to be cut
        parts = np.ceil(np.maximum(speed[1:], speed[:-1]) * np.abs(np.diff(at)) / CURVE_RAD)
        if not np.any(parts > 1):
            break
        if not parts.sum() < MOST_INSTANTS:
            return run
        parts = np.maximum(parts, 1).astype(int)
        share = np.concatenate([np.arange(n) / n for n in parts])
        begins = np.repeat(at[:-1], parts) + share * np.repeat(np.diff(at), parts)
        curve = motion(np.append(begins, at[-1]))
    if curve is run:
        return run
    return run.assign(
        curve_omega_B=(("curve_time", "axis"), curve["omega_B"].values),
        curve_B_from_N=(("curve_time", "quaternion"), curve["B_from_N"].values),
    ).assign_coords(curve_time=curve["time"].values)


def along_curve(run: xr.Dataset) -> xr.Dataset:
    """Return a motion of `propagate` on the times of its curve instead of its output times; `run` itself if it has no curve.

    Figures need it: lines between output times would be wrong if the body rotates far in a step. The Sun is fixed in N. The angular
    momentum in N is taken from the output time before. Wheel speeds are interpolated between output times.
    """
    if "curve_omega_B" not in run:
        return run
    # -1: a motion backward in time
    order = 1 if run["time"].values[-1] >= run["time"].values[0] else -1
    t, curve_t = order * run["time"].values, order * run["curve_time"].values
    to_N = matrix_from_quaternion(run["B_from_N"].values).swapaxes(1, 2)  # (n, 3, 3)
    attitude = matrix_from_quaternion(run["curve_B_from_N"].values)
    variables = {
        "omega_B": (("time", "axis"), run["curve_omega_B"].values),
        "B_from_N": (("time", "quaternion"), run["curve_B_from_N"].values),
        "sun_B": (("time", "axis"), attitude @ to_N[0] @ run["sun_B"].values[0]),
    }
    if "momentum_B" in run:
        last_output = np.searchsorted(t, curve_t, side="right") - 1
        momentum_N = np.einsum("nij,nj->ni", to_N, run["momentum_B"].values)[last_output]
        momentum_B = np.einsum("nij,nj->ni", attitude, momentum_N)
        variables["momentum_B"] = (("time", "axis"), momentum_B)
    if run.sizes.get("wheel", 0):
        speeds = run["wheel_speed_rad_s"].values.T
        speeds = np.stack([np.interp(curve_t, t, speed) for speed in speeds], axis=1)
        variables["wheel_speed_rad_s"] = (("time", "wheel"), speeds)
    coords = {"time": run["curve_time"].values, "axis": run["axis"].values}
    if "wheel" in run.coords:
        coords["wheel"] = run["wheel"].values
    return xr.Dataset(variables, coords=coords, attrs=run.attrs)


def _fastest_rotation(run: xr.Dataset, inertia: np.ndarray) -> np.ndarray:
    """Return the rate (n), rad/s, of the body's rotation plus that of the nutation by its wheels, at the times of a trajectory."""
    omega = run["omega_B"].values
    longest_s = np.abs(np.diff(run["time"].values)).max(initial=0.0)
    wheels = run["momentum_B"].values - omega @ inertia
    # with the momentum h of wheels, dw/dt = I^-1 (w x h): its frequency is sqrt(h.I h / det I)
    nutation = np.sqrt(np.einsum("ni,ij,nj->n", wheels, inertia, wheels) / np.linalg.det(inertia))
    speed = np.linalg.norm(omega, axis=1)
    # a cubic takes the rates at both ends for its slopes: it errs by a part of the rotation in the interval, however small the
    # nutation's own amplitude is
    is_visible = speed.max(initial=0.0) * longest_s > UNSEEN_RAD
    return speed + np.where(is_visible, nutation, 0.0)
