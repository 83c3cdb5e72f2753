"""Angles of body axes to Sun, nadir, ram and stations: against astropy, with errors of known draws, and what is not known."""

from __future__ import annotations

import astropy.units as u
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from astropy.coordinates import GCRS, ITRS, CartesianRepresentation, EarthLocation
from astropy.time import Time
from astropy.utils import iers
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.cli import cli
from sunspin.environment.earth import sun_J2000_m
from sunspin.environment.elements import parse_elements
from sunspin.environment.orbit import in_orbit
from sunspin.output.pointing import TRACK, with_track
from sunspin.output.report.page import write_report

EPOCH = "2021-03-14T06:00:00Z"
ELEMENTS = """1 99999U 21001A   21073.25000000  .00001000  00000-0  50000-4 0  9999
2 99999  97.5000  20.0000 0010000  50.0000 100.0000 15.20000000    16"""
"""A low, polar orbit."""

PARSED = tuple(parse_elements(ELEMENTS, "test"))

STATION = ("bratislava", 48.15, 17.11, 150.0)
AXES = {"+z": [0, 0, 1], "-x": [-1, 0, 0]}


def rates_with(
    attitude: Rotation, t_s: np.ndarray, sigmas_rad: tuple[float, float], decided=(True, True)
) -> xr.Dataset:
    """Return a result of `rates` in J2000 as an orbit and a magnetometer give it, two passes, with this attitude (n).

    `sigmas_rad`: of the Sun direction (both components together), and of the rotation about it.
    """
    orbit = in_orbit(PARSED, EPOCH, t_s, shift_sigma_s=1e-3, clock_sigma_s=1e-3)
    position, _ = orbit.states(orbit.instants(t_s))
    sun = sun_J2000_m(orbit.instants(t_s)) - position
    sun /= np.linalg.norm(sun, axis=1, keepdims=True)
    n, half = len(t_s), len(t_s) // 2
    pass_of = np.repeat([0, 1], [half, n - half])
    why = ["" if one else "several solutions" for one in decided]
    attrs = {"kind": "rates", "frame_N": "J2000", "orbit": "99999", "epoch_utc": EPOCH}
    result = xr.Dataset(
        {
            "B_from_N": (("time", "quaternion"), attitude.as_quat()),
            "sun_B": (("time", "axis"), attitude.apply(sun)),
            "sun_sigma_rad": ("time", np.full(n, sigmas_rad[0])),
            "turn_sigma_rad": ("time", np.full(n, sigmas_rad[1])),
            "pass_of": ("time", pass_of),
            "decided": ("pass_id", np.array(decided)),
            "why_not_decided": ("pass_id", why),
        },
        {"time": t_s, "pass_id": [0, 1]},
        attrs | {"vehicle": "a cube"},
    )
    return with_track(result, orbit)


TIMES = np.arange(0.0, 5400.0, 300.0)


def random_attitudes(seed: int = 1) -> Rotation:
    return Rotation.random(len(TIMES), random_state=seed)


@pytest.fixture(scope="module")
def directions_by_astropy():
    """Directions (n, 3) to nadir, ram and the station in GCRS, and the station's elevation (n, deg), all by astropy."""
    orbit = in_orbit(PARSED, EPOCH, TIMES)
    position, velocity = orbit.states(orbit.instants(TIMES))
    with iers.conf.set_temp("auto_download", False):
        when = Time(EPOCH.rstrip("Z"), scale="utc") + TIMES * u.s
        latitude, longitude = STATION[1] * u.deg, STATION[2] * u.deg
        place = EarthLocation.from_geodetic(longitude, latitude, STATION[3] * u.m)
        station = place.get_gcrs_posvel(when)[0].xyz.to_value(u.m).T
        craft = GCRS(CartesianRepresentation(position.T * u.m), obstime=when)
        fixed = craft.transform_to(ITRS(obstime=when)).cartesian.xyz.to_value(u.m).T
    origin = np.array([each.to_value(u.m) for each in place.geocentric])
    level = np.cos(latitude)
    up = [level * np.cos(longitude), level * np.sin(longitude), np.sin(latitude)]
    line = fixed - origin
    elevation = np.degrees(np.arcsin(line @ np.array(up) / np.linalg.norm(line, axis=1)))
    return {"nadir": -position, "ram": velocity, "bratislava": station - position}, elevation


