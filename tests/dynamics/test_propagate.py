"""The reference propagator against independent integrators, closed forms, published truths and invariants."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.environment.frames import BODY_AT_START
from sunspin.vehicle import Friction, Vehicle
from tests.support.vehicles import FIRST_SUN, philae_body, random_vehicle


def paper_equations(vehicle: Vehicle):
    """The paper's eqs. (3), (4), (5), (7) as printed, in terms of omega and W, for one wheel turning forward."""
    wheel = vehicle.wheels[0]
    theta, u, J, f = vehicle.inertia_kg_m2, wheel.axis_B, wheel.inertia_kg_m2, wheel.friction
    inverse = np.linalg.inv(theta - J * np.outer(u, u))

    def slipping(_t, y):
        omega, W, r = y[:3], y[3], y[4:]
        M = -np.sign(W) * (f.coulomb_N_m + f.viscous_N_m_s * abs(W))
        torque = np.cross(omega, theta @ omega) + u * M + np.cross(omega, J * u * W)
        acceleration = -inverse @ torque
        return np.concatenate([acceleration, [M / J - u @ acceleration], -np.cross(omega, r)])

    def stuck(_t, y):
        omega, r = y[:3], y[4:]
        acceleration = -np.linalg.solve(theta, np.cross(omega, theta @ omega))
        return np.concatenate([acceleration, [0.0], -np.cross(omega, r)])

    return slipping, stuck


@pytest.mark.evidence(
    "propagate", "validated", "SciPy's DOP853 on the equations as printed in the paper, rtol 1e-12"
)
@pytest.mark.parametrize(
    ("omega", "speed", "end"),
    [
        ((-0.1, 0.2, 0.0), 80.0, 500.0),
        pytest.param((-0.1, 0.2, 0.0), 865.0, 2700.0, marks=pytest.mark.long),
        pytest.param((0.1, 0.0, 0.0), 865.0, 2700.0, marks=pytest.mark.slow),
        pytest.param((0.5, 0.3, 0.14), 865.0, 2700.0, marks=pytest.mark.slow),
    ],
)
def test_philae_through_the_wheel_stop_agrees_with_dop853(omega, speed, end, reached):
    vehicle = philae_body()
    slipping, stuck = paper_equations(vehicle)

    def stopped(_t, y):
        return y[3]

    stopped.terminal = True
    options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12}
    first = solve_ivp(slipping, (0, end), [*omega, speed, *FIRST_SUN], events=stopped, **options)
    state = first.y[:, -1].copy()
    state[3] = 0.0
    second = solve_ivp(stuck, (first.t[-1], end), state, **options)
    ours = ss.propagate(vehicle, omega, FIRST_SUN, speed, np.linspace(0, end, 28))
    assert list(ours["event_what"].values) == ["stops"]
    assert ours["event_time_s"].values[0] == pytest.approx(first.t[-1], abs=1e-8)
    np.testing.assert_allclose(ours["sun_B"][-1], second.y[4:, -1], atol=1e-8)
    np.testing.assert_allclose(ours["omega_B"][-1], second.y[:3, -1], atol=1e-8)
    assert ours["wheel_speed_rad_s"].values[-1, 0] == 0.0
    off = np.abs(ours["sun_B"].values[-1] - second.y[4:, -1])
    reached(f"difference of the Sun's direction after {end / 60:.0f} min", off, "", 1e-8)


@pytest.mark.evidence("propagate", "validated", "the paper: the wheel stops after about 42 min")
def test_the_wheel_stops_after_the_published_42_minutes(reached):
    run = ss.propagate(philae_body(), [0, 0, 0], FIRST_SUN, 865.0, [0.0, 2700.0])
    reached("the wheel stops after", run["event_time_s"].values[0] / 60, "min")
    assert run["event_time_s"].values[0] / 60 == pytest.approx(42.0, abs=0.05)
    rounded = philae_body(Friction(1.0e-3, 2.6811e-6))  # the pair as printed
    run = ss.propagate(rounded, [0, 0, 0], FIRST_SUN, 865.0, [0.0, 2700.0])
    assert run["event_time_s"].values[0] == pytest.approx(2595, abs=1.0)


