"""Plans: simulated passes have the motion, light and steps that they claim, and the table counts what became of them."""

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import sunspin as ss
from sunspin import planning
from sunspin.base.errors import InputError
from sunspin.cli import cli
from sunspin.environment.elements import parse_elements
from sunspin.output.kinds.plan import plan_summary
from sunspin.output.template import write_templates
from sunspin.planning import PassSetup, SimulatedPass, plan, simulate_pass
from sunspin.telemetry.synthetic import generator
from tests.support.orbits import two_line_elements
from tests.support.simulate import CUBE_WITHOUT_NOISE_STATED as CUBE

SPEED = 0.03


def setup(**changes):
    """Return passes of a cube with twelve samples at up to 3 deg/s."""
    return PassSetup(**{"vehicle": CUBE, "samples": 12, "max_rate_rad_s": np.radians(3)} | changes)


def elements():
    """Return the elements of a low orbit."""
    return parse_elements("\n".join(two_line_elements(np.random.default_rng(4))), "test")


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


@pytest.mark.long
def test_slow_body_with_dense_beacons_is_decided_and_right():
    result = plan(CUBE, [10.0], samples=12, max_rate_rad_s=0.02, passes=3, seed=1)
    assert result["decided_wrong"].values.sum() == 0
    assert result["decided"].values.sum() >= 2
