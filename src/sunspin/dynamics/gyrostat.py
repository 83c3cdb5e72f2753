"""The equations of motion of a rigid body with wheels, written once.

State, in body axes B: total angular momentum H (3, N m s), the physical axial momentum h_i of each wheel (N m s), the
direction to the Sun r (unit, 3) and, where attitude is wanted, the quaternion B_from_N (scalar last). With A the inertia
without the axial inertia of the wheels that turn freely,

    omega = A^-1 (H - sum_free h u - K)      K = sum_held J W u
    dH/dt = H x omega      dh/dt = M(W)      dr/dt = r x omega      W = h / J - u.omega

which is the paper's eqs. (3), (4) and (7) without a matrix to solve per step, and with the invariants |H|, |r| and H.r in
view: they hold whatever the wheels' torques are. The torque on a coasting wheel is M = -sign(W) (mu0 + mu1 |W|), eq. (5).

:func:`rhs` and the observables use only + - * on scalars. Called with heyoka expressions they build the reference
integrator; traced with SymPy symbols they become the source of the ensemble kernel. There is no second copy of them.
What depends on a wheel's mode (free or held, sign of its speed) enters through :class:`Parameters`, never through a branch,
so every mode is a smooth system and mode changes are events of the callers. So do torques from outside
(:mod:`sunspin.dynamics.torques`): with them H moves in space too, and directions in space that they depend on are part of the
state beside the Sun's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from sunspin.dynamics.bodies import Bodies
from sunspin.vehicle import Vehicle

Scalar = Any  # a float, a heyoka expression or a SymPy symbol
Vector: TypeAlias = (
    Sequence[Any] | np.ndarray
)  # scalars, or an array whose first axis are the components


class WheelParameters(NamedTuple):
    """One wheel in one mode. `free` is 1 where the wheel turns freely (its torque is friction) and 0 where it is held."""

    axis: tuple[Scalar, ...]  # three
    inverse_inertia: Scalar  # 1 / J
    free: Scalar  # 1 or 0
    coulomb: Scalar  # sign(W) * (mu0 + brake): signed Coulomb torque, N m
    viscous: Scalar  # mu1, N m s


class Direction(NamedTuple):
    """A direction in body axes; `turn`, in body axes too, is the rate (rad/s) at which it turns in space, None where it stands."""

    vector: Vector
    turn: Vector | None = None


Directions: TypeAlias = Mapping[str, Direction]  # by name, "sun" first


class OutsideTorque(NamedTuple):
    """A torque on the body: `torque(omega_B, directions_B, t_s, parameters)` in N m, of + - * only, and its parameters."""

    torque: Callable[[Vector, Mapping[str, Vector], Scalar, Vector], Vector]
    parameters: Vector


class Parameters(NamedTuple):
    """All that :func:`rhs` needs besides the state: A^-1 as (xx, xy, xz, yy, yz, zz), K (N m s), wheels, torques from outside."""

    inverse: tuple[Scalar, ...]  # six
    held_momentum: tuple[Scalar, ...]  # three
    wheels: tuple[WheelParameters, ...]
    outside: tuple[OutsideTorque, ...] = ()


def cross(a: Vector, b: Vector) -> tuple[Scalar, Scalar, Scalar]:
    """a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def dot(a: Vector, b: Vector) -> Scalar:
    """a . b for three components."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def symmetric_times(m: Vector, b: Vector) -> tuple[Scalar, Scalar, Scalar]:
    """M b for a symmetric M given as (xx, xy, xz, yy, yz, zz)."""
    return (
        m[0] * b[0] + m[1] * b[1] + m[2] * b[2],
        m[1] * b[0] + m[3] * b[1] + m[4] * b[2],
        m[2] * b[0] + m[4] * b[1] + m[5] * b[2],
    )


def body_rate(H: Vector, h: Vector, p: Parameters) -> tuple[Scalar, Scalar, Scalar]:
    """omega (rad/s, B) from total momentum and the wheels' axial momenta; `h` of a held wheel is not used."""
    rest = [H[k] - p.held_momentum[k] for k in range(3)]
    for h_i, wheel in zip(h, p.wheels, strict=True):
        rest = [rest[k] - wheel.free * h_i * wheel.axis[k] for k in range(3)]
    return symmetric_times(p.inverse, rest)


def wheel_speed(h_i: Scalar, omega: Vector, wheel: WheelParameters) -> Scalar:
    """W (rad/s), speed of a free wheel relative to the body."""
    return h_i * wheel.inverse_inertia - dot(wheel.axis, omega)


def wheel_torque(h_i: Scalar, omega: Vector, wheel: WheelParameters) -> Scalar:
    """Torque on the wheel along its axis (N m), zero where it is held: what holds it follows from the motion."""
    return wheel.free * (-wheel.coulomb - wheel.viscous * wheel_speed(h_i, omega, wheel))


def momentum_rate(
    H: Vector, omega: Vector, directions: Directions, p: Parameters, t_s: Scalar
) -> Vector:
    """dH/dt (N m, B): as seen from the turning body, and by the torques from outside."""
    moment = cross(H, omega)
    vectors = {name: direction.vector for name, direction in directions.items()}
    for acting in p.outside:
        torque = acting.torque(omega, vectors, t_s, acting.parameters)
        moment = (moment[0] + torque[0], moment[1] + torque[1], moment[2] + torque[2])
    return moment


def direction_rate(direction: Direction, omega: Vector) -> tuple[Scalar, ...]:
    """d/dt of a direction as the body turns and, where it turns in space, of its turning rate too: d x (omega - turn)."""
    if direction.turn is None:
        return cross(direction.vector, omega)
    relative = [omega[k] - direction.turn[k] for k in range(3)]
    return (*cross(direction.vector, relative), *cross(direction.turn, omega))