@pytest.mark.evidence(
    "propagate", "verified", "invariants |H|, |r| and H.r, none to three wheels with friction"
)
@pytest.mark.parametrize("n_wheels", [0, 1, pytest.param(2, marks=pytest.mark.long), 3])
def test_momentum_and_energy_are_conserved_to_1e_12(n_wheels, reached):
    rng = np.random.default_rng(n_wheels)
    vehicle = random_vehicle(rng, n_wheels, dry=0.005, viscous=1e-4)
    speeds = rng.uniform(-30, 30, n_wheels) if n_wheels else None
    run = ss.propagate(vehicle, rng.normal(size=3), FIRST_SUN, speeds, np.linspace(0, 600, 601))
    H, r = run["momentum_B"].values, run["sun_B"].values
    assert run.attrs["frame_N"] == BODY_AT_START
    size = np.linalg.norm(H[0])
    assert np.ptp(np.linalg.norm(H, axis=1)) < 1e-12 * size
    assert np.ptp(np.linalg.norm(r, axis=1)) < 1e-12
    assert np.ptp(np.einsum("ij,ij->i", H, r)) < 1e-12 * size
    reached("change of |H| in 600 s, relative", np.ptp(np.linalg.norm(H, axis=1)) / size, "", 1e-12)
    attitude = Rotation.from_quat(run["B_from_N"].values)
    np.testing.assert_allclose(attitude.apply(FIRST_SUN), r, atol=1e-11)
    np.testing.assert_allclose(attitude.apply(H[0]), H, atol=1e-11 * size)
    steps = np.einsum("ni,ni->n", run["B_from_N"].values[1:], run["B_from_N"].values[:-1])
    assert np.all(steps > 0)  # no attitude jumps to the other sign


FAST = {"omega_B": [80.0, 50.0, -60.0], "wheel_speed_rad_s": 0.0}
"""A rate with which friction cannot hold a wheel at rest."""


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"omega_B": [0.1, np.nan, 0]}, "omega_B must be three finite numbers"),
        ({"sun_B": [0.19, 0.62, 0.70]}, "sun_B must be a unit vector"),
        ({"wheel_speed_rad_s": [1.0, 2.0]}, "one finite number for each of the 1 wheel"),
        ({"t_s": [0, 1, 1]}, "all increase, or all decrease"),
        ({"wheel_mode": "stop"}, "must be one of coast, hold, brake"),
        ({"wheel_mode": "brake"}, "has no brake"),
        ({"rtol": 0}, "rtol"),
        ({"stopped_at_s": np.nan}, "one finite time"),
        ({"stopped_at_s": np.array([-3.0, -4.0])}, "one finite time"),
        ({"omega_B": [1e18, 1e18, 0]}, "is it in deg/s"),
        ({"omega_B": [1e200, 1e200, 0]}, "is it in deg/s"),
        ({"wheel_speed_rad_s": 0.0, "t_s": [0.0, -100.0]}, "stopped_at_s"),
        (FAST | {"t_s": [400.0, 0.0], "stopped_at_s": 500.0}, "lies after t = 400 s"),
        (FAST | {"t_s": [0.0, -600.0], "stopped_at_s": -500.0}, "cannot have been stuck before"),
    ],
)
def test_bad_arguments_of_propagate_are_named(change, message):
    given = {"omega_B": [0.1, 0, 0], "sun_B": FIRST_SUN, "wheel_speed_rad_s": 865.0, "t_s": [0, 1]}
    with pytest.raises(ss.MotionError, match=message):
        ss.propagate(philae_body(), **given | change)


def test_a_wheel_that_friction_cannot_hold_breaks_away_at_the_start_and_at_a_command():
    (wheel,) = philae_body().wheels
    weak = replace(wheel, friction=Friction(1e-6, 1e-6), brake_torque_N_m=0.02)
    vehicle = replace(philae_body(), wheels=(weak,))
    for mode, begin in (("coast", 0.0), ([(0.0, "brake"), (10.0, "coast")], 10.0)):
        run = ss.propagate(
            vehicle, [0.1, 0.05, 0.12], FIRST_SUN, 0.0, np.arange(0.0, 30.0, 5.0), mode
        )
        assert run["event_what"].values[0] == "breaks away", mode
        assert run["event_time_s"].values[0] == begin
        turns = run["wheel_speed_rad_s"].values[:, 0] != 0.0
        np.testing.assert_array_equal(turns, run["time"].values > begin)
