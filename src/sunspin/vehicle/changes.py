"""Changing values by their keys: ``wheel.speed_rad_s=833``, ``body.inertia_kg_m2[2][2]*=0.9``, ``wheel.friction=printed``.

A change alters the parsed TOML of a vehicle file, or of a study's assumptions (:mod:`sunspin.vehicle.assumptions`), before it is
validated: the reader of that file says what is wrong with a key or a value.
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

STEP = r"(?>(?:[^.\[\]\s=*+]|\+(?!=))+|\[[^\]]*\])"  # taken whole: a long text without "=" would be split in every way
CHANGE = re.compile(rf"\s*((?!\[)(?:{STEP})(?:\.?(?:{STEP}))*?)\s*([*+]?=)\s*(\S.*?)\s*", re.DOTALL)
UNIT = re.compile(r"(?:_(?:per|kg|rad|deg|N|W|A|T|C|K|m2|m|s2|s))+$")
COEFFICIENTS = ("coulomb_N_m", "viscous_N_m_s")
LIST_HINT = "`--set list` shows all"
MAX_SHOWN = 60
"""Characters of a value in a list or a sentence."""


class Change(NamedTuple):
    """One change: key, "=", "*=" or "+=", and a number, a text, or lists and tables of these."""

    key: str
    operator: str
    value: Any

    def __str__(self) -> str:
        plain = isinstance(self.value, str) and parse_value(self.value) == self.value
        value = self.value if plain else json.dumps(self.value, default=str)
        return f"{self.key}{self.operator}{value}"


class Setting(NamedTuple):
    """What can be set, or was set: its key, value (None: not set), unit, source, and the value that it `was`."""

    key: str
    value: Any
    unit: str
    source: str
    was: Any = None

    def __str__(self) -> str:
        now, before = (
            f"{format_value(value)} {self.unit}".strip() for value in (self.value, self.was)
        )
        return f"{self.key} = {now} (was {before}{f'; {self.source}' if self.source else ''})"


Changes = Mapping[str, Any] | Iterable[str | Change] | None
"""Changes as users give them: {"wheel.speed_rad_s": 833, "body.mass_kg": "*=0.9"}, or texts as on the command line."""


def parse_changes(given: Changes) -> tuple[Change, ...]:
    """Changes from what a user gives; `InputError` for a text that is none."""
    texts = [given] if isinstance(given, str) else list(map(str, given or ()))
    if isinstance(given, Mapping):
        for k, value in enumerate(given.values()):
            if isinstance(value, str):
                texts[k] += value if value.startswith(("*=", "+=")) else f"={value}"
            else:
                value = value.tolist() if hasattr(value, "tolist") else value
                texts[k] += str(Change("", "=", value))
    changes = []
    for text in texts:
        match = CHANGE.fullmatch(text)
        if match is None:
            do = "write KEY=VALUE, KEY*=FACTOR or KEY+=STEP, for example wheel.speed_rad_s=833"
            raise InputError("this is not a valid change of a value", got=text, do=do)
        changes.append(Change(match[1], match[2], parse_value(match[3])))
    return tuple(changes)


def parse_value(text: str) -> Any:
    """A value in JSON, which of numbers and lists is also TOML's; anything else is a text without its quotes."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        number = plain_number(text)
        return text if math.isnan(number) else number


def apply_changes(table: dict[str, Any], changes: Iterable[Change]) -> tuple[Setting, ...]:
    """Change a parsed file; what each change did, without those that leave a value as it was.

    The source of a changed value says so. An element of an inertia tensor sets the symmetric one too.
    """
    done: dict[str, Setting] = {}
    for key, operator, value in changes:
        path = find_path(table, key)
        if isinstance(value, dict) and path[-1][1] == "value":
            path.pop()  # a value with its sigma and source
        holder, field = path[-1]
        old = holder.get(field) if isinstance(holder, dict) else holder[field]
        new = value if operator == "=" else _scale_or_add(old, operator, value, key)
        if field == "friction" and isinstance(value, str):
            laws = holder.get("alternative_frictions")
            new = laws.get(value, value) if isinstance(laws, dict) else value
        certificate = next((node for node, step in path if step == "value"), {})
        source = str(certificate.get("source", ""))
        first = done.get(key, Setting(key, value, unit_from_key(key), source, old))
        done[key] = first._replace(value=value if operator == "=" else new)
        if certificate and new != old and not source.startswith("set for this run"):
            was = f"set for this run; was {format_value(certificate['value'])}"
            certificate["source"] = f"{was}, {source}" if source else was
        holder[field] = new
        if "inertia_kg_m2" in key and isinstance(field, int) and isinstance(path[-2][1], int):
            rows, row = path[-2]
            if field < len(rows) and isinstance(rows[field], list) and row < len(rows[field]):
                rows[field][row] = new
    return tuple(each for each in done.values() if each.value != each.was)


