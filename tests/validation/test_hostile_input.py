"""Hostile input gives a result or one sentence: a part of the campaigns of validation/, and a case for each fault fixed."""

import json
import os
import zipfile

import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from sunspin.base.errors import printable, sentence
from sunspin.cli.interruption import STOPPED
from sunspin.compute.rows import ensemble
from sunspin.vehicle import Panel, Vehicle, Wheel
from sunspin.vehicle.file import parse_vehicle
from tests.support.rows import Waves
from validation import pool
from validation.border import CommandResult, judge, sunspin
from validation.corrupt import Corrupt
from validation.fuzz import Fuzz
from validation.hostile import TABLE_BOMBS

START = ["--omega-deg-s=6,0,0", "--sun=0,0.6,0.8"]


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert sunspin("init", ".", "--quiet") == CommandResult(0, "", "")
    return tmp_path


def refused(*arguments, words=()):
    told = sunspin(*map(str, arguments))
    assert judge(told).what == "refused", told
    for word in words:
        assert word in told.err
    return told.err


@pytest.mark.parametrize(
    ("suite", "n"), [(Fuzz, 20), pytest.param(Corrupt, 20, marks=pytest.mark.long)]
)
def test_hostile_input_gives_a_result_or_one_sentence(suite, n, monkeypatch):
    monkeypatch.setattr("validation.fuzz.SEARCH_S", 0.5)
    with suite(seed=21, memory=None) as case:
        verdicts = [case(index) for index in range(n)]
    assert [v for v in verdicts if v.bad] == []
    assert sum(v.what == "refused" for v in verdicts) > 0.38 * n  # the campaign does attack
    assert sum(v.what == "fine" for v in verdicts) > 0.08 * n  # and does not only send nonsense


@pytest.mark.long
def test_every_hostile_table_gives_a_result_or_one_sentence(home):
    """Also those with a leap second, years from 1 to 9999, other forms of time, other encodings, readings of any size."""
    good, told = (home / "telemetry.csv").read_bytes(), []
    for bomb in TABLE_BOMBS:
        (home / "bad.csv").write_bytes(bomb(good))
        told.append(judge(sunspin("check", "vehicle.toml", "bad.csv")))
    assert [each for each in told if each.bad] == []
    assert sum(each.what == "refused" for each in told) > len(told) / 2


@pytest.mark.parametrize(
    ("told", "what"),
    [
        (CommandResult(0, "fine", ""), "fine"),
        (CommandResult(0, "", "a warning"), "noise"),
        (CommandResult(2, "", "sunspin: error: no.\n"), "refused"),
        (CommandResult(2, "half a result", "sunspin: error: no.\n"), "not one sentence"),
        (CommandResult(2, "", "sunspin: error: no.\nand more\n"), "not one sentence"),
        (CommandResult(2, "", "sunspin: error: \x1b[2J.\n"), "not one sentence"),
        (CommandResult(1, "", "sunspin: defect\n"), "exit code"),
        (CommandResult(None, "", "", "Traceback"), "traceback"),
    ],
)
def test_the_judge_of_the_campaigns_detects_each_kind_of_failure(told, what):
    assert judge(told).what == what and judge(told).bad == (what not in ("fine", "refused"))


class Broken(pool.Suite):
    """A suite that does what no case may do."""

    def prepare(self):
        pass

    def __call__(self, index):
        if index == 1:
            os._exit(7)
        while index == 2:
            pass
        return pool.Verdict("fine")


@pytest.mark.long
def test_the_pool_of_a_campaign_detects_crashes_and_hangs_and_continues():
    report = pool.run(Broken, 5, workers=1, cpu_s=0.3)
    assert report.counts == {"fine": 3, "crash": 1, "hang": 1}
    assert {index: verdict.what for index, verdict in report.findings} == {1: "crash", 2: "hang"}


def test_text_from_outside_cannot_control_the_terminal():
    assert printable("a\x1b[2J\u202eb\n c\udce9 é") == "a\\x1b[2J\\u202eb c\\udce9 é"
    assert sentence("x", got=10**5000).isprintable()
    assert "\\x1b[31m" in refused("check", "\x1b[31m.toml")


