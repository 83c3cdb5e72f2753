"""Rows of a JSON file as text cells: JSON lines (an object a row), a list of objects, or a page of SatNOGS DB's interface.

Columns are named by their keys; what lies inside of another object or list has both names with a point between (`sun.0`,
`decoded.eps.u_bat`). A text that holds an object itself, as the field `decoded` of SatNOGS, is read as that object.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from sunspin.base.errors import TelemetryError, sentence

DEEPEST = 8
"""Objects inside of each other; no telemetry has more."""

PAGE = "results"
"""Key under which a page of SatNOGS DB has its rows."""


def json_rows(
    text: str, where: str, most_columns: int, most_cells: int
) -> tuple[list[str], list[list[str]], list[int]]:
    """Names of the columns in the order in which they come, cells (empty where a row has no such key), the line of each row."""
    rows: list[dict[str, str]] = []
    lines: list[int] = []
    names: dict[str, int] = {}
    for line, item in _objects(text, where):
        at = f"{where}, line {line}"
        if not isinstance(item, dict):
            raise TelemetryError(
                sentence("a row of a JSON file must be an object", got=str(item)[:60], where=at)
            )
        row = dict(_cells(item, "", at, 0))
        for name in row:
            names.setdefault(name, len(names))
        if len(names) > most_columns:
            raise TelemetryError(
                sentence(f"the file has more than {most_columns} columns", where=at)
            )
        rows.append(row)
        lines.append(line)
    if not rows or not names:
        raise TelemetryError(sentence("the file holds no samples", where=where))
    if len(rows) * len(names) > most_cells:
        what, got = (
            f"the file has more than {most_cells:.0e} cells",
            f"{len(rows)} rows of {len(names)}",
        )
        raise TelemetryError(sentence(what, got=got, do="cut it into parts", where=where))
    return list(names), [[row.get(name, "") for name in names] for row in rows], lines


def _objects(text: str, where: str) -> Iterator[tuple[int, Any]]:
    """The rows, each with its line: all lines of a file, or what one list or page holds, counted from one."""
    begins = text.lstrip()
    first = begins.splitlines()[0].strip()
    if begins.startswith("{") and _whole(first):
        for number, line in enumerate(text.splitlines(), 1):
            if line.strip():
                item = _parsed(line, f"{where}, line {number}")
                rows = item.get(PAGE) if isinstance(item, dict) else None
                yield from [(number, item)] if not isinstance(rows, list) else enumerate(rows, 1)
        return
    item = _parsed(text, where)
    rows = item.get(PAGE) if isinstance(item, dict) else item
    yield from enumerate(rows, 1) if isinstance(rows, list) else [(1, item)]


def _whole(line: str) -> bool:
    """Whether a line is an object by itself; what is damaged elsewhere shall be named with its line."""
    return line.endswith("}")


def _parsed(text: str, where: str) -> Any:
    try:
        return json.loads(text, object_pairs_hook=_once)
    except json.JSONDecodeError as error:
        place = where if ", line " in where else f"{where}, line {error.lineno}"
        raise TelemetryError(
            sentence(f"this is not valid JSON ({error.msg})", do="one object a line", where=place)
        ) from None
    except RecursionError:
        raise TelemetryError(
            sentence("the file is nested too deeply to be telemetry", where=where)
        ) from None
    except ValueError as error:  # a key twice, or a whole number of thousands of digits
        raise TelemetryError(
            sentence(f"this JSON cannot be read ({str(error)[:100]})", where=where)
        ) from None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a key stands twice in an object")
    return found


def _cells(item: Any, name: str, where: str, depth: int) -> Iterator[tuple[str, str]]:
    if depth > DEEPEST:
        raise TelemetryError(
            sentence(f"objects lie more than {DEEPEST} deep in each other", where=where)
        )
    if isinstance(item, str) and item[:1] == "{" and item[-1:] == "}":
        try:
            item = json.loads(item, object_pairs_hook=_once)
        except (ValueError, RecursionError):
            pass  # a text that only looks like an object stays a text
    if isinstance(item, dict | list):
        for key, value in item.items() if isinstance(item, dict) else enumerate(item):
            yield from _cells(
                value, f"{name}.{key}" if name else str(key).strip(), where, depth + 1
            )
    else:
        yield name, _text(item)


def _text(item: Any) -> str:
    if item is None:
        return ""
    return str(int(item)) if isinstance(item, bool) else str(item)
