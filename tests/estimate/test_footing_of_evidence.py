"""Evidences of fits and of oscillations are logs of mean likelihoods of the same readings: against sums over drawn motions."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sunspin.estimate.chain import costs, fit, log_left_out, propagate
from sunspin.estimate.model import Body, Model, Noise, Observations, States, Track
from sunspin.estimate.settings import RATES
from sunspin.estimate.swings import fits_of_oscillation, log_mean_likelihood
from sunspin.estimate.terms.directions import SunDirections
from sunspin.estimate.terms.panels import Panels, ReadingTimes
from sunspin.estimate.terms.term import Residual, facing, gaussian
from sunspin.vehicle.response.flat import PanelResponse
from tests.support.vehicles import CUBE_NORMALS, units

APART_S, COUNT, NOISE = 16.0, 200_000, 1e-4
SPHERE = Body(np.eye(3), np.zeros((0, 3, 3)))
EVERY = replace(RATES.alternatives, hopeless=np.inf)
PARTS = 3
"""Of an interval in which a drawn body wanders: turns by many small turns add up to those of the heat on a sphere."""
CAP_SIGMAS = 5.0
"""First directions are drawn within so many sigmas of the first reading: beyond it none is likely."""


@dataclass(frozen=True)
class NormalDirections(SunDirections):
    """Directions with normal errors, for which Laplace's method is exact but for what bends."""

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the differences, with another law."""
        for one in super().residuals(states, u):
            yield one._replace(law=gaussian)


def model_of(suns, sigma, rate_sigma, of=NormalDirections):
    """Return the model of a sphere whose Sun was read in these directions (n, 3) to `sigma` rad."""
    term = of.of(units(suns), np.tile(sigma**2 * np.eye(3), (len(suns), 1, 1)))
    obs = Observations(APART_S * np.arange(len(suns)), np.zeros((len(suns), 3)), (term,))
    return Model(obs, SPHERE, Noise(NOISE), rate_sigma)


def seen_turning(omega, sigma):
    """Return the Sun (n, 3) that a sphere sees that turns at a rate (3), read to `sigma` rad."""
    turned = Rotation.from_rotvec(-APART_S * np.arange(4)[:, None] * omega)
    return turned.apply([0.36, 0.48, 0.8]) + sigma * np.random.default_rng(3).normal(size=(4, 3))


def best_motion(model, omega):
    """Return the fit of a motion that begins at this rate (3) and the first reading's direction."""
    begin = facing(model.obs.terms[0].direction_B[:1])
    return fit(model, propagate(model, 0, begin, omega[None]), 40, 1e-6)


def mean_likelihood(model, sigma, wander=0.0):
    """Return the log of the mean likelihood over drawn attitudes, rates and ways of a sphere that wanders (rad s^-0.5)."""
    rng = np.random.default_rng(5)
    cap = min(CAP_SIGMAS * sigma, np.pi)
    along, angle = rng.uniform(np.cos(cap), 1.0, COUNT), rng.uniform(0, 2 * np.pi, COUNT)
    across = np.sqrt(1 - along**2)
    in_axes = np.stack([across * np.cos(angle), across * np.sin(angle), along], axis=1)
    suns = [in_axes @ facing(model.obs.terms[0].direction_B[0]).T]
    rate = model.rate_sigma * rng.normal(size=(COUNT, 3))
    parts = PARTS if wander else 1
    for _ in range(len(model.obs) - 1):
        sun, part_s = suns[-1], APART_S / parts
        for _ in range(parts):
            turn = -part_s * rate + wander * np.sqrt(part_s) * rng.normal(size=(COUNT, 3))
            sun = Rotation.from_rotvec(turn).apply(sun)
        suns.append(sun)
    sun = facing(np.stack(suns, axis=1))
    cost = costs(model.obs, Track.free(sun, np.zeros((*sun.shape[:2], 3)))).sum(axis=1)
    return np.log(np.exp(-cost).mean() * (1 - np.cos(cap)) / 2)


@pytest.mark.parametrize("rate_sigma", [0.005, 0.03])
def test_evidence_of_a_rotation_is_its_mean_likelihood(rate_sigma):
    """To 0.3: a rotation that is known to 0.1 rad only bends within its sigma."""
    sigma, omega = 0.15, 0.8 * rate_sigma * np.array([0.6, -0.5, 0.7])
    model = model_of(seen_turning(omega, sigma), sigma, rate_sigma)
    log = best_motion(model, omega).log_evidence[0] - log_left_out(model)
    assert np.isclose(log, mean_likelihood(model, sigma), atol=0.3)


