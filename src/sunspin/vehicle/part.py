"""Base class of all parts of a vehicle: a frozen model, checked in the same way in Python, from a file or as a changed copy.

A part is a pydantic dataclass, declared by :func:`part`. Its fields are the arguments in Python and the keys in a vehicle file;
a key with a different name is the field's `validation_alias`. A file is validated with a pydantic context, arguments in Python
without one.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import InitVar, field
from difflib import get_close_matches
from functools import wraps
from inspect import Signature, signature
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, TypeVar, dataclass_transform, get_args

import numpy as np
import numpy.typing as npt
from pydantic import (
    AfterValidator,
    AliasChoices,
    AliasPath,
    ConfigDict,
    Field,
    PlainValidator,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic.dataclasses import dataclass

from sunspin.base.errors import VehicleError, sentence
from sunspin.base.untrusted import SIZES, is_sensible

FloatArray = npt.NDArray[np.float64]

UNIT_TOLERANCE = 1e-3
"""Deviation of a direction's length from one that rounding to few digits may cause; it is normalised."""

CONFIG = ConfigDict(extra="forbid", validate_by_name=True, validate_by_alias=False)
"""Pydantic settings of every part."""

VALIDATED_TYPE = re.compile(r"Annotated\[(\w+), .*\](?= \| None|$)")
"""A type with validators in a signature; group 1 is the type."""

T = TypeVar("T")


@dataclass(frozen=True, eq=False, config=CONFIG)
class Part:
    """Base class of all parts: compared and hashed by content, arrays included.

    Pickles contain plain data and restore it bit by bit, without validation.
    """

    left_out: ClassVar[Mapping[str, Any]] = {}
    """Values that a file may omit although the argument in Python has no default."""

    @model_validator(mode="before")
    @classmethod
    def _with_omitted(cls, given: Any, info: ValidationInfo) -> Any:
        """Return the fields of a file with those of `left_out` that it omits; arguments in Python are returned unchanged."""
        # pydantic gives a context only for files; a table that is no dict is reported later
        return {**cls.left_out, **given} if info.context and isinstance(given, dict) else given

    def __eq__(self, other: object) -> bool:
        return (
            _comparable(self) == _comparable(other) if type(other) is type(self) else NotImplemented
        )

    def __hash__(self) -> int:
        return hash(_comparable(self))

    def __getstate__(self) -> dict[str, Any]:
        return {
            key: dict(value) if isinstance(value, MappingProxyType) else value
            for key, value in vars(self).items()
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        for key, value in state.items():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
            vars(self)[key] = MappingProxyType(value) if isinstance(value, dict) else value


def _comparable(value: Any) -> Any:
    """Return a value in a form that can be compared and hashed: parts, mappings, arrays and lists by their content."""
    if isinstance(value, Part):
        return type(value), _comparable(vars(value))
    if isinstance(value, Mapping):
        return frozenset((key, _comparable(item)) for key, item in value.items())
    return as_tuples(value)


def as_tuples(value: Any) -> Any:
    """Return arrays and lists as nested tuples of comparable values."""
    value = value.tolist() if isinstance(value, np.ndarray) else value
    return tuple(_comparable(item) for item in value) if isinstance(value, list | tuple) else value


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(field, Field))
def part(cls: type[T]) -> type[T]:
    """Make a class a frozen part whose validation errors are sentences (`VehicleError`), also in `dataclasses.replace`."""
    part_class: Any = dataclass(frozen=True, eq=False, config=CONFIG)(cls)
    validate = part_class.__init__

    @wraps(validate)
    def init(self: Any, *arguments: Any, **named: Any) -> None:
        # positional arguments are passed by name, so that messages contain the name
        positional = dict(zip(part_class.__pydantic_fields__, arguments, strict=False))
        try:
            # arguments beyond the fields stay positional, and are refused there
            validate(self, *arguments[len(positional) :], **positional, **named)
        except ValidationError as error:
            raise VehicleError(describe_error(error, part_class, part_class.__name__)) from None

    part_class.__init__ = init
    part_class.__signature__ = _plain_signature(signature(part_class))
    return part_class


