"""Rules of the house that a machine can check."""

import ast
import re
import tomllib
from pathlib import Path

import pytest

from tests.support.sources import nodes_if

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "src").rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))


def test_no_comparison_without_assert():
    """A bare np.allclose(...) compares and forgets."""
    compare = ("allclose", "isclose", "array_equal")
    for path in TESTS:
        for node in nodes_if(path, *compare):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
                name = getattr(node.value.func, "attr", getattr(node.value.func, "id", ""))
                assert name not in compare, f"{path}:{node.lineno}"


@pytest.mark.parametrize(
    "path", sorted((ROOT / "src").glob("sunspin/cases/*/vehicle.toml")), ids=lambda p: p.parent.name
)
def test_every_number_of_a_built_in_vehicle_has_a_source(path):
    def check(value, key):
        if isinstance(value, dict) and "value" in value:
            assert value.get("source", "").strip(), key
        elif isinstance(value, dict):
            for name, item in value.items():
                check(item, f"{key}.{name}")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for item in value:
                check(item, key)
        else:
            exact_geometry = key.endswith("normal_B")
            assert isinstance(value, str) or exact_geometry or not contains_number(value), (
                f"{key} has no source"
            )

    def contains_number(value):
        return (
            any(map(contains_number, value))
            if isinstance(value, list)
            else isinstance(value, int | float)
        )

    check(tomllib.loads(path.read_text("utf-8")), "")


def test_public_names_resolve_and_are_documented():
    import sunspin

    for name in sunspin.__all__:
        assert getattr(sunspin, name).__doc__, name


def test_every_convention_is_pinned_by_tests_that_exist():
    """Each numbered item of docs/conventions.md names a test that pins it, as tests/file.py::name."""
    text = (ROOT / "docs" / "conventions.md").read_text("utf-8")
    items = re.split(r"^(?=\d+\. )", text, flags=re.MULTILINE)[1:]
    assert [int(item.split(".")[0]) for item in items] == list(range(1, len(items) + 1))
    for item in items:
        named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", item)
        assert named, item
        for path, name in named:
            assert re.search(rf"^def {name}\(", (ROOT / path).read_text("utf-8"), re.MULTILINE), (
                f"{path}::{name}"
            )


def test_the_lock_is_within_the_ranges_and_names_no_host():
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    lines = [
        x
        for x in (ROOT / "requirements.lock").read_text("utf-8").splitlines()
        if x and not x.startswith("#")
    ]
    assert all(re.fullmatch(r"[\w.-]+==[\w.]+", line) for line in lines)
    locked = {
        canonicalize_name(name): version for name, version in (line.split("==") for line in lines)
    }
    table = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    extras = table["project"]["optional-dependencies"]
    wanted = [*table["project"]["dependencies"], *sum(extras.values(), [])]
    for requirement in map(Requirement, [*wanted, *table["build-system"]["requires"]]):
        assert requirement.specifier.contains(locked[canonicalize_name(requirement.name)]), (
            requirement
        )
