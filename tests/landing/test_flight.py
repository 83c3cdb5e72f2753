"""Chains of kernel runs compared with the reference propagator, its schedules and its attitude."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.dynamics.batch import Rows
from sunspin.landing.flight import fly, rz_time_shares, transfer_directions
from sunspin.vehicle import Friction, Vehicle, Wheel
from tests.support.vehicles import FIRST_SUN

SUN = FIRST_SUN / np.linalg.norm(FIRST_SUN)
SCHEDULES = {
    **{"off": ((0.0, "coast"),), "held": ((0.0, "hold"),)},
    "delayed": ((0.0, "hold"), (700.0, "coast")),
    "braked after a while": ((0.0, "coast"), (300.0, "brake")),
}


def rows(n=6, seed=0) -> Rows:
    omega = np.random.default_rng(seed).normal(size=(n, 3)) * 0.2
    return Rows(omega, np.tile(SUN, (n, 1)), np.full((n, 1), 865.0))


@pytest.mark.parametrize("name", SCHEDULES)
def test_a_chain_of_kernel_runs_agrees_with_the_reference_schedule(name):
    """Rates, Sun, wheel speed and any other fixed direction, also after the brake has stopped the wheel."""
    vehicle = ss.load_vehicle("philae")
    start = rows()
    times = np.array([100.0, 500.0, 1000.0, 1400.0])
    track = fly(vehicle, start, SCHEDULES[name], 0.0, times)
    fixed = np.tile([0.6, -0.48, 0.64], (6, 1))
    momentum = fly(vehicle, start, SCHEDULES[name], 0.0, np.array([1e-3])).momentum_B[:, 0]
    carried = transfer_directions(fixed, (momentum, start.sun_B), (track.momentum_B, track.sun_B))
    for i in range(len(start)):
        flight = start.omega_B[i], SUN, 865.0, [0.0, *times]
        run = ss.propagate(vehicle, *flight, wheel_mode=list(SCHEDULES[name]), rtol=1e-11)
        for key, tolerance in (("sun_B", 2e-2), ("omega_B", 1e-2), ("wheel_speed_rad_s", 0.02)):
            found = getattr(track, key)[i]
            np.testing.assert_allclose(found, run[key].values[1:], atol=tolerance)
        # of N's first axis
        image = Rotation.from_quat(run["B_from_N"].values[1:]).apply([1.0, 0.0, 0.0])
        first = np.tile([1.0, 0.0, 0.0], (6, 1))
        turned = (momentum, start.sun_B), (track.momentum_B, track.sun_B)
        np.testing.assert_allclose(transfer_directions(first, *turned)[i], image, atol=5e-2)
    np.testing.assert_allclose(np.linalg.norm(carried, axis=-1), 1.0, atol=1e-9)


def test_a_flight_backward_and_forward_returns_to_its_start():
    vehicle, start = ss.load_vehicle("philae"), rows()
    back = fly(vehicle, start, ((-np.inf, "coast"),), 56.0, np.array([0.0]))
    again = fly(vehicle, back.at(0), SCHEDULES["off"], 0.0, np.array([56.0]))
    np.testing.assert_allclose(again.omega_B[:, 0], start.omega_B, atol=1e-3)
    np.testing.assert_allclose(again.wheel_speed_rad_s[:, 0], 865.0, atol=1e-2)
    assert np.all(back.wheel_speed_rad_s > 890)


def test_shares_of_time_agree_with_a_dense_track_and_sum_to_one():
    vehicle, start = ss.load_vehicle("philae"), rows(3)
    share, outcome = rz_time_shares(vehicle, start, SCHEDULES["delayed"], 0.0, 1400.0, 80)
    np.testing.assert_allclose(share.sum(axis=1), 1.0, rtol=1e-12)
    assert not outcome.any()
    t = np.arange(0.0, 1400.0, 0.25)
    for i in range(3):
        flight, schedule = (start.omega_B[i], SUN, 865.0, t), list(SCHEDULES["delayed"])
        run = ss.propagate(vehicle, *flight, wheel_mode=schedule, rtol=1e-9)
        dense = np.histogram(run["sun_B"].values[:, 2], 80, (-1, 1))[0] / t.size
        assert np.abs(np.cumsum(share[i]) - np.cumsum(dense)).max() < 0.01


def test_shares_of_time_weigh_each_part_of_the_flight_by_its_duration():
    """At rest for 700 s with the wheel held; friction then turns the body about x by torque t^2 / (2 inertia) for 300 s more."""
    wheel = Wheel("w", [1, 0, 0], 0.01, 100.0, Friction(1e-4, 0.0))
    craft = Vehicle("wheel on x", np.diag([3.0, 2.5, 2.0]), wheels=[wheel])
    start = Rows(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.array([[100.0]]))
    share, _ = rz_time_shares(craft, start, SCHEDULES["delayed"], 0.0, 1000.0, 80)
    # s until r_z leaves the highest bin
    moved = np.sqrt(2 * (3.0 - 0.01) * np.arccos(1 - 2 / 80) / 1e-4)
    assert share[0, -1] == pytest.approx((700 + moved) / 1000, abs=0.01)
