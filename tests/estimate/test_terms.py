"""Terms of all sensors and torques: derivatives, closed forms, what an integration adds, and what is left out."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from sunspin.environment import Surroundings
from sunspin.estimate.chain import equations, fit
from sunspin.estimate.model import Body, Model, Noise, Observations, States, Track
from sunspin.estimate.observe import observe
from sunspin.estimate.settings import FIELD_TURN
from sunspin.estimate.terms import torques
from sunspin.estimate.terms.directions import SunDirections
from sunspin.estimate.terms.earth_light import EarthLight
from sunspin.estimate.terms.field import FieldChange, KnownField
from sunspin.estimate.terms.inertial import AttitudeChange, GyroRates, Latency, RateMagnitudes
from sunspin.estimate.terms.panels import DEFAULT_EARTH_SHARE, Panels, ReadingTimes
from sunspin.estimate.terms.term import facing
from sunspin.solve.rotations import rotate_attitude, rotation_between
from sunspin.telemetry.assess import assess
from sunspin.telemetry.gains import FAINT
from sunspin.vehicle.response.flat import PanelResponse
from sunspin.vehicle.sensors import Sensors
from tests.support.passes import slope_of
from tests.support.simulate import CUBE, MAGNETOMETER, cube_with_faults, cube_with_late_sensor
from tests.support.vehicles import CUBE_NORMALS, units
from validation.passes import make

T_S = np.array([0.0, 11.0, 25.0, 33.0, 48.0, 60.0])
N = len(T_S)


def turns(vectors):
    """Return rotation matrices by rotation vectors."""
    return Rotation.from_rotvec(vectors).as_matrix()


def motions(rng, size=0.02, count=2):
    """Return motions of slow bodies whose attitudes follow no equations of motion."""
    attitude = turns(rng.normal(size=(count * N, 3))).reshape(count, N, 3, 3)
    return States(attitude, size * rng.normal(size=(count, N, 3)))


def field_N():
    """Return a field (N, 3) in T that turns in space."""
    return 3e-5 * np.column_stack([np.cos(T_S / 500), np.sin(T_S / 500), 0.4 + T_S / 900])


def field_change(rng):
    """Return a magnetometer with an unknown zero and matrix, of a pass in which one reading is missing."""
    read = rng.normal(size=(N, 3))
    read[3] = np.nan
    term = FieldChange(T_S, read, 0.02, zero_B=0.1 * np.eye(3), matrix_sigma=0.05)
    return replace(term, drift_N=np.zeros((N, 0, 3))).of_pass(T_S)


def known_field(rng):
    """Return readings in a known field, with errors in common."""
    own, along = 1e-6 * rng.normal(size=(2, N, 4, 3))
    read = field_N() + 1e-6 * rng.normal(size=(N, 3))
    return KnownField(T_S, read, np.full(N, 5e-7), field_N(), own, along, 5e-7)


def bare_panels(rng, scale_sigma=0.05, unread=0.0, late_s=0.0):
    """Return readings of six panels with gains known to 10 %; a share is not read, and one panel is read late."""
    sigma, every = np.where(rng.random((N, 6)) < unread, np.inf, 0.03), np.full((N, 6), 0.03)
    response = PanelResponse(CUBE_NORMALS, np.array([1.0, 2.0, 1.0, 1.0, 0.5, 1.0]))
    gain, scale = (np.ones(6), 0.1 * np.eye(6)), (np.full(N, 1.1), np.full(N, scale_sigma))
    instants, shown = ReadingTimes(late_s * np.eye(6)[2], 0.0), np.ones(6, dtype=bool)
    readings, light_slice = (rng.random((N, 6)), sigma, response), (sigma, sigma, every, np.ones(N))
    return Panels(*readings, *gain, *scale, tuple("abcdef"), instants, shown, *light_slice)


def panels(rng, known):
    """Return readings of six panels under the Earth's light, which an orbit knows or not."""
    term = replace(bare_panels(rng), earth_share=0.1)
    light = 0.2 * np.column_stack([np.cos(T_S / 90), np.sin(T_S / 90), 0.3 + 0 * T_S])
    return replace(term, known_N=light if known else None).of_pass(T_S)


