"""Draws of a posterior at other times: against the reference propagator, under each draw's own body, wheels and torque."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.dynamics.torques import Steady
from sunspin.estimate.lander.predict import DrawnMotions, best_motions, predict
from sunspin.vehicle import Friction, Panel, Vehicle, Wheel
from tests.support.philae import AS_DRAWN, philae_draws
from tests.support.posteriors import tree_of

PHILAE = AS_DRAWN.vehicle
TOUCHDOWN, LATER = 25143.98, 31800.0
SUN = np.array([0.48, 0.6, 0.64])


def box(*wheels: Wheel) -> Vehicle:
    """Return a 3U CubeSat with one panel and wheels."""
    panel, inertia = Panel("+x", (1, 0, 0), 7.0), np.diag([0.042, 0.040, 0.009])
    return Vehicle("box", inertia_kg_m2=inertia, panels=[panel], wheels=wheels)


def own_vehicle(vehicle: Vehicle, tree: xr.DataTree, draw: int) -> Vehicle:
    """Return a vehicle with inertia, friction and wheel inertia of one draw."""
    draws, inertia = tree["posterior"], np.array(vehicle.require_inertia())
    for k, axis in enumerate("xyz"):
        if f"inertia_{axis}{axis}" in draws:
            inertia[k, k] = draws[f"inertia_{axis}{axis}"].values[0, draw]
    wheels = []
    for wheel in vehicle.wheels:
        tail, stated = "" if len(vehicle.wheels) == 1 else f"_{wheel.name}", wheel.friction
        names = (f"log_{kind}{tail}" for kind in ("coulomb", "viscous", "wheel_inertia"))
        dry, viscous, axial = (
            np.exp(draws[name].values[0, draw]) if name in draws else 1.0 for name in names
        )
        friction = Friction(dry * stated.coulomb_N_m, viscous * stated.viscous_N_m_s)
        own = {"friction": friction, "inertia_kg_m2": axial * wheel.inertia_kg_m2}
        wheels.append(replace(wheel, **own))
    return replace(vehicle, inertia_kg_m2=inertia, wheels=tuple(wheels))


@pytest.mark.evidence(
    "posterior", "verified", "the reference propagator, through the wheel stop and backward"
)
def test_predicted_draws_agree_with_the_reference_through_the_wheel_stop_and_backward():
    """Each with its own inertia, friction and wheel speed; the wheel stops at about 2500 s."""
    tree = philae_draws(3, 0.003)
    times = [TOUCHDOWN, 25200.0, 27000.0, LATER]
    predicted, draws = predict(PHILAE, tree, times), tree["posterior"]
    for i in range(3):
        own = own_vehicle(PHILAE, tree, i)
        state = [draws[name].values[0, i] for name in ("omega_B", "sun_B", "wheel_speed_rad_s")]
        back = ss.propagate(own, *state, [0.0, TOUCHDOWN - 25200.0])
        on = ss.propagate(own, *state, np.array(times[1:]) - 25200.0)
        for name, tolerance in (("omega_B", 1e-4), ("sun_B", 5e-4), ("wheel_speed_rad_s", 1e-3)):
            got = predicted[name].values[0, i]
            np.testing.assert_allclose(got[0], back[name].values[-1], atol=tolerance)
            np.testing.assert_allclose(got[1:], on[name].values, atol=tolerance)
    assert np.all(predicted["wheel_speed_rad_s"].values[0, :, -1] == 0)
    # z is the axis of the largest moment, and near the momentum in this flight
    angle = predicted["z_to_momentum"].values[0]
    assert np.all((angle > 0) & (angle < np.pi / 2))


def test_each_draw_moves_under_its_own_torque_in_body_axes_and_in_space():
    rng, times = np.random.default_rng(0), np.array([-100.0, 0.0, 200.0])
    omega = 0.05 * rng.standard_normal((3, 3))
    # the first draw has a torque in body axes, the second one in space, the third none; rad/s2
    torque = 1e-4 * rng.standard_normal((3, 2, 3)) * np.array([[[1], [0]], [[0], [1]], [[0], [0]]])
    craft = box()
    tree = tree_of(craft, omega, np.tile(SUN, (3, 1)), {"steady_torque": torque})
    carried = DrawnMotions.of(craft, tree).at(times)
    np.testing.assert_array_equal(carried.omega_B[:, 1], omega)
    mean = np.trace(craft.require_inertia()) / 3
    for i in range(3):
        for j in (0, 2):
            steady = [Steady(mean * torque[i])]
            run = ss.propagate(craft, omega[i], SUN, None, [0.0, times[j]], torques=steady)
            np.testing.assert_allclose(carried.sun_B[i, j], run["sun_B"].values[-1], atol=1e-3)


def test_draws_of_several_wheels_run_down_with_their_own_numbers():
    a = Wheel("a", (1, 0, 0), 1e-5, 100.0, Friction(1e-6, 1e-9))
    craft = box(a, Wheel("b", (0, 1, 0), 2e-5, -60.0, Friction(2e-6, 1e-9)))
    unknowns = {
        "wheel_speed_rad_s": np.array([[101.0, -60.0], [100.0, -63.0]]),
        "log_coulomb_a": np.array([0.2, 0.0]),
        "log_coulomb_b": np.array([0.0, -0.3]),
        "log_viscous_b": np.array([0.4, 0.0]),
        "log_wheel_inertia_a": np.array([0.0, 0.1]),
        "inertia_zz": np.array([0.0095, 0.009]),
    }
    omega = np.array([[0.04, -0.05, 0.03], [0.03, 0.0, 0.1]])
    tree = tree_of(craft, omega, np.tile(SUN, (2, 1)), unknowns)
    predicted, speeds = predict(craft, tree, [500.0]), unknowns["wheel_speed_rad_s"]
    for i in range(2):
        own = own_vehicle(craft, tree, i)
        run = ss.propagate(own, omega[i], SUN, speeds[i], [0.0, 500.0])
        for name, tolerance in (("omega_B", 1e-4), ("wheel_speed_rad_s", 1e-2)):
            expected = run[name].values[-1]
            np.testing.assert_allclose(predicted[name].values[0, i, 0], expected, atol=tolerance)


def test_predictions_do_not_depend_on_the_number_of_workers_or_the_order_of_times():
    tree = philae_draws(200, 0.003)
    one, two = (predict(PHILAE, tree, [26000.0, TOUCHDOWN], workers) for workers in (1, 2))
    np.testing.assert_allclose(one["omega_B"].values, two["omega_B"].values, rtol=1e-9)
    assert one["predicted_s"].values.tolist() == [TOUCHDOWN, 26000.0]
    motions = DrawnMotions.of(PHILAE, tree)
    backward = motions.at([26000.0, TOUCHDOWN, 26000.0]).omega_B
    np.testing.assert_allclose(backward[:, [1, 0]], one["omega_B"].values[0], rtol=1e-9)
    np.testing.assert_array_equal(backward[:, 0], backward[:, 2])


def test_predictions_at_invalid_times_or_with_another_vehicle_are_refused():
    tree = philae_draws(1)
    for times in ([], [np.nan], [25200.0 + 8 * 86400]):
        with pytest.raises(InputError, match="times to predict must be numbers, at most a week"):
            predict(PHILAE, tree, times)
    heavier = replace(PHILAE, inertia_kg_m2=1.1 * np.array(PHILAE.inertia_kg_m2))
    renamed = replace(PHILAE, wheels=(replace(PHILAE.wheels[0], name="another"),))
    for vehicle in (heavier, renamed):
        with pytest.raises(InputError, match="not of this vehicle"):
            predict(vehicle, tree, [LATER])


def test_the_best_motion_of_a_solution_is_that_of_its_likeliest_draw():
    """With its own inertia and torque, from the first sample to the last, at instants less than 0.3 rad apart."""
    craft = box()
    omega = np.array([[0.3, 0.0, 0.1], [0.0, 0.4, 0.05], [0.1, 0.1, 0.1]])
    torque = np.zeros((3, 2, 3))
    torque[1, 0] = 1e-5, 0.0, 2e-5
    unknowns = {
        "inertia_zz": np.array([0.009, 0.0095, 0.009]),
        "steady_torque": torque,
        "log_likelihood_sum": np.array([-3.0, -1.0, -2.0]),
    }
    tree = tree_of(craft, omega, np.tile(SUN, (3, 1)), unknowns, (100.0, 700.0))
    (motion,) = best_motions(craft, tree)
    own = replace(craft, inertia_kg_m2=np.diag([0.042, 0.040, 0.0095]))
    steady = [Steady(np.trace(craft.require_inertia()) / 3 * torque[1])]
    run = ss.propagate(own, omega[1], SUN, None, [0.0, 600.0], torques=steady)
    t_s = motion["time"].values
    assert (t_s[0], t_s[-1]) == (100.0, 700.0)
    np.testing.assert_allclose(motion["sun_B"].values[-1], run["sun_B"].values[-1], atol=1e-6)
    fastest = np.linalg.norm(motion["omega_B"].values, axis=1).max()
    assert np.diff(t_s).max() * fastest < 0.31
    sines = np.maximum(motion["sun_B"].values[:, 0], 0.0)
    np.testing.assert_allclose(motion["panel_signal"].values[:, 0], 7.0 * sines, atol=1e-9)
    assert motion.attrs["solution"] == 1 and motion.attrs["probability"] == 1.0
