"""Periods seen from outside and the draws of a posterior: periods against the reference motion, and what they decide in words."""

from __future__ import annotations

import numpy as np
import pytest

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.cli.values import parse_period
from sunspin.dynamics import gyrostat
from sunspin.estimate.lander import periods as of_draws
from sunspin.estimate.lander.predict import DrawnMotions
from sunspin.estimate.periods import euler_rates, own_axis
from sunspin.output.kinds.posterior import period_sentences
from tests.support.philae import AS_DRAWN, philae_draws

PHILAE = AS_DRAWN.vehicle


@pytest.mark.parametrize("after_s", [-60.0, 900.0, 2500.0])
def test_periods_of_draws_agree_with_the_reference_motion(after_s):
    """Before the first sample, after it, and when the wheel has handed its momentum to the body, whose own axis is near z."""
    tree = philae_draws(2)
    seen = ss.Period(25200.0 + after_s, 20.0, 1.0)
    found = of_draws.periods_of(DrawnMotions.of(PHILAE, tree), seen)[0]
    draws, t_s = tree["posterior"], after_s + np.linspace(-2, 2, 9) * 20.0
    state = [draws[name].values[0, 0] for name in ("omega_B", "sun_B", "wheel_speed_rad_s")]
    run = ss.propagate(PHILAE, *state, np.append(0.0, t_s if after_s > 0 else t_s[::-1]))
    omega, speeds = run["omega_B"].values[1:], run["wheel_speed_rad_s"].values[1:]
    momentum, axis = (
        gyrostat.total_momentum(PHILAE, omega, speeds),
        own_axis(PHILAE.require_inertia()),
    )
    rates = euler_rates(omega, momentum, axis).mean(axis=0)
    np.testing.assert_allclose(found, 2 * np.pi / np.abs(rates), rtol=1e-3)
    assert abs(axis[2]) > 0.99


def weighted(monkeypatch, periods, seen):
    """Return the group `period` of a posterior whose draws have these periods (n, 3)."""
    monkeypatch.setattr(of_draws, "periods_of", lambda *_: periods)
    tree = philae_draws(len(periods), 0.01)
    return of_draws.draws_by_periods(PHILAE, tree, [seen]).to_dataset()


def test_draws_are_weighted_by_a_period_and_the_reading_is_named(monkeypatch):
    """Spins of 10 to 20 s even, the others far away: the weighted mean is the period seen, and it is the spin."""
    n = 4000
    periods = np.stack([np.full(n, 90.0), np.linspace(10, 20, n), np.full(n, np.nan)], axis=1)
    group = weighted(monkeypatch, periods, ss.Period(0.0, 14.0, 1.0))
    weight = np.exp(group["log_weight"].values[0])
    assert weight.sum() == pytest.approx(1)
    assert weight @ periods[:, 1] == pytest.approx(14.0, abs=0.01)
    assert group.attrs["effective_draws"] == pytest.approx(n * 2 * np.sqrt(np.pi) / 10, rel=0.01)
    assert group.attrs["told"] and "spin 100%" in period_sentences(group)[0]


@pytest.mark.parametrize(
    ("middle", "sigma", "words"),
    [(14.0, 0.05, "periods not used: of these draws"), (60.0, 1.0, "no solution")],
)
def test_periods_that_the_draws_cannot_decide_are_reported(monkeypatch, middle, sigma, words):
    periods = np.stack([np.linspace(10, 20, 4000)] * 3, axis=1)
    group = weighted(monkeypatch, periods, ss.Period(0.0, middle, sigma))
    assert not group.attrs["told"] and words in period_sentences(group)[0]


def test_the_advice_to_draw_more_makes_periods_decisive(monkeypatch):
    """A period that few draws have: the same draws, and eight times as many, as `--draws` gives."""
    few, many = (
        period_sentences(
            weighted(
                monkeypatch,
                np.stack([np.linspace(10, 20, count)] * 3, axis=1),
                ss.Period(0.0, 14.0, 0.05),
            )
        )
        for count in (4000, 32000)
    )
    assert "ask for more --draws" in few[0]
    assert len(many) == 2 and "with periods the angular speed" in many[1]


def test_the_option_period_is_parsed():
    assert parse_period("13.0+-0.5@15:50", "2014-11-12T08:35:00Z") == ss.Period(26100.0, 13.0, 0.5)
    for text in ("13", "13+-0@100", "13+-1", "x+-1@100"):
        with pytest.raises(InputError):
            parse_period(text, None)