def test_angles_to_nadir_ram_and_station_agree_with_astropy(directions_by_astropy):
    attitude = random_attitudes()
    rates = rates_with(attitude, TIMES, (0.01, 0.02))
    found = ss.pointing(rates, list(AXES), [STATION])
    toward_sun = np.cos(found["pointing_angle"].sel(body_axis="+z", target="sun").values)
    np.testing.assert_allclose(toward_sun, rates["sun_B"].values[:, 2], atol=1e-12)
    directions, elevation = directions_by_astropy
    for name, line in directions.items():
        unit = attitude.apply(line / np.linalg.norm(line, axis=1, keepdims=True))
        for axis, vector in AXES.items():
            expected = np.degrees(np.arccos(unit @ vector))
            angle = np.degrees(found["pointing_angle"].sel(body_axis=axis, target=name).values)
            np.testing.assert_allclose(angle, expected, atol=0.1, err_msg=f"{axis} to {name}")
    np.testing.assert_allclose(np.degrees(found["station_elevation"][0]), elevation, atol=0.1)
    assert 400e3 < found["station_range"].min() < found["station_range"].max() < 14e6


@pytest.mark.parametrize("sigmas", [(0.02, 0.01), (0.005, 0.06)])
def test_the_errors_of_angles_are_those_of_fifty_draws_of_the_attitude(sigmas):
    """Small rotations across and about the Sun are drawn; differences over sigma have mean square 1, and 68 % are below 1."""
    truth = random_attitudes(5)
    exact = ss.pointing(rates_with(truth, TIMES, sigmas), list(AXES), [STATION])
    sun = rates_with(truth, TIMES, sigmas)["sun_B"].values
    rng, ratios = np.random.default_rng(8), []
    for _ in range(50):
        error = rng.normal(size=(len(TIMES), 3)) * sigmas[0] / np.sqrt(2)
        about = rng.normal(size=(len(TIMES), 1)) * sigmas[1]
        error += sun * (about - np.sum(error * sun, 1, keepdims=True))
        drawn = rates_with(Rotation.from_rotvec(error) * truth, TIMES, sigmas)
        found = ss.pointing(drawn, list(AXES), [STATION])
        off = found["pointing_angle"] - exact["pointing_angle"]
        ratios.append((off / found["pointing_sigma"]).values)
    ratio = np.array(ratios)
    assert np.isfinite(ratio).all()
    np.testing.assert_allclose(np.sqrt((ratio**2).mean(axis=(0, 3))), 1.0, atol=0.1)
    assert 0.62 < (np.abs(ratio) < 1).mean() < 0.74


def test_an_error_along_the_track_widens_nadir_but_not_the_sun():
    rates = rates_with(random_attitudes(), TIMES, (1e-4, 1e-4))
    late = rates.assign({TRACK[2]: rates[TRACK[2]] * 0 + 30.0})  # 30 s of flight are 2 degrees
    sharp, wide = (
        np.degrees(ss.pointing(one)["pointing_sigma"].isel(body_axis=0)) for one in (rates, late)
    )
    np.testing.assert_allclose(wide.sel(target="sun"), sharp.sel(target="sun"))
    assert sharp.max() < 0.02 and 1.5 < wide.sel(target="nadir").max() < 2.1
    assert 1.5 < wide.sel(target="ram").max() < 2.1


def test_the_error_is_bounded_for_an_axis_along_its_target():
    """The angle is at its least there; its error is not more than that of the direction, in any direction across."""
    rates = rates_with(random_attitudes(), TIMES, (0.02, 0.02))
    sun = rates["sun_B"].values[0]
    found = ss.pointing(rates, [sun, -sun]).isel(time=0).sel(target="sun")
    np.testing.assert_allclose(np.degrees(found["pointing_angle"]), [0, 180], atol=1e-5)
    np.testing.assert_allclose(found["pointing_sigma"], 0.02 / np.sqrt(2), rtol=1e-6)


