"""Shared fixtures. Tests on other people's data ask for `data_dir` and carry the mark `real_data`."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

pytest_plugins = ["evidence"]


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder with downloaded telemetry and kernels (docs/data.md): SUNSPIN_DATA, else shared/data beside the checkout."""
    named = os.environ.get("SUNSPIN_DATA")
    folder = Path(named) if named else Path(__file__).parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"other people's data is not here ({folder}); docs/data.md says where to download it, then set SUNSPIN_DATA")
    return folder


@pytest.fixture(scope="session", autouse=True)
def _kernel_cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Compiled kernels stay out of the user's cache, unless one is named; processes that share the tests share them."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "kernels"
    folder.mkdir(exist_ok=True)
    os.environ.setdefault("SUNSPIN_CACHE", str(folder))
