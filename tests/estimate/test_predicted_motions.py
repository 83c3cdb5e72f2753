"""Draws of a posterior at other times against the reference propagator, and periods seen from outside against closed forms."""

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.cli.values import parse_period
from sunspin.dynamics import gyrostat
from sunspin.dynamics.torques import Steady
from sunspin.estimate import periods as pd
from sunspin.estimate.lander import periods as posterior_periods
from sunspin.estimate.lander.predict import DrawnMotions, best_motions, predict
from sunspin.estimate.model import Body, Observations, Track
from sunspin.estimate.solutions import Solutions
from sunspin.output.kinds.posterior import period_sentences
from sunspin.telemetry.periodicity import FoundPeriod, LikelyPeriod
from sunspin.vehicle import Friction, Panel, Vehicle, Wheel
from tests.support.passes import estimate
from tests.support.philae import AS_DRAWN, philae_draws
from tests.support.posteriors import tree_of
from validation.many_passes import make_period

PHILAE = AS_DRAWN.vehicle
TOUCHDOWN, LATER = 25143.98, 31800.0
SUN = np.array([0.48, 0.6, 0.64])


def box(*wheels: Wheel) -> Vehicle:
    """Return a 3U CubeSat with one panel and wheels."""
    panel, inertia = Panel("+x", (1, 0, 0), 7.0), np.diag([0.042, 0.040, 0.009])
    return Vehicle("box", inertia_kg_m2=inertia, panels=[panel], wheels=wheels)


def own_vehicle(vehicle: Vehicle, tree: xr.DataTree, draw: int) -> Vehicle:
    """Return a vehicle with inertia, friction and wheel inertia of one draw."""
    draws, inertia = tree["posterior"], np.array(vehicle.require_inertia())
    for k, axis in enumerate("xyz"):
        if f"inertia_{axis}{axis}" in draws:
            inertia[k, k] = draws[f"inertia_{axis}{axis}"].values[0, draw]
    wheels = []
    for wheel in vehicle.wheels:
        tail, stated = "" if len(vehicle.wheels) == 1 else f"_{wheel.name}", wheel.friction
        names = (f"log_{kind}{tail}" for kind in ("coulomb", "viscous", "wheel_inertia"))
        dry, viscous, axial = (
            np.exp(draws[name].values[0, draw]) if name in draws else 1.0 for name in names
        )
        friction = Friction(dry * stated.coulomb_N_m, viscous * stated.viscous_N_m_s)
        own = {"friction": friction, "inertia_kg_m2": axial * wheel.inertia_kg_m2}
        wheels.append(replace(wheel, **own))
    return replace(vehicle, inertia_kg_m2=inertia, wheels=tuple(wheels))


@pytest.mark.evidence(
    "posterior", "verified", "the reference propagator, through the wheel stop and backward"
)
def test_predicted_draws_agree_with_the_reference_through_the_wheel_stop_and_backward():
    """Each with its own inertia, friction and wheel speed; the wheel stops at about 2500 s."""
    tree = philae_draws(3, 0.003)
    times = [TOUCHDOWN, 25200.0, 27000.0, LATER]
    predicted, draws = predict(PHILAE, tree, times), tree["posterior"]
    for i in range(3):
        own = own_vehicle(PHILAE, tree, i)
        state = [draws[name].values[0, i] for name in ("omega_B", "sun_B", "wheel_speed_rad_s")]
        back = ss.propagate(own, *state, [0.0, TOUCHDOWN - 25200.0])
        on = ss.propagate(own, *state, np.array(times[1:]) - 25200.0)
        for name, tolerance in (("omega_B", 1e-4), ("sun_B", 5e-4), ("wheel_speed_rad_s", 1e-3)):
            got = predicted[name].values[0, i]
            np.testing.assert_allclose(got[0], back[name].values[-1], atol=tolerance)
            np.testing.assert_allclose(got[1:], on[name].values, atol=tolerance)
    assert np.all(predicted["wheel_speed_rad_s"].values[0, :, -1] == 0)
    # z is the axis of the largest moment, and near the momentum in this flight
    angle = predicted["z_to_momentum"].values[0]
    assert np.all((angle > 0) & (angle < np.pi / 2))


