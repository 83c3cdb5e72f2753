"""Draws from the posterior of a lander: importance sampling along the exact ridges of :mod:`sunspin.estimate.lander.ridges`.

All rounds count: the outer laws of a ridge are pooled as one mixture, of which the rounds are the strata (Cornuet et al. 2012). A
motion that several ridges may propose is divided between them, so that copies of a motion do not count twice.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.special import logsumexp

from sunspin.estimate.budget import Budget
from sunspin.estimate.lander.motions import Draws, LanderMotions, ModelFit
from sunspin.estimate.lander.ridges import (
    Ridge,
    fit_ridge_curve,
    propose,
    ridges_of,
    trace_ridge,
)
from sunspin.estimate.lander.target import LanderTarget
from sunspin.estimate.settings import SAMPLING, SamplingSettings
from sunspin.solve.weights import effective_draws, pareto_tail


def sample(
    target: LanderTarget,
    fit: ModelFit,
    rng: np.random.Generator,
    s: SamplingSettings = SAMPLING,
    budget: Budget | None = None,
) -> Draws:
    """Return weighted draws from the posterior about the fitted motions, their regions numbered by falling probability.

    No round begins once the budget is spent; without one there is no limit.
    """
    budget = Budget(np.inf) if budget is None else budget
    ridges = ridges_of(target, fit, s)
    # Find the course of each ridge, that of improbable ones by fewer points.
    promise = np.array([ridge.log_promise for ridge in ridges])
    points = np.where(promise < promise.max() + np.log(s.small), s.trace_small, s.trace)
    for ridge, count in zip(ridges, points, strict=True):
        trace_ridge(target, ridge, int(count), rng, s)
    budget.spend(float(points.sum()) * len(s.trace_widths) * s.cold_runs)
    # Draw in rounds until all draws together are good enough. After each round the proposals of the ridges adapt to their draws.
    # `log_shares`: for each ridge the log probabilities of its draws so far
    draws, log_shares, rounds = None, [], []
    for number in range(s.rounds):
        counts = _draws_of_ridges(ridges, log_shares, s)
        for ridge, count in zip(ridges, counts, strict=True):
            if count:
                propose(target, ridge, count, rng, s)
        budget.spend(float(counts.sum()) * s.warm_runs)
        draws, log_shares = pooled(ridges, s)
        rounds.append((draws.evidence, draws.effective / len(draws), draws.tail))
        good = draws.effective >= s.wanted and draws.tail < s.good_tail
        # never after the first round alone, whose proposals have not adapted to any draws yet
        if budget.exhausted() or (number and good) or number + 1 == s.rounds:
            break
        for ridge, own in zip(ridges, log_shares, strict=True):
            learn(ridge, own, s)
    assert draws is not None
    return replace(draws, rounds=np.array(rounds))


def _draws_of_ridges(
    ridges: list[Ridge], log_shares: list[np.ndarray], s: SamplingSettings
) -> np.ndarray:
    """Return how many draws each ridge gets, in proportion to the root of its probability.

    In the first round the probability is that of Laplace's method, later that of its draws (`log_shares`).
    """
    if not log_shares:
        promise = np.array([ridge.log_promise for ridge in ridges])
        root = np.sqrt(np.exp(np.maximum(promise - promise.max(), np.log(s.small))))
    else:
        share = np.array([np.exp(logsumexp(own)) if len(own) else 0.0 for own in log_shares])
        root = np.where(share < s.least, 0.0, np.sqrt(share / max(share.sum(), 1e-300)))
        root = root if root.any() else np.ones(len(ridges))
    return np.ceil(s.draws * root / root.sum()).astype(int)


def pooled(ridges: list[Ridge], s: SamplingSettings) -> tuple[Draws, list[np.ndarray]]:
    """Return the draws of all ridges and rounds, and the log probabilities of each ridge's own draws.

    If several ridges may propose a motion, the weight of a draw is multiplied by the part of its own ridge in the density of all
    (multiple importance sampling, Veach 1995).
    """
    proposed = [ridge.proposals for ridge in ridges if ridge.proposals is not None]
    drawn = [ridge for ridge in ridges if ridge.proposals is not None]
    motions = LanderMotions.joined([proposals.motions for proposals in proposed])
    ridge_of = np.repeat(np.arange(len(drawn)), [ridge.drawn for ridge in drawn])  # of each draw
    # each ridge has an integral of its own, the mean weight of its draws; the integral of all is the sum of these
    weights = [ridge.log_weights(s.freedom) - np.log(ridge.drawn) for ridge in drawn]
    log_weight = np.concatenate(weights)
    # part of each ridge (r) in the density with which all ridges propose each draw (n)
    log_part = np.zeros((len(ridge_of), 1))
    if len(drawn) > 1:
        log_density = np.stack([ridge.log_density(motions, s.freedom) for ridge in drawn], axis=1)
        log_part = log_density - logsumexp(log_density, axis=1, keepdims=True)
        log_weight = log_weight + log_part[np.arange(len(ridge_of)), ridge_of]
    # as weights whose mean is the integral (:class:`Draws`)
    log_weight = np.where(np.isnan(log_weight), -np.inf, log_weight) + np.log(len(ridge_of))
    total = float(logsumexp(log_weight))
    possible = np.isfinite(total)
    log_share = log_weight - total if possible else np.full_like(log_weight, -np.inf)
    draws = Draws(
        motions=motions,
        log_weight=log_weight,
        of_model=np.zeros(len(ridge_of), dtype=np.int64),
        region=regions(np.exp(log_share), np.exp(log_part), s),
        effective=effective_draws(np.exp(log_share)) if possible else 0.0,
        tail=pareto_tail(log_weight) if possible else np.inf,
        evidence=total - float(np.log(len(ridge_of))) if possible else -np.inf,
    )
    ends = np.cumsum([0, *(ridge.drawn for ridge in ridges)])
    return draws, [log_share[a:b] for a, b in zip(ends[:-1], ends[1:], strict=True)]


def regions(weight: np.ndarray, part: np.ndarray, s: SamplingSettings) -> np.ndarray:
    """Return the region of each draw (n), by falling probability: ridges that share motions are one region.

    `weight` (n): probabilities; `part` (n, r): part of each draw that belongs to each ridge.
    """
    mass = weight @ part
    overlap = (part * weight[:, None]).T @ part
    shared = overlap > s.connected * np.minimum(mass[:, None], mass)
    label = connected_components(shared, directed=False)[1][np.argmax(part, axis=1)]
    _, inverse = np.unique(label, return_inverse=True)
    rank = np.argsort(np.argsort(-np.bincount(inverse, weights=weight), kind="stable"))
    return rank[inverse]


def learn(ridge: Ridge, log_share: np.ndarray, s: SamplingSettings) -> None:
    """Adapt the proposals of a ridge to all its draws so far (population Monte Carlo: Cappe et al. 2008).

    `log_share` (N): log probability of each draw. Adapted are the curve z*(y), the scatter about it, and the outer
    law. A part of the next draws comes from the first law, so that parts of the posterior that no draw has reached may still be.
    """
    proposals = ridge.proposals
    if proposals is None or not np.isfinite(logsumexp(log_share)):
        return
    fit_ridge_curve(ridge, s)
    # One draw may outweigh all others by chance. No weight is larger than one over the root of the number of draws.
    log_weight = log_share - logsumexp(log_share)
    weight = np.exp(np.minimum(log_weight, -np.log(len(log_weight)) / 2))
    weight /= weight.sum()
    off = proposals.z - ridge.best(proposals.y)
    scatter = (weight[:, None] * off).T @ off
    ridge.scatter = scatter + 1e-6 * np.trace(scatter) * np.eye(len(scatter))
    ridge.learnt = ridge.learnt.moved_to(proposals.y, weight, s)
    wide = ridge.first._replace(covariance=2.0 * ridge.first.covariance)
    ridge.proposing = [(s.defence, wide), (1 - s.defence, ridge.learnt)]


class Checked(NamedTuple):
    """Result of a predictive check.

    `p`: share of simulated sets of readings that fit their motion worse than the real ones; `noise_sigmas`: log of the noise over
    the stated one, in sigmas of its prior.
    """

    p: float
    noise_sigmas: float


def predictive_check(
    target: LanderTarget,
    motions: LanderMotions,
    rng: np.random.Generator,
    s: SamplingSettings = SAMPLING,
) -> Checked:
    """Return how often readings simulated from these motions, draws of equal weight, fit worse than the real ones."""
    motions = motions.take(slice(0, s.checked))
    track = target.track(motions)
    real = target.log_likelihood(track, motions.u)
    worse = [target.log_replicated(track, motions.u, rng) <= real for _ in range(s.copies)]
    noise = target.model.indices("noise")
    return Checked(float(np.mean(worse)), float(motions.u[:, noise].mean()) if noise else 0.0)


def resampled(log_weight: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    """Return the indices (n) of draws of equal weight, in random order, chosen systematically in proportion to the weights."""
    cumulative = np.cumsum(np.exp(log_weight - logsumexp(log_weight)))
    levels = (np.arange(n) + rng.random()) / n * cumulative[-1]
    return rng.permutation(np.minimum(np.searchsorted(cumulative, levels), len(cumulative) - 1))
