"""`sunspin outcomes`: a built-in case, a vehicle of one's own, results on disk, one sentence on errors."""

import json

import pytest
import xarray as xr
from test_cli import sunspin


def test_philae_to_files(tmp_path):
    out = tmp_path / "out"
    done = sunspin("outcomes", "philae", "--runs", 60, "--strategy", "off", "--strategy", "delay:600", "--out", out, "--json")
    told = json.loads(done.out)
    assert set(told["strategies"]) == {"off", "delay:600"} and told["not_told"] == ""
    assert {f"outcomes-{name}.nc" for name in ("off", "delay-600")} < {path.name for path in out.iterdir()}
    with xr.open_dataset(out / "strategies.nc", engine="h5netcdf") as table:
        value = table["value"].sel(strategy="off", quantity="touch_leg").item()
    assert value == told["strategies"]["off"]["touch_leg"]["value"]


def test_the_collision_against_the_trajectory_and_the_best_delay():
    done = sunspin("outcomes", "philae", "--runs", 200, "--strategy", "off", "--condition", "--best-delay", "--json")
    told = json.loads(done.out)
    assert abs(told["collision"]["facts"]["speed_before"] - 0.304) < 1e-4
    assert {line["name"] for line in told["collision"]["table"]} >= {"as drawn", "13 s before"}
    assert told["best_delay"]["delay_s"] in told["best_delay"]["as_good_s"]


def test_a_vehicle_without_legs_and_hull(tmp_path):
    sunspin("init", tmp_path / "mine")
    given = ("--omega", "0.1,0,0.2", "--sun", "0,0,1", "--after", 100, "--runs", 20)
    done = sunspin("outcomes", tmp_path / "mine" / "vehicle.toml", *given, "--collision-speed", 0.1, "--store", tmp_path / "rows")
    assert "r_z below -0.5" in done.out and "Without a hull and legs" in done.out
    assert (tmp_path / "rows" / "held").is_dir()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["philae", "--strategy", "sometimes"], "no wheel strategy of this name"),
        (["philae", "--scan", "nowhere.nc"], "there is no such file"),
        (["philae", "--vertical", "1,2"], "--vertical takes"),
        (["philae", "--omega", "1,2"], "--omega takes 3 numbers"),
        (["philae", "--after", "-5"], "after_s must be positive"),
        (["skcube", "--omega", "0,0,1"], "--sun is missing"),
    ],
)
def test_bad_input_is_one_sentence(arguments, text, tmp_path):
    assert text in sunspin("outcomes", *arguments, cwd=tmp_path, code=2).err
