"""From modes to a posterior: importance sampling with a heavy-tailed mixture that learns, and a check that it can be trusted.

One mixture covers all modes, so a motion is weighed by the density with which all of them propose it: copies of a mode do not
count twice, and modes that run into each other need no border. Proposals of earlier rounds only teach the mixture; what is
told rests on the last round alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.special import logsumexp

from sunspin.estimate.effort import may_go_on, spend
from sunspin.estimate.posterior.fit import Fit, OfStates
from sunspin.estimate.posterior.likelihood import Likelihood
from sunspin.estimate.posterior.mixture import Blend, Mixture, Sheet, monomials
from sunspin.estimate.posterior.model import Model, State
from sunspin.estimate.posterior.modes import Modes, standing
from sunspin.estimate.posterior.turns import drawn_turns, rest_of, with_turns, without_turns
from sunspin.estimate.posterior.verdict import EFFECTIVE_LIMIT, LEAST_WEIGHT, TAIL_LIMIT
from sunspin.solve.weights import effective_draws, pareto_tail

ROUNDS, DRAWS, LAST_DRAWS, MOST_DRAWS = 6, 10_000, 12_000, 40_000
"""Rounds in which the mixture learns at most, their draws, and the least and most draws of the last round."""

SOFTS = (1, 2)
"""Soft directions of the sheets, one kind after the other while the draws are not good. Two straighten what is free by half a
radian and more; where one is enough a second costs what its quadratic bend misses."""

WANTED = 3_000.0
"""Effective draws for which the last round is made longer."""

GOOD_SHARE = 0.25
"""Learning ends when the draws are worth this part of as many of the posterior's own."""

LENT_SHARE = 0.1
"""The share that is good enough for a mixture with the bends of another model, which learns in half as many rounds: its hypothesis
seldom has the most weight, and to find bends costs more than draws."""

WIDER = 1.3
"""Factor on the covariances of Laplace's method at first."""

DEFENCE = 0.15
"""Part of the mixture that stays with the first components, whatever was learnt."""

LOCAL, LOCAL_SHRINK = 24, 0.6
"""Where learning stalls: components put on draws of the posterior, and their covariance as a part of the whole region's."""

MOST_BENT = 12
"""Modes whose ridges are followed, the best."""

RIDGE_POINTS, RIDGE_WIDTHS = 4, (0.3, 0.7, 1.3)
"""Fits for each coefficient of a bend, and how far about the centre they are, in sigmas, one after the other."""

FAR_TORQUE = 3.0
"""How many times a size linear theory may put a torque at, where the fit was under a smaller size. A torque in space that turns the
angular momentum about the Sun is hardly seen: from a fit under a hundredth of the size it was put whole turns away, with a mass
that left out all that fits. Were there such a mode, the fits under three of the sizes would have come to it."""

ON_RIDGE = 9.0
"""Squared distance for each dimension, in sigmas, up to which a mode lies on the ridge of another."""

BLOCK = 2_000
"""Draws whose densities under all components are worked on at once."""

DENSITIES = 25
"""Densities of one draw under one component that take as long as a motion carried over one interval."""

CONNECTED = 0.02
"""Components that share this part of the draws of one of them belong to one region."""


@dataclass(frozen=True)
class Weigh(OfStates):
    """Row -> log-likelihood of a hypothesis, its unknowns with turns of panels drawn, and the log density of these draws."""

    @property
    def outputs(self) -> Mapping[str, Any]:
        return {
            "log_likelihood": ("float64", ()),
            "u": ("float64", self.state.u.shape[1:]),
            "density": ("float64", ()),
        }

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        state, likelihood = self.state.take(index), self.likelihood
        prediction = likelihood.predict(state)
        u, density = drawn_turns(likelihood, prediction, state.u)
        return {"log_likelihood": likelihood.of(prediction, u), "u": u, "density": density}


@dataclass(frozen=True)
class Sample:
    """Draws of the last round with their log weights (not normalised), log-likelihood, region, and how good they are.

    `region` (n) counts from 0 by falling weight; `of_mode` (modes) is that of each mode; `effective`: as many draws of the
    posterior itself; `tail`: Pareto's k of the largest weights, above 0.7 not to be trusted; `evidence` (log);
    `trace` (rounds, 3): log evidence, effective share, k; `ridge` (modes): modes of one number lie on one ridge. `bent`: the
    components about modes, bent along their ridges, where the sampler has such. `cut`: the computing budget ended the draws.
    """

    state: State
    log_weight: np.ndarray
    log_likelihood: np.ndarray
    region: np.ndarray
    share: np.ndarray
    of_mode: np.ndarray
    effective: float
    tail: float
    evidence: float
    trace: np.ndarray
    ridge: np.ndarray
    bent: Mixture | None = None
    cut: bool = False


