"""Panel health: lit patterns that geometry forbids, and which panels' loss would explain them (paper, section 4)."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import xarray as xr

from sunspin.measure.panels import observable_patterns
from sunspin.measure.sun import SunStatus, sun_directions
from sunspin.vehicle import Vehicle


def panel_health(vehicle: Vehicle, telemetry: Any, **options: Any) -> dict[str, Any]:
    """Which observed lit patterns the Sun alone cannot make, and the smallest sets of panels whose loss explains all.

    A pattern is explained by a set of panels if adding some of them to the lit ones gives a possible pattern: those were in
    the Sun and gave nothing, being shadowed or dead.

    Returns
    -------
    dict
        ``impossible``: {pattern (sorted tuple of panel names): number of samples}; ``explanations``: list of the smallest
        sets of panels (tuples), empty where nothing needs explaining or nothing explains it.
    """
    sun = telemetry if isinstance(telemetry, xr.Dataset) and "lit" in telemetry else sun_directions(vehicle, telemetry, **options)
    names = np.array(vehicle.panel_names)
    counts: dict[tuple[str, ...], int] = {}
    for lit in np.asarray(sun["lit"])[np.asarray(sun["status"]) == SunStatus.IMPOSSIBLE]:
        pattern = tuple(names[lit].tolist())
        counts[pattern] = counts.get(pattern, 0) + 1
    return {"impossible": counts, "explanations": explanations(vehicle, list(counts))}


def explanations(vehicle: Vehicle, patterns: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """The smallest sets of panels that make every given lit pattern possible; several if equally small."""
    possible = observable_patterns(vehicle)
    if not patterns:
        return []
    for size in range(1, len(vehicle.panel_names) + 1):
        found = [lost for lost in combinations(vehicle.panel_names, size) if all(_explained(p, lost, possible) for p in patterns)]
        if found:
            return found
    return []


def _explained(pattern: tuple[str, ...], lost: tuple[str, ...], possible: frozenset) -> bool:
    """Whether some possible pattern lights all of `pattern` and nothing else but lost panels."""
    seen = frozenset(pattern)
    return any(seen <= other and other - seen <= frozenset(lost) for other in possible)
