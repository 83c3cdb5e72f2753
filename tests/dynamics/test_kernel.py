"""The Taylor kernel against heyoka on random bodies, event for event, and against the plain equations."""

from dataclasses import replace
from functools import cached_property

import numpy as np
import pytest

import sunspin as ss
from sunspin.dynamics import batch, gyrostat
from sunspin.dynamics.bodies import Bodies
from sunspin.dynamics.kernels import rows
from sunspin.dynamics.torques import Acting, Steady
from sunspin.dynamics.wheel_modes import friction_limit
from sunspin.solve.linear import symmetric_inverse
from sunspin.vehicle import Friction
from tests.support.heyoka_witness import Torques, witness
from tests.support.vehicles import FIRST_SUN, philae_body, random_vehicle

SUN = FIRST_SUN / np.linalg.norm(FIRST_SUN)
TIMES = np.linspace(0.0, 120.0, 25)
WHAT = {rows.STOPS: "stops", rows.BREAKS_AWAY: "breaks away", rows.REVERSES: "reverses"}


def problem_of(vehicle, omega, speeds, command="coast", forces=None, bodies=None) -> batch.Problem:
    omega, speeds = np.atleast_2d(omega), np.atleast_2d(speeds)
    initial = batch.Rows(omega, np.tile(SUN, (len(omega), 1)), speeds, bodies)
    return batch.Problem(vehicle, initial, batch.one_command(vehicle, command), forces or Acting())


def compare(vehicle, omega, speeds, t, command="coast", torques=None, problem=None) -> int:
    """Compare one motion and all its events; how many there were."""
    expected = witness(vehicle, omega, SUN, speeds, t, command, torques)
    if problem is None:
        problem = problem_of(vehicle, omega, speeds, command)
    motion = batch.advance(problem, np.asarray(t[1:]), 1e-12, True, room=500)
    scale = np.abs(expected.omega_B).max()
    assert motion.outcome[0] == batch.Outcome.FINE
    np.testing.assert_allclose(motion.sun_B[0], expected.sun_B[1:], atol=3e-11)
    np.testing.assert_allclose(motion.attitude[0], expected.attitude[1:], atol=3e-11)
    np.testing.assert_allclose(motion.omega_B[0], expected.omega_B[1:], atol=3e-11 * scale)
    limit = 3e-11 * max(np.abs(speeds).max(initial=0.0), scale)
    np.testing.assert_allclose(motion.wheel_speed_rad_s[0], expected.speeds[1:], atol=limit)
    ours = motion.events[0, : motion.n_events[0]]
    seen = [(int(wheel), WHAT[int(what)]) for _, wheel, what in ours]
    assert seen == [event[1:] for event in expected.events]
    np.testing.assert_allclose(ours[:, 0], [event[0] for event in expected.events], atol=1e-9)
    return len(ours)


CASES = [
    ("coast", 0, 0.0, 1.0),
    *(("coast", n_wheels, 0.004, 1.0) for n_wheels in (1, 2, 3)),
    ("coast", 4, 0.004, 0.25),
    ("hold", 2, 0.004, 1.0),
    ("brake", 2, 0.001, 1.0),
]


@pytest.mark.evidence(
    "propagate",
    "verified",
    "heyoka on equations typed in the tests: random bodies, all wheel events",
)
@pytest.mark.parametrize("n", [2, pytest.param(20, marks=pytest.mark.long)], ids=["few", "many"])
@pytest.mark.parametrize(("command", "n_wheels", "dry", "length"), CASES)
def test_random_bodies_move_as_heyoka_says_event_for_event(command, n_wheels, dry, length, n):
    rng = np.random.default_rng(n_wheels + len(command))
    events = 0
    for _ in range(n):
        vehicle = random_vehicle(rng, n_wheels, dry=dry, viscous=2e-4)
        braked = tuple(replace(wheel, brake_torque_N_m=0.003) for wheel in vehicle.wheels)
        vehicle = replace(vehicle, wheels=braked)
        omega, speeds = 0.5 * rng.normal(size=3), rng.uniform(-20, 20, n_wheels)
        events += compare(vehicle, omega, speeds, length * TIMES, command)
    assert (events > 0) == (dry > 0 and command != "hold")


