"""Built-in cases: vehicle, timeline, telemetry and published figures, as data."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from types import MappingProxyType
from typing import Any

import xarray as xr

from sunspin.errors import InputError, sentence
from sunspin.measure.telemetry import read_telemetry
from sunspin.timeline import Timeline, parse_timeline
from sunspin.vehicle import Vehicle, load_vehicle


@dataclass(frozen=True)
class Published:
    """A figure of the paper: value, unit and its place there."""

    id: str
    what: str
    value: Any
    unit: str
    place: str


@dataclass(frozen=True)
class Case:
    """A landing or a flight that comes with the package. `telemetry` says in its attrs whether it is synthetic."""

    name: str
    vehicle: Vehicle
    timeline: Timeline
    telemetry: xr.Dataset
    published: Mapping[str, Published]


def case_file(name: str, file: str) -> Any:
    """A file of a built-in case, as a resource of the package."""
    return resources.files("sunspin").joinpath("cases", name, file)


def load_case(name: str) -> Case:
    """Load a built-in case by name; ``"philae"`` is complete (its telemetry is synthetic, the real one is not public)."""
    if name != "philae":
        raise InputError(
            sentence(f"no complete case is called {name!r}", do='known: philae; vehicles alone: load_vehicle("skcube")')
        )
    vehicle = load_vehicle(name)
    with resources.as_file(case_file(name, "telemetry.csv")) as path:
        telemetry = read_telemetry(path, vehicle)
    return Case(name, vehicle, load_timeline(name), telemetry, load_published(name))


def load_timeline(name: str) -> Timeline:
    """The timeline of a built-in case."""
    return parse_timeline(case_file(name, "timeline.toml").read_text(encoding="utf-8"))


def load_published(name: str) -> Mapping[str, Published]:
    """The published figures of a built-in case by id."""
    table = tomllib.loads(case_file(name, "published.toml").read_text(encoding="utf-8"))
    return MappingProxyType({entry["id"]: Published(**entry) for entry in table["figure"]})
