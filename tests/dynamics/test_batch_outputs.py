"""The kernel's output times, and rows with their own inertia and friction."""

from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.dynamics import batch
from sunspin.dynamics.bodies import Bodies
from tests.support.vehicles import FIRST_SUN, philae_body, random_vehicle

TIMES = np.array([100.0, 900.0, 1800.0])


def rows_for(vehicle, n=5, seed=2, speed=None):
    rng = np.random.default_rng(seed)
    speeds = np.array([speed or wheel.speed_rad_s for wheel in vehicle.wheels])
    return batch.Rows(
        rng.uniform(-0.3, 0.3, (n, 3)), np.tile(FIRST_SUN, (n, 1)), np.tile(speeds, (n, 1))
    )


def variants(vehicle, n, seed=3):
    """The vehicle with other inertia and friction, n times."""
    rng = np.random.default_rng(seed)

    def other(wheel):
        coulomb, viscous = wheel.friction.coulomb_N_m, wheel.friction.viscous_N_m_s
        inertia = wheel.inertia_kg_m2 * rng.uniform(0.9, 1.1)
        friction = ss.Friction(coulomb * rng.uniform(0.5, 2), viscous)
        return replace(wheel, inertia_kg_m2=inertia, friction=friction)

    found = []
    for _ in range(n):
        stretch = np.diag(rng.uniform(0.9, 1.1, 3))
        inertia = stretch @ vehicle.inertia_kg_m2 @ stretch
        wheels = tuple(map(other, vehicle.wheels))
        found.append(replace(vehicle, inertia_kg_m2=inertia, wheels=wheels))
    return found


@pytest.mark.parametrize("mode", ["coast", "hold"])
@pytest.mark.parametrize("n_wheels", [0, 1, 2])
def test_rates_and_wheel_speeds_at_output_times_agree_with_the_reference(n_wheels, mode):
    """Wheels of 40 rad/s stop, and are stuck, before the last instant."""
    body = random_vehicle(np.random.default_rng(5), n_wheels, dry=1e-3)
    vehicle = philae_body() if n_wheels == 1 else body
    rows = rows_for(vehicle, speed=40.0)
    run = batch.run(vehicle, rows, TIMES, command=mode, error=1e-9)
    assert n_wheels == 0 or mode == "hold" or np.any(run.wheel_speed_rad_s[:, -1] == 0)
    for i in range(len(rows)):
        speeds = rows.wheel_speed_rad_s[i] if n_wheels else None
        start = rows.omega_B[i], rows.sun_B[i], speeds
        exact = ss.propagate(vehicle, *start, [0.0, *TIMES], wheel_mode=mode)
        for name, tolerance in (("omega_B", 1e-7), ("wheel_speed_rad_s", 1e-6)):
            np.testing.assert_allclose(getattr(run, name)[i], exact[name][1:], atol=tolerance)
        np.testing.assert_allclose(run.momentum_B[i], exact["momentum_B"][1:], atol=1e-7)
        np.testing.assert_allclose(run.sun_B[i], exact["sun_B"][1:], atol=1e-7)


def test_a_row_with_its_own_inertia_and_friction_moves_like_such_a_vehicle():
    """And other numbers are another motion."""
    vehicle = philae_body()
    crafts = variants(vehicle, 4)
    rows = replace(rows_for(vehicle, 4), bodies=Bodies.stack(crafts))
    run = batch.run(vehicle, rows, 2700.0, error=1e-6)
    for i, craft in enumerate(crafts):
        one = np.array([i])
        alone = batch.run(craft, replace(rows.take(one), bodies=None), 2700.0, error=1e-6)
        np.testing.assert_allclose(run.states[i], alone.states[0], rtol=1e-9, atol=1e-9)
    same = batch.run(vehicle, replace(rows, bodies=None), 2700.0, error=1e-6)
    assert np.all(np.linalg.norm(run.sun_B - same.sun_B, axis=-1) > 1e-3)


def test_a_wheel_without_friction_is_not_held_at_rest_by_the_friction_of_others():
    vehicle = philae_body()
    bodies = Bodies.of(vehicle, 2)
    bodies = replace(bodies, coulomb_N_m=np.array([[0.0], [1e-3]]), viscous_N_m_s=np.zeros((2, 1)))
    still = batch.Rows(np.full((2, 3), 0.05), np.tile(FIRST_SUN, (2, 1)), np.zeros((2, 1)), bodies)
    speeds = batch.run(vehicle, still, np.array([50.0, 100.0]), error=1e-8).wheel_speed_rad_s
    assert np.all(speeds[0] != 0) and np.all(speeds[1] == 0)
