"""Built-in cases: vehicle, timeline, telemetry and published figures, as data.

A case is a folder with a ``vehicle.toml`` and, optionally, a ``timeline.toml``, a ``telemetry.csv`` and a ``published.toml``.
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
"""Keys of a published figure whose values are texts; each must be stated."""


@dataclass(frozen=True)
class Published:
    """A figure that a publication states: its value (a number or nested tuples), unit, meaning and place in the publication."""

    value: Any
    unit: str
    what: str
    place: str


MAX_TIMELINE_BYTES = 1_000_000
"""Largest timeline file that is read."""


@dataclass(frozen=True)
class Case:
    """A landing, flight or test: the vehicle, what happened when, its telemetry and what was published about it.

    `assumptions` holds the assumptions of the paper's study; some may have been changed for this run.
    """

    name: str
    folder: Path
    vehicle: Vehicle
    timeline: Timeline | None
    published: Mapping[str, Published]
    assumptions: Assumptions = Assumptions()

    @property
    def changes(self) -> tuple[Any, ...]:
        """Changes made for this run to values of the vehicle and to assumptions of the study."""
        return (*self.vehicle.changes, *self.assumptions.changes)

    @cached_property
    def telemetry(self) -> xr.Dataset:
        """Telemetry of the case; the file is read at the first access."""
        path = case_telemetry_path(self.name)
        if path is None:
            raise TelemetryError(
                f"case {self.name!r} comes without telemetry",
                do="read yours with read_telemetry(path, vehicle)",
            )
        return read_telemetry(path, self.vehicle)

    def require_timeline(self) -> Timeline:
        """Return the timeline; raise an `InputError` that says where to add it if there is none."""
        if self.timeline is None:
            raise InputError(
                f"case {self.name!r} has no timeline",
                do="add a timeline.toml with its events to the case's folder",
            )
        return self.timeline

    def _repr_html_(self) -> str:
        return case_html(self)


def case_names() -> list[str]:
    """Return the names of the built-in cases, sorted."""
    return sorted(path.parent.name for path in _root().glob("*/vehicle.toml"))


def case_telemetry_path(name: str) -> Path | None:
    """Return the telemetry file of a built-in case; None if there is no such case or it has no telemetry."""
    path = _root() / name / "telemetry.csv"
    return path if name in case_names() and path.is_file() else None


def load_case(name: str, changes: Changes = None) -> Case:
    """Load a built-in case by its name, for example ``"philae"``.

    Parameters
    ----------
    changes : dict or list of str, optional
        Values that replace those of the vehicle file or of the study's assumptions, by key, as in :func:`sunspin.load_vehicle`.
        Example for assumptions: ``{"study.lead_s": 30, "collision.restitution": 0.2}``.

    Returns
    -------
    Case
        Frozen: `vehicle`, `timeline` (UTC, s), `telemetry` (Dataset over (time, panel) in W), `published` (figures, each with
        value, unit and source).

    Raises
    ------
    InputError
        There is no case of this name (the message lists the names), or one of the case's files is not valid.
    """
    if name not in case_names():
        raise InputError(
            "there is no built-in case of this name",
            got=name,
            do=f"known: {', '.join(case_names())}",
        )
    folder = _root() / name
    figures_path = folder / "published.toml"
    figures = figures_path.read_text("utf-8") if figures_path.is_file() else ""
    vehicle_changes, study_changes = split_changes(changes)
    return Case(
        name=name,
        folder=folder,
        vehicle=load_vehicle(name, vehicle_changes),
        timeline=_read_timeline_in(folder),
        published=parse_published(figures, str(figures_path)),
        assumptions=read_assumptions(study_changes),
    )


def load_example(name: str = "cubesat") -> tuple[Vehicle, xr.Dataset]:
    """Load the example that `sunspin init` writes: an invented satellite and its synthetic telemetry.

    Parameters
    ----------
    name : str
        Only ``"cubesat"``: a 3U CubeSat with five panels and a wheel, 40 samples 20 s apart.

    Returns
    -------
    vehicle : Vehicle
    telemetry : Dataset
        As returned by :func:`sunspin.read_telemetry`; ``attrs["synthetic"]`` is 1.

    Raises
    ------
    InputError
        `name` is not the name of an example.
    """
    if name != "cubesat":
        raise InputError("there is no example of this name", got=name, do="known: cubesat")
    folder = Path(str(resources.files("sunspin").joinpath("template")))
    vehicle = load_vehicle(folder / "vehicle.toml")
    return vehicle, read_telemetry(folder / "telemetry.csv", vehicle)


def read_timeline(vehicle: object) -> Timeline | None:
    """Read the `timeline.toml` of a vehicle; return None if there is no such file.

    Parameters
    ----------
    vehicle : str or path
        A vehicle file: the timeline is read from the same folder, in which `sunspin reproduce` writes both. Or the name of a
        built-in vehicle: the timeline is that of its case.

    Raises
    ------
    InputError
        The file is not a valid timeline.
    """
    is_built_in = isinstance(vehicle, str) and vehicle in case_names()
    folder = _root() / str(vehicle) if is_built_in else Path(str(vehicle)).parent
    return _read_timeline_in(folder)


def _read_timeline_in(folder: Path) -> Timeline | None:
    """Read the `timeline.toml` of a folder; return None if there is no such file."""
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
    """Read the text of a ``published.toml``: figure name -> `Published`. Tables without the key `value` are skipped.

    Parameters
    ----------
    where : str
        Names the file in messages.

    Raises
    ------
    InputError
        A figure lacks one of `PUBLISHED_TEXTS`.
    """
    figures = {}
    for key, entry in read_toml(text, where, InputError).items():
        if "value" not in entry:
            continue
        # a figure without a stated unit is dimensionless
        texts = [({"unit": "1"} | entry).get(name, "") for name in PUBLISHED_TEXTS]
        if not all(text.strip() for text in texts):
            raise InputError(
                f"a published figure has {', '.join(PUBLISHED_TEXTS)}, none of them empty",
                where=f"{where}, {key}",
            )
        figures[key] = Published(as_tuples(entry["value"]), *texts)
    return MappingProxyType(figures)


def _root() -> Path:
    """Return the folder of the package that holds a folder for each built-in case."""
    return Path(str(resources.files("sunspin").joinpath("cases")))
