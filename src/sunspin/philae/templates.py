"""What the rows of the paper say: `rows.toml` of the case, one table a row, whose texts are filled with the numbers of a run.

A text may name fields in braces, with a format as in Python: `{share:.1%}`; `{paper[emd_min]}` is a published figure, and the
row's own values have their names (`{tolerance:g}`). What is computed, and which of several notes a row has, stays in Python.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from string import Formatter
from typing import Any

from sunspin.base.errors import InputError
from sunspin.base.untrusted import read_toml
from sunspin.telemetry.case import Case

TEXTS = ("what", "unit", "place", "note")
VALUES = {
    "published": object,
    "kind": str,
    "chain": str,
    "tolerance": (int, float, list),
    "at_most": (int, float),
    "input": bool,
}
"""Key of a table that is no text -> what it may be; `published` is a text to be filled if it is one."""

NOTE = re.compile(r"note(_[a-z]+)?")
"""Keys of notes: a row may have several to choose from, `note_open` beside `note`."""


@dataclass(frozen=True)
class Template:
    """One table: `texts` by key, `values` by key, `needs`: the fields that the texts name, `where` for messages."""

    texts: Mapping[str, str]
    values: Mapping[str, Any]
    needs: frozenset[str]
    where: str

    def fill(self, key: str, fields: Mapping[str, Any]) -> str:
        """A text with its fields; an `InputError` names a field that is not given or does not take its format."""
        try:
            return self.texts[key].format_map(fields)
        except (KeyError, IndexError, ValueError, TypeError, AttributeError) as error:
            raise InputError(
                f"the row's {key} cannot be filled ({error!r})", where=self.where
            ) from None


def templates(case: Case) -> Mapping[str, Template]:
    """The case's templates, by name; read once."""
    return _read(case.folder / "rows.toml")


@cache
def _read(path: Path) -> Mapping[str, Template]:
    return parse_templates(path.read_text("utf-8"), str(path))


def parse_templates(text: str, where: str) -> Mapping[str, Template]:
    """Read the text of a `rows.toml`; `where` names the file in messages."""
    tables = read_toml(text, where, InputError)
    return {name: _template(table, f"{where}, {name}") for name, table in tables.items()}


def _template(table: Any, where: str) -> Template:
    if not isinstance(table, dict):
        raise InputError("a row is a table of texts and values", got=table, where=where)
    texts, values = {}, {}
    for key, value in table.items():
        if key in TEXTS or NOTE.fullmatch(key) or (key == "published" and isinstance(value, str)):
            texts[key] = value
        elif key in VALUES:
            values[key] = value
        else:
            raise InputError(
                "a row has no such key",
                got=key,
                do=f"known: {', '.join((*TEXTS, *VALUES))}",
                where=where,
            )
        if not isinstance(value, str if key in texts else VALUES[key]) or value == "":
            raise InputError(f"{key} is not of the kind that it has to be", got=value, where=where)
    return Template(texts, values, _fields(texts, where), where)


def _fields(texts: Mapping[str, str], where: str) -> frozenset[str]:
    """Names of the fields that texts use, without what is taken of them."""
    try:
        named = [
            name
            for text in texts.values()
            for _, name, _, _ in Formatter().parse(text)
            if name is not None
        ]
    except ValueError as error:
        raise InputError(f"braces do not enclose a field ({error})", where=where) from None
    return frozenset(re.split(r"[.\[]", name)[0] for name in named)
