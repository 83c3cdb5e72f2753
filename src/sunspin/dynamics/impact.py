"""An inelastic impact of one point of the vehicle with the ground: the state after it, from the state before.

The impact is short, so only the impulse F at the contact point l counts. A wheel that turns freely or with a brake keeps its
inertial spin (friction has no time to act); one whose motor holds its speed rotates with the body (paper, eqs. 8-11):

    B d_omega = l x F      d_v = F / m      (omega + d_omega) x l + v + d_v = 0      d_W = -u.d_omega

with B the inertia less the axial inertia of the wheels that are not held. Elimination leaves K F = -(v + omega x l)
with the symmetric positive definite K = 1/m - [l] B^-1 [l], [l] the matrix of l x.

Two numbers go beyond the paper. With a restitution e the impulse is 1 + e times this, and the point leaves at -e times the velocity
at which it came. With a damper d the landing gear yields along the body's z, as Philae's does: the part d of it is replaced by
the impulse without a z component that stops the point in x and y alone. No e and d from 0 to 1 increase the energy after the
impact: it is a convex function of F, and is not larger than before at either end.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.base.provenance import provenance
from sunspin.dynamics.gyrostat import free_inertia
from sunspin.dynamics.wheel_modes import COMMANDS
from sunspin.solve.rotations import cross_matrix
from sunspin.vehicle import Vehicle


def impact(
    vehicle: Vehicle,
    omega_B: npt.ArrayLike,
    wheel_speed_rad_s: npt.ArrayLike | None,
    velocity_B: npt.ArrayLike,
    leg: str | int | npt.ArrayLike,
    wheel_mode: str | Sequence[str] = "coast",
    *,
    restitution: float = 0.0,
    damper: float = 0.0,
) -> xr.Dataset:
    """Return the state after the end of a leg hits the ground and sticks for an instant (paper, eqs. 8-11).

    Parameters
    ----------
    vehicle : Vehicle
        With mass and inertia.
    omega_B : (..., 3) rad/s
        Body rate before, body axes.
    wheel_speed_rad_s : number, (n_wheel,), (..., n_wheel) or None
        Wheel speeds relative to the body before.
    velocity_B : (..., 3) m/s
        Velocity of the centre of mass relative to the ground before, body axes.
    leg : str, int, integer array (...), or (..., 3) m
        Name of a leg, its position among `vehicle.legs` (one, or a NumPy array of integers for one per run), or any
        contact point of the vehicle, from the centre of mass in body axes.
    wheel_mode : "coast", "brake" or "hold", or one per wheel
        "hold": the motor keeps the wheel's speed during the impact, and may do work. Otherwise the wheel keeps its inertial
        spin.
    restitution : float
        Speed of the point after the impact over that before, 0 (it sticks, as in the paper) to 1.
    damper : float
        How far the landing gear yields along z: 0 (rigid legs, as in the paper) to 1.

    Returns
    -------
    xarray.Dataset
        After the impact: `omega_B` (rad/s), `wheel_speed_rad_s`, `velocity_B` (m/s), and `impulse_B` (N s) on the
        vehicle; the leading dimensions are called ``run`` (or ``run_0``, ``run_1`` ... where there are several).

    Raises
    ------
    InputError, VehicleError
        Shapes that do not fit, an unknown leg or mode, a vehicle without mass or inertia.
    """
    tip = _tips(vehicle, leg)
    omega, velocity = _vectors(omega_B, "omega_B"), _vectors(velocity_B, "velocity_B")
    speeds = _speeds(vehicle, wheel_speed_rad_s)
    held = _held(vehicle, wheel_mode)
    shapes = (omega.shape[:-1], velocity.shape[:-1], tip.shape[:-1], speeds.shape[:-1])
    try:
        batch_shape = np.broadcast_shapes(*shapes)
    except ValueError:
        raise InputError(
            "the leading shapes of rate, velocity, leg and wheel speed differ", got=shapes
        ) from None
    inverse = np.linalg.inv(free_inertia(vehicle, [not h for h in held]))
    for name, value in (("restitution", restitution), ("damper", damper)):
        if not 0 <= value <= 1:
            raise InputError(f"{name} must be a share between 0 and 1", got=value)
    mass = vehicle.require_mass()
    # K F = -(v + omega x l)
    lever = cross_matrix(tip)
    mobility = np.eye(3) / mass - lever @ inverse @ lever
    contact_velocity = velocity + np.cross(omega, tip)
    impulse = -np.linalg.solve(mobility, contact_velocity[..., None])[..., 0]
    if damper:
        across = -np.linalg.solve(mobility[..., :2, :2], contact_velocity[..., :2, None])[..., 0]
        yielding = np.concatenate([across, np.zeros((*across.shape[:-1], 1))], axis=-1)
        impulse = (1 - damper) * impulse + damper * yielding
    impulse = impulse if restitution == 0 else (1 + restitution) * impulse
    omega_change = np.cross(tip, impulse) @ inverse
    if vehicle.wheels:
        # d_W = -u.d_omega, zero for a held wheel
        axes = [
            np.zeros(3) if is_held else -np.asarray(wheel.axis_B)
            for wheel, is_held in zip(vehicle.wheels, held, strict=True)
        ]
        speeds = speeds + omega_change @ np.stack(axes, axis=-1)
    runs = tuple(f"run_{i}" for i in range(len(batch_shape)))
    if len(runs) == 1:
        runs = ("run",)

    def variable(values: np.ndarray, last: str, units: str) -> Any:
        """Return a variable over the runs, and over "axis" or "wheel"."""
        values = np.broadcast_to(values, (*batch_shape, values.shape[-1])).copy()
        return (*runs, last), values, {"units": units}

    return xr.Dataset(
        {
            "omega_B": variable(omega + omega_change, "axis", "rad s-1"),
            "wheel_speed_rad_s": variable(speeds, "wheel", "rad s-1"),
            "velocity_B": variable(velocity + impulse / mass, "axis", "m s-1"),
            "impulse_B": variable(impulse, "axis", "N s"),
        },
        coords={
            "axis": ["x", "y", "z"],
            "wheel": np.array([wheel.name for wheel in vehicle.wheels], dtype=np.str_),
        },
        attrs=provenance(
            "impact",
            **vehicle.result_attributes,
            source="paper, eqs. 8-11: inelastic sticking impact at one point",
        ),
    )


def _vectors(value: npt.ArrayLike, name: str) -> np.ndarray:
    """Return an argument as vectors (..., 3); raise InputError, with its name, if it is something else."""
    vectors = np.asarray(value, dtype=np.float64)
    if vectors.ndim == 0 or vectors.shape[-1] != 3 or not np.all(np.isfinite(vectors)):
        raise InputError(
            f"{name} must be finite with three components last", got=f"shape {vectors.shape}"
        )
    return vectors


def _speeds(vehicle: Vehicle, value: npt.ArrayLike | None) -> np.ndarray:
    """Return the wheel speeds (..., n_wheel), rad/s; with one wheel the last axis may be left out."""
    n = len(vehicle.wheels)
    speeds = np.zeros(0) if value is None else np.asarray(value, dtype=np.float64)
    if n == 1 and value is not None and (speeds.ndim == 0 or speeds.shape[-1] != 1):
        speeds = speeds[..., None]
    if speeds.ndim == 0 or speeds.shape[-1] != n or not np.all(np.isfinite(speeds)):
        raise InputError(
            f"wheel_speed_rad_s must give one finite number for each of the {n} wheel(s) of {vehicle.name!r}",
            got="none" if value is None else f"shape {np.shape(value)}",
        )
    return speeds


def _tips(vehicle: Vehicle, leg: str | int | npt.ArrayLike) -> np.ndarray:
    """Return the contact points (..., 3), m, body axes from the centre of mass; `leg` as in :func:`impact`."""
    names = [item.name for item in vehicle.legs]
    if isinstance(leg, str):
        if leg not in names:
            raise InputError(
                f"vehicle {vehicle.name!r} has no leg of this name",
                got=leg,
                do=f"known: {names or 'none'}",
            )
        return vehicle.legs[names.index(leg)].tip_B_m
    index = np.asarray(leg)
    # a list of three whole numbers is a point; only an array of integers can mean positions in the list of legs
    is_index = np.issubdtype(index.dtype, np.integer) and (
        index.ndim == 0 or isinstance(leg, np.ndarray)
    )
    if not is_index:
        return _vectors(leg, "leg")
    if index.size and not (0 <= index.min() and index.max() < len(names)):
        raise InputError(
            f"vehicle {vehicle.name!r} has {len(names)} leg(s)",
            got=leg,
            do="count them from 0, or give a point",
        )
    return np.array([item.tip_B_m for item in vehicle.legs])[index]


def _held(vehicle: Vehicle, wheel_mode: str | Sequence[str]) -> list[bool]:
    """Return whether a motor holds the speed of each wheel (n_wheel)."""
    modes = [wheel_mode] * len(vehicle.wheels) if isinstance(wheel_mode, str) else list(wheel_mode)
    if len(modes) != len(vehicle.wheels) or any(mode not in COMMANDS for mode in modes):
        raise InputError(
            f"wheel_mode must be one of {', '.join(COMMANDS)}, or one per wheel", got=wheel_mode
        )
    return [mode == "hold" for mode in modes]
