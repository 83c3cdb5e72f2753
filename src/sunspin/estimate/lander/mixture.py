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
from sunspin.estimate.lander.sample import PredictiveCheck, predictive_check
from sunspin.estimate.lander.target import LanderTarget
from sunspin.estimate.settings import SAMPLING, SamplingSettings
from sunspin.solve.weights import effective_draws, pareto_tail

COMPARED = 10.0
"""A solution is compared with those of other models if it has this many times the probability below which a model is left out. Mean
and covariance of fewer draws say nothing."""


class FirstStates(NamedTuple):
    """States of n motions at the first sample, in body axes of that time.

    `omega` (n, 3) in rad/s, `sun` (n, 3), speeds of the `wheels` (n, n_wheel) in rad/s, and `steady` (n, 2, 3): constant torques in
    body axes and in space, over the mean moment of inertia, in rad/s2.
    """

    omega: np.ndarray
    sun: np.ndarray
    wheels: np.ndarray
    steady: np.ndarray


def at_first_sample(model: LanderModel, motions: LanderMotions) -> FirstStates:
    """Return the states of motions at the first sample, propagated there from the reference."""
    rows, steady = model.rows(motions), model.steady_torques(motions.u)
    if not model.after_s:
        return FirstStates(motions.omega, motions.sun, rows.wheel_speed_rad_s, steady)
    back = model.run(rows, np.array([-model.after_s]), FINAL_ERROR, attitude=True)
    # a torque that is constant in space has components in the reference's body axes: turn them into those of the first sample
    steady[:, 1] = np.einsum("nij,nj->ni", back.attitude[:, 0], steady[:, 1])
    return FirstStates(back.omega_B[:, 0], back.sun_B[:, 0], back.wheel_speed_rad_s[:, 0], steady)


def join_models(
    drawn: Sequence[Draws], reach_s: float, settings: SamplingSettings = SAMPLING
) -> Draws:
    """Return the draws of several models together, weighted by the evidence of each model; the first is the nominal one.

    Other models of negligible probability are left out. Solutions of two models become one if they differ by no more than one
    motion may under two models. The evidence of the result is the sum, not the mean, of those of the models; no
    probability depends on that. `reach_s`: longest time from the reference to a sample.
    """
    evidence = np.array([draws.log_evidence for draws in drawn])
    probability = np.exp(evidence - logsumexp(evidence))  # of each model
    models = [m for m in range(len(drawn)) if m == 0 or probability[m] > settings.no_weight]
    # divide each model's weights by their number: then their sum, not their mean, is its evidence
    log_weight = np.concatenate([drawn[m].log_weight - np.log(len(drawn[m])) for m in models])
    share = np.exp(log_weight - logsumexp(log_weight))
    solution = _labels_over_models(drawn, probability, models, reach_s, settings)
    # number the solutions by falling probability, and give all motions as many unknowns as the largest model has
    rank = np.argsort(np.argsort(-np.bincount(solution, weights=share), kind="stable"))
    motions = [drawn[m].motions for m in models]
    count = max(part.u.shape[1] for part in motions)
    wide = [part.with_unknowns(np.arange(part.u.shape[1]), count) for part in motions]
    return Draws(
        motions=LanderMotions.joined(wide),
        log_weight=log_weight + np.log(len(log_weight)),
        model_index=np.repeat(models, [len(part) for part in motions]),
        solution=rank[solution],
        effective=effective_draws(share),
        pareto_k=pareto_tail(log_weight),
        log_evidence=float(logsumexp(log_weight)),
        rounds=np.concatenate([draws.rounds for draws in drawn]),
    )


