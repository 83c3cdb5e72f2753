"""The form of a result, which output and the paper's study read by a stored list."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

KINDS = {str: "text", int: "integer", float: "number", list: "list"}
STORED = Path(__file__).parents[1] / "estimate"


def schema(result: xr.Dataset | xr.DataTree, group: str = "") -> list[str]:
    """Return a line for each variable (kind, dimensions, attributes) and each attribute, and those of all groups of a tree."""
    lines = []
    for name, part in sorted(result.variables.items()):
        about = "".join(f"; {key} = {value}" for key, value in sorted(part.attrs.items()))
        lines.append(f"{group}{name}: {part.dtype.kind} ({', '.join(map(str, part.dims))}){about}")
    for name, value in sorted(result.attrs.items()):
        kind = next(word for kind, word in KINDS.items() if isinstance(value, kind))
        lines.append(f"{group}attribute {name}: {kind}")
    for name, part in sorted(getattr(result, "children", {}).items()):
        lines += schema(part, f"{group}{name}/")
    return lines


def stored_schema(of: str) -> list[str]:
    """Return the stored lines of the result of "rates" or "posterior"."""
    return (STORED / f"schema_{of}.txt").read_text("utf-8").splitlines()
