"""Changing assumptions by their keys: ``wheel.speed_rad_s=833``, ``body.inertia_kg_m2[2][2]*=0.9``, ``wheel.friction=printed``.

A change alters the parsed TOML of a file before it is validated, so that the file's ranges and sentences hold for it. The file may
be a vehicle's or the assumptions of a study (:mod:`sunspin.vehicle.assumptions`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from typing import Annotated, Any, NamedTuple, TypeGuard, get_args, get_origin

from sunspin.base.errors import InputError, VehicleError, sentence
from sunspin.base.toml import read_toml
from sunspin.base.untrusted import plain_number
from sunspin.vehicle.part import keys_of, part_in
from sunspin.vehicle.parts import GAIN_UNITS, Friction, Wheel

CHANGE = re.compile(r"\s*([^=]+?)\s*([*+]?=)\s*(.*?)\s*", re.DOTALL)
PLACE = re.compile(r"([^.\[\]\s]+)|\[([^\]]*)\]")
KEY = re.compile(r"[^.\[\]\s]+(\[[^\]]*\])*(\.[^.\[\]\s]+(\[[^\]]*\])*)*")

UNITS = (
    ("kg_m2", "kg m2"),
    ("_rad_s2", "rad/s2"),
    ("_rad_s", "rad/s"),
    ("_per_K", "1/K"),
    ("_per_s", "1/s"),
    ("N_m_s", "N m s"),
    ("N_m", "N m"),
    ("m_s", "m/s"),
    ("_kg", "kg"),
    ("_deg", "deg"),
    ("_rad", "rad"),
    ("_W", "W"),
    ("_A", "A"),
    ("_C", "deg C"),
    ("_m", "m"),
    ("_s", "s"),
)
"""End of a key -> the unit that it names."""

SHOWN = 60
"""Characters of a value in a list or a sentence."""

SET = "set for this run"
"""How the source of a changed value begins."""

OF_READINGS = ("telemetry.noise", "telemetry.lit_threshold")
"""Keys whose unit is that of the panels' readings."""

NO_NUMBERS = ("name", "description", "source")


class Change(NamedTuple):
    """One change as it is asked for: key, "=", "*=" or "+=", and a number, nested lists of numbers, a text or a list of texts."""

    key: str
    operator: str
    value: Any

    def __str__(self) -> str:
        return f"{self.key}{self.operator}{self.value if isinstance(self.value, str) else _toml(self.value)}"


class Changed(NamedTuple):
    """One change as it was made: `key`, new `value`, what it `was` (None: not set), `unit`, the `source` of what it was."""

    key: str
    value: Any
    was: Any
    unit: str
    source: str

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        before = "not set" if self.was is None else f"{shown(self.was)}{unit}"
        return f"{self.key} = {shown(self.value)}{unit} (was {before}{f'; {self.source}' if self.source else ''})"


class Setting(NamedTuple):
    """What can be set: its key, value (None: not set), unit and source."""

    key: str
    value: Any
    unit: str
    source: str


Changes = Mapping[str, Any] | Iterable[str | Change] | None
"""Changes as users give them: {"wheel.speed_rad_s": 833, "body.mass_kg": "*=0.9"}, or texts as on the command line."""


def changes_of(given: Changes) -> tuple[Change, ...]:
    """Changes from what a user gives; `InputError` for a text that is none."""
    if given is None:
        return ()
    if isinstance(given, str):
        given = [given]
    if isinstance(given, Mapping):
        return tuple(_entry(str(key), value) for key, value in given.items())
    return tuple(each if isinstance(each, Change) else _read(each) for each in given)


def _entry(key: str, value: Any) -> Change:
    if isinstance(value, str):
        return _read(f"{key}{value}" if value.startswith(("*=", "+=")) else f"{key}={value}")
    return Change(_checked(key), "=", value.tolist() if hasattr(value, "tolist") else value)


