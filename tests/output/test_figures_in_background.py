"""Figures drawn by a helper while this process writes the data."""

import os
import sys
from pathlib import Path

import pytest

import sunspin as ss
from sunspin.compute import helper as module
from sunspin.compute.helper import helper_process
from sunspin.output.figures import load

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are copied on Linux")


@pytest.fixture(autouse=True)
def idle_threads(monkeypatch):
    """Let this process be copied: the threads of other tests are idle."""
    monkeypatch.setattr(module, "may_fork", lambda: True)


@pytest.mark.parametrize("call", [os.abort, None])
def test_a_result_is_saved_with_its_figures_although_the_helper_was_ended(tmp_path, call):
    """Before the result is given to it, or while it draws."""
    vehicle, telemetry = ss.load_example("cubesat")
    result = ss.sun_directions(vehicle, telemetry)
    with helper_process(2, call or os.abort) as helper:
        if call is not None:
            helper.start(call)
        folder = result.sunspin.save(tmp_path / "r", helper=helper)
    assert list(folder.glob("*.svg")) and (folder / "manifest.json").exists()


def test_a_helper_draws_the_same_figures_as_this_process(tmp_path):
    vehicle, telemetry = ss.load_example("cubesat")
    result = ss.sun_directions(vehicle, telemetry)
    file = Path(ss.__file__).parent / "template" / "vehicle.toml"
    inputs = {"vehicle": file, "telemetry": telemetry}
    alone = result.sunspin.save(tmp_path / "alone", **inputs)
    with helper_process(2, load) as helper:
        together = result.sunspin.save(tmp_path / "together", **inputs, helper=helper)
    names = sorted(path.name for path in alone.iterdir())
    assert {"sun.svg", "sun.png", "manifest.json"} < set(names)
    assert names == sorted(path.name for path in together.iterdir())
    for name in names:
        assert (alone / name).read_bytes() == (together / name).read_bytes(), name
