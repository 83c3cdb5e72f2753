"""More rules of the house: what the public face says of itself, how tests compare, what the tests' own settings are."""

import ast
import inspect
import re
from pathlib import Path

import pytest

import sunspin as ss
from sources import has, nodes_if, tree

ROOT = Path(__file__).parents[1]
PYTHON = [
    path
    for part in ("src", "tests", "validation", "studies", "bench")
    for path in sorted((ROOT / part).rglob("*.py"))
]
FUNCTIONS = [name for name in ss.__all__ if inspect.isfunction(getattr(ss, name))]

SHAPE = re.compile(
    r"\((?:…|\.\.\.|[a-z_0-9]+)(?:, ?[a-z_0-9]+)*,?\)|Dataset|DataArray|DataTree|Vehicle|number|path|dict",
    re.I,
)
UNIT = re.compile(
    r"\b(rad|rad/s|s|m|m/s|W|kg|N m|N m s|deg|Hz)\b|\[0, 1\]|unit|relative|SI|Dataset|Vehicle|path|share"
)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_docstrings_of_the_public_face_name_shapes_and_units(name):
    text = inspect.getdoc(getattr(ss, name))
    assert SHAPE.search(text), f"{name} names no shape or kind of what it takes and gives"
    assert UNIT.search(text), f"{name} names no unit"
    parameters = inspect.signature(getattr(ss, name)).parameters.values()
    known = [p.name for p in parameters if p.kind is not p.VAR_KEYWORD and p.name != "vehicle"]
    missing = [n for n in known if not re.search(rf"\b{re.escape(n)}\b", text)]
    assert not missing, f"{name} does not speak of {missing}"


def calls(path: Path, *names: str):
    """Calls in a file that has one of these names."""
    return (node for node in nodes_if(path, *names) if isinstance(node, ast.Call))


def name_of(call: ast.Call) -> str:
    return getattr(call.func, "attr", getattr(call.func, "id", ""))


def test_every_comparison_states_its_tolerance():
    """The defaults of NumPy and pytest suit nobody's physics."""
    bare, names = [], ("assert_allclose", "allclose", "isclose")
    for path in PYTHON:
        for call in calls(path, *names):
            stated = {"rtol", "atol"} & {k.arg for k in call.keywords}
            if name_of(call) in names and not stated:
                bare.append(f"{path.relative_to(ROOT)}:{call.lineno}")
    assert bare == []


def test_no_module_draws_random_numbers_when_it_is_imported():
    """Nor is there a generator that all share: what is drawn would hang on who came before."""
    drawn = {"default_rng", "RandomState", "SeedSequence", "Random", "seed"}
    for path in PYTHON:
        for node in tree(path).body if has(path, *drawn) else ():
            if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef):
                continue
            found = [
                call
                for call in ast.walk(node)
                if isinstance(call, ast.Call) and name_of(call) in drawn
            ]
            seeded = [call for call in found if not call.args]
            assert not (found if "src" in path.parts else seeded), f"{path}:{node.lineno}"


def test_every_generator_has_a_seed():
    names = ("default_rng", "RandomState", "Random")
    for path in PYTHON:
        for call in calls(path, *names):
            if name_of(call) in names:
                assert call.args, f"{path}:{call.lineno}"


def test_no_file_format_of_ours_can_carry_code():
    """Nothing that a user supplies or receives is a pickle: no module reads one, and NumPy is never allowed to."""
    modules = {"pickle", "marshal", "shelve", "dill", "joblib", "cloudpickle"}
    functions = ("read_pickle", "to_pickle", "full_load", "unsafe_load")
    for path in PYTHON:
        if "src" not in path.parts:
            continue
        found = nodes_if(path, *modules, *functions)  # "pickle" is in "allow_pickle", too
        names = {
            alias.name.split(".")[0]
            for node in found
            if isinstance(node, ast.Import)
            for alias in node.names
        }
        names |= {
            (node.module or "").split(".")[0] for node in found if isinstance(node, ast.ImportFrom)
        }
        assert not names & modules, path
        asked = [node for node in found if isinstance(node, ast.Call)]
        assert not [
            call for call in asked if any(k.arg == "allow_pickle" for k in call.keywords)
        ], path
        assert not [call for call in asked if name_of(call) in functions], path


def test_nothing_listens_but_what_dask_is_asked_for():
    listeners = {"HTTPServer", "bind", "listen", "create_server", "start_server"}
    for path in PYTHON:
        if "src" in path.parts:
            assert not listeners & {name_of(call) for call in calls(path, *listeners)}, path