def test_each_draw_moves_under_its_own_torque_in_body_axes_and_in_space():
    rng, times = np.random.default_rng(0), np.array([-100.0, 0.0, 200.0])
    omega = 0.05 * rng.standard_normal((3, 3))
    # the first draw has a torque in body axes, the second one in space, the third none; rad/s2
    torque = 1e-4 * rng.standard_normal((3, 2, 3)) * np.array([[[1], [0]], [[0], [1]], [[0], [0]]])
    craft = box()
    tree = tree_of(craft, omega, np.tile(SUN, (3, 1)), {"steady_torque": torque})
    carried = DrawnMotions.of(craft, tree).at(times)
    np.testing.assert_array_equal(carried.omega_B[:, 1], omega)
    mean = np.trace(craft.require_inertia()) / 3
    for i in range(3):
        for j in (0, 2):
            steady = [Steady(mean * torque[i])]
            run = ss.propagate(craft, omega[i], SUN, None, [0.0, times[j]], torques=steady)
            np.testing.assert_allclose(carried.sun_B[i, j], run["sun_B"].values[-1], atol=1e-3)


def test_draws_of_several_wheels_run_down_with_their_own_numbers():
    a = Wheel("a", (1, 0, 0), 1e-5, 100.0, Friction(1e-6, 1e-9))
    craft = box(a, Wheel("b", (0, 1, 0), 2e-5, -60.0, Friction(2e-6, 1e-9)))
    unknowns = {
        "wheel_speed_rad_s": np.array([[101.0, -60.0], [100.0, -63.0]]),
        "log_coulomb_a": np.array([0.2, 0.0]),
        "log_coulomb_b": np.array([0.0, -0.3]),
        "log_viscous_b": np.array([0.4, 0.0]),
        "log_wheel_inertia_a": np.array([0.0, 0.1]),
        "inertia_zz": np.array([0.0095, 0.009]),
    }
    omega = np.array([[0.04, -0.05, 0.03], [0.03, 0.0, 0.1]])
    tree = tree_of(craft, omega, np.tile(SUN, (2, 1)), unknowns)
    predicted, speeds = predict(craft, tree, [500.0]), unknowns["wheel_speed_rad_s"]
    for i in range(2):
        own = own_vehicle(craft, tree, i)
        run = ss.propagate(own, omega[i], SUN, speeds[i], [0.0, 500.0])
        for name, tolerance in (("omega_B", 1e-4), ("wheel_speed_rad_s", 1e-2)):
            expected = run[name].values[-1]
            np.testing.assert_allclose(predicted[name].values[0, i, 0], expected, atol=tolerance)


def test_predictions_do_not_depend_on_the_number_of_workers_or_the_order_of_times():
    tree = philae_draws(200, 0.003)
    one, two = (predict(PHILAE, tree, [26000.0, TOUCHDOWN], workers) for workers in (1, 2))
    np.testing.assert_allclose(one["omega_B"].values, two["omega_B"].values, rtol=1e-9)
    assert one["predicted_s"].values.tolist() == [TOUCHDOWN, 26000.0]
    motions = DrawnMotions.of(PHILAE, tree)
    backward = motions.at([26000.0, TOUCHDOWN, 26000.0]).omega_B
    np.testing.assert_allclose(backward[:, [1, 0]], one["omega_B"].values[0], rtol=1e-9)
    np.testing.assert_array_equal(backward[:, 0], backward[:, 2])


