"""Passes with whole revolutions between samples. All telemetry is synthetic."""

from __future__ import annotations

import pytest

import sunspin as ss
from tests.support.orbit_cases import SPARSE, one_pass, pass_against_truth, rates_case


@pytest.mark.long
def test_sparse_samples_are_decided_for_the_true_alias_once_the_inertia_is_free():
    """A body at 4.9 deg/s sampled every 52 s: its alias one revolution slower costs 19 with the inertia free, the truth 9."""
    vehicle, data, _, truth, about = rates_case(11, 7, **SPARSE)
    found = pass_against_truth(
        ss.rates(vehicle, one_pass(data, about["begin_s"][0]).drop_vars("field_B")), truth, 0
    )
    assert found["decided"] and not found["wrong"], found


@pytest.mark.long
@pytest.mark.parametrize("i", [3, 5])
def test_a_fast_body_without_an_inertia_is_listed_though_a_slower_motion_fits(i):
    """1.0 and 2.4 revolutions between samples: motions at 0.2 and 4.4 deg/s under torques were decided at 1.00 and 0.94."""
    vehicle, data, _, truth, about = rates_case(7, i, **SPARSE)
    result = ss.rates(vehicle, one_pass(data, about["begin_s"][0]).drop_vars("field_B"))
    found = pass_against_truth(result, truth, 0)
    assert found["listed"] and not (found["decided"] and found["wrong"]), found


@pytest.mark.long
def test_an_alias_of_a_body_without_an_inertia_is_not_decided():
    """A body at 10.5 deg/s, its inertia unknown, sampled every 45 s: from the truth a fit costs 8, as the alias does."""
    vehicle, data, _, truth, about = rates_case(11, 1, **SPARSE)
    result = ss.rates(vehicle, one_pass(data, about["begin_s"][0]).drop_vars("field_B"))
    found = pass_against_truth(result, truth, 0)
    assert found["listed"] and not (found["decided"] and found["wrong"]), found