class Known(NamedTuple):
    """Draws of the same motions under a model with fewer unknowns, of whose sigmas those here are so many `times` as large."""

    drawn: Sample
    times: np.ndarray


def sample(
    likelihood: Likelihood,
    modes: Modes,
    seed: int,
    run: Any,
    chunk: int,
    part: float = 1.0,
    known: Known | None = None,
    least: float = -np.inf,
) -> Sample | None:
    """The posterior around the modes, None where no draw is possible: what is there is less than one part in all draws of what
    the modes promised. `run(function, label, chunk)` computes rows; `part`: of the draws that are made otherwise.

    Where sheets with one soft direction do not become good, others with two are learnt too, and both propose, unless the search
    for the modes was not complete: the verdict is not sure then, whatever the draws. Bends of what is `known` are taken instead of
    found; where these do not become good enough, sheets are learnt as otherwise, unless the draws that are `known` are not to be
    trusted themselves: twelve rounds more for each hypothesis would not make the verdict sure. `least`: the log evidence below
    which nobody asks how good the draws are.

    Where the computing budget (:mod:`sunspin.estimate.effort`) is spent, ridges are no longer followed and no further round begins
    but the last, of `LAST_DRAWS`.
    """
    bent = None
    if known is not None and known.drawn.bent is not None:
        rest = rest_of(likelihood.model)
        bent = known.drawn.bent.counted_in(known.times[rest[rest < len(known.times)]])
    tracks: list[_Track] = []
    rough = known is not None and (
        known.drawn.effective < EFFECTIVE_LIMIT or known.drawn.tail > TAIL_LIMIT
    )
    kinds = [(softs, None) for softs in (SOFTS if modes.complete else SOFTS[:1])]
    if bent is not None:
        kinds = [(bent.sheet.softs, bent), *([] if rough else kinds)]
    for softs, lent in kinds:
        if tracks and not may_go_on():
            break
        tracks.append(_taught(likelihood, modes, softs, seed, run, chunk, part, lent, least))
        if tracks[-1].good is not None:
            break
    worth = np.array([track.share for track in tracks])
    best = int(np.argmax(worth))
    last, trace = tracks[-1].good, [row for track in tracks for row in track.trace]
    if not worth.any():
        return None
    if last is None:
        blend = Blend(tuple(track.mixture for track in tracks), worth / worth.sum())
        most = MOST_DRAWS if may_go_on() else LAST_DRAWS
        count = int(part * np.clip(WANTED / max(worth.max(), 1e-3), LAST_DRAWS, most))
        last = _round(likelihood, blend, count, seed, len(SOFTS) * ROUNDS, run, chunk)
        trace.append([last.evidence, last.effective / count, last.tail])
        if not last.effective:  # rounds before had draws, this one has none
            return None
    label, of_component = regions(last.log_weight, last.parts, last.density)
    of_mode = tracks[0].of_mode
    share = np.bincount(label, weights=np.exp(last.log_weight - logsumexp(last.log_weight)))
    return Sample(
        last.state,
        last.log_weight,
        last.log_likelihood,
        label,
        share,
        np.where(of_mode >= 0, of_component[of_mode], -1),
        last.effective,
        last.tail,
        last.evidence,
        np.array(trace),
        tracks[best].ridge,
        tracks[best].first,
    )


@dataclass(frozen=True)
class _Track:
    """What was learnt with sheets of one kind: a mixture, the ridge and the component of each mode, the best share of draws, the
    trace, the components that it began with, and the last round, if its draws are good."""

    mixture: Mixture
    ridge: np.ndarray
    of_mode: np.ndarray
    share: float
    trace: list[list[float]]
    first: Mixture
    good: _Round | None


