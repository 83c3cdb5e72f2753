"""Conventions of docs/conventions.md that could be reversed, each worked out by hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.dynamics.gyrostat import axial_momenta, free_inertia, kinetic_energy, total_momentum

QUARTER = np.pi / 2
BALL = ss.Vehicle("ball", inertia_kg_m2=np.eye(3) * 2)


def flywheel(coulomb_N_m: float = 0.0) -> ss.Vehicle:
    """A body with equal moments of 2 kg m2 and a wheel of 0.1 kg m2 about z."""
    wheel = ss.Wheel("w", [0, 0, 1], 0.1, friction=ss.Friction(coulomb_N_m))
    return ss.Vehicle("flywheel", np.eye(3) * 2, wheels=(wheel,))


def quarter_turn_about_z():
    """The body turns counterclockwise about its z axis, once by 90 degrees, and the Sun was on its x axis."""
    return ss.propagate(BALL, [0, 0, 0.1], [1, 0, 0], None, [0, QUARTER / 0.1]).isel(time=-1)


def test_a_body_that_rotates_left_sees_the_sun_move_right():
    np.testing.assert_allclose(quarter_turn_about_z()["sun_B"], [0, -1, 0], atol=1e-12)


def test_n_is_the_body_frame_at_the_first_time():
    run = ss.propagate(BALL, [0.3, -0.2, 0.1], [0, 0, 1], None, [5.0, 6.0])
    np.testing.assert_allclose(run["B_from_N"].values[0], [0, 0, 0, 1], atol=1e-15)
    assert np.abs(run["B_from_N"].values[1, :3]).min() > 0.01


def test_quaternions_are_scalar_last_and_take_n_components_to_b_components():
    q = quarter_turn_about_z()["B_from_N"].values
    q = q * np.sign(q[3])  # q and -q are the same turn
    np.testing.assert_allclose(q, [0, 0, -np.sqrt(0.5), np.sqrt(0.5)], atol=1e-12)
    np.testing.assert_allclose(Rotation.from_quat(q).apply([1, 0, 0]), [0, -1, 0], atol=1e-12)


def test_wheel_speed_is_relative_to_the_body_and_positive_about_its_axis():
    omega, speed = np.array([0, 0, 3.0]), np.array([10.0])
    assert axial_momenta(flywheel(), omega, speed) == pytest.approx(0.1 * (10 + 3))
    assert total_momentum(flywheel(), omega, speed) == pytest.approx([0, 0, 2 * 3 + 0.1 * 10])
    energy = 1.9 * 3**2 / 2 + 0.1 * 13**2 / 2
    assert kinetic_energy(flywheel(), omega, speed) == pytest.approx(energy)


def test_inertia_is_the_tensor_of_everything_with_minus_the_products():
    """Six masses: the sum of m r x (omega x r), and the element xy is minus the sum of m x y."""
    r = np.array(
        [[1, 1, 0], [-1, -1, 0], [0, 0.5, 0.7], [0, -0.5, -0.7], [0.2, 0, 1], [-0.2, 0, -1]]
    )
    tensor = np.einsum("ni,ni->", r, r) * np.eye(3) - r.T @ r
    omega = np.array([0.3, -0.1, 0.2])
    momentum = np.cross(r, np.cross(omega, r)).sum(axis=0)
    assert tensor[0, 1] == -2
    body = ss.Vehicle("six masses", tensor)
    assert total_momentum(body, omega, np.zeros(0)) == pytest.approx(momentum)
    free = free_inertia(flywheel(), [True])
    np.testing.assert_allclose(free, np.diag([2, 2, 1.9]), rtol=1e-12, atol=1e-15)


def test_friction_slows_the_wheel_and_drags_the_body_along():
    """dh/dt = -0.01 N m, H = 1 N m s: after 5 s h = 0.95, the body turns at 0.05 / 1.9, the wheel's way."""
    end = ss.propagate(flywheel(0.01), [0, 0, 0], [1, 0, 0], 10.0, [0, 5.0]).isel(time=-1)
    np.testing.assert_allclose(end["omega_B"], [0, 0, 0.05 / 1.9], atol=1e-14)
    np.testing.assert_allclose(end["wheel_speed_rad_s"], [0.95 / 0.1 - 0.05 / 1.9], atol=1e-12)
    back = ss.propagate(flywheel(0.01), [0, 0, 0], [1, 0, 0], -10.0, [0, 5.0]).isel(time=-1)
    np.testing.assert_allclose(back["omega_B"], -end["omega_B"], atol=1e-14)


def test_batch_axes_come_first_and_components_last():
    n = Rotation.random(20, random_state=3).apply([0, 0, 1]).reshape(4, 5, 3)
    philae = ss.load_vehicle("philae")
    power = ss.panel_power(philae, n)
    assert power.shape == (4, 5, 6)
    np.testing.assert_array_equal(power[2, 3], ss.panel_power(philae, n[2, 3]))
    assert ss.direction_error(n, n[0]).shape == (4,)


def test_directions_of_three_digits_are_taken_and_others_refused():
    rounded = np.array([0.6, 0.0, 0.8004])
    assert np.linalg.norm(ss.Panel("p", rounded, 1.0).normal_B) == pytest.approx(1, abs=1e-15)
    run = ss.propagate(BALL, [0, 0, 0.1], rounded, None, [0, 3.0])
    length = np.linalg.norm(rounded)  # as given
    assert np.linalg.norm(run["sun_B"].values[1]) == pytest.approx(length, abs=1e-14)
    with pytest.raises(ss.VehicleError, match="unit vector"):
        ss.Panel("p", [0.6, 0, 0.81], 1.0)
    with pytest.raises(ss.SunspinError, match="unit"):
        ss.propagate(BALL, [0, 0, 0.1], [0.6, 0, 0.81], None, [0, 3.0])


def test_philae_wheel_turns_about_z_and_panel_6_looks_along_it():
    philae = ss.load_vehicle("philae")
    np.testing.assert_array_equal(philae.wheels[0].axis_B, [0, 0, 1])
    np.testing.assert_array_equal(philae.panels[5].normal_B, [0, 0, 1])
    assert all(leg.tip_B_m[2] < 0 for leg in philae.legs)