def test_predictions_at_invalid_times_or_with_another_vehicle_are_refused():
    tree = philae_draws(1)
    for times in ([], [np.nan], [25200.0 + 8 * 86400]):
        with pytest.raises(InputError, match="times to predict must be numbers, at most a week"):
            predict(PHILAE, tree, times)
    with pytest.raises(InputError, match="times to predict must be numbers .found .*17:25"):
        predict(PHILAE, tree, ["17:25"])
    with pytest.raises(InputError, match="predictions need the DataTree that `posterior` returned"):
        predict(PHILAE, tree.children["posterior"].to_dataset(), [25200.0])
    heavier = replace(PHILAE, inertia_kg_m2=1.1 * np.array(PHILAE.inertia_kg_m2))
    renamed = replace(PHILAE, wheels=(replace(PHILAE.wheels[0], name="another"),))
    for vehicle in (heavier, renamed):
        with pytest.raises(InputError, match="not of this vehicle"):
            predict(vehicle, tree, [LATER])


def test_the_best_motion_of_a_solution_is_that_of_its_likeliest_draw():
    """With its own inertia and torque, from the first sample to the last, at instants less than 0.3 rad apart."""
    craft = box()
    omega = np.array([[0.3, 0.0, 0.1], [0.0, 0.4, 0.05], [0.1, 0.1, 0.1]])
    torque = np.zeros((3, 2, 3))
    torque[1, 0] = 1e-5, 0.0, 2e-5
    unknowns = {
        "inertia_zz": np.array([0.009, 0.0095, 0.009]),
        "steady_torque": torque,
        "log_likelihood_sum": np.array([-3.0, -1.0, -2.0]),
    }
    tree = tree_of(craft, omega, np.tile(SUN, (3, 1)), unknowns, (100.0, 700.0))
    (motion,) = best_motions(craft, tree)
    own = replace(craft, inertia_kg_m2=np.diag([0.042, 0.040, 0.0095]))
    steady = [Steady(np.trace(craft.require_inertia()) / 3 * torque[1])]
    run = ss.propagate(own, omega[1], SUN, None, [0.0, 600.0], torques=steady)
    t_s = motion["time"].values
    assert (t_s[0], t_s[-1]) == (100.0, 700.0)
    np.testing.assert_allclose(motion["sun_B"].values[-1], run["sun_B"].values[-1], atol=1e-6)
    fastest = np.linalg.norm(motion["omega_B"].values, axis=1).max()
    assert np.diff(t_s).max() * fastest < 0.31
    sines = np.maximum(motion["sun_B"].values[:, 0], 0.0)
    np.testing.assert_allclose(motion["panel_signal"].values[:, 0], 7.0 * sines, atol=1e-9)
    assert motion.attrs["solution"] == 1 and motion.attrs["probability"] == 1.0


# ---- periods seen from outside: of solutions and draws, and what they decide ------------------------------------------------


WHEELED = Vehicle(
    "cube",
    inertia_kg_m2=np.diag([0.04, 0.042, 0.03]),
    wheels=[ss.Wheel("w", [0, 0.6, 0.8], 1e-3, speed_rad_s=1.0)],
)
RATES = np.array([[0.05, -0.02, 0.09], [0.03, 0.01, 0.2]])


@pytest.mark.parametrize("wheel", [0.0, 3.0])
def test_periods_of_a_symmetric_body_agree_with_the_textbook(wheel):
    """Precession |H| / A whatever spins along the axis, nutation none; spin is what is left of the rate about the axis."""
    A, C = 13.0, 16.0
    omega = np.array([[0.1, 0.2, 0.3], [0.1, -0.1, -0.4], [0.0, 0.05, 0.0]])
    momentum = omega * [A, A, C] + [0, 0, wheel]
    precession, spin, total = pd.euler_rates(omega, momentum, np.array([0.0, 0.0, 1.0])).T
    size = np.linalg.norm(momentum, axis=1)
    np.testing.assert_allclose(precession, size / A, rtol=1e-12)
    np.testing.assert_allclose(spin, omega[:, 2] - momentum[:, 2] / A, rtol=1e-9, atol=1e-12)
    sign = np.where(momentum[:, 2] < 0, -1, 1)
    np.testing.assert_allclose(total, precession + spin * sign, rtol=1e-9)


