"""Evidence: sums over sizes and passes, and logs of mean likelihoods of the same readings, against sums over drawn motions."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib import import_module

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp

from sunspin.estimate.between import MomentumSizes, link_passes
from sunspin.estimate.budget import Budget
from sunspin.estimate.chain import costs, fit, log_left_out, propagate
from sunspin.estimate.evidence import PassFits, ladder, share_noise, sum_over_shares
from sunspin.estimate.model import Body, Model, Noise, Observations, States, Track
from sunspin.estimate.one_pass import one_pass
from sunspin.estimate.settings import RATES, LadderSettings, SearchSettings, SolutionSettings
from sunspin.estimate.solutions import solutions
from sunspin.estimate.swings import fits_of_oscillation, log_mean_likelihood
from sunspin.estimate.terms.directions import SunDirections
from sunspin.estimate.terms.panels import Panels, ReadingTimes
from sunspin.estimate.terms.term import Residual, facing, gaussian
from sunspin.vehicle.response.flat import PanelResponse
from tests.support.chains import problem
from tests.support.passes import stated_model, tumbling_pass
from tests.support.simulate import CUBE
from tests.support.vehicles import CUBE_NORMALS, units

LADDER, SEARCH = LadderSettings(), SearchSettings()


def test_sum_over_sizes_is_that_of_fits_under_each_size():
    model, motions = problem(torque=True)
    torque = model.obs.terms[-1]
    shares = (1.0, 0.3, 0.1)

    def under(share):
        terms = (*model.obs.terms[:-1], replace(torque, sigma=share * torque.sigma))
        return fit(replace(model, obs=replace(model.obs, terms=terms)), motions, 30, 1e-9)

    terms = (*model.obs.terms[:-1], replace(torque, shares=shares))
    wide = fit(replace(model, obs=replace(model.obs, terms=terms)), motions, 30, 1e-9)
    summed = sum_over_shares(wide, beyond_fit=np.inf)
    each = [under(share) for share in shares]
    log = np.array([one.log_evidence[0] for one in each])
    assert np.isclose(summed.log_evidence[0], logsumexp(log) - np.log(3), atol=0.3)
    weight = np.exp(log - logsumexp(log))
    omega = sum(w * one.motions.omega[0] for w, one in zip(weight, each, strict=True))
    sigma = np.sqrt(np.diag(summed.motions.covariance[0, 2]))[3:]
    assert (np.abs(summed.motions.omega[0, 2] - omega[2]) < 0.1 * sigma).all()


def test_a_quiet_motion_is_most_probable_under_weak_torques_and_all_rungs_agree():
    model, motions = problem()
    assert ladder(model, motions.take(slice(0)), LADDER, SEARCH, 1e-4) == []  # no candidates
    fits = ladder(model, motions, LADDER, SEARCH, 1e-4)
    logs = {one.model.noise.acceleration: one.log_evidence[0] for one in fits}
    assert logs[5e-6] > logs[1e-3]
    assert len(logs) == len(fits)
    best = fits[int(np.argmax([one.log_evidence[0] for one in fits]))]
    for one in fits:
        sigma = np.sqrt(np.einsum("nii->ni", one.motions.covariance[0, :, 3:, 3:]))
        assert (np.abs(one.motions.omega[0] - best.motions.omega[0]) < 3 * sigma).all()


def passes_of(logs):
    """Return passes with these log evidences (passes, rungs)."""
    model, motions = problem()
    one = fit(model, motions, 5)
    passes = []
    for row in logs:
        fits = tuple(
            replace(one, model=model.under(rung), log_evidence=np.array([log]))
            for rung, log in zip(LADDER.rungs, row, strict=True)
        )
        passes.append(PassFits(model, fits, LADDER.rungs, np.full(7, -np.log(7))))
    return passes


def test_passes_tell_each_other_how_strong_torques_are_and_one_alone_has_an_even_prior():
    (one,) = share_noise(passes_of([np.linspace(0, 9, 7)]), LADDER)
    assert np.allclose(one.log_rung, -np.log(7))
    sharp, flat = np.where(np.arange(7) == 2, 0.0, -50.0), np.zeros(7)
    told = share_noise(passes_of([sharp, flat, sharp]), LADDER)[1]
    assert np.isclose(np.exp(told.log_rung).sum(), 1.0)
    assert np.exp(told.log_rung[2]) > 0.7 and np.exp(told.log_rung[0]) > 0.02


@pytest.mark.parametrize(
    ("slow", "fast", "low", "high"),
    [
        (0.0, 0.0, 0.4, 0.9),  # fit alike: open
        (-4.0, 0.0, 0.4, 0.6),  # the faster one is ahead only if every rate is as likely
        (0.0, -4.0, 0.9, 1.0),
        (-20.0, 0.0, 0.0, 0.01),  # nothing but the data counts
    ],
)
def test_which_alias_is_likelier_does_not_hang_on_the_prior_of_the_rate(slow, fast, low, high):
    """Two motions at 1.4 and 12 deg/s, known to 0.1 deg/s; `slow`, `fast`: log evidences, were the rate even before the data."""
    prior, sigma = np.radians(8.0), np.radians(0.1)
    model, motions = problem(gyro=False, torque=False, rate_sigma=prior)
    one = fit(model, motions, 5)
    omega = np.zeros((2, len(model.obs), 3))
    omega[:, :, 2] = np.radians([[1.4], [12.0]])
    two = one.take(np.array([0, 0]))
    covariance = np.broadcast_to(sigma**2 * np.eye(6), two.motions.covariance.shape)
    motions = replace(two.motions, omega=omega, covariance=covariance)
    log = np.array([slow, fast]) - (omega[:, 0] ** 2).sum(axis=1) / (2 * prior**2)
    two = replace(two, motions=motions, log_evidence=log)
    fits = PassFits(model, (two,), (model.noise.acceleration,), np.zeros(1))
    every = np.arange(len(model.obs))
    result = solutions(fits, model.obs, every, SolutionSettings(), SEARCH)
    assert np.isclose(result.probability.sum(), 1.0)
    slower = result.mean[:, 2] < np.radians(5.0)
    assert low <= result.probability[slower].sum() <= high


def test_a_motion_that_ends_on_its_way_under_the_first_torques_is_followed_down_from_stronger_ones():
    model, motions = problem(torque=False)
    off = 0.02 * np.array([1.0, -1.0, 0.5])
    poor = replace(motions, omega=motions.omega + off)
    hurried = replace(LADDER, first_steps=1, steps=3)
    first = fit(model.under(5e-6), poor, 1)

    def under_weak(begin, settings):
        fits = ladder(model, begin, settings, SEARCH, 5e-6)
        weak = [one for one in fits if one.model.noise.acceleration == 5e-6]
        return max(one.log_evidence.max() for one in weak)

    best, again = under_weak(motions, LADDER), under_weak(poor, hurried)
    assert first.log_evidence[0] < best - LADDER.hopeless
    assert np.isclose(again, best, atol=0.1)


def test_a_body_of_uncertain_inertia_that_wants_strong_torques_is_searched_under_them(monkeypatch):
    """A search with the inertia held lost the truth, and three samples between two steps of the rate were decided for it."""
    module = import_module("sunspin.estimate.one_pass")
    fit_tracks, strengths = module.fit_tracks, []

    def fit_poorly(nominal, tracks, noise, settings):
        """Return the fits of a search; of the first one those alone that need strong torques, as if the truth were lost."""
        strengths.append(noise)
        fits = fit_tracks(nominal, tracks, noise, settings)
        return [one for one in fits if noise == strong or is_strong(one)]

    def is_strong(fitted):
        return fitted.model.noise.acceleration >= RATES.ladder.strained

    strong = RATES.ladder.strong
    monkeypatch.setattr(module, "fit_tracks", fit_poorly)
    model = stated_model(CUBE, tumbling_pass(CUBE, 12, 12.0, seed=4)[0])
    fits = one_pass(model, RATES, Budget.of(1.0)).fits
    assert strengths == [RATES.search.noise, strong]
    assert not is_strong(max(fits, key=lambda one: one.log_evidence.max()))
    # an inertia without errors is not doubted
    strengths.clear()
    exact = replace(model, body=replace(model.body, errors=model.body.errors[:0]))
    one_pass(exact, RATES, Budget.of(1.0))
    assert strengths == [RATES.search.noise]


TIMES = np.arange(6) * 5400.0
UNKNOWN = [None] * 6
"""Sizes of the momentum, of a body with wheels for example."""


@dataclass(frozen=True)
class Solved:
    """What neighbours are asked of the solutions of a pass."""

    probability: np.ndarray
    mean: np.ndarray
    mean_sigma: np.ndarray


def passes(rng, wander, misled=2):
    """The true rate and an alias far from it in every pass; the pass `misled` likes its alias better."""
    rate = np.array([0.01, 0.015, 0.0]) + wander * rng.normal(size=(6, 3))
    alias = rate + 0.1 * rng.normal(size=(6, 3))
    probability = [np.array([0.3, 0.7] if k == misled else [0.9, 0.1]) for k in range(6)]
    sigma = np.full((2, 3), 1e-3)
    means = [np.stack(pair) for pair in zip(rate, alias, strict=True)]
    return [Solved(share, mean, sigma) for share, mean in zip(probability, means, strict=True)]


@pytest.mark.parametrize("misled", [0, 2])
def test_a_wrong_alias_is_outweighed_by_neighbouring_passes(misled):
    linked, walk = link_passes(passes(np.random.default_rng(0), 1e-3, misled), TIMES, 0.1, UNKNOWN)
    assert linked[misled].probability[0] > 0.95 and 1e-6 <= walk < 1e-4
    assert all(one.probability.sum() == pytest.approx(1.0) for one in linked)


def test_a_pass_that_lacks_the_true_motion_does_not_decide_the_others():
    """Each pass but the first prefers the truth; the first knows two aliases alone, which the others have too."""
    truth, aliases = np.array([-0.007, 0, 0]), np.array([[0.62, 0, 0], [-0.635, 0, 0]])
    sigma = np.array([[1e-4, 1e-4, 1e-4], [3e-4, 9e-3, 9e-3], [3e-4, 9e-3, 9e-3]])
    lost = Solved(np.array([0.6, 0.4]), aliases, sigma[1:])
    whole = Solved(np.array([0.8, 0.1, 0.1]), np.vstack([truth, aliases]), sigma)
    linked, _ = link_passes([lost, whole, whole, whole], TIMES[:4], 1.2, UNKNOWN)
    assert all(one.probability[0] > 0.9 for one in linked[1:])
    assert linked[0].probability.max() < 0.9


def test_a_rate_about_another_axis_is_linked_by_the_size_of_the_momentum():
    """The body rotates about y, about -y, and about -y faster or about y: the size alone says which."""
    sigma, wide = np.full((1, 3), 1e-3), np.full((2, 3), 1e-3)
    solved = [
        Solved(np.ones(1), np.array([[0.0, 0.04, 0.0]]), sigma),
        Solved(np.ones(1), np.array([[0.0, -0.04, 0.0]]), sigma),
        Solved(np.array([0.4, 0.6]), np.array([[0.0, 0.04, 0.0], [0.0, -0.06, 0.0]]), wide),
    ]
    sizes = [np.linalg.norm(one.mean, axis=1) for one in solved]
    known = [MomentumSizes(size, np.full(len(size), 2e-3)) for size in sizes]
    by_size, _ = link_passes(solved, TIMES[:3], 0.1, known)
    by_axis, _ = link_passes(solved, TIMES[:3], 0.1, UNKNOWN[:3])
    assert by_size[2].probability[0] > 0.9 > 0.5 > by_axis[2].probability[0]


def test_passes_with_large_rate_changes_are_not_linked():
    alone = passes(np.random.default_rng(1), 0.3)
    linked, walk = link_passes(alone, TIMES, 0.1, UNKNOWN)
    assert np.isnan(walk) or walk > 3e-4
    if np.isnan(walk):
        np.testing.assert_array_equal(linked[2].probability, alone[2].probability)


# ---- evidences are logs of mean likelihoods ---------------------------------------------------------------------------------


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
    cost = costs(model.obs, Track.unfitted(sun, np.zeros((*sun.shape[:2], 3)))).sum(axis=1)
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
        start = Track.unfitted(nominal.motions.attitude, nominal.motions.omega)
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
