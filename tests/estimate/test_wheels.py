"""Wheels: held or coasting, searched for at once or each, and named if they clearly fit better with the other sign."""

import json
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.estimate.carry import nutation
from sunspin.estimate.columns import samples_of
from sunspin.estimate.model import Body
from sunspin.estimate.observe import COASTING, HELD, take_samples, wheel_models
from sunspin.estimate.rates import rates
from sunspin.estimate.verdict import WHEEL_CHANGES
from sunspin.estimate.wheels import WRAPPED_RAD, momentum_of_each, reversed_momenta
from sunspin.vehicle import Friction
from tests.support.passes import errors_in_sigmas, estimate, tumbling_pass
from tests.support.simulate import CUBE_WITHOUT_NOISE_STATED, pulls
from validation.exchanges import draw_satellite, files
from validation.passes import make

ONE_PASS, WHEELS, RATES, OBSERVE = (
    import_module(f"sunspin.estimate.{name}") for name in ("one_pass", "wheels", "rates", "observe")
)


@pytest.fixture(scope="module")
def example():
    """The example files, whose wheel hardly slows down."""
    return ss.load_example("cubesat")


@pytest.fixture
def estimated(monkeypatch):
    """Run `rates` for a largest rate of 5 deg/s: (result, how many searches the models of the wheel took)."""

    def run(vehicle, telemetry, **replaced):
        searches = []

        def search(*arguments):
            searches.append(arguments)
            return original(*arguments)

        original = ONE_PASS.search
        with monkeypatch.context() as patch:
            patch.setattr(ONE_PASS, "search", search)
            for name, function in replaced.items():
                patch.setattr(WHEELS, name, function)
            options = {"max_rate_rad_s": np.radians(5), "column_tests": False}
            result = ss.rates(vehicle, telemetry, **options)
        return result, len(searches)

    return run


def with_friction(vehicle, factor):
    """The vehicle with so many times the friction of its wheel."""
    (wheel,) = vehicle.wheels
    stated = wheel.friction
    friction = Friction(factor * stated.coulomb_N_m, factor * stated.viscous_N_m_s)
    return replace(vehicle, wheels=(replace(wheel, friction=friction),))


def test_a_wheel_that_hardly_slows_down_gives_with_one_search_what_it_gives_with_two(
    example, estimated, monkeypatch
):
    vehicle, telemetry = example
    # The errors of rounded times depend on the motion that tells them, which here is that of a fit or of a search.
    monkeypatch.setattr(OBSERVE, "rounded_to_s", lambda t_s: 0.0)
    together, once = estimated(vehicle, telemetry)
    each, twice = estimated(vehicle, telemetry, _turn_alike=lambda *_: False)
    assert (once, twice) == (1, 2)
    assert together.attrs["wheels"] == each.attrs["wheels"]
    for name in ("omega_B", "probability", "omega_mean_B", "omega_sigma_all_B"):
        assert together[name].values == pytest.approx(each[name].values, rel=1e-5, abs=1e-7)


def test_a_wheel_that_slows_down_much_is_searched_for_by_itself(example, estimated):
    vehicle, telemetry = example
    slowing = with_friction(vehicle, 30.0)
    result, searches = estimated(slowing, telemetry)
    assert searches > 1
    assert result.attrs["wheels"].startswith("held")  # the wheel of the example keeps its speed


WHEEL = ss.Wheel("reaction-y", [0, 1, 0], 3e-4, speed_rad_s=40.0)
OTHER = ss.Wheel("reaction-x", [1, 0, 0], 2e-4, speed_rad_s=-30.0)
ONE, TWO = (replace(CUBE_WITHOUT_NOISE_STATED, wheels=w) for w in ((WHEEL,), (WHEEL, OTHER)))


@pytest.fixture(scope="module")
def seen():
    """Return telemetry and truth of a cube whose wheel about y turns its rate round by half a turn between samples."""
    omega = (0.02, 0.03, -0.01)
    return tumbling_pass(ONE, 20, 10.0, seed=2, omega_B=omega, spread=0.0, speed=[40.0])


