"""The telemetry reader: clocks, columns, units, and one sentence for each fault."""

import csv
import json
from importlib import resources

import numpy as np
import pandas as pd
import pytest

import sunspin as ss
from sunspin.base.errors import TelemetryError
from sunspin.telemetry.quality import _earth_light
from sunspin.telemetry.sun import is_reconstructed
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from sunspin.vehicle.file import parse_vehicle

GOOD = "time,a,b\n2026-01-01T00:00:00Z,1.0,2.0\n2026-01-01T00:02:00Z,1.5,0.0\n"


def vehicle(**form) -> Vehicle:
    return Vehicle(
        "two",
        panels=[Panel("a", [1, 0, 0], 1.0), Panel("b", [0, 1, 0], 1.0)],
        telemetry=TelemetryForm(**form),
    )


def read(tmp_path, text, craft=None):
    path = tmp_path / "t.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return ss.read_telemetry(path, craft or vehicle())


@pytest.mark.evidence("read_telemetry", "verified", "a file written by hand")
def test_a_good_telemetry_file_is_read(tmp_path):
    data = read(tmp_path, "# synthetic: made up\n" + GOOD)
    np.testing.assert_array_equal(data["power_W"].values, [[1, 2], [1.5, 0]])
    np.testing.assert_array_equal(data["time"].values, [0, 120])
    assert data.attrs["epoch_utc"] == "2026-01-01T00:00:00Z"
    assert data.attrs["synthetic"] == 1
    assert np.all(data["flag"].values == 0)


@pytest.mark.parametrize("kind", ["csv", "json", "parquet"])
@pytest.mark.parametrize("seed", range(3))
def test_a_wrong_cell_is_named_with_its_line_and_column(tmp_path, kind, seed):
    """Wherever it stands, among comments, blank lines, quoted cells and columns in any order."""
    rng = np.random.default_rng(seed)
    n, names = int(rng.integers(2, 40)), rng.permutation(["time", "a", "b", "other"]).tolist()
    times = pd.date_range("2026-01-01", periods=n, freq="60s").strftime("%Y-%m-%dT%H:%M:%SZ")
    cells = pd.DataFrame(dict.fromkeys(names, "1.5"), np.arange(n)).assign(time=times)
    row, column = int(rng.integers(n)), str(rng.choice(["time", "a", "b"]))
    cells.loc[row, column] = str(rng.choice(["x", "", "1_0", "\u0663"]))
    comments, blank = int(rng.integers(3)), rng.random(n) < 0.3
    line = {"csv": comments + 2, "json": 1, "parquet": 1}[kind] + row
    path = tmp_path / "t"
    if kind == "parquet":
        pytest.importorskip("pyarrow")
        cells.to_parquet(path)
    else:
        lines = cells.apply(lambda each: json.dumps(each.to_dict()), axis=1).tolist()
        if kind == "csv":
            style = {"index": False, "header": False, "quoting": csv.QUOTE_ALL if seed % 2 else 0}
            lines = cells.to_csv(**style).splitlines()
        lines = [f"\n{text}" if empty else text for text, empty in zip(lines, blank, strict=True)]
        line += int(blank[: row + 1].sum())
        head = ["# a comment"] * comments + [",".join(names)] if kind == "csv" else []
        path.write_text("\n".join(head + lines) + "\n", "utf-8")
    place = f"{'row' if kind == 'parquet' else 'line'} {line}, column '{column}'"
    with pytest.raises(TelemetryError, match=f"{place}: .* expected"):
        ss.read_telemetry(path, vehicle())


def test_unix_seconds_scale_current_and_named_columns(tmp_path):
    craft = vehicle(
        quantity="current_A",
        time_column="t",
        time_format="unix",
        scale=0.001,
        columns={"a": "ia", "b": "ib"},
    )
    data = read(tmp_path, "t,ia,ib,other\n1498633767,500,0,x\n1498633807.5,250,1,y\n", craft)
    np.testing.assert_allclose(data["current_A"].values, [[0.5, 0], [0.25, 0.001]], rtol=1e-12)
    np.testing.assert_allclose(data["time"].values, [0, 40.5], rtol=0, atol=1e-6)
    assert data.attrs["epoch_utc"].startswith("2017-06-28T07:09:27")


def test_elapsed_seconds_need_and_keep_their_epoch(tmp_path):
    craft = vehicle(time_format="elapsed", epoch_utc="2026-03-01T12:00:00")
    data = read(tmp_path, "time,a,b\n10,1,1\n20,1,1\n", craft)
    np.testing.assert_array_equal(data["time"].values, [10, 20])
    assert data.attrs["epoch_utc"] == "2026-03-01T12:00:00Z"


