"""What a store's name hangs on: the files that decide what a row gives."""

import ast
from pathlib import Path

import pytest

from sunspin.compute import identity

PACKAGE = Path(identity.__file__).parents[1]


def named() -> set[str]:
    """Files and folders that the package names to `identity.code`, the common ones included."""
    found = set(identity.PHYSICS)
    for text in (path.read_text("utf-8") for path in PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(text)) if "code(" in text else ():
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "code":
                found |= {word.value for word in node.args if isinstance(word, ast.Constant)}
    return found


@pytest.mark.parametrize("name", sorted(named()))
def test_every_file_that_is_named_is_there(name):
    files = dict(identity._files(name, PACKAGE / name))
    assert files and all(path.is_file() for path in files.values())


def test_a_change_of_the_physics_is_another_identity(monkeypatch):
    before = identity.code()
    identity.code.cache_clear()
    monkeypatch.setattr(identity, "PHYSICS", identity.PHYSICS[:-1])
    try:
        assert identity.code()["physics_sha256"] != before["physics_sha256"]
    finally:
        identity.code.cache_clear()
