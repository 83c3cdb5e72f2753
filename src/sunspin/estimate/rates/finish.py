"""From the modes that a search has found to those of a pass with weights and sigmas: common errors, other models, neighbours."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from sunspin.estimate.effort import may_go_on
from sunspin.estimate.rates.alternatives import Others, Trial, alternatives, counted, weighed
from sunspin.estimate.rates.common_errors import (
    LOOSER,
    Clock,
    Common,
    both,
    from_other_bodies,
    with_common,
)
from sunspin.estimate.rates.dense import Dense
from sunspin.estimate.rates.hypotheses import AS_STATED as AS_READ
from sunspin.estimate.rates.hypotheses import Hypothesis
from sunspin.estimate.rates.images import images_of
from sunspin.estimate.rates.link import linked
from sunspin.estimate.rates.noise import settled
from sunspin.estimate.rates.residuals import Fitted, estimates, residuals
from sunspin.estimate.rates.search import (
    distinct,
    distinct_index,
    field_leads,
    guesses,
    out_of_field,
    search,
)
from sunspin.estimate.rates.smooth import cost_limit, smooth
from sunspin.estimate.rates.spread import with_spread
from sunspin.estimate.rates.start import aliases
from sunspin.estimate.rates.state import Motion, Observations, Track, joined
from sunspin.estimate.terms.term import SUN_N
from sunspin.solve.rotations import rotation_between

MAX_MODES = 6
"""Modes reported for each pass."""

TURNS = 6
"""Turns about the Sun that are tried where a torque depends on them."""

LEAST_WEIGHT = 1e-3
"""Modes of less weight are not reported."""

NAMED = 0.05
"""Another model of the motion is named where the one as stated holds less of the weight."""


class Pass(NamedTuple):
    """The modes of one pass, best first, with weights that add to one; `index` are all of its samples, `kept` those that the
    smoother has used, on which `cost` is counted. `mean` (K, 3) is the rate averaged over all samples, with `mean_sigma` (K, 3);
    `residual`: by sensor (K, n), see :func:`sunspin.estimate.rates.residuals.residuals`; `model`: the hypothesis that holds most
    of the weight, and how much of it; `before`: the weights without periods seen from outside, where there are any; `estimates`: of
    each mode what was estimated with it, see :func:`sunspin.estimate.rates.residuals.estimates`."""

    index: np.ndarray
    kept: np.ndarray
    track: Track
    weight: np.ndarray
    mean: np.ndarray
    mean_sigma: np.ndarray
    residual: dict[str, np.ndarray]
    model: tuple[str, float] = (AS_READ, 1.0)
    before: np.ndarray | None = None
    estimates: tuple[dict[str, tuple[str, float, float]], ...] = ()

    def take(self, order: np.ndarray, weight: np.ndarray) -> Pass:
        """The modes `order` with these weights."""
        left = {name: part[order] for name, part in self.residual.items()}
        mean, sigma, before = (
            self.mean[order],
            self.mean_sigma[order],
            None if self.before is None else self.before[order],
        )
        return Pass(
            self.index,
            self.kept,
            self.track.take(order),
            weight,
            mean,
            sigma,
            left,
            self.model,
            before,
            self.estimates and tuple(self.estimates[k] for k in order),
        )


def leading(o: Observations, motion: Motion, rate_max: float) -> Track:
    """The heavier modes of one pass, best first."""
    found = []
    for guess in guesses(o):
        if found and not may_go_on():
            break
        track = search(guess, motion, rate_max)
        track = (
            out_of_field(o, track, motion)
            if field_leads(o)
            else _turned_about_sun(guess, track, motion)
        )
        order, weight = _ranked(track)
        heavy = weight[: max(2 * MAX_MODES, most_modes(o))] > LEAST_WEIGHT**2
        found.append(track.take(order[: max(1, int(np.count_nonzero(heavy)))]))
    return joined(found)


def most_modes(o: Observations) -> int:
    """Modes reported for each pass: two motions with all their images at least."""
    return max(MAX_MODES, 2 * len(images_of(o)))


def _turned_about_sun(o: Observations, track: Track, motion: Motion) -> Track:
    """The modes, tried with several turns about the Sun where torques tell one from the other: the search knows only the Sun."""
    if not motion.body.acting.needs_attitude or not len(track.omega):
        return track
    angles = 2 * np.pi / TURNS * np.arange(TURNS)[:, None] * SUN_N
    tried = [
        Track(track.attitude @ about, track.omega)
        for about in Rotation.from_rotvec(angles).as_matrix()
    ]
    fitted = joined([smooth(o, one, motion, steps=12) for one in tried])
    return distinct(fitted, o.t_s)


def _ranked(track: Track) -> tuple[np.ndarray, np.ndarray]:
    """The hypotheses' order, heaviest first, and their weights in it, that of the first being one."""
    order = np.argsort(-track.log_weight, kind="stable")
    return order, np.exp(track.log_weight[order] - track.log_weight[order[0]])


