"""Wheels that turn the body nearly alike, held or coasting, share one search; others are searched for each."""

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

import sunspin as ss
from sunspin.vehicle import Friction

ONE_PASS, WHEELS = (import_module(f"sunspin.estimate.{name}") for name in ("one_pass", "wheels"))


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
            result = ss.rates(vehicle, telemetry, max_rate_rad_s=np.radians(5))
        return result, len(searches)

    return run


def with_friction(vehicle, factor):
    """The vehicle with so many times the friction of its wheel."""
    (wheel,) = vehicle.wheels
    friction = Friction(factor * wheel.friction.coulomb_N_m, factor * wheel.friction.viscous_N_m_s)
    return replace(vehicle, wheels=(replace(wheel, friction=friction),))


def test_a_wheel_that_hardly_slows_down_gives_with_one_search_what_it_gives_with_two(
    example, estimated
):
    vehicle, telemetry = example
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
