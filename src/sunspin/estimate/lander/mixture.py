"""Draws of a lander's posterior under all models together, and their states at the first sample."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree
from scipy.special import logsumexp

from sunspin.estimate.lander.fit import FINAL_ERROR
from sunspin.estimate.lander.model import LanderModel
from sunspin.estimate.lander.motions import RATE, Draws, LanderMotions, ModelFit
from sunspin.estimate.lander.sample import Checked, predictive_check
from sunspin.estimate.lander.target import LanderTarget
from sunspin.estimate.settings import SAMPLING, SamplingSettings
from sunspin.solve.weights import effective_draws, pareto_tail

COMPARED = 10.0
"""A region is compared with those of other models if it has this many times the probability below which a model is left out. Mean
and covariance of fewer draws say nothing."""


class First(NamedTuple):
    """Motions (n) at the first sample, in body axes then.

    `omega` (n, 3) in rad/s, `sun` (n, 3), speeds of the `wheels` (n, n_wheel) in rad/s, and `steady` (n, 2, 3): constant torques in
    body axes and in space, over the mean moment of inertia, in rad/s2.
    """

    omega: np.ndarray
    sun: np.ndarray
    wheels: np.ndarray
    steady: np.ndarray


def at_first_sample(model: LanderModel, motions: LanderMotions) -> First:
    """Return motions at the first sample, carried there from the reference."""
    rows, steady = model.rows(motions), model.steady_torques(motions.u)
    if not model.after_s:
        return First(motions.omega, motions.sun, rows.wheel_speed_rad_s, steady)
    back = model.run(rows, np.array([-model.after_s]), FINAL_ERROR, attitude=True)
    # components, in the body axes of then, of the torque that is constant in space
    steady[:, 1] = np.einsum("nij,nj->ni", back.attitude[:, 0], steady[:, 1])
    return First(back.omega_B[:, 0], back.sun_B[:, 0], back.wheel_speed_rad_s[:, 0], steady)


def mixed(drawn: Sequence[Draws], reach_s: float, s: SamplingSettings = SAMPLING) -> Draws:
    """Return the draws of several models together, weighed by the evidence of each; the first is the nominal one.

    Other models of negligible probability are left out. Regions of two models become one if the alternative model may have moved
    the one to the other; `reach_s`: longest time from the reference to a sample, over which a difference of rates acts.
    """
    evidence = np.array([draws.evidence for draws in drawn])
    probability = np.exp(evidence - logsumexp(evidence))  # of each model
    models = [m for m in range(len(drawn)) if m == 0 or probability[m] > s.no_weight]
    # the weights of each model's draws, whose mean is its evidence, are divided by their number, so that their sum is
    log_weight = np.concatenate([drawn[m].log_weight - np.log(len(drawn[m])) for m in models])
    share = np.exp(log_weight - logsumexp(log_weight))
    region = _regions_of_models(drawn, probability, models, reach_s, s)
    # regions are numbered by falling probability, and all motions get as many unknowns as the largest model has
    rank = np.argsort(np.argsort(-np.bincount(region, weights=share), kind="stable"))
    motions = [drawn[m].motions for m in models]
    count = max(some.u.shape[1] for some in motions)
    wide = [some.with_unknowns(np.arange(some.u.shape[1]), count) for some in motions]
    return Draws(
        motions=LanderMotions.joined(wide),
        log_weight=log_weight + np.log(len(log_weight)),
        of_model=np.repeat(models, [len(some) for some in motions]),
        region=rank[region],
        effective=effective_draws(share),
        tail=pareto_tail(log_weight),
        evidence=float(logsumexp(log_weight)),
        rounds=np.concatenate([draws.rounds for draws in drawn]),
    )


def _regions_of_models(
    drawn: Sequence[Draws],
    probability: np.ndarray,
    models: list[int],
    reach_s: float,
    s: SamplingSettings,
) -> np.ndarray:
    """Return the region of each draw of some models, one model after the other, numbered over all models.

    `probability`: of each model. From the most probable model on, a region is either one of those of earlier models, or a new one.
    A region is described by mean (6) and covariance (6, 6) of its rate times `reach_s` (rad) and of its direction to the Sun.
    """
    known: list[tuple[np.ndarray, np.ndarray]] = []

    def squared_distance(mean: np.ndarray, covariance: np.ndarray, number: int) -> float:
        """Return that of a known region: in sigmas of the wider one, or in the largest change by another model if less."""
        off, wider = mean - known[number][0], max((covariance, known[number][1]), key=np.trace)
        turn, sun = np.linalg.norm(off[RATE]) / s.bent_rad, np.linalg.norm(off[3:]) / s.sun_rad
        by_model = float(max(turn, sun)) ** 2 * s.one_region
        return min(float(off @ np.linalg.solve(wider, off)), by_model)

    of_draws: dict[int, np.ndarray] = {}
    for m in sorted(models, key=lambda m: -probability[m]):
        draws, earlier = drawn[m], len(known)
        share = draws.probability
        number_of = np.zeros(draws.region.max(initial=0) + 1, dtype=np.int64)  # by the model's own
        for region in range(len(number_of)):
            inside = draws.region == region
            mass = share[inside].sum()
            weight = share[inside] / max(mass, 1e-300)
            omega, sun = draws.motions.omega[inside], draws.motions.sun[inside]
            x = np.concatenate([reach_s * omega, sun], axis=1)
            mean = weight @ x
            covariance = np.einsum("n,ni,nj->ij", weight, x - mean, x - mean) + 1e-6 * np.eye(6)
            distances = []
            if probability[m] * mass > COMPARED * s.no_weight:
                distances = [squared_distance(mean, covariance, k) for k in range(earlier)]
            if distances and min(distances) < s.one_region:
                number_of[region] = int(np.argmin(distances))
            else:
                number_of[region] = len(known)
                known.append((mean, covariance))
        of_draws[m] = number_of[draws.region]
    return np.concatenate([of_draws[m] for m in models])


@dataclass(frozen=True)
class Mixture:
    """Draws (n) of all models together, weighed by evidence.

    `fits` (h): the models with the motions about which they were drawn, the nominal one first; `probability` (h) of each model;
    `starts`: how many starts of the search led to each region; `workers`: threads that evaluate draws.
    """

    fits: tuple[ModelFit, ...]
    draws: Draws
    probability: np.ndarray
    starts: np.ndarray
    workers: int = 1

    @classmethod
    def of(cls, fits: Sequence[ModelFit], s: SamplingSettings, workers: int = 1) -> Mixture:
        """Return the draws of models together."""
        drawn, reach_s = [fit.drawn for fit in fits], fits[0].model.reach_s
        draws = mixed(drawn, reach_s, s)
        evidence = np.array([of_model.evidence for of_model in drawn])
        probability = np.exp(evidence - logsumexp(evidence))
        return cls(tuple(fits), draws, probability, _starts(fits, draws, reach_s), workers)

    @property
    def nominal(self) -> LanderModel:
        """Return the nominal model."""
        return self.fits[0].model

    @cached_property
    def share(self) -> np.ndarray:
        """Return the probability (r) of each region."""
        return np.bincount(self.draws.region, weights=self.draws.probability)

    def inside(self, region: int) -> np.ndarray:
        """Return the indices of the draws of a region."""
        return np.flatnonzero(self.draws.region == region)

    def effective(self, region: int) -> float:
        """Return the effective sample size of a region."""
        own = self.draws.log_weight[self.inside(region)]
        return effective_draws(np.exp(own - logsumexp(own)))

    def by_model(
        self, index: np.ndarray
    ) -> Iterator[tuple[LanderModel, np.ndarray, LanderMotions]]:
        """Yield each model of the draws `index` (n), with the positions of its draws in `index`, and their motions."""
        for h in np.unique(self.draws.of_model[index]):
            model = self.fits[h].model
            rows = np.flatnonzero(self.draws.of_model[index] == h)
            motions = self.draws.motions.take(index[rows])
            yield model, rows, replace(motions, u=motions.u[:, : len(model.unknowns)])

    def each_once(
        self,
        index: np.ndarray,
        evaluate: Callable[[LanderModel, LanderMotions], Sequence[np.ndarray]],
    ) -> list[np.ndarray]:
        """Return the arrays (n, ...) of a function of a model and its motions for the draws `index` (n), which may be repeated.

        Each draw is evaluated once, and models at the same time if there are several workers.
        """
        once, place = np.unique(index, return_inverse=True)
        parts = list(self.by_model(once))
        with ThreadPoolExecutor(min(self.workers, len(parts))) as pool:
            values = list(pool.map(lambda part: evaluate(part[0], part[2]), parts))
        place = np.argsort(np.concatenate([rows for _, rows, _ in parts]))[place]
        return [np.concatenate(arrays)[place] for arrays in zip(*values, strict=True)]

    def first(self, index: np.ndarray) -> First:
        """Return draws at the first sample."""
        return First(*self.each_once(index, at_first_sample))

    def values(self, index: np.ndarray) -> dict[str, np.ndarray]:
        """Return the unknowns of the nominal model, each (n) in its own unit, by name."""
        values = {unknown.name: np.zeros(len(index)) for unknown in self.nominal.unknowns}
        for model, rows, motions in self.by_model(index):
            for unknown, value in zip(model.unknowns, model.values(motions.u).T, strict=True):
                if unknown.name in values:
                    values[unknown.name][rows] = value
        return values

    def log_likelihood(self, index: np.ndarray) -> np.ndarray:
        """Return the log likelihood (n) of draws."""

        def of_model(model: LanderModel, motions: LanderMotions) -> tuple[np.ndarray]:
            target = LanderTarget(model)
            return (target.log_likelihood(target.track(motions), motions.u),)

        return self.each_once(index, of_model)[0]

    def checked(
        self, picked: np.ndarray, rng: np.random.Generator, s: SamplingSettings
    ) -> tuple[Checked, np.ndarray]:
        """Return the predictive check of draws of equal weight, and the probability (n, p) of readings to be outliers."""
        p, noise_sigmas, outliers = 0.0, 0.0, np.zeros(self.nominal.panels.used.shape)
        for model, rows, motions in self.by_model(picked):
            part, target = len(rows) / len(picked), LanderTarget(model)
            check = predictive_check(target, motions, rng, s)
            p += part * check.p
            noise_sigmas += part * check.noise_sigmas
            outliers += part * target.outlier_probability(motions.take(slice(0, s.checked)))
        return Checked(p, noise_sigmas), outliers


def _starts(fits: Sequence[ModelFit], draws: Draws, reach_s: float) -> np.ndarray:
    """Return how many starts of the search led to each region: the largest number under any of the models.

    A fitted motion belongs to the region of the draw of its model that is nearest to it, as a turn within `reach_s`, the longest
    time from the reference to a sample.
    """
    most = np.zeros(draws.region.max(initial=0) + 1, dtype=np.int64)
    for h in np.unique(draws.of_model):
        of_model = np.flatnonzero(draws.of_model == h)
        drawn, fitted = (
            np.concatenate([reach_s * motions.omega, motions.sun], axis=1)
            for motions in (draws.motions.take(of_model), fits[h].motions)
        )
        nearest = of_model[KDTree(drawn).query(fitted)[1]]
        starts = np.bincount(
            draws.region[nearest], weights=fits[h].motions.starts, minlength=len(most)
        )
        most = np.maximum(most, starts.astype(np.int64))
    return most