def loosened(plain: Observations, motion: Motion, clock: Clock | None, rate_max: float) -> Common:
    """Modes found as if strong torques acted, then fitted with the inertia as it may be: where that of the file fits no motion."""
    loose = replace(motion, noise=max(LOOSER[0], motion.noise))
    return with_common(
        plain.freed(), leading(plain, loose, rate_max), motion, clock, begin=loose.noise
    )


def with_aliases(
    o: Observations, fit: Common, motion: Motion, clock: Clock | None, rate_max: float
) -> Common:
    """A fit, and its aliases, which a search that held the inertia fast may have lost: fitted as if strong torques acted, then rung
    by rung, since the fit of a stiff motion ends where it begins."""
    more = aliases(o, fit.take(np.argsort(-fit.track.log_weight, kind="stable")).track, rate_max)
    if not len(more.omega):
        return fit
    return both(
        o, fit, settled(o, more, motion, clock, max(motion.noise, LOOSER[0]), True), motion, clock
    )


def finished(
    every: Observations,
    index: np.ndarray,
    kept: np.ndarray,
    track: Track,
    motion: Motion,
    clock: Clock | None,
    rate_max: float,
    begin: float,
    others: Others | None = None,
) -> Pass:
    """The modes of one pass with their weights (masses of the posterior, by Laplace's method) and sigmas, at the Sun's instants:
    found at the samples `kept` of `index` under an acceleration noise `begin`, carried to all of them; with what else may have
    moved the body counted in, if `others` are to be tried."""
    plain = every.take(kept)
    o = plain.freed()
    fit = settled(o, track, motion, clock, begin)
    if len(motion.body.errors) and fit.track.cost.min() > cost_limit(o):
        other = loosened(plain, motion, clock, rate_max)
        fit = other if other.track.cost.min() < fit.track.cost.min() else fit
    fit = with_aliases(o, fit, motion, clock, rate_max)
    fit = from_other_bodies(o, fit, motion, clock)
    fit = fit.take(
        distinct_index(fit.track, o.t_s)
    )  # with their common errors two hypotheses may have become one
    stated = weighed(
        Hypothesis(AS_READ, every.take(index), np.searchsorted(index, kept), motion, clock), fit
    )
    trials = [stated] if others is None else alternatives(stated, others)
    groups = counted(trials)
    used = sorted({i for group in groups for i, _ in group.members})
    heads = {group.members[0][0] for group in groups}
    each = {i: completed(trials[i], stated.hypothesis, index, kept, i in heads) for i in used}
    modes = [
        mixed([each[i].take(np.array([k]), np.ones(1)) for i, k in group.members], group.weights)
        for group in groups
    ]
    shares = [
        (trials[i].hypothesis.what, float(w))
        for one in groups
        for (i, _), w in zip(one.members, one.weights, strict=True)
    ]
    found = stacked(modes)._replace(
        model=(AS_READ, np.nan) if others is None else likeliest(shares)
    )
    return found.take(np.arange(len(modes)), np.array([group.weights.sum() for group in groups]))


