"""Columns of a telemetry file by name: where one stands, which sensors have none, and which nothing reads."""

from __future__ import annotations

import re
from collections.abc import Iterator
from difflib import get_close_matches

from sunspin.base.errors import TelemetryError, sentence
from sunspin.base.tables import Table
from sunspin.telemetry.sensors import sensor_columns
from sunspin.vehicle import Vehicle

NEAR = 0.75
"""Likeness of two names, letters and digits only, from which one is taken for the other misspelt."""


def column_of(
    table: Table,
    name: str,
    what: str,
    section: str = "telemetry",
    free: list[str] | None = None,
) -> str:
    """The name of a column that is there; `free`: columns that a misspelt name may mean, by default all."""
    if name not in table.header:
        near = _nearest(name, table.header if free is None else free)
        do = f"add it, or name the right column under [{section}] in the vehicle file"
        raise TelemetryError(
            sentence(
                f"column {name!r} ({what}) is missing",
                got="columns " + ", ".join(table.header),
                do=do if near is None else f"did you mean {near!r}? {do[0].upper()}{do[1:]}",
                where=table.where,
            )
        )
    return name


def _bare(name: str) -> str:
    return re.sub(r"[^a-z0-9+-]", "", name.lower())


def _nearest(name: str, names: list[str]) -> str | None:
    bare = {_bare(other): other for other in names}
    found = get_close_matches(_bare(name), bare, n=1, cutoff=NEAR)
    return bare[found[0]] if found else None


def unused_columns(vehicle: Vehicle, table: Table, columns: list[str]) -> list[str]:
    """Columns of the file that nothing reads."""
    form = vehicle.telemetry
    used = {
        form.time_column,
        "phase",
        *columns,
        *sensor_columns(vehicle),
    }
    used |= {*form.temperature_columns.values(), *form.voltage_columns.values()}
    used |= {name for name in (form.voltage_column, form.receive_time_column) if name}
    return [name for name in table.header if name not in used]


def missing_sensors(vehicle: Vehicle, table: Table, columns: list[str]) -> list[str]:
    """Sensors of which the file has no column at all; where it has some, or some that are nearly called so, an error names one."""
    free, missing = unused_columns(vehicle, table, columns), []
    for section, what, names in _sensor_parts(vehicle):
        absent = [name for name in names if name not in table.header]
        near = [name for name in absent if _nearest(name, free)]
        if absent and (len(absent) < len(names) or near):
            column_of(table, (near or absent)[0], what, section, free)
        if absent:
            missing.append(f"{what} ({', '.join(names)})")
    return missing


def _sensor_parts(vehicle: Vehicle) -> Iterator[tuple[str, str, list[str]]]:
    """Table of the vehicle file, sensor in words, its columns."""
    sensors = vehicle.sensors
    for sensor in sensors.sun_sensors:
        names = [name for name in (sensor.x_column, sensor.y_column, sensor.light_column) if name]
        yield "[sun_sensor]", f"Sun sensor {sensor.name}", names
    for section, part in sensors.with_columns.items():
        yield section, section.replace("_", " "), list(part.names)
    for wheel in vehicle.wheels:
        if wheel.speed_column:
            yield "[wheel]", f"speed of wheel {wheel.name}", [wheel.speed_column]
