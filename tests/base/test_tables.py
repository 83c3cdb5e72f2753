"""Telemetry tables: CSV, Parquet and NetCDF read alike, damaged files are refused in one sentence, Sun sensors."""

import numpy as np
import pandas as pd
import pytest

import sunspin as ss
from sunspin.estimate.model import States
from sunspin.estimate.terms.directions import SunDirections
from sunspin.estimate.terms.term import facing, student
from sunspin.vehicle.file import parse_vehicle

VEHICLE = """
name = "two"
[[panel]]
name = "a"
normal_B = [1, 0, 0]
gain_W = 1
[[panel]]
name = "b"
normal_B = [0, 1, 0]
gain_W = 1
[telemetry]
time_format = "{form}"
time_column = "when"
epoch_utc = "2026-01-01T00:00:00Z"
columns = {{ a = "pa", b = "pb" }}
"""

SENSOR = """
[[sun_sensor]]
name = "{name}"
normal_B = {normal}
x_axis_B = [0, 1, 0]
x_column = "x{name}"
y_column = "y{name}"
light_column = "l{name}"
lit_above = 5
x_scale = 0.0174532925199433
y_scale = 0.0174532925199433
x_sigma_rad = 0.02
y_sigma_rad = 0.02
"""


def frame(when):
    return pd.DataFrame({"when": when, "pa": [0.5, 0.25, 0.125], "pb": [0.1, 0.2, 0.3]})


ELAPSED = [10.0, 20.5, 31.25]
TIMES = {"elapsed": ELAPSED, "unix": [1767225600.0 + t for t in ELAPSED]}
TIMES["utc"] = pd.to_datetime([f"2026-01-01T00:00:{t}" for t in ELAPSED], format="ISO8601")


@pytest.mark.evidence(
    "read_telemetry", "verified", "the same samples as CSV, Parquet and NetCDF, with three clocks"
)
@pytest.mark.parametrize("form", TIMES)
@pytest.mark.parametrize("kind", ["csv", "parquet", "nc"])
def test_the_same_samples_read_alike_from_every_file_format_and_clock(form, kind, tmp_path):
    table, path = frame(TIMES[form]), tmp_path / f"t.{kind}"
    if kind == "csv":
        table.to_csv(path, index=False)
    elif kind == "parquet":
        pytest.importorskip("pyarrow")
        table.to_parquet(path)
    else:
        table.set_index("when").to_xarray().to_netcdf(path, engine="h5netcdf")
    data = ss.read_telemetry(path, parse_vehicle(VEHICLE.format(form=form), "v"))
    assert data["time"].values == pytest.approx([10.0, 20.5, 31.25], abs=1e-6)
    assert data["power_W"].values.tolist() == [[0.5, 0.1], [0.25, 0.2], [0.125, 0.3]]
    assert data.attrs["epoch_utc"] == "2026-01-01T00:00:00Z"


@pytest.mark.parametrize("content", [b"PAR1 cut off", b"\x89HDF\r\n\x1a\n cut off", b"CDF\x01 old"])
def test_damaged_tables_are_refused_in_one_sentence(content, tmp_path):
    path = tmp_path / "t.bin"
    path.write_bytes(content)
    with pytest.raises(ss.TelemetryError, match=r"t\.bin"):
        ss.read_telemetry(path, parse_vehicle(VEHICLE.format(form="elapsed"), "v"))


ELAPSED = VEHICLE.format(form="elapsed")


@pytest.mark.parametrize(
    ("name", "encoding", "read"),
    [
        ("Größe I [µA] bei 20 °C", "cp1252", True),
        ("Température – côté ensoleillé", "cp1252", True),
        ("Größe [°C]", "utf-8", True),
        ("温度", "gbk", False),
        ("Ток панели", "cp1251", False),
        ("T [°C]", "mac-roman", False),
    ],
)
def test_western_windows_text_is_read_and_named_and_no_other_encoding(
    name, encoding, read, tmp_path
):
    path, vehicle = tmp_path / "t.csv", parse_vehicle(ELAPSED, "v")
    path.write_bytes(f"when,pa,pb,{name}\r\n1,0.5,0.1,20\r\n2,0.4,0.2,21\r\n".encode(encoding))
    if not read:
        with pytest.raises(ss.TelemetryError, match=r"line 1: the file is not UTF-8 text; save it"):
            ss.read_telemetry(path, vehicle)
        return
    data = ss.read_telemetry(path, vehicle)
    assert data.attrs["unused_columns"] == name
    assert ("cp1252" in data.attrs.get("clock_notes", "")) == (encoding == "cp1252")