def _plain_signature(full: Signature) -> Signature:
    """Return a signature for the documentation, whose types have no validators."""
    parameters = [
        p.replace(annotation=VALIDATED_TYPE.sub(r"\1", str(p.annotation)))
        for p in full.parameters.values()
    ]
    return full.replace(parameters=parameters)


# ---------------------------------------------------------------------------------------------------------------------- values


def frozen_array(value: npt.ArrayLike) -> FloatArray:
    """Return a read-only float64 copy of ``value``."""
    array = np.array(value, dtype=np.float64)
    array.setflags(write=False)
    return array


def direction(value: npt.ArrayLike, key: str) -> FloatArray:
    """Return ``value`` (3) as a read-only unit vector, or raise `VehicleError` if it is not one to three digits."""
    vector = as_array(value)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise VehicleError(f"{key} must be three finite numbers", got=value)
    length = float(np.linalg.norm(vector))
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise VehicleError(
            f"{key} must be a unit vector, its length is {length:.6g}",
            got=np.array2string(vector, separator=", "),
            do="divide it by its length or correct its components",
        )
    return frozen_array(vector / length)


LARGEST_ANGLE_SIGMA = 1.0
"""rad: a larger uncertainty of a direction is a number in degrees."""


def as_array(value: Any) -> FloatArray:
    """Return numbers as an array; an empty one for anything else, such as rows of different length."""
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        return np.empty(0)


def checked_value(raw: Any, info: ValidationInfo) -> Any:
    """Return the value of a field, without the sigma and source that a file may add to it.

    Raises an error if the table {value, sigma, source} is not valid or a number has no sensible size. An argument in Python is
    returned unchanged.
    """
    if not info.context:  # not from a file
        return raw
    if isinstance(raw, dict):
        unknown = set(raw) - {"value", "sigma", "source"}
        if "value" not in raw or unknown:
            raise ValueError(f"a table here has the keys value, sigma, source, not {sorted(raw)}")
        source = raw.get("source")
        if source is not None and not (isinstance(source, str) and source.strip()):
            raise ValueError("source must be a text that is not empty")
        value, sigma = as_array(numbers(raw["value"])), as_array(numbers(raw.get("sigma", 0.0)))
        if sigma.shape not in ((), value.shape) or np.any(sigma < 0):
            what = (
                "the sigma of {path} must be one number or one for each component, and not negative"
            )
            raise VehicleError(what, got=raw["sigma"])
        is_angle = info.field_name == "normal_B" or str(info.field_name).endswith("_rad")
        if is_angle and np.any(sigma > LARGEST_ANGLE_SIGMA):
            what = f"the sigma of {{path}} is in rad and not above {LARGEST_ANGLE_SIGMA:g}"
            raise VehicleError(what, got=raw["sigma"], do="one degree is 0.01745")
        raw = raw["value"]
    return numbers(raw)


def numbers(raw: Any) -> Any:
    """Return a number or nested lists of numbers as floats.

    Raises ValueError for any other value, such as "0.5" or true, and for numbers outside the range of :func:`is_sensible`.
    """
    if isinstance(raw, list):
        return [numbers(item) for item in raw]
    if isinstance(raw, bool) or not isinstance(raw, int | float):
        raise ValueError(f"a number is expected, not {str(raw)[:40]!r}")
    if not is_sensible(raw):  # before float(), which fails for huge integers
        raise ValueError(
            f"{SIZES} is expected" + (f", not {raw!r}" if isinstance(raw, float) else "")
        )
    return float(raw)


def _number(raw: Any, info: ValidationInfo) -> float:
    """Return one number of a file or a Python argument; raise an error for any other value, lists and truth values included."""
    value = checked_value(raw, info)
    if isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim):
        raise VehicleError("{path} must be one number", got=value)
    try:
        if not isinstance(value, bool | str | bytes):  # float() would accept these
            return float(value)
    except (TypeError, ValueError, OverflowError):
        pass
    raise ValueError(f"a number is expected, not {str(value)[:40]!r}")


