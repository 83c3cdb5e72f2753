"""What every result says of itself: its kind, by which `sunspin.output` knows it, and where it comes from."""

from __future__ import annotations

from functools import cache
from importlib import metadata
from typing import Any

CARRIED = ("epoch_utc", "synthetic", "file", "sha256")
"""Attributes of telemetry that results made from it take over."""


@cache
def version() -> str:
    """The version of sunspin that runs."""
    return metadata.version("sunspin")


def provenance(kind: str, telemetry: Any = None, **said: Any) -> dict[str, Any]:
    """The attributes of a result: `kind`, what it takes over from the telemetry's attributes, `said`, the version.

    What is said of a vehicle is its `said`: name, and what was changed in its file.
    """
    given = getattr(telemetry, "attrs", {})
    return {"kind": kind, **{key: given[key] for key in CARRIED if key in given}, **said, "sunspin_version": version()}
