"""What a posterior begins with: readings, first brightness, priors and refusals whose advice works; and the model of a lander."""

import re
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import quad

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.cases import load_case
from sunspin.estimate.lander.grid import choose_reference
from sunspin.estimate.lander.model import LanderModel
from sunspin.estimate.lander.motions import LanderMotions
from sunspin.estimate.lander.priors import constant_torques, with_priors
from sunspin.estimate.lander.window import observe_window
from sunspin.estimate.observe import wheels_of_unknown_speed
from sunspin.estimate.posterior import _nothing_drawn, posterior
from sunspin.estimate.settings import POSTERIOR, WHEEL_SPEED
from sunspin.telemetry.assess import assess
from sunspin.vehicle import Fact, Friction, Panel, TelemetryForm, Vehicle, Wheel
from sunspin.vehicle.file import parse_vehicle
from sunspin.vehicle.response.panels import misalignment_sigma
from tests.support.landers import (
    OMEGA,
    PHILAE,
    SUN,
    dim_telemetry,
    lander_model,
    lander_telemetry,
    nominal,
)
from tests.support.passes import slope_of
from tests.support.simulate import telemetry_of
from tests.support.vehicles import small_cube
from validation import posterior_cases


def samples(craft: Vehicle, count: int = 15, interval_s: float = 20.0) -> xr.Dataset:
    """Return telemetry of the usual motion at even times."""
    return dim_telemetry(craft, interval_s * np.arange(count))


def model_of(craft: Vehicle, telemetry: xr.Dataset, **priors) -> tuple[LanderModel, dict[str, str]]:
    """Return the model of a vehicle and the sources of its priors."""
    assessment = assess(craft, telemetry)
    return with_priors(assessment, observe_window(assessment), priors)


# ---- readings and brightness -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lit", [20, 7])
def test_brightness_is_estimated_if_no_sample_gives_a_direction_and_most_are_dark(lit):
    """Four side panels; 0.37 is true."""
    craft = small_cube()
    craft = replace(craft, panels=craft.panels[:4])
    telemetry = samples(craft, 20, 15.0)
    telemetry["current_A"].values[lit:] = 0.0
    guess = observe_window(assess(craft, telemetry)).obs.terms[0].brightness
    assert guess == pytest.approx(0.37, rel=0.12)


def test_dark_samples_do_not_lower_the_brightness():
    """Three panels, a third of the samples dark: each dark reading favoured a dim Sun, and the guess was 0.37 of the true one."""
    panels = [
        Panel(name, np.eye(3)[k], 2.3 if name == "z" else 7.0) for k, name in enumerate("xyz")
    ]
    inertia = 1e-5 * np.array([[4240, 44, 7], [44, 4050, 32], [7, 32, 902]])
    form = TelemetryForm(quantity="power_W", noise=0.1)
    craft = Vehicle("v", inertia_kg_m2=inertia, panels=panels, gain_unit="W", telemetry=form)
    t_s = 20.0 * np.arange(40)
    run = ss.propagate(craft, [-2e-3, 0.017, 0.0], [-0.068, -0.963, -0.262], [], t_s)
    power = ss.panel_power(craft, run["sun_B"].values)
    power += 0.1 * np.random.default_rng(0).standard_normal(power.shape)
    telemetry = telemetry_of(craft, t_s, np.maximum(power, 0.0))
    assert observe_window(assess(craft, telemetry)).obs.terms[0].brightness == 1.0


def test_noise_on_dark_panels_does_not_change_the_brightness():
    """By the lit threshold of 1 mW alone it is 26 % too low; of 60 such files one was off by a factor of five."""
    case, philae = list(posterior_cases.cases(0))[18], load_case("philae").vehicle
    telemetry, _, noise = posterior_cases.simulate(case)
    vehicle = replace(philae, telemetry=replace(philae.telemetry, noise=case.stated * noise))
    guess = observe_window(assess(vehicle, telemetry)).obs.terms[0].brightness
    # what starts are good for
    assert guess == pytest.approx(posterior_cases.FULL_W / philae.panel_gains.max(), rel=0.08)


