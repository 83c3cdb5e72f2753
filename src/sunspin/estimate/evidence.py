"""How probable motions are: under every strength of unknown torques, every size of an error, and every model.

The probability of a model, and of a motion under it, is the integral of the posterior density around its minimum (Laplace's
method). A strength that is not known is a list of equally likely values. All of them stay in the sum: evidence chooses.
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
"""Kinds of unknowns that turn the body far, so that the states follow them linearly only near the fit."""


@dataclass(frozen=True)
class PassFits:
    """All fits of one pass, whose nominal model is `nominal`.

    `fits`: one for each model and strength of torques; `rungs` (r): these strengths in rad/s^1.5, with the logs of their prior
    probabilities `log_rung` (r). `used`: motions times samples that were fitted; `cut`: something was left out as the computing
    budget was used up.
    """

    nominal: Model
    fits: tuple[Fit, ...]
    rungs: tuple[float, ...]
    log_rung: np.ndarray
    used: float = 0.0
    cut: bool = False

    def rung(self, fitted: Fit) -> int:
        """Return the number of the rung, the strength of torques, under which a fit was made."""
        return self.rungs.index(fitted.model.noise.acceleration)

    def log_evidence_of_rungs(self) -> np.ndarray:
        """Return the log evidence (r) of each rung, motions and models summed, before its prior; minus infinity without a fit."""
        total = np.full(len(self.rungs), -np.inf)
        for fitted in self.fits:
            rung = self.rung(fitted)
            total[rung] = np.logaddexp(total[rung], logsumexp(fitted.log_evidence))
        return total


def ladder(
    model: Model,
    motions: Track,
    s: LadderSettings,
    search_settings: SearchSettings,
    first_rung: float,
    rival: float = -np.inf,
) -> list[Fit]:
    """Return fits of a model under every strength of unknown torques, one for each rung that is reached.

    A rung is one strength, in rad/s^1.5. First come the rungs from `first_rung` up, then those below it, downward. Each fit begins
    where the one before ended, since a motion hardly moves under weak torques. A path ends with a rung that is hopeless compared
    with the best one, or with another model whose log evidence is `rival`. `search_settings`: what a copy of a motion is, and how
    many motions are kept.

    If a rung above makes the first one hopeless, the fit on the first may have ended on its way to a minimum. The path down then
    begins at the highest rung reached, and fits all rungs below it again. Without this a wrong motion was decided. The true one, of
    a body with products of inertia that its file stated as zero, cost 196 on the first rung, 24 on the next, and 229 below the
    first; its alias had come down from strong torques, and cost less.
    """
    if not len(motions):
        return []
    first, first_summed = _fit_and_select(
        model.under(first_rung), motions, s.first_steps, s, search_settings
    )
    # the first strength need not be a rung: then its fit is only a beginning
    fits = {first_rung: first_summed} if first_rung in s.rungs and len(first) else {}

    def follow(path: Sequence[float], last: Fit, last_rung: float) -> tuple[Fit, float]:
        """Fit the rungs of `path` one after the other and add the fits to `fits`; return the last fit and its rung.

        The first begins at the motions of the fit `last`, on the rung `last_rung`. The next fit begins where the one before ended.
        What is added to `fits` is `summed`: the same fit with its evidence summed over all sizes that its unknowns may have.
        """
        for rung in path:
            # in steps of a factor `cooling` at most: stiffened more at once, a motion would stay where it is
            steps = max(1, int(np.ceil(abs(np.log(rung / last_rung)) / np.log(s.cooling) - 1e-9)))
            for level in (*np.geomspace(last_rung, rung, steps + 1)[1:-1].tolist(), rung):
                under = model.under(level)
                begin = rescale_unknowns(last.motions, last.model, under)
                # on the way down a rung may have a fit already, from the way up: its motions are fitted again too
                if level in fits:
                    begin = Track.joined([begin, fits[level].to_begin_from])
                last, summed = _fit_and_select(under, begin, s.steps, s, search_settings)
            last_rung = rung
            if not len(last):
                break
            fits[rung] = summed
            best = max(rival, *(float(fitted.log_evidence.max()) for fitted in fits.values()))
            if summed.log_evidence.max() < best - s.hopeless:
                break
        return last, last_rung

    rungs = sorted(s.rungs)
    last, last_rung = follow([rung for rung in rungs if rung > first_rung], first, first_rung)
    best = max((float(fitted.log_evidence.max()) for fitted in fits.values()), default=-np.inf)
    if not len(last) or first_summed.log_evidence.max(initial=-np.inf) >= best - s.hopeless:
        last, last_rung = first, first_rung
    follow([below for below in reversed(rungs) if below < last_rung], last, last_rung)
    return list(fits.values())


def _fit_and_select(
    model: Model, motions: Track, steps: int, s: LadderSettings, search_settings: SearchSettings
) -> tuple[Fit, Fit]:
    """Return the fit of motions without copies and hopeless ones, and it summed over the sizes of its unknowns (`over_shares`).

    The sum decides what is hopeless: a motion that needs only a small torque is far more probable under a small sigma of it than
    under the widest, under which it is fitted.
    """
    fitted = fit(model, motions, steps, s.tolerance)
    # Under weak torques a fit makes hardly any way. A motion whose cost has risen may stand on a slope: it is fitted further by
    # steps that obey the equations of motion.
    span_s = float(np.ptp(model.obs.t_s))
    stiff = model.noise.acceleration * np.sqrt((span_s / 2) ** 3 / 3) <= s.stiff_rad
    if stiff and len(motions.cost) == len(fitted):
        rises = fitted.motions.cost > motions.cost + s.creeping
        if rises.any():
            begin = fitted.motions.take(np.flatnonzero(rises))
            lower = fit(model, begin, steps, s.tolerance, along_equations=True)
            fitted = _join_fits([fitted.take(np.flatnonzero(~rises)), lower])
    shared = over_shares(fitted, s.beyond_fit)
    which = _distinct_motions(shared, s, search_settings)
    return fitted.take(which), shared.take(which)


def rescale_unknowns(motions: Track, before: Model, after: Model) -> Track:
    """Return motions with their unknowns, given in sigmas of the model `before`, in sigmas of the model `after`.

    An unknown that only one of the models has is left out, or begins at its centre.
    """
    index = {unknown.name: k for k, unknown in enumerate(before.unknowns)}
    u = np.zeros((len(motions), len(after.unknowns)))
    for k, now in enumerate(after.unknowns):
        number = index.get(now.name, motions.u.shape[1])
        if number < motions.u.shape[1]:
            was = before.unknowns[number]
            u[:, k] = motions.u[:, number] * (was.sigma / now.sigma if now.sigma > 0 else was.sigma)
    return replace(motions, u=u)


def _distinct_motions(
    fitted: Fit, s: LadderSettings, search_settings: SearchSettings
) -> np.ndarray:
    """Return the indices of a fit's motions without copies and hopeless ones, the most probable first."""
    return distinct(
        fitted.motions,
        fitted.model.obs.t_s,
        search_settings,
        drop=s.hopeless,
        order_by=-fitted.log_evidence,
    )