def directions(rng, double):
    """Return directions to the Sun, every second of which may mean two things."""
    unit = units(rng.normal(size=(N, 3)))
    spread = np.tile(0.02**2 * np.eye(3), (N, 1, 1))
    second = np.arange(N)[:, None] % 2 == 0 if double else np.zeros((N, 1), dtype=bool)
    others = np.where(second, -unit, np.nan), np.where(second[..., None], spread, np.nan)
    return SunDirections(unit, spread, *others)


def without_one(read):
    """Return readings of which the third is missing."""
    read[2] = np.nan
    return read


def gyro(rng, drifts_over=None):
    """Return a gyro with an uncertain zero and scale, which may drift, of which one reading is missing."""
    read, zero_sigma = without_one(0.02 * rng.normal(size=(N, 3))), np.array([1e-3, 2e-3, 0.0])
    return GyroRates(read, np.arange(float(N)), 1e-3, zero_sigma, 0.01, drifts_over=drifts_over)


TERMS = {
    "direction": lambda rng: directions(rng, double=False),
    "two meanings": lambda rng: directions(rng, double=True),
    "known factor": lambda rng: bare_panels(rng, 0.05, 0.2, 1.5),
    "free factor": lambda rng: bare_panels(rng, 1e3, 0.2, 1.5),
    "size of the rate": lambda rng: RateMagnitudes(without_one(0.04 * rng.random(N)), 0.005, 0.2),
    "neighbours": field_change,
    "known field": known_field,
    "attitude": lambda rng: AttitudeChange(T_S, turns(0.3 * rng.normal(size=(N, 3))), 0.05),
    "free light": lambda rng: panels(rng, known=False),
    "known light": lambda rng: panels(rng, known=True),
    "gyro": gyro,
    "drifting gyro": lambda rng: gyro(rng, (0.0, N - 1.0)),
}


@pytest.mark.evidence(
    "rates", "verified", "finite differences of the cost of panels, gyro, magnetometer and attitude"
)
@pytest.mark.parametrize("late", [False, True], ids=["prompt", "late"])
@pytest.mark.parametrize("name", TERMS)
def test_the_slope_of_the_cost_is_that_of_differences(name, late):
    rng = np.random.default_rng(3)
    seen = motions(rng)
    terms = (TERMS[name](rng), *([Latency(1.0, 3.0)] if late else []))
    # strong torques, so that the readings make the slope
    body = Body(np.diag([1.2, 1.0, 0.8]), np.zeros((0, 3, 3)))
    obs = Observations(T_S, np.zeros((N, 3)), terms)
    model = Model(obs, body, Noise(1e3), 1.0)
    track = Track(seen.attitude, seen.omega, 0.3 * rng.normal(size=(2, len(model.unknowns))))
    system = equations(model, track)

    def cost(nodes):
        """Return the costs with turns and rates (N, 6) changed."""
        attitude = rotate_attitude(track.attitude, np.tile(nodes[:, :3], (2, 1, 1)))
        moved = replace(track, attitude=attitude, omega=track.omega + nodes[:, 3:])
        return equations(model, moved).cost

    # a rate turns both of two late neighbours nearly alike, and a panel that is read late little: terms leave that out
    approximate = name.endswith("factor") or (late and name in ("neighbours", "attitude"))
    # by how much a rate turns the body until a late reading is known to first order
    close = 0.02 if late else 2e-4
    for sample in (0, 1, 2, 4, 5):
        for place in range(3 if approximate else 6):
            step = np.zeros((N, 6))
            step[sample, place] = 1e-6
            ours, scale = system.slope[:, sample, place], np.abs(system.slope).max()
            assert np.allclose(slope_of(cost, step, 1e-6), ours, rtol=close, atol=close * scale)
    for j, step in enumerate(1e-5 * np.eye(track.u.shape[1])):
        by_u = slope_of(lambda h: equations(model, replace(track, u=track.u + h)).cost, step, 1e-5)
        atol = 1e-3 * abs(by_u).max()
        assert np.allclose(by_u, system.border_slope[:, j], rtol=1e-3, atol=atol)


