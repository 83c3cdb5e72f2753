"""Vehicle files with and without noise, for any readings: no defect, and no number with an error of NaN."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner

import sunspin as ss
from sunspin.base.errors import InputError, SunspinError
from sunspin.cli import cli
from sunspin.telemetry.assess import panel_quality
from sunspin.telemetry.noise import ASSUMED_FROM, ASSUMED_SHARE
from sunspin.telemetry.sun import LIT_FRACTION, is_reconstructed
from sunspin.vehicle import Panel, Vehicle
from tests.support.orbit_cases import with_few_copies
from tests.support.satellite_files import UNSTATED, Spinner
from tests.support.simulate import telemetry_of

COLUMNS = [
    (f"{value}_{axis}{unit}", sigma.format(axis=axis) + end)
    for axis in "xyz"
    for value, unit, sigma, end in (
        ("omega", "", "sigma_{axis}", ""),
        ("omega", "_deg_s", "sigma_{axis}", "_deg_s"),
        ("omega", "_B_rad_s", "sigma_{axis}", "_rad_s"),
        ("sun", "_B", "sigma_rad", ""),
    )
]
"""Columns of tables, and of the error of each."""

VARIABLES = [
    ("omega_B", "omega_cov_B"),
    ("sun_B", "sun_cov_B"),
    ("sun_B", "sigma_rad"),
    ("sun_B", "sun_sigma_rad"),
    ("omega_mean_B", "omega_sigma_B"),
    ("curve_omega_B", "curve_omega_sigma_B"),
    *((f"omega_{x}", f"sigma_{x}") for x in "xyz"),
]
"""The same of results."""

PRIORS = "--prior steady_torque=0 --prior inertia=0 --prior max_rate_rad_s=0.06".split()
SMALL = (*PRIORS, *"--draws 200 --workers 1".split())
QUICK = ("--effort", "0.02", "--no-column-tests", "--workers", "1")


def said(*words: str) -> str:
    """What a command prints, or the sentence with which it ends; anything else is raised."""
    try:
        done = CliRunner().invoke(cli, list(words), catch_exceptions=False)
    except SunspinError as error:
        assert "\n" not in str(error) and not isinstance(error, RuntimeError)
        return str(error)
    assert done.exit_code in (0, 2), done.output
    if done.exit_code == 0 and "--json" in words:
        json.loads(done.output[done.output.index("{") :], parse_constant=pytest.fail)
    return done.output


def without_error(folder: Path) -> list[str]:
    """What the files of a result hold as a number beside an error that is none, or is zero."""
    found = []
    for path in folder.glob("*.csv"):
        table = pd.read_csv(path, comment="#")
        both = [(value, sigma) for value, sigma in COLUMNS if {value, sigma} <= set(table)]
        found += [f"{path.name} {v}" for v, s in both if unsure(table[v].values, table[s].values)]
    for path in folder.glob("*.nc"):
        tree = xr.open_datatree(path, engine="h5netcdf")
        for group in (tree, *tree.children.values()):
            for value, sigma in VARIABLES:
                if {value, sigma} <= set(group.data_vars):
                    number = group[value].values
                    bad = unsure(number, error_of(number, group[sigma].values))
                    found += [f"{path.name} {value}"] * bad
        tree.close()
    return found


def error_of(value: np.ndarray, error: np.ndarray) -> np.ndarray:
    """One sigma of each component of values, of their covariances or of angles; of unit vectors the rms of both angles."""
    if error.ndim > value.ndim:
        error = np.sqrt(np.trace(error, axis1=-2, axis2=-1))
    return error if error.ndim == value.ndim else np.broadcast_to(error[..., None], value.shape)


def unsure(value: np.ndarray, sigma: np.ndarray) -> bool:
    return bool((np.isfinite(value) & ~(np.isfinite(sigma) & (sigma > 0))).any())


@pytest.fixture
def few_copies(monkeypatch, undrawn):
    """An orbit is compared with few others; figures are not drawn."""
    with_few_copies(monkeypatch, 10)


def assert_no_error_is_missing(folder: Path) -> None:
    """Assert that the results in a folder hold no number beside an error that is none."""
    bad = {place.name: without_error(place) for place in folder.iterdir() if place.is_dir()}
    assert bad and not any(bad.values()), bad


@pytest.mark.long
def test_a_spinner_without_noise_is_judged_and_its_rate_is_determined(tmp_path, few_copies):
    """Three faces, never more than three panels lit, nothing below zero: without a noise all costs of the orbit check were NaN.
    No result of any command has a number with an error of NaN, with and without elements."""
    vehicle, telemetry, elements = UNSTATED.write(tmp_path)
    tle = "--tle", elements
    text = said("check", vehicle, telemetry, *tle)
    assert "randomised comparison orbits with random node and phase fit better" in text
    assert "field of 60" in text
    said("check", vehicle, telemetry, "--json")
    said("sun", vehicle, telemetry, "--json", "--out", str(tmp_path / "sun"))
    said("rates", vehicle, telemetry, *QUICK, "--json", "--out", str(tmp_path / "alone"))
    out = tmp_path / "rates"
    text = said("rates", vehicle, telemetry, *tle, *QUICK, "--out", str(out))
    assert "passes decided" in text
    assert "error of panel readings" in text
    assert "NOISE NOT STATED" in text
    table = pd.read_csv(out / "passes.csv", comment="#")
    assert table["speed_median_deg_s"][0] == pytest.approx(40.0, abs=1.5)
    assert_no_error_is_missing(tmp_path)


@pytest.mark.parametrize("key", ["relative_gain", "gain_A"])
def test_the_noise_line_suggested_by_check_works(key, tmp_path):
    spinner = replace(UNSTATED, key=key, gain=2.5e-3)
    vehicle, telemetry, _ = spinner.write(tmp_path)
    text = said("check", vehicle, telemetry)
    line = re.search(r"`(noise = (\S+))`, under \[telemetry\]", text)
    assert line is not None and "NOISE NOT STATED" in text
    assert float(line[2]) == pytest.approx(ASSUMED_SHARE * 2.5e-3, rel=0.1)
    path, noise = Path(vehicle), float(line[2])
    text = path.read_text("utf-8").replace("[telemetry]\n", f"[telemetry]\n{line[1]}\n")
    path.write_text(text, "utf-8")
    assert "NOISE" not in said("check", vehicle, telemetry)
    about = json.loads(said("check", vehicle, telemetry, "--json"))["telemetry"]
    assert about["noise"] == ss.load_vehicle(vehicle).telemetry.noise == noise


def test_an_unknown_noise_is_assumed_and_lights_no_other_panel(tmp_path):
    vehicle, telemetry, _ = UNSTATED.write(tmp_path)
    craft = ss.load_vehicle(vehicle)
    samples = ss.read_telemetry(telemetry, craft)
    sun, power = ss.sun_directions(craft, samples), samples["power_W"].values
    assert sun.attrs["noise_from"] == ASSUMED_FROM
    assert sun.attrs["noise"] == pytest.approx(ASSUMED_SHARE, rel=0.1)
    assert sun.attrs["lit_threshold"] == LIT_FRACTION * power.max()  # as ever without a noise
    assert is_reconstructed(sun["status"]).sum() > 10
    assert not unsure(sun["sun_B"].values, error_of(sun["sun_B"].values, sun["sun_cov_B"].values))
    assert np.isfinite(sun["sigma_rad"].values[is_reconstructed(sun["status"])]).all()
    assert ss.panel_health(craft, samples)["noise"] == {}  # what is assumed accuses no panel
    given = {name: float(sun.attrs[name]) for name in ("noise", "lit_threshold")}
    stated = ss.sun_directions(craft, samples, **given)
    xr.testing.assert_equal(stated["sun_cov_B"], sun["sun_cov_B"])


def test_no_noise_is_estimated_from_exact_or_dark_readings():
    rng = np.random.default_rng(0)
    axes = np.vstack([np.eye(3), -np.eye(3), np.ones((1, 3)) / np.sqrt(3)])
    craft = Vehicle("v", panels=[Panel(str(k), axis, 1.0) for k, axis in enumerate(axes)])
    exact = ss.sun_directions(craft, ss.panel_power(craft, np.abs(rng.normal(size=(20, 3)))))
    # four panels lit and no residual beyond rounding
    assert exact.attrs["noise_from"] == ASSUMED_FROM
    dark = ss.sun_directions(craft, np.zeros((4, 7)))
    assert np.isnan(dark["sun_B"].values).all() and np.isnan(dark["sigma_rad"].values).all()
    for wrong in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="noise of a panel reading must be positive"):
            ss.sun_directions(craft, np.ones((1, 7)), noise=wrong)
    with pytest.raises(InputError, match="lit_threshold must be zero or positive"):
        ss.sun_directions(craft, np.ones((1, 7)), lit_threshold=np.nan)


@pytest.mark.parametrize("gain", [2.5e-3, 900.0])
def test_without_noise_the_status_of_a_sample_does_not_depend_on_the_unit(gain):
    """What is dark was judged by a share of the gain and not of full Sun."""
    rng = np.random.default_rng(0)
    craft = Vehicle("v", panels=[Panel(str(k), axis, 1.0) for k, axis in enumerate(-np.eye(3))])
    power = np.abs(rng.normal(size=(60, 3))) * (rng.random((60, 1)) < 0.7)
    power += 0.15 * rng.random((60, 3))
    files = (telemetry_of(craft, np.arange(60.0), unit * power) for unit in (1.0, gain))
    use = [panel_quality(craft, file)["use"].values for file in files]
    assert np.array_equal(*use) and 5 < np.count_nonzero(use[0] == 2) < 50


@pytest.mark.parametrize("seed", [0, 6, 7])
def test_random_files_are_judged_and_directions_have_errors(seed, tmp_path, few_copies):
    """Some state their noise, others do not."""
    vehicle, telemetry, elements = Spinner.drawn(seed).write(tmp_path, seed)
    for tle in ((), ("--tle", elements)):
        said("check", vehicle, telemetry, *tle, "--json")
    said("sun", vehicle, telemetry, "--json", "--out", str(tmp_path / "sun"))
    assert_no_error_is_missing(tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("stated", [None, pytest.param(0.02, marks=pytest.mark.slow)])
def test_posteriors_without_a_noise_name_the_assumed_one(stated, tmp_path, undrawn):
    """The vehicle file has elements, too."""
    few = {"samples": 4, "interval_s": 10.0, "rate_deg_s": 3.0, "magnetometer": False}
    vehicle, telemetry, _ = replace(UNSTATED, stated=stated, orbit=True, **few).write(tmp_path, 3)
    said("posterior", vehicle, telemetry, *SMALL, "--json", "--out", str(tmp_path / "posterior"))
    assert_no_error_is_missing(tmp_path)
    about = json.loads((tmp_path / "posterior" / "summary.json").read_text("utf-8"))
    assert about["noise_from"] == ("given" if stated else ASSUMED_FROM)
    assert about["noise"] == pytest.approx(0.02, rel=0.6)
