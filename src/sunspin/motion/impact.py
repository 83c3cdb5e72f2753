"""A sticking, inelastic impact at one point of the body: a pure map of the state (paper, eqs. 8-11)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.errors import InputError, sentence
from sunspin.motion.gyrostat import free_inertia
from sunspin.motion.modes import schedules
from sunspin.vehicle import Vehicle


def impact(
    vehicle: Vehicle,
    omega_B: npt.ArrayLike,
    wheel_speed_rad_s: npt.ArrayLike | None,
    velocity_B: npt.ArrayLike,
    leg: str | int | npt.ArrayLike,
    wheel_mode: str | Sequence[str] = "coast",
) -> xr.Dataset:
    """The state after the end of a leg has hit the ground and stuck to it for an instant.

    The impulse F at the contact point l satisfies d_omega = A^-1 (l x F), d_v = F / m and (omega + d_omega) x l + v + d_v = 0.
    A wheel keeps its inertial spin through the blow (d_W = -u.d_omega, also when it was stuck), unless a motor holds its
    speed rigidly (``wheel_mode="hold"``), in which case the motor may do work.

    Parameters
    ----------
    omega_B : (..., 3) rad/s
    wheel_speed_rad_s : (..., n_wheel) rad/s, or None without wheels
    velocity_B : (..., 3) m/s
        Of the centre of mass relative to the ground, body axes.
    leg : name or index of a leg, or the contact point (..., 3) in m from the centre of mass

    Returns
    -------
    xarray.Dataset
        `omega_B`, `wheel_speed_rad_s`, `velocity_B` after the impact and `impulse_B` (N s), leading axes as given.
    """
    n_wheel = len(vehicle.wheels)
    omega, velocity = np.asarray(omega_B, dtype=np.float64), np.asarray(velocity_B, dtype=np.float64)
    point = _contact(vehicle, leg)
    speeds = np.zeros((*omega.shape[:-1], 0)) if wheel_speed_rad_s is None else np.asarray(wheel_speed_rad_s, np.float64)
    if n_wheel == 1 and (speeds.ndim == 0 or speeds.shape[-1:] != (1,)):
        speeds = speeds[..., None]
    if omega.shape[-1:] != (3,) or velocity.shape[-1:] != (3,) or speeds.shape[-1:] != (n_wheel,):
        raise InputError(
            sentence(
                f"omega_B and velocity_B must end in 3 components and wheel_speed_rad_s in {n_wheel}",
                got=f"{omega.shape}, {velocity.shape}, {speeds.shape}",
            )
        )
    if not all(np.all(np.isfinite(array)) for array in (omega, velocity, speeds, point)):
        raise InputError(sentence("an impact needs finite rates, speeds, velocity and contact point"))
    held = [schedule[0][1] == "hold" for schedule in schedules(vehicle, wheel_mode)]
    inverse = np.linalg.inv(free_inertia(vehicle, [not is_held for is_held in held]))
    lever = _skew(point)
    # contact velocity after: v + omega x l + (1/m - [l]x A^-1 [l]x) F = 0
    mobility = np.eye(3) / vehicle.require_mass() - lever @ inverse @ lever
    impulse = -np.linalg.solve(mobility, (velocity + np.cross(omega, point))[..., None])[..., 0]
    jump = np.cross(point, impulse) @ inverse
    axes = np.array([wheel.axis_B for wheel in vehicle.wheels]).reshape(n_wheel, 3)
    speed_jump = np.where(held, 0.0, -(jump @ axes.T))
    return _dataset(omega + jump, speeds + speed_jump, velocity + impulse / vehicle.require_mass(), impulse)


def _contact(vehicle: Vehicle, leg: Any) -> np.ndarray:
    names = [item.name for item in vehicle.legs]
    if isinstance(leg, str) and leg in names:
        return vehicle.legs[names.index(leg)].tip_B_m
    if isinstance(leg, int | np.integer) and not isinstance(leg, bool) and 0 <= leg < len(names):
        return vehicle.legs[int(leg)].tip_B_m
    if not isinstance(leg, str | int | np.integer):
        point = np.asarray(leg, dtype=np.float64)
        if point.shape[-1:] == (3,):
            return point
    raise InputError(
        sentence("leg must be the name or index of a leg, or a contact point in m", got=leg, do=f"legs: {', '.join(names)}")
    )


def _skew(v: np.ndarray) -> np.ndarray:
    """Matrix [v]x with [v]x a = v x a, (..., 3, 3)."""
    matrix = np.zeros((*v.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return matrix - np.swapaxes(matrix, -1, -2)


def _dataset(omega: np.ndarray, speeds: np.ndarray, velocity: np.ndarray, impulse: np.ndarray) -> xr.Dataset:
    shape = np.broadcast_shapes(omega.shape[:-1], velocity.shape[:-1])
    lead = tuple(f"row{k}" if len(shape) > 1 else "row" for k in range(len(shape)))

    def variable(values: np.ndarray, last: str, units: str):
        return ((*lead, last), np.broadcast_to(values, (*shape, values.shape[-1])), {"units": units})

    return xr.Dataset(
        {
            "omega_B": variable(omega, "axis", "rad/s"),
            "wheel_speed_rad_s": variable(speeds, "wheel", "rad/s"),
            "velocity_B": variable(velocity, "axis", "m/s"),
            "impulse_B": variable(impulse, "axis", "N s"),
        },
        coords={"axis": ["x", "y", "z"]},
        attrs={"source": "paper, eqs. 8-11"},
    )
