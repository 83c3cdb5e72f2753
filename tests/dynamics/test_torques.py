"""External torques in the reference propagator and the kernel, compared with SciPy; what is refused."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.dynamics import batch
from sunspin.dynamics.bodies import Bodies
from sunspin.dynamics.torques import Acting, Steady, acting
from sunspin.environment import circular, unknown
from sunspin.vehicle import Friction, Vehicle, Wheel

RATE, NORMAL, NADIR = 2e-2, np.array([0.0, 0.6, 0.8]), (1.0, 0.0, 0.0)
ORBIT = circular(RATE, NORMAL, NADIR)
START_S = 40.0
"""The motions begin there, not at zero of the environment's clock."""


PULL = ["gravity_gradient"]

WHEEL = Wheel("w", [0.0, 0.6, 0.8], 0.02, 3.0, Friction(1e-4, 1e-4))
BODY = Vehicle("body", [[1.0, 0.02, 0.0], [0.02, 1.3, 0.01], [0.0, 0.01, 0.8]], wheels=[WHEEL])
OMEGA = np.array([0.03, -0.02, 0.05])
SPEED = 3.0
ATTITUDE = Rotation.from_euler("xyz", [0.4, -0.3, 1.1])
SUN = ATTITUDE.apply([0.0, 0.0, 1.0])
PULLED = {"environment": ORBIT, "torques": PULL, "B_from_N": ATTITUDE.as_quat()}


def by_scipy(body: Vehicle, torque, t_end: float, t_start: float = 0.0, frame=ATTITUDE):
    """Rate, wheel speed and attitude as a matrix, from Euler's equations with a wheel, and its friction, typed here.

    `torque` (N m) is a function of time and attitude; a body without a wheel has one along no axis.
    """
    inertia, j = np.array(body.inertia_kg_m2), 0.02
    axis, friction = (WHEEL.axis_B, 1e-4) if body.wheels else (np.zeros(3), 0.0)
    inverse = np.linalg.inv(inertia - j * np.outer(axis, axis))

    def slope(t, y):
        omega, speed, matrix = y[:3], y[3], y[4:].reshape(3, 3)
        slowing = -friction * (np.sign(speed) + speed)
        momentum = inertia @ omega + j * speed * axis
        change = inverse @ (torque(t, matrix) - np.cross(omega, momentum) - slowing * axis)
        turning = -np.cross(omega, matrix, axisb=0, axisc=0)
        return np.concatenate([change, [slowing / j - axis @ change], turning.ravel()])

    begin = np.concatenate([OMEGA, [SPEED], frame.as_matrix().ravel()])
    accuracy = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14}
    y = solve_ivp(slope, (t_start, t_end), begin, **accuracy).y[:, -1]
    return y[:3], y[3], y[4:].reshape(3, 3)


def pull(t: float, matrix: np.ndarray) -> np.ndarray:
    """The torque of the gravity gradient along the orbit."""
    angle = RATE * t
    nadir = matrix @ (np.cos(angle) * np.array(NADIR) + np.sin(angle) * np.cross(NORMAL, NADIR))
    return 3 * RATE**2 * np.cross(nadir, np.array(BODY.inertia_kg_m2) @ nadir)


def run_once(t_s, **options):
    return ss.propagate(BODY, OMEGA, SUN, SPEED, t_s, **PULLED | options)


@pytest.mark.parametrize("t_end", [240.0, -60.0])
def test_the_reference_under_torques_agrees_with_scipy_forward_and_backward(t_end):
    run = run_once([START_S, t_end])
    omega, speed, matrix = by_scipy(BODY, pull, t_end, START_S)
    np.testing.assert_allclose(run["omega_B"].values[-1], omega, atol=1e-10)
    np.testing.assert_allclose(run["wheel_speed_rad_s"].values[-1], [speed], atol=1e-8)
    attitude = Rotation.from_quat(run["B_from_N"].values[-1]).as_matrix()
    np.testing.assert_allclose(attitude, matrix, atol=1e-9)
    np.testing.assert_allclose(run["sun_B"].values[-1], matrix @ [0, 0, 1], atol=1e-9)
    nadir = matrix @ ORBIT.at(t_end).nadir_N[0]
    np.testing.assert_allclose(run["nadir_B"].values[-1], nadir, atol=1e-9)
    assert run.attrs["frame_N"] == ORBIT.frame_N


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"environment": None, "B_from_N": None}, "the torque .* needs an environment; give one"),
        ({"environment": unknown()}, "needs the nadir, which the environment does not know"),
        ({"torques": ["magic"]}, "no such torque .found magic."),
        ({"torques": [run_once]}, "no such torque .found <function .*choose from gravity_gradient"),
        ({"torques": "gravity_gradient"}, "torques must be a list"),
    ],
)
def test_a_torque_is_refused_without_the_environment_that_it_needs(options, words):
    with pytest.raises(ss.MotionError, match=words) as refused:
        run_once([0.0, 1.0], **options)
    assert "environment" not in options or "the torque 'gravity_gradient'" in str(refused.value)


