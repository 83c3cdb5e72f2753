"""A wrong unit in the vehicle file is named with the key to change; right files get no warning."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

import sunspin as ss
from sunspin.estimate.column_tests import signed_axes
from sunspin.estimate.gyro_axes import wrong_gyro_axes
from sunspin.telemetry.assess import assess, panel_quality
from sunspin.telemetry.sun import sun_directions
from sunspin.telemetry.units import panel_unit
from sunspin.vehicle.file import find_line, parse_vehicle
from sunspin.vehicle.response.panels import panel_power
from tests.support import satellite_files

MAKERS = (satellite_files.six_faces, satellite_files.four_faces, satellite_files.wheeled)


def changed(text: str, table: str, key: str, factor: float) -> str:
    """The vehicle file with one number times a factor."""
    stands = find_line(text, table, key)
    assert stands is not None and stands[1].startswith(key)
    lines = text.splitlines()
    lines[stands[0] - 1] = re.sub(
        r"\d[\d.e+-]*", lambda m: repr(float(m[0]) * factor), lines[stands[0] - 1], count=1
    )
    return "\n".join(lines)


def judged(text: str, telemetry) -> list:
    vehicle = parse_vehicle(text, "v.toml")
    return assess(vehicle, ss.read_telemetry(telemetry, vehicle)).wrong_units


@pytest.mark.parametrize("rows", [8, 20])
@pytest.mark.parametrize("make", MAKERS)
def test_at_most_one_of_a_hundred_small_files_in_shadow_is_called_a_wrong_unit(
    make, rows, tmp_path
):
    """Whatever their size, cut off at zero or not, with noise alike for all panels or with their gains."""
    made, rng = make(tmp_path, np.random.default_rng(1)), np.random.default_rng(rows)
    vehicle = parse_vehicle(made.vehicle.read_text(), "v.toml")
    gains, accused = vehicle.input_gains, 0
    for k in range(100):
        noise = 0.003 * (gains if k % 2 else gains.max()) * rng.normal(size=(rows, len(gains)))
        readings = np.clip(noise, 0.0, None) if k % 4 < 2 else noise
        accused += panel_unit(vehicle, readings) is not None
    assert accused <= 1


@pytest.mark.parametrize("make", MAKERS)
def test_twenty_rows_of_sunlight_are_enough_to_name_a_wrong_unit(make, tmp_path):
    made, rng = make(tmp_path, np.random.default_rng(1)), np.random.default_rng(5)
    vehicle = parse_vehicle(made.vehicle.read_text(), "v.toml")
    named = 0
    for _ in range(20):
        sun = rng.normal(size=(20, 3))
        power = panel_power(vehicle, sun / np.linalg.norm(sun, axis=1, keepdims=True))
        power += 0.01 * vehicle.input_gains * rng.normal(size=power.shape)
        named += panel_unit(vehicle, 1e-3 * np.clip(power, 0.0, None)) is not None
    # of two lit panels every other order fits
    assert named >= (14 if make is satellite_files.four_faces else 19)


def with_scale(text: str) -> str:
    has = find_line(text, "telemetry", "scale")[1].startswith("scale")
    return text if has else text.replace("[telemetry]", "[telemetry]\nscale = 1.0")


@pytest.mark.parametrize("make", MAKERS)
def test_readings_off_by_a_factor_of_a_thousand_are_named(make, tmp_path):
    """Instead of `no panel lit`; a file in the right unit gets no warning."""
    made = make(tmp_path, np.random.default_rng(1))
    assert judged(made.vehicle.read_text(), made.telemetry) == []
    text = with_scale(made.vehicle.read_text())
    right = parse_vehicle(text, "v.toml").telemetry.scale
    for factor in (1e3, 1e-3):
        wrong = changed(text, "telemetry", "scale", factor)
        vehicle = parse_vehicle(wrong, "v.toml")
        samples = ss.read_telemetry(made.telemetry, vehicle)
        (found,) = assess(vehicle, samples).wrong_units
        assert (found.table, found.key) == ("telemetry", "scale")
        assert found.value == pytest.approx(right)
        assert "1000 times" in str(found) and "scale" in str(found)
        texts = {str(text) for text in panel_quality(vehicle, samples)["why"].values}
        assert any("1000 times" in text for text in texts)
        assert "dropped: no panel lit" not in texts
        assert "no panel lit" not in sun_directions(vehicle, samples)["status_text"].values
        if make is satellite_files.six_faces and factor < 1:
            with pytest.raises(ss.InputError, match="1000 times less.*set scale = 1 under"):
                ss.rates(vehicle, samples)


@pytest.mark.parametrize("key", ["scale", "voltage_scale"])
def test_a_wrong_unit_of_currents_or_of_voltages_is_named(tmp_path, key):
    """The product tells that one is, and not which: no value is put into anybody's mouth."""
    made = satellite_files.six_faces(tmp_path, np.random.default_rng(1))
    lines = [line for line in made.telemetry.read_text().splitlines() if not line.startswith("#")]
    path = tmp_path / "volts.csv"
    path.write_text("\n".join([f"{lines[0]},bus", *(f"{line},1.0" for line in lines[1:])]))
    text = with_scale(made.vehicle.read_text()).replace(
        "[telemetry]", '[telemetry]\nvoltage_column = "bus"\nvoltage_scale = 1.0'
    )
    assert judged(text, path) == []
    for factor in (1e3, 1e-3):
        (found,) = judged(changed(text, "telemetry", key, factor), path)
        assert (found.key, found.value) == ("scale or voltage_scale", None)
        assert "check scale or voltage_scale" in str(found)


