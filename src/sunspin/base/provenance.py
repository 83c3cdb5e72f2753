"""What every result says of itself: its kind, by which `sunspin.output` knows it, and where it comes from."""

from __future__ import annotations

from csv import DictReader
from functools import cache
from importlib import metadata, resources
from typing import Any

COPIED_ATTRIBUTES = ("epoch_utc", "synthetic", "file", "sha256", "clock_notes")
"""Attributes of telemetry that results made from it take over."""


@cache
def read_vocabulary() -> dict[str, dict[str, str]]:
    """Name of a variable of results -> its `units` and `long_name`."""
    file = resources.files("sunspin.base").joinpath("variables.csv")
    lines = file.read_text("utf-8").splitlines()
    return {row.pop("name"): row for row in DictReader(lines)}


def with_units(data: Any) -> Any:
    """A copy of a Dataset or DataTree with unit and long name of each variable of the vocabulary; times say their epoch in UTC, if
    known."""
    data = data.copy()
    epoch = {"epoch_utc": data.attrs["epoch_utc"]} if "epoch_utc" in data.attrs else {}
    for node in getattr(data, "subtree", [data]):
        for name, variable in node.variables.items():
            timed = epoch if name in ("time", "curve_time") else {}
            variable.attrs = read_vocabulary().get(name, {}) | timed | variable.attrs
    return data


def clock_notes(data: Any) -> list[str]:
    """Return the sentences on the clock of the telemetry that a Dataset or DataTree was made from."""
    return str(data.attrs.get("clock_notes", "")).splitlines()


@cache
def version() -> str:
    """The version of sunspin that runs."""
    return metadata.version("sunspin")


def provenance(kind: str, telemetry: Any = None, **said: Any) -> dict[str, Any]:
    """The attributes of a result: `kind`, what it takes over from the telemetry's attributes, `said`, the version.

    What is said of a vehicle is its `said`: name, and what was changed in its file.
    """
    given = getattr(telemetry, "attrs", {})
    return {
        "kind": kind,
        **{key: given[key] for key in COPIED_ATTRIBUTES if key in given},
        **said,
        "sunspin_version": version(),
    }
