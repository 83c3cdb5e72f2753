"""Draws from the posterior of a lander: importance sampling along the exact ridges of :mod:`sunspin.estimate.lander.ridges`.

All rounds count: the mixtures of outer coordinates of all rounds are pooled as one mixture, with each round as a stratum (Cornuet
et al. 2012). A motion that several ridges may propose is divided between them, so that copies of a motion do not count twice.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.special import logsumexp

from sunspin.estimate.budget import Budget
from sunspin.estimate.lander.motions import Draws, LanderMotions, ModelFit
from sunspin.estimate.lander.ridges import Ridge, fit_ridge_curve, propose, ridges_of, trace_ridge
from sunspin.estimate.lander.target import LanderTarget
from sunspin.estimate.settings import SAMPLING, SamplingSettings
from sunspin.solve.weights import effective_draws, pareto_tail


def sample(
    target: LanderTarget,
    fit: ModelFit,
    rng: np.random.Generator,
    settings: SamplingSettings = SAMPLING,
    budget: Budget | None = None,
) -> Draws:
    """Return weighted draws from the posterior about the fitted motions.

    No round begins once the budget (in runs of a motion) is spent; without a budget there is no limit.
    """
    budget = Budget(np.inf) if budget is None else budget
    ridges = ridges_of(target, fit, settings)
    # Fit the curve of each ridge, that of improbable ones by fewer points.
    log_mass = np.array([ridge.laplace_log_mass for ridge in ridges])
    improbable = log_mass < log_mass.max() + np.log(settings.small)
    points = np.where(improbable, settings.trace_small, settings.trace)
    for ridge, count in zip(ridges, points, strict=True):
        trace_ridge(target, ridge, int(count), rng)
    budget.spend(float(points.sum()) * len(settings.trace_widths) * settings.cold_runs)
    # Draw in rounds until all draws together are good enough. After each round the proposals of the ridges adapt to their draws.
    # `log_shares`: for each ridge the log probabilities of its draws so far
    draws, log_shares, rounds = None, [], []
    for number in range(settings.rounds):
        counts = _draws_of_ridges(ridges, log_shares, settings)
        for ridge, count in zip(ridges, counts, strict=True):
            if count:
                propose(target, ridge, count, rng)
        budget.spend(float(counts.sum()) * settings.warm_runs)
        draws, log_shares = pooled(ridges, settings.connected)
        rounds.append((draws.log_evidence, draws.effective / len(draws), draws.pareto_k))
        good = draws.effective >= settings.wanted and draws.pareto_k < settings.good_tail
        # good draws never end the sampling after the first round, whose proposals have not adapted to any draws yet
        last = (number and good) or number + 1 == settings.rounds
        if last or budget.exhausted():  # the budget is asked only if its end would cancel a round
            break
        for ridge, own in zip(ridges, log_shares, strict=True):
            adapt(ridge, own)
    assert draws is not None
    return replace(draws, rounds=np.array(rounds))


def _draws_of_ridges(
    ridges: list[Ridge], log_shares: list[np.ndarray], settings: SamplingSettings
) -> np.ndarray:
    """Return how many draws each ridge gets in the next round, in proportion to the root of its probability.

    In the first round the probability of a ridge is that of Laplace's method. Later it is the sum over its draws of their
    probabilities, whose logs are in `log_shares`.
    """
    if not log_shares:
        log_mass = np.array([ridge.laplace_log_mass for ridge in ridges])
        root = np.sqrt(np.exp(np.maximum(log_mass - log_mass.max(), np.log(settings.small))))
    else:
        share = np.array([np.exp(logsumexp(own)) if len(own) else 0.0 for own in log_shares])
        root = np.where(share < settings.least, 0.0, np.sqrt(share / max(share.sum(), 1e-300)))
        # if no draw has any weight, all ridges get as many
        root = root if root.any() else np.ones(len(ridges))
    return np.ceil(settings.draws * root / root.sum()).astype(int)


def pooled(ridges: list[Ridge], connected: float) -> tuple[Draws, list[np.ndarray]]:
    """Return the draws of all ridges and rounds together, and for each ridge the logs of the probabilities of its own draws.

    Where ridges overlap, several of them may propose a motion. So that it counts once, the weight of a draw is multiplied by the
    part of its own ridge in the summed density of all (multiple importance sampling, Veach 1995). `connected`: as in
    :func:`_solutions`.
    """
    # ridges without draws have no proposals yet
    drawn = [ridge for ridge in ridges if ridge.proposals is not None]
    proposed = [ridge.proposals for ridge in ridges if ridge.proposals is not None]
    motions = LanderMotions.joined([proposals.motions for proposals in proposed])
    # index of the ridge that each draw comes from
    ridge_of = np.repeat(np.arange(len(drawn)), [ridge.draw_count for ridge in drawn])
    count = len(ridge_of)
    # Logs of (weight / number of draws of the ridge). Times the parts below, the sum over a ridge is the integral of its part of
    # the posterior, and the sum over all ridges that of the whole.
    weights = [ridge.log_weights() - np.log(ridge.draw_count) for ridge in drawn]
    log_weight = np.concatenate(weights)
    # log of the part (n, r) that each ridge has in the density with which all ridges propose a draw
    log_part = np.zeros((count, 1))
    if len(drawn) > 1:
        log_density = np.stack([ridge.log_density(motions) for ridge in drawn], axis=1)
        log_part = log_density - logsumexp(log_density, axis=1, keepdims=True)
        log_weight = log_weight + log_part[np.arange(count), ridge_of]
    # NaN where no ridge has a density: no weight. Times the number of draws, as the mean weight is the evidence (:class:`Draws`).
    log_weight = np.where(np.isnan(log_weight), -np.inf, log_weight) + np.log(count)
    total = float(logsumexp(log_weight))
    possible = np.isfinite(total)  # some draw has a weight
    log_share = log_weight - total if possible else np.full_like(log_weight, -np.inf)
    draws = Draws(
        motions=motions,
        log_weight=log_weight,
        model_index=np.zeros(count, dtype=np.int64),
        solution=_labels_by_ridges(np.exp(log_share), np.exp(log_part), connected),
        effective=effective_draws(np.exp(log_share)) if possible else 0.0,
        pareto_k=pareto_tail(log_weight) if possible else np.inf,
        log_evidence=total - float(np.log(count)) if possible else -np.inf,
    )
    # the draws of each ridge follow one another; the part of a ridge without draws is empty
    ends = np.cumsum([0, *(ridge.draw_count for ridge in ridges)])
    return draws, [log_share[a:b] for a, b in zip(ends[:-1], ends[1:], strict=True)]


def _labels_by_ridges(share: np.ndarray, part: np.ndarray, connected: float) -> np.ndarray:
    """Return the index (n) of the solution of each draw, by falling probability: ridges that overlap are one solution.

    `share` (n): probabilities of the draws; `part` (n, r): part of each draw that belongs to each ridge. Ridges overlap if they
    share more than the part `connected` of the probability of one of them.
    """
    mass = share @ part  # (r) of each ridge
    overlap = (part * share[:, None]).T @ part  # (r, r) probability that two ridges share
    overlaps = overlap > connected * np.minimum(mass[:, None], mass)
    label = connected_components(overlaps, directed=False)[1][np.argmax(part, axis=1)]
    _, number = np.unique(label, return_inverse=True)
    rank = np.argsort(np.argsort(-np.bincount(number, weights=share), kind="stable"))
    return rank[number]


def adapt(ridge: Ridge, log_share: np.ndarray) -> None:
    """Adapt the proposals of a ridge to all its draws so far (population Monte Carlo: Cappe et al. 2008).

    `log_share` (N): log probability of each draw. Adapted are the curve z*(y), the scatter about it, and the mixture of outer
    coordinates. A part of the next draws comes from the first mixture, so that they may still reach parts of the posterior that no
    draw has reached.
    """
    proposals, settings = ridge.proposals, ridge.settings
    if proposals is None or not np.isfinite(logsumexp(log_share)):
        return
    fit_ridge_curve(ridge)
    # One draw may outweigh all others by chance. No weight is larger than one over the root of the number of draws.
    log_weight = log_share - logsumexp(log_share)
    weight = np.exp(np.minimum(log_weight, -np.log(len(log_weight)) / 2))
    weight /= weight.sum()
    off = proposals.z - ridge.curve(proposals.y)
    scatter = (weight[:, None] * off).T @ off
    ridge.scatter = scatter + 1e-6 * np.trace(scatter) * np.eye(len(scatter))
    ridge.adapted = ridge.adapted.adapted(proposals.y, weight, settings)
    wide = ridge.first._replace(covariance=2.0 * ridge.first.covariance)
    ridge.next_round = [(settings.defence, wide), (1 - settings.defence, ridge.adapted)]


class PredictiveCheck(NamedTuple):
    """Result of a predictive check.

    `p`: share of the simulated sets of readings that fit worse than the real ones; near 0 the real ones fit too badly, near 1 too
    well. `noise_sigmas`: mean over the draws of log(noise / stated noise), in sigmas of its prior; 0 if the noise is no unknown.
    """

    p: float
    noise_sigmas: float


def predictive_check(
    target: LanderTarget,
    motions: LanderMotions,
    rng: np.random.Generator,
    settings: SamplingSettings = SAMPLING,
) -> PredictiveCheck:
    """Return how often simulated readings fit worse than the real ones (posterior predictive check), and the mean noise unknown.

    `motions`: draws of equal weight, of which the first `settings.checked` are used. For each, `settings.copies` sets of readings
    are simulated. A set fits worse if its log likelihood under its motion is at most that of the real readings.
    """
    motions = motions.take(slice(0, settings.checked))
    track = target.track(motions)
    real = target.log_likelihood(track, motions.u)
    # (copies, draws)
    worse = [target.log_replicated(track, motions.u, rng) <= real for _ in range(settings.copies)]
    noise_indices = target.model.indices("noise")
    noise_sigmas = float(motions.u[:, noise_indices].mean()) if noise_indices else 0.0
    return PredictiveCheck(float(np.mean(worse)), noise_sigmas)


def resampled(log_weight: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    """Return the indices (n) of draws of equal weight, chosen from weighted draws by systematic resampling, in random order."""
    cumulative = np.cumsum(np.exp(log_weight - logsumexp(log_weight)))
    levels = (np.arange(n) + rng.random()) / n * cumulative[-1]
    return rng.permutation(np.minimum(np.searchsorted(cumulative, levels), len(cumulative) - 1))