# ---- priors ----------------------------------------------------------------------------------------------------------------


def test_the_first_wheel_speed_is_that_of_the_telemetry():
    wheels = (Wheel("a", [0, 0, 1], 1e-4, speed_rad_s=7.0), Wheel("b", [1, 0, 0], 1e-4))
    craft = replace(small_cube(), wheels=wheels)
    telemetry = samples(craft)
    t_s = telemetry["time"].values
    speed = np.stack([100 + t_s, np.full(len(t_s), np.nan)], axis=1)
    read = telemetry.assign(wheel_speed_rad_s=(("time", "wheel"), speed))
    assessment = assess(craft, read)
    model, _ = with_priors(assessment, observe_window(assessment, begin_s=25.0), {})
    assert [wheel.speed_rad_s for wheel in model.vehicle.wheels] == [140.0, 0.0]
    stated, _ = model_of(craft, telemetry)
    assert [wheel.speed_rad_s for wheel in stated.vehicle.wheels] == [7.0, 0.0]
    assert (
        wheels_of_unknown_speed(craft, read) == wheels_of_unknown_speed(craft, telemetry) == ["b"]
    )


def test_the_error_of_a_wheel_at_rest_is_that_of_the_file():
    wheels = (
        Wheel("a", [0, 0, 1], 1e-4, speed_rad_s=0.0),
        Wheel("b", [1, 0, 0], 1e-4, speed_rad_s=9.0),
        Wheel("c", [0, 1, 0], 1e-4, speed_rad_s=2.0),
    )
    facts = {"wheel.a.speed_rad_s": Fact(0.0, 5.0), "wheel.b.speed_rad_s": Fact(9.0, 4.5)}
    craft = replace(small_cube(), wheels=wheels, facts=facts)
    model, said = model_of(craft, samples(craft))
    sigmas = [unknown.sigma for unknown in model.unknowns if unknown.kind == "wheel_speed"]
    assert sigmas == pytest.approx([5.0, 4.5, 2.0 * WHEEL_SPEED])
    # each source is named
    assert said["wheel_speed"] == "5 rad/s (vehicle file); 0.5 (vehicle file); 0.005 (assumed)"
    assert model_of(craft, samples(craft), wheel_speed=0.1)[1]["wheel_speed"] == "0.1 (given)"


def test_gain_sigmas_come_from_the_file_unless_given():
    craft = small_cube()
    gain = craft.panels[1].gain
    stated = replace(craft, facts={f"panel.{craft.panels[1].name}.gain_A": Fact(gain, 0.03 * gain)})
    model, said = model_of(stated, samples(craft))
    gains = {unknown.name: unknown.sigma for unknown in model.unknowns if unknown.kind == "gain"}
    assert gains == {f"log_gain_{craft.input_names[1]}": pytest.approx(0.03)}
    assert said["gain"] == "0 (assumed); 0.03 (vehicle file)"
    assert len(model_of(stated, samples(craft), gain=0.02)[0].indices("gain")) == 6


