"""Starts of :mod:`sunspin.estimate.rates` moved by the equations of motion alone, and fitted so: attitude and rate at one sample.

Between samples close together the smoother's motion is stiff: it creeps, as a step that bends with the turns breaks the motion.
Six unknowns of one sample bend nothing. They find the place from afar; the smoother then lets unknown torques in.
"""

from __future__ import annotations

import numpy as np

from sunspin.estimate.rates.motion import step, step_with_answer, turn
from sunspin.estimate.rates.smooth import RATE_LIMIT, TURN_PRIOR, measured, shortened
from sunspin.estimate.rates.start import facing
from sunspin.estimate.rates.state import Motion, Observations, Track

CROWD = 4000
"""Starts moved at once, so that their numbers stay in the processor's cache."""


def carried(o: Observations, index: int, suns: np.ndarray, rates: np.ndarray, motion: Motion) -> Track:
    """Starts (K, 3) and (K, 3) at sample `index` moved to all samples of `o` by the equations of motion."""
    attitude, omega = np.empty((len(rates), len(o), 3, 3)), np.empty((len(rates), len(o), 3))
    order = np.argsort((rates**2).sum(axis=1), kind="stable")  # slow ones together need few steps
    for part in np.array_split(order, 1 + len(order) // CROWD):
        attitude[part, index], omega[part, index] = facing(suns[part]), rates[part]
        for start, end in _ways(index, len(o)):
            dt = np.full(len(part), o.t_s[end] - o.t_s[start])
            ends = motion.body.seen(o.wheels(start, end), attitude[part, start], o.t_s[start])
            made, omega[part, end] = step(motion.body, omega[part, start], dt, ends)
            attitude[part, end] = made @ attitude[part, start]
    return Track(attitude, omega)


def shot(o: Observations, index: int, track: Track, motion: Motion, steps: int) -> Track:
    """Damped Gauss-Newton on attitude and rate at sample `index` of K hypotheses; returns them with their cost."""
    damping = np.full(len(track.omega), 1e-3)
    track, *parts = _equations(o, index, track.attitude[:, index], track.omega[:, index], motion)
    each = np.arange(6)
    for _ in range(steps):
        matrix = parts[0].copy()
        matrix[:, each, each] *= 1 + damping[:, None]
        change = np.linalg.solve(matrix, -parts[1][..., None])[..., 0]
        rate = shortened(track.omega[:, index] + change[:, 3:], RATE_LIMIT * motion.rate_prior)
        trial, *new = _equations(o, index, turn(track.attitude[:, index], change[:, :3]), rate, motion)
        better = new[2] < parts[2]
        done = np.all(better & (parts[2] - new[2] < 1e-2))
        track = Track(np.where(better[:, None, None, None], trial.attitude, track.attitude),
                      np.where(better[:, None, None], trial.omega, track.omega))  # fmt: skip
        parts = [np.where(better.reshape(-1, *(1,) * (a.ndim - 1)), a, b) for a, b in zip(new, parts, strict=True)]
        damping = np.where(better, damping / 10, damping * 10)
        if done:
            break
    return Track(track.attitude, track.omega, parts[2])


def _ways(index: int, n: int) -> list[tuple[int, int]]:
    """Steps from sample to sample, away from `index` to both ends."""
    return [(i, i + 1) for i in range(index, n - 1)] + [(i, i - 1) for i in range(index, 0, -1)]


def _equations(
    o: Observations, index: int, attitude: np.ndarray, omega: np.ndarray, motion: Motion
) -> tuple[Track, np.ndarray, np.ndarray, np.ndarray]:
    """Track, normal matrix (K, 6, 6), gradient (K, 6), cost (K) of states at sample `index`."""
    k, n = len(omega), len(o)
    track = Track(np.empty((k, n, 3, 3)), np.empty((k, n, 3)))
    answer = np.empty((k, n, 6, 6))
    track.attitude[:, index], track.omega[:, index], answer[:, index] = attitude, omega, np.eye(6)
    for start, end in _ways(index, n):
        dt = np.full(k, o.t_s[end] - o.t_s[start])
        ends = motion.body.seen(o.wheels(start, end), track.attitude[:, start], o.t_s[start])
        made, track.omega[:, end], one = step_with_answer(motion.body, track.omega[:, start], dt, ends)
        track.attitude[:, end] = made @ track.attitude[:, start]
        answer[:, end] = one @ answer[:, start]
    each, slope, cost = measured(o, track)
    turned = np.swapaxes(answer, -1, -2)
    matrix = (turned @ each @ answer).sum(axis=1)
    slope = (turned @ slope[..., None])[..., 0].sum(axis=1)
    sun = track.sun_B[:, index]
    matrix[:, :3, :3] += sun[:, :, None] * sun[:, None, :] / TURN_PRIOR**2
    matrix[:, 3:, 3:] += np.eye(3) / motion.rate_prior**2
    slope[:, 3:] += omega / motion.rate_prior**2
    return track, matrix, slope, cost.sum(axis=1) + (omega**2).sum(axis=1) / (2 * motion.rate_prior**2)
