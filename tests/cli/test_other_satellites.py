"""Every command on satellites as other operators would describe them, and on their corrupted files.

All telemetry here is synthetic (tests/support/satellite_files.py) but skCUBE's, which is used where it is found.
"""

import io
import json
import shutil
import sys
from contextlib import redirect_stderr, redirect_stdout
from functools import partial

import numpy as np
import pytest
import xarray as xr

from sunspin import cli
from tests.support.corruptions import BYTES, CELLS
from tests.support.satellite_files import four_faces, six_faces, wheeled
from validation.border import BEGUN

pytestmark = pytest.mark.usefixtures("undrawn")

MAKERS = {
    "six faces, UTC, quaternion": partial(six_faces, n=20),
    "four faces, Unix ms, counts": partial(four_faces, n=24),
    "wheel, MET, Parquet": partial(wheeled, n=20),
    "wheel, MET, NetCDF, no tachometer": partial(wheeled, n=20, form="netcdf", speed=False),
}


def sunspin(*arguments):
    """The entry point in this process: exit code, what was printed, what was complained (not that work has begun)."""
    before, sys.argv = sys.argv, ["sunspin", *map(str, arguments)]
    out, err = io.StringIO(), io.StringIO()
    try:
        with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as stopped:
            cli.main()
    finally:
        sys.argv = before
    return stopped.value.code, out.getvalue(), BEGUN.sub("", err.getvalue())


def fine(outcome):
    code, out, err = outcome
    assert (code, err) == (0, ""), err
    return out


def fine_or_a_sentence(arguments, told):
    code, out, err = sunspin(*arguments)
    assert code in (0, 2), (told, err)
    if code == 2:
        assert err.startswith("sunspin: error: ") and err.count("\n") == 1, (told, err)
        assert len(err) < 1500, (told, err)
        assert "Traceback" not in err and out == "", (told, err)
    return code


LONG = ("four faces, Unix ms, counts", "wheel, MET, Parquet", "wheel, MET, NetCDF, no tachometer")
"""What is theirs alone has quick tests elsewhere: tables in tests/measure, wheels and mirror images in tests/infer."""


@pytest.mark.parametrize(
    "maker", [pytest.param(m, marks=[pytest.mark.slow] if m in LONG else []) for m in MAKERS]
)
def test_every_command_runs_on_satellites_with_other_files(maker, tmp_path):
    craft = MAKERS[maker](tmp_path, np.random.default_rng(3))
    files, out = (craft.vehicle, craft.telemetry), tmp_path / "rates"
    assert "samples" in fine(sunspin("check", *files))
    fine(sunspin("sun", *files, "--out", tmp_path / "sun"))
    about = json.loads(
        fine(sunspin("rates", *files, "--max-rate-deg-s", 5, "--json", "--out", out))
    )
    assert sum(about["samples"].values()) == len(craft.truth["time"])
    with xr.open_dataset(out / "rates.nc", engine="h5netcdf") as result:
        result = result.load()
    times = result["time"].values - result["sample"].values[0]
    for k in range(result.sizes["pass_id"]):
        at, rates = times[(result["pass_of"] == k).values], craft.truth["omega_B"].values.T
        truth = [np.interp(at, craft.truth["time"], each).mean() for each in rates]
        miss = np.degrees(result["omega_mean_B"].values[k] - truth)
        # deg/s; they turn at 1 to 3
        assert np.nanmin(np.linalg.norm(miss, axis=1)) < 0.25, "no mode is near the truth"
    for form in ("aem", "aem-xml", "netcdf", "ck", "parquet"):
        words = "export", out, "--format", form, "--out", tmp_path / form
        fine(sunspin(*words))
        dense = json.loads(fine(sunspin(*words, "--step", 1, "--json")))
        assert dense["samples"] > len(times) and dense["segments"] == result.sizes["pass_id"]


def campaign(folder, makers, copies, seed, commands):
    """Corrupt telemetry and vehicle files and run commands on them; how many ran, and how many were refused."""
    count, refused = 0, 0
    for m, maker in enumerate(makers):
        home = folder / str(m)
        home.mkdir()
        craft = makers[maker](home, np.random.default_rng(m))
        for which in ("telemetry", "vehicle"):
            original = getattr(craft, which).read_bytes()
            kinds = BYTES + (CELLS if getattr(craft, which).suffix == ".csv" else ())
            for i in range(copies):
                key = (m, which == "vehicle", i)
                rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
                kind = kinds[i % len(kinds)]
                bad = home / f"bad{getattr(craft, which).suffix}"
                bad.write_bytes(kind(original, rng))
                files = (craft.vehicle, bad) if which == "telemetry" else (bad, craft.telemetry)
                for command in commands:
                    told = f"{maker}, {which}, {kind.__name__}, copy {i}, {command}"
                    code = fine_or_a_sentence([*command.split(), *files], told)
                    count, refused = count + 1, refused + (code == 2)
    return count, refused


SMALL = {
    "six": partial(six_faces, n=14),
    "four": partial(four_faces, n=14),
    "wheel": partial(wheeled, n=12, form="parquet"),
    "wheel nc": partial(wheeled, n=12, form="netcdf"),
    "wheel csv": partial(wheeled, n=12, form="csv"),
}


@pytest.mark.parametrize("copies", [6, pytest.param(16, marks=pytest.mark.long)])
def test_corrupted_input_files_give_one_sentence_and_never_a_traceback(copies, tmp_path):
    count, refused = campaign(tmp_path, SMALL, copies, 1, ("check", "sun"))
    assert (
        0.3 * count < refused < count
    )  # the campaign does corrupt, and does not refuse what can be read


@pytest.mark.long
def test_corrupted_results_are_refused_by_export(tmp_path):
    craft = six_faces(tmp_path, np.random.default_rng(0), n=10)
    few = "--max-rate-deg-s", 5, "--out", tmp_path / "rates"
    fine(sunspin("rates", craft.vehicle, craft.telemetry, *few))
    original = (tmp_path / "rates" / "rates.nc").read_bytes()
    refused = 0
    for i, kind in enumerate(BYTES):
        bad = shutil.copytree(tmp_path / "rates", tmp_path / f"bad{i}")
        (bad / "rates.nc").write_bytes(kind(original, np.random.default_rng(i)))
        words = ["export", bad, "--out", tmp_path / f"out{i}"]
        refused += fine_or_a_sentence(words, kind.__name__) == 2
    assert refused > 3


@pytest.mark.real_data
def test_corrupted_beacons_of_skcube_never_give_a_traceback(data_dir, tmp_path):
    for name in ("skcube_pwr.csv", "skcube_adcs.csv"):
        original = (data_dir / "skcube" / name).read_bytes()
        for i, kind in enumerate(BYTES + CELLS):
            bad = tmp_path / name
            bad.write_bytes(kind(original, np.random.default_rng(i)))
            fine_or_a_sentence(["check", "skcube", bad], f"{name}, {kind.__name__}")
