"""Python files of the repository as syntax trees, each parsed once for all tests that look at them.

Most rules concern a few names: files whose text has none of them are not parsed for it.
"""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]


@cache
def text(path: Path) -> str:
    return path.read_text("utf-8")


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(text(path))


def has(path: Path, *words: str) -> bool:
    """Does the file have one of these words?"""
    return any(word in text(path) for word in words)


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    """All nodes of a file."""
    return tuple(ast.walk(tree(path)))


def nodes_if(path: Path, *words: str) -> tuple[ast.AST, ...]:
    """All nodes of a file that has one of these words, else none."""
    return nodes(path) if has(path, *words) else ()
