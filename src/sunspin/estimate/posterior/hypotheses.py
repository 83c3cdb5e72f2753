"""What may be wrong with the model behind a posterior: each hypothesis is sampled beside the model as stated, and evidence decides.

A steady torque in body axes or in space, of a size that nobody knows even to a power of ten; and moments of inertia several times
less certain than stated. Modes are found without them and fitted anew under each. A torque of a few degrees over the window is
taken up by inertia and friction, so readings that the stated model fits do not exclude it: the doubt that is left is in the draws.
Where that model does not fit, or another is far likelier, motions are searched for under the torques from the first samples on.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from sunspin.estimate.posterior.importance import Sample
from sunspin.estimate.posterior.likelihood import Likelihood
from sunspin.estimate.posterior.model import Model, State, pushed
from sunspin.estimate.posterior.modes import Modes, Plan, Search, distinct, within
from sunspin.estimate.terms.steady_torque import WORDS
from sunspin.solve.weights import effective_draws, pareto_tail

STATED = "as stated"

LOOSER, LOOSER_CHANCE = 5.0, 0.05
"""How many times less certain moments of inertia may be than stated, and how likely that is beside the model as stated."""

SEARCHED = 4
"""Which of the sigmas of a steady torque a search is under: less holds it where it does not act, more lets any motion pass."""

ASKED_P, ASKED_NOISE, ASKED_WEIGHT = 0.05, 2.0, 0.1
"""Readings this unlikely under the model as stated, noise this far from its prior (in its sigmas), or so little weight left to that
model call for a search under torques."""

NO_CHANCE = (6.0, 12.0)
"""Log evidence, by Laplace's method, by which looser moments of inertia and a torque may be worse than the best and be sampled."""

NO_WEIGHT = 1e-5
"""A hypothesis with less weight is left out, a region with less than ten times that is matched with no other."""

ONE_REGION, BENT_RAD, SUN_RAD = 9.0, 1.0, 0.3
"""Squared distance, in sigmas of the wider, below which regions under two hypotheses are one; and what a hypothesis may bend a
motion by within the window, and at the reference: another motion differs by more, mostly by whole turns."""


@dataclass(frozen=True)
class Hypothesis:
    """A model against readings, in words, the log of its prior weight beside the model as stated, and its modes."""

    what: str
    log_prior: float
    likelihood: Likelihood
    modes: Modes

    def tagged(self, time_sigma_s: float) -> Hypothesis:
        """The same with errors of the time tags."""
        model = replace(self.likelihood.model, time_sigma_s=time_sigma_s)
        return replace(self, likelihood=replace(self.likelihood, model=model))


class First(NamedTuple):
    """Motions (n) at the first sample: rates, directions, wheel speeds, and the steady torques (n, 2, 3) in body axes and in space,
    both in body axes then, in rad/s2 over the mean moment of inertia."""

    omega: np.ndarray
    sun: np.ndarray
    wheels: np.ndarray
    steady: np.ndarray


def others(first: Sampled, search: Search, most_deg: float) -> Iterator[Hypothesis]:
    """The other hypotheses, fitted from the best mode of each ridge under the model as stated, and from what fits worse than modes
    do."""
    likelihood, modes, ridge = (
        first.hypothesis.likelihood,
        first.hypothesis.modes,
        first.drawn.ridge,
    )
    best = np.unique(ridge, return_index=True)[1]
    parts = [
        (
            modes.state.take(best),
            np.bincount(ridge, weights=modes.hits).astype(np.int64)[ridge[best]],
        )
    ]
    parts += [] if modes.beyond is None else [modes.beyond]
    starts = State.joined([part for part, _ in parts]), np.concatenate([hits for _, hits in parts])

    def under(model: Model, what: str, log_prior: float, state: State) -> Hypothesis:
        other = replace(likelihood, model=model)
        found = search.refined(other, state, starts[1], list(modes.trace), list(modes.notes))
        return Hypothesis(what, log_prior, other, within(found, model.max_rate))

    model = likelihood.model
    if most_deg:
        for frame, words in WORDS.items():
            more = pushed(
                model, "B" if frame == "B" else "N", float(np.ptp(likelihood.data.t_s)), most_deg
            )
            still = np.zeros((len(starts[0]), 3))
            state = replace(starts[0], u=np.concatenate([starts[0].u, still], axis=1))
            yield under(more, f"a steady torque in {words}", 0.0, state)
    at = model.where("inertia")
    if at:
        sigma = [LOOSER if x.kind == "inertia" else 1.0 for x in model.unknowns]
        looser = tuple(
            replace(x, sigma=x.sigma * times)
            for x, times in zip(model.unknowns, sigma, strict=True)
        )
        state, chance = (
            replace(starts[0], u=starts[0].u / np.array(sigma)),
            float(np.log(LOOSER_CHANCE)),
        )
        yield under(
            replace(model, unknowns=looser),
            "moments of inertia off by more than stated",
            chance,
            state,
        )