def find_path(table: dict[str, Any], key: str) -> list[tuple[Any, Any]]:
    """The tables and lists on the way to a value, each with the key or index that leads on; absent tables are added."""
    path: list[tuple[Any, Any]] = []
    node: Any = table

    def enter(step: str | int) -> None:
        nonlocal node
        path.append((node, step))
        node = node.get(step) if isinstance(node, dict) else node[step]

    for step in re.findall(STEP, key):
        index = step[1:-1].strip() if step[0] == "[" else None
        if index is not None and is_value_table(node):
            enter("value")
        if isinstance(node, list):
            names = [str(each.get("name")) if isinstance(each, dict) else "" for each in node]
            known = ", ".join(names) if any(names) else f"0 to {len(node) - 1}"
            if index is None and len(node) > 1:
                what, do = f"there are {len(node)} of these", f"say which in brackets: {known}"
                raise InputError(what, got=key, do=do)
            index = "0" if index is None else index
            places = [*filter(None, names), *map(str, range(len(node)))]
            if index not in places:
                what = f"there is no [{index}] here"
                raise InputError(what, got=key, do=f"known: {known}")
            enter(names.index(index) if index in names else int(index))
            if step[0] == "[":
                continue
        if node is None:
            holder, field = path[-1]
            holder[field] = {}
            node = holder[field]
        if not isinstance(node, dict) or step[0] == "[":
            raise InputError("there is nothing to set by this key", got=key, do=LIST_HINT)
        if step == "gain":
            step = next((name for name in GAIN_UNITS if name in node), step)
        if step in COEFFICIENTS and "spin_down" in node and path:
            _replace_spin_down(node, path[-1][0])
        enter(step)
    if is_value_table(node):
        enter("value")
    return path


def _replace_spin_down(friction: dict[str, Any], wheel: dict[str, Any]) -> None:
    """Put coefficients in the place of a measured spin-down, so that one of them can be changed."""
    try:
        law = {name: float(bare_value(value)) for name, value in friction["spin_down"].items()}
        fit = Friction.from_spin_down(
            **law, inertia_kg_m2=float(bare_value(wheel["inertia_kg_m2"]))
        )
    except (AttributeError, KeyError, TypeError, ValueError):
        return  # the reader of the file says what is wrong with it
    friction.clear()
    for name in COEFFICIENTS:
        friction[name] = {"value": getattr(fit, name), "source": "from the measured spin-down"}


def _scale_or_add(old: Any, operator: str, operand: Any, key: str) -> Any:
    """A number, or each number of a list, times a factor or plus a step."""
    if isinstance(old, list):
        return [_scale_or_add(each, operator, operand, key) for each in old]
    numbers = [x for x in (old, operand) if isinstance(x, int | float) and abs(x) <= LARGEST]
    if len(numbers) < 2 or any(isinstance(x, bool) for x in numbers):
        got = f"{format_value(old)} {operator} {format_value(operand)}"
        raise InputError(f"{operator} needs numbers", got=got, where=key)
    return old * operand if operator == "*=" else old + operand


def is_value_table(node: Any) -> bool:
    return isinstance(node, dict) and "value" in node


def bare_value(node: Any) -> Any:
    """A value without its certificate."""
    return node["value"] if is_value_table(node) else node


def list_settings(table: Mapping[str, Any], kind: Any, path: str = "") -> Iterator[Setting]:
    """All that can be set: what a file holds, and what it leaves out of the tables that it has (value None).

    `kind` is the part that the table describes; None: only what it holds.
    """
    known = {} if kind is None or "spin_down" in table else keys_of(kind)
    for key in dict.fromkeys((*table, *known)):
        at, within = f"{path}{key}", part_in(known.get(key))
        item: Any = table.get(key)
        if key in ("name", "description", "source"):
            continue
        if key == "alternative_frictions" and item:
            laws = f"other laws in the file: {', '.join(item)}"
            yield Setting(f"{path}friction", "as below", "", laws)
            within = None
        if is_value_table(item):
            yield Setting(at, item["value"], unit_from_key(at), str(item.get("source", "")))
        elif isinstance(item, dict):
            yield from list_settings(item, within, f"{at}.")
        elif isinstance(item, list) and item and all(isinstance(each, dict) for each in item):
            for each in item:
                name = at if len(item) == 1 else f"{at}[{each.get('name')}]"
                yield from list_settings(each, within, f"{name}.")
        elif key in table:
            yield Setting(at, item, unit_from_key(at), "")
        elif within is None and key not in GAIN_UNITS:
            yield Setting(at, None, unit_from_key(at), "not in the file")
        elif at.startswith("panel_response"):  # of panels that stand as drawn there is no table
            yield from list_settings({}, within, f"{at}.")


def unit_from_key(key: str) -> str:
    """The unit that a key ends in; "" where it names none."""
    match = UNIT.search(re.sub(r"\[[^\]]*\]", "", key))
    text = match[0][1:].replace("_", " ") if match else ""
    return re.sub(r"^(rad|m) (s2?)$", r"\1/\2", re.sub(r"^per ", "1/", text)).replace("C", "deg C")


def format_value(value: Any) -> str:
    """A value for people, on one short line."""
    if isinstance(value, dict):
        text = ", ".join(f"{key} {format_value(bare_value(item))}" for key, item in value.items())
    elif isinstance(value, list):
        text = f"[{', '.join(map(format_value, value))}]"
    elif isinstance(value, float):
        text = f"{value:.7g}"
    else:
        text = "not set" if value is None else str(value)
    return textwrap.shorten(text, MAX_SHOWN, placeholder=" ...")
