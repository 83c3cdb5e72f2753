"""Attitude and momentum of many bodies, each over an interval of its own: the step of :mod:`sunspin.estimation.carry`, compiled.

The equations are those of :mod:`sunspin.dynamics.gyrostat` for a body whose wheels are given by their momentum K, and with the
torques that act on it (docs/model.md):

    omega = A^-1 (H - K)        dH/dt = H x omega + I (m x b) + torque + 3 n^2 d x (I d)
    dq/dt = -1/2 (omega, 0) q   dd/dt = d x (omega - e)        de/dt = e x omega

The momentum of the wheels and the magnetic field b are linear in time from one end of the interval to the other, in body axes.
Classical Runge-Kutta steps of fixed length: all runs of a numerical difference must take the same steps, else the difference is
that of the errors of integration.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from sunspin.dynamics.processor import cached, compiled, digest
from sunspin.solve.linear import symmetric_inverse

H, Q, D, E = 0, 3, 7, 10
"""Where the parts of a state begin: momentum (3), quaternion B_from_N (4, scalar last), nadir (3), its turning rate (3)."""

WITHOUT_NADIR, WITH_NADIR = 7, 13
"""Lengths of a state."""


class BodyNumbers(NamedTuple):
    """Numbers of the body, in units of its mean moment of inertia where they have one.

    `inertia` (3, 3); `dipole` (3): its cross product with the field is an angular acceleration; `torque_B` (3): constant in body
    axes; `strength`: 3 n^2 of the gravity gradient in 1/s2.
    """

    inertia: np.ndarray
    dipole: np.ndarray
    torque_B: np.ndarray
    strength: float


class Loads(NamedTuple):
    """What acts on each of n bodies at the start and at the end of its interval, (n, 3) each, body axes.

    Momentum of the wheels, and magnetic field; fields of shape (0, 3) where there is none.
    """

    momentum: np.ndarray
    momentum_end: np.ndarray
    field: np.ndarray
    field_end: np.ndarray


def _advance_states_of(size: int) -> Any:
    """Return the compiled steps for states of `size` numbers.

    The size is a constant of the compiled code, which then holds a state in registers: 0.3 of the time. For the same reason all
    of a derivative is computed before any of it is written: what is written might be one of the numbers still to be read.
    """
    with_nadir = size == WITH_NADIR

    @compiled
    def write_slope(z, held, field, body, inverse, d):
        """Write the derivative of the state `z` into `d` while the wheels hold the momentum `held` (3) in the field (3)."""
        inertia, dipole, torque = body.inertia, body.dipole, body.torque_B
        h0, h1, h2 = z[0], z[1], z[2]
        a, b, c = h0 - held[0], h1 - held[1], h2 - held[2]
        w0 = inverse[0] * a + inverse[1] * b + inverse[2] * c
        w1 = inverse[1] * a + inverse[3] * b + inverse[4] * c
        w2 = inverse[2] * a + inverse[4] * b + inverse[5] * c
        # of the dipole in the field: an angular acceleration, hence the inertia
        a = dipole[1] * field[2] - dipole[2] * field[1]
        b = dipole[2] * field[0] - dipole[0] * field[2]
        c = dipole[0] * field[1] - dipole[1] * field[0]
        t0 = torque[0] + inertia[0, 0] * a + inertia[0, 1] * b + inertia[0, 2] * c
        t1 = torque[1] + inertia[1, 0] * a + inertia[1, 1] * b + inertia[1, 2] * c
        t2 = torque[2] + inertia[2, 0] * a + inertia[2, 1] * b + inertia[2, 2] * c
        if with_nadir:
            n0, n1, n2, e0, e1, e2 = z[D], z[D + 1], z[D + 2], z[E], z[E + 1], z[E + 2]
            a = inertia[0, 0] * n0 + inertia[0, 1] * n1 + inertia[0, 2] * n2
            b = inertia[1, 0] * n0 + inertia[1, 1] * n1 + inertia[1, 2] * n2
            c = inertia[2, 0] * n0 + inertia[2, 1] * n1 + inertia[2, 2] * n2
            t0 += body.strength * (n1 * c - n2 * b)
            t1 += body.strength * (n2 * a - n0 * c)
            t2 += body.strength * (n0 * b - n1 * a)
            a, b, c = w0 - e0, w1 - e1, w2 - e2  # the nadir turns in space at the rate e
            d[D], d[D + 1], d[D + 2] = n1 * c - n2 * b, n2 * a - n0 * c, n0 * b - n1 * a
            d[E], d[E + 1], d[E + 2] = e1 * w2 - e2 * w1, e2 * w0 - e0 * w2, e0 * w1 - e1 * w0
        x, y, z_, s = z[Q], z[Q + 1], z[Q + 2], z[Q + 3]
        d[0], d[1], d[2] = (
            t0 + h1 * w2 - h2 * w1,
            t1 + h2 * w0 - h0 * w2,
            t2 + h0 * w1 - h1 * w0,
        )
        d[Q], d[Q + 1], d[Q + 2], d[Q + 3] = (
            -0.5 * (w0 * s + w1 * z_ - w2 * y),
            -0.5 * (w1 * s + w2 * x - w0 * z_),
            -0.5 * (w2 * s + w0 * y - w1 * x),
            0.5 * (w0 * x + w1 * y + w2 * z_),
        )

    @compiled
    def advance(states, dt, counts, loads, body, inverse):
        """Take each row of `states` (n, size), in place, over its dt (n) seconds in its number of steps, `counts` (n)."""
        y, z, total, d = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
        held, field = np.empty(3), np.zeros(3)
        in_field = len(loads.field) > 0
        for i in range(len(states)):
            for m in range(size):
                y[m] = states[i, m]
            h = dt[i] / counts[i]
            for k in range(counts[i]):
                for m in range(size):
                    z[m] = y[m]
                    total[m] = 0.0
                # at the start, twice in the middle, and at the end of the step
                for stage in range(4):
                    s = (k + 0.5 * ((stage + 1) // 2)) / counts[i]
                    for m in range(3):
                        held[m] = (1.0 - s) * loads.momentum[i, m] + s * loads.momentum_end[i, m]
                    if in_field:
                        for m in range(3):
                            field[m] = (1.0 - s) * loads.field[i, m] + s * loads.field_end[i, m]
                    write_slope(z, held, field, body, inverse, d)
                    weight = 1.0 if stage == 0 or stage == 3 else 2.0
                    reach = h if stage == 2 else 0.5 * h
                    for m in range(size):
                        total[m] += weight * d[m]
                        z[m] = y[m] + reach * d[m]
                for m in range(size):
                    y[m] += h / 6.0 * total[m]
            for m in range(size):
                states[i, m] = y[m]

    return advance


_advance = _advance_states_of(WITHOUT_NADIR)
_advance_with_nadir = _advance_states_of(WITH_NADIR)


def _entry(sources: int) -> Any:
    """Return the cached entry point; `sources` is the digest of what it is compiled from (:mod:`sunspin.dynamics.processor`)."""

    @cached("compiling the step of rates, once (some 5 s)")
    def run(states, dt, counts, loads, body, inverse):
        _ = sources
        if states.shape[1] == WITH_NADIR:
            _advance_with_nadir(states, dt, counts, loads, body, inverse)
        else:
            _advance(states, dt, counts, loads, body, inverse)

    return run


_run = _entry(digest(__file__))


def carry(
    states: np.ndarray, dt_s: np.ndarray, counts: np.ndarray, loads: Loads, body: BodyNumbers
) -> np.ndarray:
    """Return states (n, 7 or 13) after `dt_s` (n) seconds, each in its number of steps, `counts` (n) of integers.

    A state is the momentum in units of mean moment of inertia times rad/s, the quaternion B_from_N with the scalar last and, if
    the gravity gradient acts, the nadir in body axes and the rate at which it turns in space (rad/s, body axes).
    """
    moved = np.array(states, dtype=np.float64, order="C")
    _run(
        moved,
        _plain(dt_s),
        np.require(counts, np.int64, ["C", "W"]),
        Loads(*map(_plain, loads)),
        BodyNumbers(*map(_plain, body[:3]), float(body.strength)),
        _plain(symmetric_inverse(body.inertia)),
    )
    return moved


def _entry_of_bodies(sources: int) -> Any:
    """Return the cached entry point for motions of several bodies; `sources` as in `_entry`."""

    @cached("compiling the step of rates for many bodies, once (some 5 s)")
    def run(states, dt, counts, momentum, momentum_end, inertia, inverse, nothing):
        _ = sources
        size = len(states) // len(inertia)
        for k in range(len(inertia)):
            rows = slice(k * size, (k + 1) * size)
            loads = Loads(momentum[rows], momentum_end[rows], nothing, nothing)
            body = BodyNumbers(inertia[k], np.zeros(3), np.zeros(3), 0.0)
            _advance(states[rows], dt[rows], counts[rows], loads, body, inverse[k])

    return run


_run_bodies = _entry_of_bodies(digest(__file__))


def carry_bodies(
    states: np.ndarray,
    dt_s: np.ndarray,
    counts: np.ndarray,
    momenta: tuple[np.ndarray, np.ndarray],
    inertia: np.ndarray,
) -> np.ndarray:
    """Return states (b, n, 7) of b bodies without torques, n of each, after `dt_s` (b, n) seconds in `counts` (b, n) steps.

    `momenta` (b, n, 3) of the wheels at the start and at the end, and `inertia` (b, 3, 3), in mean moments. A state is as in
    :func:`carry`; a motion is the same as there.
    """
    moved = np.array(states, dtype=np.float64, order="C").reshape(-1, WITHOUT_NADIR)
    _run_bodies(
        moved,
        _plain(dt_s).ravel(),
        np.require(counts, np.int64, ["C", "W"]).ravel(),
        *(_plain(momentum).reshape(-1, 3) for momentum in momenta),
        _plain(inertia),
        _plain(symmetric_inverse(inertia)),
        np.zeros((0, 3)),
    )
    return moved.reshape(states.shape)


def _plain(values: np.ndarray) -> np.ndarray:
    """Return float64 values in one block that can be written: arrays of another kind would compile the step once more."""
    return np.require(values, np.float64, ["C", "W"])
