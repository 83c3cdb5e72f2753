"""Changes of values by their keys: ``wheel.speed_rad_s=833``, ``body.inertia_kg_m2[2][2]*=0.9``, ``wheel.friction=printed``.

A change alters the parsed TOML of a vehicle file, or of a study's assumptions (:mod:`sunspin.vehicle.assumptions`). This
happens before validation, so that the reader of that file reports errors in keys and values. Below, a *value table* is
``{value, sigma, source}``, which a file may have in place of a number.
"""

from __future__ import annotations

import json
import math
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from sunspin.base.errors import InputError
from sunspin.base.untrusted import LARGEST, plain_number
from sunspin.vehicle.part import keys_of, part_in
from sunspin.vehicle.parts import GAIN_UNITS, Friction

STEP = r"(?>(?:[^.\[\]\s=*+]|\+(?!=))+|\[[^\]]*\])"
"""A name or an index in brackets of a key. The atomic group keeps the time linear for long texts without "="."""
CHANGE = re.compile(rf"\s*((?!\[)(?:{STEP})(?:\.?(?:{STEP}))*?)\s*([*+]?=)\s*(\S.*?)\s*", re.DOTALL)
"""Key, operator and value of a change."""
UNIT = re.compile(r"(?:_(?:per|kg|rad|deg|N|W|A|T|C|K|m2|m|s2|s))+$")
"""Unit at the end of a key."""
COEFFICIENTS = ("coulomb_N_m", "viscous_N_m_s")
"""Coefficients of a friction law."""
LIST_HINT = "`--set list` shows all"
"""Advice in errors about keys."""
MAX_SHOWN = 60
"""Characters of a value in a list or a message."""


class Change(NamedTuple):
    """A change of a value: its key, the operator "=", "*=" or "+=", and the operand (number, text, list or table)."""

    key: str
    operator: str
    value: Any

    def __str__(self) -> str:
        # a text is written without quotes if it is read back as the same text
        plain = isinstance(self.value, str) and parse_value(self.value) == self.value
        value = self.value if plain else json.dumps(self.value, default=str)
        return f"{self.key}{self.operator}{value}"


class Setting(NamedTuple):
    """A value that can be or was changed: key, value (None: not set), unit, source, and the value before the change."""

    key: str
    value: Any
    unit: str
    source: str
    old_value: Any = None

    def __str__(self) -> str:
        new, old = (
            f"{format_value(value)} {self.unit}".strip() for value in (self.value, self.old_value)
        )
        return f"{self.key} = {new} (was {old}{f'; {self.source}' if self.source else ''})"


Changes = Mapping[str, Any] | Iterable[str | Change] | None
"""Changes as users give them: {"wheel.speed_rad_s": 833, "body.mass_kg": "*=0.9"}, or texts as on the command line."""


def parse_changes(given: Changes) -> tuple[Change, ...]:
    """Return the changes that a user gives, in their order; raise `InputError` for a text that is not a change.

    All forms of `Changes` are first written as texts such as "KEY=VALUE". No changes (None) give an empty tuple.
    """
    if isinstance(given, Mapping):
        texts = []
        for key, value in given.items():
            if isinstance(value, str):
                texts.append(f"{key}{value if value.startswith(('*=', '+=')) else f'={value}'}")
            else:
                plain = value.tolist() if hasattr(value, "tolist") else value  # arrays of NumPy
                texts.append(str(Change(str(key), "=", plain)))
    else:
        texts = [given] if isinstance(given, str) else list(map(str, given or ()))
    changes = []
    for text in texts:
        match = CHANGE.fullmatch(text)
        if match is None:
            do = "write KEY=VALUE, KEY*=FACTOR or KEY+=STEP, for example wheel.speed_rad_s=833"
            raise InputError("this is not a valid change of a value", got=text, do=do)
        changes.append(Change(match[1], match[2], parse_value(match[3])))
    return tuple(changes)


