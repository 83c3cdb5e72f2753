"""Sunlight in the Earth's shadow refuses elements or clock; right orbits, noise, frozen readings and an offset do not.

Telemetry of panels alone, in orbits of `tests/support/orbits.py`, whose SGP4, Sun and cylinder of shadow are not the package's.
"""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner
from scipy.spatial.transform import Rotation
from sgp4.api import Satrec, jday

import sunspin as ss
from sunspin.cli import cli
from sunspin.environment.elements import parse_elements
from sunspin.environment.orbit import in_orbit
from sunspin.estimate.orbit.check import Verdict, check_orbit
from sunspin.estimate.orbit.judged import judged_orbit
from sunspin.estimate.orbit.shadow import FEW, clear_sun, sun_in_shadow
from sunspin.estimate.settings import ORBIT
from sunspin.telemetry.assess import assess
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from sunspin.vehicle.sensors import Sensors, SunSensor
from tests.support.orbit_cases import with_few_copies
from tests.support.orbits import EARTH_KM, EPOCH, sun_of_date, two_line_elements, with_check_digit
from tests.support.simulate import telemetry_of
from tests.support.vehicles import CUBE_NORMALS, unit_vector

SEEDS = (0, 1, 5)
"""Orbits whose shadows last 10, 35 and 15 minutes."""


RELATIVE = Vehicle("cube", panels=[Panel(f"p{j}", n, 1.0) for j, n in enumerate(CUBE_NORMALS)])
CUBE = replace(RELATIVE, gain_unit="W", telemetry=TelemetryForm(noise=0.01))


