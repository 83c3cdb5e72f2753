"""Campaigns judge the estimation package that they are told to judge."""

from importlib import import_module

import pytest

from sunspin.estimation import rates as estimation
from validation import subject


@pytest.fixture(autouse=True)
def unchanged():
    """Leave the package of this process as it was."""
    before = subject.room()
    yield
    subject.judge_room(before)


@pytest.mark.parametrize(("room", "module"), [("estimation", estimation)])
def test_rates_are_those_of_the_package_that_is_judged(room, module, monkeypatch):
    subject.judge_room(room)
    monkeypatch.setattr(module, "rates", lambda vehicle, **options: (vehicle, options))
    assert subject.rates("craft", workers=2) == ("craft", {"workers": 2})


@pytest.mark.parametrize("name", ["check_orbit", "orbit_of", "calibrate_sensors"])
@pytest.mark.parametrize("room", list(subject.ORBIT))
def test_functions_of_orbits_are_those_of_the_package_that_is_judged(room, name, monkeypatch):
    subject.judge_room(room)
    module = import_module(subject.ORBIT[room][name])
    assert module.__name__.split(".")[1] == room and callable(getattr(module, name))
    monkeypatch.setattr(module, name, lambda *arguments: arguments)
    assert getattr(subject, name)("orbit", "craft") == ("orbit", "craft")


def test_a_package_that_does_not_exist_is_refused():
    with pytest.raises(ValueError, match="no such package"):
        subject.judge_room("nowhere")
