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

from sunspin.dynamics import batch
from sunspin.estimate.lander.fit import FINAL_ERROR
from sunspin.estimate.lander.model import LanderModel
from sunspin.estimate.lander.motions import Draws, LanderMotions, ModelFit
from sunspin.estimate.lander.sample import Checked, mixed, predictive_check
from sunspin.estimate.lander.target import LanderTarget
from sunspin.estimate.settings import SamplingSettings
from sunspin.solve.weights import effective_draws


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
    back = batch.run(
        model.vehicle,
        rows,
        [-model.after_s],
        command=model.wheel_mode,
        error=FINAL_ERROR,
        acting=model.acting,
        attitude=True,
        leave_long=True,
    )
    # components, in the body axes of then, of the torque that is constant in space
    steady[:, 1] = np.einsum("nij,nj->ni", back.attitude[:, 0], steady[:, 1])
    return First(back.omega_B[:, 0], back.sun_B[:, 0], back.wheel_speed_rad_s[:, 0], steady)


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
    def of(
        cls, fits: list[ModelFit], drawn: list[Draws], reach_s: float, s: SamplingSettings
    ) -> Mixture:
        """Return the draws of models together."""
        log_priors = [fit.model.log_prior for fit in fits]
        draws = mixed(drawn, log_priors, reach_s, s)
        log_mass = np.array([of_model.evidence for of_model in drawn]) + np.array(log_priors)
        probability = np.exp(log_mass - logsumexp(log_mass))
        return cls(tuple(fits), draws, probability, _starts(fits, draws, reach_s))

    @property
    def nominal(self) -> LanderModel:
        """Return the nominal model."""
        return self.fits[0].model

    @cached_property
    def share(self) -> np.ndarray:
        """Return the probability (r) of each region."""
        weight = np.exp(self.draws.log_weight - logsumexp(self.draws.log_weight))
        return np.bincount(self.draws.region, weights=weight)

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
            places = np.flatnonzero(self.draws.of_model[index] == h)
            motions = self.draws.motions.take(index[places])
            yield model, places, replace(motions, u=motions.u[:, : len(model.unknowns)])

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
        place = np.argsort(np.concatenate([places for _, places, _ in parts]))[place]
        return [np.concatenate(arrays)[place] for arrays in zip(*values, strict=True)]

    def first(self, index: np.ndarray) -> First:
        """Return draws at the first sample."""
        return First(*self.each_once(index, at_first_sample))

    def values(self, index: np.ndarray) -> dict[str, np.ndarray]:
        """Return the unknowns of the nominal model, each (n) in its own unit, by name."""
        values = {unknown.name: np.zeros(len(index)) for unknown in self.nominal.unknowns}
        for model, places, motions in self.by_model(index):
            for unknown, value in zip(model.unknowns, model.values(motions.u).T, strict=True):
                if unknown.name in values:
                    values[unknown.name][places] = value
        return values

    def log_likelihood(self, index: np.ndarray) -> np.ndarray:
        """Return the log likelihood (n) of draws."""

        def of_model(model: LanderModel, motions: LanderMotions) -> tuple[np.ndarray]:
            target = LanderTarget(model)
            return (target.log_likelihood(target.run(motions), motions.u),)

        return self.each_once(index, of_model)[0]

    def checked(
        self, picked: np.ndarray, rng: np.random.Generator, s: SamplingSettings
    ) -> tuple[Checked, np.ndarray]:
        """Return the predictive check of draws of equal weight, and the probability (n, p) of readings to be outliers."""
        p, noise_sigmas, outliers = 0.0, 0.0, np.zeros(self.nominal.panels.used.shape)
        for model, places, motions in self.by_model(picked):
            part, target = len(places) / len(picked), LanderTarget(model)
            check = predictive_check(target, motions, rng, s)
            p += part * check.p
            noise_sigmas += part * check.noise_sigmas
            outliers += part * target.outlier_probability(motions.take(slice(0, s.checked)))
        return Checked(p, noise_sigmas), outliers


def _starts(fits: list[ModelFit], draws: Draws, reach_s: float) -> np.ndarray:
    """Return how many starts of the search led to each region, under the model under which most did.

    A fitted motion belongs to the region of the draw of its model that is nearest to it, as a turn within the window.
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
