"""Would readings like these come from the posterior? Replicated readings, what noise they need, and which panels contradict."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sunspin.infer.posterior_data import BEYOND_LARGEST, Readings
from sunspin.infer.posterior_likelihood import DARK_OUTLIER, OUTLIERS, Likelihood
from sunspin.infer.posterior_model import State

DRAWS, COPIES = 100, 10
"""Draws of the posterior that are checked, and replicated sets of readings of each."""


@dataclass(frozen=True)
class Check:
    """`p`: part of replicated readings that fit their motion worse than the real ones do; `noise_sigmas`: how far the noise is
    from what was stated, in its prior's sigmas; `outliers` (K, P): probability that a reading is none of the Sun's."""

    p: float
    noise_sigmas: float
    outliers: np.ndarray


def check(likelihood: Likelihood, state: State, rng: np.random.Generator) -> Check:
    """Compare readings with copies drawn under hypotheses `state` (equal weights)."""
    part = state.take(np.arange(min(DRAWS, len(state))))
    prediction = likelihood.predict(part)
    u, noise = part.u, likelihood.noise(part.u)
    middle = prediction.sun[:, :, likelihood.middle, None]
    power = likelihood.power(middle, u)
    measured = likelihood.readings(power, noise)[:, :, 0]
    data = likelihood.data
    real = -np.where(data.used, measured, 0.0).sum(axis=(1, 2))
    worse = []
    for _ in range(COPIES):
        copy, lit = _replicated(likelihood, power[:, :, 0], noise, rng)
        worse.append(-_densities(data, likelihood, copy, lit, power[:, :, 0], noise).sum(axis=(1, 2)) >= real)
    places = likelihood.model.where("noise")
    sigmas = float(state.u[:, places[0]].mean()) if places else 0.0
    doubt = np.exp(likelihood.outlier - measured).mean(axis=0)
    return Check(float(np.mean(worse)), sigmas, np.where(data.used, np.minimum(doubt, 1.0), 0.0))


def _replicated(
    likelihood: Likelihood, power: np.ndarray, noise: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Readings (n, K, P) as the model makes them, and which of them are lit."""
    data, shape = likelihood.data, power.shape
    value = np.where(power > 0, power + noise[:, None, None] * rng.standard_normal(shape), 0.0)
    wrong = rng.random(shape) < OUTLIERS
    other = np.where(rng.random(shape) < DARK_OUTLIER, 0.0, rng.random(shape) * BEYOND_LARGEST * data.largest)
    value = np.where(wrong, other, value)
    return value, value > data.threshold


def _densities(
    data: Readings, likelihood: Likelihood, value: np.ndarray, lit: np.ndarray, power: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """Log density (n, K, P) of readings that differ from draw to draw."""
    out = np.empty(power.shape)
    for i in range(len(power)):
        one = Likelihood(likelihood.model, replace(data, value=value[i], lit=lit[i] & data.used), likelihood.direction_error)
        out[i] = one.readings(power[i][:, None, :], noise[[i]][0])[:, 0]
    return np.where(data.used, out, 0.0)

