"""Built-in cases: vehicle, timeline, telemetry and published figures, as data.

A case is a folder with a ``vehicle.toml``; ``timeline.toml``, ``telemetry.csv`` and ``published.toml`` stand beside it
where there are any.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any

import xarray as xr

from sunspin.base.errors import InputError, TelemetryError
from sunspin.base.untrusted import decode_text, read_bytes, read_toml
from sunspin.telemetry.reader import read_telemetry
from sunspin.vehicle import Vehicle, load_vehicle
from sunspin.vehicle.assumptions import Assumptions, read_assumptions, split_changes
from sunspin.vehicle.changes import Changes
from sunspin.vehicle.notebook import case_html
from sunspin.vehicle.part import as_tuples
from sunspin.vehicle.timeline import Timeline, parse_timeline

PUBLISHED_TEXTS = ("unit", "what", "place")


@dataclass(frozen=True)
class Published:
    """A figure that a publication states: its value (nested tuples where not one number), unit and place there."""

    value: Any
    unit: str
    what: str
    place: str


MAX_TIMELINE_BYTES = 1_000_000


@dataclass(frozen=True)
class Case:
    """A landing, flight or test: the vehicle, what happened when, its telemetry and what was published about it.

    `assumptions`: those of the paper's study, where they are changed.
    """

    name: str
    folder: Path
    vehicle: Vehicle
    timeline: Timeline | None
    published: Mapping[str, Published]
    assumptions: Assumptions = Assumptions()

    @property
    def changes(self) -> tuple[Any, ...]:
        """What was set for this run, of the vehicle and of the assumptions."""
        return (*self.vehicle.changes, *self.assumptions.changes)

    @cached_property
    def telemetry(self) -> xr.Dataset:
        """The case's own telemetry, read when first asked for."""
        path = case_telemetry(self.name)
        if path is None:
            raise TelemetryError(
                f"case {self.name!r} comes without telemetry",
                do="read yours with read_telemetry(path, vehicle)",
            )
        return read_telemetry(path, self.vehicle)

    def require_timeline(self) -> Timeline:
        """The timeline, or an `InputError` that says where to add it."""
        if self.timeline is None:
            raise InputError(
                f"case {self.name!r} has no timeline",
                do="add a timeline.toml with its events to the case's folder",
            )
        return self.timeline

    def _repr_html_(self) -> str:
        return case_html(self)


def case_names() -> list[str]:
    """Names of the built-in cases."""
    return sorted(path.parent.name for path in _root().glob("*/vehicle.toml"))


def case_telemetry(name: str) -> Path | None:
    """The telemetry file that comes with a built-in case; None where there is none, or no such case."""
    path = _root() / name / "telemetry.csv"
    return path if name in case_names() and path.is_file() else None


def load_case(name: str, changes: Changes = None) -> Case:
    """Load a built-in case by its name, for example ``"philae"``.

    Parameters
    ----------
    changes : dict or list of str, optional
        Values of the vehicle or of the study's assumptions that take the place of those in the files, by their keys, as in
        :func:`sunspin.load_vehicle`; of the assumptions for example ``{"study.lead_s": 30, "collision.restitution": 0.2}``.

    Returns
    -------
    Case
        Frozen: `vehicle`, `timeline` (UTC, s), `telemetry` (Dataset over (time, panel) in W), `published` (figures, each with
        value, unit and source).

    Raises
    ------
    InputError
        With the names there are, or with what is wrong in one of the case's files.
    """
    if name not in case_names():
        raise InputError(
            "there is no built-in case of this name",
            got=name,
            do=f"known: {', '.join(case_names())}",
        )
    folder = _root() / name
    figures = folder / "published.toml"
    text = figures.read_text("utf-8") if figures.is_file() else ""
    of_vehicle, of_study = split_changes(changes)
    return Case(
        name=name,
        folder=folder,
        vehicle=load_vehicle(name, of_vehicle),
        timeline=_timeline_in(folder),
        published=parse_published(text, str(figures)),
        assumptions=read_assumptions(of_study),
    )


def load_example(name: str = "cubesat") -> tuple[Vehicle, xr.Dataset]:
    """The example that `sunspin init` writes: a made-up satellite and its synthetic telemetry.

    Parameters
    ----------
    name : str
        Only ``"cubesat"``: a 3U CubeSat with five panels and a wheel, 40 samples 20 s apart.

    Returns
    -------
    vehicle : Vehicle
    telemetry : Dataset
        As of :func:`sunspin.read_telemetry`; ``attrs["synthetic"]`` is 1.

    Raises
    ------
    InputError
        For another name.
    """
    if name != "cubesat":
        raise InputError("there is no example of this name", got=name, do="known: cubesat")
    folder = Path(str(resources.files("sunspin").joinpath("template")))
    vehicle = load_vehicle(folder / "vehicle.toml")
    return vehicle, read_telemetry(folder / "telemetry.csv", vehicle)


def timeline_of(vehicle: object) -> Timeline | None:
    """The `timeline.toml` beside a vehicle file, as `sunspin reproduce` writes both; of a built-in vehicle that of its case.

    None where there is none.

    Raises
    ------
    InputError
        With what is wrong in the file.
    """
    built_in = isinstance(vehicle, str) and vehicle in case_names()
    return _timeline_in(_root() / str(vehicle) if built_in else Path(str(vehicle)).parent)


def _timeline_in(folder: Path) -> Timeline | None:
    path = folder / "timeline.toml"
    if not path.is_file():
        return None
    content = read_bytes(
        path, MAX_TIMELINE_BYTES, "timeline", InputError, "move it away, or write it again"
    )
    return parse_timeline(
        decode_text(content, str(path), InputError, "save it as UTF-8"), str(path)
    )


def parse_published(text: str, where: str) -> Mapping[str, Published]:
    """Read the text of a ``published.toml``; `where` names the file in messages. Tables without a value state no figure."""
    figures = {}
    for key, entry in read_toml(text, where, InputError).items():
        if "value" not in entry:
            continue
        texts = [({"unit": "1"} | entry).get(name, "") for name in PUBLISHED_TEXTS]
        if not all(text.strip() for text in texts):
            raise InputError(
                f"a published figure has {', '.join(PUBLISHED_TEXTS)}, none of them empty",
                where=f"{where}, {key}",
            )
        figures[key] = Published(as_tuples(entry["value"]), *texts)
    return MappingProxyType(figures)


def _root() -> Path:
    return Path(str(resources.files("sunspin").joinpath("cases")))