def test_a_pass_that_is_not_decided_has_no_angles_and_says_why(tmp_path):
    rates = rates_with(random_attitudes(), TIMES, (0.01, 0.02), decided=(True, False))
    found = ss.pointing(rates, stations=[STATION])
    second = found["pass_of"].values == 1
    assert np.isnan(found["pointing_angle"].values[..., second]).all()
    assert np.isnan(found["pointing_sigma"].values[..., second]).all()
    assert np.isfinite(found["pointing_angle"].values[..., ~second]).all()
    summary = found.sunspin.summary()
    assert "not decided (several solutions): no angles" in str(summary)
    assert summary["passes"][1]["angles"] == [] and summary["passes"][0]["angles"]
    folder = found.sunspin.save(tmp_path / "pointing")
    table = pd.read_csv(folder / "pointing.csv", comment="#")
    assert set(table[~table["decided"]]["why_no_angle"]) == {"several solutions"}
    assert table[~table["decided"]]["nadir_angle_deg"].isna().all()
    page = write_report(folder).read_text("utf-8")
    assert "not decided (several solutions)" in page and "Angles of body axes" in page


def test_an_angle_whose_error_is_too_large_is_not_given():
    found = ss.pointing(rates_with(random_attitudes(), TIMES, (0.01, 1.0)))
    assert np.isfinite(found["pointing_angle"].sel(target="sun")).all()
    nadir = found.sel(target="nadir").isel(body_axis=0)
    large = nadir["pointing_sigma"] > np.radians(30)
    assert 0 < large.sum() and np.isnan(nadir["pointing_angle"].values[large]).all()
    assert (np.degrees(found["pointing_sigma"].sel(target="nadir")) > 30).any()


@pytest.mark.parametrize("lacking", ["orbit", "frame", "track"])
def test_without_a_known_attitude_only_the_angle_to_the_sun_is_given(lacking):
    rates = rates_with(random_attitudes(), TIMES, (0.01, 0.02))
    local = {"kind": "rates", "frame_N": "sun_z_local", "vehicle": "a"}
    rates = {
        "orbit": rates.drop_attrs().assign_attrs(local),
        "frame": rates.assign_attrs(frame_N="sun_z_local"),
        "track": rates.drop_vars(list(TRACK)),
    }[lacking]
    found = ss.pointing(rates)
    assert found["target"].values.tolist() == ["sun"]
    assert "only the angle to the Sun is given" in str(found.sunspin.summary())
    with pytest.raises(InputError, match="angle to a station is not known"):
        ss.pointing(rates, stations=[STATION])


@pytest.mark.parametrize(
    ("axes", "stations", "says"),
    [
        (["up"], [], r"a body axis is one of \+x"),
        ([[0, 0, 0]], [], "a body axis is one of"),
        ([], [], "1 to 12 body axes"),
        (["+z"], [("graz", 95.0, 15.0, 0.0)], "latitude of a station lies between -90 and 90 deg"),
        (["+z"], [("graz", 45.0, 15.0, 45_000.0)], "altitude of a station"),
        (["+z"], [("graz", 45.0, float("nan"), 0.0)], "longitude of a station"),
        (["+z"], [("sun", 45.0, 15.0, 0.0)], "name of a station"),
        (["+z"], [("a", 45.0, 15.0, 0.0), ("a", 40.0, 15.0, 0.0)], "a name of its own"),
    ],
)
def test_a_wrong_axis_or_station_is_refused(axes, stations, says):
    with pytest.raises(InputError, match=says):
        ss.pointing(rates_with(random_attitudes(), TIMES, (0.01, 0.02)), axes, stations)