def completed(
    trial: Trial, stated: Hypothesis, index: np.ndarray, kept: np.ndarray, whole_story: bool = True
) -> Pass:
    """A trial's modes with their sigmas, at all samples, with residuals of sensors as good as stated if the `whole_story` is asked
    for."""
    one, fit, o = trial.hypothesis, trial.fit, trial.hypothesis.fitted()
    between = Dense.of(one.o, np.arange(len(one.o)), one.kept, fit.seen, one.motion)
    track, sigma = with_spread(o, one.motion, between.mean_map(), fit, one.clock)
    whole = between.filled(replace(track, attitude=fit.seen.attitude, omega=fit.seen.omega))
    at = Fitted(o, fit.track, fit.error, one.motion, one.clock)
    left = residuals(stated.o.freed(), one.kept, whole, at) if whole_story else {}
    hidden = sum(term.hidden_variance(np.diff(o.t_s)) for term in o.of_motion)
    whole.covariance[..., 3:, 3:] += hidden * np.eye(3)
    whole = replace(whole, log_weight=trial.log_evidence)
    weight = np.exp(trial.log_evidence - trial.best)
    return Pass(
        index,
        kept,
        whole,
        weight,
        whole.omega.mean(axis=1),
        np.sqrt(sigma**2 + hidden / len(o)),
        left,
        estimates=estimates(fit, at),
    )


def mixed(members: list[Pass], weights: np.ndarray) -> Pass:
    """One motion that several hypotheses lead to: as the heaviest has it, with what the others are off counted in its sigmas."""
    head = members[0]
    covariance, variance = np.zeros_like(head.track.covariance), np.zeros_like(head.mean_sigma)
    for one, share in zip(members, weights / weights.sum(), strict=True):
        turned = rotation_between(head.track.attitude, one.track.attitude)
        off = np.concatenate([turned, one.track.omega - head.track.omega], axis=-1)
        covariance += share * (one.track.covariance + off[..., :, None] * off[..., None, :])
        variance += share * (one.mean_sigma**2 + (one.mean - head.mean) ** 2)
    log_weight = np.logaddexp.reduce([one.track.log_weight for one in members])
    track = replace(head.track, covariance=covariance, log_weight=log_weight)
    return head._replace(track=track, mean_sigma=np.sqrt(variance))


def stacked(modes: list[Pass]) -> Pass:
    """All of a pass's modes."""
    first = modes[0]
    left = {name: np.concatenate([one.residual[name] for one in modes]) for name in first.residual}
    weight, mean, sigma = (
        np.concatenate([getattr(one, name) for one in modes])
        for name in ("weight", "mean", "mean_sigma")
    )
    track, told = joined([one.track for one in modes]), [one.estimates for one in modes]
    estimated = tuple(one for part in told for one in part)
    return Pass(first.index, first.kept, track, weight, mean, sigma, left, estimates=estimated)


def likeliest(shares: list[tuple[str, float]]) -> tuple[str, float]:
    """Of what hypotheses say, each with a weight, what is named, and its weight: the model as stated unless that is improbable."""
    total = {AS_READ: 0.0}
    for what, weight in shares:
        total[what] = total.get(what, 0.0) + weight
    return (
        (AS_READ, total[AS_READ])
        if total[AS_READ] > NAMED
        else max(total.items(), key=lambda one: one[1])
    )


def link(o: Observations, found: list[Pass], motion: Motion) -> tuple[list[Pass], float | None]:
    """The passes with weights that count their neighbours in, best mode first, hopeless ones left out; and the walk."""
    middle = [float(o.t_s[p.index].mean()) for p in found]
    means, sigmas = [p.mean for p in found], [p.mean_sigma for p in found]
    weights, walk = linked(middle, means, sigmas, [p.weight for p in found], motion.rate_prior)
    if any(p.before is not None for p in found):
        before = [p.weight if p.before is None else p.before for p in found]
        without, _ = linked(middle, means, sigmas, before, motion.rate_prior)
        found = [p._replace(before=one) for p, one in zip(found, without, strict=True)]
    result = []
    for p, weight in zip(found, weights, strict=True):
        order = np.argsort(-weight, kind="stable")
        keep = order[: max(1, int(np.count_nonzero(weight[order[: most_modes(o)]] > LEAST_WEIGHT)))]
        result.append(p.take(keep, weight[keep]))
    return result, walk