def _read(text: str) -> Change:
    found = CHANGE.fullmatch(text)
    if found is None or not found[3]:
        do = "write KEY=VALUE, KEY*=FACTOR or KEY+=STEP, for example wheel.speed_rad_s=833"
        raise InputError(sentence("this is no change of a value", got=text, do=do))
    return Change(_checked(found[1]), found[2], _value(found[3]))


def _checked(key: str) -> str:
    if KEY.fullmatch(key) is None:
        do = "write table.key, table[name].key or table.key[0][1]"
        raise InputError(sentence("this is no key of a value", got=key, do=do))
    return key


def _value(text: str) -> Any:
    """A value as TOML writes it; what is none is taken for a text without its quotes."""
    try:
        read = read_toml(f"x = {text}", "the value", InputError)
    except InputError:
        return text
    if set(read) != {"x"}:  # a second line would be another key, of which nobody asked
        return text
    numbers = filter(None, re.split(r"[\[\],\s]+", text)) if _is_numbers(read["x"]) else ()
    if (
        odd := next((number for number in numbers if math.isnan(plain_number(number))), None)
    ) is not None:
        raise InputError(
            sentence(
                "this is not a finite number such as -1.5e-3",
                got=odd,
                do="write it in decimal digits",
            )
        )
    return read["x"]


def _is_numbers(value: Any) -> bool:
    return all(map(_is_numbers, value)) if isinstance(value, list) else _is_number(value)


def changed(
    table: dict[str, Any], changes: Iterable[Change], kind: type, known: Iterable[str] = ()
) -> tuple[dict[str, Any], tuple[Changed, ...]]:
    """The table with the changes made, and what each did; one that leaves a value as it was is left out.

    Parameters
    ----------
    table : of the parsed file, which stays as it is
    kind : the part that the file describes
    known : further keys, among which the nearest is looked for where a change names none
    """
    made: dict[str, Changed] = {}
    original = table
    for change in changes:
        for each in _mirrored(change):
            try:
                table = _walk(table, _places(each.key), each, kind)
            except KeyError:
                raise InputError(
                    _unknown(each.key, [*(one.key for one in settings(table, kind)), *known])
                ) from None
            was, source = _certificate(original, each)
            value = _certificate(table, each)[0]
            value = (
                each.value if isinstance(value, dict) else value
            )  # a law of friction goes by its name
            made[each.key] = Changed(each.key, value, was, unit_of(each.key), source)
    return table, tuple(one for one in made.values() if one.value != one.was)


def _unknown(key: str, known: list[str]) -> str:
    known += [f"{k.rpartition('.')[0]}.gain" for k in known if k.rpartition(".")[2] in GAIN_UNITS]
    near = get_close_matches(key, known, n=1, cutoff=0.4) or get_close_matches(
        key, [k.rpartition(".")[2] for k in known], n=1
    )
    near = [k for k in known if k == near[0] or k.endswith(f".{near[0]}")][:1] if near else []
    meant = f"did you mean {near[0]}? " if near else ""
    return sentence("nothing can be set by this name", got=key, do=f"{meant}`--set list` shows all")


def _mirrored(change: Change) -> list[Change]:
    """The change, and for an element beside the diagonal of a tensor of inertia that of its mirror."""
    found = re.fullmatch(r"(.*inertia_kg_m2)\[(\d+)\]\[(\d+)\]", change.key, re.ASCII)
    if found is None or found[2] == found[3]:
        return [change]
    return [change, change._replace(key=f"{found[1]}[{found[3]}][{found[2]}]")]


def _places(key: str) -> list[str]:
    """Names, and places in lists, which begin with a bracket."""
    return [name or f"[{at.strip()}" for name, at in PLACE.findall(key)]


def _is_certificate(node: Any) -> TypeGuard[dict[str, Any]]:
    return isinstance(node, dict) and isinstance(node.get("value"), int | float | list | str)