def likely(stated: Hypothesis, every: list[Hypothesis]) -> list[Hypothesis]:
    """The other hypotheses that are worth sampling."""
    mass = [log_mass(one) for one in every]
    best = max([log_mass(stated), *mass])
    limits = [NO_CHANCE[one.likelihood.model.frame != ""] for one in every]
    return [one for one, own, limit in zip(every, mass, limits, strict=True) if own > best - limit]


def log_mass(one: Hypothesis) -> float:
    """The log evidence but for a constant, by Laplace's method at the best mode."""
    least = 1e-9 * np.eye(one.modes.hessian.shape[-1])
    return (
        float(np.max(-one.modes.objective - 0.5 * np.linalg.slogdet(one.modes.hessian + least)[1]))
        + one.log_prior
        - one.likelihood.model.log_truncated
    )


def searched(one: Hypothesis, search: Search, chosen: Plan, scale: float) -> Hypothesis:
    """The same with what a search under its torque finds besides."""
    likelihood = one.likelihood
    share = likelihood.model.shares[min(SEARCHED, len(likelihood.model.shares) - 1)]
    found = search.modes(replace(likelihood.model, share=share), likelihood.data, chosen, scale)
    both = (one.modes, found)
    parts = {
        "omega": [m.state.omega for m in both],
        "sun": [m.state.sun for m in both],
        "u": [m.state.u for m in both],
        "cost": [m.objective for m in both],
        "hessian": [m.hessian for m in both],
        "share": [m.share for m in both],
    }
    every = {name: np.concatenate(values) for name, values in parts.items()}
    hits = np.concatenate([m.hits for m in both])
    return replace(
        one,
        modes=within(
            distinct(every, hits, list(found.trace), list(found.notes), 2),
            likelihood.model.max_rate,
        ),
    )


@dataclass(frozen=True)
class Sampled:
    """A hypothesis and the draws of its posterior."""

    hypothesis: Hypothesis
    drawn: Sample

    @property
    def log_weight(self) -> np.ndarray:
        """Of its draws (n): together they weigh its evidence times its prior."""
        return (
            self.drawn.log_weight - np.log(len(self.drawn.log_weight)) + self.hypothesis.log_prior
        )

    def first(self, index: np.ndarray) -> First:
        """Its draws at the first sample."""
        likelihood, state = self.hypothesis.likelihood, self.drawn.state.take(index)
        model, back = likelihood.model, float(likelihood.data.t_s[0])
        rows, steady = model.rows(state), np.zeros((len(state), 2, 3))
        if model.frame:
            steady[:, "BN".index(model.frame)] = model.relative(state.u, "steady_torque", 3)
        if back == 0.0:
            return First(state.omega, state.sun, rows.wheel_speed_rad_s, steady)
        run = model.run(rows, [back], likelihood.direction_error, attitude=True)
        # the torque that stands in space, as the body sees it there
        steady[:, 1] = np.einsum("nij,nj->ni", run.attitude[:, 0], steady[:, 1])
        return First(run.omega_B[:, 0], run.sun_B[:, 0], run.wheel_speed_rad_s[:, 0], steady)


@dataclass(frozen=True)
class Mixed:
    """Draws of all hypotheses together, as :class:`Sample` has them; `of` (n): which one a draw is of, `row` (n): where there.

    `weight` (h) of each hypothesis, `starts` that led to each region at most. `state` has the unknowns of the model as stated.
    """

    tried: tuple[Sampled, ...]
    weight: np.ndarray
    of: np.ndarray
    row: np.ndarray
    log_weight: np.ndarray
    log_likelihood: np.ndarray
    region: np.ndarray
    share: np.ndarray
    starts: np.ndarray
    effective: float
    tail: float
    evidence: float

    @property
    def trace(self) -> np.ndarray:
        return np.concatenate([one.drawn.trace for one in self.tried])

    @property
    def said(self) -> dict[str, float]:
        """Weights of the hypotheses in words."""
        return {
            one.hypothesis.what: float(weight)
            for one, weight in zip(self.tried, self.weight, strict=True)
        }

    @cached_property
    def state(self) -> State:
        k = len(self.tried[0].hypothesis.likelihood.model.unknowns)
        every = [one.drawn.state for one in self.tried]
        return State.joined([replace(state, u=state.u[:, :k]) for state in every])

    def each(self, index: np.ndarray) -> Iterator[tuple[Sampled, np.ndarray, np.ndarray]]:
        """The hypotheses of draws: each with its places in `index` and its own numbers of them."""
        for h, one in enumerate(self.tried):
            places = np.flatnonzero(self.of[index] == h)
            if len(places):
                yield one, places, self.row[index[places]]

    def first(self, index: np.ndarray) -> First:
        """Draws at the first sample."""
        found: list[np.ndarray] = []
        for one, places, own in self.each(index):
            part = one.first(own)
            found = found or [np.empty((len(index), *x.shape[1:])) for x in part]
            for out, values in zip(found, part, strict=True):
                out[places] = values
        return First(*found)

    def values(self, index: np.ndarray) -> np.ndarray:
        """The unknowns (n, k) of the model as stated in their own units."""
        out = np.empty((len(index), self.state.u.shape[1]))
        for one, places, own in self.each(index):
            out[places] = one.hypothesis.likelihood.model.values(one.drawn.state.u[own])[
                :, : out.shape[1]
            ]
        return out


