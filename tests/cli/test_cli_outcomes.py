"""`sunspin outcomes`: a built-in case, a user's vehicle, results on disk, one sentence on errors."""

import json

import pytest
import xarray as xr

from tests.support.commands import sunspin

pytestmark = pytest.mark.usefixtures("undrawn")


def test_outcomes_of_philae_are_written_to_files(tmp_path):
    out = tmp_path / "out"
    words = "outcomes philae --runs 60 --strategy off --strategy delay:600 --json --out".split()
    told = json.loads(sunspin(*words, out).out)
    assert set(told["strategies"]) == {"off", "delay:600"} and told["not_told"] == ""
    written = {path.name for path in out.iterdir()}
    assert {f"outcomes-{name}.nc" for name in ("off", "delay-600")} < written
    with xr.open_dataset(out / "strategies.nc", engine="h5netcdf") as table:
        value = table["value"].sel(strategy="off", quantity="touch_leg").item()
    assert value == told["strategies"]["off"]["touch_leg"]["value"]


def test_outcomes_print_the_collision_next_to_the_trajectory_kernel():
    words = "outcomes philae --runs 200 --strategy off --condition --json".split()
    told = json.loads(sunspin(*words).out)
    assert abs(told["collision"]["facts"]["speed_before"] - 0.304) < 1e-4
    assert {line["name"] for line in told["collision"]["table"]} >= {"as drawn", "13 s before"}


def test_outcomes_of_a_vehicle_without_legs_and_hull_lack_the_contact(tmp_path):
    sunspin("init", tmp_path / "mine")
    given = "--omega-deg-s 6,0,12 --sun 0,0,1 --after 100 --runs 20 --collision-speed 0.1 --store"
    vehicle = tmp_path / "mine" / "vehicle.toml"
    done = sunspin("outcomes", vehicle, *given.split(), tmp_path / "rows")
    assert "r_z below -0.5" in done.out and "Without a hull and legs" in done.out
    assert (tmp_path / "rows" / "held").is_dir()


WHEELS = {"wx": [1, 0, 0], "wz": [0, 0, 1]}
TIPS = {"a": [1, 0, -0.6], "b": [-0.5, 0.9, -0.6], "c": [-0.5, -0.9, -0.6]}
FRICTION = "{ coulomb_N_m = 2e-3, viscous_N_m_s = 1e-5 }"
LANDER = "\n".join(
    [
        'name = "two wheels and legs"\n[body]\nmass_kg = 60\ninertia_kg_m2 = [[12, 0, 0], [0, 14, 0], [0, 0, 10]]',
        *(
            f'[[wheel]]\nname = "{name}"\naxis_B = {axis}\ninertia_kg_m2 = 0.02\nspeed_rad_s = 300\nfriction = {FRICTION}'
            for name, axis in WHEELS.items()
        ),
        *(f'[[leg]]\nname = "{name}"\ntip_B_m = {tip}' for name, tip in TIPS.items()),
    ]
)


def test_outcomes_without_collision_hull_and_antenna_print_only_what_is_known(tmp_path):
    """No rate before or after a collision that there is not, no panel that touches."""
    (tmp_path / "lander.toml").write_text(LANDER)
    given = "--omega-deg-s 3,0,6 --sun 0,0,1 --after 600 --collision-speed 0 --runs 40".split()
    done = sunspin("outcomes", tmp_path / "lander.toml", *given, "--strategy", "held")
    assert "There is no collision" in done.out and "before the collision" not in done.out
    assert "a leg touches first: 1.000 ±" in done.out
    assert "a panel touches" not in done.out
    assert "the bare body" not in done.out