def test_misalignment_sigmas_come_from_the_file_unless_given():
    craft = small_cube()
    telemetry = samples(craft)
    assert model_of(craft, telemetry)[0].panels.turns is None
    facts = {
        "panel.+y.normal_B": Fact([0.0, 1.0, 0.0], 0.02),
        "panel.-z.normal_B": Fact([0.0, 0.0, -1.0], [0.03, 0.04, 0.0]),
    }
    stated = replace(craft, facts=facts)
    assert misalignment_sigma(stated)[0] == pytest.approx([0, 0, 0.02, 0, 0, 0.05 / 3**0.5])
    model, said = model_of(stated, telemetry)
    names = [unknown.name for unknown in model.unknowns if unknown.kind == "tilt"]
    assert names == [f"tilt_{panel}_{side}_rad" for panel in ("+y", "-z") for side in (1, 2)]
    assert said["tilt"].endswith("(vehicle file)")
    # a rotation about the normal itself would change nothing
    across = model.panels.turns @ craft.panel_normals_B.T
    assert np.abs(np.einsum("kpp->kp", across)).max() < 1e-15
    assert model_of(stated, telemetry, tilt=0.0)[0].panels.turns is None
    model, said = model_of(craft, telemetry, tilt=0.05, tilt_common=0.03)
    assert len(model.indices("tilt", "tilt_common")) == 2 * 6 + 3
    assert (said["tilt"], said["tilt_common"]) == ("2.86 deg (given)", "1.72 deg (given)")


def test_a_common_misalignment_of_the_file_turns_its_panels():
    form = "[panel_response]\nturned_B_rad = { value = [0, 0, 0.2], sigma = 0.05 }\n"
    panel = '[[panel]]\nname = "x"\nnormal_B = [1, 0, 0]\ngain_A = 1\n'
    craft = parse_vehicle(f'name = "a"\n{panel}{form}', "here")
    assert misalignment_sigma(craft)[1] == 0.05
    np.testing.assert_allclose(craft.panel_normals_B, [[np.cos(0.2), np.sin(0.2), 0]], atol=1e-15)
    np.testing.assert_allclose(ss.panel_power(craft, [0, 1, 0]), [np.sin(0.2)], atol=1e-15)


# ---- refusals --------------------------------------------------------------------------------------------------------------


OBSERVED = {"kind": "rate", "t_s": 1.0, "value": 1.0, "sigma": 1.0}


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        ({"priors": {"inertai": 0.1}}, "priors know"),
        ({"priors": {"wheel_off_s": 40.0}}, r"\(found wheel_off_s\); leave it out"),
        ({"priors": {"gain": True}}, "gain"),
        ({"begin_s": 100.0, "end_s": 120.0}, "three samples with a lit panel"),
        ({"priors": {"max_rate_rad_s": 0}}, r"max_rate_rad_s must be positive \(found 0\)"),
        ({"priors": {"inertia": -1}}, r"zero \(known\) or positive"),
        *(({"priors": {"time_s": x}}, "sigma of time_s") for x in (-1.0, np.nan, "two", True)),
        ({"phase": "descent"}, "no such phase"),
        ({"begin_s": 1e6}, "three samples"),
        ({"observations": [OBSERVED | {"kind": "smell"}]}, "an observation has kind"),
        ({"observations": [OBSERVED | {"t_s": 1e5}]}, "outside the window"),
        ({"observations": [OBSERVED | {"kind": "rate", "value": [1, 2]}]}, "is one finite number"),
        *(({"observations": [OBSERVED | {"sigma": x}]}, "positive sigma") for x in (0, -1, np.inf)),
        (
            {"observations": [OBSERVED | {"kind": "field", "value": [0, 3.0, 4.0], "more": 1}]},
            "angle_rad",
        ),
        ({"seed": -1}, "seed must be a whole number"),
        ({"draws": 0}, "draws must be a whole number"),
    ],
)
def test_bad_input_of_the_posterior_is_named(arguments, part):
    craft = small_cube()
    with pytest.raises(InputError, match=part):
        posterior(craft, samples(craft), **arguments)


