"""Attitude and momentum of many bodies, each over an interval of its own: the step of :mod:`sunspin.estimation.carry`, compiled.

The equations are those of :mod:`sunspin.dynamics.gyrostat` for a body without torques whose wheels are given by their momentum K
(docs/model.md):

    omega = A^-1 (H - K)        dH/dt = H x omega        dq/dt = -1/2 (omega, 0) q

The momentum of the wheels is linear in time from one end of the interval to the other, in body axes. Classical Runge-Kutta steps of
fixed length: all runs of a numerical difference must take the same steps, else the difference is that of the errors of integration.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sunspin.dynamics.processor import cached, compiled, digest
from sunspin.solve.linear import symmetric_inverse

Q, SIZE = 3, 7
"""Where the quaternion B_from_N (4, scalar last) begins in a state, after the momentum (3); numbers of a state."""


@compiled
def _write_slope(z, held, inverse, d):
    """Write the derivative of the state `z` into `d` while the wheels hold the momentum `held` (3).

    All of it is computed before any of it is written: what is written might be one of the numbers still to be read.
    """
    h0, h1, h2 = z[0], z[1], z[2]
    a, b, c = h0 - held[0], h1 - held[1], h2 - held[2]
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
    """Take each row of `states` (n, 7), in place, over its dt (n) seconds in its number of steps, `counts` (n)."""
    # the length is a constant of the compiled code, which then holds a state in registers: 0.3 of the time
    y, z, total, d = np.empty(SIZE), np.empty(SIZE), np.empty(SIZE), np.empty(SIZE)
    held = np.empty(3)
    for i in range(len(states)):
        for m in range(SIZE):
            y[m] = states[i, m]
        h = dt[i] / counts[i]
        for k in range(counts[i]):
            for m in range(SIZE):
                z[m] = y[m]
                total[m] = 0.0
            # at the start, twice in the middle, and at the end of the step
            for stage in range(4):
                s = (k + 0.5 * ((stage + 1) // 2)) / counts[i]
                for m in range(3):
                    held[m] = (1.0 - s) * momentum[i, m] + s * momentum_end[i, m]
                _write_slope(z, held, inverse, d)
                weight = 1.0 if stage == 0 or stage == 3 else 2.0
                reach = h if stage == 2 else 0.5 * h
                for m in range(SIZE):
                    total[m] += weight * d[m]
                    z[m] = y[m] + reach * d[m]
            for m in range(SIZE):
                y[m] += h / 6.0 * total[m]
        for m in range(SIZE):
            states[i, m] = y[m]


def _entry(sources: int) -> Any:
    """Return the cached entry point; `sources` is the digest of what it is compiled from (:mod:`sunspin.dynamics.processor`)."""

    @cached("compiling the step of rates, once (some 5 s)")
    def run(states, dt, counts, momentum, momentum_end, inverse):
        _ = sources
        size = len(states) // len(inverse)
        for k in range(len(inverse)):
            rows = slice(k * size, (k + 1) * size)
            _advance(
                states[rows], dt[rows], counts[rows], momentum[rows], momentum_end[rows], inverse[k]
            )

    return run


_run = _entry(digest(__file__))


def carry_bodies(
    states: np.ndarray,
    dt_s: np.ndarray,
    counts: np.ndarray,
    momenta: tuple[np.ndarray, np.ndarray],
    inertia: np.ndarray,
) -> np.ndarray:
    """Return states (b, n, 7) of b bodies, n of each, after `dt_s` (b, n) seconds in `counts` (b, n) steps.

    A state is the momentum in units of mean moment of inertia times rad/s, and the quaternion B_from_N with the scalar last.
    `momenta` (b, n, 3) of the wheels at the start and at the end, and `inertia` (b, 3, 3), in mean moments.
    """
    moved = np.array(states, dtype=np.float64, order="C").reshape(-1, SIZE)
    _run(
        moved,
        _plain(dt_s).ravel(),
        np.require(counts, np.int64, ["C", "W"]).ravel(),
        *(_plain(momentum).reshape(-1, 3) for momentum in momenta),
        _plain(symmetric_inverse(inertia)),
    )
    return moved.reshape(states.shape)


def _plain(values: np.ndarray) -> np.ndarray:
    """Return float64 values in one block that can be written: arrays of another kind would compile the step once more."""
    return np.require(values, np.float64, ["C", "W"])