def test_an_unexpected_exception_is_reported_as_a_fault_of_sunspin(monkeypatch, home):
    def broken(*_):
        raise TypeError("oops")

    monkeypatch.delenv("SUNSPIN_TRACEBACK", raising=False)
    monkeypatch.setattr("sunspin.vehicle.load_vehicle", broken)
    STOPPED.set()  # as an interruption of an earlier command in this process leaves it
    told = sunspin("check", "philae")
    assert told.code == 1
    assert told.err.count("\n") == 1
    assert "fault of sunspin" in told.err
    assert "oops" in told.err
    monkeypatch.setenv("SUNSPIN_TRACEBACK", "1")
    assert "TypeError" in sunspin("check", "philae").escaped


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("mass_kg = " + "9" * 400, "between 1e-30 and 1e+30"),
        ("mass_kg = " + "9" * 5000, "not valid TOML"),
        ("mass_kg = 0x" + "f" * 5000, "between 1e-30 and 1e+30"),
        ("mass_kg = 1e308", "between 1e-30 and 1e+30"),
        ("mass_kg = nan", "between 1e-30 and 1e+30"),
        ("a." * 50_000 + "a = 1", "line 1"),
        ("a = " + "[" * 50_000, "nested too deeply"),
        ('name = "\\u001b[2J"', "printable"),
    ],
)
def test_huge_or_nonsensical_vehicle_files_are_refused(text, said):
    with pytest.raises(ss.VehicleError, match=said.replace("+", r"\+")) as error:
        body = text if text.startswith(("a", "name")) else f"name = 'v'\n[body]\n{text}"
        parse_vehicle(body, "v.toml")
    assert str(error.value).isprintable()
    with pytest.raises(ss.VehicleError, match="at most 32 panels"):
        Vehicle("many", panels=[Panel(str(k), [0, 0, 1], 1.0) for k in range(33)])
    with pytest.raises(ss.VehicleError, match="at most 8 wheels"):
        Vehicle("many", wheels=[Wheel(str(k), [0, 0, 1], 1.0) for k in range(9)])


def test_no_key_of_a_vehicle_file_names_a_file(home, tmp_path_factory):
    """Paths cannot leave its folder, as there are none: text that looks like one is a name, and nothing is opened."""
    secret = tmp_path_factory.mktemp("other") / "secret.csv"
    secret.write_text("time_utc,px\n")
    text = (home / "vehicle.toml").read_text("utf-8")
    text = text.replace('"px"', f'"{secret}"').replace('"my satellite"', '"../../etc/passwd"')
    (home / "v.toml").write_text(text)
    err = refused("sun", "v.toml", "telemetry.csv", words=["is missing"])
    assert "time_utc,px\n" not in err


SCAN = "scan vehicle.toml telemetry.csv --to=160"
SPIN = f"simulate philae {' '.join(START)}"
FAST = f"simulate philae --omega-deg-s=6e6,0,0 {START[1]}"


FRICTION = f"outcomes vehicle.toml --omega-deg-s=0,0,60 {START[1]} --after=1 --collision-speed=0"
TURNS = "rates vehicle.toml telemetry.csv --max-rate-deg-s=1e6"
FINE = "".join(f" --omega-{axis}-deg-s=-30:30:0.006" for axis in "xyz")
AGES = [
    (SCAN + FINE, ["2.8e+04 h of one core and 3e+04 GB"]),
    (f"{SCAN} --omega-x-deg-s=0:60:1e-10", ["h of one core", "GB of memory", "larger step"]),
    (f"{SPIN} --duration=1e7 --step=1", ["output times", "GB of memory"]),
    (f"{SPIN} --duration=1e9 --step=1e8", ["rad", "would take some"]),
    (f"{FAST} --duration=1e4 --step=1e3", ["in rad/s"]),
    # back in time friction makes a wheel faster without bound
    (f"{FRICTION} --runs=4 --lead=1e20", ["steps", "unit"]),
    (f"{TURNS} --acceleration-noise=1e-4", ["whole turns", "--max-rate-deg-s"]),
]


@pytest.mark.parametrize(("line", "words"), AGES)
def test_what_would_take_ages_or_all_memory_is_refused_in_one_sentence(line, words, home):
    refused(*line.split(), words=words)
    with pytest.raises(ss.InputError, match="GB of memory"):
        ensemble(Waves(n_rows=10**13))


@pytest.mark.parametrize("value", ["nan", "1e308", "1e-308"])
def test_infinite_or_extreme_numbers_are_refused_by_every_command(value, home):
    refused("simulate", "philae", *START, f"--duration={value}", words=["--duration", "number"])
    rate = f"--omega-deg-s=0,{value},0"
    refused("simulate", "philae", rate, START[1], "--duration=1", words=["--omega-deg-s"])
    refused("sun", "vehicle.toml", "telemetry.csv", f"--noise={value}", words=["--noise"])


