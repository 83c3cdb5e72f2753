"""E and EMD: closed forms, the axioms of a metric, an independent witness."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sunspin as ss

samples = st.lists(st.floats(-1, 1), min_size=1, max_size=12)


def test_emd_by_hand():
    assert ss.emd([-1], [1]) == 1.0  # all mass over the whole way
    assert ss.emd([0.2], [0.5]) == pytest.approx(0.15)
    assert ss.emd([0, 1], [0], [3, 1], [1]) == pytest.approx(0.125)


@settings(deadline=None)
@given(samples, samples, samples)
def test_emd_is_a_metric(a, b, c):
    assert ss.emd(a, a) == 0
    assert ss.emd(a, b) == pytest.approx(ss.emd(b, a), abs=1e-12)
    assert ss.emd(a, c) <= ss.emd(a, b) + ss.emd(b, c) + 1e-12
    assert 0 <= ss.emd(a, b) <= 1


@settings(deadline=None)
@given(st.integers(1, 40), st.integers(0, 1000))
def test_emd_of_equal_numbers_is_the_mean_of_sorted_differences(n, seed):
    a, b = np.random.default_rng(seed).uniform(-1, 1, (2, n))
    assert ss.emd(a, b) == pytest.approx(np.abs(np.sort(a) - np.sort(b)).mean() / 2, abs=1e-12)


def test_direction_error_by_hand():
    x, y = np.eye(3)[:1], np.eye(3)[1:2]
    assert ss.direction_error(x, x) == 0
    assert ss.direction_error(x, -x) == 1
    assert ss.direction_error(x, y) == 0.5
    angle = np.radians(6.1)
    tilted = np.array([[np.cos(angle), np.sin(angle), 0]])
    assert ss.direction_error(x, tilted) == pytest.approx(0.0028, abs=5e-5)  # E = 0.0028 is 6.1 degrees


def test_samples_without_a_direction_are_left_out():
    sim = np.tile(np.eye(3)[0], (3, 1))
    meas = np.array([[1, 0, 0], [np.nan] * 3, [0, 1, 0]])
    assert ss.direction_error(sim, meas) == pytest.approx(0.25)


@pytest.mark.parametrize(("a", "b"), [([], [0]), ([2.0], [0]), ([np.nan], [0])])
def test_bad_samples_are_refused(a, b):
    with pytest.raises(ss.InputError, match="z_a"):
        ss.emd(a, b)