def over_shares(fitted: Fit, beyond_fit: float) -> Fit:
    """Return a fit with evidence and moments summed over the shares of its unknowns' sigmas.

    The fit is under the widest sigmas. Its unknowns u have the mean m and the precision P. If the readings depend on them linearly,
    a prior with the share c of a sigma adds d = 1/c^2 - 1 to the precision of each: P' = P + d, and P' m' = P m. The log evidence
    changes by (m' P' m' - m P m + log det P - log det P') / 2, less log c for each unknown: the norm of its prior.

    Constant torques turn the body far, and the readings are linear only near the fit: shares that allow `beyond_fit` times more
    than the fitted size get nothing.
    """
    # indices of the unknowns whose sigma has several sizes, by their kind: all of a kind have the same
    groups: dict[str, list[int]] = {}
    for i, unknown in enumerate(fitted.model.unknowns):
        if len(unknown.shares) > 1:
            groups.setdefault(unknown.kind, []).append(i)
    if not groups or not len(fitted):
        return fitted
    # only these unknowns (g) change by themselves; `of_kind`: their indices among the g
    shared = np.concatenate([*groups.values()])
    of_kind = {kind: [list(shared).index(i) for i in group] for kind, group in groups.items()}
    u = fitted.motions.u[:, shared]
    of_shared = np.nan_to_num(fitted.u_covariance[:, shared[:, None], shared])
    # a fit that did not end in a minimum has a covariance that is none: it stays under the widest sigmas
    sound = np.linalg.eigvalsh(of_shared)[:, 0] > 0
    of_shared = np.where(sound[:, None, None], of_shared, np.eye(len(shared)))
    precision = np.linalg.pinv(of_shared, hermitian=True)
    slope = (precision @ u[..., None])[..., 0]
    before = np.linalg.slogdet(precision)[1] - np.einsum("kg,kg->k", slope, u)  # log det P - m P m

    gains, means, covariances = [], [], []  # of each combination of shares (c)
    for shares in product(*(fitted.model.unknowns[group[0]].shares for group in groups.values())):
        added, log_size, allowed = np.zeros(len(shared)), 0.0, np.ones(len(fitted), dtype=bool)
        for share, (kind, group) in zip(shares, groups.items(), strict=True):
            added[of_kind[kind]] = 1 / share**2 - 1
            log_size += len(group) * np.log(share)
            if kind in TORQUES:
                size = np.abs(u[:, of_kind[kind]]).max(axis=1)
                least = min(fitted.model.unknowns[group[0]].shares)
                allowed &= share <= beyond_fit * np.maximum(size, least)
        matrix = precision + np.diag(added)
        covariance = np.linalg.inv(matrix)
        mean = (covariance @ slope[..., None])[..., 0]
        after = np.linalg.slogdet(matrix)[1] - np.einsum("kg,kg->k", slope, mean)  # of P', m'
        gain = np.where(allowed, (before - after) / 2 - log_size, -np.inf)
        gains.append(np.where(sound, gain, 0.0 if set(shares) == {1.0} else -np.inf))
        means.append(mean)
        covariances.append(covariance)
    gain, mean, covariance = np.array(gains), np.array(means), np.array(covariances)

    # mean and covariance of the mixture of all shares
    weight = np.exp(gain - logsumexp(gain, axis=0))
    centre = np.einsum("ck,ckg->kg", weight, mean)
    off = mean - centre
    spread = np.einsum("ck,ckij->kij", weight, covariance + off[..., :, None] * off[..., None, :])
    # all unknowns follow the shared ones by their covariance, and the states follow the unknowns by `fitted.states_by_u`
    by_shared = fitted.u_covariance[:, :, shared] @ precision
    u_change = sound[:, None] * (by_shared @ (centre - u)[..., None])[..., 0]
    widening = sound[:, None, None] * by_shared @ (spread - of_shared)
    widening = widening @ np.swapaxes(by_shared, -1, -2)
    state_change = np.einsum("knim,km->kni", fitted.states_by_u, u_change)
    state_widening = (
        fitted.states_by_u @ widening[:, None] @ np.swapaxes(fitted.states_by_u, -1, -2)
    )
    motions = Track(
        rotate_attitude(fitted.motions.attitude, state_change[..., TURN]),
        fitted.motions.omega + state_change[..., RATE],
        fitted.motions.u + u_change,
        fitted.motions.cost,
        fitted.motions.covariance + state_widening,
    )
    log_evidence = fitted.log_evidence + logsumexp(gain, axis=0) - np.log(len(gain))
    u_covariance = fitted.u_covariance + widening
    return Fit(
        model=fitted.model,
        motions=motions,
        log_evidence=log_evidence,
        u_covariance=u_covariance,
        states_by_u=fitted.states_by_u,
        lowest=fitted.motions,
    )


