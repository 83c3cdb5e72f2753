"""Many motions at once: distributions of r_z, rows of other bodies, what is refused."""

from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.dynamics import batch
from sunspin.dynamics.bodies import Bodies
from tests.support.vehicles import FIRST_SUN, philae_body, random_vehicle, small_cube


def rows_of(omega, speeds) -> batch.Rows:
    n = len(omega)
    return batch.Rows(
        np.asarray(omega, float), np.tile(FIRST_SUN, (n, 1)), np.tile(np.atleast_1d(speeds), (n, 1))
    )


def test_bits_of_a_distribution_do_not_depend_on_neighbours_or_on_the_method_of_others():
    """Some are near an unstable spin and computed again by series, wheels stop on the way."""
    rng, vehicle = np.random.default_rng(1), philae_body()
    omega = np.column_stack([rng.uniform(-0.5, 1, (150, 2)), rng.uniform(-0.3, 0.3, 150)])
    rows = rows_of(omega, 865.0)
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


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"error": 0.0}, "must be at least"),
        ({"error": 1e-16}, "must be at least"),
        ({"error": np.nan}, "must be at least"),
        ({"emd_error": 1e-9}, "must be at least"),
        ({"error": 1e-3, "emd_error": 1e-3}, "found both"),
        ({"command": [(0.0, "coast"), (30.0, "hold")]}, "one command per wheel"),
    ],
)
def test_invalid_error_tolerances_of_the_kernel_are_refused(options, message):
    """So are schedules of commands, which a distribution cannot have."""
    vehicle, rows = random_vehicle(np.random.default_rng(8), 1), rows_of([[0.3, -0.4, 0.5]], 1.0)
    with pytest.raises(ss.InputError, match=message):
        batch.sun_heights(vehicle, rows, 10.0, **options)
    if options == {"error": 0.0}:
        with pytest.raises(ss.InputError, match=message):
            batch.run(vehicle, rows, 10.0, **options)


def test_absurd_rates_and_too_many_wheels_are_refused_in_a_sentence():
    vehicle, absurd = random_vehicle(np.random.default_rng(8), 0), rows_of([[1e6, 0.0, 0.0]], [])
    for follow in (batch.run, batch.sun_heights):
        with pytest.raises(ss.MotionError, match="needs .* steps; shorten the window"):
            follow(vehicle, absurd, 2700.0)
    many = random_vehicle(np.random.default_rng(8), 8)
    with pytest.raises(ss.MotionError, match="may have 4 wheels at most .found 8 wheels"):
        batch.run(many, rows_of([[0.3, -0.4, 0.5]], np.ones(8)), 10.0)


def test_a_wheel_without_friction_is_not_held_at_rest_by_the_friction_of_others():
    vehicle = philae_body()
    bodies = Bodies.of(vehicle, 2)
    bodies = replace(bodies, coulomb_N_m=np.array([[0.0], [1e-3]]), viscous_N_m_s=np.zeros((2, 1)))
    still = batch.Rows(np.full((2, 3), 0.05), np.tile(FIRST_SUN, (2, 1)), np.zeros((2, 1)), bodies)
    speeds = batch.run(vehicle, still, np.array([50.0, 100.0]), error=1e-8).wheel_speed_rad_s
    assert np.all(speeds[0] != 0) and np.all(speeds[1] == 0)


def test_one_motion_that_exceeds_its_steps_does_not_end_the_others(monkeypatch):
    monkeypatch.setattr(batch, "MAX_STEPS", 1000)
    cube, rows = small_cube(), rows_of([[0.1, 0.0, 0.0], [1e3, 0.0, 0.0]], [])
    with pytest.raises(ss.MotionError, match="needs"):
        batch.run(cube, rows, [100.0])
    run = batch.run(cube, rows, [100.0], leave_long=True)
    assert run.outcome.tolist() == [batch.Outcome.FINE, batch.Outcome.NOT_FINITE]
    alone = batch.run(cube, rows.take(np.array([0])), [100.0])
    np.testing.assert_array_equal(run.sun_B[0], alone.sun_B[0])
    assert np.isnan(run.sun_B[1]).all()
