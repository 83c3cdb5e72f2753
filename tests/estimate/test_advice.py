"""Each printed advice is followed literally and has the promised effect. All telemetry is synthetic."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from sunspin.environment.elements import parse_elements
from sunspin.environment.orbit import in_orbit
from sunspin.estimate.orbit import check as orbit_check
from sunspin.estimate.orbit.judged import judged_orbit
from sunspin.estimate.posterior import period as of_draws
from sunspin.estimate.rates import estimate
from sunspin.estimate.rates.alternatives import TORQUES_STRONGER
from sunspin.estimate.rates.finish import Pass
from sunspin.estimate.rates.motion import Body
from sunspin.estimate.rates.noise import HIGHER_NOISES
from sunspin.estimate.rates.result import _models, more_effort, slower
from sunspin.estimate.rates.start import coarse, finest
from sunspin.estimate.rates.state import Motion
from sunspin.estimate.terms.period import Period
from sunspin.output.check import orbit as check_words
from sunspin.telemetry.assess import assess
from sunspin.vehicle import Panel, Vehicle
from sunspin.vehicle.file import parse_vehicle
from sunspin.vehicle.sensors import Gyro, Sensors
from tests.support import satellite_files
from tests.support.orbit_cases import check_case
from tests.support.philae import philae_draws
from tests.support.simulate import cube_with_late_sensor, cube_with_sensor, fast_body
from validation import spinners

NORMALS = np.vstack([np.eye(3), -np.eye(3)])
CUBE = Vehicle(
    "cube",
    gain_unit="W",
    inertia_kg_m2=np.diag([0.02, 0.025, 0.03]),
    panels=[Panel(name, n, 1.0) for name, n in zip("abcdef", NORMALS, strict=True)],
)


def seen(omega, t, seed: int = 1, noise: float = 0.01, body: Vehicle = CUBE) -> xr.Dataset:
    """Powers of a cube that turns freely."""
    run = ss.propagate(body, omega, [0.6, 0.0, 0.8], None, t)
    power = ss.panel_power(CUBE, run["sun_B"].values) + noise * np.random.default_rng(seed).normal(
        size=(len(t), 6)
    )
    variables = {
        "power_W": (("time", "panel"), np.maximum(power, 0)),
        "flag": ("time", np.zeros(len(t), dtype=np.uint8)),
        "omega": run["omega_B"],
    }
    return xr.Dataset(
        variables,
        {"time": t, "panel": list("abcdef")},
        {"epoch_utc": "2026-01-01T00:00:00Z", "synthetic": 1},
    )


def printed(pattern: str, text: str) -> float:
    found = re.search(pattern, text)
    assert found is not None, text
    return float(found[1])


TIMES = np.cumsum(10 + 4 * np.random.default_rng(3).random(12))


def test_the_advice_to_raise_the_effort_completes_the_search():
    """A search cut short is complete with the effort that it names, and that is more than what was given."""
    data, setting = (
        seen([0.01, 0.012, -0.01], TIMES),
        {"max_rate_rad_s": 0.05, "acceleration_noise": 1e-5},
    )
    cut = ss.rates(CUBE, data, effort=1e-6, **setting)
    for text in (cut.attrs["verdict"], str(cut["why_not_decided"].values[0])):
        effort = printed(r"give more effort \(`--effort ([\d.e+]+)`\)", text)
        assert effort == 10.0
    assert not cut["search_complete"].values[0]
    done = ss.rates(CUBE, data, effort=effort, **setting)
    assert (
        done["search_complete"].values[0]
        and done["decided"].values[0]
        and "effort" not in done.attrs["verdict"]
    )
    assert printed(r"--effort ([\d.e+]+)", more_effort(20.0)) == 200.0


def test_the_advice_to_lower_the_largest_rate_makes_the_grid_of_starts_fine_enough():
    """With the rate that the sentence names the grid of starts is fine; with one a little larger it is not."""
    vehicle, data, _ = fast_body(60.0, np.random.default_rng(5), samples=5)
    from sunspin.estimate.rates.observe import observations

    o, motion = observations(vehicle, data)[0], Motion(Body.of(vehicle), 1e-5, 0.5)
    limit = np.radians(
        printed(r"faster than ([\d.]+) deg/s, give it as `--max-rate-deg-s`", slower(finest(o)))
    )
    assert (
        coarse(o, motion, 1.0) and not coarse(o, motion, limit) and coarse(o, motion, 1.02 * limit)
    )
    result = ss.rates(vehicle, data, max_rate_rad_s=1.0, acceleration_noise=1e-5, effort=1e-9)
    assert np.degrees(limit) == pytest.approx(
        printed(r"faster than ([\d.]+) deg/s, give it", result.attrs["verdict"]), rel=1e-3
    )
    assert "may be missing" in result.attrs["verdict"] and "coarse: if no rate" in str(
        result["why_not_decided"].values[0]
    )
    followed = ss.rates(vehicle, data, max_rate_rad_s=limit, acceleration_noise=1e-5, effort=1e-9)
    assert "missed" not in followed.attrs["verdict"] and "coarse" not in str(
        followed["why_not_decided"].values[0]
    )


@pytest.mark.long
def test_the_advice_to_state_the_zero_of_a_magnetometer_gives_right_rates(tmp_path):
    """docs/howto/orbit.md: a zero of a third of the field, taken for none, fits no motion; with its sigma the motion comes."""
    zero, faces = (0.2, -0.3, 0.25), ("-X", "+Y", "-Z", "+X")
    case = spinners.Case(
        5, 2, -6.0, 1, 1.0, faces, spinners.AS_MOUNTED, zero, True, 1.3, True, 0.1, 2.0, 150
    )
    true = np.array(spinners.make(case, tmp_path)["rates_deg_s"])
    written = (tmp_path / "vehicle.toml").read_text("utf-8")
    results = {}
    for sigma in ("", ", sigma = 10000"):
        (tmp_path / "vehicle.toml").write_text(
            re.sub("zero = .*", f"zero = {{ value = [0, 0, 0]{sigma} }}", written), "utf-8"
        )
        vehicle = ss.load_vehicle(tmp_path / "vehicle.toml")
        results[sigma] = ss.rates(vehicle, ss.read_telemetry(tmp_path / "telemetry.csv", vehicle))
    exact, open_zero = results.values()
    assert not exact["decided"].any() and open_zero["decided"].all()
    pull = np.radians(true) - open_zero["omega_B"].values
    pull /= np.sqrt(np.diagonal(open_zero["omega_cov_B"].values, axis1=1, axis2=2))
    assert np.abs(pull).max() < 4


@pytest.mark.parametrize("way", ["speed_rad_s", "speed_column", "left out"])
def test_the_advice_to_state_the_wheel_speed_removes_the_warning(way):
    data = seen([0.01, 0.012, -0.01], TIMES)
    wheel = ss.Wheel("w", [0, 1, 0], 3e-6)
    silent = ss.rates(replace(CUBE, wheels=(wheel,)), data, max_rate_rad_s=0.05, effort=1e-6)
    assert (
        "Give speed_rad_s or a speed_column, or remove the wheel if it is at rest"
        in silent.attrs["verdict"]
    )
    told = {
        "speed_rad_s": (replace(CUBE, wheels=(replace(wheel, speed_rad_s=0.01),)), data),
        "speed_column": (
            replace(CUBE, wheels=(wheel,)),
            data.assign(wheel_speed_rad_s=(("time", "wheel"), np.zeros((12, 1)))),
        ),
        "left out": (CUBE, data),
    }[way]
    result = ss.rates(*told, max_rate_rad_s=0.05, acceleration_noise=1e-5)
    assert result["decided"].values[0] and "WHEEL" not in result.attrs["verdict"], result[
        "why_not_decided"
    ].values


def test_the_advice_to_leave_a_sensor_out_gives_right_rates():
    """The gyro's zero is off by 3 deg/s; what is printed is the option of the command line."""
    from sunspin.cli.rates import SENSOR_VARIABLES

    data = seen([0.01, 0.012, -0.01], TIMES)
    gyro = (
        data["omega"].values
        + np.radians([3.0, -2.0, 2.5])
        + 1e-4 * np.random.default_rng(2).normal(size=(12, 3))
    )
    data = data.assign(gyro_B=(("time", "axis"), gyro))
    vehicle = replace(CUBE, sensors=Sensors(gyro=Gyro(("x", "y", "z"), 1.0, np.zeros(3), 5e-4)))
    bad = ss.rates(vehicle, data, max_rate_rad_s=0.1, acceleration_noise=1e-5, column_tests=True)
    assert not bad["decided"].values[0]
    found = re.search(r"`--without (\w+)` gives the rates of the others", bad.attrs["verdict"])
    assert found is not None, bad.attrs["verdict"]
    good = ss.rates(
        vehicle,
        data.drop_vars(SENSOR_VARIABLES[found[1]]),
        max_rate_rad_s=0.1,
        acceleration_noise=1e-5,
        column_tests=True,
    )
    assert good["decided"].values[0] and "--without" not in good.attrs["verdict"]
    assert np.abs(
        good["omega_mean_B"].values[0, 0] - data["omega"].values.mean(axis=0)
    ).max() < np.radians(0.1)