def must(rule: Callable[[float], bool], message: str) -> AfterValidator:
    """Return a validator by which a number must be finite and satisfy `rule`, with the message for other numbers.

    In the message `{path}` is the place of the value, `{name}` the name of the part and `{key}` the field.
    """

    def check(value: float, info: ValidationInfo) -> float:
        if not (np.isfinite(value) and rule(value)):
            what = message.format(path="{path}", name=info.data.get("name"), key=info.field_name)
            raise VehicleError(what, got=value)
        return value

    return AfterValidator(check)


def above_zero(value: float) -> bool:
    """Return whether a number is positive."""
    return value > 0


def unit(label: str) -> PlainValidator:
    """Return a validator for a unit vector (3), named `label` in messages, in which `{name}` is the name of the part."""
    return PlainValidator(
        lambda raw, info: direction(
            checked_value(raw, info), label.format(name=info.data.get("name"))
        )
    )


def array(rule: Callable[[FloatArray], bool], message: str) -> PlainValidator:
    """Return a validator that makes a read-only array and requires `rule`, with the message for other values.

    `{path}` and `{name}` in the message are as in :func:`must`.
    """

    def check(raw: Any, info: ValidationInfo) -> FloatArray:
        value = as_array(given := checked_value(raw, info))
        if not rule(value):
            what = message.format(path="{path}", name=info.data.get("name"))
            raise VehicleError(what, got=given)
        return frozen_array(value)

    return PlainValidator(check)


def _printable_name(name: str) -> str:
    """Return a name, or raise ValueError if it has characters that are not printable."""
    if not name.isprintable():
        raise ValueError("a name is a text of printable characters")
    return name


Name = Annotated[str, Field(min_length=1, max_length=100), AfterValidator(_printable_name)]
Number = Annotated[float, PlainValidator(_number)]
Positive = Annotated[Number, must(above_zero, "{path} must be positive")]
Vector = Annotated[
    FloatArray, array(lambda value: value.shape == (3,), "{path} must be three numbers")
]
Text = Annotated[Mapping[Name, Name], AfterValidator(lambda value: MappingProxyType(dict(value)))]

Numbers = Annotated[
    Mapping[Name, Number], AfterValidator(lambda value: MappingProxyType(dict(value)))
]


def no_entries() -> Mapping[str, Any]:
    """Return an empty read-only mapping, the default of mapping fields."""
    return MappingProxyType({})


# -------------------------------------------------------------------------------------------------------------------- sentences


IN_WORDS = {"string_type": "should be a text in quotes", "string_too_short": "should not be empty"}
"""Plain words for types of pydantic errors."""


