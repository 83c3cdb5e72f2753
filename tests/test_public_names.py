"""Public names of `sunspin`: each resolves, and its docstring names shapes, units and parameters."""

import inspect
import re

import pytest

import sunspin as ss

FUNCTIONS = [name for name in ss.__all__ if inspect.isfunction(getattr(ss, name))]

SHAPE = re.compile(
    r"\((?:…|\.\.\.|[a-z_0-9]+)(?:, ?[a-z_0-9]+)*,?\)|Dataset|DataArray|DataTree|Vehicle|number|path|dict",
    re.I,
)
UNIT = re.compile(
    r"\b(rad|rad/s|s|m|m/s|W|kg|N m|N m s|deg|Hz)\b|\[0, 1\]|unit|relative|SI|Dataset|Vehicle|path|share"
)


def test_every_public_name_resolves_and_is_documented():
    assert [name for name in ss.__all__ if not getattr(ss, name).__doc__] == []


@pytest.mark.parametrize("name", FUNCTIONS)
def test_docstring_of_a_public_function_names_shapes_units_and_parameters(name):
    text = inspect.getdoc(getattr(ss, name))
    assert SHAPE.search(text), f"{name} names no shape or kind of what it takes and gives"
    assert UNIT.search(text), f"{name} names no unit"
    parameters = inspect.signature(getattr(ss, name)).parameters.values()
    known = [p.name for p in parameters if p.kind is not p.VAR_KEYWORD and p.name != "vehicle"]
    missing = [n for n in known if not re.search(rf"\b{re.escape(n)}\b", text)]
    assert not missing, f"{name} does not name {missing}"
