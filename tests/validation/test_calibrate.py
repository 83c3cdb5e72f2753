"""Twins of the posterior: drawn as they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sunspin import VehicleError
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from validation.calibrate import TURNED, make

FACES = ([1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1])


def cube() -> Vehicle:
    panels = [Panel(str(k), normal, 1.0) for k, normal in enumerate(FACES)]
    form = TelemetryForm(quantity="current_A", noise=0.02)
    return Vehicle(
        "cube", inertia_kg_m2=np.diag([0.010, 0.012, 0.008]), panels=panels, telemetry=form
    )


def test_a_swapped_twin_is_the_same_but_for_the_swap():
    craft = cube()
    telemetry, truth, _, _ = make(craft, "swapped", 0.2, 12, 20.0, 0, 0)
    again, same, _, _ = make(craft, "swapped", 0.2, 12, 20.0, 0, 0)
    assert np.array_equal(telemetry["current_A"], again["current_A"]) and np.array_equal(
        truth.omega, same.omega
    )


def test_a_vehicle_without_a_noise_is_refused_with_a_sentence():
    """Its twins have no noise to be made with; once this was a division of None."""
    craft = replace(cube(), telemetry=TelemetryForm(quantity="current_A"))
    with pytest.raises(VehicleError, match=r"noise under \[telemetry\]"):
        make(craft, "unknown", 0.2, 12, 20.0, 0, 0)


def test_twins_with_turned_panels_are_drawn_from_the_prior_that_is_given():
    telemetry, truth, unknown, priors = make(cube(), "turned", 0.2, 12, 20.0, 0, 0)
    drawn = np.tensordot(truth.u[0], unknown.turns, axes=1)
    np.testing.assert_allclose(telemetry.attrs["truth_tilt_B_rad"].reshape(6, 3), drawn, atol=1e-15)
    assert set(TURNED) < set(priors) and 0.005 < np.abs(drawn).max() < 0.5
