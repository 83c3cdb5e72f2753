"""A gyro and a quaternion that `rates` did not use, set next to its result: differences, their errors, conventions, bad input."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.cli import cli
from sunspin.output.compared import compare_with, compared_summary, compared_tables
from sunspin.telemetry.withheld import parse_withheld, read_withheld
from sunspin.vehicle.sensors import Clock
from tests.support.figures import blank

SUN_SIGMA, TURN_SIGMA, RATE_SIGMA = 0.03, 0.05, np.radians(0.08)
"""Errors (rad, rad/s) of the drawn results: the Sun direction, both components together; the rotation about it; a rate."""

SIZE = 300


@pytest.fixture(scope="module")
def vehicle() -> ss.Vehicle:
    return ss.load_example("cubesat")[0]


def drawn_result(seed: int, frame: str = "J2000") -> tuple[xr.Dataset, Rotation, np.ndarray]:
    """Return a result of `rates` with drawn errors, the true attitude B_from_N (n), and the true rate (n, 3) in rad/s."""
    rng = np.random.default_rng(seed)
    truth, omega = Rotation.random(SIZE, random_state=seed), 0.02 * rng.normal(size=(SIZE, 3))
    sun = truth.apply([0.0, 0.0, 1.0])
    error = rng.normal(size=(SIZE, 3)) * SUN_SIGMA / np.sqrt(2)
    error += sun * (rng.normal(size=(SIZE, 1)) * TURN_SIGMA - np.sum(error * sun, 1, keepdims=True))
    attitude = Rotation.from_rotvec(error) * truth
    covariance = np.tile(RATE_SIGMA**2 * np.eye(3), (SIZE, 1, 1))
    attrs = {"kind": "rates", "frame_N": frame, "vehicle": "a cube"}
    data = xr.Dataset(
        {
            "B_from_N": (("time", "quaternion"), attitude.as_quat()),
            "omega_B": (("time", "axis"), omega + RATE_SIGMA * rng.normal(size=omega.shape)),
            "omega_cov_B": (("time", "axis", "axis2"), covariance),
            "sun_B": (("time", "axis"), attitude.apply([0.0, 0.0, 1.0])),
            "sun_sigma_rad": ("time", np.full(SIZE, SUN_SIGMA)),
            "pass_of": ("time", np.repeat([0, 1], SIZE // 2)),
            "decided": ("pass_id", np.array([True, True])),
        },
        {"time": np.arange(SIZE) * 10.0, "pass_id": [0, 1]},
        attrs | {"epoch_utc": "2026-01-01T00:00:00Z"},
    )
    if frame == "J2000":
        data = data.assign(turn_sigma_rad=("time", np.full(SIZE, TURN_SIGMA)))
    return data, truth, omega


def readings(result: xr.Dataset, values: np.ndarray, name: str) -> xr.DataArray:
    return xr.DataArray(values, dims=("time", name), coords={"time": result["time"].values})


@pytest.mark.parametrize("text", ["wx,wy,wz:deg/s+-0.1", "wx,wy,wz:rad/s +- 0.0017453293"])
def test_differences_of_rates_over_their_joint_sigma_have_mean_square_one(vehicle, text):
    result, _, omega = drawn_result(3)
    withheld = parse_withheld(text, vehicle)
    noise = np.radians(0.1) * np.random.default_rng(4).normal(size=omega.shape)
    found = compare_with(result, withheld, readings(result, omega + noise, "axis"))
    rms = np.sqrt((found["compared_rate_normalised"] ** 2).mean("time"))
    np.testing.assert_allclose(rms, 1.0, atol=0.12)
    np.testing.assert_allclose(found["compared_rate_difference"], result["omega_B"] - omega - noise)
    entries, lines = compared_summary(found)
    entry = entries["compared"]["rate"]
    assert entry["readings"] == SIZE and "300 readings in decided passes" in lines[0]
    np.testing.assert_allclose(entry["rms_deg_s"], np.hypot(0.08, 0.1), rtol=0.1)


@pytest.mark.parametrize(
    "convention", ["first,N_to_B", "first,B_to_N", "last,N_to_B", "last,B_to_N", "last"]
)
@pytest.mark.parametrize("frame", ["J2000", "sun_z_local"])
def test_differences_of_attitudes_do_not_depend_on_the_convention_of_the_quaternion(
    vehicle, convention, frame
):
    """Without an orbit the reference frame differs from N by a rotation, another one in each pass."""
    result, truth, _ = drawn_result(5, frame)
    withheld = parse_withheld(f"a,b,c,d:{convention}+-1.5", vehicle)
    noise = Rotation.from_rotvec(np.radians(1.5) * np.random.default_rng(6).normal(size=(SIZE, 3)))
    frames = Rotation.identity(2) if frame == "J2000" else Rotation.random(2, random_state=2)
    from_frame = frames[np.repeat([0, 1], SIZE // 2)]
    given = (noise * truth * from_frame).as_quat()
    columns = given * [-1, -1, -1, 1] if "B_to_N" in convention else given
    columns = columns[:, [3, 0, 1, 2]] if "first" in convention else columns
    read = withheld.sensor.interpret(columns).values
    found = compare_with(result, withheld, readings(result, read, "quaternion"))
    ratio = np.sqrt((found["compared_attitude_normalised"] ** 2).mean("time"))
    np.testing.assert_allclose(ratio[0], 1.0, atol=0.1)
    if frame == "J2000":
        np.testing.assert_allclose(ratio[1], 1.0, atol=0.12)
    else:
        assert np.isnan(ratio[1])
    size = np.linalg.norm(found["compared_attitude_difference"], axis=1)
    expected = np.sqrt(SUN_SIGMA**2 + TURN_SIGMA**2 + 3 * np.radians(1.5) ** 2)
    np.testing.assert_allclose(np.sqrt((size**2).mean()), expected, rtol=0.1)
    text = compared_summary(found)[1][0]
    assert ("a constant rotation of each pass is removed" in text) == (frame != "J2000")


def test_a_wrong_convention_shows_as_differences_far_beyond_their_errors(vehicle):
    result, truth, _ = drawn_result(7)
    withheld = parse_withheld("a,b,c,d:last,B_to_N+-1", vehicle)
    read = withheld.sensor.interpret(truth.as_quat()).values
    found = compare_with(result, withheld, readings(result, read, "quaternion"))
    assert np.sqrt((found["compared_attitude_normalised"] ** 2).mean()) > 10


def test_the_error_of_zero_and_scale_of_a_gyro_counts(vehicle):
    result, _, omega = drawn_result(8)
    declared = ss.load_vehicle("skcube").sensors.gyro
    craft = replace(vehicle, sensors=replace(vehicle.sensors, gyro=declared))
    found = compare_with(result, parse_withheld("gyro", craft), readings(result, omega, "axis"))
    sigma = (found["compared_rate_difference"] / found["compared_rate_normalised"]).values
    wanted = (
        RATE_SIGMA**2 + declared.noise_rad_s**2 + (declared.scale_rad_s * declared.zero_sigma) ** 2
    )
    wanted = wanted + (declared.scale_sigma / declared.scale_rad_s * omega) ** 2
    np.testing.assert_allclose(sigma, np.sqrt(wanted))


def test_passes_that_are_not_decided_are_listed_but_do_not_count(vehicle):
    result, _, omega = drawn_result(9)
    result["decided"] = ("pass_id", np.array([True, False]))
    wrong = omega + np.where(result["pass_of"].values[:, None] == 1, 1.0, 0.0)
    read = readings(result, wrong, "axis")
    found = compare_with(result, parse_withheld("x,y,z:rad/s", vehicle), read)
    entry = compared_summary(found)[0]["compared"]["rate"]
    assert entry["readings"] == SIZE // 2 and max(entry["rms_deg_s"]) < 0.2
    (table,) = compared_tables(found)
    assert len(table.frame) == SIZE and (~table.frame["decided"]).sum() == SIZE // 2


def test_a_sensor_whose_readings_are_older_is_compared_at_the_time_of_its_reading(vehicle):
    """A body that spins faster and faster about z: at an earlier time its rate is lower."""
    t = np.arange(SIZE) * 10.0
    angle, rate = 1e-6 * t**2 / 2, 1e-6 * t
    result, _, _ = drawn_result(1)
    quaternion = Rotation.from_rotvec(-angle[:, None] * [0, 0, 1]).as_quat()
    result["B_from_N"] = (("time", "quaternion"), quaternion)
    result["omega_B"] = (("time", "axis"), rate[:, None] * [0, 0, 1])
    result = result.assign_coords(quaternion=list("xyzw"), axis=list("xyz"))
    gyro = ss.load_vehicle("skcube").sensors.gyro
    sensors = replace(vehicle.sensors, gyro=gyro, clock=Clock(late_s=4.0))
    withheld = parse_withheld("gyro", replace(vehicle, sensors=sensors))
    read = readings(result, (rate - 4e-6)[:, None] * [0, 0, 1], "axis")
    found = compare_with(result, withheld, read)["compared_rate_difference"].values
    np.testing.assert_allclose(found[np.isfinite(found).all(axis=1)], 0.0, atol=1e-8)
    # the first sample of each pass has no motion before it
    assert np.isfinite(found).all(axis=1).sum() == SIZE - 2


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("gyro", r"the vehicle file has no \[gyro\]"),
        ("magnetometer", "takes a sensor, or three or four columns"),
        ("a,b", "takes a sensor, or three or four columns"),
        ("a,,c:deg/s", "takes a sensor, or three or four columns"),
        ("a,b,c", "takes a sensor, or three or four columns"),
        ("a,b,c:rpm", "does not say how columns a, b, c are to be read.*add the unit"),
        ("a,b,c:deg/s+-x", "sigma after"),
        ("a,b,c:deg/s+--1", "sigma after"),
        ("a,b,c,d:N_to_B", "add the place of the scalar"),
        ("a,b,c,d:first,sideways", "add the place of the scalar"),
        ("px,b,c:deg/s", "column 'px', which the estimate uses"),
        ("a,a,c:deg/s", "names a column twice"),
    ],
)
def test_a_comparison_that_cannot_be_read_is_refused(vehicle, text, says):
    with pytest.raises(ss.SunspinError, match=says):
        parse_withheld(text, vehicle)


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with files of `init`, cut to 16 samples, with a gyro and a quaternion made from the rates of the file itself."""
    folder = tmp_path_factory.mktemp("compared")
    run = CliRunner()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr("sunspin.output.figures.render", blank)
        assert run.invoke(cli, ["init", "."]).exit_code == 0
        # estimating it takes as long again
        text = Path("vehicle.toml").read_text("utf-8").replace("# acceleration_n", "acceleration_n")
        Path("vehicle.toml").write_text(text, "utf-8")
        data = pd.read_csv("telemetry.csv", comment="#").head(16)
        data.to_csv("telemetry.csv", index=False)
        assert run.invoke(cli, [*RATES, "--out", "alone"]).exit_code == 0
    rates = pd.read_csv(folder / "alone" / "rates.csv", comment="#")
    rng = np.random.default_rng(2)
    for axis in "xyz":
        noise = 0.2 * rng.normal(size=len(data))
        data[f"w{axis}"] = rates[f"omega_{axis}_B_deg_s"] + noise
    quaternion = rates[[f"q_{axis}_B_from_N" for axis in "wxyz"]].to_numpy()
    data[["q0", "q1", "q2", "q3"]] = quaternion
    data.to_csv(folder / "telemetry.csv", index=False)
    gyro = '\n[gyro]\ncolumns = ["wx", "wy", "wz"]\nscale_rad_s = 0.0174533\nzero = [0, 0, 0]\nnoise_rad_s = 0.0035\n'
    (folder / "gyro.toml").write_text(text + gyro, "utf-8")
    return folder