def _labels_over_models(
    drawn: Sequence[Draws],
    probability: np.ndarray,
    models: list[int],
    reach_s: float,
    settings: SamplingSettings,
) -> np.ndarray:
    """Return for each draw of the `models`, one model after the other, the index of its solution among those of all models.

    `probability`: of each model. Beginning with the most probable model, each solution either is one that an earlier model has too,
    or is new. Solutions are compared by mean (6) and covariance (6, 6) of the rate times `reach_s` (rad) and of the direction.
    """
    known: list[tuple[np.ndarray, np.ndarray]] = []  # mean and covariance of each solution

    def squared_distance(mean: np.ndarray, covariance: np.ndarray, number: int) -> float:
        """Return the squared distance from a known solution: in sigmas of the wider of the two or, if it is smaller, `by_model`.

        Another model may change a motion by `bent_rad` and `sun_rad`: for a smaller difference `by_model` is below the limit
        `one_region`, and the two are one solution.
        """
        off, wider = mean - known[number][0], max((covariance, known[number][1]), key=np.trace)
        rotation = np.linalg.norm(off[RATE]) / settings.bent_rad
        sun = np.linalg.norm(off[3:]) / settings.sun_rad
        by_model = float(max(rotation, sun)) ** 2 * settings.one_region
        return min(float(off @ np.linalg.solve(wider, off)), by_model)

    of_draws: dict[int, np.ndarray] = {}
    for m in sorted(models, key=lambda m: -probability[m]):
        # solutions are compared with those of the models before this one, not with each other
        draws, earlier = drawn[m], len(known)
        share = draws.probability
        # index among all solutions, by the index among the model's own
        number_of = np.zeros(draws.solution.max(initial=0) + 1, dtype=np.int64)
        for own in range(len(number_of)):
            inside = draws.solution == own
            mass = share[inside].sum()
            weight = share[inside] / max(mass, 1e-300)
            omega, sun = draws.motions.omega[inside], draws.motions.sun[inside]
            x = np.concatenate([reach_s * omega, sun], axis=1)
            mean = weight @ x
            covariance = np.einsum("n,ni,nj->ij", weight, x - mean, x - mean) + 1e-6 * np.eye(6)
            distances = []
            if probability[m] * mass > COMPARED * settings.no_weight:
                distances = [squared_distance(mean, covariance, k) for k in range(earlier)]
            if distances and min(distances) < settings.one_region:
                number_of[own] = int(np.argmin(distances))
            else:
                number_of[own] = len(known)
                known.append((mean, covariance))
        of_draws[m] = number_of[draws.solution]
    return np.concatenate([of_draws[m] for m in models])


