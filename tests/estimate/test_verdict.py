"""The checks that decide a pass: uniqueness, constraints, fit, completeness, upper limits. The passes are simulated."""

import itertools

import numpy as np
import pytest
import xarray as xr
from scipy.stats import chi, norm

from sunspin.estimate.calibrate import rate_known
from sunspin.estimate.rates_dataset import OTHERS_DO_NOT_FIT, with_doubted_passes
from sunspin.estimate.verdict import (
    AtOnce,
    Misfit,
    PassRow,
    answers,
    misfit,
    passes_table,
    upper_text,
)

SOUND = {"Sun": Misfit(40, 0.0, 1.0)}


def said(omega=(1.0, 0.0, 0.0), sigma=(0.1,) * 3, rate_sigma=1.0, probability=(1.0,), **checks):
    """Return the answers for solutions (K, 3) with independent components, the first of which is another one than the rest."""
    checks = {"misfits": SOUND, "explained": True, "left_open": ""} | checks
    omega, sigma = np.atleast_2d(omega), np.atleast_2d(sigma)
    covariance = np.stack([np.diag(one**2) for one in sigma])
    first = np.arange(len(omega)) == 0
    shares = np.array(probability)
    motions = AtOnce(shares, omega, covariance, first)
    return answers(motions, rate_sigma, **checks)


TWO = {"omega": np.eye(3)[[0, 0]], "sigma": np.full((2, 3), 0.1), "probability": (0.8, 0.2)}


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({}, ""),
        (TWO, "several solutions"),
        ({"sigma": (0.1, 0.6, 0.1)}, "constrained: x z only"),
        ({"sigma": (0.9, 0.9, 0.9)}, "NOT CONSTRAINED (result equals the prior)"),
        ({"sigma": (0.1, np.nan, 0.1)}, "constrained: x z only"),
        ({"misfits": {"Sun": Misfit(300, 0.34, 1.0)}}, "POOR FIT (Sun)"),
        ({"misfits": SOUND | {"gyro": Misfit(40, 0.5, 1.0)}}, "POOR FIT (gyro)"),
        ({"explained": False}, "POOR FIT"),
        ({"misfits": SOUND | {"gyro": SOUND["Sun"]}, "denied": ("gyro",)}, "POOR FIT (gyro)"),
        ({"left_open": "give more effort"}, "search incomplete (give more effort)"),
    ],
)
def test_a_pass_is_decided_only_if_all_checks_pass(change, why):
    found, _ = said(**change)
    assert found.decided is (why == "") and found.why_not == why
    # what is constrained stays so, whatever else fails
    assert found.constrained[0] == (np.ravel(change.get("sigma", [0.1]))[0] < 0.5)


def far(count, *places):
    """Return misfits (count) in sigmas, of which those at these places are far off."""
    return np.where(np.isin(np.arange(count), places), 9.0, 1.0)


@pytest.mark.parametrize(
    ("sigmas", "share", "fits"),
    [
        (far(100, 5, 21, 40, 58, 77, 93), 0.06, True),
        (far(100, *range(40, 46)), 0.06, False),  # one after the other: another motion
        (far(100, *range(0, 100, 3)), 0.34, False),
        (far(10, *range(10)), 1.0, False),
        # stop-and-go seen every second
        (far(300, *(begin + k for begin in (20, 90, 150, 230) for k in range(18))), 0.24, False),
        (far(4, 1), 0.25, True),
        (far(4, 1, 3), 0.5, False),
    ],
    ids=["strewn", "run", "third", "all", "runs", "one of four", "two of four"],
)
def test_few_single_outliers_fit_and_runs_or_many_do_not(sigmas, share, fits):
    assert misfit(sigmas).share == pytest.approx(share) and misfit(sigmas).fits is fits


def test_the_probability_of_few_runs_is_that_over_all_arrangements():
    """Five of ten far off, in all 252 orders: mean and variance of their runs, and the chance of two by the normal law."""
    runs = []
    for far in itertools.combinations(range(10), 5):
        beyond = np.isin(np.arange(10), far)
        runs.append(1 + np.count_nonzero(beyond[1:] != beyond[:-1]))
    expected = norm.cdf((2 - np.mean(runs)) / np.std(runs))
    assert misfit(np.repeat([1.0, 9.0], 5)).chance == pytest.approx(expected, rel=1e-12)


def test_the_table_of_passes_has_a_row_for_each_solution_and_no_empty_one():
    omega, sigma = np.array([[0.0, 0.0, 0.1], [0.2, 0.0, 0.0]]), np.full((2, 3), 1e-3)
    shares = np.array([0.7, 0.3])
    found, speed = said(omega, sigma, 0.2, shares)
    one = PassRow(9, 0.0, 8.25, 4.0, shares, omega, sigma, speed, found, "unchecked")
    other = one._replace(probability=np.ones(1), omega=omega[:1], sigma=sigma[:1], speed=speed[:1])
    table = passes_table([one, other], "2026-01-01T00:00:00Z")
    assert table["probability"][1].shape == (2, 2)
    assert np.isnan(table["omega_x"][1][1, 1]) and table["omega_x"][1][0, 1] == 0.2
    assert table["utc_end"][1][0] == "2026-01-01T00:00:08.250Z"
    assert table["utc_at"][1][0] == "2026-01-01T00:00:04.000Z"
    # the other solution is far away in x, and so the mixture is wide there
    for axis, constrained in (("y", True), ("x", False)):
        assert list(table[f"constrained_{axis}"][1]) == [constrained] * 2
    assert table["speed_low"][1][0, 0] < 0.1 < table["speed_high"][1][0, 0]
    assert passes_table([one], None)["utc_at"][1] == [""]