def _taught(
    likelihood: Likelihood,
    modes: Modes,
    softs: int,
    seed: int,
    run: Any,
    chunk: int,
    part: float,
    bent: Mixture | None,
    least: float,
) -> _Track:
    """Rounds of draws from which a mixture learns; its first components stand first in it. `bent`: components whose bends
    are taken instead of found; `least` as in `sample`."""
    first, ridge, of_mode = _first(likelihood, modes, softs, seed, run, chunk, bent)
    mixture, tried, trace = first, [], []
    count, good = int(part * DRAWS), None
    begin = (SOFTS.index(softs) if bent is None else len(SOFTS) + 1) * ROUNDS
    rounds, wanted = (ROUNDS, GOOD_SHARE) if bent is None else (ROUNDS // 2, LENT_SHARE)
    for turn in range(rounds):
        if turn and not may_go_on():
            break
        made = _round(likelihood, mixture, count, seed, begin + turn, run, chunk)
        trace.append([made.evidence, made.effective / count, made.tail])
        tried.append((made.effective / count, mixture))
        if made.effective > wanted * count or (turn and max(row[0] for row in trace) < least):
            good = made
            break
        if made.effective:
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1, begin + turn)))
            mixture = _learnt(made, first, mixture, local=turn >= 2, rng=rng)
    share = max(share for share, _ in tried)
    mixture = pooled(tried) if good is None and share else mixture
    return _Track(mixture, ridge, of_mode, share, trace, first, good)


def pooled(tried: list[tuple[float, Mixture]]) -> Mixture:
    """The mixtures of all rounds, by what their draws were worth: none of them may be trusted to cover the posterior alone."""
    if len(tried) == 1:
        return tried[0][1]
    total = sum(share for share, _ in tried)
    weights = [share / total * m.weight / m.weight.sum() for share, m in tried]
    n, first, second = len(weights[0]), tried[0][1], tried[1][1]
    weights[1][:n] = sum(
        weight[:n] for weight in weights[1:]
    )  # each round but the first begins with the same defence
    parts = [first, second, *(m.take(np.arange(n, len(m.weight))) for _, m in tried[2:])]
    return replace(
        Mixture.joined(parts),
        weight=np.concatenate([*weights[:2], *(weight[n:] for weight in weights[2:])]),
    )


@dataclass(frozen=True)
class _Round:
    state: State
    proposed: State  # the same without turns of panels
    log_weight: np.ndarray
    log_likelihood: np.ndarray
    parts: np.ndarray  # log of weight times density of each component
    density: np.ndarray  # log of their sum
    effective: float
    tail: float
    evidence: float


def _round(
    likelihood: Likelihood,
    mixture: Mixture | Blend,
    n: int,
    seed: int,
    turn: int,
    run: Any,
    chunk: int,
) -> _Round:
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, turn)))
    model, proposed = likelihood.model, mixture.draw(n, rng)
    state = with_turns(
        model, proposed, rng.standard_normal((n, len(model.unknowns) - len(rest_of(model))))
    )
    inside = np.flatnonzero(np.isfinite(model.log_prior(state)))
    known, of_turns = np.full(n, -np.inf), np.zeros(n)
    if len(inside):
        found = run(Weigh(likelihood, state.take(inside)), "weighing", chunk)
        known[inside], of_turns[inside], state.u[inside] = (
            found["log_likelihood"],
            found["density"],
            found["u"],
        )
    parts = mixture.log_densities(proposed)
    spend(parts.size / DENSITIES)
    density = np.concatenate([np.asarray(logsumexp(parts[rows], axis=1)) for rows in _blocks(n)])
    weight = model.log_prior(state) + known - density - of_turns
    weight = np.where(np.isnan(weight), -np.inf, weight)
    if not np.isfinite(weight.max()):  # no draw is possible
        return _Round(state, proposed, weight, known, parts, density, 0.0, np.inf, -np.inf)
    effective = effective_draws(np.exp(weight - weight.max()))
    evidence = float(logsumexp(weight) - np.log(n))
    return _Round(
        state, proposed, weight, known, parts, density, effective, pareto_tail(weight), evidence
    )


def _blocks(n: int) -> list[slice]:
    """Draws to be worked on at once, so that what is made of many draws and components stays small."""
    return [slice(low, min(low + BLOCK, n)) for low in range(0, n, BLOCK)]


