"""From modes to a posterior: importance sampling with a heavy-tailed mixture that learns, and a check that it can be trusted.

One mixture covers all modes, so a motion is weighed by the density with which all of them propose it: copies of a mode do not
count twice, and modes that run into each other need no border. Proposals of earlier rounds only teach the mixture; what is
told rests on the last round alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from scipy.special import gammaln, logsumexp
from scipy.stats import genpareto

from sunspin.infer.identity import code, plain
from sunspin.infer.posterior.fit import FILES, Fit
from sunspin.infer.posterior.likelihood import Likelihood, moved
from sunspin.infer.posterior.model import State
from sunspin.infer.posterior.modes import Modes, coordinates

FREEDOM = 5.0
"""Degrees of freedom of the mixture's Student components."""

ROUNDS, DRAWS, LAST_DRAWS, MOST_DRAWS = 6, 5_000, 12_000, 40_000
"""Rounds in which the mixture learns at most, their draws, and the least and most draws of the last round."""

WANTED = 3_000.0
"""Effective draws for which the last round is made longer."""

GOOD_SHARE = 0.25
"""Learning ends when the draws are worth this part of as many of the posterior's own."""

WIDER = 1.3
"""Factor on the covariances of Laplace's method at first."""

DEFENCE = 0.15
"""Part of the mixture that stays with the first components, whatever was learnt."""

LOCAL, LOCAL_SHRINK = 24, 0.3
"""Where learning stalls: components put on draws of the posterior, and their covariance as a part of the whole region's."""

MOST_BENT = 12
"""Modes whose ridges are followed, the best."""

SOFT = 1
"""Directions in rate and direction that may vary by much though u is known (the azimuth of H in the body), the others answering
to them."""

RIDGE_POINTS, RIDGE_WIDTHS = 4, (0.3, 0.7, 1.3)
"""Fits for each coefficient of a bend, and how far about the centre they are, in sigmas, one after the other."""

ON_RIDGE = 9.0
"""Squared distance for each dimension, in sigmas, up to which a mode lies on the ridge of another."""

TAIL_LEAST = 30
"""Weights that a tail must have to be fitted."""

CONNECTED = 0.02
"""Components that share this part of the draws of one of them belong to one region."""


@dataclass(frozen=True)
class Mixture:
    """Student components in bent coordinates.

    centres (m), bases (m, 5, 5), bends (m, M, 4), means (m, D) and covariances (m, D, D) in these coordinates, weights (m) that
    add to one. A basis turns rate and
    direction into coordinates of which the first is soft: it may vary by much within the noise. A bend says how the
    other four answer to it and to u: polynomials (see `monomials`), which are subtracted. That leaves volumes as they are,
    and straightens the thin curved sheet that uncertain inertias, friction and wheel speeds make of a mode. `moving` are the
    places in u of what the motion depends on.
    """

    centre: State
    basis: np.ndarray
    bend: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    weight: np.ndarray
    moving: tuple[int, ...]

    def coordinates(self, state: State, m: int) -> np.ndarray:
        """Bent coordinates (n, D) of states about component m."""
        x = coordinates(state, self.centre.take(np.array([m])))
        x[:, :5] = x[:, :5] @ self.basis[m].T
        x[:, SOFT:5] -= monomials(x, self.moving) @ self.bend[m]
        return x

    def states(self, x: np.ndarray, which: np.ndarray) -> State:
        """The states (n) with bent coordinates x (n, D) about the components `which` (n)."""
        centre = self.centre.take(which)
        x = np.array(x)
        x[:, SOFT:5] += np.einsum("nm,nmj->nj", monomials(x, self.moving), self.bend[which])
        step = np.linalg.solve(self.basis[which], x[:, :5, None])[:, :, 0]
        return State(centre.omega + step[:, :3], moved(centre.sun, np.clip(step[:, 3:], -np.pi, np.pi)), centre.u + x[:, 5:])

    def draw(self, n: int, rng: np.random.Generator) -> State:
        """n draws: systematic over the components, so that each gets its share."""
        edges = np.cumsum(self.weight) / self.weight.sum()
        which = np.minimum(np.searchsorted(edges, (np.arange(n) + rng.random()) / n), len(edges) - 1)
        root = np.linalg.cholesky(self.covariance)
        x = np.einsum("nij,nj->ni", root[which], rng.standard_normal((n, self.covariance.shape[1])))
        return self.states(self.mean[which] + x * np.sqrt(FREEDOM / rng.chisquare(FREEDOM, n))[:, None], which)

    def log_densities(self, state: State) -> np.ndarray:
        """Log density (n, m) of each component times its weight, over rates, the sphere and u."""
        out = np.empty((len(state), len(self.weight)))
        d = self.covariance.shape[1]
        constant = gammaln((FREEDOM + d) / 2) - gammaln(FREEDOM / 2) - 0.5 * d * np.log(FREEDOM * np.pi)
        for m in range(len(self.weight)):
            root = np.linalg.cholesky(self.covariance[m])
            square = np.sum(np.linalg.solve(root, (self.coordinates(state, m) - self.mean[m]).T) ** 2, axis=0)
            angle = np.arccos(np.clip(state.sun @ self.centre.sun[m], -1.0, 1.0))
            sphere = -np.log(np.maximum(np.sinc(angle / np.pi), 1e-12))
            volume = np.linalg.slogdet(self.basis[m])[1] - np.log(np.diag(root)).sum()
            out[:, m] = constant + volume - 0.5 * (FREEDOM + d) * np.log1p(square / FREEDOM) + sphere
        with np.errstate(divide="ignore"):
            return out + np.log(self.weight)


