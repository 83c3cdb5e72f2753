"""A body that oscillates at random between samples: its evidence, and that it is not taken for uniform rotation.

All telemetry is synthetic."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from sunspin.estimate.rates.alternatives import (
    SWINGS_QUICKLY,
    Others,
    alternatives,
    counted,
    weighed,
)
from sunspin.estimate.rates.common_errors import with_common
from sunspin.estimate.rates.hypotheses import AS_STATED, Hypothesis
from sunspin.estimate.rates.motion import Body
from sunspin.estimate.rates.state import Motion, Observations, Track
from sunspin.estimate.rates.wandering import log_evidence
from sunspin.estimate.terms.sun_direction import SunDirection
from sunspin.estimate.terms.term import EVERYWHERE, Seen, facing, normal
from sunspin.vehicle.response.planes import sphere
from validation.passes import unit

RATE_MAX = np.radians(3.0)
BODY = Body(np.eye(3), np.zeros(3), True, np.zeros((0, 3, 3)))
T_S = 60.0 * np.arange(10)


def seen(sun, sigma):
    """Readings (n) of the Sun's directions (n, 3), good to `sigma` rad."""
    rng = np.random.default_rng(8)
    read = sun + sigma * rng.normal(size=sun.shape)
    known = SunDirection.of(
        read / np.linalg.norm(read, axis=1, keepdims=True),
        np.tile(sigma**2 * np.eye(3), (len(sun), 1, 1)),
    )
    return Observations(T_S[: len(sun)], np.zeros((len(sun), 3)), (known,))


def swinging(by_rad):
    """Attitudes (n, 3, 3) that wander by so much from sample to sample."""
    rng, made = np.random.default_rng(2), [np.eye(3)]
    for _ in T_S[1:]:
        made.append(Rotation.from_rotvec(by_rad * rng.normal(size=3)).as_matrix() @ made[-1])
    return np.array(made)


def test_the_evidence_of_oscillation_agrees_with_a_filter_on_legendre_polynomials():
    """And of a body that swings beyond all bounds those of unrelated directions."""
    o, by = (
        seen(swinging(0.3)[:4] @ unit(np.random.default_rng(1)), 0.3),
        np.array([0.3, 1e3]) / np.sqrt(60.0),
    )
    grid = sphere(EVERYWHERE)
    cost = normal(
        o.of_sun[0], Seen(np.repeat(facing(grid)[:, None], 4, axis=1), np.zeros((EVERYWHERE, 4, 3)))
    )[2]
    l, cosine = np.arange(40), np.linspace(-1, 1, 4001)
    heat = np.polynomial.legendre.legval(cosine, (2 * l + 1) * np.exp(-l * (l + 1) * 0.3**2 / 2))
    spread = np.interp(grid @ grid.T, cosine, heat) / EVERYWHERE
    density = np.exp(-cost[:, 0])
    for k in range(1, 4):
        density = (spread @ density) * np.exp(-cost[:, k])
    unrelated = np.log(np.exp(-cost).mean(axis=0)).sum()
    np.testing.assert_allclose(log_evidence(o, by), [np.log(density.mean()), unrelated], atol=0.01)


def motions(sun, sigma, first_rate):
    """What holds most of the weight of readings of these directions, good to `sigma` rad, and its motion: all hypotheses, begun at
    the best of a hundred even turns, the first of which is given."""
    o, rng = seen(sun, sigma), np.random.default_rng(4)
    rate = RATE_MAX * rng.uniform(size=(100, 1)) * np.array([unit(rng) for _ in range(100)])
    rate[0] = first_rate
    first = facing(o.of_sun[0].direction_B[0])
    turned = (
        Rotation.from_rotvec((-rate[:, None] * o.t_s[:, None]).reshape(-1, 3))
        .as_matrix()
        .reshape(100, len(o), 3, 3)
    )
    one = Hypothesis(AS_STATED, o, np.arange(len(o)), Motion(BODY, 5e-7, RATE_MAX / 2))
    fit = with_common(
        one.fitted(),
        Track(turned @ first, np.repeat(rate[:, None], len(o), axis=1)),
        one.motion,
        None,
    )
    found = alternatives(
        weighed(one, fit.take(np.argsort(fit.track.cost)[:3])), Others(True, "{:.0f} s".format)
    )
    best = counted(found)[0]
    trial, mode = found[best.members[0][0]], best.members[0][1]
    return trial.hypothesis.what, trial.fit.track.omega[mode], best.weights.sum()


def test_an_oscillation_is_not_taken_for_uniform_rotation():
    what, omega, weight = motions(swinging(0.4) @ unit(np.random.default_rng(1)), 0.3, np.zeros(3))
    assert what == SWINGS_QUICKLY and weight > 0.9
    assert np.abs(omega).max() < np.radians(0.5)  # four sigmas of the mean of such swings


def test_uniform_rotation_is_not_taken_for_an_oscillation():
    rate = np.radians([0.6, -0.5, 0.8])
    turned = Rotation.from_rotvec(-rate * T_S[:, None]).as_matrix()
    _, omega, weight = motions(turned @ unit(np.random.default_rng(1)), 0.1, rate)
    assert weight > 0.9  # with a little swinging or without
    assert np.abs(omega - rate).max() < np.radians(0.05)