def share_noise(passes: Sequence[PassFits], s: LadderSettings) -> list[PassFits]:
    """Return the passes with a prior of each rung that comes in part from the other passes of the file.

    The same torques act in all passes of a file, mostly. The share `s.common` of the prior of a rung comes from the other passes,
    the rest is even. What the others say of a rung is the product of their evidences of it. Each of these is mixed in the same way
    with the mean evidence of its pass, so that one odd pass cannot decide.
    """
    log = np.array([pass_fits.log_evidence_of_rungs() for pass_fits in passes])  # (pass, rung)
    even = np.full(log.shape[1], -np.log(log.shape[1]))
    # a pass has the rung of the file with the probability `common`, else any
    log_mean = logsumexp(log + even, axis=1, keepdims=True)
    mixed = np.logaddexp(np.log(s.common) + log, np.log1p(-s.common) + log_mean)
    others = mixed.sum(axis=0) - mixed  # the product over all other passes
    prior = np.logaddexp(np.log(s.common) + log_softmax(others, axis=1), np.log1p(-s.common) + even)
    return [replace(pass_fits, log_rung=row) for pass_fits, row in zip(passes, prior, strict=True)]


def best_motions(fits: Sequence[Fit], count: int, search_settings: SearchSettings) -> Track:
    """Return the `count` most probable motions of the nominal model under any strength of torques, without copies.

    They are those from which another fit begins; there are none if the nominal model has no fit.
    """
    nominal_fits = [fitted for fitted in fits if fitted.model.what == AS_STATED and len(fitted)]
    if not nominal_fits:
        return fits[0].motions.take(slice(0)) if fits else Track.free(*np.zeros((2, 0, 0, 3)))
    motions = Track.joined([fitted.to_begin_from for fitted in nominal_fits])
    log = np.concatenate([fitted.log_evidence for fitted in nominal_fits])
    t_s = nominal_fits[0].model.obs.t_s
    return motions.take(distinct(motions, t_s, search_settings, count, np.inf, order_by=-log))


