"""Rules of the code that only its text shows: each generator has a seed, nothing reads pickles, nothing listens."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[1]
PARTS = ("src", "tests", "validation", "studies", "bench")
GENERATORS = {"default_rng", "RandomState", "Random"}
PICKLING = {"pickle", "marshal", "shelve", "dill", "joblib", "cloudpickle"}
UNPICKLING = {"read_pickle", "to_pickle", "full_load", "unsafe_load"}
LISTENERS = {"HTTPServer", "bind", "listen", "create_server", "start_server"}


def trees(*parts: str, words: set[str]):
    """Yield path and syntax tree of each file that has one of these words: others need not be parsed for them."""
    for part in parts:
        for path in sorted((ROOT / part).rglob("*.py")):
            text = path.read_text("utf-8")
            if any(word in text for word in words):
                yield path, ast.parse(text)


def calls(tree: ast.AST) -> list[ast.Call]:
    return [node for node in ast.walk(tree) if isinstance(node, ast.Call)]


def name_of(call: ast.Call) -> str:
    return getattr(call.func, "attr", getattr(call.func, "id", ""))


def test_every_generator_has_a_seed():
    """No module draws when it is imported: of a generator that all share the draws would depend on who drew before."""
    drawn = GENERATORS | {"SeedSequence", "seed"}
    for path, tree in trees(*PARTS, words=drawn):
        for call in calls(tree):
            assert call.args or name_of(call) not in GENERATORS, f"{path}:{call.lineno}"
        for node in tree.body:
            if not isinstance(node, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef):
                found = [call for call in calls(node) if name_of(call) in drawn]
                seeded = [call for call in found if not call.args]
                assert not (found if "src" in path.parts else seeded), f"{path}:{node.lineno}"


def test_the_package_reads_and_writes_no_pickles_and_opens_no_listening_socket():
    """No module of the package imports pickle or the like, and NumPy is never allowed to read one."""
    for path, tree in trees("src", words=PICKLING | UNPICKLING | LISTENERS):
        nodes = list(ast.walk(tree))
        imports = (node for node in nodes if isinstance(node, ast.Import))
        names = {alias.name.split(".")[0] for node in imports for alias in node.names}
        others = (node for node in nodes if isinstance(node, ast.ImportFrom))
        names |= {(node.module or "").split(".")[0] for node in others}
        assert not names & PICKLING, path
        called = calls(tree)
        assert "allow_pickle" not in {k.arg for call in called for k in call.keywords}, path
        assert not (UNPICKLING | LISTENERS) & {name_of(call) for call in called}, path