def _walk(node: Any, places: list[str], change: Change, kind: Any) -> Any:
    """The node with the change made at these places; `KeyError` where there is no such place."""
    if _is_certificate(node) and (not places or places[0].startswith("[")):
        value = _walk(node["value"], places, change, kind)
        if value == node["value"]:
            return node
        was = f"{SET}; was {shown(node['value'])}" + (
            f", {node['source']}" if node.get("source") else ""
        )
        return node | {
            "value": value,
            "source": node["source"] if str(node.get("source")).startswith(SET) else was,
        }
    if not places:
        return _leaf(node, change)
    if isinstance(node, list):
        return _in_list(node, places, change, kind)
    place, rest = places[0], places[1:]
    if place.startswith("["):
        raise KeyError(place)
    if _is_certificate(node) or (isinstance(node, int | float) and place in ("sigma", "source")):
        if place not in ("value", "sigma", "source") or rest:
            raise KeyError(place)
        node = node if isinstance(node, dict) else {"value": node}
        return node | {place: _leaf(node.get(place), change)}
    if node is not None and not isinstance(node, dict):
        raise KeyError(place)
    node = dict(node or {})
    if kind is Wheel and place == "friction":
        return node | {"friction": _friction(node, rest, change)}
    place = next((key for key in GAIN_UNITS if place == "gain" and key in node), place)
    within, is_name = (
        _kind_at(kind, place),
        place in NO_NUMBERS and hasattr(kind, "__pydantic_fields__"),
    )
    if is_name or (
        place not in node and within is None
    ):  # by its name a part is known to telemetry and results
        raise KeyError(place)
    if place not in node and _is_list_of_parts(kind, place) and rest:
        raise KeyError(place)
    return node | {place: _walk(node.get(place), rest, change, within)}


def _in_list(node: list[Any], places: list[str], change: Change, kind: Any) -> list[Any]:
    """A list of tables, in which a table goes by its name or its place, or of numbers."""
    tables = bool(node) and all(isinstance(each, dict) for each in node)
    if places[0].startswith("["):
        at, rest = _index(node, places[0][1:], change.key), places[1:]
    elif tables and len(node) == 1:
        at, rest = 0, places
    elif tables:
        names = ", ".join(str(each.get("name")) for each in node)
        raise InputError(
            sentence(
                f"there are {len(node)} such parts",
                got=change.key,
                do=f"say which in brackets: {names}",
            )
        )
    else:
        raise KeyError(places[0])
    return [_walk(each, rest, change, kind) if i == at else each for i, each in enumerate(node)]


def _index(node: list[Any], name: str, key: str) -> int:
    names = [str(each.get("name")) if isinstance(each, dict) else "" for each in node]
    if name and name in names:
        return names.index(name)
    if name.isdecimal() and name.isascii() and int(name) < len(node):
        return int(name)
    known = ", ".join(names) if any(names) else f"0 to {len(node) - 1}"
    raise InputError(sentence(f"there is no [{name}] here", got=key, do=f"known: {known}"))


def _friction(wheel: dict[str, Any], places: list[str], change: Change) -> Any:
    """The friction of a wheel with the change; a text names one of the wheel's other laws."""
    others, own = wheel.get("alternative_frictions", {}), wheel.get("friction")
    if not places and isinstance(change.value, str):
        if change.value not in others:
            known = ", ".join(sorted(others)) or "none"
            raise VehicleError(
                sentence(
                    "the wheel has no friction of this name", got=change.value, do=f"known: {known}"
                )
            )
        return others[change.value]
    if (
        places
        and places[0] in ("coulomb_N_m", "viscous_N_m_s")
        and isinstance(own, dict)
        and "spin_down" in own
    ):
        own = _coefficients(own["spin_down"], wheel)
    return _walk(own, places, change, Friction)


def _coefficients(spin_down: dict[str, Any], wheel: dict[str, Any]) -> dict[str, Any]:
    """Coefficients in the place of a measured spin-down, so that one of them can be changed."""

    def number(value: Any) -> float:
        return float(value["value"] if isinstance(value, dict) else value)

    law = {key: number(value) for key, value in spin_down.items()}
    friction, source = (
        Friction.from_spin_down(**law, inertia_kg_m2=number(wheel["inertia_kg_m2"])),
        "from the measured spin-down",
    )
    return {
        key: {"value": getattr(friction, key), "source": source}
        for key in ("coulomb_N_m", "viscous_N_m_s")
    }