def judged(omega_deg_s, sigma_deg_s, limit_deg_s, probability=(1.0,)):
    """Return the answers for solutions whose components are independent, searched up to a largest speed."""
    omega, sigma = np.radians(np.atleast_2d(omega_deg_s)), np.radians(np.atleast_2d(sigma_deg_s))
    return said(omega, sigma, np.radians(limit_deg_s) / 2, probability)[0]


def test_a_rate_smaller_than_its_error_is_an_upper_limit_and_not_decided():
    found = judged([0.0, -0.1, 0.0], [8.4, 1.6, 8.1], 57.3)
    assert all(found.constrained) and not found.decided and not found.speed.constrained
    drawn = np.random.default_rng(7).normal([0.0, -0.1, 0.0], [8.4, 1.6, 8.1], (400_000, 3))
    limit = np.quantile(np.linalg.norm(drawn, axis=1), 0.95)
    assert np.degrees(found.speed.below) == pytest.approx(limit, rel=0.02)
    assert found.why_not == f"speed below {upper_text(np.degrees(found.speed.below))} deg/s (95 %)"


def test_a_speed_larger_than_its_error_stays_decided():
    for omega in ([0.44, 0.0, 0.0], [0.3, 0.3, -0.3]):
        found = judged(omega, [0.34, 0.1, 0.1], 60.0)
        assert found.decided and found.speed.sigma < found.speed.value


def test_error_and_upper_limit_of_the_speed_agree_with_draws():
    """At rest the speed has the Maxwell law; far from rest linear propagation holds; a mixture is sampled."""
    rest = judged([0.0, 0.0, 0.0], [1.0, 1.0, 1.0], 60.0).speed
    assert np.degrees(rest.below) == pytest.approx(chi(3).ppf(0.95), rel=0.02)
    assert np.degrees(rest.sigma) == pytest.approx(np.sqrt(3), rel=0.02)
    fast = judged([20.0, 0.0, 0.0], [1.0, 0.2, 0.2], 60.0).speed
    assert np.degrees(fast.sigma) == pytest.approx(1.0, rel=0.03)
    assert np.degrees(fast.below) == pytest.approx(20 + norm.ppf(0.95), abs=0.05)

    both = judged([[1.0, 0.0, 0.0], [0.0, 9.0, 0.0]], [[0.5] * 3, [0.7] * 3], 60.0, (0.92, 0.08))
    rng = np.random.default_rng(3)
    second = rng.random(400_000) < 0.08
    drawn = np.where(second[:, None], [0.0, 9.0, 0.0], [1.0, 0.0, 0.0])
    drawn = drawn + np.where(second, 0.7, 0.5)[:, None] * rng.normal(size=drawn.shape)
    speed = np.linalg.norm(drawn, axis=1)
    assert np.degrees(both.speed.below) == pytest.approx(np.quantile(speed, 0.95), rel=0.02)
    rms = np.sqrt(np.mean((speed[~second] - 1.0) ** 2))
    assert np.degrees(both.speed.sigma) == pytest.approx(rms, rel=0.02)


def test_an_unlikely_alias_does_not_turn_a_known_speed_into_an_upper_limit():
    found = judged([[0.5, 0, 0], [0, 9.0, 0]], [[0.01] * 3] * 2, 60.0, (0.96, 0.04))
    assert found.speed.constrained
    assert np.degrees(found.speed.sigma) == pytest.approx(0.01, rel=0.05)


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0501, "0.051"), (0.05, "0.05"), (8.41, "8.5"), (119.0, "120"), (1e-4, "0.0001")],
)
def test_an_upper_limit_is_never_rounded_down(value, text):
    assert upper_text(value) == text


def test_a_poor_fit_the_prior_alone_or_an_incomplete_search_gives_no_upper_limit():
    slow = {"omega": (0.01, 0.0, 0.0)}
    assert "below" in said(**slow)[0].why_not  # the control
    for change in ({"explained": False}, {"sigma": (0.9, 0.9, 0.9)}, {"left_open": "more effort"}):
        found, _ = said(**slow, **change)
        assert "below" not in found.why_not and not found.decided


def test_a_pass_with_an_upper_limit_determines_the_gyro_zero():
    names = "decided unique fits search_complete constrained_x constrained_y constrained_z"
    flags = {name: ("pass_id", np.array([name != "decided", False])) for name in names.split()}
    flags |= {"constrained_speed": ("pass_id", [False, True])}
    flags |= {"columns_checked": ("pass_id", ["as_stated", "as_stated"])}
    assert rate_known(xr.Dataset(flags)).tolist() == [True, False]


@pytest.mark.parametrize(
    ("fits", "kept"),
    [
        ([True, False], True),
        ([True, True, False], True),
        ([True, False, False], False),
        ([True, True, False, False], False),
    ],
)
def test_no_pass_is_decided_if_half_of_three_or_more_do_not_fit(fits, kept):
    """What keeps a pass from fitting acts in all: with a magnetometer along other axes some passes fit by chance."""
    why = ["" if fit else "POOR FIT (Sun)" for fit in fits]
    columns = {"fits": fits, "decided": fits, "why_not_decided": why}
    doubted = with_doubted_passes(xr.Dataset({k: ("pass_id", v) for k, v in columns.items()}))
    assert doubted["decided"].values.tolist() == [fit and kept for fit in fits]
    assert doubted["why_not_decided"].values[-1] == "POOR FIT (Sun)"
    assert doubted["why_not_decided"].values[0] == ("" if kept else OTHERS_DO_NOT_FIT)
