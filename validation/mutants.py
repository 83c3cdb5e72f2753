"""Wrong on purpose: the physics core with one operator, sign, comparison or number changed, and the tests that should see it."""

from __future__ import annotations

import argparse
import ast
import copy
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

ROOT = Path(__file__).parents[1]
LIMIT_S = 400.0
"""A mutant whose tests take longer counts as seen: it hangs."""

MODULES = {
    "dynamics/gyrostat.py": (
        "tests/dynamics/test_propagate.py",
        "tests/dynamics/test_torques.py",
        "tests/dynamics/test_impact.py",
        "tests/test_properties.py",
        "tests/dynamics/test_ensemble.py",
        "tests/dynamics/test_ensemble_outputs.py",
    ),
    "estimate/scan/histogram.py": ("tests/estimate/test_histogram.py",),
    "telemetry/sun.py": ("tests/telemetry/test_sun.py", "tests/telemetry/test_sun_statistics.py"),
}
"""File of the package -> the tests that are to see its mutants, quick ones first."""

ARITHMETIC = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
}
COMPARED = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
}


@dataclass(frozen=True)
class Mutant:
    """A change: which of the file's possible ones, where, what was there, what is now, and the whole text."""

    file: str
    number: int
    line: int
    before: str
    after: str
    text: str


def mutants(file: str, text: str) -> Iterator[Mutant]:
    """All of a file's, in their order."""
    tree = ast.parse(text)
    places = list(_places(tree))
    for number in range(len(places)):
        changed = copy.deepcopy(tree)
        node, change = list(_places(changed))[number]
        before = ast.unparse(node)
        change()
        yield Mutant(
            file, number, node.lineno, before, ast.unparse(node), ast.unparse(changed) + "\n"
        )


def _places(tree: ast.Module) -> Iterator[tuple[ast.AST, Callable[[], object]]]:
    """What can be changed, with the function that changes it in place."""
    for node in _computing(tree):
        match node:
            case ast.BinOp(op=op) | ast.AugAssign(op=op) if type(op) in ARITHMETIC:
                yield node, partial(setattr, node, "op", ARITHMETIC[type(op)]())
            case ast.Compare(ops=[op, *others]) if type(op) in COMPARED:
                yield node, partial(setattr, node, "ops", [COMPARED[type(op)](), *others])
            case ast.UnaryOp(op=ast.USub()):
                yield node, partial(setattr, node, "op", ast.UAdd())
            case ast.UnaryOp(op=ast.Invert(), operand=inside):  # what was left out is taken
                yield node, partial(setattr, node, "operand", ast.UnaryOp(ast.Invert(), inside))
            case ast.BoolOp(op=op):
                other = ast.Or() if isinstance(op, ast.And) else ast.And()
                yield node, partial(setattr, node, "op", other)
            case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                yield node, partial(setattr, node, "value", value + 1)


def _computing(tree: ast.AST) -> Iterator[ast.AST]:
    """Nodes that compute: annotations, docstrings and class bodies of codes left out."""
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list"):
            continue
        for node in value if isinstance(value, list) else [value]:
            if isinstance(node, ast.AST) and not (isinstance(node, ast.ClassDef) and node.bases):
                yield node
                yield from _computing(node)


def is_seen(mutant: Mutant, home: Path) -> bool:
    """Whether the tests fail on a copy of the package with this change."""
    source = home / "src"
    if not source.exists():
        shutil.copytree(ROOT / "src", source, ignore=shutil.ignore_patterns("__pycache__"))
    target = source / "sunspin" / mutant.file
    whole = target.read_text("utf-8")
    target.write_text(mutant.text, "utf-8")
    environment = os.environ | {
        "PYTHONPATH": str(source),
        "SUNSPIN_CACHE": str(home / "kernels"),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    options = ["-q", "-x", "-m", "not slow", "-p", "no:cacheprovider"]
    command = [sys.executable, "-m", "pytest", *options, *MODULES[mutant.file]]
    try:
        done = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, timeout=LIMIT_S
        )
    except subprocess.TimeoutExpired:
        return True
    finally:
        target.write_text(whole, "utf-8")
    return done.returncode != 0


def drawn(file: str, count: int, seed: int) -> list[Mutant]:
    """So many of a file's mutants, by chance; all of them if there are no more."""
    every = list(mutants(file, (ROOT / "src" / "sunspin" / file).read_text("utf-8")))
    chosen = random.Random(f"{seed} {file}").sample(every, min(count, len(every)))
    return sorted(chosen, key=lambda mutant: mutant.number)


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--n", type=int, default=25, help="mutants of each file")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=list(MODULES))


def main(given: argparse.Namespace) -> int:
    """Print each mutant that no test sees; one if there is any."""
    survivors = 0
    for file in MODULES if given.only is None else (given.only,):
        chosen = drawn(file, given.n, given.seed)
        with tempfile.TemporaryDirectory(prefix="validation-") as home:
            unseen = [mutant for mutant in chosen if not is_seen(mutant, Path(home))]
        for mutant in unseen:
            print(f"{file}, line {mutant.line}: {mutant.before}  ->  {mutant.after}")
        print(f"{file}: {len(chosen)} mutants, {len(unseen)} survived", flush=True)
        survivors += len(unseen)
    return int(bool(survivors))