def test_wheels_without_friction_are_named_where_a_motor_is_switched_off(tmp_path):
    """A wheel whose friction is forgotten would make `off` look like `held`."""
    (tmp_path / "lander.toml").write_text(LANDER.replace(f"friction = {FRICTION}", ""))
    given = "--omega-deg-s 3,0,6 --sun 0,0,1 --after 600 --collision-speed 0 --runs 40".split()
    words = "Without friction in the vehicle file (wheel wx, wz)"
    for strategy, named in (("off", True), ("delay:60", True), ("held", False)):
        done = sunspin("outcomes", tmp_path / "lander.toml", *given, "--strategy", strategy)
        assert (words in done.out) is named
    (tmp_path / "lander.toml").write_text(LANDER)
    assert "friction" not in sunspin("outcomes", tmp_path / "lander.toml", *given).out


def test_bad_input_of_outcomes_is_refused_in_one_sentence(tmp_path):
    for line, text in (
        ("philae --strategy sometimes", "no wheel strategy of this name"),
        ("philae --scan nowhere.nc", "there is no such file"),
        ("philae --vertical 1,2", "--vertical takes"),
        ("philae --omega-deg-s 60,120", "--omega-deg-s takes 3 numbers"),
        ("philae --after -5", "after_s must be positive"),
        ("skcube --omega-deg-s 0,0,60", "--sun X,Y,Z and --after SECONDS are missing"),
    ):
        assert text in sunspin("outcomes", *line.split(), cwd=tmp_path, code=2).err


def test_the_timeline_next_to_a_vehicle_file_is_read(tmp_path):
    """`sunspin reproduce` writes both: a collision ten minutes later gives other times, and a damaged file one sentence."""
    from sunspin.cases import load_case
    from sunspin.landing.scenario import case_scenario

    folder = load_case("philae").folder
    wanted = ("--runs", 20, "--strategy", "off", "--json", "--out")
    for name in ("vehicle.toml", "timeline.toml"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())

    def scenario(vehicle, out):
        sunspin("outcomes", vehicle, *wanted, tmp_path / out)
        with xr.open_dataset(tmp_path / out / "outcomes-off.nc", engine="h5netcdf") as runs:
            return json.loads(runs.attrs["scenario"])

    own = vars(case_scenario(load_case("philae")))
    text = (tmp_path / "timeline.toml").read_text("utf-8")
    assert '"2014-11-12T16:20:00"' in text
    moved = text.replace('"2014-11-12T16:20:00"', '"2014-11-12T16:30:00"')
    (tmp_path / "timeline.toml").write_text(moved, "utf-8")
    later = scenario(tmp_path / "vehicle.toml", "later")
    moved_by = [later[key] - own[key] for key in ("before_s", "after_s")]
    assert moved_by == pytest.approx([600, -600], abs=1e-6)
    no_list = text.replace("utc = ", "utc = [") + "]"
    for damaged in ("event = 3", "epoch_utc = 3\nevent = 3", no_list, "", "\0"):
        (tmp_path / "timeline.toml").write_text(damaged, "utf-8")
        words = "outcomes", tmp_path / "vehicle.toml", *wanted, tmp_path / "never"
        assert "timeline.toml" in sunspin(*words, code=2).err


def test_times_of_outcomes_come_from_the_timeline_of_the_vehicle(tmp_path):
    sunspin("init", tmp_path / "mine")
    event = '[[event]]\nname = "{}"\nutc = "2026-01-01T00:0{}:00Z"\nsource = "ours"\n'
    events = event.format("collision", 1) + event.format("second_touchdown", 5)
    text = 'epoch_utc = "2026-01-01T00:00:00Z"\n' + events
    (tmp_path / "mine" / "timeline.toml").write_text(text, "utf-8")
    given = ("--omega-deg-s", "6,0,12", "--sun", "0,0,1", "--runs", 20, "--collision-speed", 0)
    sunspin("outcomes", tmp_path / "mine" / "vehicle.toml", *given, "--out", tmp_path / "out")
    with xr.open_dataset(tmp_path / "out" / "outcomes-off.nc", engine="h5netcdf") as runs:
        assert json.loads(runs.attrs["scenario"])["after_s"] == pytest.approx(240.0, abs=1e-9)