def _leaf(old: Any, change: Change) -> Any:
    if change.operator == "=":
        if isinstance(old, dict) and old and not isinstance(change.value, dict):
            raise InputError(_one_of(old, change.key))
        return change.value
    if not _is_number(change.value):
        raise InputError(
            sentence(
                f"what stands after {change.operator} must be a number",
                got=change.value,
                where=change.key,
            )
        )
    if old is None:
        do = "set it with = first"
        raise InputError(
            sentence(
                f"{change.operator} needs a value, and this one is not set", got=change.key, do=do
            )
        )
    return _combined(old, change)


def _one_of(table: Mapping[str, Any], key: str) -> str:
    """What is said of a change of a whole table."""
    keys = ("coulomb_N_m", "viscous_N_m_s") if "spin_down" in table else table
    do = f"set one of {', '.join(f'{key}.{each}' for each in keys)}"
    return sentence("this is a table of values and not one of them", got=key, do=do)


def _combined(old: Any, change: Change) -> Any:
    if isinstance(old, dict):
        raise InputError(_one_of(old, change.key))
    if isinstance(old, list):
        return [_combined(each, change) for each in old]
    if not _is_number(old):
        raise InputError(sentence(f"{change.operator} needs numbers", got=old, where=change.key))
    return old * change.value if change.operator == "*=" else old + change.value


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _certificate(table: Any, change: Change) -> tuple[Any, str]:
    """What stands at a change's key, and its source; a law of friction as it is written."""
    found: list[Any] = []
    node: Any = table
    source = ""
    for place in _places(change.key):
        if isinstance(node, list) and not place.startswith("[") and len(node) == 1:
            node = node[0]
        if _is_certificate(node) and place.startswith("["):
            source, node = str(node.get("source", "")), node["value"]
        if place.startswith("[") and isinstance(node, list):
            try:
                node = node[_index(node, place[1:], change.key)]
            except InputError:
                return None, ""
        elif isinstance(node, dict):
            if place == "gain":
                place = next((key for key in GAIN_UNITS if key in node), place)
            if place in ("coulomb_N_m", "viscous_N_m_s") and "spin_down" in node and found:
                node = _coefficients(node["spin_down"], found[-1])
            found.append(node)
            node = node.get(place)
        else:
            return None, ""
    if _is_certificate(node):
        source, node = str(node.get("source", "")), node["value"]
    return _bare(node), source


def _bare(node: Any) -> Any:
    """A table of values without their certificates."""
    if _is_certificate(node):
        return node["value"]
    return {key: _bare(value) for key, value in node.items()} if isinstance(node, dict) else node


def _kind_at(kind: Any, place: str) -> Any:
    """The part, or else the type, of a key of a part; None where it has no such key, and for what is no part."""
    if kind is None:
        return None
    if not hasattr(kind, "__pydantic_fields__"):
        inner = [part_in(each) for each in get_args(kind)]  # a mapping of names to parts
        return next(filter(None, inner), str if get_origin(kind) is not None else None)
    keys = keys_of(kind)
    return None if place not in keys else part_in(keys[place]) or keys[place] or Any


def _is_list_of_parts(kind: Any, place: str) -> bool:
    annotation = keys_of(kind).get(place) if hasattr(kind, "__pydantic_fields__") else None
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    return get_origin(annotation) is tuple and part_in(annotation) is not None


# ------------------------------------------------------------------------------------------------------------ what can be set


def settings(table: Mapping[str, Any], kind: Any, path: str = "") -> list[Setting]:
    """All that can be set: what the file holds, and what it could hold in the tables that it has, in the file's order."""
    found = list(_held(table, path))
    held = {one.key for one in found}
    found += [one for one in _absent(table, kind, path) if one.key not in held]
    read_in = unit_of(
        str(table.get("telemetry", {}).get("quantity", "power_W"))
    )  # what a panel's reading is in
    return [one._replace(unit=read_in) if one.key in OF_READINGS else one for one in found]


