"""What may be believed of an estimate: three questions, one function. The passes are simulated."""

import itertools

import numpy as np
import pytest
from scipy.stats import norm

from sunspin.estimate.passes import PassMotions, speeds, table
from sunspin.estimate.verdict import Misfit, answers, misfit

SOUND = {"Sun": Misfit(40, 0.0, 1.0)}


def test_a_motion_is_decided_where_all_questions_are_answered_with_yes():
    said = answers(True, np.full(3, 0.1), 1.0, SOUND, True, True)
    assert said.decided and said.why_not == ""


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"unique": False}, "several solutions"),
        ({"sigma": np.array([0.1, 0.6, 0.1])}, "constrained: x z only"),
        ({"sigma": np.full(3, 0.9)}, "NOT CONSTRAINED (result equals the prior)"),
        ({"sigma": np.array([0.1, np.nan, 0.1])}, "constrained: x z only"),
        ({"misfits": {"Sun": Misfit(300, 0.34, 1.0)}}, "POOR FIT (Sun)"),
        ({"misfits": SOUND | {"gyro": Misfit(40, 0.5, 1.0)}}, "POOR FIT (gyro)"),
        ({"explained": False}, "POOR FIT"),
        ({"search_complete": False}, "search incomplete"),
        (
            {"search_complete": False, "cure": "give more effort"},
            "search incomplete (give more effort)",
        ),
    ],
)
def test_one_no_is_enough(change, why):
    given = {"unique": True, "sigma": np.full(3, 0.1), "prior_sigma": 1.0, "misfits": SOUND}
    said = answers(**(given | {"explained": True, "search_complete": True} | change))
    assert not said.decided and said.why_not == why
    # what is constrained stays so, whatever else fails
    assert said.constrained[0] == (change.get("sigma", [0.1])[0] < 0.5)


def test_spikes_are_forgiven_and_runs_are_not():
    """Six of a hundred samples far off: strewn they are spikes, one after the other another motion."""
    strewn, together = np.ones(100), np.ones(100)
    strewn[[5, 21, 40, 58, 77, 93]] = 9.0
    together[40:46] = 9.0
    assert misfit(strewn).fits and not misfit(together).fits
    assert misfit(strewn).share == misfit(together).share == pytest.approx(0.06)


def test_the_chance_of_few_runs_is_that_of_all_arrangements():
    """Five of ten far off, in all 252 orders: mean and variance of their runs, and the chance of two by the normal law."""
    runs = []
    for far in itertools.combinations(range(10), 5):
        beyond = np.isin(np.arange(10), far)
        runs.append(1 + np.count_nonzero(beyond[1:] != beyond[:-1]))
    expected = norm.cdf((2 - np.mean(runs)) / np.std(runs))
    assert misfit(np.repeat([1.0, 9.0], 5)).chance == pytest.approx(expected, rel=1e-12)


def test_too_many_far_off_fit_nothing_however_they_are_strewn():
    far = np.ones(100)
    far[::3] = 5.0
    assert (
        not misfit(far).fits
        and misfit(np.full(10, 5.0)).share == 1.0
        and not misfit(np.full(10, 5.0)).fits
    )


def test_a_quarter_far_off_in_stretches_is_another_motion():
    """Stop-and-go seen every second: 24 % of samples beyond three sigma, one stretch after the other."""
    far = np.ones(300)
    for begin in (20, 90, 150, 230):
        far[begin : begin + 18] = 6.0
    assert misfit(far).share == pytest.approx(0.24) and not misfit(far).fits


def test_one_spike_among_four_samples_is_forgiven_and_two_are_not():
    assert (
        misfit(np.array([1.0, 9.0, 1.0, 1.0])).fits
        and not misfit(np.array([1.0, 9.0, 1.0, 9.0])).fits
    )


def test_a_sensor_that_read_nothing_does_not_disagree():
    assert misfit(np.full(5, np.nan)) == Misfit(0, 0.0, 1.0) and misfit(np.full(5, np.nan)).fits


def test_the_table_has_a_row_for_every_motion_and_leaves_out_what_is_not_there():
    said = answers(False, np.array([0.1, 0.9, 0.1]), 1.0, SOUND, True, True)
    omega, covariance = (
        np.array([[0.0, 0.0, 0.1], [0.2, 0.0, 0.0]]),
        1e-6 * np.tile(np.eye(3), (2, 1, 1)),
    )
    speed = speeds(omega, covariance)
    shares, sigma = np.array([0.7, 0.3]), np.full((2, 3), 1e-3)
    one = PassMotions(9, 0.0, 8.25, 4.0, shares, omega, sigma, speed, said, "unchecked")
    other = one._replace(probability=np.ones(1), omega=omega[:1], sigma=sigma[:1], speed=speed[:1])
    found = table([one, other], "2026-01-01T00:00:00Z")
    assert (
        found["probability"][1].shape == (2, 2)
        and np.isnan(found["omega_x"][1][1, 1])
        and found["omega_x"][1][0, 1] == 0.2
    )
    assert (
        found["utc_end"][1][0] == "2026-01-01T00:00:08.250Z"
        and found["utc_at"][1][0] == "2026-01-01T00:00:04.000Z"
    )
    for axis, constrained in (("y", False), ("x", True)):
        assert list(found[f"constrained_{axis}"][1]) == [constrained] * 2
    assert found["speed_low"][1][0, 0] < 0.1 < found["speed_high"][1][0, 0] and table([one], None)[
        "utc_at"
    ][1] == [""]
