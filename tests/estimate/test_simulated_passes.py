"""Simulated passes have the motion, light and steps that their arguments state."""

from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.environment.elements import parse_elements
from sunspin.environment.ephemeris import read_orbit
from sunspin.estimate.synthetic import EARTH_LIGHT, GAIN_ERROR, LEAST_SUNLIT, NOISE, simulate_pass
from sunspin.telemetry.synthetic import generator
from tests.support.orbits import EPOCH, place_and_speed, two_line_elements
from tests.support.simulate import CUBE_WITHOUT_NOISE_STATED as CUBE
from tests.support.vehicles import small_cube

SPEED = 0.03
TWELVE = np.arange(12) * 10.0


def simulate(seed, vehicle=CUBE, t_s=TWELVE, **options):
    """Return a pass of a cube, by default of twelve samples 10 s apart."""
    return simulate_pass(vehicle, t_s, SPEED, generator(seed, 0), **options)


def table_of_positions(tmp_path, hours):
    """Return a table of positions of an orbit, of this many hours, one line a minute."""
    t = np.arange(0, hours * 3600 + 1, 60.0)
    place, _ = place_and_speed(two_line_elements(np.random.default_rng(4)), t)
    times = np.datetime64(EPOCH) + (1000 * t).astype("timedelta64[ms]")
    lines = [f"{u}Z,{x},{y},{z}" for u, (x, y, z) in zip(times, place.tolist(), strict=True)]
    path = tmp_path / "positions.csv"
    path.write_text(
        "\n".join(["# frame: TEME", "time_utc,x_km,y_km,z_km", *lines]) + "\n", encoding="utf-8"
    )
    return read_orbit(path)


def test_simulated_pass_has_the_speed_and_conserves_energy():
    simulated = simulate(1)
    omega = simulated.omega_B
    assert np.linalg.norm(omega[0]) == pytest.approx(SPEED, rel=1e-12)
    energy = np.einsum("ni,ij,nj->n", omega, np.array(CUBE.inertia_kg_m2), omega)
    assert np.allclose(energy, energy[0], rtol=1e-7)
    assert simulated.telemetry.attrs["synthetic"] == 1


def test_readings_follow_the_true_sun_within_gains_noise_and_earth_light():
    off = []
    for seed in range(20):
        telemetry = simulate(seed).telemetry
        exact = ss.panel_power(CUBE, telemetry["true_sun_B"].values)
        off.append(telemetry[CUBE.telemetry.quantity].values - exact)
    off = np.concatenate(off) / exact.max()
    assert np.abs(off).max() < EARTH_LIGHT[1] + 5 * (GAIN_ERROR + NOISE)
    assert np.std(off) > NOISE / 2


def test_readings_of_a_converter_are_multiples_of_its_step():
    read = simulate(1, bits=5).telemetry
    full = ss.panel_power(CUBE, CUBE.panel_normals_B).max()
    steps = read[CUBE.telemetry.quantity].values / (1.2 * full / 31)
    assert np.allclose(steps, np.round(steps), atol=1e-9) and len(np.unique(np.round(steps))) > 3


def test_pass_in_orbit_has_no_sun_in_the_shadow_of_the_earth():
    dark = 0
    orbit = parse_elements("\n".join(two_line_elements(np.random.default_rng(4))), "test")
    for seed in range(6):
        one = simulate(seed, t_s=np.arange(30) * 60.0, orbit=orbit)
        here = one.environment.at(one.telemetry["time"].values)
        power = one.telemetry[CUBE.telemetry.quantity].values
        full = ss.panel_power(CUBE, CUBE.panel_normals_B).max()
        assert (here.lit > 0.5).mean() >= LEAST_SUNLIT
        shadow = here.lit == 0
        dark += shadow.sum()
        # the night side of the Earth gives no light: what is left is noise
        night = shadow & (np.linalg.norm(here.albedo_light_N, axis=1) < 1e-3)
        assert (power[night] < 6 * NOISE * full).all()
    assert dark > 0


def test_passes_lie_within_a_short_table_of_positions(tmp_path):
    orbit = table_of_positions(tmp_path, 3)
    for seed in range(8):
        one = simulate(seed, t_s=np.arange(12) * 60.0, orbit=orbit)
        assert one.environment is not None
    with pytest.raises(InputError, match="shorter than a pass"):
        simulate(0, t_s=np.arange(300) * 60.0, orbit=orbit)


def test_simulated_telemetry_takes_misalignments_or_their_sigma():
    sun = np.array([0.3, 0.5, 0.8]) / np.sqrt(0.98)
    truth = {"omega_B": [0.05, -0.08, 0.11], "sun_B": sun, "t_s": 2 * TWELVE, "scale": 0.5}
    craft = small_cube(0.005)
    drawn = ss.twin(craft, truth | {"tilt_B_rad": 0.04}, seed=3)
    tilt = drawn.attrs["truth_tilt_B_rad"].reshape(6, 3)
    again = ss.twin(craft, truth | {"tilt_B_rad": tilt}, seed=3)
    np.testing.assert_array_equal(again["current_A"].values, drawn["current_A"].values)
    assert "truth_tilt_B_rad" not in ss.twin(craft, truth, seed=3).attrs
    for wrong in (-0.1, np.zeros((5, 3)) + 0.1, np.full((6, 3), np.nan)):
        with pytest.raises(InputError, match="tilt_B_rad of a twin"):
            ss.twin(craft, truth | {"tilt_B_rad": wrong})


def test_noise_is_its_part_of_full_sun_also_if_gains_are_relative():
    """The noise of a file is in ampere and relative gains have no unit, so full Sun follows from the noise."""
    panels = tuple(replace(panel, gain=1.0) for panel in CUBE.panels)
    form = replace(CUBE.telemetry, noise=0.01)
    relative = replace(CUBE, panels=panels, gain_unit=None, telemetry=form)
    readings = [simulate(seed, relative).telemetry[form.quantity].values for seed in range(10)]
    largest, full = [each.max() for each in readings], 0.01 / NOISE
    assert 0.6 * full < np.median(largest) < 1.3 * full
