"""Properties of the motion for many vehicles, wheels, axes and rates: rotation, mirror, scale, reversal, conservation.

Few examples each by default; SUNSPIN_EXAMPLES=300 tries many.
"""

import os
from dataclasses import replace

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.dynamics import gyrostat as g
from sunspin.telemetry.sun import is_reconstructed
from sunspin.vehicle import Friction, Panel, Vehicle
from tests.support.vehicles import random_vehicle
from tests.support.vehicles import unit_vector as unit

EXAMPLES = int(os.environ.get("SUNSPIN_EXAMPLES", "6"))
few = settings(max_examples=EXAMPLES, deadline=None, derandomize=EXAMPLES <= 6)
seeds, wheels = st.integers(0, 2**32 - 1), st.integers(0, 3)
T = np.linspace(0, 40, 9)


def case(seed: int, n_wheels: int, dry: float = 0.01, viscous: float = 1e-3, n_panels: int = 0):
    """A random vehicle with a start: rates up to several rad/s, a Sun, wheel speeds."""
    rng = np.random.default_rng(seed)
    vehicle = random_vehicle(rng, n_wheels, dry, viscous)
    panels = [Panel(str(i), unit(rng), rng.uniform(0.5, 2)) for i in range(n_panels)]
    omega = unit(rng) * np.exp(rng.uniform(np.log(0.02), np.log(5.0)))
    return replace(vehicle, panels=panels), omega, unit(rng), rng.uniform(-60, 60, n_wheels), rng


def run(vehicle, omega, sun, speeds, t=T, **options):
    return ss.propagate(vehicle, omega, sun, speeds if len(speeds) else None, t, **options)


def close(a, b, turned_rad, tolerance=1e-10):
    """Equal but for what rounding, multiplied by the way turned, may do."""
    allowed = tolerance * (1 + turned_rad) * max(1.0, float(np.abs(b).max(initial=0.0)))
    np.testing.assert_allclose(a, b, rtol=0, atol=allowed)


def changed(vehicle: Vehicle, matrix: np.ndarray) -> Vehicle:
    """The vehicle turned (or mirrored) by an orthogonal matrix; a wheel's axis is a pseudovector."""
    sign, inertia = np.linalg.det(matrix), matrix @ vehicle.inertia_kg_m2 @ matrix.T
    panels = [replace(p, normal_B=matrix @ p.normal_B) for p in vehicle.panels]
    wheels = [replace(w, axis_B=sign * matrix @ w.axis_B) for w in vehicle.wheels]
    return Vehicle("changed", inertia, vehicle.mass_kg, panels, wheels)


@few
@given(seeds, wheels, st.booleans())
def test_rotating_or_mirroring_the_vehicle_rotates_or_mirrors_its_motion(seed, n_wheels, mirror):
    vehicle, omega, sun, speeds, rng = case(seed, n_wheels)
    matrix = Rotation.random(rng=rng).as_matrix() * (-1.0 if mirror else 1.0)
    sign = -1.0 if mirror else 1.0
    a = run(vehicle, omega, sun, speeds)
    b = run(changed(vehicle, matrix), sign * matrix @ omega, matrix @ sun, speeds)
    turned = np.linalg.norm(omega) * T[-1]
    close(b["sun_B"].values, a["sun_B"].values @ matrix.T, turned, 1e-8)
    close(b["omega_B"].values, sign * a["omega_B"].values @ matrix.T, turned, 1e-8)
    close(b["wheel_speed_rad_s"].values, a["wheel_speed_rad_s"].values, turned, 1e-8)


