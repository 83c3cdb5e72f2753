"""What runs without optional packages: check, sun, rates, export; reports and the study ask for what they need by name."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import sunspin as ss
from sunspin.base.extras import EXTRAS, install_command

OPTIONAL = "matplotlib plotly jinja2 markupsafe spiceypy pyarrow dask distributed heyoka ot"
"""Packages that an installation without extras does not have, as far as modules of sunspin import them."""

HIDING = """
import runpy, sys
hidden = set(sys.argv.pop(1).split())
class Hiding:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in hidden:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
for name in hidden:
    sys.modules[name] = None
sys.meta_path.insert(0, Hiding())
runpy.run_module("sunspin.cli", run_name="__main__", alter_sys=True)
"""
"""Program that runs the command line while the packages of its first argument cannot be imported."""


def run(folder: Path, *arguments: str, hidden: str = OPTIONAL) -> subprocess.CompletedProcess:
    environment = os.environ | {"PYTHONWARNINGS": ""}
    command = [sys.executable, "-c", HIDING, hidden, *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


@pytest.fixture(scope="module")
def satellite(tmp_path_factory) -> Path:
    """Folder of the example files, with the results of `sun` and `rates` from an installation without extras."""
    folder = tmp_path_factory.mktemp("satellite")
    assert run(folder, "init", ".").returncode == 0
    for command in ("sun", "rates"):
        done = run(folder, command, "vehicle.toml", "telemetry.csv", "--out", command)
        assert done.returncode == 0, done.stderr
        line = f"No figures. For figures and the HTML page: {install_command('pictures')}"
        assert line in done.stdout.splitlines()
    return folder


def test_check_runs_without_optional_packages(satellite):
    done = run(satellite, "check", "vehicle.toml", "telemetry.csv")
    assert done.returncode == 0 and "faces lit" in done.stdout


def test_results_without_optional_packages_have_all_numbers_and_no_figure(satellite):
    files = {path.name for path in (satellite / "rates").iterdir()}
    assert {"rates.csv", "passes.csv", "rates.nc", "summary.json", "vehicle.toml"} <= files
    manifest = json.loads((satellite / "rates" / "manifest.json").read_text("utf-8"))
    drawn = {name for name in files if name.endswith((".png", ".svg"))}
    assert manifest["figures"] == [] and not drawn
    assert (satellite / "sun" / "sun.csv").is_file()


def test_the_page_of_a_folder_without_figures_is_written_where_the_packages_are(satellite):
    from sunspin.output.report import write_report

    page = write_report(satellite / "rates").read_text("utf-8")
    assert "plotly" in page


@pytest.mark.parametrize(("form", "name"), [("aem", "sunspin.aem"), ("netcdf", "attitude.nc")])
def test_exports_are_written_without_optional_packages(form, name, satellite, tmp_path):
    done = run(satellite, "export", "rates", "--format", form, "--out", str(tmp_path / "out"))
    assert done.returncode == 0 and (tmp_path / "out" / name).is_file(), done.stderr


@pytest.mark.parametrize(
    ("arguments", "extra"),
    [
        (["report", "rates"], "pictures"),
        (["reproduce", "--out", "study"], "study"),
        (["export", "rates", "--format", "ck", "--out", "ck"], "spice"),
        (["export", "rates", "--format", "parquet", "--out", "table"], "parquet"),
    ],
)
def test_a_command_that_needs_an_extra_names_it_in_one_sentence(arguments, extra, satellite):
    done = run(satellite, *arguments)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("sunspin: error: ") and done.stderr.count("\n") == 1
    assert f'pip install "sunspin[{extra}]"' in done.stderr
    assert "--out" not in arguments or not (satellite / arguments[-1]).exists()


@pytest.mark.parametrize("missing", EXTRAS["pictures"])
def test_a_figure_is_refused_if_one_package_is_missing(missing, monkeypatch):
    case = ss.load_case("philae")
    directions = ss.sun_directions(case.vehicle, case.telemetry)
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(ss.InputError, match=f"a figure needs {missing}, which is not installed"):
        directions.sunspin.plot()
