"""Plans: simulated passes have the motion, light and steps that they claim, and the table counts what became of them."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import sunspin as ss
from sunspin import planning
from sunspin.base.errors import InputError
from sunspin.cli import cli
from sunspin.environment.elements import parse_elements
from sunspin.environment.ephemeris import read_orbit
from sunspin.output.kinds.plan import plan_summary
from sunspin.output.template import write_templates
from sunspin.planning import PassSetup, SimulatedPass, plan, simulate_pass
from sunspin.telemetry.synthetic import generator
from tests.support.orbits import EPOCH, place_and_speed, two_line_elements
from tests.support.simulate import CUBE_WITHOUT_NOISE_STATED as CUBE

SPEED = 0.03


def setup(**changes):
    """Return passes of a cube with twelve samples at up to 3 deg/s."""
    return PassSetup(**{"vehicle": CUBE, "samples": 12, "max_rate_rad_s": np.radians(3)} | changes)


def elements():
    """Return the elements of a low orbit."""
    return parse_elements("\n".join(two_line_elements(np.random.default_rng(4))), "test")


def table_of_positions(tmp_path, hours):
    """Return a table of positions of that orbit, so many hours long, a line a minute."""
    t = np.arange(0, hours * 3600 + 1, 60.0)
    place, _ = place_and_speed(two_line_elements(np.random.default_rng(4)), t)
    times = np.datetime64(EPOCH) + (1000 * t).astype("timedelta64[ms]")
    lines = [f"{u}Z,{x},{y},{z}" for u, (x, y, z) in zip(times, place.tolist(), strict=True)]
    path = tmp_path / "positions.csv"
    path.write_text(
        "\n".join(["# frame: TEME", "time_utc,x_km,y_km,z_km", *lines]) + "\n", encoding="utf-8"
    )
    return read_orbit(path)


def answered(omega, sigma, decided=True):
    """Return what `rates` says of a pass with one solution, for the row of a plan."""
    parts = {
        f"omega_{axis}": (("pass_id", "solution"), [[omega[k]]]) for k, axis in enumerate("xyz")
    }
    parts |= {f"sigma_{axis}": (("pass_id", "solution"), [[sigma]]) for axis in "xyz"}
    return xr.Dataset(
        parts
        | {
            "probability": (("pass_id", "solution"), [[1.0]]),
            "decided": ("pass_id", [decided]),
            "why_not_decided": ("pass_id", ["" if decided else "several solutions"]),
            "pass_of": ("time", np.zeros(3, dtype=int)),
        },
        coords={"time": [0.0, 10.0, 20.0], "pass_id": [0]},
    )


def test_simulated_pass_has_the_speed_and_conserves_energy():
    simulated = simulate_pass(setup(), 10.0, SPEED, generator(1, 0))
    omega = simulated.omega_B
    assert np.linalg.norm(omega[0]) == pytest.approx(SPEED, rel=1e-12)
    energy = np.einsum("ni,ij,nj->n", omega, np.array(CUBE.inertia_kg_m2), omega)
    assert np.allclose(energy, energy[0], rtol=1e-7)
    assert simulated.telemetry.attrs["synthetic"] == 1


def test_readings_follow_the_true_sun_within_gains_noise_and_earth_light():
    off = []
    for seed in range(20):
        telemetry = simulate_pass(setup(), 10.0, SPEED, generator(seed, 0)).telemetry
        exact = ss.panel_power(CUBE, telemetry["true_sun_B"].values)
        off.append(telemetry[CUBE.telemetry.quantity].values - exact)
    off = np.concatenate(off) / exact.max()
    assert np.abs(off).max() < planning.EARTH_LIGHT[1] + 5 * (planning.GAIN_ERROR + planning.NOISE)
    assert np.std(off) > planning.NOISE / 2


def test_readings_of_a_converter_are_multiples_of_its_step():
    read = simulate_pass(setup(bits=5), 10.0, SPEED, generator(1, 0)).telemetry
    values = read[CUBE.telemetry.quantity].values
    full = ss.panel_power(CUBE, CUBE.panel_normals_B).max()
    steps = values / (1.2 * full / 31)
    assert np.allclose(steps, np.round(steps), atol=1e-9)
    assert len(np.unique(values)) > 3


def test_pass_in_orbit_has_no_sun_in_the_shadow_of_the_earth():
    dark = 0
    for seed in range(6):
        one = simulate_pass(setup(orbit=elements(), samples=30), 60.0, SPEED, generator(seed, 0))
        here = one.environment.at(one.telemetry["time"].values)
        power = one.telemetry[CUBE.telemetry.quantity].values
        full = ss.panel_power(CUBE, CUBE.panel_normals_B).max()
        assert (here.lit > 0.5).mean() >= planning.LEAST_SUNLIT
        shadow = here.lit == 0
        dark += shadow.sum()
        # the night side of the Earth gives no light: what is left is noise
        night = shadow & (np.linalg.norm(here.albedo_light_N, axis=1) < 1e-3)
        assert (power[night] < 6 * planning.NOISE * full).all()
    assert dark > 0


def test_passes_lie_within_a_short_table_of_positions(tmp_path):
    orbit = table_of_positions(tmp_path, 3)
    for seed in range(8):
        one = simulate_pass(setup(orbit=orbit), 60.0, SPEED, generator(seed, 0))
        assert one.environment is not None
    with pytest.raises(InputError, match="shorter than a pass"):
        simulate_pass(setup(orbit=orbit, samples=300), 60.0, SPEED, generator(0, 0))


def test_noise_is_its_part_of_full_sun_also_if_gains_are_relative():
    """The noise of a file is in ampere, relative gains have no unit: full Sun must come out of the noise."""
    panels = tuple(replace(panel, gain=1.0) for panel in CUBE.panels)
    form = replace(CUBE.telemetry, noise=0.01)
    relative = replace(CUBE, panels=panels, gain_unit=None, telemetry=form)
    off = []
    for seed in range(10):
        one = simulate_pass(setup(vehicle=relative), 10.0, SPEED, generator(seed, 0)).telemetry
        off.append(one[form.quantity].values.max())
    full = 0.01 / planning.NOISE
    assert 0.6 * full < np.median(off) < 1.3 * full


def test_of_a_pass_in_parts_the_one_with_the_most_samples_counts():
    simulated = simulate_pass(setup(samples=8), 10.0, SPEED, generator(1, 0))
    right, off = answered(simulated.omega_B[5], 1e-3), answered(simulated.omega_B[5] + 0.1, 1e-3)
    both = xr.concat([off.drop_dims("time"), right.drop_dims("time")], "pass_id")
    t = simulated.telemetry["time"].values
    both = both.assign_coords(time=t, pass_id=[0, 1]).assign(pass_of=("time", [0] * 3 + [1] * 5))
    row = planning._row_of(both, simulated, 10.0, SPEED)
    assert row.decided and not row.wrong


def test_error_in_a_late_round_keeps_the_complete_ones(monkeypatch):
    calls = []

    def simulate(*arguments):
        calls.append(1)
        if len(calls) > 3:
            raise InputError("no pass of this length is half in sunlight")
        return simulate_pass(*arguments)

    monkeypatch.setattr(planning, "rates", lambda *_, **__: answered(np.zeros(3), 1.0, False))
    monkeypatch.setattr(planning, "simulate_pass", simulate)
    result = plan(CUBE, [10.0], samples=3, max_rate_rad_s=0.05, passes=5)
    assert int(result["passes"].sum()) == 5
    assert any("in sunlight" in why for why in result["pass_why"].values)


def test_name_with_signs_of_a_formula_does_not_stop_the_figure(monkeypatch, tmp_path):
    monkeypatch.setattr(planning, "rates", lambda *_, **__: answered(np.zeros(3), 1.0, False))
    named = replace(CUBE, name="a $^$ b")
    result = plan(named, [10.0], samples=3, max_rate_rad_s=0.05, passes=1)
    result.sunspin.save(tmp_path / "out")
    text = (tmp_path / "out" / "summary.json").read_text("utf-8")
    assert text.count("ynthetic telemetry.") <= 1


@pytest.mark.parametrize(("off", "wrong"), [(0.0, False), (0.02, True)])
def test_decided_rate_far_from_the_truth_counts_as_wrong(monkeypatch, off, wrong):
    def rates(vehicle, telemetry, **_):
        return answered(truth["omega"][1] + [off, 0.0, 0.0], 1e-3)

    truth = {}

    def simulate(*arguments):
        one = simulate_pass(*arguments)
        truth["omega"] = one.omega_B
        return SimulatedPass(*one)

    monkeypatch.setattr(planning, "rates", rates)
    monkeypatch.setattr(planning, "simulate_pass", simulate)
    result = plan(CUBE, [10.0], samples=3, max_rate_rad_s=0.05, passes=3)
    assert result["decided"].values.sum() == 3
    assert result["decided_wrong"].values.sum() == (3 if wrong else 0)
    assert np.isfinite(result["rate_sigma"].values).sum() == (0 if wrong else 3)


def test_speeds_of_three_rounds_lie_in_the_three_classes(monkeypatch):
    monkeypatch.setattr(planning, "rates", lambda *_, **__: answered(np.zeros(3), 1.0, False))
    rounds = []
    result = plan(
        CUBE,
        [60.0, 10.0, 10.0],
        samples=3,
        max_rate_rad_s=0.05,
        passes=3,
        after_round=rounds.append,
    )
    assert result["every"].values.tolist() == [10.0, 60.0]
    assert (result["passes"].values == 1).all()
    assert [int(one["passes"].sum()) for one in rounds] == [2, 4, 6]
    assert rounds[0]["passes"].values[:, 1].tolist() == [1, 1]  # the middle class first
    assert (result["why_not_decided"].values == "several solutions").all()
    again = plan(CUBE, [10.0, 60.0], samples=3, max_rate_rad_s=0.05, passes=3)
    xr.testing.assert_identical(result, again)


def test_interrupted_plan_keeps_the_complete_rounds(monkeypatch):
    calls = []

    def rates(*_, **__):
        calls.append(1)
        if len(calls) == 6:
            raise KeyboardInterrupt
        return answered(np.zeros(3), 1.0, False)

    monkeypatch.setattr(planning, "rates", rates)
    result = plan(CUBE, [10.0, 60.0], samples=3, max_rate_rad_s=0.05, passes=5)
    assert int(result["passes"].sum()) == 4
    assert result.attrs["interrupted"] == 1
    assert "Interrupted" in str(plan_summary(result))


def test_pass_that_rates_refuses_is_not_decided_for_that_reason(monkeypatch):
    def rates(*_, **__):
        raise InputError("no rate explains the samples")

    monkeypatch.setattr(planning, "rates", rates)
    result = plan(CUBE, [10.0], samples=3, max_rate_rad_s=0.05, passes=1)
    assert "no rate explains" in str(result["why_not_decided"].values[0, 1])


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


def test_command_writes_table_passes_and_figure_and_shows_the_first_round(tmp_path, monkeypatch):
    monkeypatch.setattr(planning, "rates", lambda *_, **__: answered(np.zeros(3), 1.0, False))
    monkeypatch.chdir(tmp_path)
    write_templates(tmp_path)
    words = "plan vehicle.toml --every 10,60 --samples 3 --passes 2 --workers 1 --out beacons"
    done = CliRunner().invoke(cli, words.split())
    assert done.exit_code == 0, done.output
    assert "round 1 of 2" in done.stderr
    assert "several solutions" in done.stdout
    table = (tmp_path / "beacons" / "plan.csv").read_text(encoding="utf-8")
    assert table.splitlines()[0].startswith("every_s,speed_from_deg_s")
    assert (tmp_path / "beacons" / "plan.png").exists()
    assert (tmp_path / "beacons" / "plan_passes.csv").exists()


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