def test_the_command_reads_the_results_folder_of_rates(user_runs, tmp_path, undrawn, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder, run = str(user_runs["rates"]), CliRunner()
    words = ["pointing", folder, "--axis", "+z", "--axis", "0,0.6,0.8", "--out", "p"]
    done = run.invoke(cli, words)
    assert done.exit_code == 0, done.output
    assert "+z: sun" in done.output and "estimated without an orbit" in done.output
    table = pd.read_csv("p/pointing.csv", comment="#")
    columns = "time_s utc pass_id decided axis sun_angle_deg sun_angle_sigma_deg why_no_angle"
    assert table.columns.tolist() == columns.split()
    rates = pd.read_csv(f"{folder}/rates.csv", comment="#")
    expected = np.degrees(np.arccos(rates["sun_z_B"]))
    np.testing.assert_allclose(table[table["axis"] == "+z"]["sun_angle_deg"], expected, atol=1e-5)
    for arguments, says in (
        (["pointing", "p"], "needs a results folder of `sunspin rates`"),
        (["pointing", "nowhere"], "no such folder"),
        (["pointing", folder, "--axis", "1,2"], "takes 3 numbers"),
        (
            ["pointing", folder, "--station", "48,17"],
            "takes latitude and longitude in deg and alt",
        ),
        (["pointing", folder, "--station", "48,17,100"], "angle to a station is not known"),
    ):
        refused = run.invoke(cli, arguments)
        assert isinstance(refused.exception, InputError) and says in str(refused.exception)


def test_angles_between_the_samples_are_those_of_the_motion_with_growing_errors():
    """Of a body that spins at 1 deg/s about an axis fixed in J2000, in two passes, first without and then with curves."""
    spin, t = np.radians(1.0) * np.array([0.6, 0.0, 0.8]), np.arange(0.0, 600.0, 20.0)
    attitude = Rotation.from_rotvec(-t[:, None] * spin)
    rates = rates_with(attitude, t, (0.01, 0.02))
    # the Sun's own motion in ten minutes is 0.007 deg
    sun_N = attitude[0].inv().apply(rates["sun_B"].values[0])
    rates = rates.assign(
        omega_B=(("time", "axis"), np.tile(spin, (len(t), 1))),
        omega_cov_B=(("time", "axis", "axis2"), np.tile(1e-6 * np.eye(3), (len(t), 1, 1))),
        sun_B=(("time", "axis"), attitude.apply(sun_N)),
    )
    for step_s, says in ((0.0, "must be positive"), (1e-3, "at most 200000 times")):
        with pytest.raises(InputError, match=says):
            ss.pointing(rates, step_s=step_s)
    found = ss.pointing(rates, stations=[STATION], step_s=4.0)
    at_samples = ss.pointing(rates, stations=[STATION])
    t = found["time"].values
    attitude = Rotation.from_rotvec(-t[:, None] * rates["omega_B"].values[0])
    orbit = in_orbit(PARSED, EPOCH, t)
    position, _ = orbit.states(orbit.instants(t))
    nadir = attitude.apply(-position / np.linalg.norm(position, axis=1, keepdims=True))
    angle = found["pointing_angle"].sel(body_axis="+z", target="nadir").values
    np.testing.assert_allclose(np.degrees(angle), np.degrees(np.arccos(nadir[:, 2])), atol=0.02)
    same = np.flatnonzero(np.isin(t, at_samples["time"].values))
    assert len(same) == at_samples.sizes["time"]
    for name in ("pointing_angle", "pointing_sigma", "station_elevation"):
        np.testing.assert_allclose(found[name].values[..., same], at_samples[name], atol=2e-5)
    # 8 s from a sample: the errors of attitude and rate together
    sigma = found["pointing_sigma"].sel(body_axis="+z", target="sun").values
    np.testing.assert_allclose(sigma[2], np.sqrt(0.01**2 / 2 + 0.008**2), rtol=1e-3)
    curves = rates.assign({f"curve_{n}": ("curve_time", rates[n].values) for n in ("pass_of",)})
    curves["curve_B_from_N"] = (("curve_time", "quaternion"), rates["B_from_N"].values)
    curves["curve_omega_B"] = (("curve_time", "axis"), rates["omega_B"].values)
    curves = curves.assign_coords(curve_time=rates["time"].values)
    between = ss.pointing(curves, stations=[STATION])
    assert np.allclose(between["curve_pointing_angle"], at_samples["pointing_angle"], atol=1e-4)
    undecided = curves.assign(decided=("pass_id", np.array([True, False])))
    left_out = np.isnan(ss.pointing(undecided)["curve_pointing_angle"].values[0, 0])
    np.testing.assert_array_equal(left_out, rates["pass_of"] == 1)
    # no time lies between the passes
    assert not ((t > 280.0) & (t < 300.0)).any()


OTHERS = "something else than `rates` writes"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda rates: rates.assign_attrs(kind="scan"), "needs a result of `rates`"),
        (lambda rates: rates.drop_vars("sun_sigma_rad"), "needs a result of `rates`"),
        (lambda rates: rates.assign(sun_B=rates["sun_B"] * np.nan), "knows no Sun direction"),
        (lambda rates: rates.assign(pass_of=rates["pass_of"] + 7), OTHERS),
        (lambda rates: rates.assign_attrs(epoch_utc="noon"), OTHERS),
        (lambda rates: rates.assign(B_from_N=rates["B_from_N"] * 0), OTHERS),
    ],
)
def test_a_result_that_is_none_of_rates_is_refused(change, says):
    with pytest.raises(InputError, match=says):
        ss.pointing(change(rates_with(random_attitudes(), TIMES, (0.01, 0.02))), stations=[STATION])
