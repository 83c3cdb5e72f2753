"""Periods seen from outside: of solutions and draws against closed forms and the reference motion, and what they decide."""

import json
from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.cli.values import parse_period
from sunspin.dynamics import gyrostat
from sunspin.estimate import periods as pd
from sunspin.estimate.lander import periods as posterior_periods
from sunspin.estimate.lander.predict import DrawnMotions
from sunspin.estimate.model import Body, Observations, Track
from sunspin.estimate.solutions import Solutions
from sunspin.output.kinds.posterior import period_sentences
from sunspin.telemetry.periodicity import FoundPeriod, LikelyPeriod
from sunspin.vehicle import Vehicle
from tests.support.passes import estimate
from tests.support.philae import AS_DRAWN, philae_draws
from validation.many_passes import make_period

WHEELED = Vehicle(
    "cube",
    inertia_kg_m2=np.diag([0.04, 0.042, 0.03]),
    wheels=[ss.Wheel("w", [0, 0.6, 0.8], 1e-3, speed_rad_s=1.0)],
)
RATES = np.array([[0.05, -0.02, 0.09], [0.03, 0.01, 0.2]])


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
    sign = np.where(momentum[:, 2] < 0, -1, 1)
    np.testing.assert_allclose(total, precession + spin * sign, rtol=1e-9)


def test_a_pure_spin_has_one_period_only():
    omega = np.array([[0, 0, 0.4], [0, 0, -0.4]])
    periods = 2 * np.pi / pd.euler_rates(omega, 15 * omega, np.array([0, 0, 1.0]))
    assert np.isnan(periods[:, :2]).all() and periods[:, 2] == pytest.approx([5 * np.pi] * 2)
    seen = [ss.Period(0.0, 15.7, 1.0)]
    weighed = pd.weigh_draws(seen, [periods], np.array([0.5, 0.5]))
    np.testing.assert_allclose(weighed.shares, [[0, 0, 1]], atol=1e-12)
    two = pd.weigh_draws(seen, [periods[:, [2, 2, 0]]], np.array([0.5, 0.5]))
    np.testing.assert_allclose(two.shares, [[0.5, 0.5, 0]], atol=1e-12)


def two_solutions(probability, sigma=1e-6):
    """A pass of three samples with two solutions of constant rates and a body of known inertia."""
    body = replace(Body.of(WHEELED), errors=np.zeros((0, 3, 3)))
    t_s = np.array([0.0, 40.0, 80.0])
    mean_moment = np.trace(WHEELED.require_inertia()) / 3
    momentum = np.tile(1e-3 * np.array([0, 0.6, 0.8]) / mean_moment, (3, 1))
    omega = np.repeat(RATES[:, None], 3, axis=1)
    covariance = np.broadcast_to(sigma**2 * np.eye(6), (2, 3, 6, 6))
    attitude = np.broadcast_to(np.eye(3), (2, 3, 3, 3))
    track = Track(attitude, omega, np.zeros((2, 0)), np.zeros(2), covariance)
    obs = Observations(t_s, momentum, ())
    known = np.full((2, 3), sigma)
    means, rest = (np.array(probability), RATES, known), (np.zeros(2), ({}, {}), ((), ()), 1.0)
    return Solutions(obs, track, *means, {}, ("as stated", 1.0), *rest), body


def test_periods_of_solutions_agree_with_the_reference_motion():
    """Free motion with a wheel that is held, before and after the sample nearest to what was seen."""
    seen = ss.Period(45.0, 25.0, 0.5)
    periods = pd.periods_of(*two_solutions([0.5, 0.5]), seen).reshape(2, -1, 3)
    instants = seen.t_s + np.linspace(-2, 2, 9) * seen.period_s - 40.0
    inertia = WHEELED.require_inertia()
    for omega, drawn in zip(RATES, periods, strict=True):
        before = np.array([0.0, *sorted(instants[instants < 0], reverse=True)])
        after = np.array([0.0, *instants[instants > 0]])
        runs = [
            ss.propagate(WHEELED, omega, [0, 0, 1], 1.0, t, wheel_mode="hold")["omega_B"].values[1:]
            for t in (before, after)
        ]
        rate = np.concatenate(runs)
        momentum = rate @ inertia + 1e-3 * np.array([0, 0.6, 0.8])
        mean = pd.euler_rates(rate, momentum, pd.spin_axis(inertia)).mean(axis=0)
        np.testing.assert_allclose(np.median(drawn, axis=0), 2 * np.pi / np.abs(mean), rtol=2e-3)


