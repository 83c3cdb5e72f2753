"""The only reader of mission files: CSV -> Dataset with flags and provenance, or one sentence on what is wrong.

Column names, units, clock and what to do with bad rows come from the vehicle file (`[telemetry]`), so that nobody has to
rewrite a file to have it read.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from sunspin.base.errors import TelemetryError
from sunspin.base.provenance import provenance
from sunspin.base.tables import Table, read_table
from sunspin.base.untrusted import plain_number
from sunspin.telemetry.noise import lowest_reading
from sunspin.telemetry.sensors import ABSURD, read_sensors, sensor_parts
from sunspin.telemetry.stored import KIND, stored_telemetry
from sunspin.telemetry.units import UNITS
from sunspin.vehicle import TelemetryForm, Vehicle
from sunspin.vehicle.craft import OR_CHANNEL
from sunspin.vehicle.sensors import unwrapped
from sunspin.vehicle.timeline import instant

FLAGS = {0: "good", 1: "not_a_number", 2: "negative", 4: "time_not_increasing"}
"""Bits of `flag`."""

COLDEST_C, HOTTEST_C = -200.0, 250.0
"""No solar panel in flight is colder or hotter: such a reading is none."""

UNIX_ZERO, LATEST_UNIX_S = datetime(1970, 1, 1, tzinfo=UTC), 1e11

NEAR = 0.75
"""Likeness of two names, letters and digits only, from which one is taken for the other misspelt."""

LEAST_FACTOR = 0.2
"""A temperature correction below this is beyond any linear law and left out."""


def read_telemetry(path: Any, vehicle: Vehicle) -> xr.Dataset:
    """Read panel powers or currents, Sun sensors, gyro and magnetometer from a CSV, JSON lines, Parquet or NetCDF file.

    Parameters
    ----------
    path : str or path
        Also `telemetry.nc` of a results folder, which gives what was read when that was written.
    vehicle : Vehicle
        Its `telemetry` says which columns, unit, clock; its panels which columns must be there. A file that has columns of
        the vehicle's sensors may have none of the panels.

    Returns
    -------
    xarray.Dataset
        `power_W` (or `current_A`) over (time, panel), `flag (time)` (bits, 0 is good), coordinate `time` in s from
        ``attrs["epoch_utc"]``, `phase (time)` and `received_s (time)` where the file has such columns; attrs name the file, its
        hash, whether it calls itself synthetic, its `unused_columns`, and `missing_sensors`: those of which it has no column. With
        ``bad_rows = "flag"`` rows are sorted by time, and rows of one instant that say the same become one, as where several
        ground stations heard a frame: attrs `rows_sorted` and `rows_merged` count them.

    Raises
    ------
    TelemetryError
        Naming file, line, column, what was found and what to do.
    """
    path = Path(path)
    if not (vehicle.sensors.sun_sensors or vehicle.sensors.sun_vector or vehicle.sensors.gyro):
        vehicle.require_panels()
    form = vehicle.telemetry
    if path.suffix == ".toml":
        what = "this is a vehicle's file and not telemetry"
        do = "give the vehicle first and then a table of samples"
        raise TelemetryError(what, do=do, where=str(path))
    table = read_table(path)
    if table.data is not None and str(table.data.attrs.get("kind")) == KIND:
        return stored_telemetry(table.data, vehicle, path)
    header = set(table.header)
    if "frame" in header and form.time_column not in header and header & {"timestamp", "observer"}:
        what = "the file holds raw frames and no readings"
        do = "turn them into a table first, as `sunspin decode` does for skCUBE"
        raise TelemetryError(what, do=do, where=str(path))
    sensors = read_sensors(vehicle, table)
    columns = _panel_columns(vehicle, table, optional=bool(sensors))
    received = _received(form, table)
    time, epoch = _times(form, table, received)
    unused = _unused_columns(vehicle, table, columns)
    counts: dict[str, int] = {}
    if form.bad_rows == "flag":
        read = header - {form.time_column, form.receive_time_column, *unused}
        table, time, epoch, counts = _in_order(form, table, time, epoch, read)
        if counts:
            sensors, received = read_sensors(vehicle, table), _received(form, table)
    values, flag = _values(vehicle, table, columns)
    values, warmth = _at_reference(vehicle, table, values)
    late = np.concatenate([[False], time[1:] <= np.maximum.accumulate(time)[:-1]])
    if form.bad_rows == "refuse" and late.any():
        i = int(late.argmax())
        got, where = table.cells[form.time_column].iat[i], f"line {table.cells.index[i]}"
        do = 'sort the rows and remove repeats, or set bad_rows = "flag" under [telemetry] in the vehicle file'
        raise TelemetryError(
            "time does not increase", got=got, do=do, where=f"{table.where}, {where}"
        )
    flag |= np.where(late, np.uint8(4), np.uint8(0))
    missing = _missing_sensors(vehicle, table, unused)
    if received is not None:
        long_name = "when the row was received, from the epoch of the times"
        seconds = received - (epoch - UNIX_ZERO).total_seconds()
        sensors["received_s"] = ("time", seconds, {"units": "s", "long_name": long_name})
    coords: dict[str, Any] = {
        "time": ("time", time, {"units": "s", "long_name": "time since the epoch"})
    }
    readings: dict[str, Any] = {}
    if values.shape[1]:
        coords["panel"] = list(vehicle.input_names)
        about = {"units": UNITS[form.quantity]}
        readings[form.quantity] = (("time", "panel"), values, about)
    if "phase" in table.header:
        phase = [cell.strip() for cell in table.cells["phase"]]
        coords["phase"] = ("time", np.array(phase, dtype=np.str_))
    if sensors or warmth:
        coords["axis"] = ["x", "y", "z"]
    masks = [bit for bit in FLAGS if bit]
    about = {"flag_masks": masks, "flag_meanings": " ".join(FLAGS[bit] for bit in masks)}
    readings["flag"] = ("time", flag, about)
    attrs = provenance("telemetry", **vehicle.said) | {
        "quantity": form.quantity,
        "sha256": table.sha256,
        "comments": "\n".join(table.comments),
        "synthetic": int(any(each.lower().startswith("synthetic") for each in table.comments)),
        "epoch_utc": epoch.isoformat().replace("+00:00", "Z"),
        "file": path.name.encode("utf-8", "backslashreplace").decode("utf-8"),
        "unused_columns": ", ".join(unused),
        "missing_sensors": "; ".join(missing),
    }
    return xr.Dataset(readings | sensors | warmth, coords, attrs | counts)


def _panel_columns(vehicle: Vehicle, table: Table, optional: bool) -> list[str]:
    """The column of each input; none if all may be missing and are."""
    form = vehicle.telemetry
    powers = form.quantity == "power_W" and not form.has_voltages
    letter, unit = ("P", "W") if powers else ("I", "A")
    names = {}
    for panel in vehicle.input_names:
        usual = [panel, f"{letter}{panel}_{unit}"]
        present = [name for name in usual if name in table.header]
        names[panel] = form.columns.get(panel) or (present or usual[1:])[0]
    usual = {*vehicle.input_names, *(f"{letter}{panel}_{unit}" for panel in vehicle.input_names)}
    if optional and not {*names.values(), *usual} & set(table.header):
        return []
    columns = [column_of(table, name, f"panel {panel}") for panel, name in names.items()]
    if twice := [name for name in columns if columns.count(name) > 1]:
        what = "two panels read one column"
        do = f"name the column of each under [telemetry.columns] in the vehicle file{OR_CHANNEL}"
        raise TelemetryError(what, got=twice[0], do=do, where=table.where)
    return columns


def _refuse(
    form: TelemetryForm, what: str, bad: np.ndarray, table: Table, names: list[str]
) -> None:
    """Raise the error for the first of the bad cells (rows, columns), if the vehicle file asks for it."""
    if form.bad_rows == "refuse" and bad.any():
        row, k = np.argwhere(bad)[0]
        got = table.cells[names[k]].iat[row] or "an empty cell"
        do = 'correct it, or set bad_rows = "flag" under [telemetry] in the vehicle file'
        raise TelemetryError(what, got=got, do=do, where=table.place(row, names[k]))


def _values(vehicle: Vehicle, table: Table, columns: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Readings (n, n_input) in W or A, NaN where none, and the flag (n) of each row."""
    form = vehicle.telemetry
    values = table.numbers(columns)
    values = np.where(np.abs(values) < ABSURD, values, np.nan)
    values = (unwrapped(values, form.wraps_at) - form.zero) * form.scale
    if columns and form.has_voltages:
        common = form.voltage_column or ""
        names = [
            column_of(table, form.voltage_columns.get(panel, common), f"voltage of panel {panel}")
            for panel in vehicle.input_names
        ]
        volts = form.voltage_scale * table.numbers(names)
        volts = np.where((volts >= 0) & (volts < ABSURD), volts, np.nan)
        what = "a voltage is a number, zero or above"
        _refuse(form, what, ~np.isfinite(volts), table, names)
        values = values * volts
    none, negative = ~np.isfinite(values), values < lowest_reading(vehicle, values)
    _refuse(form, "a finite number is expected", none, table, columns)
    _refuse(form, "a panel cannot give a negative value", negative, table, columns)
    return values, (none.any(axis=1) + 2 * negative.any(axis=1)).astype(np.uint8)


