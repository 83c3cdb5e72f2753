"""Sensor calibration from telemetry, and the copy of the vehicle file that states it."""

from __future__ import annotations

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
from sunspin.environment.elements import parse_elements
from sunspin.environment.orbit import in_orbit
from sunspin.estimate.calibrate import sensors as calibrate
from sunspin.estimate.calibrate.gyro import GyroFit, fit_gyro
from sunspin.estimate.orbit.check import OrbitCheck, Verdict
from sunspin.vehicle.rewrite import NewValue, rewrite_values
from sunspin.vehicle.sensors import Gyro
from tests.support.calibration_cases import calibration_case, deviations


@cache
def few(off: float = 1.0):
    """Return a simulated case with every second sample; it is shared and never changed."""
    case = calibration_case(1, 0, off, gyro=False)
    return case._replace(telemetry=case.telemetry.isel(time=slice(None, None, 2)))


def calibrated(case, monkeypatch, verdict=Verdict.FITS):
    """With the orbit check's answer given: it has tests of its own."""
    start = OrbitCheck(0.0, 10.0, verdict, matrix=1e-9 * np.eye(3), zero=np.zeros(3))
    monkeypatch.setattr(calibrate, "check_orbit", lambda *_: start)
    elements = parse_elements("\n".join(case.elements), "twin")
    time = case.telemetry["time"].values
    orbit = in_orbit(
        elements, case.telemetry.attrs["epoch_utc"], time, shift_sigma_s=case.shift_sigma_s
    )
    return ss.calibrate_sensors(case.vehicle, case.telemetry, orbit)


@pytest.mark.evidence(
    "calibrate_sensors",
    "modelled",
    "simulated sensors in orbit with known errors, and without errors",
)
@pytest.mark.long
@pytest.mark.parametrize("off", [1.0, 0.0])
def test_calibration_finds_sensor_errors_within_sigmas_and_changes_no_good_sensor(off, monkeypatch):
    case = few(off)
    found = calibrated(case, monkeypatch)
    z = deviations(case, found)
    kinds = {name.split(".")[0] for name in z}
    assert (
        kinds == {"panel", "magnetometer", "sun_sensor"}
        and "magnetometer.matrix" in z
        and "magnetometer.zero" in z
    )
    every = np.abs(np.concatenate(list(z.values())))
    assert np.sqrt((every**2).mean()) < 1.5 and every.max() < 4
    zero = found.isel(quantity=found["key"].values == "magnetometer.zero")
    assert np.all(zero["sigma"].values < 400) and (found["moved"].values.mean() > 0.6) == bool(off)
    assert (
        found.attrs["field_residual_after_T"] < 3.5e-7
        and " samples of twin.csv, 2021-03-" in found.attrs["source"]
    )
    text = str(found.sunspin.summary())
    assert "magnetometer.zero = (" in text and "Shift along the track" in text


@pytest.mark.evidence(
    "calibrate_sensors", "modelled", "a simulated magnetometer with known zero, scale and matrix"
)
def test_a_magnetometer_alone_gets_zero_scale_and_a_symmetric_matrix(monkeypatch):
    """Its y is reversed, so a zero that the reversed column has is that of the other sign."""
    case = calibration_case(1, 0, gyro=False)
    part = replace(case.vehicle.sensors.magnetometer, columns=("x", "-y", "z"))
    case = case._replace(
        truth=case.truth | {"magnetometer.zero": case.truth["magnetometer.zero"] * part.sign}
    )
    sensors = replace(case.vehicle.sensors, sun_sensors=(), magnetometer=part)
    data = case.telemetry.drop_vars(["power_W", "panel", "sun_sensor_angle", "sun_sensor_y_turned"])
    data = data.isel(time=slice(None, None, 3))
    found = calibrated(
        case._replace(vehicle=replace(case.vehicle, sensors=sensors), telemetry=data), monkeypatch
    )
    z = deviations(case, found)
    assert set(z) == {"magnetometer.zero", "magnetometer.matrix", "magnetometer.scale_T"}
    assert np.abs(np.concatenate(list(z.values()))).max() < 4
    matrix = found["value"].values[found["key"].values == "magnetometer.matrix"].reshape(3, 3)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12)
    assert "magnetometer.zero = (" in str(found.sunspin.summary())


def test_elements_that_do_not_fit_give_no_calibration(monkeypatch):
    with pytest.raises(
        ss.InputError,
        match="the elements do not fit the telemetry, which cannot be calibrated with them",
    ):
        calibrated(few(), monkeypatch, Verdict.REFUSED)


