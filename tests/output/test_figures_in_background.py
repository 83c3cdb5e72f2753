"""Figures drawn by a helper while this process writes the data."""

import sys
from pathlib import Path

import pytest

import sunspin as ss
from sunspin.compute import helper as module
from sunspin.compute.helper import helper_process
from sunspin.output.figures import load


@pytest.mark.skipif(sys.platform != "linux", reason="processes are copied on Linux")
def test_a_helper_draws_the_same_figures_as_this_process(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "may_fork", lambda: True)  # the threads of other tests are idle
    vehicle, telemetry = ss.load_example("cubesat")
    result = ss.rates(vehicle, telemetry, max_rate_rad_s=0.09, acceleration_noise=1e-5)
    file = Path(ss.__file__).parent / "template" / "vehicle.toml"
    inputs = {"vehicle": file, "telemetry": telemetry}
    alone = result.sunspin.save(tmp_path / "alone", **inputs)
    with helper_process(2, load) as helper:
        together = result.sunspin.save(tmp_path / "together", **inputs, helper=helper)
    names = sorted(path.name for path in alone.iterdir())
    assert {"rates.svg", "residuals.png", "manifest.json"} < set(names)
    assert names == sorted(path.name for path in together.iterdir())
    for name in names:
        assert (alone / name).read_bytes() == (together / name).read_bytes(), name
