"""Columns by name: misspelt, missing and unused ones, currents with voltages."""

from __future__ import annotations

import numpy as np
import pytest

import sunspin as ss
from sunspin.vehicle.file import parse_vehicle
from tests.support import satellite_files

BASE = """
name = "v"
[[panel]]
name = "+X"
normal_B = [1, 0, 0]
gain_W = 8.0
[[panel]]
name = "-X"
normal_B = [-1, 0, 0]
gain_W = 8.0
[telemetry]
{telemetry}
[telemetry.columns]
"+X" = "i_px"
"-X" = "i_mx"
{tables}
"""
ROWS = (("0", "1.0", "0.5", "4.0", "3.0"), ("1", "0.25", "0", "8.0", "4.0"))


def file_with(path, header: str, rows=ROWS):
    lines = [
        ",".join((f"2026-01-01T00:00:0{row[0]}Z", *row[1 : header.count(",") + 1])) for row in rows
    ]
    path.write_text(header + "\n" + "\n".join(lines) + "\n")
    return path


def read(text: str, path):
    vehicle = parse_vehicle(text, "v.toml")
    return ss.read_telemetry(path, vehicle)


def test_a_missing_column_of_a_sensor_is_reported_with_the_nearest_name(tmp_path):
    made = satellite_files.wheeled(tmp_path, np.random.default_rng(1), n=6, form="csv")
    for name, other, whose in (
        *(("mw_rpm", "MW-rpm", "wheel MW"), ("I_px", "I_pxx", "")),
        *((name, f"{name}1", "gyro") for name in ("gx", "gy", "gz")),
    ):
        wrong = tmp_path / "wrong.csv"
        wrong.write_text(made.telemetry.read_text().replace(f",{name}", f",{other}", 1))
        with pytest.raises(ss.TelemetryError, match=f"'{name}'.*did you mean '{other}'") as told:
            read(made.vehicle.read_text(), wrong)
        assert whose in str(told.value)


def test_a_sensor_without_any_column_in_the_file_is_listed_and_no_error(tmp_path):
    """Columns that nothing uses are listed too."""
    made = satellite_files.wheeled(tmp_path, np.random.default_rng(1), n=6, form="csv")
    rows = [line.split(",") for line in made.telemetry.read_text().splitlines()]
    bare = tmp_path / "bare.csv"
    bare.write_text("\n".join(",".join(row[:7]) for row in rows) + "\n")
    attrs = read(made.vehicle.read_text(), bare).attrs
    assert attrs["missing_sensors"] == "gyro (gx, gy, gz); speed of wheel MW (mw_rpm)"
    assert attrs["unused_columns"] == ""
    path = file_with(tmp_path / "t.csv", "time,i_px,i_mx,battery,phase")
    assert read(BASE.format(telemetry="", tables=""), path).attrs["unused_columns"] == "battery"


@pytest.mark.parametrize(
    ("telemetry", "tables", "volts"),
    [
        ('voltage_column = "u"', "", [[4.0, 4.0], [8.0, 8.0]]),
        ('voltage_column = "u"\nvoltage_scale = 0.5', "", [[2.0, 2.0], [4.0, 4.0]]),
        ("", '[telemetry.voltage_columns]\n"+X" = "u"\n"-X" = "w"', [[4.0, 3.0], [8.0, 4.0]]),
        ('voltage_column = "w"', '[telemetry.voltage_columns]\n"+X" = "u"', [[4, 3], [8, 4]]),
        ('voltage_column = "u"\nscale = 0.001\nzero = -1', "", [[4.0, 4.0], [8.0, 8.0]]),
    ],
)
def test_power_is_current_times_voltage(tmp_path, telemetry, tables, volts):
    path = file_with(tmp_path / "t.csv", "time,i_px,i_mx,u,w")
    samples = read(BASE.format(telemetry=telemetry, tables=tables), path)
    current = np.array([[1.0, 0.5], [0.25, 0.0]])
    current = 0.001 * (current + 1) if "zero" in telemetry else current
    np.testing.assert_allclose(samples["power_W"].values, current * volts, rtol=1e-14)
    assert samples["power_W"].attrs["units"] == "W"
    assert samples.attrs["unused_columns"] == ("" if tables else "w")


def test_a_missing_voltage_is_refused_or_flagged_and_a_missing_column_of_it_named(tmp_path):
    text = BASE.format(telemetry='voltage_column = "u"', tables="")
    rows = [("0", "1", "0.5", ""), ("1", "1", "0.5", "4")]
    path = file_with(tmp_path / "t.csv", "time,i_px,i_mx,u", rows)
    with pytest.raises(ss.TelemetryError, match="line 2, column 'u': a voltage is a number"):
        read(text, path)
    flagged = read(text.replace("[telemetry]", '[telemetry]\nbad_rows = "flag"'), path)
    assert flagged["flag"].values.tolist() == [1, 0]
    assert np.isnan(flagged["power_W"].values[0]).all()
    path = file_with(tmp_path / "t.csv", "time,i_px,i_mx,bus_v")
    said = "'bus_V' .voltage of panel .X.*did you mean 'bus_v'"
    with pytest.raises(ss.TelemetryError, match=said):
        read(BASE.format(telemetry='voltage_column = "bus_V"', tables=""), path)


@pytest.mark.parametrize(
    ("telemetry", "tables", "said"),
    [
        ('voltage_column = "u"\nquantity = "current_A"', "", "quantity is current_A"),
        ("", '[telemetry.voltage_columns]\n"+X" = "u"', "a panel has no voltage.*-X"),
        ("", '[telemetry.voltage_columns]\n"+Y" = "u"', "voltage_columns names a panel.*\\+Y"),
        ('voltage_column = "u"\nvoltage_scale = 0', "", "voltage_scale must be positive"),
    ],
)
def test_wrong_voltage_columns_in_the_vehicle_file_are_refused(telemetry, tables, said):
    with pytest.raises(ss.VehicleError, match=said):
        parse_vehicle(BASE.format(telemetry=telemetry, tables=tables), "v.toml")