def test_file_names_of_any_bytes_are_printed(home):
    told = sunspin("init", "caf\udce9", "--json")
    assert json.loads(told.out)["vehicle"].startswith("caf\udce9")
    assert sunspin("init", "caf\udce8").code == 0


def test_results_and_their_page_are_written_to_a_folder_of_any_name(home, undrawn, framed):
    os.rename("telemetry.csv", "t\udce9.csv")
    folder = "caf\udce9 \u202e"
    for command in (
        ["simulate", "philae", *START, "--duration=5"],
        ["sun", "vehicle.toml", "t\udce9.csv"],
    ):
        place = folder + command[0]
        told = sunspin(*command, f"--out={place}")
        assert not told.err and told.code == 0, told
        assert place in json.loads((home / place / "summary.json").read_text("utf-8"))["command"]
        told = sunspin("report", place)
        assert not told.err and told.code == 0, told
    pytest.importorskip("spiceypy")
    form = "--epoch=2026-01-01T00:00:00Z", "--format=ck", f"--out={folder}"
    refused("export", folder + "simulate", *form, words=["SPICE"])


def test_a_page_is_made_of_motions_with_missing_values(home, undrawn):
    assert sunspin("simulate", "philae", *START, "--duration=20", "--out=results").code == 0
    with xr.open_dataset("results/trajectory.nc", engine="h5netcdf") as data:
        data = data.load()
    for name in ("sun_B", "omega_B", "B_from_N"):
        data[name].values[3:6] = np.nan
    data.sunspin.save("unknown")
    told = sunspin("report", "unknown")
    assert told.code == 0 and not told.err, told


def test_compressed_tables_that_unpack_to_huge_sizes_are_refused(home, monkeypatch):
    """A few kB of Parquet or NetCDF can hold a billion cells; here the limit is a hundredth of what it is."""
    from sunspin.base import tables

    assert tables.MAX_CELLS == 100_000_000
    monkeypatch.setattr(tables, "MAX_CELLS", 1_000_000)
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    column = pa.DictionaryArray.from_arrays(pa.array(np.zeros(200_000, np.int8)), pa.array([1.0]))
    pq.write_table(pa.table({f"c{i}": column for i in range(6)}), "bomb.parquet")
    assert os.path.getsize("bomb.parquet") < 10_000
    refused("sun", "vehicle.toml", "bomb.parquet", words=["more than 1e+06 cells"])
    import h5netcdf

    with h5netcdf.File("bomb.nc", "w") as file:
        file.dimensions = {"time": 10**12}
        file.create_variable("px", ("time",), "f8", chunks=(10**6,))
    refused("sun", "vehicle.toml", "bomb.nc", words=["GB of memory"])


def test_files_that_are_no_scan_no_kernels_or_no_frames_are_refused_in_one_sentence(home, undrawn):
    xr.Dataset({"emd": ("x", [1.0])}).to_netcdf("scan.nc", engine="h5netcdf")
    words = "outcomes vehicle.toml --scan=scan.nc --sun=0,0.6,0.8 --after=60"
    refused(*words.split(), words=["no scan"])
    # an archive of frames without names
    with zipfile.ZipFile("frames.zip", "w") as archive:
        archive.writestr("x", b"")
    data = (home / "frames.zip").read_bytes().replace(b"\x01\x00\x00\x00x", b"\x00\x00\x00\x00\x00")
    (home / "frames.zip").write_bytes(data)
    refused("decode", "frames.zip", words=["raw"])
    pytest.importorskip("spiceypy")
    assert sunspin("simulate", "philae", *START, "--duration=5", "--out=results").code == 0
    given = "compare", "results", "--frame=X", "--epoch=2026-01-01T00:00:00Z"
    refused(*given, ".", words=["--frame"])  # the folder itself
    refused(*given, "telemetry.csv", words=["kernels cannot be used"])


def test_a_netcdf_file_that_hangs_the_library_is_refused(home, monkeypatch):
    """The other process is ended after its time; here every file is such a one."""
    from sunspin.base import netcdf

    xr.Dataset({"px": ("time", [1.0])}).to_netcdf("good.nc", engine="h5netcdf")
    monkeypatch.setattr(netcdf, "PROBE_S", 1)
    (home / "netcdf_probe.py").write_text("while True: pass\n")
    monkeypatch.setattr(netcdf, "__file__", str(home / "netcdf.py"))
    refused("sun", "vehicle.toml", "good.nc", words=["ends the program that reads it"])
