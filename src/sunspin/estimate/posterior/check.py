"""Would readings like these come from the posterior? Replicated readings, what noise they need, and which panels contradict."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sunspin.estimate.posterior.data import BEYOND_LARGEST, Readings
from sunspin.estimate.posterior.likelihood import DARK_OUTLIER, OUTLIERS, Likelihood
from sunspin.estimate.posterior.model import State
from sunspin.estimate.posterior.tags import tagged, tags_wanted, turned

DRAWS, COPIES = 100, 10
"""Draws of the posterior that are checked, and replicated sets of readings of each."""


@dataclass(frozen=True)
class Check:
    """`p`: part of replicated readings that fit their motion worse than the real ones do; `noise_sigmas`: how far the noise is
    from what was stated, in its prior's sigmas; `outliers` (K, P): probability that a reading is none of the Sun's; `tag_p`: part
    of replicated readings in which errors of time tags, said to be exact, explain as much, and `tag_s`: how large (s) they would
    be; 1 and 0 where a sigma of time was given."""

    p: float
    noise_sigmas: float
    outliers: np.ndarray
    tag_p: float
    tag_s: float


def check(likelihood: Likelihood, state: State, rng: np.random.Generator) -> Check:
    """Compare readings with copies drawn under hypotheses `state` (equal weights)."""
    part = state.take(np.arange(min(DRAWS, len(state))))
    prediction = likelihood.predict(part)
    u, noise, tag, data = (
        part.u,
        likelihood.noise(part.u),
        likelihood.model.time_sigma_s,
        likelihood.data,
    )
    real = likelihood.samples(prediction, u).sum(axis=1)
    gain, size = (
        (np.zeros(len(part)), np.zeros(len(part)))
        if tag
        else tags_wanted(likelihood, prediction, u)
    )
    worse, as_much = [], []
    for _ in range(COPIES):
        shift = (
            tag * rng.standard_normal(prediction.sun.shape[:2])
            if tag
            else np.zeros(prediction.sun.shape[:2])
        )
        power = likelihood.power(turned(prediction.sun, prediction.rate, shift), u)
        value, lit = _replicated(data, power, noise, rng)
        # readings of their own for each draw: (n, K, P), where there is one set for all otherwise
        copy = Likelihood(
            likelihood.model,
            replace(data, value=value, lit=lit & data.used),
            likelihood.direction_error,
        )
        worse.append(copy.samples(prediction, u).sum(axis=1) <= real)
        as_much.append(gain <= (0.0 if tag else tags_wanted(copy, prediction, u)[0]))
    places = likelihood.model.where("noise")
    sigmas = float(state.u[:, places[0]].mean()) if places else 0.0
    best = tagged(likelihood, prediction, u, tag)[1] if tag else np.zeros(prediction.sun.shape[:2])
    power = likelihood.power(turned(prediction.sun, prediction.rate, best), u)
    doubt = np.exp(likelihood.outlier - likelihood.readings(power, noise)).mean(axis=0)
    outliers = np.where(data.used, np.minimum(doubt, 1.0), 0.0)
    return Check(
        float(np.mean(worse)), sigmas, outliers, float(np.mean(as_much)), float(np.median(size))
    )


def _replicated(
    data: Readings, power: np.ndarray, noise: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Readings (n, K, P) as the model makes them, and which of them are lit."""
    shape = power.shape
    value = np.where(power > 0, power + noise[:, None] * rng.standard_normal(shape), 0.0)
    wrong = rng.random(shape) < OUTLIERS
    other = np.where(
        rng.random(shape) < DARK_OUTLIER, 0.0, rng.random(shape) * BEYOND_LARGEST * data.largest
    )
    value = np.where(wrong, other, value)
    return value, value > data.threshold