def describe_error(
    error: ValidationError, kind: type, where: str, table: Mapping[str, Any] | None = None
) -> str:
    """Return the most important of pydantic's errors on a part of type `kind`, as one sentence.

    Misspelt keys are the most important, as one often explains a missing key. Missing keys and wrong types follow, and physically
    impossible values (`VehicleError`) come last. `where` names the file or the class. `table`: the parsed file; None for arguments
    in Python.
    """
    problems = sorted(
        error.errors(include_url=False),
        key=lambda each: each["type"] != "unexpected_keyword_argument",
    )
    first = next(
        (each for each in problems if not isinstance(_own_error(each), VehicleError)), problems[0]
    )
    reason = _own_error(first)
    places = first["loc"]  # keys and indices that lead to the value
    if isinstance(reason, VehicleError):
        # its text has {path} where the position of the value belongs
        path = (
            _named_path(places, table)
            if table is not None
            else ".".join(map(str, (where, *places)))
        )
        return ("" if table is None else f"{where}: ") + str(reason).replace("{path}", path)
    key = ".".join(f"[{place}]" if isinstance(place, int) else str(place) for place in places)
    where = f"{where}, {key.replace('.[', '[')}"
    if first["type"] == "unexpected_keyword_argument":
        known = keys_at(kind, places[:-1], table is not None)
        similar = get_close_matches(str(places[-1]), known, n=1)
        tables = tables_with(kind, str(places[-1])) if table is not None else []
        hint = f"; {places[-1]} belongs under {' or '.join(tables)}" if tables else ""
        hint = f"; did you mean {similar[0]}?" if similar else hint
        do = f"known keys: {', '.join(known)}{hint}"
        return sentence(f"unknown key {str(places[-1])!r}", do=do, where=where)
    if first["type"] == "missing":
        return sentence("this key is missing", do="add it", where=where)
    # pydantic's own message, in the words of a file: lists and tables
    message = first["msg"].removeprefix("Value error, ").removeprefix("Input ")
    message = message.replace("valid tuple", "valid list").replace("Tuple should", "List should")
    message = IN_WORDS.get(first["type"], message.replace(" after validation", ""))
    if first["type"] == "dataclass_type":
        message = (
            "should be a table" if table is not None else message.replace("a dictionary or ", "")
        )
    got = None if isinstance(first["input"], dict) else first["input"]
    return sentence(message, got=got, where=where)


def _own_error(details: Any) -> object:
    """Return the exception that a validator of this package raised, from an entry of pydantic's errors; None if there is none."""
    return details.get("ctx", {}).get("error")


def _named_path(places: tuple[int | str, ...], table: Any) -> str:
    """Return the path of a value in a file, with parts of a list by name: ("panel", 0, "gain") is "panel.+X.gain"."""
    words, node = [], table
    for place in places:
        node = node[place]
        words.append(node["name"] if isinstance(place, int) else place)
    return ".".join(words)


def keys_of(kind: Any, in_file: bool = True) -> dict[str, Any]:
    """Return the keys of a part and their types.

    In a file keys may have other names (aliases), and a field that is read from the sigma of another key (`AliasPath`) has none.
    """
    keys = {}
    for name, info in kind.__pydantic_fields__.items():
        alias = info.validation_alias if in_file else None
        if not isinstance(alias, AliasPath):
            keys |= dict.fromkeys(
                alias.choices if isinstance(alias, AliasChoices) else [alias or name],
                info.annotation,
            )
    return keys


def keys_at(kind: Any, places: tuple[int | str, ...], in_file: bool) -> dict[str, Any]:
    """Return the keys of the part at the end of a path that begins in a part of type `kind`; keys of tables come last."""
    for place in places:
        # an index in a list is no key: its elements are of the kind that the list contains
        kind = part_in(keys_of(kind, in_file).get(str(place))) or kind
    return dict(
        sorted(keys_of(kind, in_file).items(), key=lambda item: part_in(item[1]) is not None)
    )


def tables_with(kind: Any, key: str, place: str = "") -> list[str]:
    """Return the headers of the tables of a file that have this key, such as ``[disturbance]`` or ``[[panel]]``.

    `kind`: type of the part that the file describes; `place`: its path in the file, empty for the whole file.
    """
    headers = []
    for name, annotation in keys_of(kind).items():
        part = part_in(annotation)
        if part is None or "Mapping" in str(annotation):
            continue  # tables of a mapping have names of their own
        path = f"{place}.{name}" if place else name
        if key in keys_of(part):
            headers.append(f"[[{path}]]" if "tuple[" in str(annotation) else f"[{path}]")
        headers += tables_with(part, key, path)
    return headers


def part_in(annotation: Any) -> type[Part] | None:
    """Return the type of part that an annotation is or contains, such as `Panel` in ``tuple[Panel, ...]``; else None."""
    if isinstance(annotation, type) and issubclass(annotation, Part):
        return annotation
    inside = annotation.type if isinstance(annotation, InitVar) else get_args(annotation)
    return next(filter(None, map(part_in, inside if isinstance(inside, tuple) else [inside])), None)