def test_a_magnetometer_of_the_wrong_sign_is_not_calibrated(monkeypatch):
    check = OrbitCheck(
        0.0, 10.0, Verdict.FITS, matrix=1e-9 * np.eye(3), zero=np.zeros(3), sign_turned=True
    )
    monkeypatch.setattr(calibrate, "check_orbit", lambda *_: check)
    case = few()
    data = case.telemetry.drop_vars(["power_W", "panel"])
    orbit = in_orbit(
        parse_elements("\n".join(case.elements), "twin"),
        data.attrs["epoch_utc"],
        data["time"].values,
    )
    with pytest.raises(ss.InputError, match="has the opposite sign.* change the sign of `matrix`"):
        ss.calibrate_sensors(case.vehicle, data, orbit)


def test_without_an_orbit_only_the_panels_are_calibrated():
    case = few()
    found = ss.calibrate_sensors(case.vehicle, case.telemetry)
    assert {name.split(".")[0] for name in found["key"].values} == {"panel"}
    assert "not determined without an orbit" in found.attrs["notes"]


@pytest.mark.evidence(
    "calibrate_sensors",
    "modelled",
    "a simulated gyro with known zero and scale, and rates estimated without it",
)
def test_a_gyro_is_calibrated_by_rates_estimated_without_it():
    rng = np.random.default_rng(1)
    off = []
    for _ in range(30):
        passes, each = 8, 10
        rate = np.repeat(0.03 * rng.normal(size=(passes, 3)), each, axis=0)
        pass_of = np.repeat(np.arange(passes), each)
        seen = rate + np.repeat(1e-3 * rng.normal(size=(passes, 3)), each, axis=0)
        read = 1.04 * rate + [0.01, -0.02, 0.005] + 5e-4 * rng.normal(size=rate.shape)
        t = np.arange(len(rate)) * 30.0
        found = xr.Dataset(
            {
                "omega_B": (("time", "axis"), seen),
                "omega_cov_B": (("time", "a", "b"), np.tile(1e-6 * np.eye(3), (len(t), 1, 1))),
                "pass_of": ("time", pass_of),
                "decided": ("pass_id", np.ones(passes, dtype=bool)),
            },
            {"time": t},
        )
        gyro, data = (
            Gyro(("a", "b", "c"), 1.0, np.zeros(3), 5e-4),
            xr.Dataset({"gyro_B": (("time", "axis"), read)}, {"time": t}),
        )
        fit = fit_gyro(gyro, data, found)
        sigma = np.sqrt(np.maximum(np.diag(fit.model), np.diag(fit.robust)))
        off.append((fit.values - [0.01, -0.02, 0.005, 1.04]) / sigma)
    assert 1 / 1.5 < np.sqrt(np.mean(np.square(off))) < 1.5 and fit.passes == 8
    found["decided"][2:] = False
    assert fit_gyro(gyro, data, found) is None, "two passes do not show how far off their rates are"


def test_written_keys_of_a_gyro_with_reversed_columns_read_as_the_fit():
    gyro, read = (
        Gyro(("-a", "b", "-c"), -0.5, [3, 1, 2], 5e-4),
        np.random.default_rng(1).normal(size=(20, 3)),
    )
    fit = GyroFit(np.array([0.01, -0.02, 0.005, 1.04]), np.eye(4), np.eye(4), np.ones(4), 20, 3)
    keys = {key.key: key.value for key in calibrate._gyro_keys(gyro, fit)}
    now = replace(gyro, zero=keys["zero"], scale_rad_s=float(keys["scale_rad_s"][0]))
    np.testing.assert_allclose(
        now.interpret(read).values,
        (gyro.interpret(read).values - fit.values[:3]) / fit.values[3],
        atol=1e-12,
    )


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
    assert (
        text.index("scale_T") < text.index("# noise = 5")
        and tomllib.loads(text)["gyro"]["scale_rad_s"]["value"] == 1.1
    )
    with pytest.raises(ss.VehicleError, match=r"the vehicle file has no table \[panel\.-X\]"):
        rewrite_values(FILE, [NewValue(("panel", "-X"), "gain_W", 1.0, 0.1, "s")])


def test_calibrate_sensors_writes_a_copy_and_never_overwrites_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runner = CliRunner()
    runner.invoke(cli, ["init", "."])
    before = (tmp_path / "vehicle.toml").read_text("utf-8")
    done = runner.invoke(
        cli,
        ["calibrate-sensors", "vehicle.toml", "telemetry.csv", "--out", "new.toml"],
        catch_exceptions=False,
    )
    assert done.exit_code == 0 and (tmp_path / "vehicle.toml").read_text("utf-8") == before
    new = (tmp_path / "new.toml").read_text("utf-8")
    assert {line for line in before.splitlines() if line.startswith("#")} <= set(new.splitlines())
    for out in ("new.toml", "vehicle.toml"):
        with pytest.raises(
            SunspinError, match=f"{out}: this file is there already; choose another --out"
        ):
            runner.invoke(
                cli,
                ["calibrate-sensors", "vehicle.toml", "telemetry.csv", "--out", out],
                catch_exceptions=False,
            )
    assert (tmp_path / "new.toml").read_text("utf-8") == new
