"""How probable motions are: under every strength of unknown torques, every size of an error, and every model.

The evidence of a motion under a model is the integral of prior density times likelihood around the motion (Laplace's method). If
the strength of unknown torques is not known, it is one of a list of equally likely values; each is called a rung, the list a
ladder. A motion is fitted under all of them, and its probability is the sum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, product

import numpy as np
from scipy.special import log_softmax, logsumexp

from sunspin.estimate.carry import RATE, TURN
from sunspin.estimate.chain import Fit, fit
from sunspin.estimate.copies import distinct
from sunspin.estimate.model import AS_STATED, Model, Track
from sunspin.estimate.settings import LadderSettings, SearchSettings
from sunspin.solve.rotations import rotate_attitude

TORQUES = ("steady_torque", "magnetic_torque")
"""Kinds of unknowns that turn the body far, so that attitudes and rates depend on them linearly only near the fit."""


@dataclass(frozen=True)
class PassFits:
    """All fits of one pass, whose nominal model is `nominal`.

    `fits`: one for each model and strength of unknown torques. `rungs` (r): these strengths, rad/s^1.5; `log_rung` (r): logs of
    their prior probabilities. `used`: motions times samples that were fitted. `cut`: the budget was used up before all was tried.
    """

    nominal: Model
    fits: tuple[Fit, ...]
    rungs: tuple[float, ...]
    log_rung: np.ndarray
    used: float = 0.0
    cut: bool = False

    def rung(self, fitted: Fit) -> int:
        """Return the index in `rungs` of the strength of torques under which a fit was made."""
        return self.rungs.index(fitted.model.noise.acceleration)

    def log_evidence_of_rungs(self) -> np.ndarray:
        """Return the log evidence (r) of each rung, summed over motions and models, without its prior; minus infinity if no fit."""
        total = np.full(len(self.rungs), -np.inf)
        for fitted in self.fits:
            rung = self.rung(fitted)
            total[rung] = np.logaddexp(total[rung], logsumexp(fitted.log_evidence))
        return total

    @property
    def log_evidence(self) -> float:
        """Return the log evidence of the pass, summed over all strengths of torques, models and motions."""
        return float(np.logaddexp.reduce(self.log_evidence_of_rungs() + self.log_rung))


def ladder(
    model: Model,
    motions: Track,
    s: LadderSettings,
    search_settings: SearchSettings,
    first_rung: float,
    rival: float = -np.inf,
) -> list[Fit]:
    """Fit motions of a model under every strength of unknown torques; return one fit for each rung that is reached.

    A rung is one strength, rad/s^1.5. The path up fits `first_rung` and the rungs above it, then the path down fits those below.
    Each fit begins where the one before ended, since a motion hardly moves in a fit under weak torques. A path ends at a hopeless
    rung: the log evidence of its best motion is more than `s.hopeless` below that of the best rung so far. It ends too if it is as
    far below `rival`, the log evidence of another model, and did not rise from the rung before. `search_settings`: which motions
    are copies of each other, and how many are kept.

    If the first rung is hopeless compared with those above, its fit may have stopped short of the minimum. Then the path down
    begins at the highest rung reached, and fits all rungs below it again. Without this an alias was decided in one pass, whose file
    stated products of inertia as zero that were not. The true motion cost 196 on the first rung, 24 on the next, 229 below; the
    alias, fitted downward from strong torques, cost less.
    """
    if not len(motions):
        return []
    first, first_summed = _fit_and_select(
        model.under(first_rung), motions, s.first_steps, s, search_settings
    )
    # fits by rung; if `first_rung` is not in `s.rungs`, its fit is only a beginning for the others
    fits = {first_rung: first_summed} if first_rung in s.rungs and len(first) else {}

    def fit_path(path: Sequence[float], begin: Fit, begin_rung: float) -> tuple[Fit, float]:
        """Fit the rungs of `path` one after the other and add the fits to `fits`; return the last fit and its rung.

        The first fit begins at the motions of `begin`, the fit on `begin_rung`; each other begins where the one before ended. For
        `fits` they are summed over the possible sizes of their prior sigmas (`sum_over_shares`), for the return value they are not.
        """
        last, last_rung = begin, begin_rung
        log_before = float(begin.log_evidence.max(initial=-np.inf))
        for rung in path:
            # Rungs are farther apart than a motion can follow. So strengths between two rungs are fitted too: each differs from the
            # one before by a factor of `cooling` at most. 1e-9: a ratio of exactly `cooling` is one step, however it is rounded.
            steps = max(1, int(np.ceil(abs(np.log(rung / last_rung)) / np.log(s.cooling) - 1e-9)))
            between = np.geomspace(last_rung, rung, steps + 1)[1:-1].tolist()
            for strength in (*between, rung):
                under = model.under(strength)
                motions = last.motions
                # Under weaker torques a minimum may split in two: the best motion is also fitted from both sides of it, if only the
                # Sun is read. Of a pass read by its field alone that found an alias with more evidence than the truth had.
                if rung < last_rung and model.obs.only_sun:
                    motions = Track.joined([motions, _with_other_torques(last)])
                motions = rescale_unknowns(motions, last.model, under)
                # on the way down a rung may have a fit already, from the way up: its motions are fitted again too
                if strength in fits:
                    motions = Track.joined([motions, fits[strength].to_begin_from])
                last, summed = _fit_and_select(under, motions, s.steps, s, search_settings)
            last_rung = rung
            if not len(last):
                break
            fits[rung] = summed
            # A model with a step of the rate needs weaker torques than the nominal one, and rises far on the way there. Without
            # looking whether it rises, the true interval of a step was given up, and its neighbour decided 7 sigma off.
            best = max(float(fitted.log_evidence.max()) for fitted in fits.values())
            log_now = float(summed.log_evidence.max())
            if log_now < best - s.hopeless or log_now < min(log_before, rival - s.hopeless):
                break
            log_before = log_now
        return last, last_rung

    above = [rung for rung in sorted(s.rungs) if rung > first_rung]
    highest, highest_rung = fit_path(above, first, first_rung)
    best = max((float(fitted.log_evidence.max()) for fitted in fits.values()), default=-np.inf)
    first_hopeless = first_summed.log_evidence.max(initial=-np.inf) < best - s.hopeless
    from_top = first_hopeless and len(highest)
    begin, begin_rung = (highest, highest_rung) if from_top else (first, first_rung)
    below = [rung for rung in sorted(s.rungs, reverse=True) if rung < begin_rung]
    fit_path(below, begin, begin_rung)
    return list(fits.values())


def _fit_and_select(
    model: Model, motions: Track, steps: int, s: LadderSettings, search_settings: SearchSettings
) -> tuple[Fit, Fit]:
    """Fit motions and select from them; return the fit, and the same fit summed over the sizes of its sigmas (`sum_over_shares`).

    Copies and hopeless motions are left out of both. The evidence after the sum decides what is hopeless: a motion that needs only
    a small torque is far more probable under a small sigma of it than under the largest one, under which it is fitted.
    """
    fitted = fit(model, motions, steps, s.tolerance)
    # Under weak torques a fit moves little in its steps. A motion whose cost is higher than under the torques before may not have
    # reached its minimum: it is fitted further by steps that obey the equations of motion.
    half_s = float(np.ptp(model.obs.t_s)) / 2
    # in the time T torques of the strength q turn the body by q sqrt(T^3 / 3)
    weak = model.noise.acceleration * np.sqrt(half_s**3 / 3) <= s.stiff_rad
    if weak and len(motions.cost) == len(fitted):
        rises = fitted.motions.cost > motions.cost + s.creeping
        if rises.any():
            begin = fitted.motions.take(np.flatnonzero(rises))
            lower = fit(model, begin, steps, s.tolerance, along_equations=True)
            fitted = _join_fits([fitted.take(np.flatnonzero(~rises)), lower])
    summed = sum_over_shares(fitted, s.beyond_fit)
    which = _distinct_motions(summed, s, search_settings)
    return fitted.take(which), summed.take(which)


def _with_other_torques(fitted: Fit) -> Track:
    """Return the most probable motion of a fit twice, with a torque one sigma more and less; none if the model has no torque.

    They differ along the least certain direction of the torque; the other unknowns and the states follow by their covariance. Under
    strong random torques the cost may have one flat minimum that splits in two under weaker ones. A fit that goes on from there
    ends in either. A torque fixed in space was found 100 degrees off about the Sun, and the rate 6 sigma off.
    """
    torques = [k for k, unknown in enumerate(fitted.model.unknowns) if unknown.kind in TORQUES]
    if not torques or not len(fitted):
        return fitted.motions.take(slice(0))
    best = fitted.take(np.full(2, np.argmax(fitted.log_evidence)))
    covariance = np.nan_to_num(best.u_covariance[0])
    variance, axes = np.linalg.eigh(covariance[np.ix_(torques, torques)])
    # change of all unknowns for one sigma of the torque along the last axis, whose variance is the largest
    change = covariance[:, torques] @ axes[:, -1] / np.sqrt(max(variance[-1], 1e-12))
    return _with_unknowns_changed(best, np.stack([change, -change]))


def _with_unknowns_changed(fitted: Fit, u_change: np.ndarray) -> Track:
    """Return the K motions of a fit with their unknowns changed by `u_change` (K, m), and the states as they follow linearly."""
    motions = fitted.motions
    state_change = np.einsum("knim,km->kni", fitted.states_by_u, u_change)
    return replace(
        motions,
        attitude=rotate_attitude(motions.attitude, state_change[..., TURN]),
        omega=motions.omega + state_change[..., RATE],
        u=motions.u + u_change,
    )


def rescale_unknowns(motions: Track, before: Model, after: Model) -> Track:
    """Return motions with the unknowns of the model `after`, in its sigmas; the motions have those of the model `before`.

    An unknown that only `before` has is left out; one that only `after` has begins at its centre.
    """
    index_before = {unknown.name: k for k, unknown in enumerate(before.unknowns)}
    u = np.zeros((len(motions), len(after.unknowns)))
    for k, unknown in enumerate(after.unknowns):
        # motions may lack the last unknowns of their model
        index = index_before.get(unknown.name, motions.u.shape[1])
        if index < motions.u.shape[1]:
            sigma = before.unknowns[index].sigma
            ratio = sigma / unknown.sigma if unknown.sigma > 0 else sigma
            u[:, k] = motions.u[:, index] * ratio
    return replace(motions, u=u)


def _distinct_motions(
    fitted: Fit, s: LadderSettings, search_settings: SearchSettings
) -> np.ndarray:
    """Return the indices of a fit's motions without copies and hopeless ones, the most probable first."""
    t_s, order_by = fitted.model.obs.t_s, -fitted.log_evidence
    return distinct(fitted.motions, t_s, search_settings, drop=s.hopeless, order_by=order_by)


