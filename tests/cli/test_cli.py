"""The command line as a user meets it: output, exit codes, one sentence on errors, nothing overwritten."""

import json
import math
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
import xarray as xr

from sunspin.base.errors import InputError
from tests.support.commands import sunspin

pytestmark = pytest.mark.usefixtures("framed")


@pytest.fixture
def start(tmp_path) -> Path:
    sunspin("init", tmp_path / "mine")
    return tmp_path / "mine"


def test_a_command_ends_without_a_search_for_garbage():
    """What is registered first runs last at the end of Python."""
    code = """import atexit, gc, sys
atexit.register(lambda: print("kept from the search:", gc.get_freeze_count() > 0))
from sunspin.cli import main
sys.argv[1:] = ["--version"]
main()"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("kept from the search: True\n")


@pytest.mark.parametrize(("before", "imported"), [("", False), ("import xarray", True)])
def test_dask_is_imported_only_where_xarray_has_looked_for_it(start, before, imported):
    """It would take half a second; a program that has xarray already needs it to find the same as before."""
    pytest.importorskip("dask")
    words = ["sunspin", "sun", "vehicle.toml", "telemetry.csv", "--quiet"]
    code = f"""import sys
{before}
sys.argv = {words}
from sunspin.cli import main
try:
    main()
except SystemExit as end:
    print(end.code, "dask.array" in sys.modules)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=start, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["0", str(imported)]


@pytest.mark.evidence("sun", "verified", "the files that init writes")
@pytest.mark.evidence("init", "verified", "check and sun run on what it writes")
def test_files_written_by_init_work_with_the_next_commands(start):
    files = start / "vehicle.toml", start / "telemetry.csv"
    assert "40 synthetic samples" in sunspin("check", *files).out
    summary = json.loads(sunspin("sun", *files, "--out", start / "out", "--json").out)
    assert summary["reconstructed"] == 37 and summary["synthetic_telemetry"] is True
    written = {path.name for path in (start / "out").iterdir()}
    assert {"sun.csv", "sun.nc", "sun.png", "sun.svg"} <= written
    assert "\n# synthetic telemetry\n" in (start / "out" / "sun.csv").read_text()
    with xr.open_dataset(start / "out" / "sun.nc", engine="h5netcdf") as data:
        assert data["sun_B"].sizes == {"time": 40, "axis": 3}


def test_a_folder_with_results_of_another_command_is_not_overwritten(start, tmp_path):
    keep = tmp_path / "precious"
    keep.mkdir()
    (keep / "thesis.txt").write_text("mine")
    done = sunspin("sun", start / "vehicle.toml", start / "telemetry.csv", "--out", keep, code=2)
    assert "not empty" in done.err
    assert [path.name for path in keep.iterdir()] == ["thesis.txt"]
    sunspin("sun", start / "vehicle.toml", start / "telemetry.csv", "--out", start / "out")
    motion = "--omega-deg-s=0,0,0", "--sun=0,0,1", "--duration=1"
    done = sunspin("simulate", "philae", *motion, "--out", start / "out", code=2)
    assert "results of" in done.err


@pytest.mark.evidence("simulate", "validated", "the paper: the wheel stops after about 42 min")
def test_simulate_prints_and_stores_its_events(tmp_path):
    motion = "--omega-deg-s=0,0,0 --sun=0.1959,0.5690,0.7986 --duration=2700 --step=60 --json"
    done = sunspin("simulate", "philae", *motion.split(), "--out", tmp_path / "run")
    events = json.loads(done.out)["events"]
    assert events[0]["what"] == "stops" and abs(events[0]["t_s"] / 60 - 42.0) < 0.05
    with xr.open_dataset(tmp_path / "run" / "trajectory.nc", engine="h5netcdf") as data:
        assert data.sizes["time"] == 46


def test_scan_runs_on_the_files_written_by_init(start):
    rates = {"x": (0.01, 0.02, 0.03), "y": (-0.04, -0.03, -0.02), "z": (0.04, 0.05, 0.06)}
    grid = [
        f"--omega-{axis}-deg-s={','.join(str(math.degrees(rate)) for rate in values)}"
        for axis, values in rates.items()
    ]
    options = "--metric", "E", "--to", 160, *grid, "--lines", 0, "--json", "--quiet"
    done = sunspin("scan", start / "vehicle.toml", start / "telemetry.csv", *options)
    best = json.loads(done.out)["best_omega_B"]
    # the rate with which the samples were made
    assert best == pytest.approx([0.02, -0.03, 0.05], abs=1e-9)


def test_bad_input_is_one_sentence_and_exit_code_2(tmp_path):
    spin, sun = "simulate philae --omega-deg-s", "--sun 0,0,1 --duration 1"
    for line in (
        *("sun skcube no-such-file.csv", "sun no-such-vehicle x.csv", "nonsense", "sun philae"),
        *(
            f"{spin} 60,120 {sun}",
            f"{spin} 0,0,0 --sun 0,0,0 --duration 1",
            f"{spin} 0,0,0 {sun}e30",
        ),
        *("scan philae missing.csv --omega-x-deg-s 0:60:1e-10", "reproduce --workers 0"),
        "reproduce --telemetry missing.csv --out never",
    ):
        done = sunspin(*line.split(), cwd=tmp_path, code=2)
        lines = done.err.strip().splitlines()
        assert len(lines) == 1 and lines[0].startswith("sunspin: error: ")
        assert list(tmp_path.iterdir()) == []


def test_rates_without_a_terminal_print_that_work_began_unless_quiet(start, monkeypatch):
    """Before anything long: a log that stays empty looks like a program that hangs. Bad input is one sentence, as ever."""
    said = []

    def begin(*_: object) -> None:
        said.append(sys.stderr.buffer.getvalue().decode())
        raise InputError("no further")

    monkeypatch.setattr(import_module("sunspin.estimate.rates"), "decide_wheels", begin)
    files = start / "vehicle.toml", start / "telemetry.csv"
    options = "--workers", 1, "--acceleration-noise", 1e-4
    sunspin("rates", *files, *options, code=2)
    assert said == ["sunspin: rates: 40 samples used in 1 pass\n"]
    quiet = sunspin("rates", *files, *options, "--quiet", code=2)
    assert quiet.err == "sunspin: error: no further\n"
    assert sunspin("rates", *files, "--from", 1e6, code=2).err.count("\n") == 1
