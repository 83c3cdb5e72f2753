"""Figures and pages of a simulated motion follow the body between output times that are far apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import sunspin as ss
from sunspin.dynamics.curve import along_curve, with_curve
from sunspin.output.kinds.motion import trajectory_figure
from sunspin.output.report.body import body_in_motion
from sunspin.output.report.read import Results
from sunspin.output.report.views import read_motions, sun_on_sphere
from sunspin.vehicle import Friction, Panel, Vehicle, Wheel

WHEEL = Wheel("w", [0, 1, 0], 6e-4, 310.0, Friction(2e-4, 4e-7))
BODY = Vehicle(
    "skipper", np.diag([0.31, 0.38, 0.29]), 12.4, [Panel("+X", [1, 0, 0], 1.0)], wheels=[WHEEL]
)
START = np.radians([4.0, -2.5, 1.5]), np.array([0.6, 0.0, 0.8])


def motion(times_s):
    return ss.propagate(BODY, *START, [310.0], times_s)


@pytest.fixture(scope="module", params=[1, -1])
def coarse(request):
    """A motion with output times 20 s apart, in which the body rotates by up to 200 degrees, forward and backward in time."""
    run = motion(request.param * np.arange(0.0, 601.0, 20.0))
    return with_curve(run, BODY.inertia_kg_m2, motion)


def test_a_motion_along_its_curve_is_the_one_propagated_to_these_times(coarse):
    bare = motion(np.arange(0.0, 10.0))
    assert along_curve(bare) is bare  # drawn at its output times
    curve = along_curve(coarse)
    assert curve.sizes["time"] > 3 * coarse.sizes["time"]
    close = motion(curve["time"].values)
    np.testing.assert_allclose(curve["omega_B"], close["omega_B"], atol=1e-9)
    np.testing.assert_allclose(curve["sun_B"], close["sun_B"], atol=1e-7)
    np.testing.assert_allclose(curve["momentum_B"], close["momentum_B"], atol=1e-7)
    # the speed falls along an exponential, of which 20 s are nearly straight
    np.testing.assert_allclose(curve["wheel_speed_rad_s"], close["wheel_speed_rad_s"], atol=0.05)


def test_lines_of_a_coarse_motion_take_no_short_cut(coarse):
    """Once they joined output times: chords through the sphere, rates that zigzag, and no body in motion."""
    results = Results(Path("."), "simulate", data={"trajectory": coarse}, vehicle=BODY)
    motions = read_motions(results)
    path = sun_on_sphere(results, motions)
    (line,) = [trace for trace in path.figure.data if str(trace.name).startswith("path")]
    points = np.stack([line.x, line.y, line.z], axis=1)
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).max() < 0.5
    rate_lines = trajectory_figure(coarse).axes[0].lines
    assert len(rate_lines[0].get_xdata()) == coarse.sizes["curve_time"]
    assert len(list(body_in_motion(results, motions))) == 1
