"""Panels that are read in turn: `rates` models the light at each reading's time. All telemetry is synthetic."""

from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.solve.rotations import components_after_rotation
from sunspin.vehicle import TelemetryForm
from tests.support.simulate import CUBE_WITHOUT_NOISE_STATED as CUBE
from tests.support.simulate import telemetry_of

OFFSET_S = np.array([-2.0, 3.0, 0.0, 5.0, 1.0, -4.0])


@pytest.mark.long
def test_stated_reading_offsets_give_right_rates_that_would_be_wrong_without():
    """At 4 deg/s some panels are read 20 degrees late: unstated, the rate is off three times as far, and nothing shows it (of
    twelve seeds five were decided beyond three sigma then)."""
    rng = np.random.default_rng(1)
    axis, sun = rng.normal(size=(2, 3))
    t = np.concatenate([[0.0], np.cumsum(8 * rng.uniform(0.8, 1.2, 24))])
    omega, sun = np.radians(4) * axis / np.linalg.norm(axis), sun / np.linalg.norm(sun)
    run = ss.propagate(CUBE, omega, sun, None, t)
    omega, sun = run["omega_B"].values, run["sun_B"].values
    light = [
        ss.panel_power(CUBE, components_after_rotation(sun, late * omega))[:, k]
        for k, late in enumerate(OFFSET_S)
    ]
    power = np.stack(light, axis=1) + 0.01 * rng.normal(size=(25, 6))
    data = telemetry_of(CUBE, t, np.maximum(power, 0))
    offsets = dict(zip(CUBE.panel_names, OFFSET_S, strict=True))
    pulls, misses = [], []
    for stated in (False, True):
        form = TelemetryForm(noise=0.01, offset_s=offsets if stated else {})
        result = ss.rates(
            replace(CUBE, telemetry=form), data, max_rate_rad_s=0.1, acceleration_noise=2e-5
        )
        miss = result["omega_mean_B"].values[0, 0] - omega.mean(axis=0)
        misses.append(np.degrees(np.abs(miss).max()))
        pulls.append(np.abs(miss / result["omega_sigma_B"].values[0, 0]).max())
    assert pulls[1] < 2 and 3 * misses[1] < misses[0], (pulls, misses)