def test_an_even_drift_of_the_field_is_met_by_its_unknowns():
    seen = motions(np.random.default_rng(6), count=1)
    drift = 1e-3 * np.array([0.4, -0.7, 0.2])  # of a field of size one, a second
    field = np.array([0.3, -0.2, 0.9]) + drift * T_S[:, None]
    read = np.einsum("nij,nj->ni", seen.attitude[0], field)
    term = FieldChange(T_S, read, 1e-4, drift_N=np.zeros((N, 0, 3))).of_pass(T_S)
    u = np.zeros((1, len(term.unknowns())))
    u[0, :3] = drift / (FIELD_TURN * np.median(np.linalg.norm(read, axis=1)) / np.sqrt(3))
    (before,) = term.residuals(seen, 0 * u)
    (after,) = term.residuals(seen, u)
    assert np.abs(before.value).max() > 1 and np.abs(after.value).max() < 1e-6


def test_the_zero_of_a_spinner_is_what_its_strengths_show():
    rng = np.random.default_rng(9)
    t_s = 5.0 * np.arange(60)
    field = 1 + 2e-4 * (t_s - 150.0)[:, None]
    turn = Rotation.from_rotvec(0.3 * t_s[:, None] * [[0.6, 0.0, 0.8]])
    read = turn.apply([0.3, -0.5, 0.8]) * field + 0.002 * rng.normal(size=(60, 3))
    zero = np.array([0.3, 0.2, -0.1])
    term = FieldChange(t_s, read + zero, 0.002, zero_B=0.5 * np.eye(3)).with_own_zero()
    across = np.eye(3) - np.outer([0.6, 0.0, 0.8], [0.6, 0.0, 0.8])
    covariance = term.zero_B.T @ term.zero_B
    off = read + zero - term.field_B - zero
    assert np.linalg.norm(across @ off[0]) < 0.05
    sigma = np.sqrt(np.diag(across @ covariance @ across).sum())
    assert sigma < 0.2 and np.sqrt(np.trace(covariance)) > 0.3  # along the spin nothing is learnt


def test_a_zero_that_is_exact_on_one_axis_stays_so_on_that_axis():
    """The other two are what the strengths show; a covariance that is singular there was refused."""
    rng, t_s, zero = np.random.default_rng(9), 5.0 * np.arange(60), np.array([0.3, 0.2, 0.0])
    read = Rotation.random(60, random_state=9).apply([0.3, -0.5, 0.8])
    read += zero + 0.002 * rng.normal(size=(60, 3))
    sensor = replace(MAGNETOMETER, zero_sigma=np.array([0.5, 0.5, 0.0]))
    vehicle = replace(CUBE, sensors=Sensors(magnetometer=sensor))
    telemetry = xr.Dataset({"field_B": (("time", "axis"), read)}, {"time": t_s})
    term = FieldChange.read(vehicle, telemetry).with_own_zero()
    np.testing.assert_allclose((read - term.field_B)[0], zero, atol=0.02)
    assert abs((read - term.field_B)[0, 2]) < 1e-3


@pytest.mark.parametrize("size", [0.0, 0.01, 3.0])
@pytest.mark.parametrize("known", [False, True])
def test_a_magnetic_torque_is_averaged_over_revolutions(size, known):
    rng = np.random.default_rng(11)
    seen = motions(rng, size=1.0, count=1)
    seen = replace(seen, omega=np.repeat(size * seen.omega[:, :1], N, axis=1))
    direction = np.array([0.3, -0.4, 1.2])
    term = torques.MagneticTorque.in_field(np.tile(direction, (N, 1)) if known else None)
    dt = np.diff(T_S)
    push = term.added_by_unknowns(seen, dt)[0, 3]
    share = (np.arange(4000) + 0.5) / 4000
    attitude = rotate_attitude(seen.attitude[0, 3], share[:, None] * seen.omega[0, 3] * dt[3])
    if known:
        each = np.cross(np.eye(3), (attitude @ units(direction))[:, None]) / np.sqrt(2)
    else:
        columns = np.swapaxes(attitude, 1, 2)
        each = np.cross(np.eye(3)[:, None], columns[:, None]).reshape(-1, 9, 3) / np.sqrt(6)
    acceleration = term.sigma * np.swapaxes(each, 1, 2)
    early = (1 - share)[:, None, None]
    assert np.allclose(push[3:], dt[3] * acceleration.mean(axis=0), atol=1e-8)
    assert np.allclose(push[:3], dt[3] ** 2 * (early * acceleration).mean(axis=0), atol=1e-7)


