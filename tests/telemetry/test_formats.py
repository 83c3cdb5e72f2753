"""Telemetry formats: JSON, Sun vectors, two clocks, frames received by several stations, panels read in turn."""

import csv
import io
import json
import tomllib
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
import tomlkit
import xarray as xr

import sunspin as ss
from sunspin.estimate.column_tests import advice_to_set, signed_axes
from sunspin.estimate.terms.panels import ReadingTimes
from sunspin.output.folder import write_netcdf
from sunspin.telemetry.stored import restore_telemetry
from sunspin.vehicle.file import parse_vehicle

TEMPLATE = resources.files("sunspin").joinpath("template")
VEHICLE = """
name = "two panels"
[[panel]]
name = "a"
normal_B = [1, 0, 0]
gain_W = 2
[[panel]]
name = "b"
normal_B = [0, 1, 0]
gain_W = 2
[sun_vector]
columns = ["sx", "sy", "sz"]
sigma_rad = 0.02
[telemetry]
bad_rows = "flag"
{telemetry}
[telemetry.columns]
a = "pa"
b = "pb"
"""


def craft(telemetry='time_column = "t"'):
    return parse_vehicle(VEHICLE.format(telemetry=telemetry), "test")


def read(folder, text, vehicle):
    path = folder / "telemetry"
    path.write_text(text, "utf-8")
    return ss.read_telemetry(path, vehicle)


@pytest.mark.parametrize("form", ["lines", "list", "page", "decoded"])
def test_a_json_file_reads_as_the_csv(form, tmp_path):
    text = TEMPLATE.joinpath("telemetry.csv").read_text("utf-8")
    vehicle = parse_vehicle(TEMPLATE.joinpath("vehicle.toml").read_text("utf-8"), "template")
    expected = read(tmp_path, text, vehicle)
    rows = [
        {key: value if key == "time_utc" else float(value) for key, value in row.items()}
        for row in csv.DictReader(line for line in io.StringIO(text) if not line.startswith("#"))
    ]
    if form == "decoded":  # as SatNOGS has it: the fields as a text beside the frame
        rows = [
            {"timestamp": row.pop("time_utc"), "frame": "00FF", "decoded": json.dumps(row)}
            for row in rows
        ]
        columns = {panel: f"decoded.{name}" for panel, name in vehicle.telemetry.columns.items()}
        decoded = replace(vehicle.telemetry, time_column="timestamp", columns=columns)
        vehicle = replace(vehicle, telemetry=decoded)
    dumped = {
        "lines": "\n".join(map(json.dumps, rows)),
        "list": json.dumps(rows, indent=1),
        "page": json.dumps({"next": None, "results": rows}),
        "decoded": "\n".join(map(json.dumps, rows)),
    }[form]
    found = read(tmp_path, dumped, vehicle)
    np.testing.assert_array_equal(found["power_W"], expected["power_W"])
    np.testing.assert_array_equal(found["time"], expected["time"])
    assert found.attrs["epoch_utc"] == expected.attrs["epoch_utc"]


ROW = '{"t": "2026-01-01T00:00:00Z", "pa": 1, "pb": 0}'
UNDATED = ROW.replace("2026-01-01T00:00:00Z", "noon")
HOSTILE = {
    "cut off": (ROW + '\n{"t": "2026-01-0', "line 2"),
    "no object": (ROW + "\n[1, 2]", "must be an object"),
    "a key twice": ('{"t": 1, "t": 2}', "twice"),
    "nested for ever": ('{"t": ' * 5000 + "1" + "}" * 5000, "nested|deep"),
    "deep": ('{"t": ' * 12 + "1" + "}" * 12, "deep"),
    "a number of ten thousand digits": ('{"t": ' + "9" * 10000 + "}", "not valid JSON"),
    "nothing in it": ("[]", "no samples"),
    "no columns": ("{}", "no samples"),
    "a number": ("[1]", "row 1: a row of a JSON file must be an object"),
    "no date in a list": (f"[\n{ROW},\n{UNDATED}\n]", "row 2, column 't': an ISO-8601"),
    "no date in the second of two pages": (
        f'{{"results": [{ROW}, {ROW}]}}\n{{"results": [{UNDATED}]}}',
        "row 3, column 't': an ISO-8601",
    ),
    "no such column": ('{"t": "2026-01-01T00:00:00Z", "p": 1}', "column 'pa'"),
    "raw frames": ('[{"timestamp": "2026-01-01T00:00:00Z", "frame": "00FF"}]', "raw frames"),
    "raw frames, exported": ("2026-01-01 00:00:00|00FF\n", "raw frames"),
    "many columns": (json.dumps({f"c{k}": 1 for k in range(10_001)}), "more than 10000 columns"),
}


