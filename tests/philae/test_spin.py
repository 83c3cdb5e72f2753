"""The spin fit: a dense search, aliases of regular and irregular sampling, calibrated errors."""

import numpy as np
import pytest

import sunspin as ss
from sunspin.philae.spin import errors_of_rates, fit_spin, phase, rotated_sun

CUBIC = np.array([0.01216, 5.161e-8, -3.189e-12, 3.013e-17])  # paper, section 3.1
SUN = np.array([0.8, 0.0, 0.6])


def samples(seed, jitter=6.0, noise=0.03, n=90, coefficients=CUBIC, axis=(0, 0, 1), interval=176.0):
    rng = np.random.default_rng(seed)
    t = interval * np.arange(n) + rng.uniform(-jitter, jitter, n)
    t -= t[0]
    true = rotated_sun(SUN, axis, phase(coefficients, t))
    seen = true + noise * rng.normal(size=true.shape)
    return t, seen / np.linalg.norm(seen, axis=1, keepdims=True)


def test_the_spin_phase_is_the_integral_of_the_rate_and_the_sun_moves_by_the_equations_of_motion():
    assert phase([0.1, 0.02], [3.0]) == pytest.approx(0.1 * 3 + 0.02 * 9 / 2)
    craft = ss.Vehicle("plate", inertia_kg_m2=np.diag([2.0, 2.0, 3.0]))
    t = np.linspace(0, 500, 11)
    run = ss.propagate(craft, [0, 0, 0.0122], SUN, None, t)
    ours = rotated_sun(SUN, [0, 0, 1], phase([0.0122], t))
    np.testing.assert_allclose(ours, run["sun_B"].values, atol=1e-10)


def test_the_spin_fit_finds_the_minimum_of_a_dense_search():
    """No rate on a grid ten times as dense, over all aliases, does better with the fitted drift."""
    t, seen = samples(2)
    fit = fit_spin(t, seen)
    rates = np.arange(fit.scan_rate[0], fit.scan_rate[-1], 1e-5)
    each = np.column_stack([rates, np.tile(fit.coefficients[1:], (rates.size, 1))])
    direct = errors_of_rates(each, t, seen)
    assert fit.E <= direct.min() + 1e-12
    assert abs(rates[np.argmin(direct)] - fit.coefficients[0]) < 2e-5


@pytest.mark.parametrize("cases", [30, pytest.param(80, marks=pytest.mark.long)])
def test_errors_of_the_spin_rate_are_calibrated(cases):
    """Over the simulated cases the chi-square of the four coefficients has mean 4 within its own scatter."""
    found = []
    for seed in range(cases):
        t, seen = samples(100 + seed, n=60)
        fit = fit_spin(t, seen, rate_range=(0.008, 0.016))
        off = fit.coefficients - CUBIC
        found.append(off @ np.linalg.solve(fit.covariance, off))
    assert np.mean(found) == pytest.approx(4.0, abs=3 * np.sqrt(8 / cases))


def test_irregular_times_exclude_aliases_of_the_spin_rate():
    t, seen = samples(3, interval=120.0)
    fit = fit_spin(t, seen)
    assert fit.unique
    assert fit.aliases[0, 0] == pytest.approx(CUBIC[0], abs=5e-4)


def test_at_regular_times_aliases_fit_equally_and_are_reported():
    """Negative control. At 120 s sampling 0.01216 - 2 pi / 120 = -0.0402 and + 2 pi / 120 = 0.0645 rad/s fit as well."""
    t, seen = samples(3, jitter=0.0, interval=120.0)
    fit = fit_spin(t, seen)
    assert not fit.unique
    assert fit.alias_gap == pytest.approx(0.0, abs=1e-3)
    near = np.sort(fit.aliases[fit.aliases[:, 1] < fit.E + 1e-6, 0] - CUBIC[0])
    np.testing.assert_allclose(near[np.abs(near) < 0.06], [-0.05236, 0.0, 0.05236], atol=4e-4)


def test_the_spin_fit_takes_any_axis_any_degree_and_missing_samples():
    axis = np.array([1.0, 0.0, 0.0])
    t, seen = samples(5, coefficients=[-0.004, 1e-8], axis=axis, noise=0.01, interval=100.0)
    seen[::3] = np.nan
    fit = fit_spin(t, seen, degree=1, axis_B=axis)
    assert np.abs(fit.coefficients - [-0.004, 1e-8]).max() < 1e-5
    assert fit.unique


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"t_s": [2.0, 1.0, 3.0]}, "increasing times"),
        ({"axis_B": [0, 0, 2.0]}, "axis_B must be a unit vector"),
        ({"rate_range": (1.0, 0.0)}, "rate_range must be"),
        ({"sun_B": np.full((90, 3), np.nan)}, "needs at least 7 directions .found 0 of 90"),
    ],
)
def test_bad_input_of_the_spin_fit_is_named(change, text):
    t, seen = samples(6)
    with pytest.raises(ss.SunspinError, match=text):
        fit_spin(**({"t_s": t, "sun_B": seen} | change))