def sum_over_shares(fitted: Fit, beyond_fit: float) -> Fit:
    """Return a fit (K motions) summed over the possible sizes of its prior sigmas: evidence, means and covariances of the mixture.

    The prior sigma of a quantity of unknown size, as of a torque, is the largest one times one of several equally likely factors,
    its shares (:class:`Unknown`). The fit is made under the largest sigmas. For the others its evidence and its Gaussian change by
    formulas (:func:`_posterior_under_shares`, also for `beyond_fit`); all other unknowns and the states follow by their covariance.
    """
    # indices of the unknowns whose sigma has several sizes, by their kind: all of a kind have the same size
    groups: dict[str, list[int]] = {}
    for i, unknown in enumerate(fitted.model.unknowns):
        if len(unknown.shares) > 1:
            groups.setdefault(unknown.kind, []).append(i)
    if not groups or not len(fitted):
        return fitted
    shared = np.concatenate([*groups.values()])  # (g) all these indices
    u = fitted.motions.u[:, shared]
    of_shared = np.nan_to_num(fitted.u_covariance[:, shared[:, None], shared])
    # a fit that did not end in a minimum has no valid covariance: it stays under the largest sigmas
    valid = np.linalg.eigvalsh(of_shared)[:, 0] > 0
    of_shared = np.where(valid[:, None, None], of_shared, np.eye(len(shared)))
    precision = np.linalg.pinv(of_shared, hermitian=True)
    gain, mean, covariance = _posterior_under_shares(fitted, groups, precision, valid, beyond_fit)

    # mean and covariance of the mixture over the c combinations of shares
    weight = np.exp(gain - logsumexp(gain, axis=0))
    centre = np.einsum("ck,ckg->kg", weight, mean)
    off = mean - centre
    spread = np.einsum("ck,ckij->kij", weight, covariance + off[..., :, None] * off[..., None, :])
    # Regression on the shared unknowns: if their mean changes by d and their covariance by D, those of all unknowns change by B d
    # and B D B^T, with B = (covariance of all with the shared) (that of the shared)^-1; the states by `states_by_u` times that.
    by_shared = fitted.u_covariance[:, :, shared] @ precision
    u_change = valid[:, None] * (by_shared @ (centre - u)[..., None])[..., 0]
    widening = valid[:, None, None] * by_shared @ (spread - of_shared)
    widening = widening @ np.swapaxes(by_shared, -1, -2)
    state_widening = (
        fitted.states_by_u @ widening[:, None] @ np.swapaxes(fitted.states_by_u, -1, -2)
    )
    covariance_of_states = fitted.motions.covariance + state_widening
    motions = replace(_with_unknowns_changed(fitted, u_change), covariance=covariance_of_states)
    return replace(
        fitted,
        motions=motions,
        log_evidence=fitted.log_evidence + logsumexp(gain, axis=0) - np.log(len(gain)),
        u_covariance=fitted.u_covariance + widening,
        lowest=fitted.motions,
    )