def test_the_wheel_of_a_later_pass_coasts_from_the_first_sample_of_the_file():
    slowing = replace(WHEEL, friction=Friction(coulomb_N_m=2e-6))
    craft = replace(ONE, wheels=(slowing,))
    data = xr.Dataset(coords={"time": np.concatenate([np.arange(8.0), 3600 + np.arange(8.0)])})
    result = xr.Dataset({"pass_of": ("time", np.repeat([0, 1], 8))}, {"time": data["time"]})
    later = samples_of(result, data, 1)
    whole, part = wheel_models(craft, data), wheel_models(craft, later)
    again = wheel_models(craft, take_samples(later, np.arange(4, 8)))
    assert set(part) == set(whole) == {HELD, COASTING}
    np.testing.assert_allclose(part[COASTING], whole[COASTING][8:])
    np.testing.assert_allclose(again[COASTING], whole[COASTING][12:])
    assert whole[COASTING][8, 1] < 0.6 * whole[HELD][8, 1]  # it lost speed before the later pass


def test_momenta_of_wheels_add_up_and_lie_along_their_axes(seen):
    data, _ = seen
    each = momentum_of_each(TWO, data, HELD)
    np.testing.assert_allclose(each.sum(axis=0), wheel_models(TWO, data)[HELD], atol=1e-12)
    unit = np.trace(TWO.inertia_kg_m2) / 3
    np.testing.assert_allclose(each[0], np.tile([0, 3e-4 * 40 / unit, 0], (20, 1)), atol=1e-12)
    np.testing.assert_allclose(each[1], np.tile([-2e-4 * 30 / unit, 0, 0], (20, 1)), atol=1e-12)


def test_each_wheel_and_all_are_reversed_unless_they_hardly_turn_the_rate_or_wrap(seen):
    data, _ = seen
    t_s, inertia = data["time"].values, Body.of(TWO).inertia
    each = momentum_of_each(TWO, data, HELD)
    momenta = reversed_momenta(TWO, each, inertia, t_s)
    assert set(momenta) == {(0,), (1,), (0, 1)}
    np.testing.assert_allclose(momenta[0,], each[1] - each[0], atol=1e-12)
    np.testing.assert_allclose(momenta[0, 1], -each.sum(axis=0), atol=1e-12)
    assert not reversed_momenta(TWO, 1e-5 * each, inertia, t_s)
    turned = nutation(inertia, each[0])[0] * 10.0
    fast = each * (1.01 * WRAPPED_RAD / turned)
    assert (0,) not in reversed_momenta(TWO, fast, inertia, t_s)
    assert not reversed_momenta(replace(TWO, wheels=()), each[:0], inertia, t_s)


SLOWING = replace(ONE, wheels=(replace(WHEEL, friction=Friction(coulomb_N_m=2e-6)),))


@pytest.mark.parametrize("name", [HELD, COASTING])
def test_reversed_wheels_are_searched_under_what_the_wheels_are_decided_to_do(
    seen, monkeypatch, name
):
    """Also if they are held, although a search under coasting ones was begun."""
    data, _ = seen
    momentum = wheel_models(SLOWING, data)[name]

    def doubted(obs, compared, momenta, quick_evidences, fitter):
        np.testing.assert_allclose(momenta[0,], -momentum)
        raise InputError("no further")

    decided = WHEELS.DecidedWheels(name, name, momentum, {})
    monkeypatch.setattr(RATES, "decide_wheels", lambda *_: decided)
    monkeypatch.setattr(RATES, "doubted_signs", doubted)
    with pytest.raises(InputError, match="no further"):
        rates(SLOWING, data, max_rate_rad_s=0.06)


def test_results_with_a_wheel_do_not_depend_on_the_number_of_workers(seen):
    """Of a wheel that slows down so much that its models, held and coasting, are searched for each."""
    slowing = replace(WHEEL, friction=Friction(coulomb_N_m=1.2e-5))
    craft, data = replace(ONE, wheels=(slowing,)), seen[0].isel(time=slice(8))
    options = {"max_rate_rad_s": 0.06, "column_tests": False}
    one, two = (rates(craft, data, workers=k, **options) for k in (1, 2))
    xr.testing.assert_identical(one, two)


