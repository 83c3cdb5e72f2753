"""Imports and smoke tests on versions of Python other than the one of this run.

`make test-all` runs it. A version that the machine does not have is named and passed over; one that it has must pass. Each gets an
environment of its own below build/, with the locked versions of what the package and these tests need and nothing else.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
VERSIONS = ("3.11", "3.12", "3.13")
"""Those tried here; a classifier in pyproject.toml waits until the whole suite has passed on its version."""

TOOLS = ("hatchling", "editables", "pytest", "hypothesis")
EXTRAS = "study,cluster,spice,parquet"
"""What modules of the package import beside the core."""

SMOKE = (
    "tests/test_imports.py::test_every_module_imports",
    "tests/test_vehicle.py",
    "tests/telemetry/test_sun.py",
    "tests/dynamics/test_impact.py",
    "tests/estimate/test_metrics.py",
)
"""One file of each layer that compiles no kernel."""

NEWEST = (
    "tests/dynamics/test_propagate.py",
    "tests/cli/test_cli.py",
    "tests/cli/test_simulate.py",
)
"""On the newest version alone: motions, commands, and the compiler, which is the last to know a version."""


def interpreter(version: str) -> str | None:
    """A Python of this version that starts: the one on the path, else one of pyenv."""
    kept = sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python"))
    for program in (shutil.which(f"python{version}"), *map(str, reversed(kept))):
        if program and says(program) == version:
            return program
    return None


def says(program: str) -> str:
    code = "import ensurepip, sys, venv; print('%d.%d' % sys.version_info[:2])"
    done = subprocess.run([program, "-c", code], capture_output=True, text=True)
    return done.stdout.strip()


def environment(program: str, version: str) -> Path:
    """The interpreter of an environment for this version, built anew when the lock or pyproject.toml change."""
    home = ROOT / "build" / f"python{version}"
    python, ready = home / "bin" / "python", home / ".ready"
    files = ROOT / "requirements.lock", ROOT / "pyproject.toml"
    wanted = b"".join(file.read_bytes() for file in files)
    if not (ready.is_file() and ready.read_bytes() == wanted):
        subprocess.run([program, "-m", "venv", "--clear", home], check=True)
        # most files of the packages are never imported here
        quiet = ["--quiet", "--disable-pip-version-check", "--no-compile"]
        pip = [python, "-m", "pip", "install", *quiet, "-c", ROOT / "requirements.lock"]
        subprocess.run([*pip, *TOOLS], check=True)
        own = ["--no-build-isolation", "--editable", f"{ROOT}[{EXTRAS}]"]
        subprocess.run([*pip, *own], check=True)
        ready.write_bytes(wanted)
    return python


def main() -> int:
    failed = []
    for version in VERSIONS:
        if version == f"{sys.version_info.major}.{sys.version_info.minor}":
            continue
        program = interpreter(version)
        if program is None:
            print(f"Python {version}: not on this machine, nothing was tried", flush=True)
            continue
        print(f"Python {version}: {program}", flush=True)
        python = environment(program, version)
        files = [*SMOKE, *NEWEST] if version == VERSIONS[-1] else SMOKE
        pytest = [python, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
        done = subprocess.run([*pytest, *files], cwd=ROOT)
        failed += [version] if done.returncode else []
    good, bad = "Other versions of Python: nothing failed", ", ".join(failed)
    print(f"Python {bad}: smoke tests failed" if failed else good)
    return len(failed)


if __name__ == "__main__":
    sys.exit(main())