@pytest.mark.parametrize(("text", "told"), HOSTILE.values(), ids=HOSTILE)
def test_json_that_is_no_telemetry_is_refused_in_one_sentence(text, told, tmp_path):
    with pytest.raises(ss.TelemetryError, match=told) as error:
        read(tmp_path, text, craft())
    assert "\n" not in str(error.value) and len(str(error.value)) < 1000


def test_json_values_that_are_no_numbers_are_flagged(tmp_path):
    rows = [
        ROW,
        ROW.replace("00Z", "10Z").replace("1,", "NaN,"),
        ROW.replace("00Z", "20Z").replace('"pa": 1', '"pa": null'),
    ]
    assert read(tmp_path, "\n".join(rows), craft())["flag"].values.tolist() == [0, 1, 1]


def test_sun_vectors_of_any_length_are_directions_except_short_ones(tmp_path):
    vectors = ["0,300,400", "0,0,0", "30,0,0", "-500,0,0", "a,1,1"]
    rows = [f"2026-01-01T00:00:0{k}Z,{vector}" for k, vector in enumerate(vectors)]
    found = read(tmp_path, "\n".join(["t,sx,sy,sz", *rows]), craft())
    none = 3 * [np.nan]
    expected = [[0, 0.6, 0.8], none, none, [-1, 0, 0], none]
    np.testing.assert_allclose(found["sun_sensor_B"], expected, atol=1e-12)
    across = found["sun_sensor_cov_B"].values[3]
    np.testing.assert_allclose(np.sqrt(np.diag(across)), [0.02, 0.02, 0.02], rtol=1e-9)


def test_rates_are_estimated_from_sun_vectors(tmp_path):
    t, omega = 5.0 * np.arange(20), np.array([0.02, -0.01, 0.03])
    ball = ss.Vehicle("sphere", inertia_kg_m2=np.eye(3))
    sun = ss.propagate(ball, omega, [0.6, 0.0, 0.8], None, t)["sun_B"].values
    sun = sun + 0.01 * np.random.default_rng(1).normal(size=sun.shape)
    rows = [",".join(map(str, row)) for row in np.column_stack([t, sun]).tolist()]
    vehicle = craft('time_column = "t"\ntime_format = "unix"')
    data = read(tmp_path, "\n".join(["t,sx,sy,sz", *rows]), vehicle)
    result = ss.rates(vehicle, data, max_rate_rad_s=0.1, acceleration_noise=1e-6)
    assert result.attrs["source"] == "sun_sensor" and result["unique"].item()
    off = np.abs(result["omega_mean_B"].values[0, 0] - omega)
    assert np.all(off < 4 * result["omega_sigma_B"].values[0, 0])


def test_a_frame_received_by_two_stations_is_one_row_with_both_clocks(tmp_path):
    """Without any received time the epoch is asked for."""
    form = 'time_column = "up"\ntime_format = "elapsed"\nreceive_time_column = "rx"'
    rows = [
        "500,2026-01-01T00:00:10,A,1,0",
        "500,2026-01-01T00:00:11,B,1,",
        "490,2026-01-01T00:00:00,B,0.5,1",
        "510,,A,0,1",
    ]
    text = "\n".join(["up,rx,station,pa,pb", *rows])
    found = read(tmp_path, text, craft(form))
    assert found.attrs["rows_merged"] == 1 and found.attrs["rows_sorted"] == 1
    assert found.attrs["epoch_utc"] == "2025-12-31T23:51:50Z"
    assert found["time"].values.tolist() == [490, 500, 510]
    assert found["power_W"].values[1].tolist() == [1, 0]
    np.testing.assert_array_equal(found["received_s"], [490, 500, np.nan])
    renamed = text.replace("rx", "received at"), "column 'rx'"
    for wrong, words in (renamed, ("up,rx,pa,pb\n1,,1,0\n", "epoch_utc")):
        with pytest.raises(ss.TelemetryError, match=words):
            read(tmp_path, wrong, craft(form))


