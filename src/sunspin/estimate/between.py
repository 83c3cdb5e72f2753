"""Probabilities of solutions by those of neighbouring passes: a rate changes little between passes, which excludes aliases.

This is a hidden Markov chain over the passes, whose states are their solutions. The probability of a transition is a Student
density of the change of the mean rate, or of the size of the angular momentum alone. A body that is no sphere keeps the size
between two passes, but may rotate about another axis of the body. The width of the density comes from the sigmas of both solutions
and from a random walk between the passes. Sums over all sequences of solutions (forward-backward algorithm) give the probability of
each solution. The strength of the walk is the one of a list with the largest evidence. If rates change wildly, none is better than
independent passes, and nothing changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln, logsumexp

from sunspin.estimate.chain import RATE
from sunspin.estimate.model import Body
from sunspin.estimate.observe import middle_sample
from sunspin.estimate.solutions import Solutions
from sunspin.estimate.verdict import DECIDED

WALKS = np.geomspace(1e-6, 1e-3, 13)
"""Strengths of the walk, rad/s^1.5: a rate changes by this times the root of the time between passes. 1e-3: 4 deg/s in an orbit."""

FREEDOM = 4.0
"""Degrees of freedom of Student's law, whose tails allow for large changes: a thruster may have been fired."""

BREAK = 0.01
"""Probability that the rate after a gap says nothing of that before: after a manoeuvre, or if a pass lacks the true solution. One
such pass decided for all: of a spinner at 0.38 deg/s, whose other passes favoured the truth, all were 36 deg/s off."""


KEEPS_AXIS = 0.5
"""Probability, without a break, that the mean rate changes little; else the size of the momentum alone does. A body without an
inertia rotated about y in one pass and about -y in the next: an alias near -y, of 1.5 times the rate, was decided."""

SHAPE = 0.15
"""Relative error of the momentum's size if no inertia is known, by the moments about different axes."""


class MomentumSizes(NamedTuple):
    """Sizes (K) of the angular momentum of the solutions of a pass, over the mean moment of inertia, and their sigmas (K).

    Both are in rad/s.
    """

    size: np.ndarray
    sigma: np.ndarray


def momentum_sizes(solved: Solutions, body: Body) -> MomentumSizes | None:
    """Return the sizes of the momentum at the middle of a pass; None with wheels, whose momentum may have been another before."""
    if solved.obs.momentum.any():
        return None
    middle, track = middle_sample(solved.obs.t_s), solved.track
    size, by_rate, by_inertia = body.momentum_size(
        track.omega[:, middle], track.covariance[:, middle, RATE, RATE], np.zeros(3)
    )
    return MomentumSizes(size, np.hypot(by_rate, SHAPE * size if body.sphere else by_inertia))


def link_passes(
    passes: Sequence[Solutions],
    middle_s: Sequence[float],
    rate_sigma: float,
    sizes: Sequence[MomentumSizes | None],
) -> tuple[list[Solutions], float]:
    """Return the passes with the probabilities of their solutions given all passes, and the strength of the walk (rad/s^1.5).

    If no walk is more probable than independent passes, these stay as they are, and the strength is NaN. `middle_s`: middle of each
    pass, s; `rate_sigma` (rad/s): of each component of the rate before the data; `sizes`: of the momentum in each pass, or None.
    """
    own = [np.log(np.maximum(of_pass.probability, 1e-300)) for of_pass in passes]
    # log evidence relative to that of independent passes, which is 0
    best, best_evidence = None, 0.0
    gaps_s = np.abs(np.diff(middle_s))
    for walk in WALKS:
        transitions = [
            _log_transition(passes[k : k + 2], sizes[k : k + 2], walk**2 * gap_s, rate_sigma)
            for k, gap_s in enumerate(gaps_s)
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
    neighbours: Sequence[Solutions],
    sizes: Sequence[MomentumSizes | None],
    walk: float,
    rate_sigma: float,
) -> np.ndarray:
    """Return the log density (K, L) of the L solutions of a pass given each of the K of the pass before, less that of the prior.

    `neighbours`: the two passes, with the `sizes` of their momenta. The density is Student's law of the three components of the
    mean rate. If the sizes are known it is mixed with that of the change of the size, in which all directions of the rate are
    equally likely; but only if one of the two passes is unique by itself. With evenly spaced samples an alias may have the same
    size in all passes, and their sizes would favour it: two of four passes were decided so. Both are mixed with the prior by
    :data:`BREAK`. `walk`: variance (rad2/s2) that the walk between the passes adds. The prior of a rate is in
    `Solutions.probability`, so it is divided out.
    """
    before, after = neighbours
    variance = before.mean_sigma[:, None] ** 2 + after.mean_sigma[None] ** 2 + walk
    density = _log_student(after.mean[None] - before.mean[:, None], variance)
    first, second = sizes
    is_unique = max(before.probability.max(), after.probability.max()) >= DECIDED
    if first is not None and second is not None and is_unique:
        variance = first.sigma[:, None] ** 2 + second.sigma[None] ** 2 + walk
        change = second.size[None] - first.size[:, None]
        # over a sphere of this size; the variance keeps the density of a body at rest finite
        sphere = np.log(4 * np.pi * (second.size[None] ** 2 + variance))
        of_size = _log_student(change[..., None], variance[..., None]) - sphere
        density = np.logaddexp(np.log(KEEPS_AXIS) + density, np.log1p(-KEEPS_AXIS) + of_size)
    prior = -(after.mean**2).sum(axis=-1) / (2 * rate_sigma**2)
    linked = density - (prior - 1.5 * np.log(2 * np.pi * rate_sigma**2))[None]
    return np.logaddexp(np.log1p(-BREAK) + linked, np.log(BREAK))


def _log_student(change: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return the log of Student's density (...) of d numbers `change` (..., d) with these variances (..., d), uncorrelated."""
    d, square = change.shape[-1], (change**2 / variance).sum(axis=-1)
    norm = gammaln((FREEDOM + d) / 2) - gammaln(FREEDOM / 2) - d / 2 * np.log(np.pi * FREEDOM)
    density = norm - np.log(variance).sum(axis=-1) / 2
    return density - (FREEDOM + d) / 2 * np.log1p(square / FREEDOM)