def monomials(x: np.ndarray, moving: tuple[int, ...]) -> np.ndarray:
    """Of bent coordinates (n, D): all u, the soft one, and the products of two of these and of those u that move the body."""
    part = np.concatenate([x[:, :SOFT], x[:, [5 + i for i in moving]]], axis=1)
    i, j = np.triu_indices(part.shape[1])
    return np.concatenate([x[:, 5:], x[:, :SOFT], part[:, i] * part[:, j]], axis=1)


@dataclass(frozen=True)
class Weigh:
    """Row -> log-likelihood of a hypothesis."""

    likelihood: Likelihood
    state: State = field(repr=False)
    outputs: ClassVar[Mapping[str, Any]] = {"log_likelihood": ("float64", ())}

    @property
    def n_rows(self) -> int:
        return len(self.state)

    def identity(self) -> dict[str, Any]:
        return {**code(*FILES), "weigh": plain(self)}

    def __call__(self, index: np.ndarray) -> dict[str, np.ndarray]:
        return {"log_likelihood": self.likelihood(self.state.take(index))}


@dataclass(frozen=True)
class Sample:
    """Draws of the last round with their log weights (not normalised), log-likelihood, region, and how good they are.

    `region` (n) counts from 0 by falling weight; `of_component` (m) is that of each component; `effective`: as many draws of the
    posterior itself; `tail`: Pareto's k of the largest weights, above 0.7 not to be trusted; `evidence` (log);
    `trace` (rounds, 3): log evidence, effective share, k.
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


def sample(likelihood: Likelihood, modes: Modes, seed: int, run: Any, chunk: int) -> Sample:
    """The posterior around the modes; `run(function, label, chunk)` computes rows."""
    first, of_mode = _first(likelihood, modes, seed, run, chunk)
    mixture, tried, trace = first, [], []
    for turn in range(ROUNDS):
        made = _round(likelihood, mixture, DRAWS, seed, turn, run, chunk)
        trace.append([made.evidence, made.effective / DRAWS, made.tail])
        tried.append((made.effective / DRAWS, mixture))
        if made.effective > GOOD_SHARE * DRAWS:
            break
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1, turn)))
        mixture = _learnt(made, first, mixture, local=turn >= 2, rng=rng)
    share = max(share for share, _ in tried)
    mixture = tried[-1][1] if share > GOOD_SHARE else _pooled(tried)
    count = int(np.clip(WANTED / max(share, 1e-3), LAST_DRAWS, MOST_DRAWS))
    last = _round(likelihood, mixture, count, seed, ROUNDS, run, chunk)
    trace.append([last.evidence, last.effective / count, last.tail])
    label, of_component = _regions(last, mixture)
    share = np.bincount(label, weights=np.exp(last.log_weight - logsumexp(last.log_weight)))
    return Sample(
        last.state, last.log_weight, last.log_likelihood, label, share, of_component[of_mode], last.effective, last.tail,
        last.evidence, np.array(trace),
    )  # fmt: skip


def _pooled(tried: list[tuple[float, Mixture]]) -> Mixture:
    """The mixtures of all rounds, by what their draws were worth: none of them may be trusted to cover the posterior alone."""
    parts, total = [mixture for _, mixture in tried], sum(share for share, _ in tried)
    basis, bend = (np.concatenate([getattr(m, name) for m in parts]) for name in ("basis", "bend"))
    mean, covariance = (np.concatenate([getattr(m, name) for m in parts]) for name in ("mean", "covariance"))
    weight = np.concatenate([share / total * m.weight / m.weight.sum() for share, m in tried])
    return Mixture(State.joined([m.centre for m in parts]), basis, bend, mean, covariance, weight, parts[0].moving)


@dataclass(frozen=True)
class _Round:
    state: State
    log_weight: np.ndarray
    log_likelihood: np.ndarray
    parts: np.ndarray  # log of weight times density of each component
    effective: float
    tail: float
    evidence: float


def _round(likelihood: Likelihood, mixture: Mixture, n: int, seed: int, turn: int, run: Any, chunk: int) -> _Round:
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, turn)))
    state = mixture.draw(n, rng)
    prior = likelihood.model.log_prior(state)
    inside = np.flatnonzero(np.isfinite(prior))
    known = np.full(n, -np.inf)
    known[inside] = run(Weigh(likelihood, state.take(inside)), "weighing", chunk)["log_likelihood"]
    parts = mixture.log_densities(state)
    weight = prior + known - logsumexp(parts, axis=1)
    weight = np.where(np.isnan(weight), -np.inf, weight)
    share = np.exp(weight - weight.max())
    effective = float(share.sum() ** 2 / np.sum(share**2))
    return _Round(state, weight, known, parts, effective, pareto_tail(weight), float(logsumexp(weight) - np.log(n)))


def pareto_tail(log_weight: np.ndarray) -> float:
    """Shape k of the generalised Pareto law of the largest weights (Vehtari et al. 2024): errors shrink as expected below 0.7."""
    weight = np.sort(np.exp(log_weight - log_weight.max()))
    count = int(min(0.2 * len(weight), 3 * np.sqrt(len(weight))))
    if count < TAIL_LEAST or weight[-count - 1] <= 0:
        return np.inf
    beyond = weight[-count:] - weight[-count - 1]
    if beyond[-1] <= 0 or beyond.mean() < 1e-12 * weight[-1]:
        return -1.0  # all alike
    return float(genpareto.fit(beyond / beyond.mean(), floc=0)[0])


def _first(likelihood: Likelihood, modes: Modes, seed: int, run: Any, chunk: int) -> tuple[Mixture, np.ndarray]:
    """Components by Laplace's method, bent along their ridges; and the component that each mode belongs to.

    Modes on the ridge of a better one are not given a component of their own.
    """
    model, d = likelihood.model, modes.hessian.shape[1]
    least = np.diag(np.concatenate([np.full(3, model.max_rate**-2), np.ones(2), np.zeros(d - 5)]))
    laplace = np.linalg.inv(modes.hessian + least)
    parts = [_straight(0.5 * (c + c.T), likelihood.data.reach_s, tuple(model.moving)) for c in laplace]
    basis, bend, covariance = (np.array(every) for every in zip(*parts, strict=True))
    owner = np.arange(len(covariance))
    alike = np.ones(len(covariance))
    mixture = Mixture(modes.state, basis, bend, np.zeros((len(covariance), d)), covariance, alike, tuple(model.moving))
    for m in range(min(len(covariance), MOST_BENT)):
        for k in np.flatnonzero(owner[:m] == np.arange(m)):
            off = mixture.coordinates(modes.state.take(np.array([m])), int(k))[0]
            if off @ np.linalg.solve(covariance[k], off) < ON_RIDGE * d:
                owner[m] = k
                break
        if owner[m] == m:
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(2, m)))
            _follow_ridge(likelihood, mixture, m, rng, run, chunk)
    kept = np.flatnonzero(owner == np.arange(len(owner)))
    mass = (-modes.objective + 0.5 * np.linalg.slogdet(laplace)[1])[kept]
    weight = np.exp(np.maximum(0.7 * (mass - mass.max()), -8.0))
    first = Mixture(
        modes.state.take(kept), basis[kept], bend[kept], mixture.mean[kept], WIDER * covariance[kept], weight / weight.sum(),
        mixture.moving,
    )
    return first, np.searchsorted(kept, owner)


def _straight(laplace: np.ndarray, reach_s: float, moving: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Basis, linear bend and covariance in bent coordinates of one covariance (D, D).

    With u held, the soft directions are those of largest variance, rates counted as what they turn in `reach_s`.
    """
    d = len(laplace)
    size = np.diag([reach_s] * 3 + [1.0] * 2)
    slope = np.linalg.solve(laplace[5:, 5:], laplace[5:, :5]).T
    alone = size @ (laplace[:5, :5] - slope @ laplace[5:, :5]) @ size
    values, vectors = np.linalg.eigh(0.5 * (alone + alone.T))
    basis = vectors[:, ::-1].T @ size
    whole = np.eye(d)
    whole[:5, :5] = basis
    covariance = whole @ laplace @ whole.T
    ridge = [*range(5, d), *range(SOFT)]
    answer = np.linalg.solve(covariance[np.ix_(ridge, ridge)], covariance[np.ix_(ridge, range(SOFT, 5))])
    count = len(ridge) + (SOFT + len(moving)) * (SOFT + len(moving) + 1) // 2
    bend = np.zeros((count, 5 - SOFT))
    bend[: len(ridge)] = answer
    left = covariance[SOFT:5, SOFT:5] - covariance[np.ix_(range(SOFT, 5), ridge)] @ answer
    covariance[SOFT:5, :], covariance[:, SOFT:5] = 0.0, 0.0
    covariance[SOFT:5, SOFT:5] = 0.5 * (left + left.T)
    return basis, bend, covariance