@pytest.mark.parametrize(("n_wheels", "dry"), [(0, 0.0), (2, 0.0), (1, 1e-3)])
def test_random_bodies_move_backward_as_heyoka_says(n_wheels, dry):
    rng = np.random.default_rng(7)
    vehicle = random_vehicle(rng, n_wheels, dry=dry, viscous=2e-4)
    compare(vehicle, 0.5 * rng.normal(size=3), rng.uniform(5, 20, n_wheels), -TIMES)


def test_a_wheel_reverses_backward_as_heyoka_says():
    vehicle = random_vehicle(np.random.default_rng(1), 1, dry=0.001)
    for omega in ([0.8, 0.5, -0.6], [-0.9, 0.7, 0.8]):
        assert compare(vehicle, np.array(omega), np.array([0.1]), -TIMES / 4) > 0


def test_steady_torques_turn_a_body_with_a_wheel_as_heyoka_says():
    rng = np.random.default_rng(11)
    for _ in range(3):
        vehicle = random_vehicle(rng, 1, dry=0.004, viscous=2e-4)
        omega = 0.5 * rng.normal(size=3)
        speeds = rng.uniform(-20, 20, 1)
        torques = 1e-3 * rng.normal(size=(2, 3))
        problem = problem_of(vehicle, omega, speeds, forces=Acting((Steady(torques),)))
        compare(vehicle, omega, speeds, TIMES, torques=Torques(*torques), problem=problem)


HARD = [[-0.275, 0.82, 0.285], [-0.335, 1.0, -0.165], [-0.35, 0.82, 0.21]]
"""Rates with which the second wheel is held and let go up to 17 times, once for much less than a step."""


@pytest.mark.parametrize("omega", HARD)
def test_a_wheel_that_is_held_and_let_go_again_and_again_does_so_as_heyoka_says(omega):
    """It may break away just at its limit, turn for a moment only, and stop within the same step, whatever error is allowed."""
    vehicle, speeds = philae_body(), [865.0, -605.5]
    (wheel,) = vehicle.wheels
    across = replace(wheel, name="across", axis_B=[1.0, 0.0, 0.0])
    vehicle = replace(vehicle, wheels=(wheel, across))
    assert compare(vehicle, np.array(omega), np.array(speeds), np.linspace(0, 2700, 28)) > 5
    exact = ss.propagate(vehicle, omega, SUN, speeds, [0.0, 2700.0])["sun_B"].values[-1]
    rows = batch.Rows(np.array([omega]), SUN[None], np.array([speeds]))
    for wanted in (1e-2, 1e-5, 1e-6, 1e-8):
        result = batch.run(vehicle, rows, 2700.0, error=wanted)
        assert result.outcome[0] == batch.Outcome.FINE
        assert np.linalg.norm(result.sun_B[0, 0] - exact) < wanted


STEP, WEIGHTS = 0.02, (4 / 5, -1 / 5, 4 / 105, -1 / 280)
"""Central differences of order eight."""


def plain_parameters(vehicle, commands, speeds) -> gyrostat.Parameters:
    """The numbers of the plain equations for wheels in these modes: "stuck", or under a command."""
    free = np.array([command in ("coast", "brake") for command in commands])
    J = np.array([wheel.inertia_kg_m2 for wheel in vehicle.wheels])
    axes = np.array([wheel.axis_B for wheel in vehicle.wheels])
    wheels = []
    for wheel, command, is_free, speed in zip(vehicle.wheels, commands, free, speeds, strict=True):
        body, dry = 1 / wheel.inertia_kg_m2, np.sign(speed) * friction_limit(wheel, command)
        law = float(is_free), dry, wheel.friction.viscous_N_m_s
        wheels.append(gyrostat.WheelParameters(tuple(wheel.axis_B), body, *law))
    inverse = symmetric_inverse(gyrostat.free_inertia(vehicle, free))
    return gyrostat.Parameters(tuple(inverse), tuple((J * speeds * ~free) @ axes), tuple(wheels))


MODES = "coast hold brake-coast coast-coast-coast hold-coast-stuck stuck-brake-hold".split()


