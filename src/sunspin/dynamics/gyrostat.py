"""The equations of motion of a rigid body with wheels, as plain functions of numbers.

State, in body axes B: total angular momentum H (3, N m s), the axial momentum h of each wheel (N m s) and the direction to the Sun
r (unit, 3). A wheel has the axis u, the axial inertia J and the speed W relative to the body. With A the inertia without the axial
inertia of the wheels that turn freely,

    omega = A^-1 (H - sum_free h u - K)      K = sum_held J W u
    dH/dt = H x omega + torque    dh/dt = M(W)    dr/dt = r x omega    W = h / J - u.omega

which is the paper's eqs. (3), (4) and (7) without a matrix to solve per step; |H|, |r| and H.r are invariants (docs/model.md).
Derivatives are those of components in rotating axes. M is the torque on the wheel along its axis (eq. 5): Coulomb and viscous
friction oppose its speed W.

What depends on a wheel's mode (free or held, sign of its speed) enters through :class:`Parameters`, never through a branch, so
every mode is a smooth system and mode changes are events.

The kernels use the same equations in other form (:mod:`sunspin.dynamics.kernels.flow`, :mod:`sunspin.dynamics.step`). The tests
compare them with these functions, and build other integrators (heyoka) from them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from sunspin.dynamics.bodies import Bodies
from sunspin.vehicle import Vehicle

# a number, an array, or an expression of another integrator
Scalar = Any
# three scalars, or an array whose first axis are the components
Vector: TypeAlias = Sequence[Any] | np.ndarray

NO_TORQUE = (0.0, 0.0, 0.0)


class WheelParameters(NamedTuple):
    """One wheel in one mode. `free` is 1 if it turns freely (its torque is friction) and 0 if friction or a motor holds it."""

    axis: tuple[Scalar, ...]  # three
    inverse_inertia: Scalar  # 1 / J
    free: Scalar  # 1 or 0
    coulomb: Scalar  # sign(W) * (mu0 + brake): signed Coulomb torque, N m
    viscous: Scalar  # mu1, N m s


class Parameters(NamedTuple):
    """What the equations need besides the state: A^-1 as (xx, xy, xz, yy, yz, zz), K (N m s), and the wheels."""

    inverse: tuple[Scalar, ...]  # six
    held_momentum: tuple[Scalar, ...]  # three
    wheels: tuple[WheelParameters, ...]


def cross(a: Vector, b: Vector) -> tuple[Scalar, Scalar, Scalar]:
    """Return a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def dot(a: Vector, b: Vector) -> Scalar:
    """Return a . b for three components."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def symmetric_times(m: Vector, b: Vector) -> tuple[Scalar, Scalar, Scalar]:
    """Return M b for a symmetric M given as (xx, xy, xz, yy, yz, zz)."""
    return (
        m[0] * b[0] + m[1] * b[1] + m[2] * b[2],
        m[1] * b[0] + m[3] * b[1] + m[4] * b[2],
        m[2] * b[0] + m[4] * b[1] + m[5] * b[2],
    )


def body_rate(H: Vector, h: Vector, p: Parameters) -> tuple[Scalar, Scalar, Scalar]:
    """Return omega (rad/s, B) = A^-1 (H - K - sum_free h u), from H and the axial momenta `h`; that of a held wheel is not used."""
    rest = [H[k] - p.held_momentum[k] for k in range(3)]
    for h_i, wheel in zip(h, p.wheels, strict=True):
        rest = [rest[k] - wheel.free * h_i * wheel.axis[k] for k in range(3)]
    return symmetric_times(p.inverse, rest)


def wheel_speed(h_i: Scalar, omega: Vector, wheel: WheelParameters) -> Scalar:
    """Return W (rad/s), the speed of a free wheel relative to the body, from its axial momentum `h_i` and the body rate."""
    return h_i * wheel.inverse_inertia - dot(wheel.axis, omega)


def wheel_torque(h_i: Scalar, omega: Vector, wheel: WheelParameters) -> Scalar:
    """Return the friction torque on a wheel along its axis (N m); zero for a held wheel (see :func:`holding_torque`)."""
    return wheel.free * (-wheel.coulomb - wheel.viscous * wheel_speed(h_i, omega, wheel))


def gravity_gradient(nadir: Vector, inertia: Vector, strength: Scalar) -> tuple[Scalar, ...]:
    """Return 3 n^2 nadir x (I nadir) (eq. 23), N m: unit nadir in B, I as six elements in kg m2, strength 3 n^2 in 1/s2."""
    return tuple(strength * x for x in cross(nadir, symmetric_times(inertia, nadir)))


def rhs(
    H: Vector, h: Vector, r: Vector, p: Parameters, torque: Vector = NO_TORQUE
) -> tuple[tuple[Scalar, ...], tuple[Scalar, ...], tuple[Scalar, ...]]:
    """Return the time derivatives of H, h and r in body axes (paper, eqs. 3, 4, 5, 7, in momenta).

    torque : (3,) N m, B
        External torque on the body.
    """
    omega = body_rate(H, h, p)
    by_rotation = cross(H, omega)
    return (
        tuple(by_rotation[k] + torque[k] for k in range(3)),
        tuple(wheel_torque(h_i, omega, wheel) for h_i, wheel in zip(h, p.wheels, strict=True)),
        cross(r, omega),
    )


def holding_torque(
    H: Vector, h: Vector, p: Parameters, wheel: int, torque: Vector = NO_TORQUE
) -> Scalar:
    """Return J u.domega/dt (N m), the torque that keeps the speed of held wheel number `wheel`.

    If it is stuck, it breaks away beyond mu0 (eq. 6). domega/dt = A^-1 (H x omega + torque - sum_free M u).
    """
    omega = body_rate(H, h, p)
    by_rotation = cross(H, omega)
    moment = [by_rotation[k] + torque[k] for k in range(3)]
    for h_i, each in zip(h, p.wheels, strict=True):
        friction = wheel_torque(h_i, omega, each)
        moment = [moment[k] - friction * each.axis[k] for k in range(3)]
    own = p.wheels[wheel]
    return dot(own.axis, symmetric_times(p.inverse, moment)) / own.inverse_inertia


def free_inertia(vehicle: Vehicle | Bodies, free: Sequence[bool]) -> np.ndarray:
    """Return A (..., 3, 3) in kg m2: the inertia less the axial inertia J u u' of each wheel that turns freely (`free`)."""
    bodies = Bodies.of(vehicle)
    tensor = np.array(bodies.inertia_kg_m2)
    for k, is_free in enumerate(free):
        if is_free:
            axis = bodies.axes_B[k]
            tensor -= bodies.wheel_inertia_kg_m2[..., k, None, None] * np.outer(axis, axis)
    return tensor