def _first(
    likelihood: Likelihood,
    modes: Modes,
    softs: int,
    seed: int,
    run: Any,
    chunk: int,
    bent: Mixture | None = None,
) -> tuple[Mixture, np.ndarray, np.ndarray]:
    """Components by Laplace's method, bent along their ridges; of each mode, the one on whose ridge it lies and its component (-1:
    it has none).

    Modes on the ridge of a likelier one are not given a component of their own, nor are those that are negligible. `bent` as in
    `_taught`.
    """
    model, reach = standing(likelihood.model)[0], likelihood.data.reach_s
    d, kept = model.dimension, np.concatenate([np.arange(5), 5 + rest_of(likelihood.model)])
    least = np.diag([model.max_rate**-2] * 3 + [1.0] * 2 + [0.0] * len(likelihood.model.unknowns))
    laplace = np.linalg.inv(modes.hessian + least)
    volume = 0.5 * np.linalg.slogdet(laplace)[1]
    laplace = (0.5 * (laplace + np.swapaxes(laplace, 1, 2)))[:, kept[:, None], kept]
    centres = without_turns(likelihood.model, modes.state)
    sheet = Sheet.of(d, softs, model.moving, model.where("scale"))
    if bent is None:
        parts = [_straight(c, _basis(c, reach), sheet) for c in laplace]
    else:
        # by what they turn within reach, and by direction
        off = reach * (centres.omega[:, None] - bent.centre.omega)
        near = np.argmin((off**2).sum(2) - 2 * centres.sun @ bent.centre.sun.T, axis=1)
        parts = [
            _straight(c, bent.basis[k], sheet, bent, k) for c, k in zip(laplace, near, strict=True)
        ]
    basis, bend, covariance = (np.array(every) for every in zip(*parts, strict=True))
    owner = np.arange(len(covariance))
    alike = np.ones(len(covariance))
    mixture = Mixture(
        centres, basis, bend, np.zeros((len(covariance), d)), covariance, alike, sheet
    )
    mass = volume - modes.objective
    order, least_mass = np.argsort(-mass, kind="stable"), mass.max() + np.log(LEAST_WEIGHT / 2)
    for i, m in enumerate(order[:MOST_BENT]):
        if mass[m] < least_mass:
            break
        for k in order[:i][owner[order[:i]] == order[:i]]:
            off = mixture.coordinates(centres.take(np.array([m])), int(k))[0]
            if off @ np.linalg.solve(covariance[k], off) < ON_RIDGE * d:
                owner[m] = k
                break
        if owner[m] == m and bent is None and may_go_on():
            rng = np.random.default_rng(
                np.random.SeedSequence(
                    seed, spawn_key=(2, SOFTS.index(softs) * len(modes.objective) + m)
                )
            )
            turns = np.delete(modes.state.u[[m]], rest_of(likelihood.model), axis=1)
            _follow_ridge(likelihood, mixture, m, turns, rng, run, chunk)
    kept = np.flatnonzero(owner == np.arange(len(owner)))
    first, mass = mixture.take(kept), mass[kept]
    if model.frame:
        first, mass, of_kept = _over_sizes(model, first, mass, modes.share[kept])
        kept = kept[of_kept]
    heavy = np.flatnonzero(mass > mass.max() + np.log(LEAST_WEIGHT / 2))
    first, mass = first.take(heavy), mass[heavy]
    modes_of, component = np.unique(kept[heavy], return_index=True)
    of_mode = np.full(len(owner), -1)
    of_mode[modes_of] = component
    weight = np.exp(np.maximum(0.7 * (mass - mass.max()), -8.0))
    first = replace(first, covariance=WIDER * first.covariance, weight=weight / weight.sum())
    return first, owner, of_mode[owner]


def _over_sizes(
    model: Model, mixture: Mixture, mass: np.ndarray, fitted: np.ndarray
) -> tuple[Mixture, np.ndarray, np.ndarray]:
    """Components under each sigma that a steady torque may have instead of the one (m) of their fit, by linear theory, those beyond
    its reach (`FAR_TORQUE`) left out; their log masses, and which component each was made of, in order."""
    places = 5 + np.array(model.where("steady_torque"))
    made: list[tuple[int, float, np.ndarray, np.ndarray]] = []
    for m, share in enumerate(fitted):
        torque, inverse = mixture.centre.u[m, places - 5], np.linalg.inv(mixture.covariance[m])
        for other in model.shares:
            more = other**-2 - share**-2
            precision, pull = np.array(inverse), np.zeros(len(inverse))
            precision[places, places] += more
            pull[places] = -more * torque
            covariance = np.linalg.inv(precision)
            mean = covariance @ pull
            if other > share and np.linalg.norm(torque + mean[places]) > FAR_TORQUE * other:
                continue
            gain = 0.5 * (pull @ mean - more * torque @ torque)
            size = 0.5 * (
                np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(mixture.covariance[m])[1]
            )
            made.append((m, mass[m] + gain + size - 3 * np.log(other / share), mean, covariance))
    index, masses, means, covariances = (np.array(every) for every in zip(*made, strict=True))
    sized = replace(mixture.take(index), mean=means, covariance=covariances)
    return sized, masses, index