@pytest.mark.long
def test_the_advice_to_state_a_time_offset_removes_the_warning():
    data, run = cube_with_late_sensor("gyro", 5.3, np.random.default_rng(101))
    silent = ss.rates(cube_with_sensor("gyro", None), data, max_rate_rad_s=0.15)
    line = re.search(
        r"state (sensors_late_s = \{[^}]*\}) under \[clock\] of the vehicle file",
        silent.attrs["verdict"],
    )
    assert line is not None and "SEEM LATE" in silent.attrs["verdict"], silent.attrs["verdict"]
    clock = parse_vehicle(f'name = "a"\n[clock]\n{line[1]}\n', "a").sensors.clock
    stated = ss.rates(cube_with_sensor("gyro", clock), data, max_rate_rad_s=0.15)
    assert (
        "SEEM" not in stated.attrs["verdict"]
        and "late (vehicle file and data)" in stated.attrs["verdict"]
    )
    assert abs(stated.attrs["sensors_late_s"] - 5.3) < 3.5 * stated.attrs["sensors_late_sigma_s"]


def test_the_advice_of_check_to_set_the_scale_removes_the_warning(tmp_path):
    """Readings in W that the vehicle file takes for mW: the line that is named is replaced by what is printed."""
    from sunspin.output.check.files import describe_telemetry

    made = satellite_files.six_faces(tmp_path, np.random.default_rng(1))
    made.vehicle.write_text(
        made.vehicle.read_text().replace("[telemetry]", "[telemetry]\nscale = 0.001")
    )

    def wrong() -> list[str]:
        lines = describe_telemetry(
            ss.load_vehicle(made.vehicle), made.telemetry, str(made.vehicle)
        )[2]
        return [line for line in lines if "WRONG" in line]

    (said,) = wrong()
    found = re.search(r"set (scale = [\d.e-]+) under \[telemetry\], line (\d+)", said)
    assert found is not None, said
    text = made.vehicle.read_text("utf-8").splitlines()
    text[int(found[2]) - 1] = found[1]
    made.vehicle.write_text("\n".join(text), "utf-8")
    assert not wrong()