def _at_reference(
    vehicle: Vehicle, table: Table, values: np.ndarray
) -> tuple[np.ndarray, dict[str, Any]]:
    """Values at the panels' reference temperature, and the temperatures; a panel without a reading takes the others' mean."""
    form, panels = vehicle.telemetry, vehicle.input_names
    if not form.temperature_columns or not values.shape[1]:
        return values, {}
    warm = np.full(values.shape, np.nan)
    for panel, name in form.temperature_columns.items():
        column = column_of(table, name, f"temperature of panel {panel}")
        warm[:, panels.index(panel)] = form.temperature_scale * table.numbers([column])[:, 0]
    warm = np.where((warm > COLDEST_C) & (warm < HOTTEST_C), warm, np.nan)
    known = np.isfinite(warm)
    mean = np.where(known, warm, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    mean = np.where(known.any(axis=1), mean, form.reference_temperature_C)
    filled = np.where(known, warm, mean[:, None])
    factor = 1 + form.temperature_coefficient_per_K * (filled - form.reference_temperature_C)
    factor = np.where(factor > LEAST_FACTOR, factor, 1.0)
    about = {"units": "degC", "long_name": "temperature of the panel"}
    return values / factor, {"panel_temperature_C": (("time", "panel"), warm, about)}


def parse_utc(text: str) -> datetime | None:
    text = re.sub(r"\s*(UTC|GMT)$", "Z", text.strip()).replace("/", "-")
    day = re.fullmatch(
        r"(\d{4})-(\d{3})([T ].*)?", text, re.ASCII
    )  # year and day of the year, as in CCSDS 301.0-B, ASCII code B
    try:
        if day:
            start = datetime(int(day[1]), 1, 1, tzinfo=UTC) + timedelta(days=int(day[2]) - 1)
            text = start.date().isoformat() + (day[3] or "")
    except (ValueError, OverflowError):  # no such year or day
        return None
    return instant(text)


def _received(form: TelemetryForm, table: Table) -> np.ndarray | None:
    """When each row (n) was received, Unix seconds; NaN where it does not say; None if no column says."""
    if form.receive_time_column is None:
        return None
    cells = table.cells[column_of(table, form.receive_time_column, "the time of reception")]
    if form.receive_time_format == "unix":
        seconds = np.array([plain_number(cell) for cell in cells])
        return np.where(np.abs(seconds) < LATEST_UNIX_S, seconds, np.nan)
    moments = [parse_utc(cell) for cell in cells]
    return np.array([(each - UNIX_ZERO).total_seconds() if each else np.nan for each in moments])


def _times(
    form: TelemetryForm, table: Table, received: np.ndarray | None
) -> tuple[np.ndarray, datetime]:
    """Seconds from the epoch, and the epoch: the vehicle's, else by when rows were received, else the first sample."""
    cells = table.cells[column_of(table, form.time_column, "the time")].tolist()
    fixed = None if form.epoch_utc is None else parse_utc(form.epoch_utc)
    if form.epoch_utc is not None and fixed is None:
        what = "telemetry.epoch_utc of the vehicle is not an ISO-8601 time"
        raise TelemetryError(what, got=form.epoch_utc)

    def refused(what: str, row: int, do: str) -> TelemetryError:
        where = table.place(row, form.time_column)
        return TelemetryError(what, got=cells[row] or "an empty cell", do=do, where=where)

    if form.time_format == "utc":
        moments = [moment for cell in cells if (moment := parse_utc(cell)) is not None]
        if len(moments) < len(cells):
            i = next(k for k, cell in enumerate(cells) if parse_utc(cell) is None)
            raise refused("an ISO-8601 UTC time is expected", i, _how_to_write(cells[i]))
        zones = [re.search(r":.*([+-]\d\d:?\d\d|Z|UTC|GMT)$", cell.strip()) for cell in cells]
        local = any(zone and zone[1].strip("+-:0") not in ("", "Z", "UTC", "GMT") for zone in zones)
        if local and None in zones:  # nobody knows whether those without a zone are UTC
            what = "other times of this file have a time zone and this one has none"
            raise refused(what, zones.index(None), "give each its zone, or Z for UTC")
        epoch = fixed or moments[0]
        return np.array([(moment - epoch).total_seconds() for moment in moments]), epoch
    numbers = np.array([plain_number(cell) for cell in cells]) * form.time_scale_s
    if (bad := ~(np.abs(numbers) <= LATEST_UNIX_S)).any():
        kind = "Unix seconds" if form.time_format == "unix" else "seconds"
        do = "correct it, or set time_format under [telemetry] in the vehicle file"
        raise refused(f"{kind} is expected", int(bad.argmax()), do)
    if form.time_format == "elapsed":
        if fixed is None and received is not None and np.isfinite(received).any():
            fixed = UNIX_ZERO + timedelta(seconds=round(float(np.nanmedian(received - numbers)), 3))
        if fixed is None:
            what = "elapsed times need telemetry.epoch_utc in the vehicle file"
            raise TelemetryError(what)
        return numbers, fixed
    epoch = fixed or UNIX_ZERO + timedelta(seconds=float(numbers[0]))
    return numbers - (epoch - UNIX_ZERO).total_seconds(), epoch


def _how_to_write(cell: str) -> str:
    """What to do with a cell that is no time in UTC."""
    size = abs(plain_number(cell))
    if size > LATEST_UNIX_S:
        return 'if it is Unix time in milliseconds, set time_format = "unix" and time_scale_s = 0.001 under [telemetry]'
    if np.isfinite(size):
        return 'if it is in seconds, set time_format = "unix" (since 1970) or "elapsed" under [telemetry] in the vehicle file'
    if re.search(r":\d\d:60(?!\d)", cell):
        return "leap seconds are not known: write the second before or after, or remove the row"
    return (
        "write it as 2026-01-31T23:59:59Z, or set time_format under [telemetry] in the vehicle file"
    )


def _in_order(
    form: TelemetryForm, table: Table, time: np.ndarray, epoch: datetime, read: set[str]
) -> tuple[Table, np.ndarray, datetime, dict[str, int]]:
    """Rows sorted by time, those of one instant that do not contradict each other in what is `read` merged (the station's name may
    differ, and when it heard them); and how many were moved and merged."""
    order = np.argsort(time, kind="stable")
    rows = table.cells.to_numpy(copy=True)
    compared = np.array([name in read for name in table.header])
    kept: list[int] = []
    for i in order:
        if kept and time[i] == time[kept[-1]]:
            first, second = rows[kept[-1]], rows[i]
            empty = np.array([not cell.strip() for cell in first])
            differ = (first != second) & ~empty & np.array([bool(cell.strip()) for cell in second])
            if not (differ & compared).any():
                rows[kept[-1]] = np.where(empty, second, first)
                continue
        kept.append(int(i))
    late = int(np.count_nonzero(time[1:] < np.maximum.accumulate(time)[:-1]))
    counts = {"rows_sorted": late, "rows_merged": len(time) - len(kept)}
    if not any(counts.values()):
        return table, time, epoch, {}
    time = time[kept]
    if form.epoch_utc is None and form.time_format != "elapsed":
        epoch, time = epoch + timedelta(seconds=float(time[0])), time - time[0]
    cells = pd.DataFrame(rows[kept], table.cells.index[kept], table.header)
    return table._replace(cells=cells), time, epoch, {k: n for k, n in counts.items() if n}


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
            f"column {name!r} ({what}) is missing",
            got="columns " + ", ".join(table.header),
            do=do if near is None else f"did you mean {near!r}? {do[0].upper()}{do[1:]}",
            where=table.where,
        )
    return name


