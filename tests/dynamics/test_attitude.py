"""Compiled steps of attitude and momentum, compared with SciPy on Euler's equations."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from sunspin.estimate.rates.motion import STEP_ANGLE, Body, Ends, step, steps_of

INERTIA = np.array([[1.2, 0.05, -0.02], [0.05, 1.0, 0.04], [-0.02, 0.04, 0.8]])
DIPOLE = np.array([2e-3, -1e-3, 3e-3])


def drawn(n):
    rng = np.random.default_rng(5)
    field, momentum = rng.normal(size=(2, n, 3))
    ends = Ends(
        field,
        field + 0.3 * rng.normal(size=(n, 3)),
        0.4 * momentum,
        0.4 * momentum + 0.05 * rng.normal(size=(n, 3)),
    )
    return 0.1 * rng.normal(size=(n, 3)), rng.uniform(5.0, 20.0, n), ends


def euler(omega, dt, ends):
    """Euler's equations with wheels and a dipole, momentum and attitude (from the body at the start) at the end."""

    def slope(t, y):
        s = t / dt
        held, field = (
            (1 - s) * a + s * b
            for a, b in ((ends.momentum, ends.momentum_end), (ends.field, ends.field_end))
        )
        rate = np.linalg.solve(INERTIA, y[:3] - held)
        matrix = y[3:].reshape(3, 3)
        turning = -np.cross(rate, matrix, axisb=0, axisc=0)
        return np.concatenate(
            [np.cross(y[:3], rate) + INERTIA @ np.cross(DIPOLE, field), turning.ravel()]
        )

    start = np.concatenate([INERTIA @ omega + ends.momentum, np.eye(3).ravel()])
    y = solve_ivp(slope, (0, dt), start, method="DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
    return y[3:].reshape(3, 3), np.linalg.solve(INERTIA, y[:3] - ends.momentum_end)


@pytest.mark.evidence(
    "rates",
    "verified",
    "a step of the smoother with wheels and a dipole, SciPy on Euler's equations",
)
def test_compiled_steps_agree_with_eulers_equations(reached):
    omega, dt, ends = drawn(12)
    body = Body(INERTIA, DIPOLE, False)
    matrix, rate = step(body, omega, dt, ends)
    turns = np.maximum(steps_of(body, omega, dt, ends) * STEP_ANGLE / (2 * np.pi), 1.0)
    for i in range(0, 12, 2):
        wanted, fast = euler(
            omega[i], dt[i], Ends(*(part if part is None else part[i] for part in ends))
        )
        away = (Rotation.from_matrix(matrix[i]) * Rotation.from_matrix(wanted).inv()).magnitude()
        reached("error of the attitude in a turn", away / turns[i], "rad", 2e-4)
        assert (
            away < 2e-4 * turns[i] and np.abs(rate[i] - fast).max() < 2e-4 * turns[i]
        )  # rad, rad/s