def test_a_stated_dipole_and_gravity_push_as_the_closed_forms_say():
    """Evenly in a constant field; a body with its long axis (z, the least moment) 0.1 rad off the nadir is turned towards it."""
    term = torques.StatedDipole(np.array([0.0, 0.0, 2e-6]), np.tile([1.0, 0.0, 0.0], (N, 1)))
    dt = np.diff(T_S)
    pushed = term.added_by_torque(motions(np.random.default_rng(1)), dt)
    assert np.allclose(pushed[0, :, 4], 2e-6 * dt) and np.allclose(pushed[0, :, 1], 1e-6 * dt**2)
    assert np.abs(pushed[..., [0, 2, 3, 5]]).max() == 0.0

    inertia = np.diag([1.3, 1.3, 0.4])
    attitude = np.tile(turns([0.1, 0.0, 0.0]), (1, 2, 1, 1))
    term = torques.GravityTorque(np.tile([0.0, 0.0, 1.0], (2, 1)), np.full(2, 3e-6), inertia)
    pushed = term.added_by_torque(States(attitude, np.zeros((1, 2, 3))), np.array([10.0]))[0, 0]
    nadir = attitude[0, 0] @ [0.0, 0.0, 1.0]
    pull = 3e-6 * np.cross(nadir, inertia @ nadir) / np.diag(inertia)
    assert np.allclose(pushed, np.concatenate([50 * pull, 10 * pull]), rtol=1e-9, atol=1e-15)


MOMENTS = np.diag([1.2, 1.0, 0.8])
DT, SIZE = 8.0, 1e-6


def integrated(omega, wheel, push=lambda turned: np.zeros(3)):
    """Return attitude and rate after DT, by another integrator: with a momentum wheel(t) and a torque by attitude."""

    def change(t, y):
        total, turned = y[:3], y[3:].reshape(3, 3)
        rate = np.linalg.solve(MOMENTS, total - wheel(t))
        turning = -np.cross(rate, turned, axisb=0, axisc=0)
        return np.concatenate([np.cross(total, rate) + push(turned), turning.ravel()])

    start = np.concatenate([omega @ MOMENTS + wheel(0.0), np.eye(3).ravel()])
    precise = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14, "max_step": 0.5}
    y = solve_ivp(change, (0, DT), start, **precise).y[:, -1]
    return y[3:].reshape(3, 3), np.linalg.solve(MOMENTS, y[:3] - wheel(DT))


def difference(first, second):
    """Return by how much attitude and rate (6) of a second motion differ from those of a first one."""
    return np.concatenate([rotation_between(first[0], second[0]), second[1] - first[1]])


@pytest.mark.parametrize("frame", ["B", "N"])
def test_a_constant_torque_pushes_as_an_integration_with_it_does(frame):
    momentum, omega = np.array([0.0, 0.01, 0.0]), np.array([0.05, -0.02, 0.08])
    attitude = facing(np.array([0.6, 0.0, 0.8]))
    torque = torques.ConstantTorque(frame, 1.0, (1.0,), MOMENTS, np.tile(momentum, (2, 1)))
    seen = States(np.tile(attitude, (1, 2, 1, 1)), np.tile(omega, (1, 2, 1)))
    push = torque.added_by_unknowns(seen, np.array([DT]))[0, 0]

    def end(axis):
        """Return the end of a motion under a torque along an axis of the body or of space."""
        in_B = {
            "B": lambda turned: SIZE * axis,
            "N": lambda turned: SIZE * turned @ attitude @ axis,
        }
        return integrated(omega, lambda t: momentum, in_B[frame])

    free = end(np.zeros(3))
    for k, axis in enumerate(np.eye(3)):
        change = difference(free, end(axis)) / SIZE
        assert np.allclose(push[:, k], change, rtol=0.03, atol=0.03 * np.abs(change).max())


