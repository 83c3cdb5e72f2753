"""Attributes of results: the kind, by which `sunspin.output` recognises a result, and the origin; units of their variables."""

from __future__ import annotations

from csv import DictReader
from functools import cache
from importlib import metadata, resources
from typing import Any

COPIED_ATTRIBUTES = ("epoch_utc", "synthetic", "file", "sha256", "clock_notes")
"""Attributes of telemetry that are copied to the results made from it."""


@cache
def read_vocabulary() -> dict[str, dict[str, str]]:
    """Read the `units` and `long_name` of each variable that results may contain, by its name."""
    file = resources.files("sunspin.base").joinpath("variables.csv")
    lines = file.read_text("utf-8").splitlines()
    return {row.pop("name"): row for row in DictReader(lines)}


def with_units(data: Any) -> Any:
    """Return a copy of a Dataset or DataTree with the unit and long name of each variable that is in the vocabulary.

    Time coordinates also get the epoch in UTC if it is known.
    """
    data = data.copy()
    epoch = {"epoch_utc": data.attrs["epoch_utc"]} if "epoch_utc" in data.attrs else {}
    for node in getattr(data, "subtree", [data]):  # all nodes of a tree, or the Dataset itself
        for name, variable in node.variables.items():
            of_time = epoch if name in ("time", "curve_time") else {}
            # attributes that the variable has already are kept
            variable.attrs = read_vocabulary().get(name, {}) | of_time | variable.attrs
    return data


def clock_notes(data: Any) -> list[str]:
    """Return the notes on the clock of the telemetry from which a Dataset or DataTree was made, a sentence each."""
    return str(data.attrs.get("clock_notes", "")).splitlines()


@cache
def version() -> str:
    """Return the version of sunspin that is running."""
    return metadata.version("sunspin")


def provenance(kind: str, telemetry: Any = None, **attributes: Any) -> dict[str, Any]:
    """Return the attributes of a result: `kind`, attributes copied from the telemetry, `attributes`, and the version.

    For a vehicle pass ``**vehicle.result_attributes``: its name and the changes made to its file.
    """
    telemetry_attrs = getattr(telemetry, "attrs", {})
    return {
        "kind": kind,
        **{key: telemetry_attrs[key] for key in COPIED_ATTRIBUTES if key in telemetry_attrs},
        **attributes,
        "sunspin_version": version(),
    }
