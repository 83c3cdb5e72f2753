"""The collision's impulse as evidence: weights with known values, axes of comet 67P, and the landing kernel if it is present."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from studies import impulse as im
from studies.impulse import comet_from_J2000
from sunspin.philae.collision import KERNEL, event_tdb_s, read_kernel_states

CASE = ss.load_case("philae")
LANDING_S = 469_078_511.0
SEEN = im.VelocityChange(0.2246, np.radians(18.7), np.radians(-7.0))


def collisions(size, to_sun, about):
    each = {"velocity_change": size, "change_to_sun": to_sun, "change_about_sun": about}
    return xr.Dataset({name: ("run", np.atleast_1d(values)) for name, values in each.items()})


def test_collision_weights_use_the_requested_number_of_components():
    off = SEEN.direction_sigma_rad
    runs = collisions(
        [0.2246, 0.2246 + 2 * 0.02, 0.2246, 0.2246, np.nan],
        SEEN.to_sun_rad + np.array([0, 0, off, 0, 0]),
        SEEN.about_sun_rad + np.array([2 * np.pi, 0, 0, np.pi, 0]),
    )
    one, two, three = (SEEN.weights(runs, numbers) for numbers in (1, 2, 3))
    np.testing.assert_allclose(one, [1, np.exp(-2), 1, 1, 0], rtol=1e-7)
    np.testing.assert_allclose(two, [1, np.exp(-2), np.exp(-0.5), 1, 0], rtol=1e-7)
    assert three[0] == pytest.approx(1, abs=1e-9) and three[3] < 1e-10
    assert np.degrees(off) == pytest.approx(5.5, abs=0.1)


def test_the_landing_kernel_is_read_in_inertial_axes(tmp_path, monkeypatch):
    """States made so that the change of velocity in J2000 stands 40 degrees from a Sun along x, at a place 3 km out."""
    tdb, landed = event_tdb_s(CASE, "collision"), event_tdb_s(CASE, "first_touchdown")
    change = 0.2 * np.array([np.cos(np.radians(40)), np.sin(np.radians(40)), 0.0])
    place = comet_from_J2000(tdb) @ [0.0, 3000.0, 0.0]
    before = np.concatenate([place, [0.1, 0.2, -0.1]])
    after = np.concatenate([place, before[3:] + comet_from_J2000(tdb) @ change])
    down = np.concatenate([comet_from_J2000(landed) @ [0.0, 0.0, 2000.0], np.zeros(3)])
    states = np.array([down, before, after])
    monkeypatch.setattr(im, "read_kernel_states", lambda path, times: states)
    sun = tmp_path.joinpath(*im.SUN)
    sun.parent.mkdir()
    sun.write_text("utc,et_s,x,y,z,au\n" + "".join(f"t,{tdb + dt},1,0,0,3\n" for dt in (-60, 60)))
    seen = im.read_velocity_change(CASE, tmp_path)
    assert seen.change_m_s == pytest.approx(0.2, abs=1e-4)
    assert np.degrees(seen.to_sun_rad) == pytest.approx(40, abs=0.1)
    assert np.degrees(seen.about_sun_rad) == pytest.approx(-90, abs=0.5)  # from z about x
    sun.write_text("utc,et_s,x,y,z,au\nt,1,1,0,0,3\n")
    with pytest.raises(ss.InputError, match="no direction of the Sun at the collision"):
        im.read_velocity_change(CASE, tmp_path)
    sun.unlink()
    with pytest.raises(ss.InputError, match=r"Sun's directions are not there.*docs/data.md"):
        im.read_velocity_change(CASE, tmp_path)


@pytest.fixture(scope="module")
def drawn():
    """Collisions whose rate after grows with the size of the blow, and nothing else tells."""
    n, rng = 20_000, np.random.default_rng(0)
    runs = collisions(
        rng.uniform(0, 0.5, n), np.arccos(rng.uniform(-1, 1, n)), rng.uniform(-np.pi, np.pi, n)
    )
    rate = rng.uniform(0, 1, n)
    runs["speed_touchdown"] = "run", rate
    for name, values in (("before", rate), ("after", 2 * runs["velocity_change"].values)):
        runs[f"omega_{name}_B"] = ("run", "axis"), np.outer(values, [0.6, 0.0, 0.8])
    return runs


def test_the_impulse_study_writes_table_and_figure(drawn, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(im, "read_velocity_change", lambda case, folder: SEEN)
    monkeypatch.setattr(im, "load_motions", lambda source, seed: SimpleNamespace())
    monkeypatch.setattr(im, "simulate_collisions", lambda chain, n, seed: drawn)
    assert im.main([str(tmp_path / "out"), "--data", str(tmp_path)]) == 0
    assert (tmp_path / "out" / "impulse.png").stat().st_size > 10_000
    text = (tmp_path / "out" / "impulse.md").read_text("utf-8")
    assert text in capsys.readouterr().out and "0.2246 m/s, 18.7 deg from the Sun" in text


def test_the_impulse_study_without_its_data_ends_with_one_sentence(tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("SUNSPIN_DATA", raising=False)
    assert im.main([str(tmp_path / "out")]) == 2
    assert "SUNSPIN_DATA" in capsys.readouterr().err and not list(tmp_path.iterdir())


@pytest.mark.real_data
def test_the_impulse_of_the_landing_kernel_is_the_recorded_one(data_dir):
    pytest.importorskip("spiceypy")
    seen = im.read_velocity_change(CASE, data_dir)
    recorded = CASE.published["kernel_velocity_change"].value
    assert seen.change_m_s == pytest.approx(recorded, abs=2e-4)
    assert np.degrees(seen.to_sun_rad) == pytest.approx(18.7, abs=0.1)


def test_the_pole_of_the_comet_is_z_and_its_meridian_rotates_as_published():
    right_ascension, declination = np.radians(im.POLE_DEG)
    level = np.array([np.cos(right_ascension), np.sin(right_ascension)])
    pole = [*(np.cos(declination) * level), np.sin(declination)]
    np.testing.assert_allclose(comet_from_J2000(LANDING_S) @ pole, [0, 0, 1], atol=1e-12)
    # where the comet's equator rises through that of J2000
    node = [-level[1], level[0], 0.0]
    seen = comet_from_J2000(0.0) @ node
    assert np.degrees(np.arctan2(-seen[1], seen[0])) == pytest.approx(im.MERIDIAN_DEG)
    assert 24 * 360 / im.DEG_PER_DAY == pytest.approx(12.404, abs=1e-3)


def test_the_inertial_velocity_is_the_derivative_of_the_inertial_position():
    state = np.array([2123.0, -959.0, 497.0, 0.24, 0.11, -0.2])
    before, after = (
        comet_from_J2000(LANDING_S + dt).T @ (state[:3] + dt * state[3:]) for dt in (-1, 1)
    )
    velocity = im.velocity_J2000(LANDING_S, state)
    np.testing.assert_allclose(velocity, (after - before) / 2, atol=1e-7)
    assert np.linalg.norm(np.cross(im.SPIN_COMET, state[:3])) == pytest.approx(0.33, abs=0.01)


@pytest.mark.real_data
def test_at_the_landing_site_the_sun_is_up_and_gravity_points_down(data_dir):
    """The pole by the Sun's height over the comet's equator in November 2014; the spin by the path's acceleration in space."""
    pytest.importorskip("spiceypy")
    times = LANDING_S + np.array([0.6, 600.0, 601.0, 2700.0, 6600.0])
    states = read_kernel_states(data_dir.joinpath(*KERNEL), times)
    for t, state in zip(times, states, strict=True):
        sun = comet_from_J2000(t) @ im.sun_J2000(data_dir, t)
        assert np.degrees(np.arcsin(sun[2])) == pytest.approx(37.2, abs=0.3)
        assert sun @ state[:3] > 0.5 * np.linalg.norm(state[:3])
    fixed = states[2, 3:] - states[1, 3:]
    space = comet_from_J2000(times[1]) @ np.subtract(
        *(im.velocity_J2000(times[k], states[k]) for k in (2, 1))
    )
    down = -states[1, :3] / np.linalg.norm(states[1, :3])
    away = [np.degrees(np.arccos(x @ down / np.linalg.norm(x))) for x in (fixed, space)]
    assert away[1] < 6 < 15 < away[0]