@pytest.mark.parametrize("sense", [1.0, -1.0], ids=["forward", "backward"])
@pytest.mark.parametrize("modes", MODES)
def test_the_motion_satisfies_the_plain_equations_to_1e_10(modes, sense):
    """Random bodies, oblique wheels in all modes, and steady torques in body axes and in space."""
    commands, rng = modes.split("-"), np.random.default_rng(3)
    n = len(commands)
    for _ in range(4):
        vehicle = random_vehicle(rng, n, dry=1e-4, viscous=2e-4)
        wheels = []
        for wheel, command in zip(vehicle.wheels, commands, strict=True):
            law = Friction(1.0, 0.0) if command == "stuck" else wheel.friction
            wheels.append(replace(wheel, brake_torque_N_m=3e-4, friction=law))
        vehicle = replace(vehicle, wheels=wheels)
        speeds = rng.uniform(8, 15, n) * rng.choice([-1, 1], n) * (np.array(commands) != "stuck")
        torques = 1e-3 * rng.normal(size=(2, 3))
        asked = ["coast" if command == "stuck" else command for command in commands]
        problem = problem_of(
            vehicle, 0.3 * rng.normal(size=3), speeds, asked, Acting((Steady(torques),))
        )
        times = sense * (1.0 + STEP * np.arange(-4, 5))
        motion = batch.advance(problem, times, 1e-13, attitude=True)
        y = motion.states[0]
        slope = sum(w * (y[4 + k] - y[4 - k]) for k, w in enumerate(WEIGHTS, 1)) / (sense * STEP)
        torque = torques[0] + motion.attitude[0, 4] @ torques[1]
        p = plain_parameters(vehicle, commands, speeds)
        free = np.array([wheel.free > 0 for wheel in p.wheels])
        H, h, r = y[4, :3], y[4, 3 : 3 + n], y[4, 3 + n : 6 + n]
        dH, dh, dr = gyrostat.rhs(H, h, r, p, torque)
        np.testing.assert_allclose(slope[:3], dH, atol=1e-10)
        np.testing.assert_allclose(slope[3 + n : 6 + n], dr, atol=1e-10)
        np.testing.assert_allclose(slope[3 : 3 + n][free], np.array(dh)[free], atol=1e-10)
        # h of a wheel that is held changes by the torque that this takes
        holding = np.array([gyrostat.holding_torque(H, h, p, i, torque) for i in range(n)])
        np.testing.assert_allclose(slope[3 : 3 + n][~free], holding[~free], atol=1e-10)
        np.testing.assert_allclose(y[4, 6 + n : 9 + n], gyrostat.body_rate(H, h, p), atol=1e-12)


def test_a_schedule_and_a_run_back_through_a_stop_are_those_of_heyoka():
    """Two wheels are held, coast, and are braked to a stop: legs of one command each by the witness, with all events."""
    rng = np.random.default_rng(8)
    vehicle = random_vehicle(rng, 2, dry=2e-3, viscous=2e-4)
    wheels = tuple(replace(wheel, brake_torque_N_m=0.02) for wheel in vehicle.wheels)
    vehicle = replace(vehicle, wheels=wheels)
    omega, speeds = np.array([0.05, -0.03, 0.08]), np.array([9.0, 12.0])
    legs = [(0.0, "hold"), (10.0, "coast"), (20.0, "brake"), (60.0, "coast")]
    times = [0.0, 10.0, 20.0, 60.0, 90.0]
    track = ss.propagate(vehicle, omega, SUN, speeds, times, wheel_mode=legs)
    sun, events = SUN, []
    for k, (begin, command) in enumerate(legs):
        expected = witness(vehicle, omega, sun, speeds, [begin, times[k + 1]], command)
        omega, sun, speeds = expected.omega_B[-1], expected.sun_B[-1], expected.speeds[-1]
        events += expected.events
        np.testing.assert_allclose(track["omega_B"].values[k + 1], omega, atol=1e-11)
        np.testing.assert_allclose(track["sun_B"].values[k + 1], sun, atol=3e-11)
        np.testing.assert_allclose(track["wheel_speed_rad_s"].values[k + 1], speeds, atol=1e-9)
    assert [what for _, _, what in events] == ["stops", "stops"]
    assert track["event_what"].values.tolist() == ["stops", "stops"]
    assert track["event_wheel"].values.tolist() == [f"w{i}" for _, i, _ in events]
    np.testing.assert_allclose(track["event_time_s"].values, [t for t, _, _ in events], atol=1e-9)
    # backward, the stops have to be given
    stopped = [next(t for t, i, _ in events if i == wheel) for wheel in range(2)]
    end = omega, sun, speeds, times[::-1]
    back = ss.propagate(vehicle, *end, wheel_mode=legs, stopped_at_s=stopped)
    there = {name: track[name].values[::-1] for name in ("omega_B", "sun_B", "wheel_speed_rad_s")}
    np.testing.assert_allclose(back["omega_B"].values, there["omega_B"], atol=1e-9)
    np.testing.assert_allclose(back["sun_B"].values, there["sun_B"], atol=1e-8)
    np.testing.assert_allclose(
        back["wheel_speed_rad_s"].values, there["wheel_speed_rad_s"], atol=1e-7
    )
    np.testing.assert_allclose(back["event_time_s"].values, sorted(stopped)[::-1], atol=1e-9)
    assert back["event_what"].values.tolist() == ["stops", "stops"]


