"""Plans: the table counts what became of the simulated passes."""

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

from sunspin import planning
from sunspin.base.errors import InputError
from sunspin.cli import cli
from sunspin.estimate.synthetic import simulate_pass
from sunspin.output.kinds.plan import plan_figure, plan_summary
from sunspin.output.template import write_templates
from sunspin.planning import plan
from sunspin.telemetry.assess import assess
from sunspin.telemetry.synthetic import generator
from sunspin.vehicle.file import parse_vehicle
from tests.support.simulate import CUBE_WITHOUT_NOISE_STATED as CUBE

SPEED = 0.03


def answered(omega, sigma, decided=True):
    """Return what `rates` says of a pass with one solution, for the row of a plan."""
    one = ("pass_id", "solution")
    parts = {f"omega_{axis}": (one, [[omega[k]]]) for k, axis in enumerate("xyz")}
    parts |= {f"sigma_{axis}": (one, [[sigma]]) for axis in "xyz"}
    parts |= {
        "probability": (one, [[1.0]]),
        "decided": ("pass_id", [decided]),
        "why_not_decided": ("pass_id", ["" if decided else "several solutions"]),
        "pass_of": ("time", np.zeros(3, dtype=int)),
    }
    return xr.Dataset(parts, {"time": [0.0, 10.0, 20.0], "pass_id": [0]})


def test_of_a_pass_in_parts_the_one_with_the_most_samples_counts():
    simulated = simulate_pass(CUBE, np.arange(8) * 10.0, SPEED, generator(1, 0))
    right, off = answered(simulated.omega_B[5], 1e-3), answered(simulated.omega_B[5] + 0.1, 1e-3)
    both = xr.concat([off.drop_dims("time"), right.drop_dims("time")], "pass_id")
    t = simulated.telemetry["time"].values
    both = both.assign_coords(time=t, pass_id=[0, 1]).assign(pass_of=("time", [0] * 3 + [1] * 5))
    row = planning._row_of(both, simulated, 10.0, SPEED)
    assert row.decided and not row.wrong


@pytest.fixture
def undecided(monkeypatch):
    """Let no pass be decided, without an estimate."""
    monkeypatch.setattr(planning, "rates", lambda *_, **__: answered(np.zeros(3), 1.0, False))


def test_error_in_a_late_round_keeps_the_complete_ones(undecided, monkeypatch):
    calls = []

    def simulate(*arguments, **options):
        calls.append(1)
        if len(calls) > 3:
            raise InputError("no pass of this length is half in sunlight")
        return simulate_pass(*arguments, **options)

    monkeypatch.setattr(planning, "simulate_pass", simulate)
    result = plan(CUBE, [10.0], samples=3, max_rate_rad_s=0.05, passes=5)
    assert int(result["passes"].sum()) == 5
    assert any("in sunlight" in why for why in result["pass_why"].values)


@pytest.mark.parametrize(("off", "wrong"), [(0.0, False), (0.02, True)])
def test_decided_rate_far_from_the_truth_counts_as_wrong(monkeypatch, off, wrong):
    truth = {}

    def simulate(*arguments, **options):
        simulated = simulate_pass(*arguments, **options)
        truth["omega"] = simulated.omega_B
        return simulated

    right = lambda *_, **__: answered(truth["omega"][1] + [off, 0.0, 0.0], 1e-3)  # noqa: E731
    monkeypatch.setattr(planning, "rates", right)
    monkeypatch.setattr(planning, "simulate_pass", simulate)
    result = plan(CUBE, [10.0], samples=3, max_rate_rad_s=0.05, passes=3)
    assert result["decided"].values.sum() == 3
    assert result["decided_wrong"].values.sum() == (3 if wrong else 0)
    assert np.isfinite(result["rate_sigma"].values).sum() == (0 if wrong else 3)


def test_speeds_of_three_rounds_lie_in_the_three_classes(undecided):
    rounds, options = [], {"samples": 3, "max_rate_rad_s": 0.05, "passes": 3}
    result = plan(CUBE, [60.0, 10.0, 10.0], after_round=rounds.append, **options)
    assert result["every"].values.tolist() == [10.0, 60.0]
    assert (result["passes"].values == 1).all()
    assert [int(one["passes"].sum()) for one in rounds] == [2, 4, 6]
    assert rounds[0]["passes"].values[:, 1].tolist() == [1, 1]  # the middle class first
    assert (result["why_not_decided"].values == "several solutions").all()
    again = plan(CUBE, [10.0, 60.0], **options)
    xr.testing.assert_identical(result, again)


