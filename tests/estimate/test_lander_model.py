"""The model of a lander: its motion, its prior, and what is read of a stretch of telemetry."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

import sunspin as ss
from sunspin.estimate.lander.motions import LanderMotions
from sunspin.estimate.lander.priors import constant_torques, with_priors
from sunspin.estimate.lander.window import observe_window
from sunspin.telemetry.assess import assess
from tests.support.landers import OMEGA, PHILAE, SUN, lander_model, lander_telemetry, nominal
from tests.support.passes import slope_of


def test_a_motion_is_that_of_propagate_from_any_reference():
    """From the first sample, and from the fifth with the wheel as it is then, but for its reaction to the body's own changes."""
    t_s = 100.0 * np.arange(8)
    model = lander_model(t_s)
    run = ss.propagate(PHILAE, OMEGA, SUN, [w.speed_rad_s for w in PHILAE.wheels], t_s)
    carried = model.sun_states(nominal(model), 1e-9)
    np.testing.assert_allclose(carried.sun_B[0], run["sun_B"].values, atol=1e-7)
    later, fifth = model.after(400.0, model.max_rate), run.isel(time=[4])
    at = LanderMotions(fifth["omega_B"].values, fifth["sun_B"].values, nominal(model).u)
    speeds = fifth["wheel_speed_rad_s"].values
    np.testing.assert_allclose(later.wheel_speeds(at.u), speeds, rtol=2e-4)
    again = later.sun_states(at, 1e-9)
    np.testing.assert_allclose(again.sun_B[0], run["sun_B"].values, atol=0.02)
    np.testing.assert_allclose(again.omega[0], run["omega_B"].values, atol=2e-3)
    assert later.first_speed(at, 1e-9)[0] == pytest.approx(np.linalg.norm(OMEGA), rel=1e-2)


def test_unknowns_change_the_body_that_they_name():
    model = lander_model()
    for name, field, element in (
        ("inertia_yy", "inertia_kg_m2", (0, 1, 1)),
        ("log_coulomb", "coulomb_N_m", (0, 0)),
        ("log_viscous", "viscous_N_m_s", (0, 0)),
    ):
        at = [x.name for x in model.unknowns].index(name)
        u = np.zeros((1, len(model.unknowns)))
        before = np.array(getattr(model.bodies(u), field))
        u[0, at] = 1.0
        after = np.array(getattr(model.bodies(u), field))
        unknown = model.unknowns[at]
        factor = 1 + unknown.sigma / unknown.centre if "inertia" in name else np.exp(unknown.sigma)
        assert after[element] == pytest.approx(factor * before[element])
        before[element] = after[element]
        np.testing.assert_allclose(after, before)


def test_a_body_that_cannot_exist_is_drawn_in_until_it_can():
    """The largest moment is at most the sum of the others; what can exist stays as it is."""
    model = lander_model(inertia=0.3)
    u = np.zeros((2, len(model.unknowns)))
    at = [x.name for x in model.unknowns].index("inertia_zz")
    u[0, at], u[1, at] = 7.0, 0.5
    drawn_in = model.possible(u)
    np.testing.assert_array_equal(drawn_in[1], u[1])
    moments = np.linalg.eigvalsh(model.bodies(u).inertia_kg_m2[0])
    assert moments[2] == pytest.approx(moments[0] + moments[1], rel=1e-6)
    assert 0 < drawn_in[0, at] < 7.0
    density = model.log_prior_density(replace(nominal(model, 2), u=u))
    assert np.isinf(density).tolist() == [True, False]
    # of a normal prior with 30 % some bodies cannot exist, and the rest is normalised
    assert -2.0 < model.log_possible < -0.01


