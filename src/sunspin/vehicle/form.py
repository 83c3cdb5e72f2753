"""The building blocks of a vehicle file: values with their birth certificate, and tables that refuse unknown keys."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, NamedTuple

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from sunspin.base.errors import VehicleError, sentence
from sunspin.base.untrusted import SIZES, is_sensible
from sunspin.vehicle import parts


class Given(NamedTuple):
    """A physical value as the file gives it."""

    value: Any
    sigma: Any = None
    source: str | None = None


def _given(raw: Any) -> Given:
    if isinstance(raw, dict):
        unknown = set(raw) - {"value", "sigma", "source"}
        if "value" not in raw or unknown:
            raise ValueError(f"a table here has the keys value, sigma, source, not {sorted(raw)}")
        source = raw.get("source")
        if source is not None and not (isinstance(source, str) and source.strip()):
            raise ValueError("source must be a text that is not empty")
        return Given(_numbers(raw["value"]), None if raw.get("sigma") is None else _numbers(raw["sigma"]), source)
    return Given(_numbers(raw))


def _numbers(raw: Any) -> Any:
    """Numbers, or nested lists of them, as floats; anything else is refused (so "0.5" or true is not a number)."""
    if isinstance(raw, list):
        return [_numbers(item) for item in raw]
    if isinstance(raw, bool) or not isinstance(raw, int | float):
        raise ValueError(f"a number is expected, not {str(raw)[:40]!r}")
    if not is_sensible(raw):  # also of whole numbers too large for a float
        raise ValueError(f"{SIZES} is expected" + (f", not {raw!r}" if isinstance(raw, float) else ""))
    return float(raw)


def _shown(name: str) -> str:
    if not name.isprintable():
        raise ValueError("a name is a text of printable characters")
    return name


Value = Annotated[Any, BeforeValidator(_given)]
Name = Annotated[str, Field(min_length=1, max_length=100), AfterValidator(_shown)]


class Form(BaseModel):
    model_config: ClassVar[ConfigDict] = ConfigDict(extra="forbid", frozen=True, strict=True)


def take(facts: dict[str, parts.Fact], key: str, given: Given | None) -> Any:
    """Note the birth certificate of a value under `key` and return the bare value."""
    if given is None:
        return None
    facts[key] = parts.Fact(_tuples(given.value), _tuples(given.sigma), given.source)
    return given.value


def scalar(facts: dict[str, parts.Fact], key: str, given: Given | None) -> Any:
    value = take(facts, key, given)
    if value is not None and not isinstance(value, float):
        raise VehicleError(sentence(f"{key} must be one number", got=value))
    return value


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value
