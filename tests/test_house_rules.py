"""Rules of the house that a machine can check."""

import ast
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "src").rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))


@pytest.mark.parametrize("path", SOURCES + TESTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_are_short(path):
    assert len(path.read_text("utf-8").splitlines()) <= 400


def test_no_comparison_without_assert():
    """A bare np.allclose(...) compares and forgets."""
    for path in TESTS:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
                name = getattr(node.value.func, "attr", getattr(node.value.func, "id", ""))
                assert name not in ("allclose", "isclose", "array_equal"), f"{path}:{node.lineno}"


def test_randomness_is_passed_and_never_found():
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Attribute) and node.value.attr == "random":
                assert node.attr in ("default_rng", "Generator", "SeedSequence"), f"{path}:{node.lineno}"


def test_nothing_from_outside_is_executed():
    for path in SOURCES:
        text = path.read_text("utf-8")
        names = {node.id for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Name)}
        assert not names & {"eval", "exec", "pickle"}, path


@pytest.mark.parametrize("path", sorted((ROOT / "src").glob("sunspin/cases/*/vehicle.toml")), ids=lambda p: p.parent.name)
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
            assert isinstance(value, str) or exact_geometry or not contains_number(value), f"{key} has no source"

    def contains_number(value):
        return any(map(contains_number, value)) if isinstance(value, list) else isinstance(value, int | float)

    check(tomllib.loads(path.read_text("utf-8")), "")


def test_public_names_resolve_and_are_documented():
    import sunspin

    for name in sunspin.__all__:
        assert getattr(sunspin, name).__doc__, name