def best_fit(fits: Sequence[Fit]) -> Fit:
    """Return the fit with the most probable motion, all strengths of torques being equally likely."""
    return max(
        (fitted for fitted in fits if len(fitted)),
        key=lambda fitted: float(fitted.log_evidence.max()),
    )


def best_cost(fits: Sequence[Fit]) -> float:
    """Return the cost of the most probable motion; infinity without any.

    Another motion may cost less: under the strongest torques nearly everything costs little, and is improbable.
    """
    pairs = (zip(fitted.log_evidence, fitted.motions.cost, strict=True) for fitted in fits)
    return float(max(chain.from_iterable(pairs), default=(0.0, np.inf))[1])


def merge_fits(
    fits: Sequence[Fit], s: LadderSettings, search_settings: SearchSettings
) -> list[Fit]:
    """Return one fit for each model and strength of torques, in which a motion that several fits have counts once."""
    groups: dict[tuple[str, float], list[Fit]] = {}
    for fitted in fits:
        groups.setdefault((fitted.model.what, fitted.model.noise.acceleration), []).append(fitted)
    joined = [_join_fits(group) for group in groups.values()]
    return [fitted.take(_distinct_motions(fitted, s, search_settings)) for fitted in joined]


def _join_fits(fits: list[Fit]) -> Fit:
    """Return the motions of several fits of one model as one fit."""
    parts = ((fitted.log_evidence, fitted.u_covariance, fitted.states_by_u) for fitted in fits)
    motions = Track.joined([fitted.motions for fitted in fits])
    lowest = Track.joined([fitted.to_begin_from for fitted in fits])
    joined = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Fit(fits[0].model, motions, *joined, lowest)