def _held(table: Mapping[str, Any], path: str) -> Iterator[Setting]:
    for key, item in table.items():
        at = f"{path}{key}"
        if key in NO_NUMBERS:
            continue
        if _is_certificate(item):
            yield Setting(at, item["value"], unit_of(at), str(item.get("source", "")))
        elif isinstance(item, dict):
            if key == "alternative_frictions":
                yield Setting(
                    f"{path}friction", "as below", "", f"other laws in the file: {', '.join(item)}"
                )
            yield from _held(item, f"{at}.")
        elif isinstance(item, list) and item and all(isinstance(each, dict) for each in item):
            for each in item:
                yield from _held(each, f"{at}." if len(item) == 1 else f"{at}[{each.get('name')}].")
        else:
            yield Setting(at, item, unit_of(at), "")


def _absent(table: Mapping[str, Any], kind: Any, path: str) -> Iterator[Setting]:
    """Keys that a part knows and the file leaves out: of tables that stand in it, and of the laws of the panels."""
    if (
        kind is None
        or not hasattr(kind, "__pydantic_fields__")
        or any(key in table for key in ("spin_down", "value"))
    ):
        return
    for key, annotation in keys_of(kind).items():
        at, within, item = f"{path}{key}", part_in(annotation), table.get(key)
        if within is None or _is_list_of_parts(kind, key):
            if key in table and within is not None and isinstance(item, list):
                for each in item:
                    yield from _absent(
                        each, within, f"{at}." if len(item) == 1 else f"{at}[{each.get('name')}]."
                    )
            elif (
                key not in table
                and key not in NO_NUMBERS
                and within is None
                and key not in GAIN_UNITS
            ):
                yield Setting(at, None, unit_of(at), "not in the file")
        elif key != "alternative_frictions" and (
            isinstance(item, dict) or at.startswith("panel_response")
        ):
            yield from _absent(item or {}, within, f"{at}.")


def unit_of(key: str) -> str:
    """The unit that a key names by its end; "" where it names none."""
    name = re.sub(r"\[[^\]]*\]$", "", re.sub(r"\[[^\]]*\]$", "", key)).rpartition(".")[2]
    return next((unit for end, unit in UNITS if name.endswith(end)), "")


def shown(value: Any) -> str:
    """A value for people, on one line of at most `SHOWN` characters, cut between words: half a number is another number."""
    if isinstance(value, dict):
        text = ", ".join(f"{key} {shown(item)}" for key, item in value.items())
    elif isinstance(value, list):
        text = f"[{', '.join(map(shown, value))}]"
    else:
        text = (
            f"{value:.7g}"
            if isinstance(value, float)
            else "not set"
            if value is None
            else str(value)
        )
    return (
        text
        if len(text) <= SHOWN
        else f"{text[: SHOWN - 4].rpartition(' ')[0] or text[: SHOWN - 4]} ..."
    )


# ------------------------------------------------------------------------------------------------------------------ as a file


def toml_text(table: Mapping[str, Any]) -> str:
    """A table as TOML: tables of the first level under their headings, what is in them on a line each."""
    lines = [
        f"{_name(key)} = {_toml(value)}" for key, value in table.items() if not _has_heading(value)
    ]
    for key, value in table.items():
        if _has_heading(value):
            for each in value if isinstance(value, list) else [value]:
                lines += ["", f"[[{_name(key)}]]" if isinstance(value, list) else f"[{_name(key)}]"]
                lines += [f"{_name(inner)} = {_toml(item)}" for inner, item in each.items()]
    return "\n".join(lines) + "\n"


def _has_heading(value: Any) -> bool:
    return isinstance(value, dict) or (
        isinstance(value, list) and bool(value) and isinstance(value[0], dict)
    )


def _name(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _toml(key)


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return (
            "{ " + ", ".join(f"{_name(key)} = {_toml(item)}" for key, item in value.items()) + " }"
        )
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    escaped = "".join(
        c if c.isprintable() and c not in '"\\' else f"\\U{ord(c):08x}" for c in str(value)
    )
    return f'"{escaped}"'