def in_an_orbit(data: xr.Dataset, given: tuple[str, str], **options):
    return in_orbit(
        parse_elements("\n".join(given), "twin"),
        data.attrs["epoch_utc"],
        data["time"].values,
        **options,
    )


def test_the_advice_to_reverse_the_matrix_of_the_magnetometer_makes_the_elements_fit(monkeypatch):
    monkeypatch.setattr(orbit_check, "COPIES", 10)
    vehicle, data, given, about = check_case(1, 1)
    orbit, wrong = (
        in_an_orbit(data, given, shift_sigma_s=about["sigma_s"]),
        data.assign(field_B=-data["field_B"]),
    )
    _, _, words = judged_orbit(orbit, vehicle, wrong)
    assert "HAS THE OPPOSITE SIGN: change the sign of `matrix`" in words
    part = vehicle.sensors.magnetometer
    turned = replace(
        vehicle, sensors=replace(vehicle.sensors, magnetometer=replace(part, matrix=-part.matrix))
    )
    used, _, words = judged_orbit(
        orbit, turned, wrong.assign(field_B=-wrong["field_B"])
    )  # as its columns are read now
    assert used is not None and "SIGN" not in words


def test_the_advice_to_widen_the_along_track_offset_makes_the_elements_fit(monkeypatch):
    monkeypatch.setattr(orbit_check, "COPIES", 10)
    vehicle, data, given, about = check_case(1, 1)
    found = {}
    for sigma in (abs(about["ahead_s"]) / 6, abs(about["ahead_s"])):
        found[sigma] = about_orbit_lines(
            vehicle, data, in_an_orbit(data, given, shift_sigma_s=sigma, shift_s=0.0)
        )
    narrow, wide = found.values()
    assert any("widen --tle-shift-sigma" in line for line in narrow), narrow
    assert not any("widen" in line for line in wide) and "elements consistent" in wide[0], wide


