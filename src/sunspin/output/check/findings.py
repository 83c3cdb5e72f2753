"""The form in which parts of `sunspin check` and `sunspin rates` return what they found."""

from __future__ import annotations

from typing import Any, NamedTuple


class Findings(NamedTuple):
    """What a part of a check found: `summary`, entries of `summary.json`, and `lines`, the same in words for the console."""

    summary: dict[str, Any]
    lines: list[str]
