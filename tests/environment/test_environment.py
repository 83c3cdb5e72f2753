"""The unknown environment and circular orbits."""

import numpy as np
import pytest

import sunspin as ss
from sunspin.environment import circular, unknown
from sunspin.environment.frames import SUN_Z_LOCAL


def test_an_unknown_environment_gives_only_a_fixed_sun():
    nothing = unknown()
    found = nothing.at([0.0, 50.0, 1e6])
    assert nothing.frame_N == SUN_Z_LOCAL and found.sun_N.shape == (3, 3)
    assert np.array_equal(found.sun_N, np.tile([0.0, 0.0, 1.0], (3, 1)))
    assert found.field_N is None and found.nadir_N is None and found.lit is None


def test_the_nadir_of_a_circular_orbit_rotates_evenly_about_the_orbit_normal():
    orbit = circular(2e-3, [0.0, 0.0, 5.0], [0.0, 3.0, 1.0])
    assert orbit.frame_N == SUN_Z_LOCAL
    found = orbit.at([0.0, np.pi / 4e-3, 100.0, 100.001])
    np.testing.assert_allclose(found.nadir_N[:2], [[0, 1, 0], [-1, 0, 0]], atol=1e-15)
    turn = (found.nadir_N[3] - found.nadir_N[2]) / 0.001
    np.testing.assert_allclose(np.cross(found.nadir_turn_N[2], found.nadir_N[2]), turn, atol=1e-8)
    assert np.array_equal(orbit.at(100.0).nadir_N, found.nadir_N[2:3])


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ((0.0, [0, 0, 1]), "the rate of an orbit must be positive, in rad/s .found 0.0"),
        ((1e-3, [1, 0, 0]), "the nadir lies along the orbit's normal; give a nadir across it"),
        ((1e-3, [0, 0, 0]), "the nadir lies along"),
        ((1e-3, [0, 0, 1], [0, 0, 0]), "the nadir lies along"),
        ((1e-3, [0, 1]), "normal and nadir of an orbit must be three finite numbers each"),
    ],
)
def test_an_orbit_without_valid_radius_and_normal_is_refused(given, text):
    with pytest.raises(ss.InputError, match=text):
        circular(*given)