def _nearest(name: str, names: list[str]) -> str | None:
    bare = {re.sub(r"[^a-z0-9+-]", "", each.lower()): each for each in names}
    near = get_close_matches(re.sub(r"[^a-z0-9+-]", "", name.lower()), bare, n=1, cutoff=NEAR)
    return bare[near[0]] if near else None


def _unused_columns(vehicle: Vehicle, table: Table, columns: list[str]) -> list[str]:
    """Columns of the file that nothing reads."""
    form = vehicle.telemetry
    used = {form.time_column, form.receive_time_column, form.voltage_column, "phase", *columns}
    used |= {name for _, _, names in sensor_parts(vehicle) for name in names}
    used |= {*form.temperature_columns.values(), *form.voltage_columns.values()}
    return [name for name in table.header if name not in used]


def _missing_sensors(vehicle: Vehicle, table: Table, unused: list[str]) -> list[str]:
    """Sensors of which the file has no column at all; where it has some, or some that are nearly called so, an error names one."""
    missing = []
    for section, what, names in sensor_parts(vehicle):
        absent = [name for name in names if name not in table.header]
        near = [name for name in absent if _nearest(name, unused)]
        if absent and (len(absent) < len(names) or near):
            column_of(table, (near or absent)[0], what, section, unused)
        if absent:
            missing.append(f"{what} ({', '.join(names)})")
    return missing