def total_momentum(
    vehicle: Vehicle | Bodies, omega_B: np.ndarray, wheel_speed_rad_s: np.ndarray
) -> np.ndarray:
    """Return H = Theta omega + sum J W u (..., 3) in N m s, from omega_B (..., 3) and wheel speeds W (..., n_wheel).

    Theta is the inertia with locked wheels.
    """
    bodies = Bodies.of(vehicle)
    spins = bodies.wheel_inertia_kg_m2 * wheel_speed_rad_s
    return np.einsum("...i,...ij->...j", omega_B, bodies.inertia_kg_m2) + spins @ bodies.axes_B


def axial_momenta(
    vehicle: Vehicle | Bodies, omega_B: np.ndarray, wheel_speed_rad_s: np.ndarray
) -> np.ndarray:
    """Return the axial momentum h = J (W + u.omega) of each wheel (..., n_wheel) in N m s; arguments as :func:`total_momentum`."""
    bodies = Bodies.of(vehicle)
    return bodies.wheel_inertia_kg_m2 * (wheel_speed_rad_s + omega_B @ bodies.axes_B.T)


def kinetic_energy(
    vehicle: Vehicle | Bodies, omega_B: np.ndarray, wheel_speed_rad_s: np.ndarray
) -> np.ndarray:
    """Return the rotational kinetic energy (...) in J, wheels included: omega.A omega / 2 + sum h^2 / (2 J)."""
    bodies = Bodies.of(vehicle)
    tensor = free_inertia(bodies, [True] * bodies.n_wheels)
    h = axial_momenta(bodies, omega_B, wheel_speed_rad_s)
    body = np.einsum("...i,...ij,...j->...", omega_B, tensor, omega_B) / 2
    return body + (h**2 / (2 * bodies.wheel_inertia_kg_m2)).sum(axis=-1)