@pytest.mark.parametrize("seed", range(2))
def test_a_gyro_in_degrees_or_radians_and_wrong_axes_of_a_gyro_are_named(tmp_path, seed):
    """As stated they are believed; in another order or with other signs they are named so that it turns the Sun as seen."""
    made = satellite_files.wheeled(tmp_path, np.random.default_rng(seed), form="csv")
    text = made.vehicle.read_text()
    vehicle = parse_vehicle(text, "v.toml")
    for factor in (180 / np.pi, np.pi / 180):
        (found,) = judged(changed(text, "gyro", "scale_rad_s", factor), made.telemetry)
        assert (found.table, found.key) == ("gyro", "scale_rad_s")
        assert found.value == pytest.approx(vehicle.sensors.gyro.scale_rad_s, rel=1e-3)
    samples = ss.read_telemetry(made.telemetry, vehicle)
    assert wrong_gyro_axes(assess(vehicle, samples)) is None
    rate, named, ways = samples["gyro_B"].values, 0, list(signed_axes())[1::5]
    for what, order, sign in ways:
        read = np.empty_like(rate)
        read[:, order] = rate * sign  # what the columns hold, if they are to be read so
        found = wrong_gyro_axes(assess(vehicle, samples.assign(gyro_B=(("time", "axis"), read))))
        columns = vehicle.sensors.gyro.keys_for_axes(order, sign)["columns"]
        words = f"the gyro {what} agrees", f"set columns = {json.dumps(columns)}"
        assert found is None or all(word in found for word in words)
        named += found is not None
    assert named >= len(ways) / 2  # the others carry the Sun nearly as well


@pytest.mark.parametrize("factor", [60 / (2 * np.pi), 2 * np.pi / 60])
def test_a_wheel_speed_in_revolutions_is_named(tmp_path, factor):
    made = satellite_files.wheeled(tmp_path, np.random.default_rng(3), form="csv")
    text = changed(made.vehicle.read_text(), "wheel", "speed_scale_rad_s", factor)
    (found,) = judged(text, made.telemetry)
    assert found.key == "speed_scale_rad_s" and found.value == pytest.approx(0.104719755, rel=1e-6)


MAGNETOMETER = """
name = "v"
[magnetometer]
columns = ["bx", "by", "bz"]
zero = {zero}
noise = {noise}
[disturbance]
dipole = {dipole}
[[sun_sensor]]
name = "s"
normal_B = [1, 0, 0]
x_axis_B = [0, 1, 0]
x_column = "sx"
x_scale = 1.0
x_sigma_rad = 0.02
y_sigma_rad = 0.5
"""
IN_TESLA = {"zero": np.array([2e-6, -1e-6, 3e-6]), "noise": 3e-7}
IN_TESLA["dipole"] = np.array([0.3, 0.1, -0.2])


@pytest.mark.parametrize("unit", [1.0, 1e9])
@pytest.mark.parametrize(
    ("key", "at_fault"),
    [("zero", 1e3), ("noise", 1e6), ("noise", 1e-9), ("zero", 1e9), ("dipole", 1e6)],
)
def test_a_wrong_unit_of_a_magnetometer_is_named(tmp_path, unit, key, at_fault):
    """The columns may be in any unit, but zero, noise and dipole are in the same one (the dipole per unit)."""
    rng = np.random.default_rng(5)
    field = rng.normal(size=(60, 3))
    field = 4e-5 * field / np.linalg.norm(field, axis=1, keepdims=True) + IN_TESLA["zero"]
    rows = [
        f"2026-01-01T00:00:{i:02d}Z,0.1," + ",".join(repr(float(b)) for b in unit * field[i])
        for i in range(60)
    ]
    path = tmp_path / "field.csv"
    path.write_text("time,sx,bx,by,bz\n" + "\n".join(rows))
    right = {key: value * unit for key, value in IN_TESLA.items()}
    right["dipole"] = IN_TESLA["dipole"] / unit

    def judge(values):
        told = {name: np.asarray(value).tolist() for name, value in values.items()}
        return judged(MAGNETOMETER.format(**told), path)

    assert judge(right) == []
    assert [found.key for found in judge(right | {key: right[key] * at_fault})] == [key]


@pytest.mark.parametrize("reach_deg", [40.0, 90.0])
def test_a_sun_sensor_in_degrees_is_named(tmp_path, reach_deg):
    """Also of a sensor that reads something while the Sun stands behind it."""
    wrong = MAGNETOMETER.format(zero=[0, 0, 0], noise=1, dipole=[0, 0, 0])
    path = tmp_path / "sun.csv"
    for seed in range(10):
        sun = np.random.default_rng(seed).normal(size=(60, 3))
        across = np.abs(sun[:, 0]) if reach_deg < 90 else sun[:, 0]
        angle = np.degrees(np.arctan2(sun[:, 1], across)) * reach_deg / 90
        rows = [f"2026-01-01T00:00:{i:02d}Z,{angle[i]:.3f}" for i in range(60)]
        path.write_text("\n".join(["time,sx", *rows]))
        assert judged(wrong.replace("x_scale = 1.0", f"x_scale = {np.pi / 180}"), path) == []
        (found,) = judged(wrong, path)
        assert found.key == "x_scale" and found.value == pytest.approx(np.pi / 180)
        assert "degrees read as radians" in str(found)


def test_the_line_to_change_is_found_for_a_key():
    text = 'name = "v"\n[telemetry]\n# scale = 3\nscale = 2 # x\n[telemetry.columns]\nscale = "b"\n[[wheel]]\nname = "w"\n'
    assert find_line(text, "telemetry", "scale") == (4, "scale = 2 # x")
    assert find_line(text, "telemetry", "noise") == (2, "[telemetry]")
    assert find_line(text, "[wheel]", "name") == (8, 'name = "w"')
    assert find_line(text, "gyro", "zero") is None