def test_relative_gains_are_known_in_a_plan_though_one_pass_does_not_show_every_panel(monkeypatch):
    """Whether they are placeholders is judged by all passes of a file."""
    panels = "".join(
        f'[[panel]]\nname = "{name}"\nnormal_B = {normal}\nrelative_gain = 1.0\n'
        for name, normal in {
            "+X": [1, 0, 0],
            "-X": [-1, 0, 0],
            "+Y": [0, 1, 0],
            "+Z": [0, 0, 1],
        }.items()
    )
    seen = []

    def rates(vehicle, telemetry, **_):
        seen.append(assess(vehicle, telemetry).doubtful_gains)
        return answered(np.zeros(3), 1.0, False)

    monkeypatch.setattr(planning, "rates", rates)
    plan(parse_vehicle(f'name = "a"\n{panels}', "test"), [10.0], samples=4, max_rate_rad_s=0.01)
    assert len(seen) == 9 and not any(seen)


def test_interrupted_plan_keeps_the_complete_rounds(monkeypatch):
    """A pass that `rates` refuses is not decided for that reason."""
    calls = []

    def rates(*_, **__):
        calls.append(1)
        if len(calls) == 6:
            raise KeyboardInterrupt
        raise InputError("no rate explains the samples")

    monkeypatch.setattr(planning, "rates", rates)
    result = plan(CUBE, [10.0, 60.0], samples=3, max_rate_rad_s=0.05, passes=5)
    assert int(result["passes"].sum()) == 4
    assert result.attrs["interrupted"] == 1
    assert "Interrupted" in str(plan_summary(result))
    assert "no rate explains" in str(result["why_not_decided"].values[0, 1])
    assert [text.get_text() for text in plan_figure(result).axes[1].texts] == [
        "no right decided rate"
    ]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"every_s": []}, "intervals"),
        ({"every_s": [-1.0]}, "intervals"),
        ({"every_s": [float("nan")]}, "intervals"),
        ({"samples": 2}, "three samples"),
        ({"passes": 0}, "at least one pass"),
        ({"bits": 40}, "1 to 32 bits"),
        ({"max_rate_rad_s": 0.0}, "must be positive"),
    ],
)
def test_arguments_that_make_no_sense_are_refused(changes, words):
    given = {"every_s": [10.0], "max_rate_rad_s": 0.05} | changes
    with pytest.raises(InputError, match=words):
        plan(CUBE, **given)


def test_command_writes_table_passes_and_figure_and_shows_the_first_round(
    tmp_path, undecided, monkeypatch
):
    """The name of the vehicle may have signs of a formula."""
    monkeypatch.chdir(tmp_path)
    write_templates(tmp_path)
    text = (tmp_path / "vehicle.toml").read_text("utf-8").replace('"my satellite"', '"a $^$ b"')
    (tmp_path / "vehicle.toml").write_text(text, "utf-8")
    words = "plan vehicle.toml --every 10,60 --samples 3 --passes 2 --workers 1 --out beacons"
    done = CliRunner().invoke(cli, words.split())
    assert done.exit_code == 0, done.output
    # its columns are aligned
    assert "round 1 of 2\n    every   speed, deg/s  passes" in done.stderr
    assert "several solutions" in done.stdout
    error = CliRunner().invoke(cli, ["plan", "vehicle.toml", "--every", "often"]).exception
    assert "--every takes intervals in s, such as 10,30,60 (found often)" in str(error)
    table = (tmp_path / "beacons" / "plan.csv").read_text(encoding="utf-8")
    assert table.splitlines()[0].startswith("every_s,speed_from_deg_s") and "a $^$ b" in text
    assert (tmp_path / "beacons" / "plan.png").exists()
    assert (tmp_path / "beacons" / "plan_passes.csv").exists()
    summary = (tmp_path / "beacons" / "summary.json").read_text("utf-8")
    assert summary.count("ynthetic telemetry.") <= 1


def test_plan_leaves_out_the_orbit_of_the_vehicle_file_on_request(tmp_path, monkeypatch):
    orbits = []

    def refuse(*_, orbit, **__):
        orbits.append(len(orbit))
        raise InputError("no further")

    monkeypatch.setattr(planning, "plan", refuse)
    monkeypatch.chdir(tmp_path)
    write_templates(tmp_path)
    file = tmp_path / "vehicle.toml"
    text = file.read_text("utf-8").replace("# [orbit]", "[orbit]").replace("# tle =", "tle =")
    file.write_text(text, "utf-8")
    for words in ("plan vehicle.toml", "plan vehicle.toml --no-orbit"):
        assert "no further" in str(CliRunner().invoke(cli, words.split()).exception)
    assert orbits == [1, 0]
    done = CliRunner().invoke(cli, ["plan", "vehicle.toml", "--no-orbit", "--tle", "my.tle"])
    assert "--no-orbit contradicts" in str(done.exception)


@pytest.mark.long
def test_slow_body_with_dense_beacons_is_decided_and_right():
    result = plan(CUBE, [10.0], samples=12, max_rate_rad_s=0.02, passes=3, seed=1)
    assert result["decided_wrong"].values.sum() == 0
    assert result["decided"].values.sum() >= 2
