"""The sticking impact: contact velocity, conserved momentum, energy, and an impact worked out by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sunspin as ss
from sunspin.dynamics import gyrostat as g
from sunspin.vehicle import Leg, Vehicle
from tests.support.vehicles import philae_body, random_vehicle


def energy(vehicle, omega, speeds, velocity):
    moving = vehicle.mass_kg * (velocity**2).sum(axis=-1) / 2
    return g.kinetic_energy(vehicle, omega, speeds) + moving


def state_of(after):
    return [after[name].values for name in ("omega_B", "wheel_speed_rad_s", "velocity_B")]


def blow(seed: int, n_wheels: int, mode="coast"):
    """A random vehicle, state and contact point, and the state after: (vehicle, before, tip, after)."""
    rng = np.random.default_rng(seed)
    vehicle = random_vehicle(rng, n_wheels)
    before = (rng.normal(size=3), rng.normal(size=n_wheels) * 100, rng.normal(size=3))
    tip = rng.normal(size=3)
    after = ss.impact(vehicle, *before, tip, wheel_mode=mode)
    return vehicle, before, tip, after


cases = settings(max_examples=60, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


@pytest.mark.evidence(
    "impact", "verified", "zero velocity of the contact point, on random vehicles"
)
@cases
@given(seeds, st.integers(0, 3), st.sampled_from(["coast", "brake", "hold"]))
def test_the_contact_point_is_at_rest_after_the_impact(seed, n_wheels, mode):
    _, _, tip, after = blow(seed, n_wheels, mode)
    contact = np.cross(after["omega_B"].values, tip) + after["velocity_B"].values
    np.testing.assert_allclose(contact, 0.0, atol=1e-12)


@pytest.mark.evidence("impact", "verified", "conservation of momentum, on random vehicles")
@cases
@given(seeds, st.integers(0, 3), st.sampled_from(["coast", "hold"]))
def test_momentum_about_the_contact_point_is_conserved(seed, n_wheels, mode):
    vehicle, (omega, speeds, velocity), tip, after = blow(seed, n_wheels, mode)

    def about_contact(omega, speeds, velocity):
        return g.total_momentum(vehicle, omega, speeds) - np.cross(tip, vehicle.mass_kg * velocity)

    then, first = about_contact(*state_of(after)), about_contact(omega, speeds, velocity)
    np.testing.assert_allclose(then, first, rtol=1e-10, atol=1e-10)
    change = vehicle.mass_kg * (after["velocity_B"].values - velocity)
    np.testing.assert_allclose(after["impulse_B"].values, change, rtol=1e-10, atol=1e-12)


@pytest.mark.evidence("impact", "verified", "kinetic energy, which an impact must not raise")
@cases
@given(seeds, st.integers(0, 3))
def test_free_wheels_keep_their_inertial_spin_and_an_impact_never_adds_energy(seed, n_wheels):
    vehicle, (omega, speeds, velocity), _, after = blow(seed, n_wheels)
    then = state_of(after)
    first, last = (g.axial_momenta(vehicle, *x) for x in ((omega, speeds), then[:2]))
    np.testing.assert_allclose(last, first, rtol=1e-12, atol=1e-12)
    before = energy(vehicle, omega, speeds, velocity)
    lost = before - energy(vehicle, *then)
    assert lost >= -1e-12 * before


def test_a_held_wheel_keeps_its_speed_and_its_motor_may_do_work():
    vehicle = philae_body()
    rng = np.random.default_rng(5)
    omega, tip = rng.normal(size=(500, 3)) * 0.3, np.array([1.478, 0.0118, -0.4078])
    velocity = rng.normal(size=(500, 3)) * 0.15
    after = ss.impact(vehicle, omega, 865.0, velocity, tip, wheel_mode="hold")
    assert np.all(after["wheel_speed_rad_s"].values == 865.0)
    work = energy(vehicle, *state_of(after))
    work = work - energy(vehicle, omega, np.full((500, 1), 865.0), velocity)
    assert work.max() > 0 > work.min()


@pytest.mark.evidence("impact", "verified", "an impact worked out by hand")
def test_a_rod_that_lands_on_one_end_moves_as_worked_out_by_hand():
    """A body with unit mass and inertia falls at speed 1 along -z on its end at distance 2 along x.

    The upward impulse is F = v / (1/m + l^2/I) = 1/5, its moment l x F = (2, 0, 0) x (0, 0, 1/5) = (0, -2/5, 0), and
    the centre goes on falling at 1 - 1/5. Check: omega x l = (0, -2/5, 0) x (2, 0, 0) = (0, 0, 4/5) cancels it at the
    end.
    """
    body = Vehicle("unit", np.eye(3), 1.0, legs=[Leg("end", [2.0, 0.0, 0.0])])
    after = ss.impact(body, [0, 0, 0], None, [0, 0, -1.0], "end")
    np.testing.assert_allclose(after["impulse_B"].values, [0, 0, 0.2], atol=1e-15)
    np.testing.assert_allclose(after["omega_B"].values, [0, -0.4, 0], atol=1e-15)
    np.testing.assert_allclose(after["velocity_B"].values, [0, 0, -0.8], atol=1e-15)


def test_many_impacts_at_once_equal_the_same_impacts_one_by_one():
    vehicle = ss.load_vehicle("philae")
    rng = np.random.default_rng(1)
    omega, velocity = rng.normal(size=(6, 3)), rng.normal(size=(6, 3))
    speeds, legs = rng.normal(size=(6, 1)) * 100, rng.integers(0, 3, 6)
    together = ss.impact(vehicle, omega, speeds, velocity, legs)
    assert together["omega_B"].dims == ("run", "axis") and together["omega_B"].shape == (6, 3)
    flat = ss.impact(vehicle, omega, speeds[:, 0], velocity, legs)
    for key in together:
        np.testing.assert_array_equal(flat[key].values, together[key].values)
    for i in range(6):
        alone = ss.impact(vehicle, omega[i], speeds[i], velocity[i], vehicle.legs[legs[i]].name)
        for key in alone:
            one, many = alone[key].values, together[key].values[i]
            np.testing.assert_allclose(many, one, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"leg": "4"}, "no leg of this name"),
        ({"leg": 3}, "has 3 leg"),
        ({"leg": [1.0, 2.0]}, "leg must be finite with three components"),
        ({"omega_B": [0.0, float("nan"), 0.0]}, "omega_B must be finite"),
        ({"wheel_speed_rad_s": None}, "one finite number for each of the 1 wheel"),
        ({"wheel_mode": "stop"}, "wheel_mode must be one of"),
        ({"omega_B": np.zeros((4, 3)), "velocity_B": np.zeros((5, 3))}, "leading shapes"),
    ],
)
def test_bad_arguments_of_an_impact_are_named(change, text):
    given = {"omega_B": [0, 0, 0], "wheel_speed_rad_s": 0.0, "velocity_B": [0, 0, -1], "leg": "1"}
    with pytest.raises(ss.InputError, match=text):
        ss.impact(ss.load_vehicle("philae"), **given | change)
    with pytest.raises(ss.VehicleError, match="mass_kg"):
        ss.impact(Vehicle("no mass", np.eye(3)), [0, 0, 0], None, [0, 0, -1], [1.0, 0, 0])