def _follow_ridge(likelihood: Likelihood, mixture: Mixture, m: int, rng: np.random.Generator, run: Any, chunk: int) -> None:
    """Fit the bend of component m: the best of the stiff coordinates for values of the others about the centre's."""
    d, count = mixture.covariance.shape[1], mixture.bend.shape[1]
    n, ridge = RIDGE_POINTS * count, [*range(SOFT), *range(5, d)]
    here = np.full(1, m)
    answer = np.zeros((0, d))
    root = np.linalg.cholesky(mixture.covariance[m][np.ix_(ridge, ridge)])
    for width in RIDGE_WIDTHS:  # a narrow part first: its bend takes the starts of the wider ones near the ridge
        x = np.zeros((n, d))
        x[:, ridge] = width * rng.standard_normal((n, d - 5 + SOFT)) @ root.T
        start = mixture.states(x, np.repeat(here, n))
        free = np.linalg.inv(mixture.basis[m])[:, SOFT:]
        found = run(Fit(likelihood, start, ((3.0, 2), (1.0, 4)), free=free), "ridge", chunk)
        flat = replace(mixture, bend=np.zeros_like(mixture.bend))
        answer = flat.coordinates(State(found["omega"], found["sun"], start.u), m)
        terms, good = monomials(answer, mixture.moving), np.isfinite(found["cost"])
        good &= found["cost"] < np.median(found["cost"][good]) + 3.0 * d
        scale = np.linalg.cholesky(mixture.covariance[m, SOFT:5, SOFT:5])
        for _ in range(4):  # points that fell to another ridge are let go
            if good.sum() < 1.5 * count:
                return
            bend = np.linalg.lstsq(terms[good], answer[good, SOFT:5], rcond=None)[0]
            off = np.linalg.norm(np.linalg.solve(scale, (answer[:, SOFT:5] - terms @ bend).T), axis=0)
            good &= off < max(4.0 * np.median(off[good]), 1.0)
        mixture.bend[m] = bend


