"""Friction from a spin-down curve and the running time of a wheel, compared with closed forms and the propagator."""

import numpy as np
import pytest

import sunspin as ss
from sunspin.dynamics.friction import fit_spin_down, spin_down_speed, spin_down_time
from sunspin.vehicle import Friction, Vehicle, Wheel

PUBLISHED = (1271.0, -4.643e-4, -388.9)  # paper, section 2.2
J = 0.0058


def published_curve(t):
    c1, c2, c3 = PUBLISHED
    return c1 * np.exp(c2 * t) + c3


@pytest.mark.evidence(
    "fit_spin_down", "validated", "coefficients and friction of the paper, section 2.2"
)
@pytest.mark.parametrize("t0", [0.0, 700.0])
def test_a_fit_to_the_published_spin_down_curve_returns_its_coefficients(t0, reached):
    t = t0 + np.arange(0.0, 1800.0, 30.0)
    fit = fit_spin_down(t, published_curve(t), J)
    assert (fit.c1_rad_s, fit.c2_per_s, fit.c3_rad_s) == pytest.approx(PUBLISHED, rel=1e-7)
    assert fit.friction.coulomb_N_m == pytest.approx(1.0473e-3, rel=1e-4)
    assert fit.friction.viscous_N_m_s == pytest.approx(2.693e-6, rel=1e-4)
    error = np.abs(np.array([fit.c1_rad_s, fit.c2_per_s, fit.c3_rad_s]) / PUBLISHED - 1)
    reached("relative error of the coefficients", error, "", 1e-7)
    np.testing.assert_allclose(fit(t), published_curve(t), rtol=1e-9)
    # a wheel that turns backward has the same friction
    assert fit_spin_down(t, -published_curve(t), J).friction == fit.friction


def test_the_running_time_of_a_wheel_has_the_limits_of_the_friction_law():
    """And the speed of a coasting wheel follows its fitted curve."""
    assert spin_down_time(Friction(0.0, 1e-6), J, 10.0) == np.inf
    by_dry_friction = pytest.approx(J * 865 / 1e-3, rel=1e-6)
    assert spin_down_time(Friction(1e-3, 0.0), J, 865.0) == by_dry_friction
    assert spin_down_time(Friction(1e-3, 1e-12), J, 865.0) == by_dry_friction
    assert spin_down_time(Friction(1e-3, 1e-6), J, 0.0) == 0.0
    c1, c2, c3 = PUBLISHED
    friction, t = Friction.from_spin_down(c1, c2, c3, J), np.linspace(0, 3000, 301)
    speed = spin_down_speed(friction.coulomb_N_m, friction.viscous_N_m_s, J, c1 + c3, t)
    np.testing.assert_allclose(speed, np.maximum(published_curve(t), 0.0), atol=1e-9)
    assert speed[t > spin_down_time(friction, J, c1 + c3)].max() == 0.0


@pytest.mark.evidence(
    "fit_spin_down", "verified", "the propagator against the closed form of the time to stop"
)
def test_a_very_heavy_body_lets_the_wheel_run_as_long_as_a_fixed_one():
    friction = Friction(1e-3, 2e-6)
    wheel = Wheel("w", [0, 0, 1], J, 300.0, friction)
    vehicle = Vehicle("rock", np.eye(3) * 1e7, 1e6, wheels=[wheel])
    run = ss.propagate(vehicle, [0, 0, 0], [1, 0, 0], 300.0, [0.0, 3000.0])
    expected = spin_down_time(friction, J, 300.0)
    assert run["event_time_s"].values[0] == pytest.approx(expected, rel=1e-7)


@pytest.mark.evidence("fit_spin_down", "verified", "scatter of 60 fits of noisy curves")
def test_the_covariance_of_a_friction_fit_is_the_scatter_of_repeated_fits(reached):
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 2000.0, 25.0)
    fits = [fit_spin_down(t, published_curve(t) + rng.normal(size=t.size), J) for _ in range(60)]
    scatter = np.std([[f.c1_rad_s, f.c2_per_s, f.c3_rad_s] for f in fits], axis=0)
    claimed = np.sqrt(np.mean([np.diag(f.covariance) for f in fits], axis=0))
    reached("scatter over stated error", scatter / claimed)
    # 60 fits fix a width to about 9 %
    assert np.all(np.abs(np.log(scatter / claimed)) < np.log(1.4))


def test_the_error_of_the_spin_down_curve_does_not_depend_on_the_zero_of_time():
    """One record, its clock begun 700 s apart: the variance of the fitted speed at each sample by the covariance of each fit."""
    t = np.arange(0.0, 2000.0, 25.0)
    speed, variances = published_curve(t) + np.random.default_rng(3).normal(size=t.size), []
    for clock in (t, t + 700.0):
        fit = fit_spin_down(clock, speed, J)
        decay = np.exp(fit.c2_per_s * clock)
        slope = np.stack([decay, fit.c1_rad_s * clock * decay, np.ones_like(clock)])
        variances.append(np.einsum("it,ij,jt->t", slope, fit.covariance, slope))
    np.testing.assert_allclose(variances[1], variances[0], rtol=1e-5)


def test_a_fit_to_noisy_viscous_friction_has_no_negative_coulomb_torque():
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 3000.0, 30.0)
    for _ in range(10):
        fit = fit_spin_down(t, 500 * np.exp(-1e-3 * t) + rng.normal(size=t.size) * 0.5, J)
        assert fit.friction.coulomb_N_m >= 0
        assert fit.friction.viscous_N_m_s == pytest.approx(1e-3 * J, rel=0.02)


@pytest.mark.parametrize(
    ("t", "speed", "text"),
    [
        ([0, 1, 2], [3, 2, 1], "4 or more times"),
        ([0, 1, 1, 2], [4, 3, 2, 1], "must increase"),
        ([0, 1, 2, 3], [4, 3, float("nan"), 1], "finite"),
        ([0, 1, 2, 3], [2, 1, 0, 0], "cut the record before the wheel stops"),
        ([0, 1, 2, 3], [1, 2, 3, 4], "does not slow down"),
    ],
)
def test_records_that_are_no_spin_down_are_refused(t, speed, text):
    with pytest.raises(ss.MotionError, match=text):
        fit_spin_down(t, speed, J)