RATES = "rates vehicle.toml telemetry.csv --max-rate-deg-s 5 --effort 0.1 --workers 1".split()
RATES += ["--no-column-tests"]


def test_the_estimate_does_not_use_the_sensor_with_which_it_is_compared(
    place, monkeypatch, undrawn
):
    monkeypatch.chdir(place)
    run, declared = CliRunner(), ["rates", "gyro.toml", *RATES[2:]]
    both = "--compare wx,wy,wz:deg/s+-0.2 --compare q0,q1,q2,q3:first --out columns".split()
    for arguments in ([*declared, "--compare", "gyro", "--out", "withheld"], [*RATES, *both]):
        done = run.invoke(cli, arguments)
        assert done.exit_code == 0, done.output
    files = (place / name / "rates.csv" for name in ("alone", "withheld", "columns"))
    alone, withheld, columns = (pd.read_csv(file, comment="#") for file in files)
    pd.testing.assert_frame_equal(alone, withheld)
    pd.testing.assert_frame_equal(alone, columns)
    table = pd.read_csv(place / "columns" / "compared.csv", comment="#")
    assert len(table) == len(columns)
    assert 0.1 < np.sqrt((table["omega_x_difference_deg_s"] ** 2).mean()) < 0.3
    assert table["rotation_deg"].max() < 0.01  # the quaternion is that of the result itself
    assert "withheld rates (wx, wy, wz): 16 readings" in done.output
    assert "a constant rotation of each pass is removed" in done.output
    page = run.invoke(cli, ["report", "columns"])
    html = (place / "columns" / "report.html").read_text("utf-8")
    assert page.exit_code == 0 and "Sensors that were withheld" in html


