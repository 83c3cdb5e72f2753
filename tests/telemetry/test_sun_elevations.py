"""Columns with the elevation of the Sun above each panel, or its sine: read as signals of flat panels."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import sunspin as ss
from sunspin.base.errors import TelemetryError, VehicleError
from sunspin.cli import cli
from sunspin.telemetry.sun import sun_directions
from sunspin.vehicle.file import parse_vehicle
from tests.support.vehicles import CUBE_NORMALS, directions

VEHICLE = """
name = "a cube"
[telemetry]
quantity = "elevation_deg"
time_column = "t"
time_format = "elapsed"
epoch_utc = "2026-01-01T00:00:00Z"
noise = 1.0
""" + "".join(
    f'[[panel]]\nname = "p{k}"\nnormal_B = {normal.tolist()}\nrelative_gain = {1 + k}\n'
    for k, normal in enumerate(CUBE_NORMALS)
)
SUNS = directions(40, 1)
COSINES = SUNS @ CUBE_NORMALS.T
ELEVATIONS = np.degrees(np.arcsin(COSINES))


def write(path: Path, values: np.ndarray) -> Path:
    """Write a telemetry file with these values (n, 6) in the columns of the panels."""
    lines = ["t," + ",".join(f"p{k}" for k in range(6))]
    lines += [",".join(f"{x:.10g}" for x in (10.0 * k, *row)) for k, row in enumerate(values)]
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path


@pytest.mark.parametrize(
    ("keys", "values"),
    [
        ('quantity = "elevation_deg"', ELEVATIONS),
        ('quantity = "elevation_deg"\nscale = 57.29577951', np.radians(ELEVATIONS)),
        ('quantity = "elevation_deg"\nzero = -90', ELEVATIONS - 90.0),
        ('quantity = "incidence_deg"', 90.0 - ELEVATIONS),
        ('quantity = "incidence_deg"\nscale = 57.29577951', np.radians(90.0 - ELEVATIONS)),
        ('quantity = "cosine"', COSINES),
        ('quantity = "cosine"\nscale = 0.01', 100 * np.maximum(COSINES, 0)),
    ],
)
def test_angles_become_the_readings_of_flat_panels(tmp_path, keys, values):
    """Gain times sine of the elevation where the Sun is above the panel, zero where it is below."""
    vehicle = parse_vehicle(VEHICLE.replace('quantity = "elevation_deg"', keys), "test")
    data = ss.read_telemetry(write(tmp_path / "angles.csv", values), vehicle)
    np.testing.assert_allclose(data["power_W"], ss.panel_power(vehicle, SUNS), atol=1e-6)
    assert data["power_W"].attrs["units"] == "1"
    assert data.attrs["quantity"] == vehicle.telemetry.quantity
    assert (data["flag"] == 0).all()


def test_sun_directions_from_noisy_elevations_are_as_good_as_their_errors_say(tmp_path):
    """The sine has noise, as for angles that were computed from currents."""
    vehicle, rng = parse_vehicle(VEHICLE, "test"), np.random.default_rng(2)
    sun = directions(400, 1)
    sine = np.clip(sun @ CUBE_NORMALS.T, 0, 1) + np.radians(1.0) * rng.normal(size=(400, 6))
    angles = np.degrees(np.arcsin(np.clip(sine, 0, 1)))
    found = sun_directions(vehicle, ss.read_telemetry(write(tmp_path / "n.csv", angles), vehicle))
    known = np.isfinite(found["sun_B"]).all("axis").values
    off = np.linalg.norm(found["sun_B"].values[known] - sun[known], axis=1)
    assert known.mean() > 0.75 and np.degrees(np.median(off)) < 2.0
    ratio = np.sqrt(np.mean((off / found["sigma_rad"].values[known]) ** 2))
    assert 0.7 < ratio < 1.3


def test_the_noise_of_elevations_is_that_of_the_readings_in_rad_times_gain():
    """Keys of electrical readings do not go with angles."""
    vehicle = parse_vehicle(VEHICLE, "test")
    np.testing.assert_allclose(vehicle.input_noise, np.radians(1.0) * np.arange(1, 7))
    text = VEHICLE.replace('"elevation_deg"', '"cosine"').replace("noise = 1.0", "noise = 0.02")
    cosines = parse_vehicle(text, "test")
    np.testing.assert_allclose(cosines.input_noise, 0.02 * np.arange(1, 7))
    where = "noise = 1.0\n"
    for key in ("throttled = true", "lit_threshold = 0.1", 'voltage_column = "u"'):
        says = f"telemetry.{key.partition(' ')[0]} is for powers and currents"
        with pytest.raises(VehicleError, match=says):
            parse_vehicle(VEHICLE.replace(where, f"{where}{key}\n"), "test")
    channel = '[[channel]]\nname = "x"\npanels = ["p0", "p3"]\nreads = "sum"'
    with pytest.raises(VehicleError, match="a channel reads powers or currents"):
        parse_vehicle(VEHICLE + channel, "test")


@pytest.mark.parametrize(
    ("keys", "value", "says"),
    [
        ("", 150.0, r"an elevation \(deg\) lies between -90 and 90"),
        ('quantity = "cosine"', 55.0, "a cosine lies between -1 and 1"),
        ("", "dark", "a finite number is expected"),
    ],
)
def test_a_value_that_is_no_angle_is_refused_with_its_place(tmp_path, keys, value, says):
    text = VEHICLE.replace('quantity = "elevation_deg"', keys) if keys else VEHICLE
    path = write(tmp_path / "angles.csv", COSINES if keys else ELEVATIONS)
    lines = path.read_text("utf-8").splitlines()
    lines[3] = re.sub(r"[^,]+$", str(value), lines[3])
    path.write_text("\n".join(lines), "utf-8")
    with pytest.raises(TelemetryError, match=says) as refused:
        ss.read_telemetry(path, parse_vehicle(text, "test"))
    assert "line 4" in str(refused.value) and "p5" in str(refused.value)
    flagging = parse_vehicle(text.replace("noise =", 'bad_rows = "flag"\nnoise ='), "test")
    data = ss.read_telemetry(path, flagging)
    assert np.isnan(data["power_W"].values[2, 5]) and np.isfinite(data["power_W"].values[3]).all()


def test_elevations_in_radians_are_refused_with_the_scale_that_helps(tmp_path):
    path = write(tmp_path / "angles.csv", np.radians(ELEVATIONS))
    with pytest.raises(TelemetryError, match=r"do not look like degrees.*scale = 57\.29578"):
        ss.read_telemetry(path, parse_vehicle(VEHICLE, "test"))


def test_check_says_how_angles_are_read_and_stored_telemetry_is_not_converted_again(
    tmp_path, undrawn, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    Path("cube.toml").write_text(VEHICLE, "utf-8")
    write(tmp_path / "angles.csv", ELEVATIONS)
    run = CliRunner()
    done = run.invoke(cli, ["check", "cube.toml", "angles.csv"])
    assert done.exit_code == 0
    assert "elevations of the Sun (deg) are read as signals of flat panels" in done.output
    assert run.invoke(cli, ["sun", "cube.toml", "angles.csv", "--out", "sun"]).exit_code == 0
    vehicle = ss.load_vehicle("cube.toml")
    again = ss.read_telemetry("sun/telemetry.nc", vehicle)
    np.testing.assert_allclose(again["power_W"], ss.panel_power(vehicle, SUNS), atol=1e-6)
    assert "flat panels" not in run.invoke(cli, ["check", "cube.toml"]).output