def sensors_vehicle():
    p, m = (SENSOR.format(name=name, normal=[s, 0, 0]) for name, s in (("p", 1), ("m", -1)))
    return parse_vehicle(ELAPSED + p + m, "v")


def sensor_file(path, rows):
    header = "when,xp,yp,lp,xm,ym,lm\n"
    path.write_text(header + "".join(",".join(map(str, row)) + "\n" for row in rows))
    return path


def test_a_sun_sensor_measures_angles_from_its_normal(tmp_path):
    """Two that contradict each other give no direction."""
    rows = [
        (0, 30, 0, 50, 0, 0, 0),
        (1, 0, 45, 50, 0, 0, 0),
        (2, *[0] * 6),
        (3, 0, 0, 50, 0, 0, 50),
    ]
    data = ss.read_telemetry(sensor_file(tmp_path / "s.csv", rows), sensors_vehicle())
    sun = data["sun_sensor_B"].values
    assert sun[0] == pytest.approx([np.cos(np.pi / 6), 0.5, 0.0], abs=1e-9)
    # y axis: x cross y = z
    assert sun[1] == pytest.approx([np.sqrt(0.5), 0.0, np.sqrt(0.5)], abs=1e-9)
    assert np.isnan(sun[2:]).all()
    assert "power_W" not in data


TURNED = "y_turned_above = 45\ny_turned_scale = -0.0174532925199433\ny_turned_sigma = 2\n"


def test_a_sun_sensor_near_its_switching_intensity_keeps_both_readings(tmp_path):
    vehicle = parse_vehicle(ELAPSED + SENSOR.format(name="p", normal=[1, 0, 0]) + TURNED, "v")
    rows = [(k, 0, 30, light, 0, 0, 0) for k, light in enumerate((30, 43, 47, 60, 0))]
    path = sensor_file(tmp_path / "s.csv", rows)
    data = ss.read_telemetry(path, vehicle)
    up, down = [np.cos(np.pi / 6), 0.0, 0.5], [np.cos(np.pi / 6), 0.0, -0.5]
    expected = [up, up, down, down, [np.nan] * 3]
    np.testing.assert_allclose(data["sun_sensor_B"].values, expected, atol=1e-9)
    other = data["sun_sensor_other_B"].values
    np.testing.assert_allclose(other[1:3], [down, up], atol=1e-9)
    assert np.isnan(other[[0, 3, 4]]).all()
    assert np.isnan(data["sun_sensor_other_cov_B"].values[0]).all()
    sun, _ = SunDirections.read(data, "sun_sensor")
    seen = States(facing(np.tile(down, (1, 5, 1))), np.zeros((1, 5, 3)))
    (residual,) = sun.residuals(seen, np.zeros((1, 0)))
    cost = student(residual.value)[0][0]
    # the better of the two counts
    assert cost[0] > 5 and cost[1:] == pytest.approx(np.zeros(4), abs=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("x_axis_B = [0, 1, 0]", "x_axis_B = [1, 0, 0]", "right angles"),
        ("x_sigma_rad = 0.02", "x_sigma_rad = 0", "must be positive"),
        ('y_column = "yp"\n', "", "both y_column and y_scale"),
        ("y_sigma_rad = 0.02", "y_sigma_rad = 0.02\ny_turned_sigma = 3", "no y_turned_above"),
        ("y_sigma_rad = 0.02", "y_sigma_rad = 0.02\nlit = 3", "unknown key"),
    ],
)
def test_a_wrong_sensor_table_is_refused_in_one_sentence(old, new, text):
    sensor = SENSOR.format(name="p", normal=[1, 0, 0]).replace(old, new)
    with pytest.raises(ss.VehicleError, match=text):
        parse_vehicle(ELAPSED + sensor, "v")