def test_a_wheel_that_changes_its_speed_turns_the_body_as_an_integration_does():
    """Along a ramp within the interval, and by each error of the ramp and of the momentum at the knots."""
    axis, omega = np.array([0.0, 0.6, 0.8]), np.array([0.03, -0.02, 0.05])
    h = np.array([0.0, 0.01, 0.0])
    t_s, ramp = np.array([0.0, DT]), torques.Ramp(2.0, 6.0, SIZE)
    momentum = h + np.outer(ramp.change(t_s), axis)
    wheel = torques.WheelChange(t_s, axis, ramp, 1.0, MOMENTS, momentum)
    seen = States(np.tile(np.eye(3), (1, 2, 1, 1)), np.tile(omega, (1, 2, 1)))

    def end(lost):
        """Return the end of a motion with this momentum, lost(t), taken up by the wheel."""
        return integrated(omega, lambda t: h + lost(t) * axis)

    straight, after_ramp = end(lambda t: SIZE * t / DT), end(ramp.change)

    known = wheel.added_by_torque(seen, np.array([DT]))[0, 0]
    # a ramp in the middle is even about it
    assert np.abs(known).max() < 1e-12
    assert np.abs(difference(straight, after_ramp)).max() < 0.1 * SIZE
    late = replace(wheel, ramp=torques.Ramp(5.0, 7.0, SIZE))
    known = late.added_by_torque(seen, np.array([DT]))[0, 0]
    exact = difference(straight, end(late.ramp.change))
    # the body turns by 0.5 rad in the interval; to first order in that
    assert np.allclose(known[:3], exact[:3], atol=0.15 * np.abs(exact[:3]).max())

    by_errors = wheel.added_by_unknowns(seen, np.array([DT]))[0, 0]
    longer = difference(after_ramp, end(lambda t: 1.1 * ramp.change(t))) / 0.1
    assert np.allclose(by_errors[:, 0], longer, atol=0.05 * np.abs(longer).max())
    later = difference(after_ramp, end(torques.Ramp(2.0, 6.1, SIZE).change)) / 0.1
    assert np.allclose(by_errors[:3, 2], later[:3], atol=0.15 * np.abs(later[:3]).max())


def test_opposite_panels_see_sun_and_earth_as_one_vector():
    rng = np.random.default_rng(12)
    seen = motions(rng, count=1)
    term = panels(rng, known=False)
    light = np.array([0.1, -0.05, 0.08])
    u = np.zeros((1, len(term.unknowns())))
    u[0, 6:9] = light / np.linalg.norm(term.earth.light_N[0, 0])
    earth = EarthLight(term.earth.light_N, np.zeros(6))
    more, _ = earth.on_panels(term.response, term.gain, seen.attitude, u[:, 6:])
    share = more / term.full_sun
    both = np.einsum("knij,j->kni", seen.attitude, light)
    assert np.allclose(share[..., :3] - share[..., 3:], both, atol=1e-12)


def test_panels_in_the_shadow_must_be_dark_and_show_no_sun():
    rng = np.random.default_rng(13)
    term = replace(panels(rng, known=False), earth=None)
    lit = np.array([1.0, 1.0, 0.5, 0.0, 0.0, 0.0])
    here = Surroundings(np.tile([0.0, 0.0, 1.0], (N, 1)), lit=lit, lit_sigma=np.full(N, 0.001))
    placed = term.placed(here)
    assert list(placed.present()) == [True, True, True, False, False, False]
    assert placed.scale_sigma[2] > 0.5 and placed.scale_sigma[0] == 0.05
    seen = motions(rng, count=1)
    (residual,) = placed.residuals(seen, np.zeros((1, len(placed.unknowns()))))
    assert np.abs(residual.by_turn[:, 3:]).max() == 0.0
    assert np.allclose(residual.value[0, 4, :6], -placed.power[4] / placed.dark_sigma[4])


