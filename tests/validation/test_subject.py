"""Campaigns judge the estimation package that they are told to judge."""

from importlib import import_module

import numpy as np
import pytest

import sunspin as ss
from sunspin.cases import load_case
from validation import subject
from validation.calibrate import make


@pytest.fixture(autouse=True)
def unchanged():
    """Leave the package of this process as it was."""
    before = subject.room()
    yield
    subject.judge_room(before)


NAMES = [(name, room) for name, rooms in subject.MODULES.items() for room in rooms]


@pytest.mark.parametrize(("name", "room"), NAMES)
def test_functions_are_those_of_the_package_that_is_judged(name, room, monkeypatch):
    subject.judge_room(room)
    module = import_module(subject.MODULES[name][room])
    assert module.__name__.split(".")[1] == room and callable(getattr(module, name))
    monkeypatch.setattr(module, name, lambda vehicle, **options: (vehicle, options))
    assert getattr(subject, name)("craft", workers=2) == ("craft", {"workers": 2})


@pytest.mark.parametrize("name", ["rates", "posterior"])
def test_without_a_choice_the_package_of_the_commands_is_judged(name):
    assert subject._of_room(name) is getattr(ss, name)


@pytest.mark.parametrize("room", list(subject.MODULES["posterior"]))
def test_the_density_of_the_truth_exceeds_that_of_motions_beside_it(room):
    """Of a case drawn from the prior: a rate that is off by 0.2 deg/s, or a moment by 3 %, is less likely by far."""
    subject.judge_room(room)
    vehicle = load_case("philae").vehicle
    telemetry, truth, priors = make(vehicle, "unknown", 0.25, 16, 20.0, 0, 0)
    omega, sun = np.tile(truth.omega_B, (3, 1)), np.tile(truth.sun_B, (3, 1))
    omega[1, 0] += np.radians(0.2)
    values = {name: np.full(3, value) for name, value in truth.values.items()}
    values["inertia_zz"][2] *= 1.03
    true, *beside = subject.log_density(vehicle, telemetry, priors, omega, sun, values)
    assert np.isfinite(true) and true > 4 + max(beside)


def test_a_package_that_does_not_exist_is_refused():
    with pytest.raises(ValueError, match="no such package"):
        subject.judge_room("nowhere")
