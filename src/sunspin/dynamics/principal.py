"""The principal axes in which :mod:`sunspin.dynamics.kernels.split` rotates, and how many steps it needs.

The three parts main, P and Q of the flow are rotations about the axes m, p and q. Which principal axis is which is chosen so that
their commutators, the error of the method, are smallest.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np

from sunspin.dynamics import gyrostat as g
from sunspin.dynamics.bodies import Bodies
from sunspin.vehicle import Vehicle

ORDERS = np.array(list(permutations(range(3))))
"""Ways to call three principal axes p, q, m."""

TYPICAL_RATE = 0.3
"""rad/s of the body, and 100 rad/s of a wheel whose speed the vehicle does not give: only the choice of axes depends on them."""

LAW = 7e-4
"""Of the law of errors: measured on Philae, where the wheel's part counts, and on random bodies of very unequal moments."""

OBLIQUE_LAW = 0.3
"""Of the part of the law that oblique wheels cause. While wheels turn steadily 0.02 keeps the phase (99 of 100 among 3,000 random
bodies), but a wheel that stops turns an error of phase into one of rate. With 0.3 at most one EMD in 100 errs by more than 2e-3."""

MOST_MAIN_ANGLE, MOST_SIDE_ANGLE = 1.2, 0.6
"""rad by which the parts may rotate in a step."""


def free_sets(n_wheels: int) -> np.ndarray:
    """Return which wheels turn freely (2^n_wheels, n_wheels), in every set; bit i of its number stands for wheel i."""
    return np.arange(2**n_wheels)[:, None] >> np.arange(n_wheels) & 1 > 0


def frames(vehicle: Vehicle, bodies: Bodies) -> np.ndarray:
    """Return inverse moments l (1/(kg m2)) and rows p, q, m of the rotation from B, (n_set, 12), for every set of free wheels.

    bodies : Bodies
        One body, leading shape (1,).
    """
    sets = free_sets(bodies.n_wheels)
    moments, columns = np.linalg.eigh(np.stack([g.free_inertia(bodies, free)[0] for free in sets]))
    inverse, axes = 1.0 / moments, np.swapaxes(columns, -1, -2)
    wheel_momenta = bodies.wheel_inertia_kg_m2[0] * np.array(
        [abs(wheel.speed_rad_s or 100.0) for wheel in vehicle.wheels]
    )
    bias = _wheel_rates(bodies, inverse, axes, wheel_momenta[None])[:, 0]
    momentum = TYPICAL_RATE * float(np.trace(vehicle.require_inertia())) / 3
    momentum += sum(wheel.inertia_kg_m2 * abs(wheel.speed_rad_s or 0.0) for wheel in vehicle.wheels)
    turn = inverse.mean(axis=-1) * momentum
    cost = np.stack([_commutators(order, inverse, bias, turn) for order in ORDERS])
    order = ORDERS[np.argmin(cost, axis=0)]
    axes = np.take_along_axis(axes, order[..., None], axis=-2)
    axes[..., 0, :] *= np.sign(np.linalg.det(axes))[..., None]
    ordered = np.take_along_axis(inverse, order, axis=-1)
    return np.concatenate([ordered, axes.reshape(-1, 9)], axis=1)


def _wheel_rates(
    bodies: Bodies, inverse: np.ndarray, axes: np.ndarray, momenta: np.ndarray
) -> np.ndarray:
    """Return bounds (n_set, n, 3) in rad/s on l sum_free |h| |u| in principal axes, from |h| (n, n_wheel)."""
    total = np.zeros((len(inverse), len(momenta), 3))
    for i, free in enumerate(free_sets(bodies.n_wheels).T):
        along = np.abs(axes @ bodies.axes_B[i]) * free[:, None]
        total += along[:, None] * momenta[:, i, None]
    return inverse[:, None] * total


def _commutators(
    order: np.ndarray, inverse: np.ndarray, bias: np.ndarray, turn: np.ndarray
) -> np.ndarray:
    """Return the size (n_set) of the commutators of main, P and Q at typical rates, with the axes called in this order."""
    p, q, m = order
    spread = np.abs(inverse - inverse[..., q, None])
    spread = spread / inverse.mean(axis=-1, keepdims=True) * turn[..., None]
    main, first, second = spread[..., m] + bias[..., m], spread[..., p] + bias[..., p], bias[..., q]
    small = first + second
    return main**2 * small / 24 + main * small**2 / 12 + first * second * small / 12


def split_steps(
    bodies: Bodies,
    frame: np.ndarray,
    momenta: tuple[np.ndarray, np.ndarray],
    duration_s: float,
    phase_error: float,
) -> np.ndarray:
    """Return the number of steps (n), a float, for an error of the direction at the end (rad).

    With a and b the rates of main and of the others, and a' and b' those without wheels, the phase errs by about
    LAW (b' (a' + b')^4 + b^2 a^3) h^4 T: what the wheels add is constant in body axes, and errors of first order in b average out
    over its turns. With p and q the rates of P and Q, their commutators add OBLIQUE_LAW p q (p + q) h^2 T, the error of Q P Q.

    momenta : (n), (n, n_wheel)
        |H| and |h| in N m s.
    """
    inverse, axes = frame[:, :3], frame[:, 3:].reshape(-1, 3, 3)
    spread = np.abs(inverse - inverse[:, 1:2])[:, None] * momenta[0][:, None]
    rates = spread + _wheel_rates(bodies, inverse, axes, np.abs(momenta[1]))
    main, others = rates[..., 2], rates[..., 0] + rates[..., 1]
    plain_main, plain = spread[..., 2], spread[..., 0] + spread[..., 1]
    law = (plain * (plain_main + plain) ** 4 + others**2 * main**3).max(axis=0)
    duration = abs(duration_s)
    steps = duration * (LAW * law * duration / phase_error) ** 0.25
    side, oblique = rates[..., 0], rates[..., 1]
    law = (side * oblique * (side + oblique)).max(axis=0)
    steps = np.maximum(steps, duration * (OBLIQUE_LAW * law * duration / phase_error) ** 0.5)
    steps = np.maximum(steps, main.max(axis=0) * duration / MOST_MAIN_ANGLE)
    return np.maximum(steps, rates[..., :2].max(axis=(0, 2)) * duration / MOST_SIDE_ANGLE)
