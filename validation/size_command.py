"""``python -m validation size``: how large the package is, beside the ceilings of pyproject.toml."""

from __future__ import annotations

import argparse

from validation.size import exceeded, table


def options(parser: argparse.ArgumentParser) -> None:
    """There are none."""


def run(_: argparse.Namespace) -> int:
    """Print the counts; one if any is above its ceiling."""
    print(table())
    sentences = exceeded()
    print("\n".join(sentences))
    return int(bool(sentences))
