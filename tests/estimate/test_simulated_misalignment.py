"""Simulated telemetry with misaligned panels."""

import numpy as np
import pytest

import sunspin as ss
from sunspin.base.errors import InputError
from tests.support.vehicles import small_cube


def test_simulated_telemetry_takes_misalignments_or_their_sigma():
    truth = {
        "omega_B": [0.05, -0.08, 0.11],
        "sun_B": np.array([0.3, 0.5, 0.8]) / np.sqrt(0.98),
        "t_s": 20.0 * np.arange(12),
        "scale": 0.5,
    }
    craft = small_cube(0.005)
    drawn = ss.twin(craft, truth | {"tilt_B_rad": 0.04}, seed=3)
    tilt = drawn.attrs["truth_tilt_B_rad"].reshape(6, 3)
    again = ss.twin(craft, truth | {"tilt_B_rad": tilt}, seed=3)
    np.testing.assert_array_equal(again["current_A"].values, drawn["current_A"].values)
    assert "truth_tilt_B_rad" not in ss.twin(craft, truth, seed=3).attrs
    for wrong in (-0.1, np.zeros((5, 3)) + 0.1, np.full((6, 3), np.nan)):
        with pytest.raises(InputError, match="tilt_B_rad of a twin"):
            ss.twin(craft, truth | {"tilt_B_rad": wrong})
