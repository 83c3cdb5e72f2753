"""The wheel and the source archive: their content, and that the wheel works on its own."""

import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return folder


def run(code: str, folder: Path) -> str:
    """Run code on the wheel's own files, not on those of the checkout."""
    environment = os.environ | {"PYTHONPATH": str(folder), "PYTHONSAFEPATH": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=folder, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_wheel_works_on_its_own(built, tmp_path):
    (wheel,) = built.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    said = "import sunspin; print(sunspin.__file__, sunspin.load_case('philae').telemetry.sizes['time'])"
    init = "from sunspin.cli import cli; cli(['init', 'mine', '--quiet'], standalone_mode=False)"
    where = run(f"{said}; {init}", tmp_path).split()
    assert where == [str(tmp_path / "sunspin" / "__init__.py"), "251"]
    page = (ROOT / "docs" / "howto" / "verdicts.md").read_text("utf-8")
    assert (tmp_path / "sunspin" / "output" / "verdicts.md").read_text("utf-8") == page
    assert (tmp_path / "mine" / "vehicle.toml").is_file()
    assert (tmp_path / "sunspin" / "py.typed").is_file()


def test_the_archives_hold_what_they_should_and_nothing_else(built):
    (wheel,), (source,) = built.glob("*.whl"), built.glob("*.tar.gz")
    names = zipfile.ZipFile(wheel).namelist()
    assert all(re.match(r"sunspin(-[\d.]+\.dist-info)?/", name) for name in names)
    with tarfile.open(source) as archive:
        inside = {name.split("/", 1)[1] for name in archive.getnames() if "/" in name}
    wanted = "LICENSE CITATION.cff CHANGELOG.md tests/conftest.py docs/conf.py".split()
    assert {*wanted, "examples/01_sun_from_powers.py"} <= inside
    paths = (ROOT / "src/sunspin/cases").glob("[a-z]*/*")
    data = {path.relative_to(ROOT / "src").as_posix() for path in paths if path.is_file()}
    assert "sunspin/cases/philae/published.toml" in data and data <= set(names)
    other = (".bsp", ".bc", ".zip", ".nc", ".tex")  # other people's data and results
    assert not [name for name in [*names, *inside] if name.lower().endswith(other)]


def test_citation_and_changelog_have_the_version_of_the_package():
    version = PROJECT["version"]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text("utf-8")
    changes = (ROOT / "CHANGELOG.md").read_text("utf-8")
    assert re.search(rf"^## {re.escape(version)}\b", changes, re.MULTILINE)


def test_heavy_dependencies_are_extras():
    core = " ".join(PROJECT["dependencies"])
    extras = "cluster spice parquet pictures study docs test"
    assert set(extras.split()) <= set(PROJECT["optional-dependencies"])
    for heavy in ("pyarrow", "distributed", "spiceypy", "sphinx", "matplotlib", "plotly"):
        assert heavy not in core
