"""Many motions at once, compared with the reference propagator; rows of other bodies; distributions of r_z; what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import wasserstein_distance

import sunspin as ss
from sunspin.base.errors import SunspinError
from sunspin.dynamics import batch
from sunspin.dynamics.bodies import Bodies
from tests.support.vehicles import FIRST_SUN, philae_body, random_vehicle, small_cube


def rows_of(omega, speeds) -> batch.Rows:
    n = len(omega)
    return batch.Rows(
        np.asarray(omega, float), np.tile(FIRST_SUN, (n, 1)), np.tile(np.atleast_1d(speeds), (n, 1))
    )


def reference(vehicle, rows, duration, **options):
    ends = []
    for omega, sun, speeds in zip(rows.omega_B, rows.sun_B, rows.wheel_speed_rad_s, strict=True):
        speeds = speeds if len(speeds) else None
        run = ss.propagate(vehicle, omega, sun, speeds, [0.0, duration], **options)
        ends.append(run["sun_B"].values[-1])
    return np.array(ends)


def philae_rows(n=40, seed=1):
    rng = np.random.default_rng(seed)
    omega = np.column_stack([rng.uniform(-0.5, 1, (n, 2)), rng.uniform(-0.3, 0.3, n)])
    return rows_of(omega, 865.0)


@pytest.mark.parametrize("wanted", [1e-2, 1e-4, 1e-6])
def test_the_kernel_meets_its_direction_error_through_the_wheel_stop(wanted):
    vehicle, rows = philae_body(), philae_rows()
    result = batch.run(vehicle, rows, 2700.0, error=wanted)
    error = np.linalg.norm(result.sun_B[:, 0] - reference(vehicle, rows, 2700.0), axis=1)
    assert error.max() < wanted
    assert np.all(result.outcome == batch.Outcome.FINE)


HARD = [[-0.275, 0.82, 0.285], [-0.335, 1.0, -0.165], [-0.35, 0.82, 0.21]]
"""Rates with which the second wheel is held and let go up to 17 times, once for much less than a step."""


@pytest.mark.parametrize("wanted", [1e-2, 1e-5, 1e-6, 1e-8])
def test_the_kernel_agrees_with_the_reference_on_a_wheel_held_and_released_repeatedly(wanted):
    """It may break away just at its limit, turn for a moment only, and stop within the same step."""
    vehicle = philae_body()
    (wheel,) = vehicle.wheels
    across = replace(wheel, name="across", axis_B=[1.0, 0.0, 0.0])
    vehicle = replace(vehicle, wheels=(wheel, across))
    rows = rows_of(HARD, [865.0, -605.5])
    result = batch.run(vehicle, rows, 2700.0, error=wanted)
    assert np.all(result.outcome == batch.Outcome.FINE)
    error = np.linalg.norm(result.sun_B[:, 0] - reference(vehicle, rows, 2700.0), axis=1)
    assert error.max() < wanted


@pytest.mark.parametrize("n_wheels", [0, 1, pytest.param(2, marks=pytest.mark.long)])
def test_distributions_of_random_vehicles_agree_with_the_reference(n_wheels):
    """Strongly unequal moments, oblique wheels that stop or not, slow and fast rows: EMD by SciPy, no mask."""
    rng = np.random.default_rng(200 + n_wheels)
    vehicle = random_vehicle(rng, n_wheels, dry=0.004, viscous=2e-4)
    omega = rng.normal(size=(6, 3)) * np.geomspace(0.02, 2.0, 6)[:, None]
    rows = rows_of(omega, rng.uniform(-20, 20, n_wheels))
    result = batch.sun_heights(vehicle, rows, 600.0)
    centres = (np.arange(256 * 8) + 0.5) / (128 * 8) - 1
    for i in range(len(rows)):
        speeds = rows.wheel_speed_rad_s[i] if n_wheels else None
        start, times = (rows.omega_B[i], FIRST_SUN, speeds), np.linspace(0, 600, 20_001)
        z = ss.propagate(vehicle, *start, times, rtol=1e-9)["sun_B"].values[:, 2]
        shares = np.repeat(result.seconds[i], 8).astype(float)
        assert wasserstein_distance(centres, z, shares) / 2 < 1.5e-3


def test_bits_of_a_distribution_do_not_depend_on_neighbours_or_on_the_method_of_others():
    """Some are near an unstable spin and computed again by series, wheels stop on the way."""
    vehicle, rows = philae_body(), philae_rows(150)
    together = batch.sun_heights(vehicle, rows, 2700.0, bins=80).seconds
    order = np.random.default_rng(1).permutation(150)
    shuffled = batch.sun_heights(vehicle, rows.take(order), 2700.0, bins=80).seconds
    assert np.array_equal(together[order], shuffled)
    alone = batch.sun_heights(vehicle, rows.take(np.array([7])), 2700.0, bins=80).seconds
    assert np.array_equal(together[7], alone[0])


def test_a_histogram_counts_time_and_is_the_same_forward_and_backward():
    vehicle, rows = random_vehicle(np.random.default_rng(8), 0), rows_of([[0.3, -0.4, 0.5]], [])
    forward = batch.sun_heights(vehicle, rows, 700.0).seconds
    assert forward.sum() == pytest.approx(700.0, rel=1e-4)
    end = batch.run(vehicle, rows, 700.0, error=1e-6)
    there = batch.Rows(end.omega_B[:, 0], end.sun_B[:, 0], end.wheel_speed_rad_s[:, 0])
    back = batch.sun_heights(vehicle, there, -700.0).seconds
    assert np.abs(np.cumsum(forward - back)).mean() / 700.0 < 2e-3  # EMD: each errs by 1e-3


def test_invalid_error_tolerances_of_the_kernel_are_refused():
    vehicle, rows = random_vehicle(np.random.default_rng(8), 0), rows_of([[0.3, -0.4, 0.5]], [])
    for options in ({"error": 0.0}, {"error": 1e-16}, {"error": np.nan}, {"emd_error": 1e-9}):
        with pytest.raises(ss.InputError, match="must be at least"):
            batch.sun_heights(vehicle, rows, 10.0, **options)
    with pytest.raises(ss.InputError, match="must be at least"):
        batch.run(vehicle, rows, 10.0, error=0.0)
    with pytest.raises(ss.InputError, match="found both"):
        batch.sun_heights(vehicle, rows, 10.0, error=1e-3, emd_error=1e-3)


def test_absurd_rates_and_too_many_wheels_are_refused_in_a_sentence():
    vehicle = random_vehicle(np.random.default_rng(8), 0)
    with pytest.raises(ss.MotionError, match="needs .* steps; shorten the window"):
        batch.run(vehicle, rows_of([[1e6, 0.0, 0.0]], []), 2700.0)
    many = random_vehicle(np.random.default_rng(8), 8)
    with pytest.raises(ss.MotionError, match="may have 4 wheels at most .found 8 wheels"):
        batch.run(many, rows_of([[0.3, -0.4, 0.5]], np.ones(8)), 10.0)


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


def test_one_motion_that_exceeds_its_steps_does_not_end_the_others():
    cube, sun = small_cube(), np.tile([0.6, 0.0, 0.8], (2, 1))
    rows = batch.Rows(np.array([[0.1, 0.0, 0.0], [1e6, 0.0, 0.0]]), sun, np.zeros((2, 0)))
    with pytest.raises(SunspinError, match="needs"):
        batch.run(cube, rows, [100.0])
    run = batch.run(cube, rows, [100.0], leave_long=True)
    assert run.outcome.tolist() == [batch.Outcome.FINE, batch.Outcome.NOT_FINITE]
    alone = batch.run(cube, rows.take(np.array([0])), [100.0])
    np.testing.assert_array_equal(run.sun_B[0], alone.sun_B[0])
    assert np.isnan(run.sun_B[1]).all()
