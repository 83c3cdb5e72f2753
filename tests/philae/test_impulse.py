"""The collision's impulse as evidence: angles and weights with known values, and the landing kernel if it is present."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from studies import impulse as im
from studies.impulse import comet_from_J2000
from sunspin.philae.collision import event_tdb_s

CASE = ss.load_case("philae")
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