@pytest.mark.parametrize("kind", ["inertia", "steady_torque"])
def test_a_prior_of_several_sigmas_is_a_mixture_of_weight_one(kind):
    """As the density of a distance from the centre, in three dimensions, it integrates to one; weights are its slopes."""
    model = lander_model()
    if kind == "steady_torque":
        model = constant_torques(lander_model(inertia=0.0), {})[0]
    places = model.indices(kind)
    assert len(places) == 3

    def cost(distance: float) -> tuple[float, float]:
        u = np.zeros((1, len(model.unknowns)))
        u[0, places[1]] = distance
        total, weight = model.prior_cost(u)
        return float(total[0]), float(weight[0, places[1]])

    def shell(log_distance: float) -> float:
        distance = np.exp(log_distance)
        return 4 * np.pi * distance**3 * np.exp(-cost(distance)[0]) / (2 * np.pi) ** 1.5

    assert quad(shell, np.log(1e-5), np.log(60.0), limit=300)[0] == pytest.approx(1.0, rel=1e-3)
    for distance in (0.5, 2.0, 8.0):
        by_distance = slope_of(lambda h, at=distance: cost(at + h)[0], 1e-5, 1e-5)
        assert by_distance == pytest.approx(cost(distance)[1] * distance, rel=1e-5)
    # one of the sigmas alone is a normal law
    u = np.zeros((1, len(model.unknowns)))
    u[0, places[1]] = 1.0
    share = model.unknowns[places[0]].shares[1]
    alone = model.prior_cost(u, {kind: 1})[0] - model.prior_cost(0 * u, {kind: 1})[0]
    assert alone[0] == pytest.approx(0.5 / share**2)


def test_a_constant_torque_turns_the_body_by_its_largest_angle_over_the_samples():
    """300 degrees by one sigma, or the caller's; zero means that none acts."""
    model = lander_model()
    duration = float(np.ptp(model.obs.t_s))
    in_body, in_space = constant_torques(model, {})
    assert (in_body.frame, in_space.frame) == ("B", "N")
    sigma = in_body.unknowns[in_body.indices("steady_torque")[0]].sigma
    assert sigma * duration**2 / 2 == pytest.approx(np.radians(300.0))
    small = constant_torques(model, {"steady_torque": 20.0})[0]
    unknown = small.unknowns[small.indices("steady_torque")[0]]
    assert unknown.sigma * duration**2 / 2 <= np.radians(20.0)
    assert constant_torques(model, {"steady_torque": 0.0}) == []
    # a torque about z speeds a body that rests, without its wheel, by torque over moment of inertia
    rest = replace(in_body, vehicle=replace(PHILAE, wheels=()), of_motion=in_body.of_motion[-3:])
    u = np.zeros((1, len(rest.unknowns)))
    u[0, 2] = 1.0
    carried = rest.sun_states(LanderMotions(np.zeros((1, 3)), SUN[None], u), 1e-9)
    inertia = PHILAE.require_inertia()
    rate = sigma * (np.trace(inertia) / 3) * np.linalg.solve(inertia, [0, 0, 1.0]) * 100.0
    np.testing.assert_allclose(carried.omega[0, 1], rate, rtol=0.02, atol=2e-5)


def test_priors_say_what_they_are_and_where_from():
    assessment = assess(PHILAE, lander_telemetry(100.0 * np.arange(8)))
    window = observe_window(assessment)
    model, said = with_priors(assessment, window, {"inertia": 0.02, "max_rate_rad_s": 0.3})
    assert said["inertia"] == "0.02 (given)"
    assert said["friction"] == "0.05 (assumed)"
    assert said["rate"] == "uniform in a ball of 0.3 rad/s"
    assert model.max_rate == 0.3
    exact = dict.fromkeys(("inertia", "friction", "wheel_speed"), 0.0)
    assert not with_priors(assessment, window, exact)[0].of_motion


def test_a_window_holds_all_readings_and_a_sample_for_each_observation():
    t_s = 100.0 * np.arange(8)
    assessment = assess(PHILAE, lander_telemetry(t_s, noise=0.01))
    given = [
        {"kind": "rate", "t_s": 250.0, "value": 0.1, "sigma": 0.01},
        {"kind": "gyro", "t_s": 300.0, "value": [0.0, 0.0, 0.1], "sigma": 0.01},
    ]
    window = observe_window(assessment, begin_s=100.0, end_s=600.0, observations=given)
    np.testing.assert_allclose(window.obs.t_s, [0, 100, 150, 200, 300, 400, 500])
    assert window.start_s == 100.0
    panels, rate, gyro = window.obs.terms
    assert np.flatnonzero(~panels.present()).tolist() == [2]
    assert np.flatnonzero(rate.present()).tolist() == [2]
    assert np.flatnonzero(gyro.present()).tolist() == [3]
    assert panels.brightness == pytest.approx(2.5, rel=0.05)