def bent_by_a_magnetometer(off, zero_sigma, matrix, matrix_sigma):
    """Return the fit of a cube that a wrong magnetometer watches, begun at its true motion, and the true rates (n, 3)."""
    data, run = cube_with_late_sensor("field", 0.0, np.random.default_rng(4), 9)
    part = replace(MAGNETOMETER, zero_sigma=np.full(3, zero_sigma))
    vehicle = replace(CUBE, sensors=Sensors(magnetometer=part))
    read = (data["field_B"].values + off) @ matrix.T
    data = data.assign(field_B=(("time", "axis"), read))
    obs = observe(assess(vehicle, data)).obs
    terms = tuple(
        replace(term, matrix_sigma=matrix_sigma) if isinstance(term, FieldChange) else term
        for term in obs.terms
    )
    obs = replace(obs, terms=terms).of_pass(np.arange(len(obs)))
    model = Model(obs, Body.of(vehicle), Noise(1e-5), 0.05)
    attitude = Rotation.from_quat(run["B_from_N"].values).as_matrix()
    sun_N = attitude[0].T @ run["sun_B"].values[0]
    truth = run["omega_B"].values
    start = Track.unfitted((attitude @ facing(sun_N))[None], truth[None])
    return fit(model, replace(start, u=np.zeros((1, len(model.unknowns)))), 60), truth


def pull_of(one, truth):
    """Return the rms of the rates' errors over their sigmas."""
    off = one.motions.omega[0] - truth
    covariance = one.motions.covariance[0, :, 3:, 3:]
    return np.sqrt(np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off).mean() / 3)


@pytest.mark.evidence(
    "rates", "modelled", "a simulated magnetometer whose zero is off by its stated sigma"
)
def test_an_uncertain_magnetometer_zero_is_estimated():
    """Taken for exact, a zero off by a third of the field bends the motion by many sigmas; with its sigma stated it does not."""
    off = np.array([0.3, -0.25, 0.2])
    exact, known = (bent_by_a_magnetometer(off, sigma, np.eye(3), 0.0) for sigma in (0.0, 0.3))
    assert pull_of(*known) < 1.6 < 2.5 < pull_of(*exact)


@pytest.mark.evidence(
    "rates", "modelled", "a simulated magnetometer with soft iron and an uncalibrated zero"
)
def test_an_uncertain_magnetometer_matrix_is_estimated():
    """Of a fast spinner soft iron turns the axis by degrees: by more sigmas if the matrix is taken for exact."""
    rng, pulls = np.random.default_rng(3), []
    for _ in range(6):
        matrix = np.eye(3) + 0.05 * rng.normal(size=(3, 3))
        cases = [bent_by_a_magnetometer(np.zeros(3), 0.0, matrix, sigma) for sigma in (0.0, 0.05)]
        pulls.append([pull_of(*each) for each in cases])
    exact, known = np.transpose(pulls)
    assert np.median(known) < 1.3 and known.max() < 2 and (exact > known).all(), pulls


def test_without_albedo_no_light_of_the_earth_is_estimated():
    data, _ = cube_with_faults((), np.random.default_rng(1))
    read, _ = Panels.read(assess(CUBE, data))
    assert read.earth_share < FAINT and read.of_pass(data["time"].values).earth is None


def test_samples_without_a_gyro_reading_do_not_sharpen_it_in_the_search():
    unread, some = np.full((2, 100, 3), np.nan)
    some[::10] = 0.02
    for read, sigma in ((some, pytest.approx(1e-2, rel=1e-3)), (unread, 1e-4)):
        gyro = GyroRates(read, np.arange(100.0), 1e-4, np.full(3, 1e-2), 0.0)
        assert gyro.for_search()[0].sigma == sigma


@pytest.mark.parametrize(("count", "field"), [(1, True), (1, False), (6, True)])
def test_panels_that_cannot_show_the_light_of_the_earth_have_it_as_an_unknown(count, field):
    """A single panel is never opposite to a lit one. Six panels would show it, and here there is hardly any.

    Who reads no magnetometer may be far from the Earth.
    """
    made = make("right model", 0, 1)
    vehicle = replace(made.vehicle, panels=made.vehicle.panels[:count])
    data = made.telemetry.isel(panel=slice(count))
    if field:
        data["field_B"] = ("time", "axis"), np.ones((data.sizes["time"], 3))
    panels, _ = Panels.read(assess(vehicle, data))
    unseen = count == 1 and field
    assert panels.earth_share == DEFAULT_EARTH_SHARE if unseen else panels.earth_share < 0.05