def _basis(laplace: np.ndarray, reach_s: float) -> np.ndarray:
    """Basis (5, 5) of one covariance (D, D): with u held, directions by falling variance, rates as what they turn in `reach_s`."""
    size = np.diag([reach_s] * 3 + [1.0] * 2)
    slope = np.linalg.solve(laplace[5:, 5:], laplace[5:, :5]).T
    alone = size @ (laplace[:5, :5] - slope @ laplace[5:, :5]) @ size
    return np.linalg.eigh(0.5 * (alone + alone.T))[1][:, ::-1].T @ size


def _straight(
    laplace: np.ndarray, basis: np.ndarray, sheet: Sheet, bent: Mixture | None = None, k: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Basis, linear bend and covariance in bent coordinates of one covariance (D, D); products as in component `k` of `bent`."""
    whole = np.eye(len(laplace))
    whole[:5, :5] = basis
    covariance = whole @ laplace @ whole.T
    along, stiff = sheet.along, sheet.stiff
    answer = np.linalg.solve(covariance[np.ix_(along, along)], covariance[np.ix_(along, stiff)])
    bend = np.zeros((sheet.terms, len(stiff)))
    bend[: len(along)] = answer
    if bent is not None:
        bend[len(along) :] = sheet.lent(bent.sheet, bent.bend[k])
    left = covariance[np.ix_(stiff, stiff)] - covariance[np.ix_(stiff, along)] @ answer
    covariance[stiff, :], covariance[:, stiff] = 0.0, 0.0
    covariance[np.ix_(stiff, stiff)] = 0.5 * (left + left.T)
    return basis, bend, covariance


def _follow_ridge(
    likelihood: Likelihood,
    mixture: Mixture,
    m: int,
    turns: np.ndarray,
    rng: np.random.Generator,
    run: Any,
    chunk: int,
) -> None:
    """Fit the bend of component m: the best of the stiff coordinates, and of the panels' turns, for values of the others about the
    centre's; `turns` (1, k): those of the centre."""
    d, sheet = mixture.covariance.shape[1], mixture.sheet
    n, along, stiff = RIDGE_POINTS * sheet.terms, sheet.along, sheet.stiff
    here = np.full(1, m)
    root = np.linalg.cholesky(mixture.covariance[m][np.ix_(along, along)])
    model = likelihood.model
    kept = np.concatenate([np.arange(5), 5 + rest_of(model)])
    whole = np.eye(model.dimension)
    whole[:5, :5] = np.linalg.inv(mixture.basis[m])
    free = whole[:, [*kept[stiff], *np.setdiff1d(np.arange(len(whole)), kept)]]
    for width in (
        RIDGE_WIDTHS
    ):  # a narrow part first: its bend takes the starts of the wider ones near the ridge
        x = np.zeros((n, d))
        x[:, along] = width * rng.standard_normal((n, len(along))) @ root.T
        start = with_turns(model, mixture.states(x, np.repeat(here, n)), turns)
        found = run(Fit(likelihood, start, ((3.0, 2), (1.0, 4)), free=free), "ridge", chunk)
        flat = replace(mixture, bend=np.zeros_like(mixture.bend))
        answer = flat.coordinates(
            without_turns(model, State(found["omega"], found["sun"], found["u"])), m
        )
        terms, good = monomials(answer, sheet), np.isfinite(found["cost"])
        good &= found["cost"] < np.median(found["cost"][good]) + 3.0 * d
        scale = np.linalg.cholesky(mixture.covariance[m][np.ix_(stiff, stiff)])
        for _ in range(4):  # points that fell to another ridge are let go
            if good.sum() < 1.5 * sheet.terms:
                return
            bend = np.linalg.lstsq(terms[good], answer[good][:, stiff], rcond=None)[0]
            off = np.linalg.norm(
                np.linalg.solve(scale, (answer[:, stiff] - terms @ bend).T), axis=0
            )
            good &= off < max(4.0 * np.median(off[good]), 1.0)
        mixture.bend[m] = bend


def _learnt(
    made: _Round, first: Mixture, mixture: Mixture, local: bool, rng: np.random.Generator
) -> Mixture:
    """The mixture with the moments of the weighted draws, each draw shared out among the components that may have made it."""
    weight = made.log_weight - made.log_weight.max()
    cut = (
        logsumexp(weight) - np.log(len(weight)) / 2
    )  # no draw counts for more than a root of their number
    weight = np.exp(np.minimum(weight, cut))
    share = np.exp(made.parts - made.density[:, None]) * (weight / weight.sum())[:, None]
    used = np.flatnonzero(share.sum(axis=0) > 1e-4)
    mean, learnt = mixture.mean[used], mixture.covariance[used]
    for alike, x in mixture.charts(made.proposed, used):
        for i in np.searchsorted(used, alike):
            part = share[:, used[i]] / share[:, used[i]].sum()
            keep = min(1.0, effective_draws(part) / (4.0 * x.shape[1]))  # few draws move little
            mean[i] = keep * (part @ x) + (1 - keep) * mean[i]
            spread = (part[:, None] * (x - mean[i])).T @ (x - mean[i])
            learnt[i] = keep * spread + (1 - keep) * learnt[i]
    origin, shares = used, share[:, used].sum(axis=0) / share[:, used].sum()
    if local:
        pick = rng.choice(len(weight), LOCAL, p=weight / weight.sum())
        owner = np.argmax(share[np.ix_(pick, used)], axis=1)
        points = [
            mixture.coordinates(made.proposed.take(pick[[i]]), int(used[o]))[0]
            for i, o in enumerate(owner)
        ]
        origin, mean = np.concatenate([used, used[owner]]), np.concatenate([mean, points])
        learnt = np.concatenate([learnt, LOCAL_SHRINK * learnt[owner]])
        shares = np.concatenate([0.4 * shares, np.full(LOCAL, 0.6 / LOCAL)])
    learnt = learnt + 1e-9 * np.einsum("mii,ij->mij", learnt, np.eye(learnt.shape[1]))
    return Mixture(
        State.joined([first.centre, mixture.centre.take(origin)]),
        np.concatenate([first.basis, mixture.basis[origin]]),
        np.concatenate([first.bend, mixture.bend[origin]]),
        np.concatenate([first.mean, mean]),
        np.concatenate([2.0 * first.covariance, learnt]),
        np.concatenate([DEFENCE * first.weight, (1 - DEFENCE) * shares / shares.sum()]),
        mixture.sheet,
    )


def regions(
    log_weight: np.ndarray, parts: np.ndarray, density: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The region of each draw (n) and of each component (m; -1: none of weight); arguments as in `_Round`."""
    weight = np.exp(log_weight - logsumexp(log_weight))
    blocks = _blocks(len(weight))
    mass = sum(weight[rows] @ np.exp(parts[rows] - density[rows, None]) for rows in blocks)
    heavy = np.flatnonzero(mass >= 1e-12)  # of thousands of components few are: the product costs
    overlap = np.zeros((len(heavy), len(heavy)))
    for rows in blocks:
        share = np.exp(parts[rows][:, heavy] - density[rows, None])
        overlap += (weight[rows, None] * share).T @ share
    least = np.minimum(mass[heavy, None], mass[heavy])
    alike = np.zeros((len(mass), len(mass)), dtype=bool)
    alike[np.ix_(heavy, heavy)] = overlap > CONNECTED * least
    label = connected_components(alike, directed=False)[1]
    of_draw = label[np.argmax(parts, axis=1)]
    names, inverse = np.unique(of_draw, return_inverse=True)
    order = np.argsort(-np.bincount(inverse, weights=weight), kind="stable")
    rank = np.empty(len(names), dtype=np.int64)
    rank[order] = np.arange(len(names))
    place = {int(name): int(rank[i]) for i, name in enumerate(names)}
    return rank[inverse], np.array([place.get(int(name), -1) for name in label])


def resampled(log_weight: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    """Indices (n) of draws of equal weight, systematic, in a random order."""
    edges = np.cumsum(np.exp(log_weight - logsumexp(log_weight)))
    which = np.minimum(
        np.searchsorted(edges, (np.arange(n) + rng.random()) / n * edges[-1]), len(edges) - 1
    )
    return rng.permutation(which)
