"""Sensors calibrated by their own telemetry: errors within sigmas, nothing written that the data do not determine."""

import tomllib
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import sunspin as ss
from sunspin.base.errors import SunspinError
from sunspin.cli import cli
from sunspin.estimate import calibrate
from sunspin.estimate.calibrate import GyroFit, calibrate_sensors, fit_gyro, gyro_keys, new_values
from sunspin.estimate.orbit.check import OrbitCheck, Verdict
from sunspin.vehicle.rewrite import NewValue, rewrite_values
from sunspin.vehicle.sensors import Gyro
from tests.support.calibration_cases import calibration_case, deviations, orbit_of_case


@cache
def few(off: float = 1.0):
    """Return a simulated case with every second sample; it is shared and never changed."""
    case = calibration_case(1, 0, off, gyro=False)
    return case._replace(telemetry=case.telemetry.isel(time=slice(None, None, 2)))


def calibrated(case, monkeypatch, verdict=Verdict.FITS, **said):
    """Return the calibration with the answer of the orbit check given: it has tests of its own."""
    check = OrbitCheck(0.0, 10.0, verdict, matrix=1e-9 * np.eye(3), zero=np.zeros(3), **said)
    monkeypatch.setattr(calibrate, "check_orbit", lambda *_: check)
    return calibrate_sensors(case.vehicle, case.telemetry, orbit_of_case(case, case.telemetry))


@pytest.mark.evidence(
    "calibrate_sensors",
    "modelled",
    "simulated sensors in orbit with known errors, and without errors",
)
@pytest.mark.parametrize("off", [1.0, 0.0])
def test_errors_of_sensors_are_found_within_sigmas_and_a_good_sensor_stays(off, monkeypatch):
    case = few(off)
    result = calibrated(case, monkeypatch)
    z = deviations(case, result)
    assert {name.split(".")[0] for name in z} == {"panel", "magnetometer", "sun_sensor"}
    assert "magnetometer.matrix" in z and "magnetometer.zero" in z
    every = np.abs(np.concatenate(list(z.values())))
    assert np.sqrt((every**2).mean()) < 1.5 and every.max() < 4
    zero = result.isel(quantity=result["key"].values == "magnetometer.zero")
    assert np.all(zero["sigma"].values < 400)
    assert (result["moved"].values.mean() > 0.6) == bool(off)
    assert result.attrs["field_residual_after_T"] < 3.5e-7
    assert " samples of twin.csv, 2021-03-" in result.attrs["source"]
    text = str(result.sunspin.summary())
    assert "magnetometer.zero = (" in text and "Shift along the track" in text
    shapes = {value.key: np.shape(value.value) for value in new_values(result)}
    assert shapes["matrix"] == (3, 3) and shapes["zero"] == (3,) and shapes["gain_W"] == ()


@pytest.mark.evidence(
    "calibrate_sensors", "modelled", "a simulated magnetometer with known zero, scale and matrix"
)
def test_a_magnetometer_alone_gets_zero_scale_and_a_symmetric_matrix(monkeypatch):
    """Its y is reversed, so a zero of the reversed column has the opposite sign."""
    case = calibration_case(1, 0, gyro=False)
    part = replace(case.vehicle.sensors.magnetometer, columns=("x", "-y", "z"))
    zero = case.truth["magnetometer.zero"] * part.sign
    sensors = replace(case.vehicle.sensors, sun_sensors=(), magnetometer=part)
    data = case.telemetry.drop_vars(["power_W", "panel", "sun_sensor_angle", "sun_sensor_y_turned"])
    case = case._replace(
        truth=case.truth | {"magnetometer.zero": zero},
        vehicle=replace(case.vehicle, sensors=sensors),
        telemetry=data.isel(time=slice(None, None, 3)),
    )
    result = calibrated(case, monkeypatch)
    z = deviations(case, result)
    assert set(z) == {f"magnetometer.{name}" for name in ("zero", "matrix", "scale_T")}
    assert np.abs(np.concatenate(list(z.values()))).max() < 4
    matrix = result["value"].values[result["key"].values == "magnetometer.matrix"].reshape(3, 3)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12)


@pytest.mark.parametrize(
    ("said", "what"),
    [
        ({"verdict": Verdict.REFUSED}, "do not fit the telemetry, which cannot be calibrated with"),
        ({"sign_turned": True}, "has the opposite sign.* change the sign of `matrix`"),
        ({"turned_axes": "the axes are others; set x"}, "axes are others, and is not .*; set x"),
    ],
)
def test_elements_signs_or_axes_that_do_not_fit_give_no_calibration(said, what, monkeypatch):
    case = few()
    field = case._replace(telemetry=case.telemetry.drop_vars(["power_W", "panel"]))
    with pytest.raises(ss.InputError, match=what):
        calibrated(field, monkeypatch, **said)


def test_without_an_orbit_only_the_panels_are_calibrated():
    case = few()
    result = calibrate_sensors(case.vehicle, case.telemetry)
    assert {name.split(".")[0] for name in result["key"].values} == {"panel"}
    assert "not determined without an orbit" in result.attrs["notes"]
    with pytest.raises(ss.InputError, match="has nothing that can be calibrated"):
        nothing = xr.Dataset(coords={"time": case.telemetry["time"]}, attrs=case.telemetry.attrs)
        calibrate_sensors(case.vehicle, nothing)