def test_a_pure_spin_has_one_period_only():
    omega = np.array([[0, 0, 0.4], [0, 0, -0.4]])
    periods = 2 * np.pi / pd.euler_rates(omega, 15 * omega, np.array([0, 0, 1.0]))
    assert np.isnan(periods[:, :2]).all() and periods[:, 2] == pytest.approx([5 * np.pi] * 2)
    seen = [ss.Period(0.0, 15.7, 1.0)]
    weighed = pd.weigh_draws(seen, [periods], np.array([0.5, 0.5]))
    np.testing.assert_allclose(weighed.shares, [[0, 0, 1]], atol=1e-12)
    two = pd.weigh_draws(seen, [periods[:, [2, 2, 0]]], np.array([0.5, 0.5]))
    np.testing.assert_allclose(two.shares, [[0.5, 0.5, 0]], atol=1e-12)


def two_solutions(probability, sigma=1e-6):
    """A pass of three samples with two solutions of constant rates and a body of known inertia."""
    body = replace(Body.of(WHEELED), errors=np.zeros((0, 3, 3)))
    t_s = np.array([0.0, 40.0, 80.0])
    mean_moment = np.trace(WHEELED.require_inertia()) / 3
    momentum = np.tile(1e-3 * np.array([0, 0.6, 0.8]) / mean_moment, (3, 1))
    omega = np.repeat(RATES[:, None], 3, axis=1)
    covariance = np.broadcast_to(sigma**2 * np.eye(6), (2, 3, 6, 6))
    attitude = np.broadcast_to(np.eye(3), (2, 3, 3, 3))
    track = Track(attitude, omega, np.zeros((2, 0)), np.zeros(2), covariance)
    obs = Observations(t_s, momentum, ())
    known = np.full((2, 3), sigma)
    means, rest = (np.array(probability), RATES, known), (np.zeros(2), ({}, {}), ((), ()), 1.0)
    return Solutions(obs, track, *means, {}, ("as stated", 1.0), *rest), body


def test_periods_of_solutions_agree_with_the_reference_motion():
    """Free motion with a wheel that is held, before and after the sample nearest to what was seen."""
    seen = ss.Period(45.0, 25.0, 0.5)
    periods = pd.periods_of(*two_solutions([0.5, 0.5]), seen).reshape(2, -1, 3)
    instants = seen.t_s + np.linspace(-2, 2, 9) * seen.period_s - 40.0
    inertia = WHEELED.require_inertia()
    for omega, drawn in zip(RATES, periods, strict=True):
        before = np.array([0.0, *sorted(instants[instants < 0], reverse=True)])
        after = np.array([0.0, *instants[instants > 0]])
        runs = [
            ss.propagate(WHEELED, omega, [0, 0, 1], 1.0, t, wheel_mode="hold")["omega_B"].values[1:]
            for t in (before, after)
        ]
        rate = np.concatenate(runs)
        momentum = rate @ inertia + 1e-3 * np.array([0, 0.6, 0.8])
        mean = pd.euler_rates(rate, momentum, pd.spin_axis(inertia)).mean(axis=0)
        np.testing.assert_allclose(np.median(drawn, axis=0), 2 * np.pi / np.abs(mean), rtol=2e-3)