@few
@given(seeds, st.integers(3, 8))
def test_rotating_the_panels_rotates_the_sun_direction(seed, n_panels):
    vehicle, _, _, _, rng = case(seed, 0, n_panels=n_panels)
    matrix = Rotation.random(rng=rng).as_matrix()
    suns = np.array([unit(rng) for _ in range(30)])
    turned = changed(vehicle, matrix)
    power = ss.panel_power(vehicle, suns)
    close(ss.panel_power(turned, suns @ matrix.T), power, 0.0, 1e-14)
    power = np.maximum(power + rng.normal(size=power.shape) * 0.003, 0)
    a, b = (ss.sun_directions(v, power, lit_threshold=0.02) for v in (vehicle, turned))
    assert np.array_equal(a["status"].values, b["status"].values)
    told = is_reconstructed(a["status"])
    close(b["sun_B"].values[told], (a["sun_B"].values @ matrix.T)[told], 0.0, 1e-9)
    close(b["delta"].values[told], a["delta"].values[told], 0.0, 1e-12)


def scaled_wheels(vehicle: Vehicle, inertia: float, coulomb: float, viscous: float) -> list:
    """Return the wheels with inertia and friction times these factors."""
    wheels = []
    for w in vehicle.wheels:
        law = Friction(coulomb * w.friction.coulomb_N_m, viscous * w.friction.viscous_N_m_s)
        wheels.append(replace(w, inertia_kg_m2=inertia * w.inertia_kg_m2, friction=law))
    return wheels


@few
@given(seeds, wheels, st.sampled_from([2.0, 3.7, 1e3, 1e-4]))
def test_another_unit_of_mass_changes_no_motion(seed, n_wheels, factor):
    vehicle, omega, sun, speeds, _ = case(seed, n_wheels)
    inertia, others = factor * vehicle.inertia_kg_m2, scaled_wheels(vehicle, *[factor] * 3)
    heavier = Vehicle("heavier", inertia, wheels=others)
    a, b = run(vehicle, omega, sun, speeds), run(heavier, omega, sun, speeds)
    turned = np.linalg.norm(omega) * T[-1]
    close(b["sun_B"].values, a["sun_B"].values, turned, 1e-8)
    close(b["momentum_B"].values / factor, a["momentum_B"].values, turned, 1e-8)
    assert list(a["event_what"].values) == list(b["event_what"].values)


@few
@given(seeds, wheels, st.sampled_from([0.5, 3.0, 60.0]))
def test_another_unit_of_time_changes_no_path(seed, n_wheels, factor):
    """Rates times f and torques times f^2 give the same orientations 1 / f earlier."""
    vehicle, omega, sun, speeds, _ = case(seed, n_wheels)
    faster = replace(vehicle, wheels=scaled_wheels(vehicle, 1.0, factor**2, factor))
    a = run(vehicle, omega, sun, speeds)
    b = run(faster, factor * omega, sun, factor * speeds, T / factor)
    turned = np.linalg.norm(omega) * T[-1]
    close(b["sun_B"].values, a["sun_B"].values, turned, 1e-8)
    close(b["omega_B"].values / factor, a["omega_B"].values, turned, 1e-8)


@few
@given(seeds, st.permutations(range(3)))
def test_the_motion_does_not_depend_on_the_order_of_wheels(seed, order):
    vehicle, omega, sun, speeds, _ = case(seed, 3)
    other = replace(vehicle, wheels=[vehicle.wheels[i] for i in order])
    a, b = run(vehicle, omega, sun, speeds), run(other, omega, sun, speeds[list(order)])
    turned = np.linalg.norm(omega) * T[-1]
    close(b["sun_B"].values, a["sun_B"].values, turned, 1e-8)
    reordered = a["wheel_speed_rad_s"].values[:, list(order)]
    close(b["wheel_speed_rad_s"].values, reordered, turned, 1e-8)


def state_of(motion):
    return [motion[name].values for name in ("omega_B", "sun_B", "wheel_speed_rad_s")]


@few
@given(seeds, wheels)
def test_without_friction_a_reversed_motion_returns_to_its_start(seed, n_wheels):
    vehicle, omega, sun, speeds, _ = case(seed, n_wheels, dry=0.0, viscous=0.0)
    end = run(vehicle, omega, sun, speeds).isel(time=-1)
    omega_back, sun_back, speeds_back = state_of(end)
    back = run(vehicle, -omega_back, sun_back, -speeds_back).isel(time=-1)
    turned = np.linalg.norm(omega) * T[-1]
    close(back["sun_B"].values, sun, turned, 1e-8)
    close(-back["omega_B"].values, omega, turned, 1e-8)


