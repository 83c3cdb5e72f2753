"""Neighbouring passes of :mod:`sunspin.estimate.rates` help to tell aliases apart: between two passes a rate changes only so much.

A chain over the passes, its states their modes: the chance of a step is a Student density of the change of the mean rate, its
width from the modes' own sigmas and a random walk between the passes. How fast that walk is, is taken from the data (largest
evidence); where rates change wildly it comes out fast, and the passes are left as they are. Only weights change, no rate does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.special import gammaln, logsumexp

WALKS = np.geomspace(1e-6, 1e-3, 13)
"""rad/s^1.5; the mean rate changes by this times the root of the time between two passes. 1e-3 is 4 deg/s in an orbit."""

FREEDOM = 4.0
"""Degrees of freedom of the Student law: somebody may have fired a thruster."""


def linked(
    times_s: Sequence[float],
    rates: Sequence[np.ndarray],
    sigmas: Sequence[np.ndarray],
    weights: Sequence[np.ndarray],
    prior: float,
) -> tuple[list[np.ndarray], float | None]:
    """Weights of each pass's modes with the neighbours counted in, and the random walk (rad/s^1.5; None: passes not linked).

    Parameters
    ----------
    times_s : (n_pass,)
        Middle of each pass.
    rates, sigmas : n_pass arrays (K, 3) rad/s
        Mean rate of each mode, and its sigma.
    weights : n_pass arrays (K)
        That add to one in each pass.
    prior : float
        Sigma (rad/s) of the rate before anything was measured, with which the weights were made.
    """
    alone = [np.log(np.maximum(weight, 1e-300)) for weight in weights]
    best: tuple[list[np.ndarray], list[np.ndarray], float] | None = None
    evidence = 0.0  # of passes that do not know of each other
    for walk in WALKS:
        steps = [
            _step(
                rates[k],
                sigmas[k],
                rates[k + 1],
                sigmas[k + 1],
                walk**2 * abs(times_s[k + 1] - times_s[k]),
                prior,
            )
            for k in range(len(rates) - 1)
        ]
        forward = [alone[0]]
        for step, own in zip(steps, alone[1:], strict=True):
            forward.append(own + _log_sum(forward[-1][:, None] + step, axis=0))
        total = float(_log_sum(forward[-1]))
        if total > evidence:
            evidence, best = total, (forward, steps, float(walk))
    if best is None:
        return [np.asarray(weight) for weight in weights], None
    forward, steps, chosen = best
    backward = [np.zeros(len(alone[-1]))]
    for step, own in zip(reversed(steps), reversed(alone[1:]), strict=True):
        backward.insert(0, _log_sum(step + (own + backward[0])[None], axis=1))
    both = [f + b for f, b in zip(forward, backward, strict=True)]
    return [np.exp(log - _log_sum(log)) for log in both], chosen


def _log_sum(log: np.ndarray, axis: int | None = None) -> np.ndarray:
    found: Any = logsumexp(
        log, axis=axis
    )  # SciPy declares the sign, which it gives on request, as well
    return found


def _step(
    rate: np.ndarray,
    sigma: np.ndarray,
    next_rate: np.ndarray,
    next_sigma: np.ndarray,
    walk: float,
    prior: float,
) -> np.ndarray:
    """Log density (K, L) of the modes of the next pass given those of this, over that of the prior alone."""
    variance = sigma[:, None] ** 2 + next_sigma[None] ** 2 + walk
    square = ((next_rate[None] - rate[:, None]) ** 2 / variance).sum(axis=-1)
    size = (
        gammaln((FREEDOM + 3) / 2)
        - gammaln(FREEDOM / 2)
        - 1.5 * np.log(np.pi * FREEDOM)
        - np.log(variance).sum(axis=-1) / 2
    )
    density = size - (FREEDOM + 3) / 2 * np.log1p(square / FREEDOM)
    flat = -(next_rate**2).sum(axis=-1) / (2 * prior**2) - 1.5 * np.log(2 * np.pi * prior**2)
    return density - flat[None]
