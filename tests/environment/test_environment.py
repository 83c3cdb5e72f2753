"""The environment that is not known, and the names of frames on results with an attitude."""

import numpy as np

import sunspin as ss
from sunspin.environment import unknown
from sunspin.environment.frames import BODY_AT_START, SUN_Z_LOCAL
from vehicles import FIRST_SUN, philae_body


def test_of_an_unknown_environment_only_the_sun_is_known_and_stands_still():
    nothing = unknown()
    found = nothing.at([0.0, 50.0, 1e6])
    assert nothing.frame_N == SUN_Z_LOCAL and found.sun_N.shape == (3, 3)
    assert np.array_equal(found.sun_N, np.tile([0.0, 0.0, 1.0], (3, 1)))
    assert found.field_N is None and found.nadir_N is None and found.lit is None


def test_an_attitude_says_which_frame_it_is_from():
    run = ss.propagate(philae_body(), [0.1, 0.0, 0.0], FIRST_SUN, 0.0, [0.0, 10.0])
    assert run.attrs["frame_N"] == BODY_AT_START
    assert np.array_equal(run["B_from_N"].values[0], [0.0, 0.0, 0.0, 1.0])