@few
@given(seeds, wheels, st.sampled_from(["coast", "hold"]))
def test_momentum_is_conserved_and_energy_never_added(seed, n_wheels, mode):
    vehicle, omega, sun, speeds, _ = case(seed, n_wheels, dry=0.05, viscous=3e-3)
    there = run(vehicle, omega, sun, speeds, np.linspace(0, 120, 121), wheel_mode=mode)
    H, r = there["momentum_B"].values, there["sun_B"].values
    H = H / np.linalg.norm(H[0])
    for one, other in ((H, H), (r, r), (H, r)):
        assert np.ptp(np.einsum("ij,ij->i", one, other)) < 1e-11
    if mode == "coast":  # a motor that holds a speed may do work
        omega, _, speeds = state_of(there)
        energy = g.kinetic_energy(vehicle, omega, speeds)
        assert np.all(np.diff(energy) <= 1e-11 * energy[0])


@few
@given(seeds, st.integers(0, 2))
def test_a_run_equals_its_parts_in_sequence(seed, n_wheels):
    vehicle, omega, sun, speeds, rng = case(seed, n_wheels)
    whole = run(vehicle, omega, sun, speeds)
    rest = run(vehicle, *state_of(whole.isel(time=4)), T[4:])
    close(rest["sun_B"].values, whole["sun_B"].values[4:], np.linalg.norm(omega) * T[-1], 1e-8)


@few
# a panel has failed, and all of an arc fits the others alike
@example(2977344, [1, 0, 2, 3, 4, 5], 1e-3)
@given(seeds, st.permutations(range(6)), st.sampled_from([1e-3, 1.0, 60.0]))
def test_sun_directions_do_not_depend_on_panel_order_and_power_unit(seed, order, unit_of_power):
    vehicle, _, _, _, rng = case(seed, 0, n_panels=6)
    order = list(order)
    panels = [vehicle.panels[i] for i in order]
    other = replace(vehicle, panels=[replace(p, gain=unit_of_power * p.gain) for p in panels])
    power = ss.panel_power(vehicle, np.array([unit(rng) for _ in range(60)]))
    power = np.maximum(power + rng.normal(size=(60, 6)) * 0.01, 0)
    power[::7, 0] = 0.0  # a panel that fails: patterns that cannot be
    power[1::9] = 0.0
    a = ss.sun_directions(vehicle, power, lit_threshold=0.03, noise=0.01)
    limits = {"lit_threshold": 0.03 * unit_of_power, "noise": 0.01 * unit_of_power}
    b = ss.sun_directions(other, unit_of_power * power[:, order], **limits)
    assert np.array_equal(a["status"].values, b["status"].values)
    assert len(np.unique(a["status"].values)) > 2
    assert np.array_equal(a["status_text"].values, b["status_text"].values)
    assert np.array_equal(a["lit"].values[:, order], b["lit"].values)
    close(b["delta"].values, a["delta"].values, 0.0, 1e-10)
    told = is_reconstructed(a["status"])
    close(b["sun_B"].values[told], a["sun_B"].values[told], 0.0, 1e-8)
    np.testing.assert_allclose(b["sigma_rad"].values[told], a["sigma_rad"].values[told], rtol=1e-6)


def test_the_property_tests_detect_wrong_physics():
    """The negative control of this file: a vehicle that is not turned along with its start."""
    vehicle, omega, sun, speeds, rng = case(3, 1)
    matrix = Rotation.random(rng=rng).as_matrix()
    a, b = run(vehicle, omega, sun, speeds), run(vehicle, matrix @ omega, matrix @ sun, speeds)
    assert np.abs(b["sun_B"].values - a["sun_B"].values @ matrix.T).max() > 0.1