def test_bodies_of_their_own_move_as_such_vehicles_and_neighbours_do_not_matter_to_a_bit():
    rng = np.random.default_rng(3)
    vehicle, n = random_vehicle(rng, 2, dry=0.004, viscous=2e-4), 70
    bodies = Bodies.of(vehicle, n)
    inertia = bodies.inertia_kg_m2 * rng.uniform(0.8, 1.2, (n, 1, 1))
    coulomb = bodies.coulomb_N_m * rng.uniform(0.5, 1.5, (n, 2))
    bodies = replace(bodies, inertia_kg_m2=inertia, coulomb_N_m=coulomb)
    omega, speeds = 0.4 * rng.normal(size=(n, 3)), rng.uniform(-20, 20, (n, 2))
    t = np.array([10.0, 60.0, 120.0])
    initial = batch.Rows(omega, np.tile(SUN, (n, 1)), speeds, bodies)
    together = batch.run(vehicle, initial, t, error=1e-9)
    some = rng.permutation(n)[:37]
    alone = batch.run(vehicle, initial.take(some), t, error=1e-9)
    assert np.array_equal(alone.states, together.states[some])
    for i in some[:2]:
        track = witness(bodies.vehicle(vehicle, i), omega[i], SUN, speeds[i], [0.0, *t])
        np.testing.assert_allclose(together.sun_B[i], track.sun_B[1:], atol=1e-9)
        np.testing.assert_allclose(together.omega_B[i], track.omega_B[1:], atol=1e-9)


def test_outputs_at_the_start_and_next_to_each_other_are_states_of_one_motion():
    vehicle = random_vehicle(np.random.default_rng(4), 1, dry=0.004)
    omega, speeds = np.array([0.3, -0.2, 0.4]), np.array([6.0])
    problem = problem_of(vehicle, omega, speeds)
    many = np.sort(np.append(np.linspace(0, 60, 400), [0.0, 1e-9, 30.0, 30.0]))
    motion = batch.advance(problem, many, 1e-12)
    np.testing.assert_allclose(motion.omega_B[0, :2], [omega, omega], atol=1e-15)
    few = batch.advance(problem, np.array([30.0, 60.0]), 1e-12)
    at = [int(np.flatnonzero(many == t)[0]) for t in (30.0, 60.0)]
    np.testing.assert_allclose(motion.states[0, at], few.states[0], rtol=1e-10, atol=1e-10)


def test_numbers_that_are_none_end_with_an_outcome_and_leave_neighbours_alone():
    vehicle, bad = philae_body(), [0, 7, 39]
    omega = np.tile([0.1, 0.2, 0.3], (40, 1))
    good = batch.Rows(omega, np.tile(SUN, (40, 1)), np.full((40, 1), 865.0))
    expected = batch.run(vehicle, good, [10.0, 60.0])
    spoilt = omega.copy()
    spoilt[bad, 1] = np.nan, np.inf, 1e200
    motion = batch.run(vehicle, replace(good, omega_B=spoilt), [10.0, 60.0], leave_long=True)
    others = np.delete(np.arange(40), bad)
    assert np.all(motion.outcome[bad] == batch.Outcome.NOT_FINITE)
    assert np.all(np.isnan(motion.states[bad, -1]))
    assert np.array_equal(motion.states[others], expected.states[others])