def test_tails_of_readings_hold_more_than_the_evidence_of_a_rotation_counts():
    """Laplace's method takes Student's law for the Gaussian of its weights.

    Of five numbers that are determined it misses 0.5 to 1.5; if readings are many, half the log of 4/3 for each in the mean.
    """
    sigma, omega = 0.15, np.array([0.0144, -0.012, 0.0168])
    model = model_of(seen_turning(omega, sigma), sigma, 0.03, SunDirections)
    log = best_motion(model, omega).log_evidence[0] - log_left_out(model)
    assert 0.3 < mean_likelihood(model, sigma) - log < 1.5


COMING_BACK = np.array([[0, 0, 1.0], [0.5, 0, 0.8], [0.4, 0.5, 0.8], [0, 0, 1.0]])
"""Directions of the Sun, to be made units, that a body about rest shows."""


@pytest.mark.parametrize("rate_sigma", [0.001, 0.01])
def test_evidence_of_an_oscillation_is_its_mean_likelihood_under_every_weaker_torque(rate_sigma):
    """Of a body that hardly turns, and of one that may turn by a sixth of a radian between samples."""
    sigma = 0.5
    model = model_of(COMING_BACK, sigma, rate_sigma)
    fits = fits_of_oscillation(model, [best_motion(model, np.zeros(3))], EVERY, RATES.ladder)
    of_size = {one.model.noise.rate: one for one in fits}
    assert len(of_size) == len(EVERY.swings_rad)
    for size in sorted(of_size)[:3]:
        log = of_size[size].log_evidence[0] - log_left_out(model)
        assert np.isclose(log, mean_likelihood(model, sigma, size), atol=0.1)
    for size in of_size:
        alike = [one for one in fits if one.model.noise.rate == size]
        assert np.ptp([one.log_evidence[0] for one in alike]) < 0.2
        strengths = [one.model.noise.acceleration for one in alike]
        assert strengths == sorted(RATES.ladder.rungs)[: len(strengths)]
        assert len(strengths) > 3 and strengths[-1] * np.ptp(model.obs.t_s) < 2 * size


def panels_of(suns, noise, gain_sigma):
    """Return the model of six panels with one error of all their gains, in the light of these directions (n, 3)."""
    rng, n, faces = np.random.default_rng(7), len(suns), CUBE_NORMALS
    light = np.maximum(suns @ faces.T, 0.0) + noise * rng.normal(size=(n, 6))
    sigma, names = np.full((n, 6), noise), tuple("abcdef")
    gain, scale = (np.ones(6), gain_sigma * np.ones((1, 6))), (np.ones(n), np.full(n, 1e-3))
    instants, shown = ReadingTimes(np.zeros(6)), np.ones(6, dtype=bool)
    readings, light_slice = (light, sigma, PanelResponse(faces, np.ones(6))), (sigma, sigma, sigma)
    term = Panels(*readings, *gain, *scale, names, instants, shown, *light_slice, np.ones(n))
    obs = Observations(APART_S * np.arange(n), np.zeros((n, 3)), (term,))
    return Model(obs, SPHERE, Noise(NOISE), 0.03)


def test_an_oscillation_pays_for_gains_that_are_not_known_as_a_rotation_does():
    """Odds of both are those of integrals over the one gain."""
    omega = np.array([0.01, -0.015, 0.01])
    suns = seen_turning(omega, 0.0)
    model = panels_of(suns, 0.1, gain_sigma=0.3)
    nominal = fit(model, propagate(model, 0, facing(suns)[:1], omega[None]), 40, 1e-6)
    swing = fits_of_oscillation(model, [nominal], EVERY, RATES.ladder)[-1]
    wander = np.array([swing.model.noise.rate])
    errors = np.linspace(-2.0, 2.0, 81)
    of_swing, of_rotation = [], []
    (term,) = model.obs.terms
    for u in errors:
        held = replace(model.obs, terms=(term.with_fixed_unknowns(np.array([u])),))
        of_swing.append(log_mean_likelihood(held, wander)[0])
        start = Track.free(nominal.motions.attitude, nominal.motions.omega)
        of_rotation.append(fit(replace(model, obs=held), start, 20, 1e-6).log_evidence[0])
    prior = np.exp(-(errors**2) / 2) / np.sqrt(2 * np.pi)
    log_swing, log_rotation = (
        np.log(np.trapezoid(np.exp(np.array(one)) * prior, errors))
        for one in (of_swing, of_rotation)
    )
    narrowed = np.linalg.slogdet(swing.motions.covariance[0, 0, 3:, 3:])[1] / 2
    log_swing += narrowed + log_left_out(model) - 3 * np.log(model.rate_sigma)
    odds = swing.log_evidence[0] - nominal.log_evidence[0]
    assert np.isclose(odds, log_swing - log_rotation, atol=0.3)
    assert nominal.log_evidence[0] < max(of_rotation) - 1  # the gain costs something
