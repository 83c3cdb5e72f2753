"""The ensemble kernel against the reference propagator; its bits against its neighbours."""

import numpy as np
import pytest

import sunspin as ss
from sunspin.motion import kernel as k
from vehicles import FIRST_SUN, philae_body, random_vehicle


def rows_of(omega, speeds) -> k.Rows:
    n = len(omega)
    return k.Rows(np.asarray(omega, float), np.tile(FIRST_SUN, (n, 1)), np.tile(np.atleast_1d(speeds), (n, 1)))


def reference(vehicle, rows, duration, **options):
    ends = []
    for omega, sun, speeds in zip(rows.omega_B, rows.sun_B, rows.wheel_speed_rad_s, strict=True):
        run = ss.propagate(vehicle, omega, sun, speeds if len(speeds) else None, [0.0, duration], **options)
        ends.append(run["sun_B"].values[-1])
    return np.array(ends)


def philae_rows(n=40, seed=1):
    rng = np.random.default_rng(seed)
    return rows_of(np.column_stack([rng.uniform(-0.5, 1, (n, 2)), rng.uniform(-0.3, 0.3, n)]), 865.0)


@pytest.mark.parametrize("wanted", [1e-2, 1e-4, 1e-6])
def test_the_error_asked_for_is_met_through_the_wheel_stop(wanted):
    vehicle, rows = philae_body(), philae_rows()
    result = k.run_rows(vehicle, rows, 2700.0, direction_error=wanted)
    error = np.linalg.norm(result.track[:, 0, 4:] - reference(vehicle, rows, 2700.0), axis=1)
    assert error.max() < wanted
    assert np.all(result.outcome == k.Outcome.FINE)


@pytest.mark.parametrize("n_wheels", [0, 1, 2])
@pytest.mark.parametrize("mode", ["coast", "hold"])
def test_other_vehicles_with_stops_and_breakaways(n_wheels, mode):
    rng = np.random.default_rng(100 + n_wheels)
    vehicle = random_vehicle(rng, n_wheels, dry=0.004, viscous=2e-4)
    rows = rows_of(rng.normal(size=(12, 3)) * 0.5, rng.uniform(-20, 20, n_wheels))
    result = k.run_rows(vehicle, rows, 120.0, direction_error=1e-6, wheel_mode=mode)
    expected = reference(vehicle, rows, 120.0, wheel_mode=mode)
    np.testing.assert_allclose(result.track[:, 0, 3 + n_wheels :], expected, atol=1e-5)


def test_backward_run():
    vehicle, rows = philae_body(), philae_rows(8)
    result = k.run_rows(vehicle, rows, -56.0, direction_error=1e-8)
    np.testing.assert_allclose(result.track[:, 0, 4:], reference(vehicle, rows, -56.0), atol=1e-8)


def test_backward_through_reversals_of_the_wheel():
    vehicle = random_vehicle(np.random.default_rng(1), 1, dry=0.001)
    rows = rows_of([[0.8, 0.5, -0.6], [-0.9, 0.7, 0.8]], 0.1)
    back = ss.propagate(vehicle, rows.omega_B[0], FIRST_SUN, 0.1, [0.0, -30.0])
    assert "reverses" in back["event_what"].values
    result = k.run_rows(vehicle, rows, -30.0, direction_error=1e-7)
    np.testing.assert_allclose(result.track[:, 0, 4:], reference(vehicle, rows, -30.0), atol=1e-6)


def test_backward_from_rest_is_an_outcome_and_not_a_number():
    result = k.run_rows(philae_body(), rows_of([[0.1, 0.2, 0.3]], 0.0), -60.0)
    assert result.outcome[0] == k.Outcome.PAST_UNKNOWN


def test_the_order_of_accuracy_is_eight():
    vehicle, rows = random_vehicle(np.random.default_rng(3), 0), rows_of([[0.3, -0.4, 0.5]], [])
    exact = reference(vehicle, rows, 40.0)
    errors = []
    for steps in (32, 64):
        result = k.run_rows(vehicle, rows, 40.0, direction_error=1.0, min_steps=steps)
        errors.append(np.linalg.norm(result.track[0, 0, 3:] - exact[0]))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(8, abs=0.8)


def test_output_times_are_those_of_one_run():
    vehicle, rows = philae_body(), philae_rows(5)
    times = np.array([130.0, 1000.0, 2600.0])
    result = k.run_rows(vehicle, rows, times, direction_error=1e-8)
    run = ss.propagate(vehicle, rows.omega_B[0], FIRST_SUN, 865.0, [0.0, *times])
    np.testing.assert_allclose(result.track[0, :, 4:], run["sun_B"].values[1:], atol=1e-7)


def test_bits_of_a_row_do_not_depend_on_its_neighbours():
    vehicle, rows = philae_body(), philae_rows(70)
    together = k.run_rows(vehicle, rows, 2700.0, direction_error=1e-3, bins=64)
    order = np.random.default_rng(0).permutation(70)
    shuffled = k.run_rows(vehicle, rows.take(order), 2700.0, direction_error=1e-3, bins=64)
    alone = k.run_rows(vehicle, rows.take(np.array([17])), 2700.0, direction_error=1e-3, bins=64)
    assert np.array_equal(together.hist[order], shuffled.hist)
    assert np.array_equal(together.hist[17], alone.hist[0])


def test_invariants_of_the_kernel_stay_within_the_error_asked_for():
    vehicle, rows = philae_body(), philae_rows(20)
    wanted = 1e-4
    end = k.run_rows(vehicle, rows, 2700.0, direction_error=wanted).track[:, 0]
    start = k.work_array(vehicle, rows, ("coast",))[:, :7]
    for pick in (lambda y: np.linalg.norm(y[:, :3], axis=1), lambda y: np.linalg.norm(y[:, 4:], axis=1)):
        assert np.abs(pick(end) / pick(start) - 1).max() < wanted


def test_an_edit_to_the_physics_is_another_kernel(monkeypatch):
    from sunspin.motion import compiled, gyrostat

    structure = k.structure_of(philae_body(), None, 0)
    before = compiled.source(structure)
    monkeypatch.setattr(gyrostat, "cross", lambda a, b: (0 * a[0], 0 * a[0], 0 * a[0]))
    assert compiled.source(structure) != before