@pytest.mark.evidence(
    "calibrate_sensors",
    "modelled",
    "a simulated gyro with known zero and scale, and rates estimated without it",
)
def test_a_gyro_is_calibrated_by_rates_estimated_without_it():
    rng = np.random.default_rng(1)
    gyro, passes, each = Gyro(("a", "b", "c"), 1.0, np.zeros(3), 5e-4), 8, 10
    t_s, off = np.arange(passes * each) * 30.0, []
    for _ in range(30):
        rate = np.repeat(0.03 * rng.normal(size=(passes, 3)), each, axis=0)
        seen = rate + np.repeat(1e-3 * rng.normal(size=(passes, 3)), each, axis=0)
        read = 1.04 * rate + [0.01, -0.02, 0.005] + 5e-4 * rng.normal(size=rate.shape)
        variables = {
            "omega_B": (("time", "axis"), seen),
            "omega_cov_B": (("time", "a", "b"), np.tile(1e-6 * np.eye(3), (len(t_s), 1, 1))),
            "pass_of": ("time", np.repeat(np.arange(passes), each)),
            "decided": ("pass_id", np.ones(passes, dtype=bool)),
        }
        result = xr.Dataset(variables, {"time": t_s})
        data = xr.Dataset({"gyro_B": (("time", "axis"), read)}, {"time": t_s})
        fit = fit_gyro(gyro, data, result)
        off.append((fit.values - [0.01, -0.02, 0.005, 1.04]) / fit.sigma)
    assert 1 / 1.5 < np.sqrt(np.mean(np.square(off))) < 1.5 and fit.passes == 8
    result["decided"][2:] = False
    # two passes do not show how far their rates are off
    assert fit_gyro(gyro, data, result) is None


def test_written_keys_of_a_gyro_with_reversed_columns_read_as_the_fit():
    gyro = Gyro(("-a", "b", "-c"), -0.5, [3, 1, 2], 5e-4)
    read = np.random.default_rng(1).normal(size=(20, 3))
    values = np.array([0.01, -0.02, 0.005, 1.04])
    keys = gyro_keys(gyro, GyroFit(values, np.ones(4), np.ones(4), 20, 3))
    zero, scale = (key.value for key in keys)
    changed = replace(gyro, zero=zero, scale_rad_s=float(scale[0]))
    expected = (gyro.interpret(read).values - values[:3]) / values[3]
    np.testing.assert_allclose(changed.interpret(read).values, expected, atol=1e-12)


FILE = """# my satellite
name = "x"
[[panel]]
name = "+X"
normal_B = [1, 0, 0]
cells = 7   # of the second batch
[magnetometer]
columns = ["a", "b", "c"]
zero = [0, 0, 0]   # by the data sheet
# noise = 5

# the gyro
[gyro]
columns = ["d", "e", "f"]
scale_rad_s = { value = 1.0, sigma = 0.1, source = "old" }
noise_rad_s = 1
"""


def test_the_calibrated_copy_keeps_order_and_comments_of_the_vehicle_file():
    field = ("magnetometer",)
    new = [
        NewValue(("panel", "+X"), "relative_gain", 6.5, 0.1, "s"),
        NewValue(field, "zero", [1.0, 2.0, 3.0], [0.1] * 3, "s"),
        NewValue(field, "scale_T", 2e-9, 1e-11, "s"),
        NewValue(("gyro",), "scale_rad_s", 1.1, 0.01, "s"),
    ]
    text = rewrite_values(FILE, new)
    assert [line for line in text.splitlines() if line not in FILE.splitlines()] == [
        'relative_gain = {value = 6.5, sigma = 0.1, source = "s"}   # of the second batch',
        'zero = {value = [1.0, 2.0, 3.0], sigma = [0.1, 0.1, 0.1], source = "s"}   # by the data sheet',
        'scale_T = {value = 2e-09, sigma = 1e-11, source = "s"}',
        'scale_rad_s = {value = 1.1, sigma = 0.01, source = "s"}',
    ]
    assert text.index("scale_T") < text.index("# noise = 5")
    assert tomllib.loads(text)["gyro"]["scale_rad_s"]["value"] == 1.1
    with pytest.raises(ss.VehicleError, match=r"the vehicle file has no table \[panel\.-X\]"):
        rewrite_values(FILE, [NewValue(("panel", "-X"), "gain_W", 1.0, 0.1, "s")])


def test_calibrate_sensors_writes_a_copy_and_never_overwrites_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runner = CliRunner()
    runner.invoke(cli, ["init", "."])
    before = (tmp_path / "vehicle.toml").read_text("utf-8")
    words = ["calibrate-sensors", "vehicle.toml", "telemetry.csv", "--out"]
    done = runner.invoke(cli, [*words, "new.toml"], catch_exceptions=False)
    assert done.exit_code == 0 and (tmp_path / "vehicle.toml").read_text("utf-8") == before
    new = (tmp_path / "new.toml").read_text("utf-8")
    assert {line for line in before.splitlines() if line.startswith("#")} <= set(new.splitlines())
    for out in ("new.toml", "vehicle.toml"):
        refusal = f"{out}: this file is there already; choose another --out"
        with pytest.raises(SunspinError, match=refusal):
            runner.invoke(cli, [*words, out], catch_exceptions=False)
    assert (tmp_path / "new.toml").read_text("utf-8") == new
