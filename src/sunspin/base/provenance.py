"""What every result says of itself: its kind, by which `sunspin.output` knows it, and where it comes from."""

from __future__ import annotations

from collections.abc import Mapping
from csv import DictReader
from functools import cache
from importlib import metadata, resources
from typing import Any

import numpy as np

CARRIED = ("epoch_utc", "synthetic", "file", "sha256")
"""Attributes of telemetry that results made from it take over."""

LABELS = frozenset("units long_name about title flag_meanings".split())
"""Attributes of variables that are read back, texts all."""


@cache
def vocabulary(file: str = "variables.csv") -> dict[str, dict[str, str]]:
    """Name of a variable of results -> `units`, `long_name`, and `fixed` if a reader relies on the unit.

    Of "attributes.csv": name of an attribute that is read back from files of results -> its `kind`, text or (one) number.
    """
    lines = resources.files("sunspin.base").joinpath(file).read_text("utf-8").splitlines()
    return {row.pop("name"): row for row in DictReader(lines)}


def described(data: Any) -> Any:
    """A copy of a Dataset or DataTree with unit and long name of each variable of the vocabulary; times say their epoch in UTC, if
    known."""
    data = data.copy()
    epoch = {"epoch_utc": data.attrs["epoch_utc"]} if "epoch_utc" in data.attrs else {}
    for node in getattr(data, "subtree", [data]):
        for name, variable in node.variables.items():
            row = vocabulary().get(name, {}).items()
            known = {label: text for label, text in row if label != "fixed"}
            timed = epoch if name in ("time", "curve_time") else {}
            variable.attrs = known | timed | variable.attrs
    return data


@cache
def version() -> str:
    """The version of sunspin that runs."""
    return metadata.version("sunspin")


def changed_attribute(attrs: Mapping[str, Any], variables: Mapping[Any, Any]) -> str:
    """What somebody has made of an attribute of a result of our own, or of its variables, that it cannot be, in words."""
    kinds = vocabulary("attributes.csv")
    for name in sorted({*attrs} & {*kinds}):
        value = np.asarray(attrs[name])
        if kinds[name]["kind"] == "text":
            if not isinstance(attrs[name], str):
                return f"its attribute {name} must be a text"
        elif value.dtype.kind not in "biuf" or value.size != 1:
            return f"its attribute {name} must be one number"
    if "synthetic" in attrs and np.asarray(attrs["synthetic"]).ravel()[0] not in (0, 1):
        return "its attribute synthetic must be 0 or 1"
    for name, variable in variables.items():
        for label in sorted({*variable.attrs} & LABELS):
            if not isinstance(variable.attrs[label], str):
                return f"the attribute {label} of its variable {name} must be a text"
        row = vocabulary().get(name, {"fixed": ""})
        if row["fixed"] and variable.attrs.get("units") != row["units"]:
            return f"the units of its variable {name} must be {row['units']!r}"
    return ""


def provenance(kind: str, telemetry: Any = None, **said: Any) -> dict[str, Any]:
    """The attributes of a result: `kind`, what it takes over from the telemetry's attributes, `said`, the version.

    What is said of a vehicle is its `said`: name, and what was changed in its file.
    """
    given = getattr(telemetry, "attrs", {})
    return {
        "kind": kind,
        **{key: given[key] for key in CARRIED if key in given},
        **said,
        "sunspin_version": version(),
    }
