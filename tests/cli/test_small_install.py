"""What runs without optional packages: check, sun, rates, export; reports and the study ask for what they need by name."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

import sunspin as ss
from sunspin.base.extras import EXTRAS, install_command
from sunspin.output.report import write_report
from tests.support.rows import ELSEWHERE
from validation.border import CommandResult

OPTIONAL = "matplotlib plotly jinja2 markupsafe spiceypy pyarrow dask distributed heyoka ot"
"""Packages that an installation without extras does not have, as far as modules of sunspin import them."""

HIDING = """
import json, sys
hidden = set(sys.argv[1].split())
class Hiding:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in hidden:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
for name in hidden:
    sys.modules[name] = None
sys.meta_path.insert(0, Hiding())
from validation.border import sunspin
print(json.dumps([sunspin(*words)[:3] for words in json.loads(sys.argv[2])]))
"""
"""Program that runs commands one after the other while the packages of its first argument cannot be imported."""

FILES = "vehicle.toml", "telemetry.csv"
EXPORTS = {"aem": "sunspin.aem", "netcdf": "attitude.nc"}
NEEDS_EXTRA = {
    ("report", "rates"): "pictures",
    ("reproduce", "--out", "study"): "study",
    ("export", "rates", "--format", "ck", "--out", "ck"): "spice",
    ("export", "rates", "--format", "parquet", "--out", "table"): "parquet",
}
COMMANDS = [
    ("init", "."),
    ("sun", *FILES, "--out", "sun"),
    ("rates", *FILES, "--effort", "0.1", "--out", "rates"),
    ("check", *FILES),
    *(("export", "rates", "--format", form, "--out", form) for form in EXPORTS),
    *NEEDS_EXTRA,
]


class Installation(NamedTuple):
    """A folder of the example files with results, and what each command printed without extras."""

    folder: Path
    results: dict[tuple[str, ...], CommandResult]


@pytest.fixture(scope="module")
def small(tmp_path_factory) -> Installation:
    folder = tmp_path_factory.mktemp("satellite")
    program = [sys.executable, "-c", HIDING, OPTIONAL, json.dumps(COMMANDS)]
    options = {"cwd": folder, "env": ELSEWHERE, "capture_output": True, "text": True}
    done = subprocess.run(program, **options)
    assert done.returncode == 0, done.stderr
    results = [CommandResult(*each) for each in json.loads(done.stdout)]
    return Installation(folder, dict(zip(COMMANDS, results, strict=True)))


def test_results_without_optional_packages_have_all_numbers_and_no_figure(small):
    for words in COMMANDS[1:3]:
        done = small.results[words]
        assert done.code == 0, done.err
        line = f"No figures. For figures and the HTML page: {install_command('pictures')}"
        assert line in done.out.splitlines()
    check = small.results["check", *FILES]
    assert check.code == 0 and "faces lit" in check.out
    files = {path.name for path in (small.folder / "rates").iterdir()}
    assert {"rates.csv", "passes.csv", "rates.nc", "summary.json", "vehicle.toml"} <= files
    manifest = json.loads((small.folder / "rates" / "manifest.json").read_text("utf-8"))
    drawn = {name for name in files if name.endswith((".png", ".svg"))}
    assert manifest["figures"] == [] and not drawn
    assert (small.folder / "sun" / "sun.csv").is_file()
    # the page of a folder without figures is written where the packages are
    assert "plotly" in write_report(small.folder / "rates").read_text("utf-8")


@pytest.mark.parametrize("form", EXPORTS)
def test_exports_are_written_without_optional_packages(form, small):
    done = small.results["export", "rates", "--format", form, "--out", form]
    assert done.code == 0 and (small.folder / form / EXPORTS[form]).is_file(), done.err


@pytest.mark.parametrize("words", NEEDS_EXTRA, ids=NEEDS_EXTRA.values())
def test_a_command_that_needs_an_extra_names_it_in_one_sentence(words, small):
    done = small.results[words]
    assert done.code == 2 and done.out == ""
    assert done.err.startswith("sunspin: error: ") and done.err.count("\n") == 1
    assert f'pip install "sunspin[{NEEDS_EXTRA[words]}]"' in done.err
    assert "--out" not in words or not (small.folder / words[-1]).exists()


@pytest.mark.parametrize("missing", EXTRAS["pictures"])
def test_a_figure_is_refused_if_one_package_is_missing(missing, monkeypatch):
    case = ss.load_case("philae")
    directions = ss.sun_directions(case.vehicle, case.telemetry)
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(ss.InputError, match=f"a figure needs {missing}, which is not installed"):
        directions.sunspin.plot()
