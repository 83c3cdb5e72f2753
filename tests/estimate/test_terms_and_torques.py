"""Terms: their derivatives are those of differences, and what a torque adds is what an integration with it adds."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sunspin.estimate.model import States
from sunspin.estimate.terms.directions import SunDirections
from sunspin.estimate.terms.inertial import Gyro
from sunspin.estimate.terms.panels import Instants, Panels
from sunspin.estimate.terms.term import facing
from sunspin.estimate.terms.torques import ConstantTorque, exponential
from sunspin.solve.rotations import rotate_attitude, rotation_between
from sunspin.vehicle.response.flat import PanelResponse

RNG = np.random.default_rng(3)
N = 6
FACES = np.vstack([np.eye(3), -np.eye(3)])
STEP = 1e-6


def directions(double=False):
    """Return six directions, some of which mean two things."""
    unit = RNG.normal(size=(N, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    spread = np.tile(0.02**2 * np.eye(3), (N, 1, 1))
    other, other_spread = np.full((N, 3), np.nan), np.full((N, 3, 3), np.nan)
    if double:
        other[::2], other_spread[::2] = -unit[::2], spread[::2]
    return SunDirections(unit, spread, other, other_spread)


def panels(scale_sigma):
    """Return readings of six panels with gains that are known to 10 %, some of them not read."""
    sigma = np.where(RNG.random((N, 6)) < 0.2, np.inf, 0.03)
    response = PanelResponse(FACES, np.array([1.0, 2.0, 1.0, 1.0, 0.5, 1.0]))
    offset = Instants(np.array([0.0, 0.0, 1.5, 0.0, 0.0, 0.0]), 0.0)
    scale = np.full(N, 1.1), np.full(N, scale_sigma)
    names = tuple("abcdef")
    power = RNG.random((N, 6))
    gain = np.ones(6), 0.1 * np.eye(6)
    shown, lit = np.ones(6, dtype=bool), np.ones(N)
    sigmas = sigma, sigma, np.full((N, 6), 0.03)
    return Panels(power, sigma, response, *gain, *scale, names, offset, shown, *sigmas, lit)


def gyro():
    """Return a gyro whose zero and scale are not known, with one reading missing."""
    rate = 0.02 * RNG.normal(size=(N, 3))
    rate[2] = np.nan
    return Gyro(rate, 1e-3, np.array([1e-3, 2e-3, 0.0]), 0.01)


def numeric(term, seen, u, moved):
    """Return the derivative (K, n, r) of a term's differences along a change of motions and unknowns."""
    ends = [next(term.residuals(*moved(seen, u, sign * STEP))).value for sign in (1, -1)]
    return (ends[0] - ends[1]) / (2 * STEP)


@pytest.mark.parametrize(
    "make",
    [directions, lambda: directions(double=True), lambda: panels(0.05), lambda: panels(1e3), gyro],
    ids=["direction", "two meanings", "known factor", "free factor", "gyro"],
)
def test_derivatives_are_those_of_differences(make):
    term = make()
    k = 3
    sun = RNG.normal(size=(k, N, 3))
    seen = States(
        facing(sun / np.linalg.norm(sun, axis=-1, keepdims=True)), 1e-3 * RNG.normal(size=(k, N, 3))
    )
    u = 0.3 * RNG.normal(size=(k, len(term.unknowns())))
    residual = next(term.residuals(seen, u))
    for axis, turn in enumerate(np.eye(3)):
        if residual.by_turn is not None:
            by = numeric(
                term,
                seen,
                u,
                lambda s, u, h, turn=turn: (
                    States(rotate_attitude(s.attitude, h * turn), s.omega),
                    u,
                ),
            )
            # a factor that is projected out has Kaufman's slope, exact where the readings are met
            assert np.allclose(
                along(residual, residual.by_turn[..., axis]), along(residual, by), atol=2e-3
            )
        if residual.by_rate is not None:
            by = numeric(
                term,
                seen,
                u,
                lambda s, u, h, turn=turn: (States(s.attitude, s.omega + h * turn), u),
            )
            assert np.allclose(residual.by_rate[..., axis], by, atol=1e-4)
    for j, unit in enumerate(np.eye(u.shape[1])):
        by = numeric(term, seen, u, lambda s, u, h, unit=unit: (s, u + h * unit))
        assert residual.by_u is not None
        assert np.allclose(along(residual, residual.by_u[..., j]), along(residual, by), atol=1e-4)


def along(residual, derivative):
    """Return the change (K, n) of half the square of the differences: Kaufman's slope has that exactly."""
    return np.einsum("knr,knr->kn", residual.value, derivative)


@pytest.mark.parametrize("frame", ["B", "N"])
def test_a_constant_torque_pushes_as_an_integration_with_it_does(frame):
    inertia = np.diag([1.2, 1.0, 0.8])
    momentum = np.array([[0.0, 0.01, 0.0]])
    omega, dt, size = np.array([0.05, -0.02, 0.08]), 8.0, 1e-6
    torque = ConstantTorque(
        "B" if frame == "B" else "N", 1.0, (1.0,), inertia, np.repeat(momentum, 2, axis=0)
    )
    attitude = facing(np.array([0.6, 0.0, 0.8]))
    seen = States(np.tile(attitude, (1, 2, 1, 1)), np.tile(omega, (1, 2, 1)))
    push = torque.added_by_unknowns(seen, np.array([dt]))[0, 0]
    for axis in range(3):
        ends = [
            run(inertia, momentum, omega, dt, sign * size, axis, frame, attitude) for sign in (0, 1)
        ]
        turn = rotation_between(ends[0][0], ends[1][0])
        change = np.concatenate([turn, ends[1][1] - ends[0][1]]) / size
        assert np.allclose(push[:, axis], change, rtol=0.03, atol=0.03 * np.abs(change).max())


def run(inertia, momentum, omega, dt, size, axis, frame, attitude):
    """Return attitude and rate after dt with a torque, by Euler's equations in another integrator."""

    def slope(_, y):
        """Return the derivative of momentum (3) and attitude since the start (9)."""
        turned = y[3:].reshape(3, 3)
        rate = np.linalg.solve(inertia, y[:3] - momentum[0])
        torque = size * (np.eye(3)[axis] if frame == "B" else (turned @ attitude)[:, axis])
        turning = -np.cross(rate, turned, axisb=0, axisc=0)
        return np.concatenate([np.cross(y[:3], rate) + torque, turning.ravel()])

    start = np.concatenate([omega @ inertia + momentum[0], np.eye(3).ravel()])
    y = solve_ivp(slope, (0, dt), start, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    return y[3:].reshape(3, 3), np.linalg.solve(inertia, y[:3] - momentum[0])


def test_exponential_of_a_rotation_is_the_rotation():
    angle = np.array([0.4, -3.0, 1.7])
    cross = np.array([[0, -angle[2], angle[1]], [angle[2], 0, -angle[0]], [-angle[1], angle[0], 0]])
    assert np.allclose(exponential(-cross[None])[0], rotate_attitude(np.eye(3), angle), atol=1e-12)
