"""Periods that columns of a telemetry file show, in the stretches that are used."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sunspin.base.errors import InputError
from sunspin.telemetry.periodicity import Stretch, find_periods
from sunspin.telemetry.reader import columns_of_readings, read_telemetry
from sunspin.vehicle import Vehicle

MOST_TURNS, LARGEST_RATE = 1.5, 1.0
"""If no largest rate is stated: revolutions between samples of the shortest period, and the rate (rad/s) of a shortest one."""


def read_column_periods(
    path: Path,
    vehicle: Vehicle,
    names: Sequence[str],
    max_rate_rad_s: float | None,
    kept: tuple[float, float],
) -> dict[str, list[Stretch]]:
    """Return what each stretch of each column shows.

    `max_rate_rad_s`: no period is shorter than a revolution at this rate; default: the vehicle's largest rate, else that of one and
    a half revolutions between samples. `kept`: first and last time (s from the epoch) of the samples that are used.

    Raises
    ------
    InputError
        The estimate uses a column, or the file has no such column.
    """
    used = columns_of_readings(vehicle)
    if taken := [name for name in names if name in used]:
        what = f"--period names column {taken[0]!r}, which the estimate uses already"
        raise InputError(what, do="name a column that it does not use, or give SECONDS+-SIGMA@TIME")
    data = read_telemetry(path, vehicle, columns=names)
    time = data["time"].values
    inside = (time >= kept[0]) & (time <= kept[1])
    found = {}
    for k, name in enumerate(names):
        values = data["column_reading"].values[inside, k]
        limit = max_rate_rad_s or vehicle.sensors.disturbance.max_rate_rad_s
        if limit is None:
            read_s = np.unique(time[inside][np.isfinite(values)])
            usual = float(np.median(np.diff(read_s))) if len(read_s) > 1 else np.inf
            limit = min(MOST_TURNS * 2 * np.pi / usual, LARGEST_RATE)
        found[name] = find_periods(time[inside], values, 2 * np.pi / limit)
    return found


def describe_periods(found: dict[str, list[Stretch]], clock: Any) -> list[str]:
    """Return a sentence for each stretch of each column; `clock`: function from s to a time in words."""
    lines = []
    for name, stretches in found.items():
        if not stretches:
            lines.append(f"  column {name}: no stretch has enough readings for a period; unchanged")
        for one in stretches:
            where = f"column {name}, {clock(one.first_s)} to {clock(one.last_s)}"
            where += f" ({one.readings} readings)"
            if one.found is None:
                chance = (
                    f"noise alone would show as much with a probability of {one.false_alarm:.2g}"
                )
                lines.append(f"  {where}: no significant period ({chance}); unchanged")
                continue
            every = [
                f"{part.period_s:.4g} +- {part.sigma_s:.2g} s ({part.probability:.0%})"
                for part in one.found.every
            ]
            chance = f"in noise alone with a probability of {max(one.false_alarm, 1e-6):.1g}"
            lines.append(f"  {where}: period {' or '.join(every)}; {chance}")
    return lines
