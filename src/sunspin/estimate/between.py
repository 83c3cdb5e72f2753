"""Probabilities of solutions by those of neighbouring passes: a rate changes little between passes, which excludes aliases.

This is a hidden Markov chain over the passes, whose states are their solutions. The probability of a transition is a Student
density of the change of the mean rate. Its width comes from the sigmas of both solutions and from a random walk between the passes.
Sums over all sequences of solutions (forward-backward algorithm) give the probability of each solution. The strength of the walk
is the one of a list with the largest evidence. If rates change wildly, none is better than independent passes, and nothing changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import gammaln, logsumexp

from sunspin.estimate.solutions import Solutions

WALKS = np.geomspace(1e-6, 1e-3, 13)
"""Strengths of the walk, rad/s^1.5: a rate changes by this times the root of the time between passes. 1e-3: 4 deg/s in an orbit."""

FREEDOM = 4.0
"""Degrees of freedom of Student's law, whose tails allow for large changes: a thruster may have been fired."""

BREAK = 0.01
"""Probability that the rate after a gap says nothing of that before: after a manoeuvre, or if a pass lacks the true solution. One
such pass decided for all: of a spinner at 0.38 deg/s, whose other passes favoured the truth, all were 36 deg/s off."""


def link_passes(
    passes: Sequence[Solutions], middle_s: Sequence[float], rate_sigma: float
) -> tuple[list[Solutions], float]:
    """Return the passes with the probabilities of their solutions given all passes, and the strength of the walk (rad/s^1.5).

    If no walk is more probable than independent passes, these stay as they are, and the strength is NaN. `middle_s`: middle of each
    pass, s; `rate_sigma` (rad/s): of each component of the rate before the data.
    """
    own = [np.log(np.maximum(of_pass.probability, 1e-300)) for of_pass in passes]
    # log evidence relative to that of independent passes, which is 0
    best, best_evidence = None, 0.0
    gaps_s = np.abs(np.diff(middle_s))
    for walk in WALKS:
        transitions = [
            _log_transition(before, after, walk**2 * gap_s, rate_sigma)
            for before, after, gap_s in zip(passes[:-1], passes[1:], gaps_s, strict=True)
        ]
        # log probability of each solution given its pass and all earlier ones
        forward = [own[0]]
        for transition, own_of_next in zip(transitions, own[1:], strict=True):
            forward.append(own_of_next + logsumexp(forward[-1][:, None] + transition, axis=0))
        evidence = float(logsumexp(forward[-1]))
        if evidence > best_evidence:
            best, best_evidence = (forward, transitions, float(walk)), evidence
    if best is None:
        return list(passes), np.nan
    forward, transitions, chosen = best
    # log probability of all later passes given each solution
    backward = [np.zeros(len(own[-1]))]
    for transition, own_of_next in zip(reversed(transitions), reversed(own[1:]), strict=True):
        backward.insert(0, np.asarray(logsumexp(transition + own_of_next + backward[0], axis=1)))
    linked = []
    for solved, earlier, later in zip(passes, forward, backward, strict=True):
        log = earlier + later
        linked.append(replace(solved, probability=np.exp(log - logsumexp(log))))
    return linked, chosen


def _log_transition(
    before: Solutions, after: Solutions, walk: float, rate_sigma: float
) -> np.ndarray:
    """Return the log density (K, L) of the L solutions of a pass given each of the K of the pass before, less that of the prior.

    The density is Student's law of the three components of the mean rate, mixed with the prior by :data:`BREAK`. `walk`: variance
    (rad2/s2) that the walk between the passes adds. The prior of a rate is in `Solutions.probability`, so it is divided out.
    """
    variance = before.mean_sigma[:, None] ** 2 + after.mean_sigma[None] ** 2 + walk
    square = ((after.mean[None] - before.mean[:, None]) ** 2 / variance).sum(axis=-1)
    # log of Student's density of three numbers with these variances: its norm, then the part that depends on the change
    norm = gammaln((FREEDOM + 3) / 2) - gammaln(FREEDOM / 2) - 1.5 * np.log(np.pi * FREEDOM)
    density = norm - np.log(variance).sum(axis=-1) / 2
    density = density - (FREEDOM + 3) / 2 * np.log1p(square / FREEDOM)
    prior = -(after.mean**2).sum(axis=-1) / (2 * rate_sigma**2)
    linked = density - (prior - 1.5 * np.log(2 * np.pi * rate_sigma**2))[None]
    return np.logaddexp(np.log1p(-BREAK) + linked, np.log(BREAK))
