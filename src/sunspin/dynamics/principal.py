"""The principal axes of the split kernel, and how many steps it needs.

The kernel (:mod:`sunspin.dynamics.kernels.split`) composes a motion of rotations about the principal axes p, q and m of A, in three
parts called P, Q and main. Their commutators are the error of the method. The principal axes are named so that it is smallest.
l are the inverse principal moments, in the order p, q, m.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np

from sunspin.dynamics.bodies import Bodies
from sunspin.dynamics.gyrostat import free_inertia
from sunspin.vehicle import Vehicle

ORDERS = np.array(list(permutations(range(3))))
"""Ways (6, 3) to name three principal axes p, q, m."""

TYPICAL_RATE, TYPICAL_WHEEL_RATE = 0.3, 100.0
"""rad/s of the body, and of a wheel whose speed the vehicle does not give: only the choice of axes depends on them."""

LAW = 7e-4
"""Factor of the error law of :func:`split_steps`: measured on Philae, where the wheel counts, and on random bodies of very unequal
moments."""

OBLIQUE_LAW = 0.3
"""Factor of the part of the law that oblique wheels cause. While wheels turn steadily 0.02 keeps the phase (99 of 100 among 3,000
random bodies), but at a wheel that stops an error of phase becomes one of rate. With 0.3 at most one EMD in 100 errs by more than
2e-3."""

MOST_MAIN_ANGLE, MOST_SIDE_ANGLE = 1.2, 0.6
"""Largest rotation (rad) by main, and by P or Q, in a step."""


def free_sets(n_wheels: int) -> np.ndarray:
    """Return all sets of wheels that may turn freely, as booleans (2^n_wheels, n_wheels); bit i of a set's number is wheel i."""
    return np.arange(2**n_wheels)[:, None] >> np.arange(n_wheels) & 1 > 0


def frames(vehicle: Vehicle, bodies: Bodies) -> np.ndarray:
    """Return, for every set of free wheels, l (3), 1/(kg m2), and the rotation from B to axes p, q, m (9, by rows): (n_set, 12).

    bodies : Bodies
        One body, leading shape (1,).
    """
    sets = free_sets(bodies.n_wheels)
    moments, columns = np.linalg.eigh(np.stack([free_inertia(bodies, free)[0] for free in sets]))
    inverse, axes = 1.0 / moments, np.swapaxes(columns, -1, -2)
    wheel_momenta = bodies.wheel_inertia_kg_m2[0] * np.array(
        [abs(wheel.speed_rad_s or TYPICAL_WHEEL_RATE) for wheel in vehicle.wheels]
    )
    wheel_rates = _wheel_rates(bodies, inverse, axes, wheel_momenta[None])[:, 0]
    momentum = TYPICAL_RATE * float(np.trace(vehicle.require_inertia())) / 3
    momentum += sum(wheel.inertia_kg_m2 * abs(wheel.speed_rad_s or 0.0) for wheel in vehicle.wheels)
    body_rate = inverse.mean(axis=-1) * momentum
    error = np.stack([_commutators(order, inverse, wheel_rates, body_rate) for order in ORDERS])
    order = ORDERS[np.argmin(error, axis=0)]
    axes = np.take_along_axis(axes, order[..., None], axis=-2)
    # right-handed
    axes[..., 0, :] *= np.sign(np.linalg.det(axes))[..., None]
    ordered = np.take_along_axis(inverse, order, axis=-1)
    return np.concatenate([ordered, axes.reshape(-1, 9)], axis=1)


def _wheel_rates(
    bodies: Bodies, inverse: np.ndarray, axes: np.ndarray, momenta: np.ndarray
) -> np.ndarray:
    """Return bounds (n_set, n, 3) of the part l sum_free |h| |u| of omega by free wheels, rad/s, in principal axes.

    `inverse` (n_set, 3): l; `axes` (n_set, 3, 3): rotation from B; `momenta` (n, n_wheel): |h|.
    """
    total = np.zeros((len(inverse), len(momenta), 3))
    for i, free in enumerate(free_sets(bodies.n_wheels).T):
        along = np.abs(axes @ bodies.axes_B[i]) * free[:, None]
        total += along[:, None] * momenta[:, i, None]
    return inverse[:, None] * total


def _commutators(
    order: np.ndarray, inverse: np.ndarray, wheel_rates: np.ndarray, body_rate: np.ndarray
) -> np.ndarray:
    """Return the size (n_set) of the third-order commutators of main, P and Q, with the axes p, q, m in this `order` (3).

    `inverse` (n_set, 3): l; `wheel_rates` (n_set, 3) and `body_rate` (n_set): typical rates, rad/s.
    """
    p, q, m = order
    # l_i - l_q times a typical momentum: the rates of main and P without wheels; Q has none
    by_body = np.abs(inverse - inverse[..., q, None])
    by_body = by_body / inverse.mean(axis=-1, keepdims=True) * body_rate[..., None]
    rate_main, rate_p = by_body[..., m] + wheel_rates[..., m], by_body[..., p] + wheel_rates[..., p]
    rate_q = wheel_rates[..., q]
    sides = rate_p + rate_q
    return rate_main**2 * sides / 24 + rate_main * sides**2 / 12 + rate_p * rate_q * sides / 12


def split_steps(
    bodies: Bodies,
    frame: np.ndarray,
    momenta: tuple[np.ndarray, np.ndarray],
    duration_s: float,
    phase_error: float,
) -> np.ndarray:
    """Return the number of steps (n), not rounded, for an error of the direction at the end (rad).

    After steps of h seconds over T seconds the phase errs by about LAW (b' (a' + b')^4 + b^2 a^3) h^4 T. a and b are the rates of
    main, and of P and Q together; a' and b' are those without wheels. The part of the wheels is constant in body axes, and errors
    of first order in b average out over its revolutions. With the rates p and q of P and Q, their own commutators add
    OBLIQUE_LAW p q (p + q) h^2 T, the error of Q P Q. The set of free wheels with the most steps counts.

    frame : (n_set, 12)
        As of :func:`frames`.
    momenta : (n), (n, n_wheel)
        |H| and h in N m s.
    """
    inverse, axes = frame[:, :3], frame[:, 3:].reshape(-1, 3, 3)
    # (n_set, n, 3), in the order p, q, m
    without_wheels = np.abs(inverse - inverse[:, 1:2])[:, None] * momenta[0][:, None]
    rates = without_wheels + _wheel_rates(bodies, inverse, axes, np.abs(momenta[1]))
    main, sides = rates[..., 2], rates[..., 0] + rates[..., 1]
    bare_main, bare_sides = without_wheels[..., 2], without_wheels[..., 0] + without_wheels[..., 1]
    law = (bare_sides * (bare_main + bare_sides) ** 4 + sides**2 * main**3).max(axis=0)
    duration = abs(duration_s)
    steps = duration * (LAW * law * duration / phase_error) ** 0.25
    rate_p, rate_q = rates[..., 0], rates[..., 1]
    law = (rate_p * rate_q * (rate_p + rate_q)).max(axis=0)
    steps = np.maximum(steps, duration * (OBLIQUE_LAW * law * duration / phase_error) ** 0.5)
    steps = np.maximum(steps, main.max(axis=0) * duration / MOST_MAIN_ANGLE)
    return np.maximum(steps, rates[..., :2].max(axis=(0, 2)) * duration / MOST_SIDE_ANGLE)
