"""Neighbouring passes tell aliases apart: from one to the next a rate changes only so much. Probabilities change, no rate does.

A chain over the passes, its states their solutions: the chance of a step is a Student density of the change of the mean rate, its
width from the solutions' own sigmas and a random walk between the passes. How fast that walk is the data say (largest evidence);
where rates change wildly it comes out fast, and the passes are left as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import gammaln, logsumexp

from sunspin.estimation.solutions import Solutions

WALKS = np.geomspace(1e-6, 1e-3, 13)
"""rad/s^1.5; the mean rate changes by this times the root of the time between two passes. 1e-3 is 4 deg/s in an orbit."""

FREEDOM = 4.0
"""Degrees of freedom of Student's law: somebody may have fired a thruster."""


def link_passes(
    passes: Sequence[Solutions], middle_s: Sequence[float], rate_sigma: float
) -> tuple[list[Solutions], float]:
    """Return the passes with probabilities that count their neighbours in, and the walk (rad/s^1.5), NaN if they are not linked.

    `middle_s`: the middle of each pass; `rate_sigma` (rad/s): of a rate before the data.
    """
    alone = [np.log(np.maximum(one.probability, 1e-300)) for one in passes]
    best, evidence = None, 0.0  # of passes that do not know of each other
    for walk in WALKS:
        steps = [
            _log_step(one, other, walk**2 * abs(middle_s[k + 1] - middle_s[k]), rate_sigma)
            for k, (one, other) in enumerate(zip(passes[:-1], passes[1:], strict=True))
        ]
        forward = [alone[0]]
        for step, own in zip(steps, alone[1:], strict=True):
            forward.append(own + logsumexp(forward[-1][:, None] + step, axis=0))
        total = float(logsumexp(forward[-1]))
        if total > evidence:
            best, evidence = (forward, steps, float(walk)), total
    if best is None:
        return list(passes), np.nan
    forward, steps, chosen = best
    backward = [np.zeros(len(alone[-1]))]
    for step, own in zip(reversed(steps), reversed(alone[1:]), strict=True):
        backward.insert(0, np.asarray(logsumexp(step + own + backward[0], axis=1)))
    linked = []
    for one, on, back in zip(passes, forward, backward, strict=True):
        log = on + back
        linked.append(replace(one, probability=np.exp(log - logsumexp(log))))
    return linked, chosen


def _log_step(one: Solutions, other: Solutions, walk: float, rate_sigma: float) -> np.ndarray:
    """Return the log density (K, L) of the solutions of the next pass given those of this, over that of the prior alone.

    `walk`: variance (rad2/s2) that the walk between the passes adds.
    """
    variance = one.mean_sigma[:, None] ** 2 + other.mean_sigma[None] ** 2 + walk
    square = ((other.mean[None] - one.mean[:, None]) ** 2 / variance).sum(axis=-1)
    size = gammaln((FREEDOM + 3) / 2) - gammaln(FREEDOM / 2) - 1.5 * np.log(np.pi * FREEDOM)
    density = size - np.log(variance).sum(axis=-1) / 2
    density = density - (FREEDOM + 3) / 2 * np.log1p(square / FREEDOM)
    prior = -(other.mean**2).sum(axis=-1) / (2 * rate_sigma**2)
    return density - (prior - 1.5 * np.log(2 * np.pi * rate_sigma**2))[None]
