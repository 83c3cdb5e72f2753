"""Axes of comet 67P: the published pole, velocities against differences of positions, and the landing kernel where present."""

import numpy as np
import pytest

from studies import impulse as comet
from sunspin.philae.collision import KERNEL, read_kernel_states

LANDING_S = 469_078_511.0


def test_the_pole_of_the_comet_is_z_and_its_meridian_rotates_as_published():
    right_ascension, declination = np.radians(comet.POLE_DEG)
    level = np.array([np.cos(right_ascension), np.sin(right_ascension)])
    pole = [*(np.cos(declination) * level), np.sin(declination)]
    np.testing.assert_allclose(comet.comet_from_J2000(LANDING_S) @ pole, [0, 0, 1], atol=1e-12)
    # where the comet's equator rises through that of J2000
    node = [-level[1], level[0], 0.0]
    seen = comet.comet_from_J2000(0.0) @ node
    assert np.degrees(np.arctan2(-seen[1], seen[0])) == pytest.approx(comet.MERIDIAN_DEG)
    assert 24 * 360 / comet.DEG_PER_DAY == pytest.approx(12.404, abs=1e-3)


def test_the_inertial_velocity_is_the_derivative_of_the_inertial_position():
    state = np.array([2123.0, -959.0, 497.0, 0.24, 0.11, -0.2])
    before, after = (
        comet.comet_from_J2000(LANDING_S + dt).T @ (state[:3] + dt * state[3:]) for dt in (-1, 1)
    )
    velocity = comet.velocity_J2000(LANDING_S, state)
    np.testing.assert_allclose(velocity, (after - before) / 2, atol=1e-7)
    assert np.linalg.norm(np.cross(comet.SPIN_COMET, state[:3])) == pytest.approx(0.33, abs=0.01)


@pytest.mark.real_data
def test_at_the_landing_site_the_sun_is_up_and_gravity_points_down(data_dir):
    """The pole by the Sun's height over the comet's equator in November 2014; the spin by the path's acceleration in space."""
    pytest.importorskip("spiceypy")
    times = LANDING_S + np.array([0.6, 600.0, 601.0, 2700.0, 6600.0])
    states = read_kernel_states(data_dir.joinpath(*KERNEL), times)
    for t, state in zip(times, states, strict=True):
        sun = comet.comet_from_J2000(t) @ comet.sun_J2000(data_dir, t)
        assert np.degrees(np.arcsin(sun[2])) == pytest.approx(37.2, abs=0.3)
        assert sun @ state[:3] > 0.5 * np.linalg.norm(state[:3])
    fixed = states[2, 3:] - states[1, 3:]
    space = comet.comet_from_J2000(times[1]) @ np.subtract(
        *(comet.velocity_J2000(times[k], states[k]) for k in (2, 1))
    )
    down = -states[1, :3] / np.linalg.norm(states[1, :3])
    away = [np.degrees(np.arccos(x @ down / np.linalg.norm(x))) for x in (fixed, space)]
    assert away[1] < 6 < 15 < away[0]
