"""A gyro: its zero is estimated if the file says that it may be off; a zero off that the file does not state does not fit."""

from dataclasses import replace

import numpy as np
import pytest

from sunspin.estimate.rates import rates
from sunspin.vehicle.sensors import Sensors
from validation.passes import FACES, GYRO, compare_with_truth, draw_times, observe, spin, unit


@pytest.mark.parametrize(
    ("zero_rad_s", "stated", "fits"),
    [(2e-3, True, True), (0.0, False, True), (0.01, False, False)],
    ids=["stated", "not stated, none", "not stated, off"],
)
def test_zero_of_a_gyro(zero_rad_s, stated, fits):
    rng = np.random.default_rng(5)
    t_s = draw_times(rng, 24, 10.0)
    omega, attitude = spin(np.radians(2.0) * unit(rng), t_s)
    simulated = observe(FACES, omega, attitude, t_s, 0.02, rng, gyro=True)
    off = zero_rad_s * np.array([1.0, -1.0, 0.5])
    read = omega + off + GYRO.noise_rad_s * rng.normal(size=omega.shape)
    data = simulated.telemetry.assign(gyro_B=(("time", "axis"), read))
    gyro = replace(GYRO, zero_sigma=np.full(3, 2e-3 if stated else 0.0))
    vehicle = replace(simulated.vehicle, sensors=Sensors(gyro=gyro))
    result = rates(vehicle, data, max_rate_rad_s=0.15)
    row = compare_with_truth(result, simulated)
    assert row["decided"] == fits and not row["wrong"]
    assert ("gyro" in row["why"]) != fits
    names = list(result["estimate"].values)
    for axis, true in zip("xyz", off, strict=True):
        k = names.index(f"gyro_zero_{axis}")
        value, sigma = (result[f"estimate_{what}"].values[0, k] for what in ("value", "sigma"))
        assert abs(value - true) < 4 * sigma and sigma < 1e-3
