"""Shared fixtures. Tests on other people's data ask for `data_dir` and carry the mark `real_data`."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import pytest

pytest_plugins = ["tests.support.evidence"]


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """What the test modules import stays to the end: the search for garbage need not go through it, then or each time after."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder with downloaded telemetry and kernels (docs/data.md): SUNSPIN_DATA, else shared/data beside the checkout."""
    named = os.environ.get("SUNSPIN_DATA")
    folder = Path(named) if named else Path(__file__).parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(
            f"other people's data is not here ({folder}); docs/data.md says where to download it, then set SUNSPIN_DATA"
        )
    return folder


@pytest.fixture
def undrawn(monkeypatch) -> None:
    """Results are saved without the files of their figures, which take longer than all else; the figures are still made."""
    from sunspin.output import figures

    monkeypatch.setattr(figures, "render", lambda figure: {})


@pytest.fixture
def framed(monkeypatch) -> None:
    """Figures are made, but only their frames drawn."""
    from sunspin.output import figures
    from tests.support.figures import frame

    monkeypatch.setattr(figures, "lay_out", frame)
