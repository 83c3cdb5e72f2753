"""Gravity gradient in the reference propagator and the kernel."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.dynamics import batch
from sunspin.dynamics.torques import acting
from sunspin.environment import circular
from sunspin.vehicle import Panel, Vehicle

N = 1.1e-3
ROLL, PITCH, YAW = 2.0, 2.5, 1.0
BODY = Vehicle("body", np.diag([ROLL, PITCH, YAW]), panels=[Panel("z", [0, 0, 1], 1.0)])
ORBIT = circular(N, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
LIBRATION = np.sqrt(3 * N**2 * (ROLL - YAW) / PITCH)
AMPLITUDE = 1e-3
START = Rotation.from_rotvec([0.0, -AMPLITUDE, 0.0])
OMEGA, SUN = np.array([0.0, N, 0.0]), START.apply([0.0, 0.0, 1.0])
TIMES = np.linspace(0.0, 12 * 2 * np.pi / LIBRATION, 901)


def propagated() -> np.ndarray:
    pull = {"environment": ORBIT, "torques": ["gravity_gradient"], "B_from_N": START.as_quat()}
    return ss.propagate(BODY, OMEGA, SUN, None, TIMES, **pull)["nadir_B"].values


def seen_nadir(turned: np.ndarray) -> np.ndarray:
    """The nadir in body axes at all times, of rotations of the body since the start at all but the first."""
    nadir_N = ORBIT.at(TIMES).nadir_N
    at_start = START.apply(nadir_N)
    return np.vstack([at_start[:1], np.einsum("nij,nj->ni", turned, at_start[1:])])


def in_the_kernel() -> np.ndarray:
    rows = batch.Rows(OMEGA[None], SUN[None], np.zeros((1, 0)), B_from_N=START.as_quat()[None])
    forces = acting(["gravity_gradient"], ORBIT)
    run = batch.run(BODY, rows, TIMES[1:], error=1e-6, acting=forces, attitude=True)
    return seen_nadir(run.attitude[0])


@pytest.mark.evidence(
    "propagate", "verified", "closed form of a small libration under gravity gradient"
)
@pytest.mark.parametrize("moved", [propagated, in_the_kernel])
def test_a_body_librates_about_the_nadir_at_the_rate_of_the_closed_form(moved, reached):
    nadir = moved()
    angle = np.arctan2(nadir[:, 0], nadir[:, 2])
    assert np.abs(angle).max() == pytest.approx(AMPLITUDE, rel=1e-3)
    at = np.flatnonzero(np.diff(np.sign(angle)))
    crossed = TIMES[at] - angle[at] * (TIMES[at + 1] - TIMES[at]) / (angle[at + 1] - angle[at])
    found = np.pi * (len(crossed) - 1) / (crossed[-1] - crossed[0])
    reached("relative error of the libration's rate", abs(found / LIBRATION - 1))
    assert found == pytest.approx(LIBRATION, rel=1e-6)