def test_a_period_that_may_be_another_counts_both():
    """Two solutions of unlike periods: a column that may have either keeps their probabilities, times those of the column."""
    one, body = two_solutions([0.5, 0.5])
    # the sum of precession and spin, averaged over four of the periods seen; the period of either solution is that of no other
    seen_s = 62.0
    draws = pd.periods_of(one, body, ss.Period(40.0, seen_s, 0.5)).reshape(2, -1, 3)
    of_each = np.median(draws, axis=1)
    first_s, second_s = of_each[:, 2]
    other = LikelyPeriod(float(second_s), 0.5, 0.25)
    seen = FoundPeriod(40.0, float(first_s), 0.5, 0.75, 1e-4, (other,))
    (after,), attrs = pd.weigh_by_periods([one], body, [seen], [0])
    # the precession of the first has nearly the same period: two of its three rotations count
    near = np.exp(-0.5 * ((of_each - of_each[:, 2:]) / 0.5) ** 2).sum(axis=1) * [0.75, 0.25]
    assert after.probability == pytest.approx(near / near.sum(), abs=0.02)
    (row,) = json.loads(attrs["periods"])
    assert row["told"] and row["carried"] > 0.99
    elsewhere = replace(seen, t_s=1e5)
    unchanged, attrs = pd.weigh_by_periods([one], body, [elsewhere], [0])
    assert unchanged == [one] and attrs == {}
    sure = replace(seen, probability=1.0, aliases=())
    (after,), _ = pd.weigh_by_periods([one], body, [sure], [0])
    assert after.probability[0] > 0.99


def test_a_period_reweights_solutions_and_names_the_kind_of_rotation():
    one, body = two_solutions([0.8, 0.2])
    at_40 = ss.Period(40.0, 25.0, 0.5)
    periods = np.median(pd.periods_of(one, body, at_40).reshape(2, -1, 3), axis=1)
    of_second = ss.Period(40.0, float(periods[1, 0]), 0.5)
    (after,), attrs = pd.weigh_by_periods([one], body, [of_second], [3])
    (row,) = json.loads(attrs["periods"])
    assert after.probability[1] > 0.99 and np.array_equal(after.without_periods, [0.8, 0.2])
    assert row["told"] and row["pass"] == 3
    assert row["shares"][0] > 0.9 and row["without"] == pytest.approx([0.2, 0.8])

    # a period that none has, and one that only an unlikely solution has
    (same,), attrs = pd.weigh_by_periods([one], body, [ss.Period(40.0, 400.0, 0.5)], [0])
    (row,) = json.loads(attrs["periods"])
    assert np.array_equal(same.probability, one.probability)
    assert not row["told"] and row["nearest_sigmas"] > pd.FAR_SIGMAS
    rare, body = two_solutions([0.99, 0.01])
    (kept,), attrs = pd.weigh_by_periods([rare], body, [of_second], [0])
    (row,) = json.loads(attrs["periods"])
    assert np.array_equal(kept.probability, rare.probability)
    assert not row["told"] and row["carried"] == pytest.approx(0.01)


def test_a_period_at_a_time_of_no_pass_is_refused():
    one, body = two_solutions([0.8, 0.2])
    with pytest.raises(InputError, match=r"time of no pass .*; passes are at 0 to 80 s"):
        pd.weigh_by_periods([one], body, [ss.Period(200.0, 25.0, 0.5)], [0])


def test_drawn_inertias_scatter_as_the_file_says_and_a_sphere_has_one():
    rng = np.random.default_rng(0)
    body = Body.of(WHEELED)
    drawn = np.concatenate([pd.draw_inertias(body, rng) for _ in range(200)])
    spread = np.sqrt(((drawn - body.inertia) ** 2).mean(axis=0))
    np.testing.assert_allclose(spread, np.abs(body.errors).max(axis=0), rtol=0.1)
    sphere = Body.of(replace(WHEELED, inertia_kg_m2=None, wheels=()))
    assert (pd.draw_inertias(sphere, rng) == np.eye(3)).all()


def test_rates_with_a_period_keep_probabilities_with_and_without_it():
    simulated, period = make_period(0, 0)
    result = estimate(simulated, periods=[period], column_tests=False)
    before = result["probability_without_periods"]
    assert before.dims == ("pass_id", "solution")
    assert result["probability"].values[0].sum() == pytest.approx(1, abs=1e-2)
    assert result["probability"].values[0, 0] > before.values[0, 0]
    assert json.loads(result.attrs["periods"])[0]["told"]


