"""Rows of a JSON file as text cells: JSON lines (an object a row), a list of objects, or a page of SatNOGS DB's interface.

Columns are named by their keys; what lies inside of another object or list has both names with a point between (`sun.0`,
`decoded.eps.u_bat`). A text that holds an object itself, as the field `decoded` of SatNOGS, is read as that object.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pandas as pd

from sunspin.base.errors import TelemetryError

DEEPEST = 8
"""Objects inside of each other; no telemetry has more."""

PAGE = "results"
"""Key under which a page of SatNOGS DB has its rows."""


def json_rows(text: str, where: str, most_columns: int, most_cells: int) -> pd.DataFrame:
    """Cells (empty where a row has no such key), indexed by the line of each row; columns in the order in which they come."""
    rows: list[dict[str, str]] = []
    lines: list[int] = []
    names: dict[str, None] = {}
    for line, item in _objects(text, where):
        at = f"{where}, line {line}"
        if not isinstance(item, dict):
            what = "a row of a JSON file must be an object"
            raise TelemetryError(what, got=str(item)[:60], where=at)
        rows.append(dict(_cells(item, "", at, 0)))
        lines.append(line)
        names.update(dict.fromkeys(rows[-1]))
        if len(names) > most_columns:
            what = f"the file has more than {most_columns} columns"
            raise TelemetryError(what, where=at)
        if len(rows) * len(names) > most_cells:
            what = f"the file has more than {most_cells:.0e} cells"
            raise TelemetryError(what, do="cut it into parts", where=at)
    cells = [[row.get(name, "") for name in names] for row in rows]
    return pd.DataFrame(cells, lines, list(names), dtype=object)


def _objects(text: str, where: str) -> Iterator[tuple[int, Any]]:
    """The rows, each with its line: all lines of a file, or what one list or page holds, counted from one."""
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    first = lines[0][1].strip()
    whole = not (first[0] == "{" and first[-1] == "}")  # else each line is an object by itself
    if whole:
        lines = [(1, text)]
    for number, line in lines:
        try:
            item = json.loads(line, object_pairs_hook=_once)
        except json.JSONDecodeError as error:
            what, at = (
                f"this is not valid JSON ({error.msg})",
                f"{where}, line {number + error.lineno - 1}",
            )
            raise TelemetryError(what, do="one object a line", where=at) from None
        except RecursionError:
            what = "the file is nested too deeply to be telemetry"
            raise TelemetryError(what, where=where) from None
        except ValueError as error:  # a key twice, or a whole number of thousands of digits
            what, at = f"this JSON cannot be read ({str(error)[:100]})", f"{where}, line {number}"
            raise TelemetryError(what, where=at) from None
        page = item.get(PAGE) if isinstance(item, dict) else item if whole else None
        yield from enumerate(page, 1) if isinstance(page, list) else [(number, item)]


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(dict(pairs)) < len(pairs):
        raise ValueError("a key stands twice in an object")
    return dict(pairs)


def _cells(item: Any, name: str, where: str, depth: int) -> Iterator[tuple[str, str]]:
    if depth > DEEPEST:
        what = f"objects lie more than {DEEPEST} deep in each other"
        raise TelemetryError(what, where=where)
    if isinstance(item, str) and item[:1] == "{" and item[-1:] == "}":
        try:
            item = json.loads(item, object_pairs_hook=_once)
        except (ValueError, RecursionError):
            pass  # a text that only looks like an object stays a text
    if isinstance(item, dict | list):
        for key, value in item.items() if isinstance(item, dict) else enumerate(item):
            inner = f"{name}.{key}" if name else str(key).strip()
            yield from _cells(value, inner, where, depth + 1)
    else:
        yield name, "" if item is None else str(int(item) if isinstance(item, bool) else item)
