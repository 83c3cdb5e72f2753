"""Periods observed from outside: Euler's rates compared with closed forms, weights with known results."""

import numpy as np
import pytest

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.cli.values import parse_period
from sunspin.dynamics import gyrostat as g
from sunspin.estimate.posterior import period as of_draws
from sunspin.estimate.terms import period as pd
from tests.support.philae import philae_draws

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


def test_the_advice_to_draw_more_makes_periods_decisive(monkeypatch):
    """A period that few draws have: the same draws, and eight times as many, as `--draws` gives."""
    decided = {}
    for count in (4000, 32000):
        tree, _ = philae_draws(count, 0.01)
        values = np.stack([np.linspace(10, 20, count)] * 3, axis=1)
        monkeypatch.setattr(of_draws, "periods_of", lambda *_, values=values: values)
        of_draws.with_periods(PHILAE, tree, [pd.Period(0.0, 14.0, 0.05)])
        decided[count] = of_draws.period_sentences(tree["period"].to_dataset())
    few, many = decided.values()
    assert "ask for more --draws" in few[0]
    assert len(many) == 2 and "with periods the angular speed" in many[1]
