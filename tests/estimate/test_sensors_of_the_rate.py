"""Sensors of the rate: a gyro whose zero is off though the file takes it for known, and a sensor of the rate's size alone."""

import re
import tomllib
from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.estimate.alternatives import another_zero
from sunspin.estimate.model import Model, States
from sunspin.estimate.rates import rates
from sunspin.estimate.settings import GYRO_ZEROS, RATES
from sunspin.estimate.terms.inertial import RateMagnitudes
from sunspin.vehicle.sensors import Gyro, RateSize, Sensors
from tests.support.passes import errors_in_sigmas, estimate, stated_model
from tests.support.simulate import CUBE, FOUR_SIDES, simulated_pass, uneven_times
from tests.support.vehicles import SUN_VECTOR_FILE, unit_vector
from validation.passes import (
    FACES,
    GYRO,
    ZERO_OFF,
    compare_with_truth,
    draw_times,
    make,
    observe,
    spin,
    unit,
)


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
    simulated = observe(FACES, omega, attitude, t_s, 0.02, rng, gyro=True)
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


# ---- the zero offset of an ordinary gyro: the file does not state it, or it drifts --------------------------------------------


ZERO_DEG_S = np.array([0.3, -0.2, 0.25])
"""Zero offset of the gyro."""


def with_gyro(seed, speed_deg_s=0.6, drift_deg_s=0.0, body=CUBE, order=(0, 1, 2), scale=1.0):
    """Return vehicle, telemetry and true motion of a pass with a gyro of 0.02 deg/s noise.

    Its zero offset, which the vehicle file does not state, drifts over the pass along a drawn axis. `order`: of its columns. It
    reads `scale` times the rate.
    """
    rng = np.random.default_rng(seed)
    t_s = uneven_times(rng, 20, 10.0, 0.1)
    data, run = simulated_pass(body, np.radians(speed_deg_s) * unit_vector(rng), t_s, rng)
    noise, drift = np.radians(0.02), drift_deg_s * np.outer(t_s / t_s[-1] - 0.5, unit_vector(rng))
    read = scale * run["omega_B"].values + np.radians(ZERO_DEG_S + drift)
    read = (read + noise * rng.normal(size=read.shape))[:, order]
    vehicle = replace(body, sensors=Sensors(gyro=Gyro(("x", "y", "z"), 1.0, np.zeros(3), noise)))
    return vehicle, data.assign(gyro_B=(("time", "axis"), read)), run


def worst(result, run):
    """Return the largest error of a component of the rate at any sample, in sigmas."""
    sigma = np.sqrt(np.einsum("nii->ni", result["omega_cov_B"].values))
    true = run["omega_B"].sel(time=result["time"]).values
    return float((np.abs(result["omega_B"].values - true) / sigma).max())


@pytest.mark.evidence(
    "rates", "modelled", "a gyro whose zero offset the vehicle file does not state"
)
def test_a_zero_that_the_file_does_not_state_is_estimated_and_no_axes_are_accused():
    vehicle, data, run = with_gyro(8)
    result = rates(vehicle, data, max_rate_rad_s=0.08)
    assert result["decided"].all() and worst(result, run) < 4.5
    assert "columns_doubt" not in result.attrs
    value, sigma = estimated_zero(result)
    assert (np.abs(value - np.radians(ZERO_DEG_S)) < 4 * sigma).all()


def test_other_axes_of_a_gyro_without_a_stated_zero_are_named():
    vehicle, data, _ = with_gyro(9, 3.0, order=(1, 0, 2))
    result = rates(vehicle, data, max_rate_rad_s=0.08)
    assert not result["decided"].any()
    assert "the gyro read as (+y, +x, +z) of its columns" in result.attrs["columns_doubt"]


def test_a_zero_that_the_others_do_not_confirm_is_named_and_stated_decides_the_pass():
    """Panels on four sides leave a mirror image, which would fit the gyro along other axes."""
    vehicle, data, run = with_gyro(10, body=FOUR_SIDES)
    result = rates(vehicle, data, max_rate_rad_s=0.08)
    assert not result["decided"].any()
    said = re.search(r"set (zero = .*) under \[gyro\]", result.attrs["verdict"])
    assert said is not None, result.attrs["verdict"]
    zero = tomllib.loads(said[1])["zero"]
    gyro = replace(
        vehicle.sensors.gyro, zero=np.array(zero["value"]), zero_sigma=np.full(3, zero["sigma"])
    )
    stated_zero = replace(vehicle, sensors=Sensors(gyro=gyro))
    result = rates(stated_zero, data, max_rate_rad_s=0.08)
    assert result["decided"].all() and worst(result, run) < 4.5


def test_a_zero_that_drifts_within_a_pass_is_estimated():
    vehicle, data, run = with_gyro(11, drift_deg_s=0.2)
    result = rates(vehicle, data, max_rate_rad_s=0.08)
    assert result["decided"].all() and worst(result, run) < 4.5
    assert result["model"].values.tolist() == ["a drifting zero offset of the gyro"]


def test_a_scale_whose_error_the_file_does_not_state_is_estimated():
    """A fast body whose gyro reads 1.5 % too much was decided, and 28 sigma off."""
    vehicle, data, run = with_gyro(16, 35.0, scale=1.015)
    gyro = replace(vehicle.sensors.gyro, zero_sigma=np.full(3, np.radians(0.5)))
    result = rates(replace(vehicle, sensors=Sensors(gyro=gyro)), data, max_rate_rad_s=1.0)
    assert result["decided"].all() and worst(result, run) < 4.5


# ---- the size of the rate alone decides between aliases, and is judged like any sensor --------------------------------------


NOISE_RAD_S = 2e-3
PART = RateSize("rate", 1.0, NOISE_RAD_S)
VEHICLE = (
    SUN_VECTOR_FILE
    + """
[rate_size]
column = "rate"
scale_rad_s = {scale}
noise_rad_s = 1e-3
"""
)


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
    assert np.abs(errors_in_sigmas(result, omega)).max() < 5
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
