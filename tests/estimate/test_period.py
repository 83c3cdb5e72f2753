"""Periods observed from outside: Euler's rates compared with closed forms, weights with known results."""

from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.cli.values import parse_period
from sunspin.dynamics import gyrostat as g
from sunspin.estimate.posterior import period as of_draws
from sunspin.estimate.rates import period as of_modes
from sunspin.estimate.rates.finish import Pass
from sunspin.estimate.rates.motion import Body
from sunspin.estimate.rates.state import Motion, Observations, Track
from sunspin.estimate.terms import period as pd
from sunspin.vehicle import Vehicle
from tests.support.philae import philae_draws
from tests.support.simulate import CUBE_WITHOUT_NOISE_STATED, simulated_pass, uneven_times

PHILAE = ss.load_vehicle("philae")
INERTIA = PHILAE.require_inertia()


@pytest.mark.parametrize("wheel", [0.0, 3.0])
def test_periods_of_a_symmetric_body_agree_with_the_textbook(wheel):
    """Precession |H| / A whatever spins along the axis, nutation none; spin is what is left of the rate about the axis."""
    A, C = 13.0, 16.0
    omega = np.array([[0.1, 0.2, 0.3], [0.1, -0.1, -0.4], [0.0, 0.05, 0.0]])
    momentum = omega * [A, A, C] + [0, 0, wheel]
    precession, spin, total = pd.euler_rates(omega, momentum, np.array([0.0, 0.0, 1.0])).T
    size = np.linalg.norm(momentum, axis=1)
    np.testing.assert_allclose(precession, size / A, rtol=1e-12)
    np.testing.assert_allclose(spin, omega[:, 2] - momentum[:, 2] / A, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        total, precession + spin * np.where(momentum[:, 2] < 0, -1, 1), rtol=1e-9
    )


def test_a_pure_spin_has_one_period_only():
    found = pd.euler_rates(
        np.array([[0, 0, 0.4], [0, 0, -0.4]]),
        np.array([[0, 0, 6.0], [0, 0, -6.0]]),
        np.array([0, 0, 1.0]),
    )
    assert np.isnan(found[:, :2]).all() and found[:, 2] == pytest.approx([0.4, 0.4])
    assert np.array_equal(
        pd.Period(0.0, 15.7, 1.0).density(2 * np.pi / found)[:, :2], np.zeros((2, 2))
    )


def test_periods_of_draws_agree_with_the_reference_motion():
    tree, state = philae_draws(2)
    seen = pd.Period(25200.0 + 900.0, 20.0, 1.0)
    t = 900.0 + np.linspace(-2, 2, 9) * 20.0
    run = ss.propagate(PHILAE, state.omega[0], state.sun[0], 865.0, np.concatenate([[0.0], t]))
    omega, speeds = run["omega_B"].values[1:], run["wheel_speed_rad_s"].values[1:]
    rates = pd.euler_rates(
        omega, g.total_momentum(PHILAE, omega, speeds), pd.own_axis(INERTIA)
    ).mean(axis=0)
    np.testing.assert_allclose(
        of_draws.periods_of(PHILAE, tree, seen)[0], 2 * np.pi / np.abs(rates), rtol=1e-3
    )
    assert abs(pd.own_axis(INERTIA)[2]) > 0.99


def weighted(monkeypatch, periods, seen, n=4000):
    tree, _ = philae_draws(n, 0.01)
    monkeypatch.setattr(of_draws, "periods_of", lambda *_: periods)
    of_draws.with_periods(PHILAE, tree, [seen])
    return tree["period"].to_dataset()


