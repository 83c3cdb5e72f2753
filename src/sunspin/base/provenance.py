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

TEXTS = frozenset(
    "kind epoch_utc file sha256 vehicle changes comments sunspin_version quantity unused_columns missing_sensors frame_N "
    "celestial_frame source verdict verdict_word acceleration_noise_from sensors_late_from columns_doubt odd_sensor alike wheels "
    "strategy scenario schedule orbit_name not_told vertical metric about collision command title noise_from torques priors "
    "hypotheses".split()
)
NUMBERS = frozenset(
    "synthetic seed runs candidates collisions rows_sorted rows_merged coarse_passes cut_passes effort acceleration_noise "
    "max_rate_rad_s sensors_late_s sensors_late_sigma_s walk_between_passes noise lit_threshold p_value pareto_k effective_draws "
    "log_evidence samples t_first_s t_last_s reference_sample solution best_s probability no_sphere gyro_used field_used "
    "effort_given fine_up_to_rad_s".split()
)
"""Attributes that are read back from files of results: those that are texts, and those that are one number each."""

LABELS = frozenset("units long_name about title flag_meanings".split())
"""Attributes of variables that are read back, texts all."""


@cache
def vocabulary() -> dict[str, dict[str, str]]:
    """Name of a variable of results -> `units`, `long_name`, and `fixed` if a reader relies on the unit."""
    lines = (
        resources.files("sunspin").joinpath("base", "variables.csv").read_text("utf-8").splitlines()
    )
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


def is_ours(attrs: Mapping[Any, Any]) -> bool:
    """Whether a file with these attributes is a result of our own; what is exported goes by the conventions of others."""
    ours = isinstance(attrs.get("kind"), str) or "sunspin_version" in attrs
    return ours and "Conventions" not in attrs


def changed_attribute(attrs: Mapping[str, Any], variables: Mapping[Any, Any]) -> str:
    """What somebody has made of an attribute of a result of our own, or of its variables, that it cannot be, in words."""
    for name in sorted({*attrs} & TEXTS):
        if not isinstance(attrs[name], str):
            return f"its attribute {name} must be a text"
    for name in sorted({*attrs} & NUMBERS):
        value = np.asarray(attrs[name])
        if value.dtype.kind not in "biuf" or value.size != 1:
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