def rhs(
    H: Vector,
    h: Vector,
    directions: Directions,
    p: Parameters,
    t_s: Scalar = 0,
    spin: Scalar = 0,
    axis: Vector | None = None,
) -> tuple[Vector, tuple[Scalar, ...], tuple[Scalar, ...]]:
    """Time derivatives in body axes of H, h and, one after the other, the directions with their turning rates.

    Paper eqs. (3), (4), (5), (7) in terms of momenta, and with torques from outside. Without those a `spin` in 1/(kg m2) may be
    given: the directions are then seen from axes that turn about H at the rate spin |H| besides. The share spin H of omega turns
    them about H and leaves H alone, and what is left of omega is slower than omega; see :func:`spun`. Where torques move H, an
    `axis` in space that was H once stands for it: the first direction alone is seen from axes that turn about it, and its own
    derivative comes last.
    """
    omega = body_rate(H, h, p)
    torques = tuple(wheel_torque(h_i, omega, wheel) for h_i, wheel in zip(h, p.wheels, strict=True))
    if axis is not None:
        left = tuple(omega[k] - spin * axis[k] for k in range(3))
        sun, *others = directions.values()
        rates = (x for direction in others for x in direction_rate(direction, omega))
        return (
            momentum_rate(H, omega, directions, p, t_s),
            torques,
            (*direction_rate(sun, left), *rates, *cross(axis, left)),
        )
    left = tuple(omega[k] - spin * H[k] for k in range(3)) if spin != 0 else omega
    moment = momentum_rate(H, left, directions, p, t_s)
    return (
        moment,
        torques,
        tuple(x for direction in directions.values() for x in direction_rate(direction, left)),
    )


def spun(H: Vector, r: Vector, cosine: Scalar, sine: Scalar, along: Scalar) -> tuple[Scalar, ...]:
    """r in body axes, from its value in the axes that turn about H, after a turn by the angle a = spin |H| t.

    `cosine` is cos a, `sine` is sin a / |H|, `along` is (1 - cos a) H.r / |H|^2; H.r is an invariant.
    """
    x = cross(r, H)
    return tuple(cosine * r[k] + sine * x[k] + along * H[k] for k in range(3))


def quaternion_rate(q: Vector, omega: Vector) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """dq/dt of q = B_from_N, scalar last: -1/2 (omega, 0) * q."""
    x, y, z, w = q
    a, b, c = (0.5 * component for component in omega)
    return (
        -(a * w + b * z - c * y),
        -(b * w + c * x - a * z),
        -(c * w + a * y - b * x),
        a * x + b * y + c * z,
    )


def body_acceleration(
    H: Vector, h: Vector, p: Parameters, directions: Directions, t_s: Scalar = 0
) -> tuple[Scalar, Scalar, Scalar]:
    """domega/dt (rad/s2, B)."""
    omega = body_rate(H, h, p)
    moment = momentum_rate(H, omega, directions, p, t_s)
    for h_i, wheel in zip(h, p.wheels, strict=True):
        torque = wheel_torque(h_i, omega, wheel)
        moment = [moment[k] - torque * wheel.axis[k] for k in range(3)]
    return symmetric_times(p.inverse, moment)


def holding_torque(
    H: Vector,
    h: Vector,
    p: Parameters,
    wheel: WheelParameters,
    inertia: Scalar,
    directions: Directions,
    t_s: Scalar = 0,
) -> Scalar:
    """J u.domega/dt (N m): the torque on a held wheel that keeps its speed; a stuck one breaks away beyond mu0 (eq. 6)."""
    return inertia * dot(wheel.axis, body_acceleration(H, h, p, directions, t_s))


# ---- what is computed with numbers only --------------------------------------------------------------------------------


def free_inertia(vehicle: Vehicle | Bodies, free: Sequence[bool]) -> np.ndarray:
    """A (..., 3, 3) in kg m2: the vehicle's inertia less the axial inertia of each free wheel."""
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
    """H = Theta omega + sum J W u (..., 3) in N m s, from omega_B (..., 3) and wheel speeds (..., n_wheel)."""
    bodies = Bodies.of(vehicle)
    spins = bodies.wheel_inertia_kg_m2 * wheel_speed_rad_s
    return np.einsum("...i,...ij->...j", omega_B, bodies.inertia_kg_m2) + spins @ bodies.axes_B


def axial_momenta(
    vehicle: Vehicle | Bodies, omega_B: np.ndarray, wheel_speed_rad_s: np.ndarray
) -> np.ndarray:
    """h = J (W + u.omega) (..., n_wheel) in N m s."""
    bodies = Bodies.of(vehicle)
    return bodies.wheel_inertia_kg_m2 * (wheel_speed_rad_s + omega_B @ bodies.axes_B.T)


def kinetic_energy(
    vehicle: Vehicle | Bodies, omega_B: np.ndarray, wheel_speed_rad_s: np.ndarray
) -> np.ndarray:
    """Rotational kinetic energy (...) in J, wheels included: omega.A omega / 2 + sum h^2 / (2 J)."""
    bodies = Bodies.of(vehicle)
    tensor = free_inertia(bodies, [True] * bodies.n_wheels)
    h = axial_momenta(bodies, omega_B, wheel_speed_rad_s)
    body = np.einsum("...i,...ij,...j->...", omega_B, tensor, omega_B) / 2
    return body + (h**2 / (2 * bodies.wheel_inertia_kg_m2)).sum(axis=-1)
