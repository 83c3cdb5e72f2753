"""Compiled steps of attitude and momentum, compared with SciPy on Euler's equations."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from sunspin.estimate.carry import STEP_RAD, angle_turned, step

INERTIA = np.array([[1.2, 0.05, -0.02], [0.05, 1.0, 0.04], [-0.02, 0.04, 0.8]])


def drawn(n):
    """Return rates (n, 3), intervals (n) and the momenta of wheels (n, 3) at their ends."""
    rng = np.random.default_rng(5)
    momentum = 0.4 * rng.normal(size=(n, 3))
    momenta = momentum, momentum + 0.05 * rng.normal(size=(n, 3))
    return 0.1 * rng.normal(size=(n, 3)), rng.uniform(5.0, 20.0, n), momenta


def euler(omega, dt, start, end):
    """Return attitude (from the body at the start) and rate at the end, by Euler's equations with wheels of these momenta (3)."""

    def slope(t, y):
        s = t / dt
        rate = np.linalg.solve(INERTIA, y[:3] - (1 - s) * start - s * end)
        turning = -np.cross(rate, y[3:].reshape(3, 3), axisb=0, axisc=0)
        return np.concatenate([np.cross(y[:3], rate), turning.ravel()])

    first = np.concatenate([INERTIA @ omega + start, np.eye(3).ravel()])
    y = solve_ivp(slope, (0, dt), first, method="DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    return y[3:].reshape(3, 3), np.linalg.solve(INERTIA, y[:3] - end)


@pytest.mark.evidence(
    "rates", "verified", "a step of a fit with wheels, SciPy on Euler's equations"
)
def test_compiled_steps_agree_with_eulers_equations(reached):
    omega, dt, momenta = drawn(12)
    end = step(INERTIA, omega[None], dt, momenta)
    angle = np.ceil(angle_turned(INERTIA[None], omega[None], dt, momenta)[0] / STEP_RAD) * STEP_RAD
    turns = np.maximum(angle / (2 * np.pi), 1.0)
    for i in range(0, 12, 2):
        wanted, rate = euler(omega[i], dt[i], momenta[0][i], momenta[1][i])
        turned = Rotation.from_matrix(end.turned[0, i])
        away = (turned * Rotation.from_matrix(wanted).inv()).magnitude()
        reached("error of the attitude in a turn", away / turns[i], "rad", 2e-4)
        assert away < 2e-4 * turns[i]
        assert np.abs(end.omega[0, i] - rate).max() < 2e-4 * turns[i]  # rad/s
