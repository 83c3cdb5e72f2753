"""A gyro whose zero is off though the vehicle file takes it for known: the rates are right, and the gyro does not fit."""

from dataclasses import replace

import numpy as np
import pytest

from sunspin.estimate.alternatives import another_zero
from sunspin.estimate.model import Model
from sunspin.estimate.rates import rates
from sunspin.estimate.settings import GYRO_ZEROS, RATES
from sunspin.vehicle.sensors import Sensors
from tests.support.passes import estimate, stated_model
from validation.passes import (
    FACES,
    GYRO,
    ZERO_OFF,
    compare_with_truth,
    draw_times,
    make,
    spin,
    unit,
)
from validation.passes import observe as observe_passes


@pytest.fixture(scope="module")
def simulated():
    """Return a pass of six panels and a gyro whose zero is off by half a degree a second."""
    return make("fault: gyro zero off", 0, 3)


def stated(simulated) -> Model:
    """Return the model of the pass as its vehicle file has it."""
    return stated_model(simulated.vehicle, simulated.telemetry)


def test_a_zero_that_is_stated_is_doubted_and_one_that_is_not_is_free_anyway(simulated):
    (other,) = another_zero(stated(simulated), RATES.alternatives)
    zeros = [unknown for unknown in other.unknowns if unknown.kind == "gyro_zero"]
    assert [unknown.sigma for unknown in zeros] == [GYRO_ZEROS[0]] * 3
    assert all(unknown.doubted and len(unknown.shares) == len(GYRO_ZEROS) for unknown in zeros)
    assert np.isclose(other.log_prior, np.log(0.05 / 0.95))
    assert not list(another_zero(other, RATES.alternatives))


def test_an_axis_whose_zero_is_exact_has_an_unknown_as_the_others_have(simulated):
    """Another zero frees all three axes, and its unknowns take the places of those of the file."""
    gyro = replace(simulated.vehicle.sensors.gyro, zero_sigma=np.array([3.0, 3.0, 0.0]))
    vehicle = replace(simulated.vehicle, sensors=replace(simulated.vehicle.sensors, gyro=gyro))
    model = stated_model(vehicle, simulated.telemetry)
    (other,) = another_zero(model, RATES.alternatives)
    assert [x.name for x in model.unknowns] == [x.name for x in other.unknowns]
    sigmas = [x.sigma for x in model.unknowns if x.kind == "gyro_zero"]
    np.testing.assert_allclose(sigmas, abs(gyro.scale_rad_s) * np.array([3.0, 3.0, 0.003]))


def estimated_zero(result):
    """Return the zero of the gyro (3) and its sigma, rad/s."""
    k = [result["estimate"].values.tolist().index(f"gyro_zero_{axis}") for axis in "xyz"]
    return (result[f"estimate_{what}"].values[0, k] for what in ("value", "sigma"))


def test_the_rates_are_right_and_the_gyro_is_named(simulated):
    result = estimate(simulated, max_rate_rad_s=0.15)
    row = compare_with_truth(result, simulated)
    assert (
        not row["decided"]
        and row["why"] == "POOR FIT (gyro); the gyro contradicts the other readings"
    )
    assert row["pull"] < 3 and row["miss_deg_s"] < np.degrees(ZERO_OFF) / 10
    assert result["model"].values.tolist() == ["another zero offset of the gyro"]
    value, sigma = estimated_zero(result)
    off = (simulated.telemetry["gyro_B"].values - simulated.omega).mean(axis=0)
    assert (np.abs(value - off) < 4 * sigma).all()


def test_a_gyro_with_the_zero_of_the_file_is_believed(simulated):
    off = (simulated.telemetry["gyro_B"].values - simulated.omega).mean(axis=0)
    read = simulated.telemetry["gyro_B"].values - off
    telemetry = simulated.telemetry.assign(gyro_B=(("time", "axis"), read))
    right = simulated._replace(telemetry=telemetry)
    result = estimate(right, max_rate_rad_s=0.15)
    row = compare_with_truth(result, right)
    assert row["decided"] and not row["wrong"]
    assert result["model"].values.tolist() == ["as stated"]


def test_a_zero_that_is_off_within_its_stated_sigma_is_estimated():
    rng = np.random.default_rng(5)
    t_s = draw_times(rng, 24, 10.0)
    omega, attitude = spin(np.radians(2.0) * unit(rng), t_s)
    simulated = observe_passes(FACES, omega, attitude, t_s, 0.02, rng, gyro=True)
    off = 2e-3 * np.array([1.0, -1.0, 0.5])
    read = omega + off + GYRO.noise_rad_s * rng.normal(size=omega.shape)
    data = simulated.telemetry.assign(gyro_B=(("time", "axis"), read))
    gyro = replace(GYRO, zero_sigma=np.full(3, 2e-3))
    vehicle = replace(simulated.vehicle, sensors=Sensors(gyro=gyro))
    result = rates(vehicle, data, max_rate_rad_s=0.15)
    row = compare_with_truth(result, simulated)
    assert row["decided"] and not row["wrong"]
    value, sigma = estimated_zero(result)
    assert (np.abs(value - off) < 4 * sigma).all() and sigma.max() < 1e-3