def _learnt(made: _Round, first: Mixture, mixture: Mixture, local: bool, rng: np.random.Generator) -> Mixture:
    """The mixture with the moments of the weighted draws, each draw shared out among the components that may have made it."""
    weight = made.log_weight - made.log_weight.max()
    cut = logsumexp(weight) - np.log(len(weight)) / 2  # no draw counts for more than a root of their number
    weight = np.exp(np.minimum(weight, cut))
    share = np.exp(made.parts - logsumexp(made.parts, axis=1, keepdims=True)) * (weight / weight.sum())[:, None]
    used = np.flatnonzero(share.sum(axis=0) > 1e-4)
    means, covariances, masses = [], [], []
    for m in used:
        part, mass = share[:, m] / share[:, m].sum(), share[:, m].sum()
        x = mixture.coordinates(made.state, int(m))
        keep = min(1.0, 1.0 / np.sum(part**2) / (4.0 * x.shape[1]))  # few draws move little
        mean = keep * (part @ x) + (1 - keep) * mixture.mean[m]
        spread = np.einsum("n,ni,nj->ij", part, x - mean, x - mean)
        means.append(mean)
        covariances.append(keep * spread + (1 - keep) * mixture.covariance[m])
        masses.append(mass)
    origin, mean, learnt, shares = used, np.array(means), np.array(covariances), np.array(masses) / np.sum(masses)
    if local:
        pick = rng.choice(len(weight), LOCAL, p=weight / weight.sum())
        owner = np.argmax(share[np.ix_(pick, used)], axis=1)
        points = [mixture.coordinates(made.state.take(pick[[i]]), int(used[o]))[0] for i, o in enumerate(owner)]
        origin, mean = np.concatenate([used, used[owner]]), np.concatenate([mean, points])
        learnt = np.concatenate([learnt, LOCAL_SHRINK * learnt[owner]])
        shares = np.concatenate([0.4 * shares, np.full(LOCAL, 0.6 / LOCAL)])
    learnt = learnt + 1e-9 * np.einsum("mii,ij->mij", learnt, np.eye(learnt.shape[1]))
    return Mixture(
        State.joined([first.centre, mixture.centre.take(origin)]), np.concatenate([first.basis, mixture.basis[origin]]),
        np.concatenate([first.bend, mixture.bend[origin]]), np.concatenate([first.mean, mean]),
        np.concatenate([2.0 * first.covariance, learnt]),
        np.concatenate([DEFENCE * first.weight, (1 - DEFENCE) * shares / shares.sum()]), mixture.moving,
    )  # fmt: skip