def about_orbit_lines(vehicle, data, orbit) -> list[str]:
    """What `check` says of an orbit."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(check_words, "orbit_of", lambda *_: orbit)
        return check_words.describe_orbit(assess(vehicle, data), None, None)[1]


def test_torques_of_most_passes_are_not_called_stronger_than_in_the_rest_of_the_file():
    def passes(*models: str) -> list[Pass]:
        nothing = Pass(*([None] * 7))
        return [nothing._replace(model=(model, 0.9)) for model in models]

    motion = Motion(Body.of(CUBE), 2e-5, 0.05)
    assert _models(passes(TORQUES_STRONGER, "as stated"), motion) == [TORQUES_STRONGER, "as stated"]
    for models in ((TORQUES_STRONGER,), (TORQUES_STRONGER, TORQUES_STRONGER, "as stated")):
        named = _models(passes(*models), motion)
        assert named[0] == "unknown torques stronger than 2e-05 rad/s^1.5"
        assert not any("rest" in name for name in named)


def test_a_decided_pass_gives_no_advice_on_the_inertia(monkeypatch):
    """A noise that is strong on the ladder and smaller once refined: the pass is decided, and the verdict says no other thing."""
    monkeypatch.setattr(estimate, "choose", lambda o, *_: (HIGHER_NOISES[0], o, "none"))
    sphere = replace(CUBE, inertia_kg_m2=np.eye(3))
    data = seen([0.01, 0.012, -0.01], TIMES, body=sphere)
    result = ss.rates(replace(sphere, inertia_kg_m2=None), data, max_rate_rad_s=0.05)
    asked = "GIVE ITS INERTIA" in result.attrs["verdict"]
    assert result.attrs["acceleration_noise"] < HIGHER_NOISES[0]
    assert bool(result["decided"].values[0]) is not asked


@pytest.mark.long
def test_the_advice_to_state_the_inertia_makes_the_pass_decided():
    """A long body of three units at 3.4 deg/s, 12 s between samples, seen by the Sun alone: of unknown inertia it is not decided,
    and with its own one, products of inertia included, it is, rightly."""
    inertia = [[0.0355, 0.0001, -0.0025], [0.0001, 0.0369, 0.0023], [-0.0025, 0.0023, 0.0065]]
    body = replace(CUBE, inertia_kg_m2=np.array(inertia))
    rng = np.random.default_rng(0)
    t, omega = np.cumsum(rng.uniform(10, 14, 42)), [0.0284, -0.03, 0.0431]
    run = ss.propagate(body, omega, [-0.898, 0.146, -0.416], None, t)
    power = ss.panel_power(body, run["sun_B"].values)
    power = np.maximum(power + 0.01 * rng.normal(size=power.shape), 0.0)
    data = seen(omega, t, body=body).assign(power_W=(("time", "panel"), power))
    sphere = ss.rates(replace(body, inertia_kg_m2=None), data)
    assert "GIVE ITS INERTIA" in sphere.attrs["verdict"] and not sphere["decided"].values[0]
    assert "give its inertia" in str(sphere["why_not_decided"].values[0])
    known = ss.rates(body, data)
    assert "INERTIA" not in known.attrs["verdict"] and known["decided"].values[0]
    truth = run["omega_B"].sel(time=known["time"].values).values.mean(axis=0)
    off = known["omega_mean_B"].values[0, 0] - truth
    assert np.abs(off / known["omega_sigma_all_B"].values[0]).max() < 4


def test_the_advice_to_draw_more_makes_periods_decisive(monkeypatch):
    """A period that few draws have: the same draws, and eight times as many, as `--draws` gives."""
    decided = {}
    for count in (4000, 32000):
        tree, _ = philae_draws(count, 0.01)
        values = np.stack([np.linspace(10, 20, count)] * 3, axis=1)
        monkeypatch.setattr(of_draws, "periods_of", lambda *_, values=values: values)
        of_draws.with_periods(ss.load_vehicle("philae"), tree, [Period(0.0, 14.0, 0.05)])
        decided[count] = of_draws.period_sentences(tree["period"].to_dataset())
    few, many = decided.values()
    assert "ask for more --draws" in few[0]
    assert len(many) == 2 and "with periods the angular speed" in many[1]
