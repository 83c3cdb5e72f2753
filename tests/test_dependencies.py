"""Dependencies: imports and declarations agree, licences bind no user, the lock is within the ranges."""

from __future__ import annotations

import re
import sys
import tomllib
from functools import cache
from importlib import metadata
from pathlib import Path

import grimp
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from sunspin.base import extras
from tests.support.other_pythons import VERSIONS

ROOT = Path(__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
PROJECT = PYPROJECT["project"]

MODULES = {"pot": "ot", "pyerfa": "erfa"}
"""Distribution -> module, where the names differ."""

NOT_IMPORTED = {
    "h5py": "h5netcdf reads and writes by it, and from 1.7 on does not bring it",
    "soupsieve": "holds back a version of what furo needs",
    "furo": "named in docs/conf.py, found by Sphinx",
    "myst-parser": "named in docs/conf.py, found by Sphinx",
    "sphinx": "run as a program",
    "parquet": "xarray and pandas read by it",
}

BROUGHT = {"markupsafe": "jinja2", "llvmlite": "numba"}
"""Imported here, and needed always by a declared one, which knows the version that it needs."""

SHARE_ALIKE = re.compile(r"\b(A?GPL|GNU (Affero )?General Public)", re.IGNORECASE)


def names(requirements: list[str]) -> set[str]:
    return {
        re.match(r"[A-Za-z0-9_.-]+", text)[0].lower().replace("_", "-") for text in requirements
    }


def requirements_of(extra: str) -> list[str]:
    """Requirements of an extra; one that names another extra of this package stands for the requirements of that one."""
    expanded: list[str] = []
    for text in PROJECT["optional-dependencies"][extra]:
        own = re.fullmatch(r"sunspin\[(\w+)\]", text)
        expanded += requirements_of(own[1]) if own else [text]
    return expanded


CORE = names(PROJECT["dependencies"])
EXTRAS = {extra: names(requirements_of(extra)) for extra in PROJECT["optional-dependencies"]}


@cache
def imported() -> set[str]:
    """Return the third-party packages that modules of sunspin import, as import-linter's graph has them."""
    graph = grimp.build_graph("sunspin", include_external_packages=True, cache_dir=None)
    packages = {name for name in graph.modules if graph.is_module_squashed(name)}
    return packages - sys.stdlib_module_names


def module_of(distribution: str) -> str:
    return MODULES.get(distribution, distribution.replace("-", "_"))


def test_every_imported_package_is_declared():
    """And every declared one is imported."""
    runtime = CORE | set().union(
        *(wanted for extra, wanted in EXTRAS.items() if extra not in ("test", "docs", "bench"))
    )
    assert len(imported()) > 10
    for module, parent in BROUGHT.items():
        needs = [text for text in metadata.requires(parent) or [] if "extra ==" not in text]
        assert module in imported() and parent in runtime and module in names(needs)
    declared = {module_of(name) for name in runtime} | set(BROUGHT)
    assert not imported() - declared
    assert not {name for name in CORE if module_of(name) not in imported()} - set(NOT_IMPORTED)


def test_an_error_that_names_an_extra_names_the_packages_that_it_brings():
    assert {extra: set(modules) for extra, modules in extras.EXTRAS.items()} == {
        extra: {module_of(name) for name in EXTRAS[extra]} for extra in extras.EXTRAS
    }


def closure(wanted: set[str]) -> set[str]:
    """Distributions with all that they bring, as far as they are installed."""
    found, todo = set(), set(wanted)
    while todo:
        name = todo.pop()
        try:
            needs = metadata.requires(name) or []
        except metadata.PackageNotFoundError:
            continue
        found.add(name)
        todo |= names([text for text in needs if "extra ==" not in text]) - found
    return found


def licence(name: str) -> str:
    about = metadata.metadata(name)
    licences = [c for c in about.get_all("Classifier", []) if c.startswith("License")]
    given = [about.get("License-Expression") or "", *licences]
    return " ".join(filter(None, given)) or str(about.get("License") or "")[:200]


@pytest.mark.parametrize("extra", ["", *(name for name in EXTRAS if name not in ("test", "docs"))])
def test_no_dependency_has_a_share_alike_licence(extra):
    """Of what comes with sunspin or an extra; tools of the tests and of the documentation are not passed on."""
    every = closure(EXTRAS[extra] if extra else CORE)
    assert every or extra, "nothing is installed"
    told = {name: licence(name) for name in every}
    assert not sorted(name for name, text in told.items() if not text), "no licence"
    assert not {name: text for name, text in told.items() if SHARE_ALIKE.search(text)}


def test_every_python_version_in_the_classifiers_is_tried():
    """Classifiers begin with the lowest version that may install it, and name none that `make test-all` would not try."""
    known = (re.search(r":: (3\.\d+)$", text) for text in PROJECT["classifiers"])
    claimed = [version[1] for version in known if version]
    assert PROJECT["requires-python"] == f">={claimed[0]}" and set(claimed) <= set(VERSIONS)


def test_the_lock_is_within_the_ranges_and_names_no_host():
    text = (ROOT / "requirements.lock").read_text("utf-8")
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    assert all(re.fullmatch(r"[\w.-]+==[\w.]+", line) for line in lines)
    pairs = (line.split("==") for line in lines)
    locked = {canonicalize_name(name): version for name, version in pairs}
    optional = [text for extra in EXTRAS for text in requirements_of(extra)]
    wanted = [*PROJECT["dependencies"], *optional]
    for requirement in map(Requirement, [*wanted, *PYPROJECT["build-system"]["requires"]]):
        version = locked[canonicalize_name(requirement.name)]
        assert requirement.specifier.contains(version), requirement
