"""Starts of :mod:`sunspin.estimate.rates` moved by the equations of motion alone, and fitted so: attitude and rate at one sample.

Between samples close together the smoother's motion is stiff: it creeps, as a step that bends with the turns breaks the motion.
Six unknowns of one sample bend nothing. They find the place from afar; the smoother then lets unknown torques in.
"""

from __future__ import annotations

import numpy as np

from sunspin.estimate.rates.motion import step, step_with_answer
from sunspin.estimate.rates.smooth import followed, free_turn, measured
from sunspin.estimate.rates.state import Motion, Observations, Track
from sunspin.solve.least_squares import least_squares
from sunspin.solve.linear import DenseSystem, solve_dense
from sunspin.solve.rotations import rotate_attitude

CROWD = 4000
"""Starts moved at once, so that their numbers stay in the processor's cache."""


def carried(
    o: Observations, index: int, attitudes: np.ndarray, rates: np.ndarray, motion: Motion
) -> Track:
    """Return the motions that have these attitudes (K, 3, 3) and rates (K, 3) at sample `index`, at all samples of `o`."""
    attitude, omega = np.empty((len(rates), len(o), 3, 3)), np.empty((len(rates), len(o), 3))
    order = np.argsort((rates**2).sum(axis=1), kind="stable")  # slow ones together need few steps
    for part in np.array_split(order, 1 + len(order) // CROWD):
        attitude[part, index], omega[part, index] = attitudes[part], rates[part]
        for start, end in _ways(index, len(o)):
            dt = np.full(len(part), o.t_s[end] - o.t_s[start])
            ends = motion.body.seen(o.wheels(start, end), attitude[part, start], o.t_s[start])
            made, omega[part, end] = step(motion.body, omega[part, start], dt, ends)
            attitude[part, end] = made @ attitude[part, start]
    return Track(attitude, omega)


def shot(o: Observations, index: int, track: Track, motion: Motion, steps: int) -> Track:
    """Attitude and rate at sample `index` of K hypotheses, fitted; returns them with their cost."""
    found = least_squares(
        lambda state: _equations(o, index, state[0], state[1], motion),
        lambda state, step: (
            rotate_attitude(state[0], step[:, :3]),
            followed(state[1] + step[:, 3:], motion),
        ),
        solve_dense,
        (track.attitude[:, index], track.omega[:, index]),
        steps=steps,
    )
    attitude, omega = found.system.extras
    return Track(attitude, omega, found.system.cost)


def _ways(index: int, n: int) -> list[tuple[int, int]]:
    """Steps from sample to sample, away from `index` to both ends."""
    return [(i, i + 1) for i in range(index, n - 1)] + [(i, i - 1) for i in range(index, 0, -1)]


def _equations(
    o: Observations, index: int, attitude: np.ndarray, omega: np.ndarray, motion: Motion
) -> DenseSystem:
    """Those of turn and rate (6) at sample `index`; kept are attitudes and rates at all samples."""
    k, n = len(omega), len(o)
    track = Track(np.empty((k, n, 3, 3)), np.empty((k, n, 3)))
    answer = np.empty((k, n, 6, 6))
    track.attitude[:, index], track.omega[:, index], answer[:, index] = attitude, omega, np.eye(6)
    for start, end in _ways(index, n):
        dt = np.full(k, o.t_s[end] - o.t_s[start])
        ends = motion.body.seen(o.wheels(start, end), track.attitude[:, start], o.t_s[start])
        made, track.omega[:, end], one = step_with_answer(
            motion.body, track.omega[:, start], dt, ends
        )
        track.attitude[:, end] = made @ track.attitude[:, start]
        answer[:, end] = one @ answer[:, start]
    each, slope, cost = measured(o, track)
    turned = np.swapaxes(answer, -1, -2)
    matrix = (turned @ each @ answer).sum(axis=1)
    slope = (turned @ slope[..., None])[..., 0].sum(axis=1)
    matrix[:, :3, :3] += free_turn(o, track.sun_B[:, index])
    matrix[:, 3:, 3:] += np.eye(3) / motion.rate_prior**2
    slope[:, 3:] += omega / motion.rate_prior**2
    total = cost.sum(axis=1) + (omega**2).sum(axis=1) / (2 * motion.rate_prior**2)
    return DenseSystem(total, matrix, slope, extras=(track.attitude, track.omega))