def test_a_wheel_of_the_right_sign_is_not_accused(seen):
    data, run = seen
    result = rates(ONE, data, max_rate_rad_s=0.06)
    assert result["decided"].values.all() and np.abs(pulls(result, run)).max() < 5.0
    assert "columns_doubt" not in result.attrs
    # a mirror across the wheel's axis is not seen: the columns +y and -y may be exchanged, no others
    unseen = [one["what"] for one in json.loads(result.attrs["columns_unseen"])]
    assert unseen == ["the columns of panels +y and -y exchanged"]
    assert result["columns_checked"].values[0] == "unchecked"


def test_rates_are_right_after_a_wheel_is_braked_and_the_change_is_named(monkeypatch):
    """Without the changed momentum, passes were decided and 19 to 50 sigma off after the wheel was braked."""
    tested, doubted_signs = [], RATES.doubted_signs

    def record(obs, compared, momenta, *rest):
        tested.append((obs.momentum, momenta))
        return doubted_signs(obs, compared, momenta, *rest)

    monkeypatch.setattr(RATES, "doubted_signs", record)
    simulated = make("wheel braked", 11, 4)
    result = estimate(simulated)
    assert result["decided"].values.all()
    assert np.abs(errors_in_sigmas(result, simulated.omega)).max() < 4.5
    last = result["omega_B"].values[-1] - simulated.omega[-1]
    assert np.degrees(np.abs(last).max()) < 0.2
    change = result.attrs["wheel_change"]
    assert "wheel: speed changed by about" in change
    assert f"({change}), which the file does" in result.attrs["verdict"]
    # the reversed wheel, with which the file is compared, changes its speed too: else reversed wheels were not found
    momentum, momenta = tested[-1]
    np.testing.assert_allclose(np.ptp(momentum - momenta[(0,)], axis=0), 0, atol=1e-12)
    assert np.ptp(momentum, axis=0).max() > 1e-3


@pytest.mark.slow
def test_a_wheel_that_turns_the_other_way_is_named_though_a_change_of_its_speed_fits():
    """A small change was taken, and the pass decided 25 sigma off."""
    satellite = draw_satellite(91, 29)
    vehicle, data = files(satellite, np.arange(len(satellite.names)), -satellite.momenta)
    result = rates(vehicle, data, max_rate_rad_s=0.09, column_tests=False)
    assert not result["decided"].values.any() and not result.attrs["wheel_change"]
    assert "wheel 0 turning the other way" in result.attrs["columns_doubt"]


@pytest.mark.long
def test_steps_that_a_wheel_may_cause_leave_a_pass_undecided_and_the_advice_gives_right_rates():
    """The pass was decided 20 sigma off after the wheel was braked."""
    simulated = make("wheel braked", 91, 2)
    result = estimate(simulated)
    assert not result["decided"].values.any() and WHEEL_CHANGES in result.attrs["verdict"]
    before = simulated.telemetry["time"].values < 130  # the wheel is braked from about 135 s on
    # the wheel's momentum h along its axis u, from |I omega + h u|, which stays the same
    (wheel,) = simulated.vehicle.wheels
    body = simulated.omega @ np.array(simulated.vehicle.inertia_kg_m2)
    nominal = wheel.inertia_kg_m2 * wheel.speed_rad_s
    along = body @ np.array(wheel.axis_B)
    square = (body[0] ** 2).sum() + 2 * nominal * along[0] + nominal**2
    h = np.sign(nominal) * np.sqrt(along**2 - (body**2).sum(axis=1) + square) - along
    speeds = ("time", "wheel"), h[:, None] / wheel.inertia_kg_m2
    for changed in (
        simulated._replace(
            telemetry=simulated.telemetry.isel(time=before), omega=simulated.omega[before]
        ),
        simulated._replace(telemetry=simulated.telemetry.assign(wheel_speed_rad_s=speeds)),
    ):
        result = estimate(changed)
        assert result["decided"].values.all()
        assert np.abs(errors_in_sigmas(result, changed.omega)).max() < 4.5
