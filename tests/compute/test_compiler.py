"""Compiled code that is kept between processes."""

import importlib.util
import sys

import pytest

CALLED = "from numba import njit\n\n\n@njit(cache=True)\ndef one():\n    return {}\n"
CALLING = """from sunspin.compute.compiler import compiled_with, njit
import called

keep = {}


@keep
def two():
    return called.one() + 1
"""


@pytest.mark.parametrize(
    ("keep", "after"), [("compiled_with(called)", 21), ("njit(cache=True)", 2)]
)
def test_what_is_kept_knows_the_files_that_it_calls(keep, after, tmp_path, monkeypatch):
    """And numba alone does not."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def run(value):
        (tmp_path / "called.py").write_text(CALLED.format(value))
        (tmp_path / "calling.py").write_text(CALLING.format(keep))
        for name in ("called", "calling"):
            spec = importlib.util.spec_from_file_location(name, tmp_path / f"{name}.py")
            module = importlib.util.module_from_spec(spec)
            monkeypatch.setitem(sys.modules, name, module)
            spec.loader.exec_module(module)
        return module.two()

    assert run(1) == run(1) == 2
    assert run(20) == after
