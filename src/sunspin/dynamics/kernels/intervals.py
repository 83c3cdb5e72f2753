"""Attitude and rate of many bodies, each over its own interval: the compiled part of :mod:`sunspin.dynamics.step`.

The equations are those of :mod:`sunspin.dynamics.gyrostat` for a body without torques, with the momentum K of its wheels given
(docs/model.md). q is the attitude B_from_N, a quaternion:

    omega = A^-1 (H - K)        dH/dt = H x omega        dq/dt = -1/2 (omega, 0) q

A state is a tuple of seven numbers, H and then q (scalar last). The compiler keeps tuples in registers: with arrays the same steps
took 1.7 times as long. Momenta are in units of mean moment of inertia times rad/s.
"""

from __future__ import annotations

import numpy as np

from sunspin.dynamics.processor import compiled

LOST = 1e6
"""Momentum of a motion whose numbers overflow, because its steps are too long: its cost must be large, not NaN."""


@compiled
def _rate(h0, h1, h2, wheels, inverse):
    """Return the rate A^-1 (H - K) of a body with the momentum H, for wheels with the momentum K, `wheels` (3).

    `inverse` (6): A^-1 as xx, xy, xz, yy, yz, zz.
    """
    a, b, c = h0 - wheels[0], h1 - wheels[1], h2 - wheels[2]
    return (
        inverse[0] * a + inverse[1] * b + inverse[2] * c,
        inverse[1] * a + inverse[3] * b + inverse[4] * c,
        inverse[2] * a + inverse[4] * b + inverse[5] * c,
    )


@compiled
def _slope(state, wheels, inverse):
    """Return the derivative of a state."""
    h0, h1, h2, x, y, z, s = state
    w0, w1, w2 = _rate(h0, h1, h2, wheels, inverse)
    return (
        h1 * w2 - h2 * w1,
        h2 * w0 - h0 * w2,
        h0 * w1 - h1 * w0,
        -0.5 * (w0 * s + w1 * z - w2 * y),
        -0.5 * (w1 * s + w2 * x - w0 * z),
        -0.5 * (w2 * s + w0 * y - w1 * x),
        0.5 * (w0 * x + w1 * y + w2 * z),
    )


@compiled
def _moved(state, time, slope):
    """Return a state that has moved along a slope for a time."""
    return (
        state[0] + time * slope[0],
        state[1] + time * slope[1],
        state[2] + time * slope[2],
        state[3] + time * slope[3],
        state[4] + time * slope[4],
        state[5] + time * slope[5],
        state[6] + time * slope[6],
    )


@compiled
def _between(start, end, share):
    """Return the vector at a share of the way from `start` to `end`."""
    rest = 1.0 - share
    return (
        rest * start[0] + share * end[0],
        rest * start[1] + share * end[1],
        rest * start[2] + share * end[2],
    )


@compiled
def _advance(state, dt, count, wheels, wheels_end, inverse):
    """Return a state after dt seconds, in `count` Runge-Kutta steps; momentum `wheels` goes linearly to `wheels_end`."""
    h = dt / count
    for k in range(count):
        middle = _between(wheels, wheels_end, (k + 0.5) / count)
        first = _slope(state, _between(wheels, wheels_end, k / count), inverse)
        second = _slope(_moved(state, 0.5 * h, first), middle, inverse)
        third = _slope(_moved(state, 0.5 * h, second), middle, inverse)
        at_end = _moved(state, h, third)
        last = _slope(at_end, _between(wheels, wheels_end, (k + 1.0) / count), inverse)
        state = _moved(_moved(state, h / 6.0, first), h / 3.0, second)
        state = _moved(_moved(state, h / 3.0, third), h / 6.0, last)
    return state


@compiled
def _write_matrix(x, y, z, s, matrices, at):
    """Write the rotation matrix of a quaternion (scalar s, of any length), its nine elements from the index `at` on."""
    scale = 2.0 / (x * x + y * y + z * z + s * s)
    matrices[at] = 1.0 - scale * (y * y + z * z)
    matrices[at + 4] = 1.0 - scale * (x * x + z * z)
    matrices[at + 8] = 1.0 - scale * (x * x + y * y)
    matrices[at + 1], matrices[at + 3] = scale * (x * y - s * z), scale * (x * y + s * z)
    matrices[at + 2], matrices[at + 6] = scale * (x * z + s * y), scale * (x * z - s * y)
    matrices[at + 5], matrices[at + 7] = scale * (y * z - s * x), scale * (y * z + s * x)


@compiled
def _vector(vectors, k):
    """Return the vector number k of many."""
    return vectors[3 * k], vectors[3 * k + 1], vectors[3 * k + 2]


def carry(rates, dt_s, steps, start, end, inertias, inverses, attitudes, runs, motions, n, bodies):
    """Replace the rates (runs, motions, n, 3) by those after dt_s, and write the attitudes (runs, motions, n, 3, 3).

    Arguments as of :func:`sunspin.dynamics.step.carry_bodies`: addresses of contiguous arrays, then their sizes. `start`, `end`
    (n, 3): momentum of the wheels. `inertias` (runs, bodies, 3, 3) and `inverses` (runs, bodies, 6): of all motions of a run
    (`bodies` = 1), or of each. With addresses in place of arrays the machine code can be called without numba.
    """
    for row in range(runs * motions):
        motion = row % motions
        body = row // motions * bodies + motion % bodies
        a, v = 9 * body, 6 * body  # where its inertia and the inverse begin
        inverse = (
            inverses[v],
            inverses[v + 1],
            inverses[v + 2],
            inverses[v + 3],
            inverses[v + 4],
            inverses[v + 5],
        )
        for i in range(n):
            at = row * n + i
            w0, w1, w2 = _vector(rates, at)
            wheels, wheels_end = _vector(start, i), _vector(end, i)
            # H = A omega + K; no rotation yet
            h0 = wheels[0] + inertias[a] * w0 + inertias[a + 1] * w1 + inertias[a + 2] * w2
            h1 = wheels[1] + inertias[a + 3] * w0 + inertias[a + 4] * w1 + inertias[a + 5] * w2
            h2 = wheels[2] + inertias[a + 6] * w0 + inertias[a + 7] * w1 + inertias[a + 8] * w2
            state = (h0, h1, h2, 0.0, 0.0, 0.0, 1.0)
            dt, count = dt_s[motion * n + i], steps[motion * n + i]
            h0, h1, h2, x, y, z, s = _advance(state, dt, count, wheels, wheels_end, inverse)
            size = x * x + y * y + z * z + s * s
            finite = np.isfinite(h0) and np.isfinite(h1) and np.isfinite(h2) and np.isfinite(size)
            if not (finite and size > 0.0):
                h0, h1, h2, x, y, z, s = LOST, LOST, LOST, 0.0, 0.0, 0.0, 1.0
            w0, w1, w2 = _rate(h0, h1, h2, wheels_end, inverse)
            rates[3 * at], rates[3 * at + 1], rates[3 * at + 2] = w0, w1, w2
            _write_matrix(x, y, z, s, attitudes, 9 * at)