def test_motions_at_rest_without_momentum_and_without_time_are_followed():
    vehicle = random_vehicle(np.random.default_rng(1), 1, dry=0.001)
    still = batch.run(vehicle, batch.Rows(np.zeros((1, 3)), SUN[None], np.zeros((1, 1))), 60.0)
    assert np.array_equal(still.sun_B[0, 0], SUN) and still.outcome[0] == batch.Outcome.FINE
    omega = -5.0 * 0.02 * np.linalg.solve(vehicle.inertia_kg_m2, vehicle.wheels[0].axis_B)
    compare(vehicle, omega, np.array([5.0]), np.linspace(0, 60, 4))  # H = 0
    now = batch.run(vehicle, batch.Rows(omega[None], SUN[None], np.full((1, 1), 5.0)), 0.0)
    np.testing.assert_allclose(now.omega_B[0, 0], omega, atol=1e-15)
    # a wheel at rest has no past
    turning = batch.Rows(np.array([[0.1, 0.2, 0.3]]), SUN[None], np.zeros((1, 1)))
    assert batch.run(philae_body(), turning, -60.0).outcome[0] == batch.Outcome.PAST_UNKNOWN


class AllOfOmega(batch.Problem):
    """The same motions, with no part of omega left out of the series."""

    @cached_property
    def modes(self) -> np.ndarray:
        """Return the modes with a share of H of zero."""
        return super().modes * np.array([0.0] + [1.0] * 6)


@pytest.mark.parametrize("end_s", [600.0, -200.0])
def test_what_is_left_out_under_steady_torques_changes_no_motion_by_1e_10_and_saves_steps(end_s):
    """Torques that turn H by far more than `wheels.FAR`, and those of a lander; forward and backward, with a wheel."""
    rng = np.random.default_rng(4)
    vehicle = philae_body()
    omega = 0.1 * rng.normal(size=(32, 3))
    bodies = replace(Bodies.of(vehicle, 32), steady_N_m=1e-6 * rng.normal(size=(32, 2, 3)))
    bodies.steady_N_m[:16] *= 1e3
    initial = batch.Rows(omega, np.tile(SUN, (32, 1)), rng.uniform(5, 9, (32, 1)), bodies)
    given = vehicle, initial, ("coast",), Acting((Steady(),))
    times = end_s * np.array([0.4, 1.0])
    for error, agreed in ((1e-12, 1e-10), (3e-8, 1e-4)):
        less, whole = (
            batch.advance(kind(*given), times, error, True) for kind in (batch.Problem, AllOfOmega)
        )
        np.testing.assert_allclose(less.states, whole.states, atol=agreed)
    assert less.steps[16:].mean() < 0.75 * whole.steps[16:].mean()


@pytest.mark.parametrize(
    "wanted",
    [pytest.param(1e-4, marks=pytest.mark.long), 1e-6, pytest.param(1e-8, marks=pytest.mark.long)],
)
def test_the_law_of_errors_holds_on_random_bodies_and_near_unstable_spins(wanted):
    """Moments of all shapes; a third of the motions begins within 1e-3 of the middle axis, and their wheels reverse again and
    again: an event found with the error of a coarse step must not be found again at once."""
    rng = np.random.default_rng(21)
    for _ in range(4):
        vehicle = random_vehicle(rng, 1, dry=1e-4, viscous=1e-5)
        axes = np.linalg.eigh(vehicle.inertia_kg_m2)[1]
        omega = 0.5 * rng.normal(size=(96, 3))
        omega[:32] = 0.5 * (axes[:, 1] + 1e-3 * rng.normal(size=(32, 3)))
        initial = batch.Rows(omega, np.tile(SUN, (96, 1)), rng.uniform(-20, 20, (96, 1)))
        initial.wheel_speed_rad_s[:32] *= 1e-3
        motion = batch.run(vehicle, initial, 600.0, error=wanted)
        exact = batch.advance(batch.Problem(vehicle, initial, ("coast",)), np.array([600.0]), 1e-13)
        error = np.linalg.norm(motion.sun_B[:, 0] - exact.sun_B[:, 0], axis=1)
        assert np.all(motion.outcome == batch.Outcome.FINE)
        assert error.max() < wanted