def test_a_period_that_may_be_another_counts_both():
    """Two solutions of unlike periods: a column that may have either keeps their probabilities, times those of the column."""
    one, body = two_solutions([0.5, 0.5])
    # the sum of precession and spin, averaged over four of the periods seen; the period of either solution is that of no other
    seen_s = 62.0
    draws = pd.periods_of(one, body, ss.Period(40.0, seen_s, 0.5)).reshape(2, -1, 3)
    of_each = np.median(draws, axis=1)
    first_s, second_s = of_each[:, 2]
    other = LikelyPeriod(float(second_s), 0.5, 0.25)
    seen = FoundPeriod(40.0, float(first_s), 0.5, 0.75, 1e-4, (other,))
    (after,), attrs = pd.weigh_by_periods([one], body, [seen], [0])
    # the precession of the first has nearly the same period: two of its three rotations count
    near = np.exp(-0.5 * ((of_each - of_each[:, 2:]) / 0.5) ** 2).sum(axis=1) * [0.75, 0.25]
    assert after.probability == pytest.approx(near / near.sum(), abs=0.02)
    (row,) = json.loads(attrs["periods"])
    assert row["told"] and row["carried"] > 0.99
    elsewhere = replace(seen, t_s=1e5)
    unchanged, attrs = pd.weigh_by_periods([one], body, [elsewhere], [0])
    assert unchanged == [one] and attrs == {}
    sure = replace(seen, probability=1.0, aliases=())
    (after,), _ = pd.weigh_by_periods([one], body, [sure], [0])
    assert after.probability[0] > 0.99


def test_a_period_reweights_solutions_and_names_the_kind_of_rotation():
    one, body = two_solutions([0.8, 0.2])
    at_40 = ss.Period(40.0, 25.0, 0.5)
    periods = np.median(pd.periods_of(one, body, at_40).reshape(2, -1, 3), axis=1)
    of_second = ss.Period(40.0, float(periods[1, 0]), 0.5)
    (after,), attrs = pd.weigh_by_periods([one], body, [of_second], [3])
    (row,) = json.loads(attrs["periods"])
    assert after.probability[1] > 0.99 and np.array_equal(after.without_periods, [0.8, 0.2])
    assert row["told"] and row["pass"] == 3
    assert row["shares"][0] > 0.9 and row["without"] == pytest.approx([0.2, 0.8])

    # a period that none has, and one that only an unlikely solution has
    (same,), attrs = pd.weigh_by_periods([one], body, [ss.Period(40.0, 400.0, 0.5)], [0])
    (row,) = json.loads(attrs["periods"])
    assert np.array_equal(same.probability, one.probability)
    assert not row["told"] and row["nearest_sigmas"] > pd.FAR_SIGMAS
    rare, body = two_solutions([0.99, 0.01])
    (kept,), attrs = pd.weigh_by_periods([rare], body, [of_second], [0])
    (row,) = json.loads(attrs["periods"])
    assert np.array_equal(kept.probability, rare.probability)
    assert not row["told"] and row["carried"] == pytest.approx(0.01)


def test_a_period_at_a_time_of_no_pass_is_refused():
    one, body = two_solutions([0.8, 0.2])
    with pytest.raises(InputError, match=r"time of no pass .*; passes are at 0 to 80 s"):
        pd.weigh_by_periods([one], body, [ss.Period(200.0, 25.0, 0.5)], [0])


def test_drawn_inertias_scatter_as_the_file_says_and_a_sphere_has_one():
    rng = np.random.default_rng(0)
    body = Body.of(WHEELED)
    drawn = np.concatenate([pd.draw_inertias(body, rng) for _ in range(200)])
    spread = np.sqrt(((drawn - body.inertia) ** 2).mean(axis=0))
    np.testing.assert_allclose(spread, np.abs(body.errors).max(axis=0), rtol=0.1)
    sphere = Body.of(replace(WHEELED, inertia_kg_m2=None, wheels=()))
    assert (pd.draw_inertias(sphere, rng) == np.eye(3)).all()


