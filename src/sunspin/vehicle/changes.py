"""Changing assumptions by their keys: ``wheel.speed_rad_s=833``, ``body.inertia_kg_m2[2][2]*=0.9``, ``wheel.friction=printed``.

A change alters the parsed TOML of a file before it is validated, so that the file's ranges and sentences hold for it. The file may
be a vehicle's or the assumptions of a study (:mod:`sunspin.vehicle.assumptions`).
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy
from difflib import get_close_matches
from typing import Annotated, Any, NamedTuple, TypeGuard, get_args, get_origin

from sunspin.base.errors import InputError, VehicleError, sentence
from sunspin.base.toml import read_toml
from sunspin.base.untrusted import plain_number
from sunspin.vehicle.part import keys_of, part_in
from sunspin.vehicle.parts import GAIN_UNITS, Friction, Wheel

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

COEFFICIENTS = ("coulomb_N_m", "viscous_N_m_s")


class Change(NamedTuple):
    """One change as it is asked for: key, "=", "*=" or "+=", and a number, nested lists of numbers, a text or a list of texts."""

    key: str
    operator: str
    value: Any

    def __str__(self) -> str:
        value = self.value if isinstance(self.value, str) else json.dumps(self.value)
        return f"{self.key}{self.operator}{value}"


class Changed(NamedTuple):
    """One change as it was done: `key`, new `value`, what it `was` (None: not set), `unit`, the `source` of what it was."""

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
        asked: list[str | Change] = []
        for key, value in given.items():
            if isinstance(value, str):
                asked.append(f"{key}{'' if value.startswith(('*=', '+=')) else '='}{value}")
            else:
                number = value.tolist() if hasattr(value, "tolist") else value
                asked.append(Change(_checked(str(key)), "=", number))
        given = asked
    return tuple(each if isinstance(each, Change) else _read(each) for each in given)


def _read(text: str) -> Change:
    parts = re.fullmatch(r"\s*([^=]+?)\s*([*+]?=)\s*(.*?)\s*", text, re.DOTALL)
    if parts is None or not parts[3]:
        do = "write KEY=VALUE, KEY*=FACTOR or KEY+=STEP, for example wheel.speed_rad_s=833"
        raise InputError(sentence("this is no change of a value", got=text, do=do))
    return Change(_checked(parts[1]), parts[2], _value(parts[3]))


def _checked(key: str) -> str:
    if KEY.fullmatch(key) is None:
        do = "write table.key, table[name].key or table.key[0][1]"
        raise InputError(sentence("this is no key of a value", got=key, do=do))
    return key


def _value(text: str) -> Any:
    """A value as TOML writes it; what is none is taken for a text without its quotes."""
    try:
        parsed = read_toml(f"x = {text}", "the value", InputError)
    except InputError:
        return text
    if set(parsed) != {"x"}:  # a second line would be another key, of which nobody asked
        return text
    if _is_numbers(parsed["x"]):
        for number in filter(None, re.split(r"[\[\],\s]+", text)):
            if math.isnan(plain_number(number)):
                what = "this is not a finite number such as -1.5e-3"
                raise InputError(sentence(what, got=number, do="write it in decimal digits"))
    return parsed["x"]


def changed(
    table: dict[str, Any], changes: Iterable[Change], kind: type, known: Iterable[str] = ()
) -> tuple[dict[str, Any], tuple[Changed, ...]]:
    """The table with the changes done, and what each did; one that leaves a value as it was is left out.

    Parameters
    ----------
    table : of the parsed file, which stays as it is
    kind : the part that the file describes
    known : further keys, among which the nearest is looked for where a change names none
    """
    new, done = deepcopy(table), {}
    for asked in changes:
        mirror = re.fullmatch(r"(.*inertia_kg_m2)\[(\d+)\]\[(\d+)\]", asked.key, re.ASCII)
        keys = [asked.key]
        if mirror is not None and mirror[2] != mirror[3]:  # a tensor stays symmetric
            keys.append(f"{mirror[1]}[{mirror[3]}][{mirror[2]}]")
        for change in (asked._replace(key=key) for key in keys):
            try:
                value = _put(_located(new, change.key, kind), change)
            except KeyError:
                held = [each.key for each in settings(table, kind)]
                raise InputError(_unknown(change.key, [*held, *known])) from None
            try:
                before = _located(deepcopy(table), change.key, kind)
                was, source = _bare(before.value), str(before.about.get("source", ""))
            except (KeyError, InputError):  # within what an earlier change has brought in
                was, source = None, ""
            done[change.key] = Changed(change.key, value, was, unit_of(change.key), source)
    return new, tuple(each for each in done.values() if each.value != each.was)


class _Place(NamedTuple):
    """Where a key leads: the table or list that holds its value, and at which `step`; the table with value, sigma and source that
    it belongs to, if any (`about`); the `kind` of part in which it lies."""

    holder: Any
    step: Any
    value: Any
    about: dict[str, Any]
    kind: Any


def _located(table: dict[str, Any], key: str, kind: Any) -> _Place:
    """The place of a key; tables that the file leaves out are added to `table`. `KeyError` where there can be no such place."""
    node: Any = table
    holder: Any = None
    step: Any = None
    about: dict[str, Any] = {}
    inside = kind

    def enter(at: str | int) -> None:
        nonlocal node, holder, step
        holder, step = node, at
        node = node.get(at) if isinstance(node, dict) else node[at]

    places = PLACE.findall(key)
    for number, (name, at) in enumerate(places):
        if node is None:  # a table that the file leaves out
            node = holder[step] = {}
        if name and isinstance(node, list):  # the only table of a list needs no brackets
            if not node or not all(isinstance(each, dict) for each in node):
                raise KeyError(key)
            if len(node) > 1:
                names = ", ".join(str(each.get("name")) for each in node)
                what = f"there are {len(node)} such parts"
                raise InputError(sentence(what, got=key, do=f"say which in brackets: {names}"))
            enter(0)
        inside = kind
        if not name:
            if _is_certificate(node):
                about = node
                enter("value")
            if not isinstance(node, list):
                raise KeyError(key)
            enter(_index(node, at.strip(), key))
            continue
        if _is_number(node) and name in ("sigma", "source"):
            node = holder[step] = {"value": node}
        if not isinstance(node, dict):
            raise KeyError(key)
        if _is_certificate(node):
            if name not in ("value", "sigma", "source") or number < len(places) - 1:
                raise KeyError(key)
            enter(name)
            break
        name = next((unit for unit in GAIN_UNITS if name == "gain" and unit in node), name)
        known = _kind_at(kind, name)
        is_part = hasattr(kind, "__pydantic_fields__")
        if name in NO_NUMBERS and is_part:  # by its name a part is known to telemetry and results
            raise KeyError(key)
        more = number < len(places) - 1
        if name not in node and (known is None or (more and _is_list_of_parts(kind, name))):
            raise KeyError(key)
        if name in COEFFICIENTS and "spin_down" in node:
            law = _coefficients(node["spin_down"], holder)
            node.clear()
            node.update(law)
        enter(name)
        kind = known
    if _is_certificate(node):
        about = node
        enter("value")
    return _Place(holder, step, node, about, inside)


def _index(node: list[Any], name: str, key: str) -> int:
    """A table of a list goes by its name or its place, any other element by its place."""
    names = [str(each.get("name")) if isinstance(each, dict) else "" for each in node]
    if name and name in names:
        return names.index(name)
    if name.isdecimal() and name.isascii() and int(name) < len(node):
        return int(name)
    known = ", ".join(names) if any(names) else f"0 to {len(node) - 1}"
    raise InputError(sentence(f"there is no [{name}] here", got=key, do=f"known: {known}"))


def _put(place: _Place, change: Change) -> Any:
    """Do a change at its place; the new value, a law of friction by its name."""
    old, new = place.value, change.value
    if place.kind is Wheel and place.step == "friction" and isinstance(new, str):
        laws = place.holder.get("alternative_frictions", {})
        if new not in laws:
            known = ", ".join(sorted(laws)) or "none"
            what = "the wheel has no friction of this name"
            raise VehicleError(sentence(what, got=new, do=f"known: {known}"))
        place.holder["friction"] = deepcopy(laws[new])
        return new
    if change.operator != "=":
        new = _combined(old, change)
    elif isinstance(old, dict) and old and not isinstance(new, dict):
        raise InputError(_one_of(old, change.key))
    if place.about and new != old:
        about = place.about
        if not str(about.get("source")).startswith(SET):
            was = f"{SET}; was {shown(about['value'])}"
            about["source"] = was + (f", {about['source']}" if about.get("source") else "")
    place.holder[place.step] = new
    return _bare(new)


def _combined(old: Any, change: Change) -> Any:
    """Old values times a factor or plus a step."""
    if not _is_number(change.value):
        what = f"what stands after {change.operator} must be a number"
        raise InputError(sentence(what, got=change.value, where=change.key))
    if old is None:
        what = f"{change.operator} needs a value, and this one is not set"
        raise InputError(sentence(what, got=change.key, do="set it with = first"))
    if isinstance(old, dict):
        raise InputError(_one_of(old, change.key))
    if isinstance(old, list):
        return [_combined(each, change) for each in old]
    if not _is_number(old):
        raise InputError(sentence(f"{change.operator} needs numbers", got=old, where=change.key))
    return old * change.value if change.operator == "*=" else old + change.value


def _one_of(table: Mapping[str, Any], key: str) -> str:
    """What is said of a change of a whole table."""
    keys = COEFFICIENTS if "spin_down" in table else table
    do = f"set one of {', '.join(f'{key}.{each}' for each in keys)}"
    return sentence("this is a table of values and not one of them", got=key, do=do)


def _unknown(key: str, known: list[str]) -> str:
    known += [f"{k.rpartition('.')[0]}.gain" for k in known if k.rpartition(".")[2] in GAIN_UNITS]
    ends = {k.rpartition(".")[2]: k for k in reversed(known)}
    near = get_close_matches(key, known, n=1, cutoff=0.4)
    near = near or [ends[end] for end in get_close_matches(key, ends, n=1)]
    meant = f"did you mean {near[0]}? " if near else ""
    return sentence("nothing can be set by this name", got=key, do=f"{meant}`--set list` shows all")


def _coefficients(spin_down: dict[str, Any], wheel: dict[str, Any]) -> dict[str, Any]:
    """Coefficients in the place of a measured spin-down, so that one of them can be changed."""
    law = {key: float(_bare(value)) for key, value in spin_down.items()}
    inertia = float(_bare(wheel["inertia_kg_m2"]))
    friction = Friction.from_spin_down(**law, inertia_kg_m2=inertia)
    source = "from the measured spin-down"
    return {key: {"value": getattr(friction, key), "source": source} for key in COEFFICIENTS}


def _is_certificate(node: Any) -> TypeGuard[dict[str, Any]]:
    return isinstance(node, dict) and isinstance(node.get("value"), int | float | list | str)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_numbers(value: Any) -> bool:
    return all(map(_is_numbers, value)) if isinstance(value, list) else _is_number(value)


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


def toml_text(table: Mapping[str, Any]) -> str:
    """A table as TOML: tables of the first level under their headings, what is in them on a line each."""
    import tomlkit

    def line(value: Any) -> Any:
        if isinstance(value, dict):
            inline = tomlkit.inline_table()
            inline.update({key: line(each) for key, each in value.items()})
            return inline
        return value

    def lines(value: Mapping[str, Any]) -> Any:
        under = tomlkit.table()
        for key, each in value.items():
            under.add(key, line(each))
        return under

    document, headed = tomlkit.document(), {}
    for key, value in table.items():
        if isinstance(value, dict):
            headed[key] = lines(value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            headed[key] = tomlkit.aot()
            for each in value:
                headed[key].append(lines(each))
        else:
            document.add(key, value)
    for key, value in headed.items():
        document.add(key, value)
    return tomlkit.dumps(document)