def test_panels_can_be_read_in_turn_or_averaged():
    offsets = ReadingTimes(np.array([0.0, 2.0, 0.0]), 3.0)
    shifts = list(offsets.shifts())
    np.testing.assert_allclose(sum(weight for _, weight in shifts), 1.0, rtol=1e-12)
    mean = sum(np.exp(0.3 * shift) * weight for shift, weight in shifts)
    exact = np.exp(0.3 * offsets.offset_s) * np.sinh(0.45) / 0.45
    np.testing.assert_allclose(mean, exact, rtol=1e-6)
    assert len(list(ReadingTimes(np.zeros(3)).shifts())) == 1


@pytest.mark.parametrize(
    "text", ["[telemetry.offset_s]\nc = 1", "averaged_s = -1", "[telemetry.offset_s]\na = inf"]
)
def test_invalid_reading_offsets_are_refused_in_one_sentence(text):
    words = "panel that the vehicle does not have|must not be negative|number"
    with pytest.raises(ss.VehicleError, match=words):
        craft('time_column = "t"\n' + text)


SENSORS = """
[gyro]
columns = ["gx", "gy", "gz"]
scale_rad_s = 0.01
zero = [1, 2, 3]
noise_rad_s = 0.001
"""


REVERSED = """
[gyro]
columns = ["-gy", "gx", "gz"]
scale_rad_s = 0.01
zero = [2, 1, 3]
noise_rad_s = 0.001
wraps_at = 256
[magnetometer]
columns = ["mx", "-mz", "my"]
zero = [10, 30, 20]
wraps_at = 256
matrix = [[1, 0.1, 0], [0, 2, 0], [0, 0, 1]]
"""