def _posterior_under_shares(
    fitted: Fit,
    groups: dict[str, list[int]],
    precision: np.ndarray,
    valid: np.ndarray,
    beyond_fit: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute how a fit of K motions changes if the prior sigmas of g unknowns have another of their possible sizes.

    Return the change of the log evidence (c, K), and mean (c, K, g) and covariance (c, K, g, g) of these unknowns, for each of c
    combinations of shares: a share is a sigma as part of the largest one. `groups`: indices of the unknowns by kind, as all of a
    kind have the same share. `precision` (K, g, g): inverse of their covariance in the fit, which has the largest sigmas. Motions
    that are not `valid` (K) have no covariance and count only with these.

    The unknowns u have the mean m and the precision P. If the readings depend on them linearly, a prior with the share f of a sigma
    adds d = 1/f^2 - 1 to the precision of each: P' = P + d, and P' m' = P m. The log evidence changes by (m' P' m' - m P m + log
    det P - log det P') / 2, less log f for each unknown, as its prior is normalised. Torques turn the body far, and the
    readings are linear only near the fit. So a share of a kind in :data:`TORQUES` has no probability if it exceeds `beyond_fit`
    times the fitted size: the largest |u| of the kind, but at least the smallest share.
    """
    shared = np.concatenate([*groups.values()])
    of_kind = {kind: np.flatnonzero(np.isin(shared, group)) for kind, group in groups.items()}
    u = fitted.motions.u[:, shared]
    slope = (precision @ u[..., None])[..., 0]  # P m
    before = np.linalg.slogdet(precision)[1] - np.einsum("kg,kg->k", slope, u)  # log det P - m P m
    gains, means, covariances = [], [], []  # of each combination
    for shares in product(*(fitted.model.unknowns[group[0]].shares for group in groups.values())):
        added, log_size, allowed = np.zeros(len(shared)), 0.0, np.ones(len(fitted), dtype=bool)
        for share, (kind, group) in zip(shares, groups.items(), strict=True):
            added[of_kind[kind]] = 1 / share**2 - 1
            log_size += len(group) * np.log(share)
            if kind in TORQUES:
                size = np.abs(u[:, of_kind[kind]]).max(axis=1)
                least = min(fitted.model.unknowns[group[0]].shares)
                allowed &= share <= beyond_fit * np.maximum(size, least)
        matrix = precision + np.diag(added)  # P'
        covariance = np.linalg.inv(matrix)
        mean = (covariance @ slope[..., None])[..., 0]  # m'
        after = np.linalg.slogdet(matrix)[1] - np.einsum("kg,kg->k", slope, mean)
        gain = np.where(allowed, (before - after) / 2 - log_size, -np.inf)
        # without a covariance only the largest sigmas count
        gains.append(np.where(valid, gain, 0.0 if set(shares) == {1.0} else -np.inf))
        means.append(mean)
        covariances.append(covariance)
    return np.array(gains), np.array(means), np.array(covariances)


def share_noise(passes: Sequence[PassFits], s: LadderSettings) -> list[PassFits]:
    """Return the passes with a prior of the strength of torques that comes in part from the other passes of the file.

    Mostly the same torques act in all passes of a file. So the file is assumed to have one strength, and each pass to have that one
    with the probability `s.common`, else any of the rungs. The rule also limits what one odd pass can say against a rung.
    """
    log_evidence = np.array([pass_fits.log_evidence_of_rungs() for pass_fits in passes])
    log_even = np.full(log_evidence.shape[1], -np.log(log_evidence.shape[1]))
    log_common, log_any = np.log(s.common), np.log1p(-s.common)
    # log evidence of each pass (row) if the file has each strength (column)
    log_mean = logsumexp(log_evidence + log_even, axis=1, keepdims=True)
    given_file = np.logaddexp(log_common + log_evidence, log_any + log_mean)
    # of the file's strength, by all passes but one: sums of logs; then the prior of that one pass
    by_others = given_file.sum(axis=0) - given_file
    log_prior = np.logaddexp(log_common + log_softmax(by_others, axis=1), log_any + log_even)
    return [replace(fits, log_rung=row) for fits, row in zip(passes, log_prior, strict=True)]


def best_motions(fits: Sequence[Fit], count: int, search_settings: SearchSettings) -> Track:
    """Return the `count` most probable motions of the nominal model under any strength of torques, without copies.

    Other fits begin from them. None is left out as improbable. The result is empty if the nominal model has no fit.
    """
    nominal_fits = [fitted for fitted in fits if fitted.model.what == AS_STATED and len(fitted)]
    if not nominal_fits:
        # no motion, at no samples
        none = Track.unfitted(np.zeros((0, 0, 3, 3)), np.zeros((0, 0, 3)))
        return fits[0].motions.take(slice(0)) if fits else none
    motions = Track.joined([fitted.to_begin_from for fitted in nominal_fits])
    log_evidence = np.concatenate([fitted.log_evidence for fitted in nominal_fits])
    t_s = nominal_fits[0].model.obs.t_s
    which = distinct(motions, t_s, search_settings, count, drop=np.inf, order_by=-log_evidence)
    return motions.take(which)


def best_fit(fits: Sequence[Fit]) -> Fit:
    """Return the most probable motion of all fits, as a fit of it alone (K = 1); all strengths of torques are equally likely."""
    with_motions = (fitted for fitted in fits if len(fitted))
    best = max(with_motions, key=lambda fitted: float(fitted.log_evidence.max()))
    return best.take(np.array([np.argmax(best.log_evidence)]))


def best_nominal_fit(fits: Sequence[Fit]) -> Fit:
    """Return the most probable motion of the nominal model, under any strength of torques, as a fit of it alone (K = 1)."""
    return best_fit([fitted for fitted in fits if fitted.model.what == AS_STATED])


def best_cost(fits: Sequence[Fit]) -> float:
    """Return the cost of the most probable motion of all fits; infinity if there is none.

    It is not the least cost: under the strongest torques nearly every motion costs little, and is improbable.
    """
    motions = (zip(fitted.log_evidence, fitted.motions.cost, strict=True) for fitted in fits)
    _, cost = max(chain.from_iterable(motions), default=(0.0, np.inf))
    return float(cost)


def merge_fits(
    fits: Sequence[Fit], s: LadderSettings, search_settings: SearchSettings
) -> list[Fit]:
    """Return one fit for each model and strength of torques; a motion that several fits contain is counted once."""
    groups: dict[tuple[str, float], list[Fit]] = {}  # by the model's name and the strength
    for fitted in fits:
        groups.setdefault((fitted.model.what, fitted.model.noise.acceleration), []).append(fitted)
    joined = [_join_fits(group) for group in groups.values()]
    return [fitted.take(_distinct_motions(fitted, s, search_settings)) for fitted in joined]


def _join_fits(fits: list[Fit]) -> Fit:
    """Return the motions of several fits of one model as one fit."""
    return Fit(
        model=fits[0].model,
        motions=Track.joined([fitted.motions for fitted in fits]),
        log_evidence=np.concatenate([fitted.log_evidence for fitted in fits]),
        u_covariance=np.concatenate([fitted.u_covariance for fitted in fits]),
        states_by_u=np.concatenate([fitted.states_by_u for fitted in fits]),
        lowest=Track.joined([fitted.to_begin_from for fitted in fits]),
    )
