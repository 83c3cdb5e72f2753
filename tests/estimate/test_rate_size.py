"""A sensor of the size of the rate alone: it decides between aliases, is judged like any sensor, and is read from its column."""

from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.estimate.model import States
from sunspin.estimate.rates import rates
from sunspin.estimate.terms.inertial import RateMagnitudes
from sunspin.vehicle.sensors import RateSize, Sensors
from validation.passes import FACES, observe, spin

NOISE_RAD_S = 2e-3
PART = RateSize("rate", 1.0, NOISE_RAD_S)
VEHICLE = """
name = "with the size of its rate"
[telemetry]
time_format = "elapsed"
epoch_utc = "2026-01-01T00:00:00Z"
[sun_vector]
columns = ["sx", "sy", "sz"]
sigma_rad = 0.02
[rate_size]
column = "rate"
scale_rad_s = {scale}
noise_rad_s = 1e-3
"""


def aliased(part=PART, factor=1.0):
    """Return a vehicle, telemetry without and with sizes (times a factor), and the true rates.

    The body spins about its axis of least inertia, and samples are even: whole turns more between them look much the same.
    """
    rng = np.random.default_rng(4)
    t_s = 20.0 * np.arange(12)
    axis = np.array([0.05, 0.03, 1.0])
    omega, attitude = spin(np.radians(6.0) * axis / np.linalg.norm(axis), t_s)
    made = observe(FACES, omega, attitude, t_s, 0.03, rng)
    read = factor * np.linalg.norm(omega, axis=1) + NOISE_RAD_S * rng.normal(size=len(t_s))
    vehicle = replace(made.vehicle, sensors=Sensors(rate_size=part))
    return vehicle, made.telemetry, made.telemetry.assign(rate_size=("time", read)), omega


def test_the_size_of_the_rate_decides_between_aliases():
    vehicle, without, data, omega = aliased()
    alone = rates(vehicle, without, max_rate_rad_s=0.5)
    assert "rate_size_used" not in alone.attrs and not alone["unique"].values[0]
    result = rates(vehicle, data, max_rate_rad_s=0.5)
    assert result.attrs["rate_size_used"] == 1
    assert result["decided"].values[0] and "only Sun directions" not in result.attrs["verdict"]
    sigma = np.sqrt(np.einsum("nii->ni", result["omega_cov_B"].values))
    assert np.all(np.abs(result["omega_B"].values - omega) < 5 * sigma)
    # a motion mirrored by exchanged columns has the same size: the sensor confirms no column
    assert result["columns_checked"].values.tolist() == ["unchecked"]


def test_a_size_that_contradicts_the_sun_does_not_fit():
    vehicle, _, data, _ = aliased(factor=3.0)
    result = rates(vehicle, data, max_rate_rad_s=0.15, column_tests=False)
    assert not result["fits"].values[0]
    assert "size of the rate" in str(result["why_not_decided"].values[0])


def test_an_uncertain_scale_is_estimated():
    vehicle, _, data, omega = aliased(RateSize("rate", 1.0, NOISE_RAD_S, 0.1), factor=1.1)
    result = rates(vehicle, data, max_rate_rad_s=0.15, column_tests=False)
    k = list(result["estimate"].values).index("rate_size_scale")
    value, sigma = (result[f"estimate_{what}"].values[0, k] for what in ("value", "sigma"))
    # the reading less its error is the size: 1.1 size (1 - u) = size
    assert abs(value - (1 - 1 / 1.1)) < 4 * sigma and sigma < 0.03
    assert result["decided"].values[0]


def test_a_body_at_rest_has_a_residual_and_no_slope():
    term = RateMagnitudes(np.array([0.01, 0.0]), 0.005)
    still = States(np.tile(np.eye(3), (1, 2, 1, 1)), np.zeros((1, 2, 3)))
    residual = next(term.residuals(still, np.zeros((1, 0))))
    assert residual.value[0, :, 0].tolist() == [-2.0, 0.0] and not residual.by_rate.any()


def test_the_column_of_a_size_is_read_in_its_unit(tmp_path):
    file = tmp_path / "vehicle.toml"
    file.write_text(VEHICLE.format(scale="{ value = 0.0174532925, sigma = 0.001 }"), "utf-8")
    table = tmp_path / "telemetry.csv"
    table.write_text("time,sx,sy,sz,rate\n0,1,0,0,2\n5,1,0,0,\n10,1,0,0,-1\n", "utf-8")
    vehicle = ss.load_vehicle(file)
    assert vehicle.sensors.rate_size.scale_sigma == 0.001
    data = ss.read_telemetry(table, vehicle)
    assert data["rate_size"].dims == ("time",) and data["rate_size"].attrs["units"] == "rad s-1"
    # a size below zero is none
    np.testing.assert_allclose(data["rate_size"].values, [np.radians(2), np.nan, np.nan])
    file.write_text(VEHICLE.format(scale=-1), "utf-8")
    with pytest.raises(ss.VehicleError, match=r"rate_size.scale_rad_s must be positive"):
        ss.load_vehicle(file)
