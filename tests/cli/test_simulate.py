"""Commands that compute a motion, and so compile kernels: their results, the last time, folders and caches."""

import json
import math
import os
import subprocess
import sys

import pytest
import xarray as xr

from tests.support.commands import sunspin
from validation.border import BEGUN

MOTION = ("simulate", "philae", "--omega-deg-s=6,0,0", "--sun=0.1959,0.5690,0.7986")


def test_results_of_the_same_command_are_replaced(undrawn, tmp_path):
    for duration in (10, 20):
        sunspin(*MOTION, f"--duration={duration}", "--out", tmp_path / "run")
    with xr.open_dataset(tmp_path / "run" / "trajectory.nc", engine="h5netcdf") as data:
        assert data.sizes["time"] == 21
    assert not [path.name for path in (tmp_path / "run").iterdir() if path.name.endswith(".part")]


def test_the_last_output_time_of_simulate_is_its_duration():
    for duration, step in ((10, 3), (-10, 3), (0.3, 0.1), (0, 1)):
        done = sunspin(*MOTION, f"--duration={duration}", f"--step={step}", "--json")
        assert json.loads(done.out)["t_s"] == pytest.approx(duration, abs=1e-12)


@pytest.mark.parametrize("home", ["", pytest.param("/proc", marks=pytest.mark.long)])
def test_without_a_cache_folder_no_library_writes_to_the_output(home):
    """A library that warned of its own cache on standard output would spoil what --json writes there."""
    places = os.environ | {"HOME": home, "XDG_CACHE_HOME": home}
    command = [sys.executable, "-m", "sunspin.cli", *MOTION, "--duration=10", "--json"]
    done = subprocess.run(command, env=places, capture_output=True, text=True)
    errors = BEGUN.sub("", done.stderr)  # the first run says that it compiles
    assert (done.returncode, errors) == (0, "") and json.loads(done.stdout)["t_s"] == 10


@pytest.mark.parametrize("form", ["aem", "netcdf", "parquet"])
def test_export_writes_to_a_folder_whose_name_is_not_utf8(form, tmp_path, undrawn):
    sunspin(*MOTION, "--duration=5", "--out", tmp_path / "run")
    place = tmp_path / os.fsdecode(b"caf\xe9")
    epoch = "--epoch=2026-01-01T00:00:00Z"
    done = sunspin("export", tmp_path / "run", "--format", form, epoch, "--out", place)
    assert done.err == "" and len(list(place.glob("[a-z]*"))) == 1


def test_the_direction_to_the_sun_may_have_any_length():
    """A direction rounded to two digits was refused once: its length was 0.998."""
    motion = "simulate", "philae", "--omega-deg-s=6,0,0", "--duration=60", "--json"
    rounded, doubled = (
        json.loads(sunspin(*motion, f"--sun={sun}").out) for sun in ("0.2,0.57,0.8", "0.4,1.14,1.6")
    )
    assert rounded["sun_B"] == pytest.approx(doubled["sun_B"], abs=1e-9)
    assert math.hypot(*rounded["sun_B"]) == pytest.approx(1.0, abs=1e-9)
