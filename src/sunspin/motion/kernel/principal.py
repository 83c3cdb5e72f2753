"""The gyrostat's flow as a product of rotations about fixed body axes: the numbers behind the fast ensemble kernel.

In the principal axes (p, q, m) of A^-1 the body rate is omega_i = l_i H_i - w_i with w = l (K + sum_free h u), and H and the
Sun's direction r both turn with it (dv/dt = v x omega; :mod:`sunspin.motion.gyrostat`). A multiple of H in omega turns r about
H, which stays: that part, l_q H, commutes with all others and is done exactly. What is left has three parts, each a rotation
about an axis at a rate that it does not change:

    main   (l_m - l_q) H_m - w_m  about m, together with the friction that does not depend on omega
    P      (l_p - l_q) H_p - w_p  about p
    Q                      - w_q  about q

Products of these flows are rotations, so |H|, |r| and H.r are kept to rounding, and the error comes from commutators: it
falls with the differences of the moments of inertia, not with the rate of the tumbling.

They are composed as Q/2 P/2 main P/2 Q/2 (Strang), which is of second order and its own mirror image. What friction's share of
omega does to the wheels is added after each step.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np

from sunspin.motion import gyrostat as g
from sunspin.vehicle import Vehicle


@dataclass(frozen=True)
class Frame:
    """Principal frame of one set of free wheels: l (3) in 1/(kg m2) and the rows (p, q, m) of the rotation from B (3, 3)."""

    inverse: np.ndarray
    axes: np.ndarray


def frames(vehicle: Vehicle) -> list[Frame]:
    """One principal frame for every set of free wheels (bit i: wheel i is free)."""
    n = len(vehicle.wheels)
    return [_frame(vehicle, [bool(bits >> i & 1) for i in range(n)]) for bits in range(2**n)]


def _frame(vehicle: Vehicle, free: list[bool]) -> Frame:
    moments, columns = np.linalg.eigh(g.free_inertia(vehicle, free))
    inverse = 1.0 / moments
    bias = _typical_wheel_rate(vehicle, free, inverse, columns)
    turn = np.mean(inverse) * _typical_momentum(vehicle)
    best = min(permutations(range(3)), key=lambda order: _cost(order, inverse, bias, turn))
    axes = columns[:, list(best)].T.copy()
    axes[0] *= np.sign(np.linalg.det(axes))
    return Frame(inverse[list(best)], axes)


def _typical_momentum(vehicle: Vehicle) -> float:
    """N m s; only the choice of axes depends on it."""
    body = 0.3 * float(np.trace(vehicle.require_inertia())) / 3
    return body + sum(wheel.inertia_kg_m2 * abs(wheel.speed_rad_s or 0.0) for wheel in vehicle.wheels)


def _typical_wheel_rate(vehicle: Vehicle, free: list[bool], inverse: np.ndarray, columns: np.ndarray) -> np.ndarray:
    total = np.zeros(3)
    for wheel, is_free in zip(vehicle.wheels, free, strict=True):
        if is_free:
            total += wheel.inertia_kg_m2 * abs(wheel.speed_rad_s or 100.0) * np.abs(columns.T @ wheel.axis_B)
    return inverse * total


def _cost(order: tuple[int, ...], inverse: np.ndarray, bias: np.ndarray, turn: float) -> float:
    """Size of the commutators for main, P, Q = axes m, p, q; see `commutator_rate`."""
    p, q, m = order
    spread = np.abs(inverse - inverse[q]) / np.mean(inverse) * turn
    return float(_commutators(spread[m] + bias[m], spread[p] + bias[p], bias[q]))


def _commutators(main: np.ndarray, p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """rad/s per (step in s)^2: leading error of Strang's product of three rotations at these rates, a bound."""
    small = p + q
    return main**2 * small / 24 + main * small**2 / 12 + p * q * small / 12


def part_rates(vehicle: Vehicle, momentum: np.ndarray, axial: np.ndarray) -> np.ndarray:
    """Bounds (3, n_sets, n) on the rates of main, P and Q in rad/s, from |H| (n) and |h| (n, n_wheel), per set of free wheels."""
    found = []
    for bits, frame in enumerate(frames(vehicle)):
        spread = np.abs(frame.inverse - frame.inverse[1])
        bias = np.zeros((3, len(momentum)))
        for i, wheel in enumerate(vehicle.wheels):
            if bits >> i & 1:
                bias += np.outer(frame.inverse * np.abs(frame.axes @ wheel.axis_B), np.abs(axial[:, i]))
        found.append(spread[[2, 0, 1], None] * momentum + bias[[2, 0, 1]])
    return np.stack(found, axis=1)


def strang_error_rate(rates: np.ndarray) -> np.ndarray:
    """(n): phase error of Strang's method in rad per s and per (step in s)^2, at most; `rates` from `part_rates`."""
    return _commutators(*rates).max(axis=0)


def is_oblique(vehicle: Vehicle) -> bool:
    """Whether the part Q is needed: some wheel axis has a component along q."""
    return any(
        abs(frame.axes[1] @ wheel.axis_B) > 1e-12 and bits >> i & 1
        for bits, frame in enumerate(frames(vehicle))
        for i, wheel in enumerate(vehicle.wheels)
    )