@pytest.mark.evidence("read_telemetry", "verified", "files with one mistake each")
@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["empty"]),
        ("time,a,b\n", ["header but no samples"]),
        (GOOD.replace("time,a,b", "time,a,c"), ["column 'Pb_W'", "missing", "columns time, a, c"]),
        (GOOD.replace("2.0", "nan"), ["line 2", "column 'b'", "nan"]),
        (GOOD.replace("2.0", ""), ["line 2", "column 'b'", "empty cell"]),
        (GOOD.replace("1.5", "-3"), ["line 3", "negative", "-3"]),
        (GOOD.replace("00:02:00", "00:00:00"), ["line 3", "time does not increase"]),
        (GOOD.replace("2026-01-01T00:02:00Z", "yesterday"), ["line 3", "ISO-8601", "yesterday"]),
        (GOOD.replace("1.5,0.0", "1.5"), ["line 3", "2 values", "3 columns"]),
        (GOOD.encode("utf-16")[:-1], ["not UTF-16"]),
        (b"time,a,b\n\xff,1,2\n", ["line 2", "not UTF-8"]),
        (GOOD + "\0", ["binary"]),
        ("time,a,a,b\n1,2,3,4\n", ["share a name"]),
        ('time,a,b\n"2026,1,2\n', ["CSV"]),
    ],
)
def test_bad_telemetry_files_are_refused_in_one_sentence(tmp_path, text, parts):
    with pytest.raises(ss.TelemetryError) as error:
        read(tmp_path, text)
    message = str(error.value)
    assert "t.csv" in message and "\n" not in message
    for part in parts:
        assert part in message, message
    with pytest.raises(ss.TelemetryError, match="cannot be read"):
        ss.read_telemetry(tmp_path / "none.csv", vehicle())
    with pytest.raises(ss.TelemetryError, match="folder"):
        ss.read_telemetry(tmp_path, vehicle())


FLAGGING = {"time_format": "elapsed", "epoch_utc": "2026-01-01", "bad_rows": "flag"}


def test_bad_rows_can_be_flagged_instead(tmp_path):
    craft = vehicle(**FLAGGING)
    data = read(tmp_path, "time,a,b\n0,1,1\n10,nan,1\n20,-2,1\n20,1,1\n30,1,1\n", craft)
    np.testing.assert_array_equal(data["flag"].values, [0, 1, 2, 4, 0])
    status = ss.sun_directions(craft, data, lit_threshold=0.1)["status_text"].values
    assert all("flagged" in text for text in status[1:4])


def test_rows_are_sorted_and_repeats_merged_where_bad_rows_are_flagged(tmp_path):
    """One tag far ahead of its time must not spoil the rows behind it; two stations heard the frame at 20 s, each a part of it.
    A file without an epoch begins at its earliest row."""
    text = "time,a,b\n900,7,1\n0,1,1\n10,2,1\n20,3,\n20,,1\n30,4,1\n20,3,1\n"
    data = read(tmp_path, text, vehicle(**FLAGGING))
    np.testing.assert_array_equal(data["time"].values, [0, 10, 20, 30, 900])
    np.testing.assert_array_equal(data["power_W"].values[:, 0], [1, 2, 3, 4, 7])
    assert not data["flag"].values.any()
    assert data.attrs["rows_merged"] == 2 and data.attrs["rows_sorted"] == 6
    text = "time,a,b\n2026-01-01T00:01:00Z,2,1\n2026-01-01T00:00:00Z,1,1\n"
    data = read(tmp_path, text, vehicle(bad_rows="flag"))
    assert data.attrs["epoch_utc"] == "2026-01-01T00:00:00Z"
    assert data["time"].values.tolist() == [0.0, 60.0]


def test_times_without_a_zone_next_to_local_ones_are_refused(tmp_path):
    """Nobody knows whether they are UTC; beside times in UTC they are."""
    rows = "time,a,b\n2026-01-01T00:00:00{},2,1\n2026-01-01T00:01:00,1,1\n"
    words = r"line 3, column 'time': other times of this file have a time zone .* or Z for UTC"
    with pytest.raises(ss.SunspinError, match=words):
        read(tmp_path, rows.format("+02:00"))
    assert read(tmp_path, rows.format("Z"))["time"].values.tolist() == [0, 60]