def test_a_minus_before_a_column_reverses_it_after_its_zero(tmp_path):
    (tmp_path / "t.csv").write_text(
        "t,pa,pb,sx,sy,sz,gx,gy,gz,mx,my,mz\n2026-01-01T00:00:00Z,1,0,1,0,0,11,252,3,20,20,29\n"
    )
    text = VEHICLE.format(telemetry='time_column = "t"').replace('"sx", "sy"', '"sy", "-sx"')
    data = ss.read_telemetry(tmp_path / "t.csv", parse_vehicle(text + REVERSED, "v.toml"))
    np.testing.assert_allclose(data["gyro_B"].values, [[0.06, 0.10, 0.0]], atol=1e-12)  # 252 is -4
    np.testing.assert_allclose(data["field_B"].values, [[10 + 0.1, 2.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(data["sun_sensor_B"].values, [[0, -1, 0]], atol=1e-12)
    assert data.attrs["unused_columns"] == "" and data.attrs["missing_sensors"] == ""


@pytest.mark.parametrize(
    ("peak", "fill", "named"),
    [(1.3, None, True), (1.0, None, False), (0.6, None, False), (0.6, 4095, False)],
)
def test_readings_that_pile_up_at_the_largest_count_of_a_converter_are_named(
    peak, fill, named, tmp_path
):
    """Right files reach that count now and then, or hold it as a fill value far above all readings."""
    light = np.cos(0.37 * np.arange(200))
    counts = np.clip(np.round(4095 * peak * np.stack([light, -light], axis=1)), 0, 4095)
    if fill:
        counts[::20] = fill
    rows = [f"{10 * k},{first:.0f},{second:.0f}" for k, (first, second) in enumerate(counts)]
    (tmp_path / "t.csv").write_text("\n".join(["t,pa,pb", *rows]) + "\n")
    keys = 'time_column = "t"\ntime_format = "unix"'
    craft = parse_vehicle(VEHICLE.format(telemetry=keys), "v.toml")
    data = ss.read_telemetry(tmp_path / "t.csv", craft)
    notes = data.attrs.get("clock_notes", "")
    assert ("pile up at 4095, the largest count of 12 bits" in notes) == named


def test_suggested_keys_read_a_sensor_as_suggested():
    """For each of the 48 ways: the keys that the sentence names, in the vehicle file, give the readings that were meant."""
    base = tomllib.loads(REVERSED)
    base["gyro"]["zero"] = {"value": [2, 1, 3], "sigma": [0.1, 0.2, 0.3]}
    raw = np.random.default_rng(2).uniform(0, 255, (5, 6))
    header = ["gx", "gy", "gz", "mx", "my", "mz"]
    plain = VEHICLE.format(telemetry='time_column = "t"')

    def sensor(table, keys):
        craft = parse_vehicle(plain + tomlkit.dumps({table: keys}), "v.toml")
        return craft.sensors.with_columns[table]

    def values(sensor):
        return sensor.interpret(raw[:, [header.index(name) for name in sensor.names]]).values

    for table in ("gyro", "magnetometer"):
        old = sensor(table, base[table])
        for _, order, sign in signed_axes():
            told = advice_to_set(table, old.keys_for_axes(order, sign)).removeprefix("set ")
            lines = told.partition(" under ")[0].split(" and ")
            # each is a line that can stand in the table as it is
            assert all(line.partition(" = ")[0].isidentifier() for line in lines)
            keys = tomllib.loads("\n".join(lines))
            new = sensor(table, base[table] | keys)
            np.testing.assert_allclose(values(new), values(old)[:, order] * sign, atol=1e-9)
            np.testing.assert_array_equal(new.zero_sigma, old.zero_sigma[order])


@pytest.fixture
def stored(tmp_path):
    """A vehicle, its telemetry with a gyro and a Sun vector, and the file of it as results folders have it."""
    vehicle = parse_vehicle(VEHICLE.format(telemetry='time_column = "t"') + SENSORS, "test")
    (tmp_path / "t.csv").write_text(
        "t,pa,pb,sx,sy,sz,gx,gy,gz,phase\n2026-01-01T00:00:00Z,1,0,1,0,0,1,2,4,dark\n"
        "2026-01-01T00:01:00Z,0.5,1,0,1,0,1,5,4,lit\n"
    )
    data = ss.read_telemetry(tmp_path / "t.csv", vehicle)
    return vehicle, data, write_netcdf(tmp_path / "telemetry.nc", data)


def test_telemetry_of_a_results_folder_is_read_unchanged(stored):
    vehicle, data, path = stored
    again = ss.read_telemetry(path, vehicle)
    xr.testing.assert_identical(again.drop_attrs(), data.drop_attrs())
    assert dict(again.attrs) == dict(data.attrs)
    assert again["gyro_B"].values[1].tolist() == [0.0, 0.03, 0.01]
    xr.testing.assert_identical(
        restore_telemetry(data.assign(more=("time", [1, 2])), vehicle, path), data
    )


SPOILT = {
    "texts": lambda one: one.values.astype(str),
    "complex": lambda one: one.values.astype(complex),
    "endless": lambda one: np.full(one.shape, np.inf),
    "huge": lambda one: np.full(one.shape, 1e300),
    "truths": lambda one: np.ones(one.shape, dtype=bool),
    "objects": lambda one: np.full(one.shape, None),
}


@pytest.mark.parametrize("how", SPOILT)
def test_any_damage_of_stored_telemetry_is_named(stored, how):
    """Every variable, its values in another form or beyond all measure; and with a dimension of its own."""
    vehicle, data, path = stored
    for name in ("flag", "power_W", "gyro_B", "sun_sensor_B", "sun_sensor_cov_B", "time"):
        one = data[name]
        wrong = data.assign_coords({name: (one.dims, SPOILT[how](one))})
        mean = one.mean("time")
        other = data.rename_dims(time="row") if name == "time" else data.assign({name: mean})
        for damaged in (wrong, other):
            with pytest.raises(ss.TelemetryError, match="not that of this vehicle"):
                restore_telemetry(damaged, vehicle, path)


def test_stored_telemetry_that_was_changed_or_is_of_another_vehicle_is_refused(stored):
    vehicle, data, path = stored
    spoilt = (
        (data.assign_coords(panel=["a", "c"]), "other panels.*vehicle.toml"),
        (data.drop_vars("panel"), "other panels"),
        (data.isel(panel=[0]), "other panels"),
        (data.drop_vars("flag"), "no flags"),
        (data.assign(flag=("time", [0.0, np.nan])), "another form of flag"),
        (data.assign(gyro_B=("time", ["a", "b"])), "another form of gyro_B"),
        (data.assign(power_W=1e300 * data["power_W"]), "power_W beyond all measure"),
        (data.assign_coords(time=[0.0, np.inf]), "no times"),
        (data.assign_attrs(epoch_utc="never"), "no epoch"),
        (data[["flag"]], "no flags, or no reading"),
    )
    for wrong, why in spoilt:
        with pytest.raises(ss.TelemetryError, match=f"not that of this vehicle .found {why}"):
            restore_telemetry(wrong, vehicle, path)