def test_an_attitude_and_a_sun_that_contradict_each_other_are_refused():
    words = "sun_B is not where B_from_N shows the environment's Sun .found 0.49 rad away"
    with pytest.raises(ss.MotionError, match=words):
        run_once([0.0, 1.0], B_from_N=[0.0, 0.0, 0.0, 1.0])
    with pytest.raises(ss.MotionError, match="B_from_N must be a unit quaternion"):
        run_once([0.0, 1.0], B_from_N=[0.0, 0.0, 1.0])
    with pytest.raises(ss.MotionError, match="B_from_N is the attitude in an environment"):
        ss.propagate(BODY, OMEGA, SUN, SPEED, [0.0, 1.0], B_from_N=ATTITUDE.as_quat())


def test_rows_need_their_attitude_under_torques_that_depend_on_directions():
    rows = batch.Rows(OMEGA[None], SUN[None], np.array([[SPEED]]))
    words = "torques that depend on directions need the attitude of each row; give B_from_N"
    with pytest.raises(ss.InputError, match=words):
        batch.run(BODY, rows, 1.0, acting=acting(PULL, ORBIT))


def test_a_scan_under_torques_agrees_with_the_reference():
    times = START_S + np.array([20.0, 40.0])
    track = run_once([START_S, *times])["sun_B"].isel(time=[1, 2])
    track = track.assign_coords(time=[20.0, 40.0]).to_dataset()
    grid = [[rate, rate + 0.02] for rate in OMEGA]
    pulled = ss.Propagation(direction_error=1e-8, start_s=START_S, **PULLED)
    found = ss.scan(BODY, track, SUN, *grid, SPEED, propagation=pulled)
    assert found.values[0, 0, 0] < 1e-12 < found.values.ravel()[1:].min()
    free = ss.Propagation(direction_error=1e-8)
    other = ss.scan(BODY, track, SUN, *grid, SPEED, propagation=free)
    assert other.values[0, 0, 0] > 1e-7  # the control: without the torque it is another motion


def test_distributions_under_torques_agree_with_the_reference():
    rows = batch.Rows(
        OMEGA[None], SUN[None], np.array([[SPEED]]), B_from_N=ATTITUDE.as_quat()[None]
    )
    result = batch.sun_heights(BODY, rows, 300.0, acting=acting(PULL, ORBIT, START_S))
    z = run_once(START_S + np.linspace(0.0, 300.0, 40001))["sun_B"].values[:, 2]
    expected = np.histogram(z, 256, (-1, 1))[0] / len(z)
    assert np.abs(np.cumsum(result.seconds[0] / 300.0 - expected)).max() < 5e-3


@pytest.mark.evidence(
    "propagate", "verified", "steady torques in body axes and in space against SciPy's integrator"
)
def test_steady_torques_in_body_axes_and_in_space_turn_a_body_as_eulers_equations_say():
    body, t = Vehicle("box", np.diag([0.010, 0.012, 0.008])), [150.0, 300.0]
    torques = 0.01 * np.array([[1e-4, -2e-4, 1e-4], [2e-4, 1e-4, -1e-4]])
    cases = np.stack([torques * [[1], [0]], torques * [[0], [1]], torques])
    bodies = replace(Bodies.of(body, 3), steady_N_m=cases)
    rows = batch.Rows(np.tile(OMEGA, (3, 1)), np.tile(SUN, (3, 1)), np.zeros((3, 0)), bodies)
    run = batch.run(body, rows, t, error=1e-8, acting=Acting((Steady(),)))
    for i, case in enumerate(cases):
        # N is B at the start
        torque = partial(lambda case, _, matrix: case[0] + matrix @ case[1], case)
        omega, _, matrix = by_scipy(body, torque, t[-1], frame=Rotation.identity())
        reference = ss.propagate(body, OMEGA, SUN, None, [0.0, *t], torques=[Steady(case)])
        for found in (run.sun_B[i, -1], reference["sun_B"].values[-1]):
            np.testing.assert_allclose(found, matrix @ SUN, atol=1e-7)
        np.testing.assert_allclose(run.omega_B[i, -1], omega, atol=1e-9)
    # the control: the two kinds are not the same
    assert np.linalg.norm(run.sun_B[0, -1] - run.sun_B[1, -1]) > 0.1
