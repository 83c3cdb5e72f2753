"""A wheel that is braked: what it loses the body gains."""

from __future__ import annotations

import numpy as np

from validation.passes import BRAKING_S, MOMENTS, make, spin


def test_a_braked_wheel_hands_its_momentum_to_the_body():
    """Momentum of body and wheel together is constant in space, to what steps of a quarter of a second leave."""
    lost, axis, t_s = 0.4 * 5e-3, np.array([0.0, 1.0, 0.0]), np.linspace(0.0, 200.0, 41)

    def wheels(t: float) -> tuple[np.ndarray, np.ndarray]:
        done = np.clip((t - 90.0) / BRAKING_S, 0.0, 1.0)
        braking = 1 / BRAKING_S if 0.0 < done < 1.0 else 0.0
        return (5e-3 - lost * done) * axis, -lost * braking * axis

    omega, attitude = spin(np.array([0.02, -0.01, 0.03]), t_s, wheels=wheels)
    stored = np.array([wheels(t)[0] for t in t_s])
    momentum_N = np.einsum("nji,nj->ni", attitude, MOMENTS * omega + stored)
    size = np.linalg.norm(momentum_N[0])
    assert np.abs(momentum_N - momentum_N[0]).max() < 2e-3 * size
    assert np.linalg.norm(omega[-1] - omega[0]) > 0.2 * lost / MOMENTS[1]


def test_the_file_of_a_braked_wheel_states_its_first_speed_and_no_column_of_it():
    simulated = make("wheel braked", 0, 0)
    (wheel,) = simulated.vehicle.wheels
    assert wheel.speed_rad_s and "wheel_speed_rad_s" not in simulated.telemetry