def test_missing_columns_and_two_comparisons_of_a_kind_are_refused(place, monkeypatch):
    monkeypatch.chdir(place)
    for compared, says in (
        (["nx,ny,nz:deg/s"], "no columns of the sensor to compare with"),
        (["wx,wy,wz:deg/s", "wx,wy,wz:rad/s"], "given twice"),
        (["attitude"], "the vehicle file has no [attitude]"),
    ):
        options = [part for text in compared for part in ("--compare", text)]
        done = CliRunner().invoke(cli, [*RATES, *options])
        assert isinstance(done.exception, ss.SunspinError) and says in str(done.exception)
    words = ["rates", "gyro.toml", *RATES[2:], "--compare", "wx,wy,wz:deg/s"]
    done = CliRunner().invoke(cli, words)
    assert isinstance(done.exception, InputError)
    assert "which the estimate uses" in str(done.exception)


def test_stored_telemetry_is_not_compared_with_the_sensor_that_it_holds(vehicle, tmp_path):
    """It would be read without its columns, and the result compared with the gyro that the estimate used."""
    stored = tmp_path / "telemetry.nc"
    result, *_ = drawn_result(5, "J2000")
    gyro = readings(result, result["omega_B"].values, "axis").rename("gyro_B")
    gyro.to_dataset().assign_attrs(kind="telemetry").to_netcdf(stored)
    withheld = parse_withheld("wx,wy,wz:deg/s", vehicle)
    with pytest.raises(InputError, match="no columns of the sensor to compare with"):
        read_withheld(withheld, vehicle, stored)


def test_single_reading_of_a_pass_without_an_orbit_gives_no_difference(vehicle):
    result, truth, _ = drawn_result(5, "local")
    read = truth.as_quat()
    read[1 : SIZE // 2] = np.nan
    withheld = parse_withheld("a,b,c,d:last,N_to_B+-1.5", vehicle)
    found = compare_with(result, withheld, readings(result, read, "quaternion"))
    difference = found["compared_attitude_difference"].values
    assert np.isnan(difference[: SIZE // 2]).all() and np.isfinite(difference[SIZE // 2 :]).all()
