"""Rules of the code that only its text shows: each generator has a seed, nothing reads pickles, nothing listens."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PYTHON = [
    path
    for part in ("src", "tests", "validation", "studies", "bench")
    for path in sorted((ROOT / part).rglob("*.py"))
]


@cache
def text(path: Path) -> str:
    return path.read_text("utf-8")


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(text(path))


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    return tuple(ast.walk(tree(path)))


def has(path: Path, *words: str) -> bool:
    """Return whether the text of a file has one of these words: others need not be parsed for them."""
    return any(word in text(path) for word in words)


def nodes_if(path: Path, *words: str) -> tuple[ast.AST, ...]:
    """Return all nodes of a file that has one of these words, else none."""
    return nodes(path) if has(path, *words) else ()


def calls(path: Path, *names: str):
    """Return the calls in a file that has one of these names."""
    return (node for node in nodes_if(path, *names) if isinstance(node, ast.Call))


def name_of(call: ast.Call) -> str:
    return getattr(call.func, "attr", getattr(call.func, "id", ""))


def test_no_module_draws_random_numbers_when_it_is_imported():
    """A generator that all share is not allowed either: its draws would depend on who drew before."""
    drawn = {"default_rng", "RandomState", "SeedSequence", "Random", "seed"}
    for path in PYTHON:
        for node in tree(path).body if has(path, *drawn) else ():
            if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef):
                continue
            every = (call for call in ast.walk(node) if isinstance(call, ast.Call))
            found = [call for call in every if name_of(call) in drawn]
            seeded = [call for call in found if not call.args]
            assert not (found if "src" in path.parts else seeded), f"{path}:{node.lineno}"


def test_every_generator_has_a_seed():
    names = ("default_rng", "RandomState", "Random")
    for path in PYTHON:
        for call in calls(path, *names):
            if name_of(call) in names:
                assert call.args, f"{path}:{call.lineno}"


def test_the_package_reads_and_writes_no_pickles():
    """No module of the package imports pickle or the like, and NumPy is never allowed to read one."""
    modules = {"pickle", "marshal", "shelve", "dill", "joblib", "cloudpickle"}
    functions = ("read_pickle", "to_pickle", "full_load", "unsafe_load")
    for path in PYTHON:
        if "src" not in path.parts:
            continue
        found = nodes_if(path, *modules, *functions)  # "pickle" is in "allow_pickle", too
        imports = (node for node in found if isinstance(node, ast.Import))
        names = {alias.name.split(".")[0] for node in imports for alias in node.names}
        others = (node for node in found if isinstance(node, ast.ImportFrom))
        names |= {(node.module or "").split(".")[0] for node in others}
        assert not names & modules, path
        asked = [node for node in found if isinstance(node, ast.Call)]
        assert "allow_pickle" not in {k.arg for call in asked for k in call.keywords}, path
        assert not [call for call in asked if name_of(call) in functions], path


def test_the_package_opens_no_listening_socket():
    listeners = {"HTTPServer", "bind", "listen", "create_server", "start_server"}
    for path in PYTHON:
        if "src" in path.parts:
            assert not listeners & {name_of(call) for call in calls(path, *listeners)}, path
