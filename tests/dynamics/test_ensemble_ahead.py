"""Kernels that are compiled in another process."""

import os

import numpy as np
import pytest

from sunspin.base.errors import OutputError
from sunspin.dynamics import ensemble as k
from sunspin.dynamics.ensemble import ahead, compiled, series_lanes, steps
from tests.support.vehicles import FIRST_SUN, random_vehicle


@pytest.fixture
def short_kernels(monkeypatch, tmp_path):
    """A cache of its own, and a series so short that it is compiled in seconds."""
    monkeypatch.setenv("SUNSPIN_CACHE", str(tmp_path))
    for module in (series_lanes, steps):
        monkeypatch.setattr(module, "ORDER", 3)
    compiled.kernel.cache_clear()
    yield tmp_path
    compiled.kernel.cache_clear()


def test_the_text_of_a_kernel_is_generated_once(short_kernels, monkeypatch):
    """SymPy is not even imported for a kernel whose text was kept; a damaged or older text is generated anew."""
    structure = k.structure_of(random_vehicle(np.random.default_rng(11), 1), None, 0)
    text = compiled.source(structure)
    assert compiled.kept_source(structure) == text
    (path,) = compiled.cache_folder().glob("source_*.txt")
    with monkeypatch.context() as unable:
        unable.setattr(compiled, "source", lambda structure: pytest.fail("generated again"))
        assert compiled.kept_source(structure) == text
    path.write_text(path.read_text("utf-8").replace("omega", "0mega", 1), "utf-8")
    assert compiled.kept_source(structure) == text
    monkeypatch.setattr(series_lanes, "ORDER", 4)
    assert compiled.kept_source(structure) == compiled.source(structure) != text


def test_compiling_reports_a_cache_folder_that_cannot_be_written(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("SUNSPIN_CACHE", str(tmp_path / "file"))
    with pytest.raises(OutputError, match="cannot be kept here.*SUNSPIN_CACHE"):
        k.compile_all([])


@pytest.mark.long
@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="nothing is compiled ahead on a single core")
def test_a_kernel_compiled_in_another_process_is_read_from_the_cache(short_kernels):
    vehicle = random_vehicle(np.random.default_rng(8), 0)
    k.prepare(vehicle, [(None, 0)])
    k.prepare(vehicle, [(None, 0)])
    assert len(set(ahead._under_way.values())) >= 1
    rows = k.Rows(np.array([[0.1, 0.2, 0.3]]), FIRST_SUN[None], np.zeros((1, 0)))
    module = ahead.ready_kernel(k.structure_of(vehicle, None, 0))
    assert ahead.is_kept(ahead._path(module))
    k.run_rows(vehicle, rows, 1.0, direction_error=1e-2)
    assert sum(module.run.stats.cache_hits.values()) == 1
    assert not module.run.stats.cache_misses


@pytest.mark.long
def test_without_a_second_process_the_kernel_is_compiled_in_this_one(short_kernels, monkeypatch):
    monkeypatch.setattr(ahead.sys, "executable", str(short_kernels / "nowhere"))
    vehicle = random_vehicle(np.random.default_rng(9), 0)
    k.prepare(vehicle, [(None, 0)])
    rows = k.Rows(np.array([[0.1, 0.2, 0.3]]), FIRST_SUN[None], np.zeros((1, 0)))
    assert k.run_rows(vehicle, rows, 1.0, direction_error=1e-2).outcome[0] == k.Outcome.FINE