def test_a_wheel_too_fast_for_the_window_is_refused_with_a_window_that_works():
    wheel = Wheel("w", [0.6, 0.0, 0.8], 0.01, 5e5, Friction(1e-5, 1e-7))
    fast = replace(small_cube(), inertia_kg_m2=np.diag([0.7, 0.6, 0.9]), wheels=(wheel,))
    slow = replace(fast, wheels=(replace(wheel, speed_rad_s=80.0),))
    priors = {"max_rate_rad_s": 0.01, "wheel_speed": 0.0}

    def searched(craft: Vehicle, count: int, span_s: float = 7200.0) -> None:
        """Look for the reference of samples over a time."""
        telemetry = samples(slow, count, span_s / (count - 1))
        choose_reference(model_of(craft, telemetry, **priors)[0], POSTERIOR.grid)

    with pytest.raises(InputError, match="wheels at 5e\\+05 rad/s") as refused:
        searched(fast, 20)
    window = re.search(r"use ([\d.e+]+) s of them", str(refused.value))
    assert window is not None
    searched(fast, 20, float(window[1]))
    searched(slow, 20)


@pytest.mark.parametrize("rate", [5.0, 1e30])
def test_a_prior_with_too_many_starts_is_refused_with_their_number_and_the_limit(rate):
    case = load_case("philae")
    assessment = assess(case.vehicle, case.telemetry)
    window = observe_window(assessment)

    def place(limit: float):
        """Return the reference of the search under a largest rate."""
        model, _ = with_priors(assessment, window, {"max_rate_rad_s": limit})
        return choose_reference(model, POSTERIOR.grid, given_rate=True)

    with pytest.raises(InputError, match=r"asks for \S+ starts, and 4e\+07 at most") as refused:
        place(rate)
    most = float(str(refused.value).split("give ")[1].split()[0])
    assert 0.6 < most < rate and place(most).limit <= most
    assert not place(0.6).doubts  # the default is searched whole


def of_inertia(relative: float, products: float = 0.0, **changes) -> Vehicle:
    """Return a box whose file states sigmas of its moments, and of its products in units of the least moment."""
    tensor = np.diag([0.010, 0.008, 0.012])
    sigma = np.diag(relative * np.diag(tensor)) + products * 0.008 * (1 - np.eye(3))
    facts = {"body.inertia_kg_m2": Fact(tensor, sigma=sigma)}
    return replace(small_cube(), **{"inertia_kg_m2": tensor, "facts": facts} | changes)


def test_if_nothing_can_be_drawn_the_message_names_the_largest_rate():
    craft = of_inertia(0.0)
    model, _ = model_of(craft, samples(craft), max_rate_rad_s=0.1)
    assert "give --prior max_rate_rad_s=0.2" in str(_nothing_drawn(model))


@pytest.mark.parametrize("rod", [False, True])
def test_the_inertia_sigma_in_the_advice_keeps_most_of_the_prior_physical(rod):
    """A long thin body is at the edge of the triangle rule: a sigma of 1 % is too much for it."""
    craft = of_inertia(2.0, 1.0)
    if rod:
        craft = replace(craft, inertia_kg_m2=np.diag([1.0, 1.0, 0.003]), facts={})
    telemetry = samples(craft)
    text = str(_nothing_drawn(model_of(craft, telemetry, max_rate_rad_s=0.1)[0]))
    advice = re.search(r"give --prior inertia=([\d.e+-]+)", text)
    assert "hardly any inertia" in text and advice is not None
    narrower, _ = model_of(craft, telemetry, max_rate_rad_s=0.1, inertia=float(advice[1]))
    assert np.exp(narrower.log_possible) > 0.5


# ---- the model: its motion, its prior, and what is read of a stretch of telemetry -------------------------------------------


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
    strong = constant_torques(model, {"steady_torque": 6000.0})[0]
    unknown = strong.unknowns[strong.indices("steady_torque")[0]]
    assert unknown.sigma * duration**2 / 2 == pytest.approx(np.radians(6000.0))
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
    assert said["inertia"] == "0.02 (given) of each moment, of the mean moment for each product"
    assert said["friction"] == "0.05 (assumed)"
    assert said["rate"] == "uniform in a ball of 0.3 rad/s"
    assert model.max_rate == 0.3
    assert with_priors(assessment, window, {}, "hold")[1]["friction"] == "none acts"
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
