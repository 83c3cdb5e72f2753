"""Attitude and rate of many bodies, each over its own interval: the compiled part of :func:`sunspin.estimate.carry.step`.

The equations are those of :mod:`sunspin.dynamics.gyrostat` for a body without torques, with the momentum K of its wheels given
(docs/model.md). q is the attitude B_from_N, a quaternion:

    omega = A^-1 (H - K)        dH/dt = H x omega        dq/dt = -1/2 (omega, 0) q

All wheels count as held, so that A is the inertia with locked wheels. Friction enters through K alone: the caller computes how the
wheels run down (`wheel_speeds` in :mod:`sunspin.estimate.observe`). K is linear in time from one end of the interval to the other,
in body axes. The method is that of Runge and Kutta, of fourth order, with steps of fixed length: derivatives are computed as
differences of runs, and with other steps in each run they would be those of the integration errors. Momenta are in units of mean
moment of inertia times rad/s.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sunspin.dynamics.processor import cached, compiled, digest
from sunspin.solve.linear import symmetric_inverse

Q, SIZE = 3, 7
"""Index at which the quaternion B_from_N (4, scalar last) begins in a state, after the momentum H (3); length of a state."""

LOST = 1e6
"""Momentum of a motion whose numbers overflow, because its steps are too long: its cost must be large, not NaN."""


@compiled
def _write_slope(z, wheels, inverse, d):
    """Write the derivative of the state `z` (7) into `d` (7), for wheels with the momentum `wheels` (3).

    `inverse` (6): A^-1 as xx, xy, xz, yy, yz, zz. All is read before anything is written, as the compiler cannot know that z and d
    do not overlap.
    """
    h0, h1, h2 = z[0], z[1], z[2]
    a, b, c = h0 - wheels[0], h1 - wheels[1], h2 - wheels[2]
    w0 = inverse[0] * a + inverse[1] * b + inverse[2] * c
    w1 = inverse[1] * a + inverse[3] * b + inverse[4] * c
    w2 = inverse[2] * a + inverse[4] * b + inverse[5] * c
    x, y, z_, s = z[Q], z[Q + 1], z[Q + 2], z[Q + 3]
    d[0], d[1], d[2] = h1 * w2 - h2 * w1, h2 * w0 - h0 * w2, h0 * w1 - h1 * w0
    d[Q], d[Q + 1], d[Q + 2], d[Q + 3] = (
        -0.5 * (w0 * s + w1 * z_ - w2 * y),
        -0.5 * (w1 * s + w2 * x - w0 * z_),
        -0.5 * (w2 * s + w0 * y - w1 * x),
        0.5 * (w0 * x + w1 * y + w2 * z_),
    )


@compiled
def _advance(states, dt, counts, momentum, momentum_end, inverse):
    """Propagate each row of `states` (n, 7), in place, over its dt (n) seconds in `counts` (n) steps.

    The momentum of the wheels goes from `momentum` (n, 3) to `momentum_end` (n, 3).
    """
    # SIZE is a constant of the compiled code, which then keeps a state in registers: 0.3 of the time
    y, z, total, d = np.empty(SIZE), np.empty(SIZE), np.empty(SIZE), np.empty(SIZE)
    wheels = np.empty(3)
    for i in range(len(states)):
        for m in range(SIZE):
            y[m] = states[i, m]
        h = dt[i] / counts[i]
        for k in range(counts[i]):
            for m in range(SIZE):
                z[m] = y[m]
                total[m] = 0.0
            # Runge-Kutta: slopes at the start, twice in the middle, and at the end of the step
            for stage in range(4):
                s = (k + 0.5 * ((stage + 1) // 2)) / counts[i]
                for m in range(3):
                    wheels[m] = (1.0 - s) * momentum[i, m] + s * momentum_end[i, m]
                _write_slope(z, wheels, inverse, d)
                weight = 1.0 if stage == 0 or stage == 3 else 2.0
                to_next = h if stage == 2 else 0.5 * h
                for m in range(SIZE):
                    total[m] += weight * d[m]
                    z[m] = y[m] + to_next * d[m]
            for m in range(SIZE):
                y[m] += h / 6.0 * total[m]
        for m in range(SIZE):
            states[i, m] = y[m]


@compiled
def _write_matrix(q, matrix):
    """Write the rotation matrix of a quaternion (4, scalar last, of any length) into `matrix` (3, 3)."""
    x, y, z, s = q[0], q[1], q[2], q[3]
    scale = 2.0 / (x * x + y * y + z * z + s * s)
    matrix[0, 0] = 1.0 - scale * (y * y + z * z)
    matrix[1, 1] = 1.0 - scale * (x * x + z * z)
    matrix[2, 2] = 1.0 - scale * (x * x + y * y)
    matrix[0, 1], matrix[1, 0] = scale * (x * y - s * z), scale * (x * y + s * z)
    matrix[0, 2], matrix[2, 0] = scale * (x * z + s * y), scale * (x * z - s * y)
    matrix[1, 2], matrix[2, 1] = scale * (y * z - s * x), scale * (y * z + s * x)


def _entry(sources: int) -> Any:
    """Return the entry point, whose machine code is stored on disk and compiled again when a source file has changed.

    `sources`: the digest of the files that it is compiled from (:func:`sunspin.dynamics.processor.digest`).
    """

    @cached("compiling the step of rates, once (some 5 s)")
    def run(omega, dt, counts, momentum, momentum_end, inertia, inverse, attitudes):
        """Replace the rates `omega` (r, K, n, 3) by those at the end, and write `attitudes` (r, K, n, 3, 3).

        Arguments as of :func:`carry_bodies`; `inverse` (r, K or 1, 6): A^-1.
        """
        _ = sources  # so the closure holds the digest, which becomes a key of numba's cache
        n = dt.shape[1]
        states, bodies = np.empty((n, SIZE)), inertia.shape[1]
        for r in range(omega.shape[0]):
            for k in range(omega.shape[1]):
                body, inverse_of_body = inertia[r, k % bodies], inverse[r, k % bodies]
                for i in range(n):
                    # H = A omega + K; no rotation yet
                    for m in range(3):
                        states[i, m] = momentum[i, m]
                        for j in range(3):
                            states[i, m] += body[m, j] * omega[r, k, i, j]
                        states[i, Q + m] = 0.0
                    states[i, Q + 3] = 1.0
                _advance(states, dt[k], counts[k], momentum, momentum_end, inverse_of_body)
                for i in range(n):
                    size = 0.0
                    for m in range(Q, SIZE):
                        size += states[i, m] * states[i, m]
                    lost = not (size > 0.0 and np.isfinite(size))
                    for m in range(3):
                        lost = lost or not np.isfinite(states[i, m])
                    if lost:
                        for m in range(3):
                            states[i, m], states[i, Q + m] = LOST, 0.0
                        states[i, Q + 3] = 1.0
                    # omega = A^-1 (H - K)
                    a = states[i, 0] - momentum_end[i, 0]
                    b = states[i, 1] - momentum_end[i, 1]
                    c = states[i, 2] - momentum_end[i, 2]
                    v = inverse_of_body
                    omega[r, k, i, 0] = v[0] * a + v[1] * b + v[2] * c
                    omega[r, k, i, 1] = v[1] * a + v[3] * b + v[4] * c
                    omega[r, k, i, 2] = v[2] * a + v[4] * b + v[5] * c
                    _write_matrix(states[i, Q:], attitudes[r, k, i])

    return run


_run = _entry(digest(__file__))


def carry_bodies(
    inertia: np.ndarray,
    omega: np.ndarray,
    dt_s: np.ndarray,
    counts: np.ndarray,
    momenta: tuple[np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Return attitudes and rates after n intervals, for r runs of K motions; each interval starts with its own rate.

    Attitudes (r, K, n, 3, 3) are rotation matrices from body axes at the start of the interval to those at its end.

    Parameters
    ----------
    inertia : (r, K, 3, 3) or (r, 1, 3, 3)
        In mean moments of inertia, for each motion of each run, or for all motions of a run.
    omega : (r, K, n, 3), rad/s
        Rates at the start of each interval.
    dt_s : (n) or, for each motion, (K, n)
        Length of the intervals, s; may be negative.
    counts : (K, n)
        Number of steps, the same in all runs.
    momenta : two (n, 3)
        Momentum of the wheels at the start and at the end of each interval.
    """
    rates = np.array(omega, dtype=np.float64, order="C")
    attitudes = np.empty((*rates.shape, 3))
    _run(
        rates,
        _plain(np.broadcast_to(dt_s, counts.shape)),
        np.require(counts, np.int64, ["C", "W"]),
        *(_plain(momentum) for momentum in momenta),
        _plain(inertia),
        _plain(symmetric_inverse(inertia)),
        attitudes,
    )
    return attitudes, rates


def load() -> None:
    """Load the compiled step, or compile it. Done before a process is forked, it is not repeated in each child."""
    still, steps = np.zeros((1, 3)), np.ones((1, 1), dtype=np.int64)
    carry_bodies(np.eye(3)[None, None], np.zeros((1, 1, 1, 3)), np.ones(1), steps, (still, still))


def _plain(values: np.ndarray) -> np.ndarray:
    """Return values as a contiguous, writable float64 array: for another kind the step would be compiled once more."""
    flags = values.flags
    if values.dtype == np.float64 and flags.c_contiguous and flags.writeable:
        return values  # the usual case, for which `require` takes six times as long
    return np.require(values, np.float64, ["C", "W"])