def _regions(made: _Round, mixture: Mixture) -> tuple[np.ndarray, np.ndarray]:
    """The region of each draw (n) and of each component (m; -1: none of weight)."""
    weight = np.exp(made.log_weight - logsumexp(made.log_weight))
    share = np.exp(made.parts - logsumexp(made.parts, axis=1, keepdims=True))
    mass = weight @ share
    overlap = np.einsum("n,ni,nj->ij", weight, share, share)
    alike = overlap > CONNECTED * np.maximum(np.minimum(mass[:, None], mass[None, :]), 1e-300)
    alike[mass < 1e-12] = False
    alike[:, mass < 1e-12] = False
    label = np.arange(len(mass))
    for i in range(len(mass)):
        for j in np.flatnonzero(alike[i]):
            label[label == label[j]] = label[i]
    of_draw = label[np.argmax(made.parts, axis=1)]
    names, inverse = np.unique(of_draw, return_inverse=True)
    order = np.argsort(-np.bincount(inverse, weights=weight), kind="stable")
    rank = np.empty(len(names), dtype=np.int64)
    rank[order] = np.arange(len(names))
    place = {int(name): int(rank[i]) for i, name in enumerate(names)}
    return rank[inverse], np.array([place.get(int(name), -1) for name in label])


def resampled(log_weight: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    """Indices (n) of draws of equal weight, systematic, in a random order."""
    edges = np.cumsum(np.exp(log_weight - logsumexp(log_weight)))
    which = np.minimum(np.searchsorted(edges, (np.arange(n) + rng.random()) / n * edges[-1]), len(edges) - 1)
    return rng.permutation(which)


