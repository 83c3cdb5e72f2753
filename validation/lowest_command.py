"""``python -m validation lowest``: the tests in a new environment with the lowest versions that pyproject.toml allows."""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
EXTRAS = ("parquet", "spice", "test", "bench")
QUICK = (
    "tests/test_vehicle.py",
    "tests/telemetry",
    "tests/base/test_tables.py",
    "tests/dynamics/test_propagate.py",
    "tests/dynamics/test_impact.py",
    "tests/estimate/test_metrics.py",
    "tests/compute/test_store.py",
    "tests/estimate/test_scan.py",
    "tests/output/test_export.py",
    "tests/cli/test_cli.py",
)

OLD_AGE = (
    "-W",
    "ignore::DeprecationWarning",
    "-W",
    "ignore::PendingDeprecationWarning",
    "-W",
    "ignore::FutureWarning",
)
"""What old libraries say of the newest ones below them; any other warning is an error here as well."""


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--folder", type=Path, help="where the environment is made; default: a temporary folder"
    )
    parser.add_argument(
        "--only-install", action="store_true", help="make the environment and print what is in it"
    )
    parser.add_argument("tests", nargs="*", default=list(QUICK), help="what pytest runs there")


def pins() -> list[str]:
    """Every direct dependency at its lower bound."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    wanted = list(project["dependencies"])
    for extra in EXTRAS:
        wanted += project["optional-dependencies"].get(extra, [])
    lowest: dict[str, str] = {}
    for requirement in wanted:
        found = re.fullmatch(r"([\w.-]+(?:\[[\w,]+\])?)[>=]=([\w.]+)", requirement)
        if found is None:
            raise SystemExit(f"{requirement}: no lower bound")
        lowest[found[1]] = found[2]
    return [f"{name}=={version}" for name, version in lowest.items()]


def run(options: Any) -> int:
    with tempfile.TemporaryDirectory(prefix="validation-") as temporary:
        folder = options.folder or Path(temporary) / "env"
        python = folder / "bin" / "python"
        if not python.exists():
            subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
            pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
            if subprocess.run([*pip, *pins(), str(ROOT)]).returncode:
                return 1
        if options.only_install:
            return subprocess.run([str(python), "-m", "pip", "freeze"]).returncode
        tests = [str(python), "-m", "pytest", "-q", "-m", "not slow", *OLD_AGE, *options.tests]
        return subprocess.run(tests, cwd=ROOT).returncode