@pytest.mark.parametrize("after_s", [-60.0, 900.0, 2500.0])
def test_periods_of_draws_agree_with_the_reference_motion(after_s):
    """Before the first sample, after it, and when the wheel has handed its momentum to the body, whose own axis is near z."""
    tree = philae_draws(2)
    seen = ss.Period(25200.0 + after_s, 20.0, 1.0)
    found = posterior_periods.periods_of(DrawnMotions.of(PHILAE, tree), seen)[0]
    draws, t_s = tree["posterior"], after_s + np.linspace(-2, 2, 9) * 20.0
    state = [draws[name].values[0, 0] for name in ("omega_B", "sun_B", "wheel_speed_rad_s")]
    run = ss.propagate(PHILAE, *state, np.append(0.0, t_s if after_s > 0 else t_s[::-1]))
    omega, speeds = run["omega_B"].values[1:], run["wheel_speed_rad_s"].values[1:]
    momentum = gyrostat.total_momentum(PHILAE, omega, speeds)
    axis = pd.spin_axis(PHILAE.require_inertia())
    mean = pd.euler_rates(omega, momentum, axis).mean(axis=0)
    np.testing.assert_allclose(found, 2 * np.pi / np.abs(mean), rtol=1e-3)
    assert abs(axis[2]) > 0.99


def weighted(monkeypatch, periods, middle_s, sigma_s):
    """Return the group `period` of a posterior whose draws have these periods (n, 3), after one was seen."""
    seen = ss.Period(0.0, middle_s, sigma_s)
    monkeypatch.setattr(posterior_periods, "periods_of", lambda *_: periods)
    tree = philae_draws(len(periods), 0.01)
    return posterior_periods.draws_by_periods(PHILAE, tree, [seen]).to_dataset()


def test_draws_are_weighted_by_a_period_and_the_reading_is_named(monkeypatch):
    """Spins of 10 to 20 s even, the others far away: the weighted mean is the period seen, and it is the spin."""
    n = 4000
    periods = np.stack([np.full(n, 90.0), np.linspace(10, 20, n), np.full(n, np.nan)], axis=1)
    group = weighted(monkeypatch, periods, 14.0, 1.0)
    weight = np.exp(group["log_weight"].values[0])
    assert weight.sum() == pytest.approx(1)
    assert weight @ periods[:, 1] == pytest.approx(14.0, abs=0.01)
    assert group.attrs["effective_draws"] == pytest.approx(n * 2 * np.sqrt(np.pi) / 10, rel=0.01)
    assert group.attrs["told"] and "spin 100%" in period_sentences(group)[0]


def even_periods(count):
    return np.stack([np.linspace(10, 20, count)] * 3, axis=1)


@pytest.mark.parametrize(
    ("middle", "sigma", "words"),
    [(14.0, 0.05, "periods not used: of these draws"), (60.0, 1.0, "no solution")],
)
def test_periods_that_the_draws_cannot_decide_are_reported(monkeypatch, middle, sigma, words):
    group = weighted(monkeypatch, even_periods(4000), middle, sigma)
    assert not group.attrs["told"] and words in period_sentences(group)[0]


def test_the_advice_to_draw_more_makes_periods_decisive(monkeypatch):
    """A period that few draws have: the same draws, and eight times as many, as `--draws` gives."""
    few, many = (
        period_sentences(weighted(monkeypatch, even_periods(count), 14.0, 0.05))
        for count in (4000, 32000)
    )
    assert "ask for more --draws" in few[0]
    assert len(many) == 2 and "with periods the angular speed" in many[1]


def test_the_option_period_is_parsed():
    assert parse_period("13.0+-0.5@15:50", "2014-11-12T08:35:00Z") == ss.Period(26100.0, 13.0, 0.5)
    for text in ("13", "13+-0@100", "13+-1", "x+-1@100"):
        with pytest.raises(InputError):
            parse_period(text, None)