def test_small_negative_readings_are_accepted_and_large_ones_refused(tmp_path):
    """Dark panels of a real file read a little below zero now and then, within a stated noise or one that the file shows; a panel
    with its sign turned reads far below."""
    data = read(tmp_path, GOOD.replace("0.0", "-0.02"), vehicle(noise=0.01))
    assert data["power_W"].values[1, 1] == -0.02
    rng = np.random.default_rng(2)
    lit = np.maximum(0, np.sin(np.arange(40)[:, None] + [0.0, np.pi]))
    noisy = lit + 0.01 * rng.standard_normal(lit.shape)
    craft = vehicle(time_format="elapsed", epoch_utc="2026-01-01")

    def text(values) -> str:
        rows = [f"{10 * k},{a:.4f},{b:.4f}\n" for k, (a, b) in enumerate(values)]
        return "time,a,b\n" + "".join(rows)

    assert (noisy < -0.01).sum() > 3
    data = read(tmp_path, text(noisy), craft)
    np.testing.assert_array_equal(data["flag"].values, 0)
    np.testing.assert_allclose(data["power_W"].values, noisy, rtol=0, atol=1e-4)
    assert ss.sun_directions(craft, data).attrs["noise"] == pytest.approx(0.01, rel=0.5)
    for spoilt in (noisy * [1, -1], np.where(np.arange(80).reshape(40, 2) == 33, -0.2, noisy)):
        with pytest.raises(TelemetryError, match="a panel cannot give a negative value"):
            read(tmp_path, text(spoilt), craft)


@pytest.mark.evidence("read_telemetry", "validated", "real beacons of skCUBE")
@pytest.mark.real_data
def test_skcube_beacons_are_read_with_a_summary_of_their_content(data_dir):
    craft = ss.load_vehicle("skcube")
    data = ss.read_telemetry(data_dir / "skcube" / "skcube_pwr.csv", craft)
    assert data.sizes["time"] == 55
    sun = ss.sun_directions(craft, data)
    # as counted by hand: six beacons with three lit faces
    assert is_reconstructed(sun["status"]).sum() == 6
    assert set(np.unique(sun["n_lit"].values)) <= {0, 1, 2, 3}


TEMPLATE = resources.files("sunspin").joinpath("template", "vehicle.toml").read_text("utf-8")


@pytest.mark.parametrize(
    ("time", "words"),
    [
        ("2016-12-31T23:59:60Z", "leap seconds are not known"),
        ("2016-12-31 23:59:60.25+00:00", "leap seconds are not known"),
        ("1767225600", 'if it is in seconds, set time_format = "unix"'),
        ("46023.5", 'if it is in seconds, set time_format = "unix"'),
        ("1767225600000", "Unix time in ms, us or ns, set time_format = .unix."),
        ("01.13.2026 00:00:00", "write it as 2026-01-31T23:59:59Z"),
        ("2026-01-01T00:00:00+25:00", "write it as 2026-01-31T23:59:59Z"),
        ("58:00.3", "a spreadsheet left minutes and seconds of it"),
        ("11:58:00.125", "name the column of dates as date_column"),
        ("nan", "write it as 2026-01-31T23:59:59Z"),
    ],
)
def test_an_invalid_time_is_refused_with_the_form_to_write(tmp_path, time, words):
    file = tmp_path / "t.csv"
    file.write_text(f"time_utc,px,mx,py,my,pz\n{time},1,0,1,0,1\n")
    words = f"line 2, column 'time_utc': an ISO-8601 UTC time is expected .*{words}"
    with pytest.raises(ss.SunspinError, match=words):
        ss.read_telemetry(file, parse_vehicle(TEMPLATE, "v.toml"))


@pytest.mark.parametrize(
    "first", ["2026-01-01T00:00:00Z,0.000,0.000,1,2,3", "2026-01-01T00:00:00Z,,,1,2,3"]
)
def test_a_file_without_a_header_is_reported(tmp_path, first):
    file = tmp_path / "t.csv"
    file.write_text(f"{first}\n{first}\n")
    words = "the first row holds numbers and no names of columns"
    with pytest.raises(ss.SunspinError, match=words):
        ss.read_telemetry(file, parse_vehicle(TEMPLATE, "v.toml"))


def test_the_albedo_estimate_takes_readings_of_any_size():
    """A scale that is off by hundreds of powers of ten: squares of Python's numbers would end in an error."""
    assert _earth_light(1e200, 100, 0.0) > 1e199 and _earth_light(0.1, 100, 0.2) == 0.0
