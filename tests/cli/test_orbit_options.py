"""Elements on the command line and in the vehicle file."""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

from sunspin.base.errors import SunspinError
from sunspin.cli import cli
from tests.support.orbit_cases import with_few_copies

TLE = """1 25544U 98067A   26001.50000000  .00010000  00000-0  10000-3 0  9999
2 25544  51.6400 120.0000 0006000  30.0000  40.0000 15.49000000    03
"""


@pytest.fixture
def satellite(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(cli, ["init", "."]).exit_code == 0
    (tmp_path / "my.tle").write_text(TLE, "utf-8")
    return tmp_path


def said(*words: str, command: str = "check") -> str:
    with pytest.raises(SunspinError) as error:
        CliRunner().invoke(cli, [command, *words], catch_exceptions=False)
    return str(error.value)


def test_wrong_elements_are_refused_in_one_sentence(satellite):
    (satellite / "bad.tle").write_text(TLE.replace("9999", "9990"), "utf-8")
    text = said("vehicle.toml", "telemetry.csv", "--tle", "bad.tle")
    assert text.startswith(
        "bad.tle, line 1: the checksum of the line is 9, but its last character says '0';"
    )
    assert said("vehicle.toml", "telemetry.csv", "--omm", "none.xml").startswith(
        "none.xml: the file of elements cannot be read"
    )
    bare = said("vehicle.toml", "--tle", "my.tle")
    assert bare == "elements are compared with telemetry; give TELEMETRY too"
    assert said("vehicle.toml", "telemetry.csv", "--tle-shift-sigma", "5").startswith(
        "an along-track offset needs elements"
    )
    assert said("vehicle.toml", "telemetry.csv", "--norad", "25544") == (
        "--norad selects a satellite of an orbit file; give --tle FILE too"
    )
    text = said("vehicle.toml", "telemetry.csv", "--tle", "bad.tle", command="rates")
    assert text.startswith("bad.tle, line 1: the checksum")
    text = said("vehicle.toml", "telemetry.csv", "--tle", "my.tle", "--no-orbit", command="rates")
    assert text.startswith("--no-orbit contradicts the elements")


def test_a_file_of_many_satellites_serves_with_the_number_or_name_of_one(satellite, monkeypatch):
    with_few_copies(monkeypatch, 3)
    other = TLE.replace("25544", "25545").replace("999\n", "990\n").replace("03\n", "04\n")
    (satellite / "group.tle").write_text(f"MINE\n{TLE}SISTER\n{other}", "utf-8")
    words = ["vehicle.toml", "telemetry.csv", "--tle", "group.tle"]
    advice = (
        "(found 25544 (MINE), 25545 (SISTER)); name yours with --norad and its catalogue number"
    )
    assert said(*words).endswith(advice)
    for name in ("25544", "mine"):
        done = CliRunner().invoke(cli, ["check", *words, "--norad", name, "--json"])
        assert json.loads(done.stdout)["orbit"]["satellite"] == 25544, done.output


def test_the_orbit_check_is_inconclusive_without_data_and_reads_elements_from_the_vehicle_file(
    satellite, monkeypatch
):
    with_few_copies(monkeypatch, 10)
    words = ["check", "vehicle.toml", "telemetry.csv", "--tle", "my.tle"]
    done = CliRunner().invoke(cli, words, catch_exceptions=False)
    said = "Orbit of satellite 25544: inconclusive: this telemetry cannot distinguish the elements"
    assert said in done.output
    text = (satellite / "vehicle.toml").read_text("utf-8")
    for mark in ("[orbit]", "tle =", "shift_s =", "clock_s ="):
        text = text.replace(f"# {mark}", mark)
    (satellite / "vehicle.toml").write_text(text, "utf-8")
    done = CliRunner().invoke(cli, [*words[:3], "--json"], catch_exceptions=False)
    orbit = json.loads(done.output)["orbit"]
    assert orbit["satellite"] == 25544 and orbit["verdict"] == "undecided" and orbit["copies"] == 10


def test_rates_with_an_orbit_hold_its_positions_for_pointing(satellite, monkeypatch, undrawn):
    """Without a magnetometer the attitude about the Sun is free, and pointing says so; with one it would use the positions."""
    with_few_copies(monkeypatch, 3)
    few = "--to 120 --no-column-tests --effort 0.1 --tle my.tle --out rates".split()
    done = CliRunner().invoke(cli, ["rates", "vehicle.toml", "telemetry.csv", *few])
    assert done.exit_code == 0, done.output
    with xr.open_dataset("rates/rates.nc") as rates:
        radius = np.linalg.norm(rates["position_J2000"], axis=1)
        speed = np.linalg.norm(rates["velocity_J2000"], axis=1)
        assert rates["position_J2000"].attrs["units"] == "m" and rates.attrs["orbit"]
    np.testing.assert_allclose(radius, 6.79e6, rtol=0.01)  # 15.49 revolutions a day
    np.testing.assert_allclose(speed, np.sqrt(3.986e14 / radius), rtol=0.01)
    done = CliRunner().invoke(cli, ["pointing", "rates"])
    assert done.exit_code == 0 and "no magnetometer was used" in done.output, done.output


def test_rates_along_elements_whose_field_and_sun_disagree_are_not_decided(satellite, monkeypatch):
    """Axes of a magnetometer turned by 90 degrees: 4 of 6 passes of a spinner were decided, 10 sigma off."""
    from sunspin.output.check import orbit

    disagree = orbit.ChosenOrbit(None, None, {}, ["FIELD AND SUN DISAGREE"], True)
    monkeypatch.setattr(orbit, "choose_orbit", lambda *_: disagree)
    words = ["rates", "vehicle.toml", "telemetry.csv", "--json", "--quiet", "--workers", "1"]
    words += ["--effort", "0.1"]
    (only,) = json.loads(CliRunner().invoke(cli, words).stdout)["passes"]
    assert not only["decided"] and "field and Sun disagree" in only["why_not_decided"]
