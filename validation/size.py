"""How large the package is: lines by folder, and what makes code hard to follow, counted from its text."""

from __future__ import annotations

import argparse
import ast
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "sunspin"
OTHER_LANGUAGES = {".js": "JavaScript", ".j2": "Jinja", ".css": "CSS", ".toml": "TOML"}
VAGUE = frozenset({"found", "one", "told", "made"})
"""Names of variables that do not say what they hold."""


@dataclass(frozen=True)
class Size:
    """Counts of a folder's Python files.

    `single_caller`: functions whose name is used exactly once in the package. Functions that users call are left out: exported
    names, decorated functions such as commands and properties, names with two underscores. `repeated_classes`: names of classes
    that occur more than once in the package. `constants`: upper-case names that a module assigns. `vague_names`: uses of names in
    `VAGUE` for variables and parameters.
    """

    files: int = 0
    lines: int = 0
    functions: int = 0
    single_caller: int = 0
    classes: int = 0
    repeated_classes: int = 0
    constants: int = 0
    vague_names: int = 0
    skipped_formatting: int = 0


Function = ast.FunctionDef | ast.AsyncFunctionDef


@cache
def measure_folders(source: Path = SOURCE) -> dict[str, Size]:
    """Return the size of each folder of the package, of its own files as ".", and of the whole as "src"."""
    texts = {path: path.read_text("utf-8") for path in sorted(source.rglob("*.py"))}
    trees = {path: ast.parse(text) for path, text in texts.items()}
    nodes = {path: list(ast.walk(tree)) for path, tree in trees.items()}
    uses = Counter(name for each in nodes.values() for name in _used(each))
    class_names = Counter(
        n.name for each in nodes.values() for n in each if isinstance(n, ast.ClassDef)
    )
    public = _public(trees.get(source / "__init__.py"))

    def size(paths: list[Path]) -> Size:
        """Return the size of these files together."""
        inside = [node for path in paths for node in nodes[path]]
        functions = [node for node in inside if isinstance(node, Function)]
        classes = [node.name for node in inside if isinstance(node, ast.ClassDef)]
        return Size(
            files=len(paths),
            lines=sum(texts[path].count("\n") for path in paths),
            functions=len(functions),
            single_caller=sum(
                uses[f.name] == 1 and not _called_by_users(f, public) for f in functions
            ),
            classes=len(classes),
            repeated_classes=len({name for name in classes if class_names[name] > 1}),
            constants=sum(len(set(_constants(trees[path]))) for path in paths),
            vague_names=sum(_is_vague(node) for node in inside),
            skipped_formatting=sum(texts[path].count("# fmt: ") for path in paths),
        )

    by_folder: dict[str, list[Path]] = {}
    for path in texts:
        parts = path.relative_to(source).parts
        by_folder.setdefault(parts[0] if len(parts) > 1 else ".", []).append(path)
    return {name: size(paths) for name, paths in sorted(by_folder.items())} | {
        "src": size(list(texts))
    }


def count_lines(folder: Path) -> int:
    """Return the number of lines of Python in a folder."""
    return sum(path.read_text("utf-8").count("\n") for path in folder.rglob("*.py"))


def lines_by_language(source: Path = SOURCE) -> dict[str, int]:
    """Return the number of lines in each language other than Python."""
    lines = dict.fromkeys(OTHER_LANGUAGES.values(), 0)
    for path in source.rglob("*"):
        if path.suffix in OTHER_LANGUAGES:
            lines[OTHER_LANGUAGES[path.suffix]] += path.read_text("utf-8").count("\n")
    return lines


def count_everything() -> dict[str, dict[str, int]]:
    """Return counts by table: lines of each folder, counts over the whole package, lines of other languages."""
    by_folder = measure_folders()
    whole = by_folder["src"]
    lines = {name: size.lines for name, size in by_folder.items() if name != "."}
    lines["tests"] = count_lines(ROOT / "tests")
    lines["validation, studies, bench"] = sum(
        count_lines(ROOT / name) for name in ("validation", "studies", "bench")
    )
    package = {
        field.name: getattr(whole, field.name) for field in fields(Size) if field.name != "lines"
    }
    return {"lines": lines, "package": package, "languages": lines_by_language()}


def table() -> str:
    """Return all counts as text: a line for each folder, then those of the whole package."""
    names = [field.name for field in fields(Size)]
    rows = [["folder", *names]]
    rows += [
        [folder, *(str(getattr(size, name)) for name in names)]
        for folder, size in measure_folders().items()
    ]
    rows += [[], ["counted", "now"]]
    rows += [
        [name, str(value)]
        for values in count_everything().values()
        for name, value in values.items()
    ]
    # widths of the first column and of all others
    first_width = max(len(cell) for row in rows for cell in row[:1])
    width = max(len(cell) for row in rows for cell in row[1:])
    lines = []
    for row in rows:
        cells = "".join(f"{cell:>{width + 2}}" for cell in row[1:])
        lines.append(f"{row[0]:<{first_width}}{cells}" if row else "")
    return "\n".join(lines)


def _used(nodes: list[ast.AST]) -> Iterator[str]:
    """Yield each name that is read, as a variable or an attribute."""
    for node in nodes:
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            yield node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
            yield node.attr


def _called_by_users(function: Function, public: set[str]) -> bool:
    """Return whether a function is called from outside: it is public, decorated or a special method."""
    return (
        function.name in public or bool(function.decorator_list) or function.name.startswith("__")
    )


def _public(init: ast.Module | None) -> set[str]:
    """Return the names that the package exports: `sunspin/__init__.py` imports each of them for type checkers."""
    return {
        alias.asname or alias.name
        for node in (ast.walk(init) if init is not None else ())
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }


def _constants(tree: ast.Module) -> Iterator[str]:
    """Yield the upper-case names that a module assigns."""
    for node in tree.body:
        targets: list[ast.expr] = []
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AnnAssign):
            targets = [node.target]
        for target in targets:
            for name in ast.walk(target):
                if isinstance(name, ast.Name) and name.id.isupper():
                    yield name.id


def _is_vague(node: ast.AST) -> bool:
    """Return whether a node is a variable or parameter named as in `VAGUE`."""
    if isinstance(node, ast.Name):
        return node.id in VAGUE
    return isinstance(node, ast.arg) and node.arg in VAGUE


def options(parser: argparse.ArgumentParser) -> None:
    """Add no options."""


def main(_: argparse.Namespace) -> int:
    """Print the counts."""
    print(table())
    return 0
