"""Every module imports without a warning, and no command waits for a module that it does not use."""

import importlib
import importlib.util
import os
import pkgutil
import pty
import subprocess
import sys
from contextlib import suppress

import numpy as np
import pytest

import sunspin
from sunspin.output.template import write_templates
from sunspin.vehicle import Vehicle


def modules() -> list[str]:
    """All modules of the package but programs and the texts from which kernels are made."""
    found = [module.name for module in pkgutil.walk_packages(sunspin.__path__, "sunspin.")]
    return [name for name in found if not name.endswith(("_template", "__main__"))]


NEEDS = {"sunspin.compute.cluster": "distributed"}
"""Modules of an extra, which is not everywhere."""


def test_every_module_imports():
    assert len(modules()) > 150
    for name in modules():
        if name not in NEEDS or importlib.util.find_spec(NEEDS[name]) is not None:
            importlib.import_module(name)


@pytest.mark.parametrize("order", ["sunspin, xarray as xr", "xarray as xr, sunspin"])
def test_a_results_file_has_the_accessor_after_import_of_sunspin(order, tmp_path):
    """Without a public name of sunspin being used; and a question whether xarray is there, before it, changes nothing."""
    result = sunspin.propagate(
        Vehicle("made up", inertia_kg_m2=np.eye(3)), [0.1, 0, 0], [0, 0, 1.0], None, [0.0, 1.0]
    )
    result.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    code = f"import importlib.util; import {order.split(', ')[0]}; importlib.util.find_spec('xarray'); import {order}; import sys"
    code += f"; print(xr.open_dataset({str(tmp_path / 'a.nc')!r}).sunspin.summary())"
    assert output_of(code).startswith("at t = 1 s:")


def output_of(code: str, **options) -> str:
    """Return what a new process prints that runs this code."""
    run = [sys.executable, "-c", code]
    options = {"capture_output": True, "text": True, "check": True} | options
    return subprocess.run(run, **options).stdout


IN_TURN = """
import sys, sunspin as ss
print(*sys.modules)
import sunspin.cli
print(*sys.modules)
import sunspin.cli.scan; ss.scan, ss.load_case, ss.sun_directions
print(*sys.modules)
"""


def test_code_waits_for_no_module_that_it_does_not_use():
    """Each of these takes as long to import as a small scan or the estimate of a short pass takes to run."""
    package, command, scan = (set(line.split()) for line in output_of(IN_TURN).splitlines())
    heavy = set("numpy xarray scipy numba heyoka matplotlib".split())
    assert "sunspin" in package and not package & (heavy | {"click"})
    assert "sunspin.cli" in command and not command & (heavy - {"numpy"})
    unused = "heyoka scipy.stats scipy.optimize scipy.spatial matplotlib plotly"
    assert "sunspin.dynamics.batch" in scan and not scan & set(unused.split())
    code = "import sys, sunspin as ss; ss.rates; import sunspin.cli.rates; print(*sys.modules)"
    loaded = set(output_of(code).split())
    assert "sunspin.estimate.rates" in loaded
    assert not loaded & set("scipy.stats scipy.optimize matplotlib".split())


def test_the_first_line_of_rates_comes_before_the_imports_that_take_longest(tmp_path):
    """And modules that only others need are never imported, not even for the figures; the step is loaded without numba."""
    write_templates(tmp_path)
    run = "-X importtime -m sunspin.cli rates vehicle.toml telemetry.csv --out rates --workers 1"
    command = [sys.executable, *run.split(), "--effort", "0.1"]
    terminal, end = pty.openpty()
    with subprocess.Popen(command, cwd=tmp_path, stderr=end) as process:
        os.close(end)
        written = b""
        with suppress(OSError):  # that of a terminal whose other end is closed
            while part := os.read(terminal, 65536):
                written += part
    os.close(terminal)
    assert process.returncode == 0
    said = written.decode().splitlines()
    first = next(i for i, line in enumerate(said) if line.startswith("sunspin: "))
    assert said[first] == "sunspin: rates: reading telemetry.csv"
    imported = [
        {line.rpartition("|")[2].strip() for line in part if line.startswith("import time:")}
        for part in (said[:first], said)
    ]
    assert "click" in imported[0]
    assert not imported[0] & {"pandas", "xarray", "scipy", "numba", "pyarrow", "matplotlib"}
    assert {"llvmlite.binding", "pandas", "scipy", "matplotlib"} <= imported[1]
    unused = "numba scipy.linalg scipy.interpolate scipy.spatial scipy.optimize scipy.stats"
    assert not imported[1] & set(unused.split())


def test_check_and_sun_wait_for_neither_the_compiler_nor_linear_algebra(tmp_path):
    """numba and the parts of SciPy take a quarter of the time in which these commands run on the example files."""
    code = """
import sys
from sunspin.cli import cli
cli(["init", ".", "--quiet"], standalone_mode=False)
for command in ("check", "sun"):
    cli([command, "vehicle.toml", "telemetry.csv", "--quiet"], standalone_mode=False)
print(*sys.modules)
"""
    loaded = set(output_of(code, cwd=tmp_path).split())
    assert "sunspin.telemetry.assess" in loaded
    unused = (
        "numba llvmlite scipy.linalg scipy.spatial scipy.optimize scipy.stats matplotlib plotly"
    )
    assert not loaded & set(unused.split())