class Flight:
    """An orbit, and what the cube reads along it at times in s from its epoch."""

    def __init__(self, seed: int, step_s: float = 30.0) -> None:
        self.rng = np.random.default_rng(seed)
        self.given = two_line_elements(self.rng)
        self.t = np.arange(0.0, 5700.0, step_s)

    def sky(self, late_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the Sun's direction (n, 3), whether it is up (n) and the ground below lit (n), `late_s` after the times."""
        day, fraction = jday(EPOCH.year, EPOCH.month, EPOCH.day, EPOCH.hour, 0, 0)
        fraction = fraction + (self.t + late_s) / 86400
        _, place, _ = Satrec.twoline2rv(*self.given).sgp4_array(np.full(len(self.t), day), fraction)
        sun = sun_of_date(day - 2451545.0 + fraction)
        along = (place * sun).sum(axis=1)
        away = np.linalg.norm(place - along[:, None] * sun, axis=1)
        return sun, (along > 0) | (away > EARTH_KM), along > 0

    def telemetry(self, late_s: float = 0.0, albedo: float = 0.1) -> xr.Dataset:
        """Return readings whose times are behind the true ones by `late_s`."""
        sun, self.lit, day = self.sky(late_s)
        spin = np.radians(3.0) * unit_vector(self.rng)
        first = Rotation.random(random_state=int(self.rng.integers(2**31)))
        sun_B = (Rotation.from_rotvec(self.t[:, None] * spin) * first).apply(sun)
        power = np.maximum(sun_B @ CUBE_NORMALS.T, 0) * self.lit[:, None]
        power += albedo * self.rng.uniform(size=power.shape) * day[:, None]
        return self.dataset(power + 0.01 * self.rng.normal(size=power.shape))

    def dataset(self, power: np.ndarray) -> xr.Dataset:
        """Return readings (n, 6) as telemetry."""
        data = telemetry_of(CUBE, self.t[: len(power)], np.maximum(power, 0))
        return data.assign_attrs(epoch_utc=EPOCH.isoformat() + "Z", synthetic=1)

    def orbit(self, **options):
        """Return the environment of the orbit's own elements."""
        elements = parse_elements("\n".join(self.given), "flight")
        return in_orbit(elements, EPOCH.isoformat() + "Z", self.t, **options)

    def against(self, data, vehicle=CUBE, **options):
        """Return what the check of the shadow says of telemetry."""
        return sun_in_shadow(self.orbit(**options), assess(vehicle, data), ORBIT.span)


@pytest.mark.parametrize("late_s", [10.0, -10.0])
def test_right_elements_with_a_clock_off_by_seconds_do_not_contradict_the_light(late_s):
    for seed, step_s in ((0, 20.0), (1, 5.0)):
        flight = Flight(seed, step_s=step_s)
        data = flight.telemetry(late_s, albedo=0.3)
        assert not flight.against(data).samples
        assert clear_sun(assess(CUBE, data))[1].sum() > 100


@pytest.mark.parametrize("late_s", [-1500.0, -400.0, 400.0, 1500.0])
def test_a_clock_off_by_minutes_is_contradicted_and_its_least_error_given(late_s):
    for seed in SEEDS:
        flight = Flight(seed)
        against = flight.against(flight.telemetry(late_s))
        shadow = ~flight.sky(0.0)[1]
        in_sun = int((shadow & flight.lit).sum())
        assert FEW < against.samples <= min(in_sun, against.of)
        # the times are behind the true ones by `late_s`
        least_s = against.behind_s if late_s > 0 else against.ahead_s
        assert 0 < abs(late_s) - least_s < 280 and against.beyond_s <= least_s
        assert ("behind UTC" in str(against)) is (late_s > 0)


def test_an_offset_within_the_prior_is_not_contradicted():
    flight = Flight(1)
    data = flight.telemetry(400.0)
    assert flight.against(data).samples
    assert not flight.against(data, shift_sigma_s=400.0 / ORBIT.span).samples
    assert not flight.against(data, clock_s=400.0).samples
    assert not flight.against(data, shift_s=400.0).samples
    orbit = replace(flight.orbit(), middle_jd=flight.orbit().middle_jd - 20, drift_sigma_s_day=10.0)
    assert not sun_in_shadow(orbit, assess(CUBE, data), ORBIT.span).samples


def test_four_sunlit_samples_in_shadow_contradict_and_three_do_not():
    flight = Flight(1)
    power = flight.telemetry(0.0)["power_W"].values
    dark, bright = np.flatnonzero(~flight.lit), power[np.flatnonzero(flight.lit)]
    middle = len(dark) // 2
    for count in (FEW, FEW + 1):
        changed = power.copy()
        changed[dark[middle : middle + count]] = bright[:count]
        assert flight.against(flight.dataset(changed)).samples == (count if count > FEW else 0)


def test_stray_light_noise_and_frozen_readings_contradict_nothing():
    flight = Flight(1)
    day = flight.telemetry(0.0)["power_W"].values
    dark, n = np.flatnonzero(~flight.lit), len(CUBE_NORMALS)
    weak = 0.3 * day[flight.lit][: len(dark)]
    for values in (day[flight.lit][-1], np.full(n, 0.6), weak, np.eye(n)[0] * 5.0):
        changed = day.copy()
        changed[dark] = values
        assert not flight.against(flight.dataset(changed)).samples


def test_a_file_of_the_night_alone_contradicts_nothing():
    flight = Flight(1)
    flight.telemetry(0.0)
    dark = ~flight.lit
    noise = np.abs(flight.rng.normal(size=(dark.sum(), len(CUBE_NORMALS))))
    for readings in (noise, 0.1 * noise + 1.0, np.maximum(noise - 0.7, 0)):
        data = flight.dataset(readings).assign_coords(time=flight.t[dark])
        assert not flight.against(data, RELATIVE).samples
    sunny = flight.dataset(flight.telemetry(0.0)["power_W"].values[flight.lit][: dark.sum()])
    assert flight.against(sunny.assign_coords(time=flight.t[dark]), RELATIVE).samples > 20


def test_sunlight_in_shadow_refuses_the_elements_and_is_named():
    few = replace(ORBIT, copies=5, hours=(1,))
    flight = Flight(1)
    data, orbit = flight.telemetry(1500.0), flight.orbit()
    used, check, words = judged_orbit(orbit, CUBE, data, settings=few)
    assert used is None and check.verdict is Verdict.REFUSED and check.sun_in_shadow.samples > 20
    assert "deep in the Earth's shadow have clear Sun" in words
    right = check_orbit(replace(orbit, clock_s=1500.0), CUBE, data, settings=few)
    assert right.verdict is not Verdict.REFUSED and not str(right.sun_in_shadow)


def test_a_sun_sensor_that_freezes_in_the_shadow_contradicts_nothing():
    flight = Flight(1)
    sun, lit, _ = flight.sky(0.0)
    read = Rotation.from_rotvec(flight.t[:, None] * np.radians([1.8, 0.0, 2.4])).apply(sun)
    read += 0.01 * np.random.default_rng(0).normal(size=read.shape)
    read = np.where(lit[:, None], read / np.linalg.norm(read, axis=1)[:, None], np.nan)
    first = int(np.flatnonzero(~lit & np.append(False, lit[:-1]))[0])
    frozen = read.copy()
    frozen[first : first + 12] = read[first - 1]
    numbers = (0.2, 1.0, 1.0, 0.01, 0.01)
    sensors = tuple(
        SunSensor(f"s{k}", face, np.roll(face, 1), f"x{k}", f"y{k}", f"l{k}", *numbers)
        for k, face in enumerate(CUBE_NORMALS)
    )
    craft = Vehicle("cube", sensors=Sensors(sun_sensors=sensors))
    data = flight.dataset(np.zeros((len(read), len(CUBE_NORMALS)))).drop_dims("panel")
    for directions in (read, frozen):
        seen = data.assign(sun_sensor_B=(("time", "axis"), directions))
        assert not flight.against(seen, craft).samples


TLE = """MYCUBE
1 A5544U 26123A   25365.91234567  .00012345  00000-0  23456-3 0  9998
2 A5544  97.4437 295.9456 0012835  41.8426 290.0000 15.20921507  946"""
"""An orbit that is in the Earth's shadow at the times of the example telemetry, which is in the Sun."""


@pytest.fixture
def satellite(tmp_path, monkeypatch):
    """Return a folder with the template and elements that do not fit it, for a check with few comparison orbits."""
    monkeypatch.chdir(tmp_path)
    with_few_copies(monkeypatch, 5, hours=(1,))
    assert CliRunner().invoke(cli, ["init", "."]).exit_code == 0
    name, first, second = TLE.splitlines()
    elements = "\n".join((name, first, with_check_digit(second)))
    (tmp_path / "my.tle").write_text(f"{elements}\n", "utf-8")
    return tmp_path


def run(*words: str):
    return CliRunner().invoke(cli, list(words), catch_exceptions=False)


@pytest.mark.long
def test_check_reports_elements_that_do_not_fit_and_rates_ignore_them(satellite):
    files = ("vehicle.toml", "telemetry.csv")
    done = run("check", *files, "--tle", "my.tle")
    assert "Orbit of MYCUBE (105544): elements not consistent with the telemetry" in done.output
    words = r"the elements do not fit: (\d+) of \d+ samples deep in the Earth's shadow"
    contradicted = re.search(words, done.output)
    assert contradicted is not None and int(contradicted[1]) > 20
    few = ("--to", "120", "--no-column-tests", "--effort", "0.1")
    done = run("rates", *files, *few, "--tle", "my.tle", "--json")
    result = json.loads(done.stdout)
    assert "continuing without the orbit" in done.stderr
    assert result["orbit"]["used"] is False and result["passes"]


def test_the_advice_to_correct_the_clock_makes_the_elements_usable(satellite):
    checked = ("check", "vehicle.toml", "telemetry.csv", "--tle", "my.tle")
    minutes = run(*checked).output
    sides = (rf"(\d+) min or more if it is {side} UTC" for side in ("behind", "ahead of"))
    behind, ahead = (60 * int(re.search(side, minutes)[1]) for side in sides)
    # the vehicle file says by how much UTC is ahead of the clock
    for clock_s in (behind + 180, -ahead - 180):
        text = (satellite / "vehicle.toml").read_text("utf-8")
        text += f"\n[orbit]\nclock_s = {{ value = {clock_s}, sigma = 1 }}\n"
        (satellite / "clock.toml").write_text(text, "utf-8")
        done = run("check", "clock.toml", "telemetry.csv", "--tle", "my.tle", "--json")
        assert json.loads(done.stdout)["orbit"]["verdict"] != "refused"
    sigma = str((min(behind, ahead) + 90) / ORBIT.span)
    wider = run(*checked, "--tle-shift-sigma", sigma, "--json")
    assert json.loads(wider.stdout)["orbit"]["verdict"] != "refused"


def test_an_orbit_with_too_few_sunlit_samples_is_named_as_the_reason():
    flight = Flight(1)
    data = flight.telemetry(1500.0)
    shadow = ~flight.sky(0.0)[1]
    some = data.isel(time=np.flatnonzero(shadow & flight.lit)[2:20])
    with pytest.raises(ss.InputError, match="by the orbit .* are in the Earth's shadow"):
        ss.rates(CUBE, some, environment=flight.orbit())
