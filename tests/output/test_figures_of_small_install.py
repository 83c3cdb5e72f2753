"""The page of a folder that was written without the packages of figures has its figures."""

from pathlib import Path

import numpy as np
import pytest

import sunspin as ss
from sunspin.output import result as result_module
from sunspin.output.folder import read_manifest
from sunspin.output.report import write_report
from sunspin.telemetry.synthetic import telemetry_dataset
from tests.support.browser import Page
from tests.support.simulate import CUBE


def test_the_page_has_the_figures_that_the_folder_lacks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    t = 20.0 * np.arange(12)
    sun = ss.propagate(CUBE, [0.01, 0.02, 0.03], [0.6, 0.0, 0.8], None, t)["sun_B"].values
    power = ss.panel_power(CUBE, sun)
    samples = telemetry_dataset(CUBE, t, power, sun, "2026-01-01T00:00:00Z", {})
    directions = ss.sun_directions(CUBE, samples)
    with monkeypatch.context() as small_install:
        small_install.setattr(result_module, "missing_packages", lambda _: ["matplotlib"])
        directions.sunspin.save(tmp_path / "small", telemetry=samples)
    directions.sunspin.save(tmp_path / "whole", telemetry=samples)
    assert read_manifest(tmp_path / "small")["figures"] == []

    def images(folder: Path) -> list[str]:
        """Return what each figure of the page shows, in words."""
        tags = Page(write_report(folder)).tags
        return [attrs["alt"] for tag, attrs in tags if tag == "img"]

    assert images(tmp_path / "small") == images(tmp_path / "whole") != []
