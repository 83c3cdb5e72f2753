"""A gyro whose columns are not along the body axes as stated: another order or other signs, as the Sun and the field show.

Only where the rates as stated do not turn these directions as they are seen, and others do: a gyro that fits is not accused.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import permutations, product
from typing import Any

import numpy as np
import xarray as xr

from sunspin.telemetry.units import BETTER, LAGS, TURNS_RIGHT, TURNS_WRONG, carried, directions_seen
from sunspin.vehicle import Vehicle
from sunspin.vehicle.changes import toml_text

AS_GOOD = 1.3
"""Readings whose median angle is less than this many times the least turn the directions as well: the one nearest to the stated
is named, as a component that is small at all times may have any sign."""


def signed_axes() -> Iterator[tuple[str, list[int], tuple[float, ...]]]:
    """The 48 ways to read three columns as axes, in words, with the column and the sign of each axis; the stated one first."""
    for order in permutations(range(3)):
        for sign in product((1.0, -1.0), repeat=3):
            axes = ", ".join(f"{'-' if s < 0 else '+'}{'xyz'[k]}" for k, s in zip(order, sign, strict=True))
            yield f"read as ({axes}) of its columns", list(order), sign


def to_write(table: str, keys: Mapping[str, Any]) -> str:
    """What to do, in words: the keys of a table of the vehicle file that say how a sensor is read."""
    return f"set {' and '.join(toml_text(keys).splitlines())} under [{table}] of the vehicle file"


def wrong_gyro_axes(vehicle: Vehicle, telemetry: xr.Dataset) -> str | None:
    """How the gyro of `read_telemetry` must be read to turn the Sun and the field as they are seen, in words, and what to write;
    None where it does so as stated, or no other reading does."""
    gyro = vehicle.sensors.gyro
    if gyro is None or "gyro_B" not in telemetry:
        return None
    time, rate, seen = telemetry["time"].values, telemetry["gyro_B"].values, directions_seen(vehicle, telemetry)
    ways = list(signed_axes())
    maps = [np.eye(3)[order] * np.array(sign)[:, None] for _, order, sign in ways]
    for lag in LAGS:
        stated, still = carried(time, seen, rate, lag, [maps[0], np.zeros((3, 3))])
        if stated <= TURNS_WRONG:
            continue
        angles = np.array(carried(time, seen, rate, lag, maps))
        least = float(angles.min())
        if least < min(TURNS_RIGHT, BETTER * stated, BETTER * still):
            alike = np.flatnonzero(angles < AS_GOOD * least)
            chosen = max(alike, key=lambda k: (np.trace(maps[k]), -angles[k]))
            what, order, sign = ways[chosen]
            found = f"the gyro {what} turns the Sun as it is seen, and as stated it does not"
            return f"{found}; {to_write('gyro', gyro.read_as(order, sign))}"
    return None