def test_rates_with_a_period_keep_probabilities_with_and_without_it():
    simulated, period = make_period(0, 0)
    result = estimate(simulated, periods=[period], column_tests=False)
    before = result["probability_without_periods"]
    assert before.dims == ("pass_id", "solution")
    assert result["probability"].values[0].sum() == pytest.approx(1, abs=1e-2)
    assert result["probability"].values[0, 0] > before.values[0, 0]
    assert json.loads(result.attrs["periods"])[0]["told"]


PHILAE = AS_DRAWN.vehicle


@pytest.mark.parametrize("after_s", [-60.0, 900.0, 2500.0])
def test_periods_of_draws_agree_with_the_reference_motion(after_s):
    """Before the first sample, after it, and when the wheel has handed its momentum to the body, whose own axis is near z."""
    tree = philae_draws(2)
    seen = ss.Period(25200.0 + after_s, 20.0, 1.0)
    found = posterior_periods.periods_of(DrawnMotions.of(PHILAE, tree), seen)[0]
    draws, t_s = tree["posterior"], after_s + np.linspace(-2, 2, 9) * 20.0
    state = [draws[name].values[0, 0] for name in ("omega_B", "sun_B", "wheel_speed_rad_s")]
    run = ss.propagate(PHILAE, *state, np.append(0.0, t_s if after_s > 0 else t_s[::-1]))
    omega, speeds = run["omega_B"].values[1:], run["wheel_speed_rad_s"].values[1:]
    momentum = gyrostat.total_momentum(PHILAE, omega, speeds)
    axis = pd.spin_axis(PHILAE.require_inertia())
    mean = pd.euler_rates(omega, momentum, axis).mean(axis=0)
    np.testing.assert_allclose(found, 2 * np.pi / np.abs(mean), rtol=1e-3)
    assert abs(axis[2]) > 0.99


def weighted(monkeypatch, periods, middle_s, sigma_s):
    """Return the group `period` of a posterior whose draws have these periods (n, 3), after one was seen."""
    seen = ss.Period(0.0, middle_s, sigma_s)
    monkeypatch.setattr(posterior_periods, "periods_of", lambda *_: periods)
    tree = philae_draws(len(periods), 0.01)
    return posterior_periods.draws_by_periods(PHILAE, tree, [seen]).to_dataset()


def test_draws_are_weighted_by_a_period_and_the_reading_is_named(monkeypatch):
    """Spins of 10 to 20 s even, the others far away: the weighted mean is the period seen, and it is the spin."""
    n = 4000
    periods = np.stack([np.full(n, 90.0), np.linspace(10, 20, n), np.full(n, np.nan)], axis=1)
    group = weighted(monkeypatch, periods, 14.0, 1.0)
    weight = np.exp(group["log_weight"].values[0])
    assert weight.sum() == pytest.approx(1)
    assert weight @ periods[:, 1] == pytest.approx(14.0, abs=0.01)
    assert group.attrs["effective_draws"] == pytest.approx(n * 2 * np.sqrt(np.pi) / 10, rel=0.01)
    assert group.attrs["told"] and "spin 100%" in period_sentences(group)[0]


def even_periods(count):
    return np.stack([np.linspace(10, 20, count)] * 3, axis=1)


@pytest.mark.parametrize(
    ("middle", "sigma", "words"),
    [(14.0, 0.05, "periods not used: of these draws"), (60.0, 1.0, "no solution")],
)
def test_periods_that_the_draws_cannot_decide_are_reported(monkeypatch, middle, sigma, words):
    group = weighted(monkeypatch, even_periods(4000), middle, sigma)
    assert not group.attrs["told"] and words in period_sentences(group)[0]


def test_the_advice_to_draw_more_makes_periods_decisive(monkeypatch):
    """A period that few draws have: the same draws, and eight times as many, as `--draws` gives."""
    few, many = (
        period_sentences(weighted(monkeypatch, even_periods(count), 14.0, 0.05))
        for count in (4000, 32000)
    )
    assert "ask for more --draws" in few[0]
    assert len(many) == 2 and "with periods the angular speed" in many[1]


def test_the_option_period_is_parsed():
    assert parse_period("13.0+-0.5@15:50", "2014-11-12T08:35:00Z") == ss.Period(26100.0, 13.0, 0.5)
    for text in ("13", "13+-0@100", "13+-1", "x+-1@100"):
        with pytest.raises(InputError):
            parse_period(text, None)
