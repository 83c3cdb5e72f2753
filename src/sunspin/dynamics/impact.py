"""A sticking impact of one point of the vehicle with the ground: a pure map from the state before to the state after.

The blow is short, so only the impulse F at the contact point l counts. A wheel that its bearing lets go keeps its
inertial spin (friction has no time to act), one whose motor holds its speed turns with the body (paper, eqs. 8-11):

    B d_omega = l x F      d_v = F / m      (omega + d_omega) x l + v + d_v = 0      d_W = -u.d_omega

with B the inertia less the axial inertia of the wheels that are not held. Elimination leaves K F = -(v + omega x l)
with the symmetric positive definite K = 1/m - [l] B^-1 [l], [l] the matrix of l x.

Two numbers go beyond the paper. With a restitution e the impulse is 1 + e times this, and the point leaves at -e times the velocity
at which it came (of the blow's energy 1 - e^2 is lost). With a damper d the landing gear yields along the body's z, as Philae's
does: a share d of the impulse is replaced by the one without a component along z that stops the point in x and y alone. Both lose
energy for any e and d from 0 to 1: it is a convex function of F, and is lost at both ends.
"""

from __future__ import annotations

from collections.abc import Sequence

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
    """State after the end of a leg hits the ground and sticks for an instant (paper, eqs. 8-11).

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
        "hold": the motor keeps the wheel's speed through the blow, and may do work. Else the wheel keeps its inertial
        spin.
    restitution : float
        Speed at which the point leaves over that at which it came, 0 (it sticks, as in the paper) to 1.
    damper : float
        Share of the blow that a landing gear yielding along z takes: 0 (rigid legs, as in the paper) to 1.

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
        batch = np.broadcast_shapes(*shapes)
    except ValueError:
        raise InputError(
            "the leading shapes of rate, velocity, leg and wheel speed differ", got=shapes
        ) from None
    inverse = np.linalg.inv(free_inertia(vehicle, [not h for h in held]))
    for name, value in (("restitution", restitution), ("damper", damper)):
        if not 0 <= value <= 1:
            raise InputError(f"{name} must be a share between 0 and 1", got=value)
    impulse = _impulse(inverse, vehicle.require_mass(), omega, velocity, tip, damper)
    impulse = impulse if restitution == 0 else (1 + restitution) * impulse
    kick = np.cross(tip, impulse) @ inverse
    turned = [
        np.zeros(3) if h else -np.asarray(w.axis_B)
        for w, h in zip(vehicle.wheels, held, strict=True)
    ]
    speeds_after = speeds + (kick @ np.stack(turned, axis=-1) if turned else 0.0)
    return _dataset(
        vehicle,
        batch,
        omega + kick,
        velocity + impulse / vehicle.require_mass(),
        impulse,
        speeds_after,
    )


def _impulse(
    inverse: np.ndarray,
    mass: float,
    omega: np.ndarray,
    velocity: np.ndarray,
    tip: np.ndarray,
    damper: float,
) -> np.ndarray:
    """F (..., 3) in N s from K F = -(v + omega x l); with a damper, mixed with that of x and y alone."""
    lever = cross_matrix(tip)
    mobility = np.eye(3) / mass - lever @ inverse @ lever
    contact_velocity = velocity + np.cross(omega, tip)
    rigid = -np.linalg.solve(mobility, contact_velocity[..., None])[..., 0]
    if damper == 0:
        return rigid
    across = -np.linalg.solve(mobility[..., :2, :2], contact_velocity[..., :2, None])[..., 0]
    yielding = np.concatenate([across, np.zeros((*across.shape[:-1], 1))], axis=-1)
    return (1 - damper) * rigid + damper * yielding


def _vectors(value: npt.ArrayLike, name: str) -> np.ndarray:
    vectors = np.asarray(value, dtype=np.float64)
    if vectors.ndim == 0 or vectors.shape[-1] != 3 or not np.all(np.isfinite(vectors)):
        raise InputError(
            f"{name} must be finite with three components last", got=f"shape {vectors.shape}"
        )
    return vectors


def _speeds(vehicle: Vehicle, value: npt.ArrayLike | None) -> np.ndarray:
    """Wheel speeds (..., n_wheel); with one wheel its axis may be left out."""
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
    modes = [wheel_mode] * len(vehicle.wheels) if isinstance(wheel_mode, str) else list(wheel_mode)
    if len(modes) != len(vehicle.wheels) or any(mode not in COMMANDS for mode in modes):
        raise InputError(
            f"wheel_mode must be one of {', '.join(COMMANDS)}, or one per wheel", got=wheel_mode
        )
    return [mode == "hold" for mode in modes]


def _dataset(vehicle, batch, omega, velocity, impulse, speeds) -> xr.Dataset:
    runs = ("run",) if len(batch) == 1 else tuple(f"run_{i}" for i in range(len(batch)))
    n = len(vehicle.wheels)
    return xr.Dataset(
        {
            "omega_B": (
                (*runs, "axis"),
                np.broadcast_to(omega, (*batch, 3)).copy(),
                {"units": "rad s-1"},
            ),
            "wheel_speed_rad_s": (
                (*runs, "wheel"),
                np.broadcast_to(speeds, (*batch, n)).copy(),
                {"units": "rad s-1"},
            ),
            "velocity_B": (
                (*runs, "axis"),
                np.broadcast_to(velocity, (*batch, 3)).copy(),
                {"units": "m s-1"},
            ),
            "impulse_B": (
                (*runs, "axis"),
                np.broadcast_to(impulse, (*batch, 3)).copy(),
                {"units": "N s"},
            ),
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