@dataclass(frozen=True)
class Mixture:
    """Draws of all models together, weighted by evidence.

    `fits` (h): the models with the motions about which they were drawn, the nominal one first; `probability` (h) of each model;
    `starts` (r): how many starts of the search led to each solution; `workers`: threads that evaluate draws.
    """

    fits: tuple[ModelFit, ...]
    draws: Draws
    probability: np.ndarray
    starts: np.ndarray
    workers: int = 1

    @classmethod
    def of(cls, fits: Sequence[ModelFit], settings: SamplingSettings, workers: int = 1) -> Mixture:
        """Return the draws of several fitted models together; each fit has draws."""
        drawn, reach_s = [fit.drawn for fit in fits], fits[0].model.reach_s
        draws = join_models(drawn, reach_s, settings)
        evidence = np.array([of_model.log_evidence for of_model in drawn])
        probability = np.exp(evidence - logsumexp(evidence))
        return cls(tuple(fits), draws, probability, _starts(fits, draws, reach_s), workers)

    @property
    def nominal(self) -> LanderModel:
        """Return the nominal model."""
        return self.fits[0].model

    @cached_property
    def share(self) -> np.ndarray:
        """Return the probability (r) of each solution."""
        return np.bincount(self.draws.solution, weights=self.draws.probability)

    def inside(self, solution: int) -> np.ndarray:
        """Return the indices of the draws of a solution."""
        return np.flatnonzero(self.draws.solution == solution)

    def effective(self, solution: int) -> float:
        """Return the effective sample size of a solution."""
        own = self.draws.log_weight[self.inside(solution)]
        return effective_draws(np.exp(own - logsumexp(own)))

    def by_model(
        self, index: np.ndarray
    ) -> Iterator[tuple[LanderModel, np.ndarray, LanderMotions]]:
        """Yield each model that the draws `index` (n) have, the positions in `index` of its draws, and their motions."""
        for h in np.unique(self.draws.model_index[index]):
            model = self.fits[h].model
            positions = np.flatnonzero(self.draws.model_index[index] == h)
            motions = self.draws.motions.take(index[positions])
            yield model, positions, replace(motions, u=motions.u[:, : len(model.unknowns)])

    def evaluate(
        self,
        index: np.ndarray,
        function: Callable[[LanderModel, LanderMotions], Sequence[np.ndarray]],
    ) -> list[np.ndarray]:
        """Return the arrays (n, ...) that `function` computes for the draws with the indices `index` (n), in this order.

        `function` takes a model and k motions of it, and returns arrays (k, ...). It is called once for each model, in parallel
        threads if `workers` allows, and gets each draw once even if `index` repeats it.
        """
        distinct, place_in_distinct = np.unique(index, return_inverse=True)
        parts = list(self.by_model(distinct))
        with ThreadPoolExecutor(min(self.workers, len(parts))) as pool:
            values = list(pool.map(lambda part: function(part[0], part[2]), parts))
        # The values come one model after the other. `row_of_distinct`: where among them each draw of `distinct` is.
        row_of_distinct = np.argsort(np.concatenate([positions for _, positions, _ in parts]))
        rows = row_of_distinct[place_in_distinct]
        return [np.concatenate(arrays)[rows] for arrays in zip(*values, strict=True)]

    def first_states(self, index: np.ndarray) -> FirstStates:
        """Return the states of the draws `index` (n) at the first sample."""
        return FirstStates(*self.evaluate(index, at_first_sample))

    def unknown_values(self, index: np.ndarray) -> dict[str, np.ndarray]:
        """Return the unknowns of the nominal model for the draws `index` (n): name -> values (n) in the unit of the unknown."""
        values = {unknown.name: np.zeros(len(index)) for unknown in self.nominal.unknowns}
        for model, positions, motions in self.by_model(index):
            for unknown, value in zip(model.unknowns, model.values(motions.u).T, strict=True):
                if unknown.name in values:
                    values[unknown.name][positions] = value
        return values

    def log_likelihood(self, index: np.ndarray) -> np.ndarray:
        """Return the log likelihood (n) of the draws `index` (n)."""

        def of_model(model: LanderModel, motions: LanderMotions) -> tuple[np.ndarray]:
            target = LanderTarget(model)
            return (target.log_likelihood(target.track(motions), motions.u),)

        return self.evaluate(index, of_model)[0]

    def check(
        self, picked: np.ndarray, rng: np.random.Generator, settings: SamplingSettings
    ) -> tuple[PredictiveCheck, np.ndarray]:
        """Return the predictive check, and for each reading (n, p) the probability that it is an outlier.

        `picked`: indices of draws of equal weight. Each model counts by its share of these.
        """
        p, noise_sigmas, outliers = 0.0, 0.0, np.zeros(self.nominal.panels.used.shape)
        for model, positions, motions in self.by_model(picked):
            part, target = len(positions) / len(picked), LanderTarget(model)
            of_model = predictive_check(target, motions, rng, settings)
            p += part * of_model.p
            noise_sigmas += part * of_model.noise_sigmas
            outliers += part * target.outlier_probability(motions.take(slice(0, settings.checked)))
        return PredictiveCheck(p, noise_sigmas), outliers


def _starts(fits: Sequence[ModelFit], draws: Draws, reach_s: float) -> np.ndarray:
    """Return how many starts of the search led to each solution (r): the largest number under any of the models.

    A fitted motion belongs to the solution of the draw of its model that is nearest to it in direction (rad) and in rate times
    `reach_s` (rad), the longest time from the reference to a sample.
    """
    most = np.zeros(draws.solution.max(initial=0) + 1, dtype=np.int64)
    for h in np.unique(draws.model_index):
        of_model = np.flatnonzero(draws.model_index == h)
        drawn, fitted = (
            np.concatenate([reach_s * motions.omega, motions.sun], axis=1)
            for motions in (draws.motions.take(of_model), fits[h].motions)
        )
        nearest = of_model[KDTree(drawn).query(fitted)[1]]
        starts = np.bincount(
            draws.solution[nearest], weights=fits[h].motions.starts, minlength=len(most)
        )
        most = np.maximum(most, starts.astype(np.int64))
    return most