def parse_value(text: str) -> Any:
    """Return a value written in JSON (whose numbers and lists are those of TOML); any other text is returned as it is.

    Numbers that JSON does not accept but TOML does, such as "+1", are read too.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        number = plain_number(text)  # NaN if the text is not a number
        return text if math.isnan(number) else number


def apply_changes(table: dict[str, Any], changes: Iterable[Change]) -> tuple[Setting, ...]:
    """Change a parsed file in place; return a setting for each value that differs from before.

    The source of a changed value says that it was changed. A change of an off-diagonal element of an inertia tensor also sets
    the mirrored element. Several changes of one key give one setting, with the value of the file as the old one.
    """
    settings: dict[str, Setting] = {}  # by key
    for key, operator, operand in changes:
        path = find_path(table, key)
        if isinstance(operand, dict) and path[-1][1] == "value":
            path.pop()  # a new table {value, sigma, source} replaces the whole old one
        holder, field = path[-1]
        old = holder.get(field) if isinstance(holder, dict) else holder[field]
        new = operand if operator == "=" else _scale_or_add(old, operator, operand, key)
        # a friction given by name is one of the wheel's alternative laws
        if field == "friction" and isinstance(operand, str):
            laws = holder.get("alternative_frictions")
            new = laws.get(operand, operand) if isinstance(laws, dict) else operand
        value_table = next((node for node, step in path if step == "value"), {})
        source = str(value_table.get("source", ""))
        first = settings.get(key, Setting(key, operand, unit_from_key(key), source, old))
        # the setting shows what the user gave: the name of a friction law, not its coefficients
        settings[key] = first._replace(value=operand if operator == "=" else new)
        if value_table and new != old and not source.startswith("set for this run"):
            was = f"set for this run; was {format_value(value_table['value'])}"
            value_table["source"] = f"{was}, {source}" if source else was
        holder[field] = new
        if "inertia_kg_m2" in key and isinstance(field, int) and isinstance(path[-2][1], int):
            # the key ends with [row][field]; the tensor may be ragged, as it is not validated yet
            rows, row = path[-2]
            if field < len(rows) and isinstance(rows[field], list) and row < len(rows[field]):
                rows[field][row] = new
    return tuple(each for each in settings.values() if each.value != each.old_value)


def find_path(table: dict[str, Any], key: str) -> list[tuple[Any, Any]]:
    """Return the tables and lists that lead to a value, each with its key or index of the next.

    `key` is written as users do: the index or name of a list's only element may be omitted, "gain" stands for the gain key of
    the panel, and "value" of a value table is implied. `table` changes in two cases: absent tables are added, and a measured
    spin-down is replaced by its coefficients if the key is one of them.

    Raises `InputError` for a key that is ambiguous or leads nowhere.
    """
    path: list[tuple[Any, Any]] = []
    node: Any = table
    for step in re.findall(STEP, key):
        # a step is a key, or an index or name in brackets
        index = step[1:-1].strip() if step[0] == "[" else None
        if index is not None and is_value_table(node):
            node = _extend_path(path, node, "value")
        # in a list: a step in brackets chooses an element; without one a single element is entered for the next key
        if isinstance(node, list):
            names = [str(each.get("name")) if isinstance(each, dict) else "" for each in node]
            known = ", ".join(names) if any(names) else f"0 to {len(node) - 1}"
            if index is None and len(node) > 1:
                what, do = f"there are {len(node)} of these", f"say which in brackets: {known}"
                raise InputError(what, got=key, do=do)
            index = "0" if index is None else index
            choices = [*filter(None, names), *map(str, range(len(node)))]
            if index not in choices:
                what = f"there is no [{index}] here"
                raise InputError(what, got=key, do=f"known: {known}")
            node = _extend_path(path, node, names.index(index) if index in names else int(index))
            if step[0] == "[":
                continue
        if node is None:  # the file lacks this table
            holder, field = path[-1]
            holder[field] = {}
            node = holder[field]
        if not isinstance(node, dict) or step[0] == "[":
            raise InputError("there is nothing to set by this key", got=key, do=LIST_HINT)
        # `gain` means the key that the panel has, and a coefficient can be set in place of a spin-down
        if step == "gain":
            step = next((name for name in GAIN_UNITS if name in node), step)
        if step in COEFFICIENTS and "spin_down" in node and path:
            _replace_spin_down(node, path[-1][0])
        node = _extend_path(path, node, step)
    if is_value_table(node):
        _extend_path(path, node, "value")
    return path


def _extend_path(path: list[tuple[Any, Any]], node: Any, step: str | int) -> Any:
    """Append a table or list and its key or index to `path`, and return what is there; None for an absent key."""
    path.append((node, step))
    return node.get(step) if isinstance(node, dict) else node[step]


def _replace_spin_down(friction: dict[str, Any], wheel: dict[str, Any]) -> None:
    """Replace a measured spin-down in a friction table by its coefficients, so that one of them can be changed.

    A spin-down or wheel that is not valid is left unchanged.
    """
    try:
        curve = {name: float(bare_value(value)) for name, value in friction["spin_down"].items()}
        law = Friction.from_spin_down(
            **curve, inertia_kg_m2=float(bare_value(wheel["inertia_kg_m2"]))
        )
    except (AttributeError, KeyError, TypeError, ValueError):
        return  # the reader of the file reports what is wrong with it
    friction.clear()
    for name in COEFFICIENTS:
        friction[name] = {"value": getattr(law, name), "source": "from the measured spin-down"}


def _scale_or_add(old: Any, operator: str, operand: Any, key: str) -> Any:
    """Return a number, or each number of a list, multiplied by a factor ("*=") or increased by a step ("+=").

    Raises `InputError`, with the `key`, if the old value or the operand is not a number of sensible size.
    """
    if isinstance(old, list):
        return [_scale_or_add(each, operator, operand, key) for each in old]
    # a truth value is an int in Python
    numbers = [x for x in (old, operand) if isinstance(x, int | float) and abs(x) <= LARGEST]
    if len(numbers) < 2 or any(isinstance(x, bool) for x in numbers):
        got = f"{format_value(old)} {operator} {format_value(operand)}"
        raise InputError(f"{operator} needs numbers", got=got, where=key)
    return old * operand if operator == "*=" else old + operand


def is_value_table(node: Any) -> bool:
    """Return whether a node of a parsed file is a table {value, sigma, source}."""
    return isinstance(node, dict) and "value" in node


def bare_value(node: Any) -> Any:
    """Return the value of a value table, any other node unchanged."""
    return node["value"] if is_value_table(node) else node


def list_settings(table: Mapping[str, Any], kind: Any, path: str = "") -> Iterator[Setting]:
    """Yield all settings of a file: those that it contains, and with value None those missing from its tables.

    `path` is written before the keys of `table`. `kind` is the class of part that the table describes; None:
    list only the contents. Names and texts that only describe are left out.
    """
    # a friction given by its spin-down lacks no coefficients
    known = {} if kind is None or "spin_down" in table else keys_of(kind)
    for key in dict.fromkeys((*table, *known)):
        full_key, kind_below = f"{path}{key}", part_in(known.get(key))
        item: Any = table.get(key)
        if key in ("name", "description", "source"):
            continue
        if key == "alternative_frictions" and item:
            # the friction can be set to the name of a law; the laws themselves follow, without their missing keys
            laws = f"other laws in the file: {', '.join(item)}"
            yield Setting(f"{path}friction", "as below", "", laws)
            kind_below = None
        if is_value_table(item):
            yield Setting(
                full_key, item["value"], unit_from_key(full_key), str(item.get("source", ""))
            )
        elif isinstance(item, dict):
            yield from list_settings(item, kind_below, f"{full_key}.")
        elif isinstance(item, list) and item and all(isinstance(each, dict) for each in item):
            for each in item:
                name = full_key if len(item) == 1 else f"{full_key}[{each.get('name')}]"
                yield from list_settings(each, kind_below, f"{name}.")
        elif key in table:
            yield Setting(full_key, item, unit_from_key(full_key), "")
        elif kind_below is None and key not in GAIN_UNITS:  # a panel has only one of the gain keys
            yield Setting(full_key, None, unit_from_key(full_key), "not in the file")
        elif full_key.startswith("panel_response"):  # absent if the panels are aligned as drawn
            yield from list_settings({}, kind_below, f"{full_key}.")


def unit_from_key(key: str) -> str:
    """Return the unit at the end of a key in readable form, such as "rad/s"; "" if there is none.

    A key writes it with underscores: "_rad_s" is "rad/s", "_per_K" is "1/K", "_kg_m2" is "kg m2", "_C" is "deg C".
    """
    match = UNIT.search(re.sub(r"\[[^\]]*\]", "", key))  # without indices in brackets
    text = match[0][1:].replace("_", " ") if match else ""
    text = re.sub(r"^per ", "1/", text)
    return re.sub(r"^(rad|m) (s2?)$", r"\1/\2", text).replace("C", "deg C")


def format_value(value: Any) -> str:
    """Return a value as one line for people, shortened to `MAX_SHOWN` characters; value tables in it lose sigma and source."""
    if isinstance(value, dict):
        text = ", ".join(f"{key} {format_value(bare_value(item))}" for key, item in value.items())
    elif isinstance(value, list):
        text = f"[{', '.join(map(format_value, value))}]"
    elif isinstance(value, float):
        text = f"{value:.7g}"
    else:
        text = "not set" if value is None else str(value)
    return textwrap.shorten(text, MAX_SHOWN, placeholder=" ...")
