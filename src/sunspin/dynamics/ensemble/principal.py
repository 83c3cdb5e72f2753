"""The gyrostat's flow as a product of rotations about fixed body axes: the numbers behind the fast ensemble kernel.

In the principal axes (p, q, m) of A^-1 the body rate is omega_i = l_i H_i - w_i with w = l (K + sum_free h u), and H and the
Sun's direction r both turn with it (dv/dt = v x omega; :mod:`sunspin.dynamics.gyrostat`). A multiple of H in omega turns r about
H, which stays: that part, l_q H, commutes with all others and is done exactly. What is left has three parts, each a rotation
about an axis at a rate that it does not change:

    main   (l_m - l_q) H_m - w_m  about m, together with the friction that does not depend on omega
    P      (l_p - l_q) H_p - w_p  about p
    Q                      - w_q  about q

Products of these flows are rotations, so |H|, |r| and H.r are kept to rounding, and the error comes from commutators: it
falls with the differences of the moments of inertia, not with the rate of the tumbling.

How they are composed is told in split_lanes.py. What friction's share of omega does to the wheels is added after each step.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np

from sunspin.dynamics import gyrostat as g
from sunspin.dynamics.bodies import Bodies
from sunspin.vehicle import Vehicle

ORDERS = np.array(list(permutations(range(3))))
"""Ways to call three principal axes p, q, m."""

TYPICAL_RATE = 0.3
"""rad/s of the body, and 100 rad/s of a wheel whose speed the vehicle does not tell: only the choice of axes hangs on them."""


def free_sets(n_wheels: int) -> np.ndarray:
    """Which wheels are free (2^n_wheels, n_wheels), in every set (bit i of its number: wheel i is)."""
    return np.arange(2**n_wheels)[:, None] >> np.arange(n_wheels) & 1 > 0


def free_inertias(bodies: Bodies) -> np.ndarray:
    """The inertia A (n_set, ..., 3, 3) for every set of free wheels."""
    return np.stack([g.free_inertia(bodies, free) for free in free_sets(bodies.n_wheels)])


@dataclass(frozen=True)
class Frames:
    """Principal frames for every set of free wheels: l (n_set, ..., 3) in 1/(kg m2), rows (p, q, m) of the rotation from B."""

    inverse: np.ndarray
    axes: np.ndarray


def frames(vehicle: Vehicle, bodies: Bodies) -> Frames:
    """The principal frames whose order of axes makes the commutators of the three parts smallest."""
    moments, columns = np.linalg.eigh(free_inertias(bodies))
    inverse, axes = 1.0 / moments, np.swapaxes(columns, -1, -2)
    bias = _typical_wheel_rates(vehicle, bodies, inverse, axes)
    turn = inverse.mean(axis=-1) * _typical_momentum(vehicle)
    cost = np.stack([_cost(order, inverse, bias, turn) for order in ORDERS])
    order = ORDERS[np.argmin(cost, axis=0)]
    axes = np.take_along_axis(axes, order[..., None], axis=-2)
    axes[..., 0, :] *= np.sign(np.linalg.det(axes))[..., None]
    return Frames(np.take_along_axis(inverse, order, axis=-1), axes)


def _typical_momentum(vehicle: Vehicle) -> float:
    """N m s."""
    body = TYPICAL_RATE * float(np.trace(vehicle.require_inertia())) / 3
    return body + sum(
        wheel.inertia_kg_m2 * abs(wheel.speed_rad_s or 0.0) for wheel in vehicle.wheels
    )


def _typical_wheel_rates(
    vehicle: Vehicle, bodies: Bodies, inverse: np.ndarray, axes: np.ndarray
) -> np.ndarray:
    """Components (n_set, ..., 3) of A^-1 sum_free J |W| |u|."""
    speeds = np.array([abs(wheel.speed_rad_s or 100.0) for wheel in vehicle.wheels])
    return _wheel_rates(bodies, inverse, axes, bodies.wheel_inertia_kg_m2 * speeds)


def _wheel_rates(
    bodies: Bodies, inverse: np.ndarray, axes: np.ndarray, momenta: np.ndarray
) -> np.ndarray:
    """Bounds (n_set, n, 3) in rad/s on l sum_free |h| |u| in principal axes, from |h| (n, n_wheel)."""
    total = np.zeros(1)
    for i, free in enumerate(free_sets(bodies.n_wheels).T):
        along = np.abs(axes @ bodies.axes_B[i]) * free[:, None, None]
        total = total + along * momenta[..., i, None]
    return inverse * total


def _cost(order: np.ndarray, inverse: np.ndarray, bias: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Size of the commutators of main, P and Q, rotations about the axes m, p and q, at typical rates."""
    p, q, m = order
    spread = (
        np.abs(inverse - inverse[..., q, None])
        / inverse.mean(axis=-1, keepdims=True)
        * turn[..., None]
    )
    main, first, second = spread[..., m] + bias[..., m], spread[..., p] + bias[..., p], bias[..., q]
    small = first + second
    return main**2 * small / 24 + main * small**2 / 12 + first * second * small / 12


def part_rates(
    bodies: Bodies, frame: Frames, momentum: np.ndarray, axial: np.ndarray
) -> np.ndarray:
    """Bounds (3, n_set, n) on the rates of main, P and Q in rad/s, from |H| (n) and |h| (n, n_wheel), per set of free wheels."""
    spread = np.abs(frame.inverse - frame.inverse[..., 1:2]) * momentum[:, None]
    rates = spread + _wheel_rates(bodies, frame.inverse, frame.axes, np.abs(axial))
    return np.moveaxis(rates[..., [2, 0, 1]], -1, 0)


def is_oblique(vehicle: Vehicle) -> bool:
    """Whether the part Q is needed: some wheel axis has a component along q."""
    bodies = Bodies.of(vehicle, 1)
    along = np.abs(frames(vehicle, bodies).axes[:, 0, 1] @ bodies.axes_B.T)
    return bool(np.any((along > 1e-12) & free_sets(bodies.n_wheels)))