def test_weights_by_a_period_are_the_mean_of_three_densities(monkeypatch):
    """Spins of 10 to 20 s even, the others far away: the weighted mean is the period seen, and it is the spin."""
    periods = np.stack(
        [np.full(4000, 90.0), np.linspace(10, 20, 4000), np.full(4000, np.nan)], axis=1
    )
    found = weighted(monkeypatch, periods, pd.Period(0.0, 14.0, 1.0))
    weight = np.exp(found["log_weight"].values[0])
    assert weight.sum() == pytest.approx(1) and weight @ periods[:, 1] == pytest.approx(
        14.0, abs=0.01
    )
    assert found.attrs["effective_draws"] == pytest.approx(4000 * 2 * np.sqrt(np.pi) / 10, rel=0.01)
    np.testing.assert_allclose(found["probability"].values[0], [0, 1, 0], atol=1e-12)
    assert found.attrs["told"] and "spin 100%" in of_draws.period_sentences(found)[0]
    both = weighted(monkeypatch, periods[:, [1, 1, 0]], pd.Period(0.0, 14.0, 1.0))
    np.testing.assert_allclose(both["probability"].values[0], [0.5, 0.5, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("middle", "sigma", "words"),
    [(14.0, 0.05, "periods not used: of these draws"), (60.0, 1.0, "no solution")],
)
def test_periods_that_the_draws_cannot_decide_are_reported(monkeypatch, middle, sigma, words):
    periods = np.stack([np.linspace(10, 20, 4000)] * 3, axis=1)
    found = weighted(monkeypatch, periods, pd.Period(0.0, middle, sigma))
    assert not found.attrs["told"] and words in of_draws.period_sentences(found)[0]


def test_the_option_period_is_parsed():
    assert parse_period("13.0+-0.5@15:50", "2014-11-12T08:35:00Z") == pd.Period(26100.0, 13.0, 0.5)
    for text in ("13", "13+-0@100", "13+-1", "x+-1@100"):
        with pytest.raises(InputError):
            parse_period(text, None)


WHEELED = Vehicle(
    "cube",
    inertia_kg_m2=np.diag([0.04, 0.042, 0.03]),
    wheels=[ss.Wheel("w", [0, 0.6, 0.8], 1e-3, speed_rad_s=1.0)],
)
RATES = np.array([[0.05, -0.02, 0.09], [0.03, 0.01, 0.2]])


def two_modes(weight, sigma=1e-6, inertia_errors=None):
    """A pass of three samples with two modes at constant rates, as the estimator hands them to the periods."""
    body = Body.of(WHEELED)
    body = replace(body, errors=np.zeros((0, 3, 3)) if inertia_errors is None else inertia_errors)
    t = np.array([0.0, 40.0, 80.0])
    momentum = np.tile(1e-3 * np.array([0, 0.6, 0.8]) / body.unit, (3, 1))
    covariance = np.broadcast_to(sigma**2 * np.eye(6), (2, 3, 6, 6))
    rates = np.repeat(RATES[:, None], 3, axis=1)
    track = Track(
        np.broadcast_to(np.eye(3), (2, 3, 3, 3)), rates, np.zeros(2), np.zeros(2), covariance
    )
    every = np.arange(3)
    one = Pass(every, every, track, np.array(weight), RATES, np.full((2, 3), sigma), {})
    return Observations(t, momentum, ()), one, Motion(body, 0.0, 1.0)


def test_periods_of_solutions_agree_with_the_reference_motion():
    """Free motion with a wheel that is held, before and after the sample nearest to what was seen."""
    seen = pd.Period(45.0, 25.0, 0.5)
    found = of_modes.periods_of(*two_modes([0.5, 0.5]), seen).reshape(2, -1, 3)
    for omega, periods in zip(RATES, found, strict=True):
        after, before = (
            np.array([0.0, *times]) for times in np.split(seen.instants_s - 40.0, [4])[::-1]
        )
        runs = [
            ss.propagate(WHEELED, omega, [0, 0, 1], 1.0, t, wheel_mode="hold")["omega_B"].values[1:]
            for t in (np.array([0.0, *sorted(before[1:], reverse=True)]), after)
        ]
        rate = np.concatenate(runs)
        momentum = rate @ WHEELED.require_inertia() + 1e-3 * np.array([0, 0.6, 0.8])
        reference = (
            2
            * np.pi
            / np.abs(
                pd.euler_rates(rate, momentum, pd.own_axis(WHEELED.require_inertia())).mean(axis=0)
            )
        )
        np.testing.assert_allclose(np.median(periods, axis=0), reference, rtol=2e-3)


def test_a_period_reweights_solutions_and_names_the_kind_of_rotation():
    o, one, motion = two_modes([0.8, 0.2])
    periods = np.median(
        of_modes.periods_of(o, one, motion, pd.Period(40.0, 25.0, 0.5)).reshape(2, -1, 3), axis=1
    )
    (after,), (said,) = of_modes.weighted(o, [one], motion, [pd.Period(40.0, periods[1, 0], 0.5)])
    assert after.weight[1] > 0.99 and np.array_equal(after.before, [0.8, 0.2]) and said["told"]
    assert said["shares"][0] > 0.9 and said["without"] == pytest.approx([0.2, 0.8])
    (same,), (refused,) = of_modes.weighted(o, [one], motion, [pd.Period(40.0, 400.0, 0.5)])
    assert (
        np.array_equal(same.weight, one.weight)
        and not refused["told"]
        and refused["nearest_sigmas"] > pd.FAR_SIGMAS
    )
    o, rare, motion = two_modes([0.99, 0.01])
    (kept,), (against,) = of_modes.weighted(
        o, [rare], motion, [pd.Period(40.0, periods[1, 0], 0.5)]
    )
    assert (
        np.array_equal(kept.weight, rare.weight)
        and not against["told"]
        and against["carried"] == pytest.approx(0.01)
    )
    with pytest.raises(
        InputError, match=r"time of no pass \(found 200 s\); passes are at 0 to 80 s"
    ):
        of_modes.weighted(o, [one], motion, [pd.Period(200.0, 25.0, 0.5)])


def test_rates_with_a_period_keep_probabilities_with_and_without_it():
    rng = np.random.default_rng(4)
    data, _ = simulated_pass(
        CUBE_WITHOUT_NOISE_STATED, [0.01, 0.02, 0.0], uneven_times(rng, 8, 20.0, 0.3), rng
    )
    seen = pd.Period(80.0, 2 * np.pi / np.hypot(0.01, 0.02), 20.0)
    found = ss.rates(
        CUBE_WITHOUT_NOISE_STATED,
        data,
        acceleration_noise=2e-5,
        max_rate_rad_s=0.04,
        periods=[seen],
    )
    assert found["probability"].values[0].sum() == pytest.approx(1) and found[
        "probability_without_periods"
    ].dims == ("pass_id", "solution")
    told = found.sunspin.summary()
    assert told["periods"][0]["told"] and any(
        "; in pass 0 the likeliest motion holds 100%" in line for line in told.lines
    )