def mixed(tried: list[Sampled]) -> Mixed:
    """Hypotheses weighed by their evidence, those without weight left out (the first stays); regions that are one joined."""
    evidence = np.array([logsumexp(one.log_weight) for one in tried])
    weight = np.exp(evidence - logsumexp(evidence))
    kept = [0, *(1 + np.flatnonzero(weight[1:] > NO_WEIGHT))]
    tried, weight = [tried[int(i)] for i in kept], weight[kept]
    log_weight = np.concatenate([one.log_weight for one in tried])
    label, starts = _regions(tried, weight)
    share = np.exp(log_weight - logsumexp(log_weight))
    by_region = np.bincount(label, weights=share)
    order = np.argsort(-by_region, kind="stable")
    rank = np.argsort(order, kind="stable")
    sizes = [len(one.drawn.log_weight) for one in tried]
    return Mixed(
        tuple(tried),
        weight,
        np.repeat(np.arange(len(tried)), sizes),
        np.concatenate([np.arange(n) for n in sizes]),
        log_weight,
        np.concatenate([one.drawn.log_likelihood for one in tried]),
        rank[label],
        by_region[order],
        starts[order],
        effective_draws(share),
        pareto_tail(log_weight),
        float(logsumexp(log_weight)),
    )


def _regions(tried: list[Sampled], weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The region of each draw of all hypotheses, and the starts that led to each at most.

    Hypotheses follow by falling weight; a region is that of an earlier one whose rates and direction are the nearest, if they are
    near enough, else its own. So none joins two of an earlier hypothesis.
    """
    known: list[tuple[np.ndarray, np.ndarray]] = []
    starts: list[int] = []
    labels: dict[int, np.ndarray] = {}
    for h in np.argsort(-weight, kind="stable"):
        drawn, modes = tried[h].drawn, tried[h].hypothesis.modes
        reach, before = tried[h].hypothesis.likelihood.data.reach_s, len(known)
        place = np.empty(len(drawn.share), dtype=np.int64)
        share = np.exp(drawn.log_weight - logsumexp(drawn.log_weight))
        for r in range(len(drawn.share)):
            inside = drawn.region == r
            x = np.concatenate([drawn.state.omega[inside] * reach, drawn.state.sun[inside]], axis=1)
            part = share[inside] / max(share[inside].sum(), 1e-300)
            mean = part @ x
            spread = np.einsum("n,ni,nj->ij", part, x - mean, x - mean) + 1e-6 * np.eye(6)
            matched = weight[h] * drawn.share[r] > 10 * NO_WEIGHT
            far = [_distance(mean, spread, *other) for other in known[:before]] if matched else []
            led = int(modes.hits[drawn.of_mode == r].sum())
            if far and min(far) < ONE_REGION:
                place[r] = int(np.argmin(far))
                starts[place[r]] = max(starts[place[r]], led)
            else:
                place[r] = len(known)
                known.append((mean, spread))
                starts.append(led)
        labels[int(h)] = place[drawn.region]
    return np.concatenate([labels[h] for h in range(len(tried))]), np.array(starts)


def _distance(
    mean: np.ndarray, spread: np.ndarray, other: np.ndarray, others_spread: np.ndarray
) -> float:
    """Squared distance of two regions in sigmas of the wider, or in what may be one motion bent by a hypothesis if that is less."""
    off, wider = mean - other, max((spread, others_spread), key=np.trace)
    bent = max(float(np.linalg.norm(off[:3])) / BENT_RAD, float(np.linalg.norm(off[3:])) / SUN_RAD)
    return min(float(off @ np.linalg.solve(wider, off)), ONE_REGION * bent**2)
