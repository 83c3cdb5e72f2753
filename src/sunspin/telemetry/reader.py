"""The only reader of mission files: table -> Dataset with flags and provenance, or one sentence on what is wrong.

Column names, units, clock and the treatment of bad rows come from the vehicle file (`[telemetry]`), so that files need not be
rewritten.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import timedelta
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from sunspin.base.errors import TelemetryError
from sunspin.base.provenance import provenance
from sunspin.base.tables import TextTable, read_table
from sunspin.telemetry.dates import rewrite_dates
from sunspin.telemetry.fractions import add_fractions, unread_fractions
from sunspin.telemetry.layout import join_packets, pivot_series
from sunspin.telemetry.noise import describe_saturation, find_wrapped_counts, lowest_reading
from sunspin.telemetry.sensors import ABSURD, read_columns, read_sensors, sensor_columns
from sunspin.telemetry.sources import describe_sources
from sunspin.telemetry.stored import KIND, restore_telemetry
from sunspin.telemetry.times import Times, read_received_times, read_times
from sunspin.telemetry.timescales import UNIX_ZERO
from sunspin.telemetry.units import UNITS
from sunspin.vehicle import TelemetryForm, Vehicle
from sunspin.vehicle.craft import CHANNEL_HINT
from sunspin.vehicle.sensors import unwrap_counts

NOT_A_NUMBER, NEGATIVE, NOT_INCREASING = np.uint8(1), np.uint8(2), np.uint8(4)
FLAGS = {0: "good", 1: "not_a_number", 2: "negative", 4: "time_not_increasing"}
"""Bits of `flag`, and their meanings."""

COLDEST_C, HOTTEST_C = -200.0, 250.0
"""Range of temperatures of solar panels in flight; readings outside are left out."""

NEAR = 0.75
"""Similarity of two names (letters and digits only, difflib's ratio) from which one is taken as a misspelling of the other."""


ANGLES = {
    "elevation_deg": (-90.0, 90.0, 10.0, "an elevation (deg)"),
    "incidence_deg": (0.0, 180.0, 10.0, "an angle from the normal (deg)"),
    "cosine": (-1.0, 1.0, 0.2, "a cosine"),
}
"""Quantity of angles of the Sun -> smallest and largest value, how far noise may go beyond them, and its name in messages."""

LEAST_LARGEST_DEG = 4.0
"""The largest angle (deg) of a file is larger, and the largest one in rad (pi) is smaller: cubes have the Sun above 35 deg."""

LEAST_FACTOR = 0.2
"""A temperature correction below this is not applied, because the linear law does not hold."""


class MissingColumn(TelemetryError):
    """A telemetry file lacks a column that the vehicle file names."""


def read_telemetry(path: Any, vehicle: Vehicle, *, columns: Sequence[str] = ()) -> xr.Dataset:
    """Read panel readings, Sun sensors, gyro and magnetometer from a CSV, JSON lines, Parquet or NetCDF file.

    Parameters
    ----------
    path : str or path
        Also `telemetry.nc` of a results folder: the telemetry from which the results were computed.
    vehicle : Vehicle
        Its `telemetry` gives columns, units and clock; its panels give the columns that must exist. A file with columns of the
        vehicle's sensors need not have columns of panels.
    columns : list of str, optional
        Further columns of the file, such as a light curve; their numbers become `column_reading (time, column)`.

    Returns
    -------
    xarray.Dataset
        `power_W` (or `current_A`) over (time, panel); for angles of the Sun `power_W` holds gain times cosine.
        `flag (time)`: bits, 0 is good; coordinate `time` in s from
        ``attrs["epoch_utc"]``. `phase (time)` and `received_s (time)` if the file has such columns. The variables of
        :func:`sunspin.telemetry.sensors.read_sensors`.

        attrs name the file, its hash, whether it calls itself synthetic, its `unused_columns`, and `missing_sensors`, which have no
        column. `clock_notes`, if present, has one sentence in each line on how rows became samples, on assumptions about the clock
        and on its restarts.

        With ``bad_rows = "flag"`` or "sort" rows are sorted by time. Rows of one instant without contradictions are merged, for
        example if several ground stations received a frame. Rows with dates years from all others are left out. attrs
        `rows_sorted`, `rows_merged` and `rows_misdated` count these rows. Rows are also left out if only unused columns have a
        value, such as temperatures at times of their own; `rows_of_others` counts them.

    Raises
    ------
    TelemetryError
        The file cannot be read. The message names file, line and column, the offending value and what to do.
    """
    path = Path(path)
    if not (vehicle.sensors.sun_sensors or vehicle.sensors.sun_vector or vehicle.sensors.gyro):
        vehicle.require_panels()
    form = vehicle.telemetry  # columns, units and clock of the file
    if path.suffix == ".toml":
        what = "this is a vehicle's file and not telemetry"
        do = "give the vehicle first and then a table of samples"
        raise TelemetryError(what, do=do, where=str(path))
    table = read_table(path)
    if table.data is not None and str(table.data.attrs.get("kind")) == KIND:
        if columns:
            what, do = (
                "a results folder keeps the columns of sensors only",
                "give the original file",
            )
            raise TelemetryError(what, got=", ".join(columns), do=do, where=str(path))
        return restore_telemetry(table.data, vehicle, path)
    header = set(table.header)
    if "frame" in header and form.time_column not in header and header & {"timestamp", "observer"}:
        what = "the file holds raw frames and no readings"
        do = "turn them into a table first with `sunspin decode`"
        raise TelemetryError(what, do=do, where=str(path))
    if form.date_column is not None:
        require_column(table, form.date_column, "the date")
    if form.fraction_column is not None:
        require_column(table, form.fraction_column, "the fraction of a second")
    table = add_fractions(form, rewrite_dates(form, table))
    table, layout_notes = pivot_series(table, form.time_column, columns_of_readings(vehicle))
    header = set(table.header)
    # read here too, as a file of sensors alone needs no column of a panel
    sensors = read_sensors(vehicle, table)
    panel_columns = _panel_columns(vehicle, table, optional=bool(sensors))
    for name in columns:
        require_column(table, name, "a column that is asked for")
    _require_clock(form, table)
    unused = _unused_columns(vehicle, table, [*panel_columns, *columns])
    layout_notes += table.notes + unread_fractions(form, table, unused)
    reading_columns = header - {*_clock_columns(form), *unused}
    times, counts = read_times(form, table, reading_columns), {}
    if form.bad_rows != "refuse":
        table, times, n_others = _leave_out_others(form, table, times, reading_columns)
        table, times, counts = _sort_and_merge(form, table, times, reading_columns)
        counts |= {"rows_of_others": n_others} if n_others else {}
        if counts:  # the rows of the table have changed
            sensors = read_sensors(vehicle, table)
    if form.sample_span_s is not None:
        _find_late_rows(form, table, times.time)  # refuses falling times, if it must
        (table, packet_notes), rows = join_packets(
            table, times.time, form.sample_span_s, reading_columns
        )
        times, sensors = times.take(rows), read_sensors(vehicle, table)
        layout_notes += packet_notes
    time, epoch, received = times.time, times.epoch, times.received
    sensors |= read_columns(table, columns)
    values, flag, saturation = _read_panels(vehicle, table, panel_columns)
    layout_notes += describe_sources(table, time, unused, values) + saturation
    values, temperatures = _correct_for_temperature(vehicle, table, values)
    flag |= np.where(_find_late_rows(form, table, time), NOT_INCREASING, np.uint8(0))
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
        if form.has_angles:
            about = {
                "units": "1",
                "long_name": "gain times cosine of the Sun's angle from the panel's normal",
            }
        readings[form.variable] = (("time", "panel"), values, about)
    if "phase" in table.header:
        phase = [cell.strip() for cell in table.cells["phase"]]
        coords["phase"] = ("time", np.array(phase, dtype=np.str_))
    if columns:
        coords["column"] = list(columns)
    if sensors or temperatures:
        coords["axis"] = ["x", "y", "z"]
    bits = [bit for bit in FLAGS if bit]
    flag_attrs = {"flag_masks": bits, "flag_meanings": " ".join(FLAGS[bit] for bit in bits)}
    readings["flag"] = ("time", flag, flag_attrs)
    attrs = provenance("telemetry", **vehicle.result_attributes) | {
        "quantity": form.quantity,
        "sha256": table.sha256,
        "comments": "\n".join(table.comments),
        "synthetic": int(any(text.lower().startswith("synthetic") for text in table.comments)),
        "epoch_utc": epoch.isoformat().replace("+00:00", "Z"),
        "file": path.name.encode("utf-8", "backslashreplace").decode("utf-8"),
        "unused_columns": ", ".join(unused),
        "missing_sensors": "; ".join(missing),
    }
    if notes := (*layout_notes, *times.notes):
        attrs["clock_notes"] = "\n".join(notes)
    return xr.Dataset(readings | sensors | temperatures, coords, attrs | counts)


def _find_late_rows(form: TelemetryForm, table: TextTable, time: np.ndarray) -> np.ndarray:
    """Return the rows (n) whose time (n, s) is not later than all times before it.

    Raises
    ------
    TelemetryError
        There is such a row, and the vehicle file sets ``bad_rows = "refuse"``.
    """
    late = np.concatenate([[False], time[1:] <= np.maximum.accumulate(time)[:-1]])
    if form.bad_rows == "refuse" and late.any():
        row = int(late.argmax())
        got, where = (
            table.cells[form.time_column].iat[row],
            f"{table.where}, {table.row_place(row)}",
        )
        do = 'sort the rows and remove repeats, or set bad_rows = "flag" under [telemetry] in the vehicle file'
        raise TelemetryError("time does not increase", got=got, do=do, where=where)
    return late


def columns_of_readings(vehicle: Vehicle) -> set[str]:
    """Return the names of all columns with readings that the vehicle file reads, panels under each of their default names."""
    form = vehicle.telemetry
    names = {name for sensor in sensor_columns(vehicle) for name in sensor.columns}
    names |= {*form.temperature_columns.values(), *form.voltage_columns.values()}
    for panel in vehicle.input_names:
        default_names = {panel, f"P{panel}_W", f"I{panel}_A"}
        names |= {form.columns[panel]} if panel in form.columns else default_names
    return names


def _panel_columns(vehicle: Vehicle, table: TextTable, optional: bool) -> list[str]:
    """Return the name of the column of each input (panel or channel); an empty list if `optional` and the table has none of them.

    The name is that stated in `[telemetry.columns]`; else that of the input, as Xp, if the table has it; else, for powers and
    currents, one with quantity and unit, as PXp_W or IXp_A.

    Raises
    ------
    TelemetryError
        A column is missing, or two inputs have the same one.
    """
    form = vehicle.telemetry
    # with voltages the columns hold currents, from which powers are computed later
    has_powers = form.quantity == "power_W" and not form.has_voltages
    letter, unit = ("P", "W") if has_powers else ("I", "A")
    names = {}
    default_names = {panel: (panel, f"{letter}{panel}_{unit}") for panel in vehicle.input_names}
    if form.has_angles:
        default_names = {panel: (panel, panel) for panel in vehicle.input_names}
    for panel, (short, long) in default_names.items():
        names[panel] = form.columns.get(panel) or (short if short in table.header else long)
    known_names = {*names.values(), *(name for pair in default_names.values() for name in pair)}
    if optional and not known_names & set(table.header):
        return []
    columns = [require_column(table, name, f"panel {panel}") for panel, name in names.items()]
    if duplicates := [name for name in columns if columns.count(name) > 1]:
        what = "two panels read one column"
        do = f"name the column of each under [telemetry.columns] in the vehicle file{CHANNEL_HINT}"
        raise TelemetryError(what, got=duplicates[0], do=do, where=table.where)
    return columns


def _refuse_bad_cells(
    form: TelemetryForm, what: str, bad: np.ndarray, table: TextTable, names: list[str]
) -> None:
    """Raise a `TelemetryError` for the first bad cell (n, n_column) of the columns `names`, if ``bad_rows = "refuse"``."""
    if form.bad_rows == "refuse" and bad.any():
        row, k = np.argwhere(bad)[0]
        got = table.cells[names[k]].iat[row] or "an empty cell"
        do = 'correct it, or set bad_rows = "flag" under [telemetry] in the vehicle file'
        raise TelemetryError(what, got=got, do=do, where=table.place(row, names[k]))


def _read_panels(
    vehicle: Vehicle, table: TextTable, columns: list[str]
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Return the panel readings (n, n_input) in W or A, NaN if missing, the flag (n) of each row (bits of `FLAGS`), and sentences
    on saturated readings.

    Raises
    ------
    TelemetryError
        A column of voltages is missing. With ``bad_rows = "refuse"`` also: a cell is not a number, or negative beyond noise.
    """
    form = vehicle.telemetry
    values = table.numbers(columns)
    values = np.where(np.abs(values) < ABSURD, values, np.nan)
    if form.wraps_at is None and columns and (full := find_wrapped_counts(values)):
        what = f"readings up to {np.nanmax(values):.0f} look like negative numbers of a converter"
        do = f"set wraps_at = {full} under [telemetry]"
        raise TelemetryError(what, do=do, where=table.where)
    has_counts = form.wraps_at is None and not form.has_angles
    saturation = describe_saturation(values, columns) if has_counts else ()
    values = (unwrap_counts(values, form.wraps_at) - form.zero) * form.scale
    if columns and form.has_voltages:  # the values are currents: power is current times voltage
        common_column = form.voltage_column or ""
        names = [
            require_column(
                table, form.voltage_columns.get(panel, common_column), f"voltage of panel {panel}"
            )
            for panel in vehicle.input_names
        ]
        volts = form.voltage_scale * table.numbers(names)
        volts = np.where((volts >= 0) & (volts < ABSURD), volts, np.nan)
        what = "a voltage is a number, zero or above"
        _refuse_bad_cells(form, what, ~np.isfinite(volts), table, names)
        values = values * volts
    if form.has_angles and columns:
        values = _signals_of_angles(vehicle, table, columns, values)
    missing, negative = ~np.isfinite(values), values < lowest_reading(vehicle, values)
    _refuse_bad_cells(form, "a finite number is expected", missing, table, columns)
    _refuse_bad_cells(form, "a panel cannot give a negative value", negative, table, columns)
    flag = NOT_A_NUMBER * missing.any(axis=1) | NEGATIVE * negative.any(axis=1)
    return values, flag, saturation


def _signals_of_angles(
    vehicle: Vehicle, table: TextTable, columns: list[str], values: np.ndarray
) -> np.ndarray:
    """Return the readings (n, n_panel) of flat panels that have the Sun at these angles (deg), or with these cosines.

    A reading is the panel's gain times the cosine of the angle of incidence. If the Sun is below the plane of the panel it is
    zero, as in the dark.

    Raises
    ------
    TelemetryError
        A value is no such angle (with ``bad_rows = "refuse"``), or all angles are so small that they must be in rad.
    """
    quantity = vehicle.telemetry.quantity
    low, high, beyond, text = ANGLES[quantity]
    outside = (values < low - beyond) | (values > high + beyond)
    what = f"{text} lies between {low:g} and {high:g}, after scale and zero under [telemetry]"
    _refuse_bad_cells(vehicle.telemetry, what, outside, table, columns)
    known = np.where(outside, np.nan, values)
    largest = float(np.nanmax(np.abs(known), initial=0.0))
    if quantity == "cosine":
        return vehicle.input_gains * np.maximum(known, 0.0)
    if 0 < largest < LEAST_LARGEST_DEG:
        what = "the angles of the Sun do not look like degrees"
        do = 'set scale = 57.29578 under [telemetry] for rad, or quantity = "cosine"'
        got = f"{largest:.3g} as the largest one"
        raise TelemetryError(what, got=got, do=do, where=table.where)
    elevation = known if quantity == "elevation_deg" else 90.0 - known
    sine = np.sin(np.radians(np.clip(elevation, -90.0, 90.0)))
    return vehicle.input_gains * np.maximum(sine, 0.0)


def _correct_for_temperature(
    vehicle: Vehicle, table: TextTable, values: np.ndarray
) -> tuple[np.ndarray, dict[str, Any]]:
    """Return readings (n, n_panel) reduced to the panels' reference temperature, and a dict with the variable of the temperatures.

    A panel without a temperature reading takes the mean of the others in the row, else the reference temperature.
    """
    form, panels = vehicle.telemetry, vehicle.input_names
    if not form.temperature_columns or not values.shape[1]:
        return values, {}
    temperature = np.full(values.shape, np.nan)
    for panel, name in form.temperature_columns.items():
        column = require_column(table, name, f"temperature of panel {panel}")
        temperature[:, panels.index(panel)] = form.temperature_scale * table.numbers([column])[:, 0]
    plausible = (temperature > COLDEST_C) & (temperature < HOTTEST_C)
    temperature = np.where(plausible, temperature, np.nan)
    known = np.isfinite(temperature)
    mean = np.where(known, temperature, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    mean = np.where(known.any(axis=1), mean, form.reference_temperature_C)
    filled = np.where(known, temperature, mean[:, None])
    factor = 1 + form.temperature_coefficient_per_K * (filled - form.reference_temperature_C)
    factor = np.where(factor > LEAST_FACTOR, factor, 1.0)
    about = {"units": "degC", "long_name": "temperature of the panel"}
    return values / factor, {"panel_temperature_C": (("time", "panel"), temperature, about)}


def _clock_columns(form: TelemetryForm) -> list[str]:
    """Return the names of the columns that contain times."""
    names = (form.time_column, form.fraction_column, form.week_column, form.receive_time_column)
    return [name for name in names if name is not None]


def _require_clock(form: TelemetryForm, table: TextTable) -> None:
    """Raise a `TelemetryError` if a column with times is missing."""
    require_column(table, form.time_column, "the time")
    if form.week_column is not None:
        require_column(table, form.week_column, "the GPS week")
    if form.receive_time_column is not None:
        require_column(table, form.receive_time_column, "the time of reception")


def _leave_out_others(
    form: TelemetryForm, table: TextTable, times: Times, reading_columns: set[str]
) -> tuple[TextTable, Times, int]:
    """Return table and times without rows in which only columns that are not used have a value, and the number of these rows.

    Such rows are no samples: temperatures at times of their own, or packets of another instrument. A row without any value is a
    sample whose readings were lost, and is kept. So is a file of nothing but such rows, for the error messages. Without a stated
    epoch, times of dates count from the first row of the result.
    """

    def any_value(names: set[str]) -> np.ndarray:
        columns = [table.cells[name].str.strip().ne("").to_numpy(bool) for name in sorted(names)]
        return np.any(columns, axis=0) if columns else np.zeros(len(table.cells), bool)

    header = set(table.header)
    empty = ~any_value(reading_columns & header)
    if not empty.any():
        return table, times, 0
    of_others = empty & any_value(header - reading_columns - {*_clock_columns(form), "phase"})
    if of_others.all() or not of_others.any():
        return table, times, 0
    table = table._replace(cells=table.cells[~of_others])
    return table, _count_from_first_row(form, times.take(~of_others)), int(of_others.sum())


def _count_from_first_row(form: TelemetryForm, times: Times) -> Times:
    """Return times that count from the first row, as it may have changed, unless the epoch is stated or times are elapsed."""
    if form.epoch_utc is not None or form.time_format == "elapsed":
        return times
    first_s = float(times.time[0])
    return times._replace(time=times.time - first_s, epoch=times.epoch + timedelta(seconds=first_s))


def _sort_and_merge(
    form: TelemetryForm, table: TextTable, times: Times, reading_columns: set[str]
) -> tuple[TextTable, Times, dict[str, int]]:
    """Return table and times sorted by time, and the numbers of rows sorted, merged and left out (only numbers that are not zero).

    Rows of one instant are merged if their `reading_columns` do not contradict each other. Other columns, such as the station or
    the time of reception, may differ. Rows dated by a reset clock are left out. Without a stated epoch, times of dates count from
    the first row of the result.
    """
    time = times.time
    order = np.argsort(time, kind="stable")
    rows = table.cells.to_numpy(copy=True)
    compared = np.array([name in reading_columns for name in table.header])
    kept: list[int] = []  # rows of the result, in the order of time
    for i in order[~times.misdated[order]]:
        if kept and time[i] == time[kept[-1]]:
            first, second = rows[kept[-1]], rows[i]
            empty = np.array([not cell.strip() for cell in first])
            differ = (first != second) & ~empty & np.array([bool(cell.strip()) for cell in second])
            if not (differ & compared).any():
                rows[kept[-1]] = np.where(empty, second, first)  # fill empty cells
                continue
        kept.append(int(i))
    dated = time[~times.misdated]  # in the file's order
    counts = {
        "rows_sorted": int(np.count_nonzero(dated[1:] < np.maximum.accumulate(dated)[:-1])),
        "rows_merged": len(dated) - len(kept),
        "rows_misdated": len(time) - len(dated),
    }
    if not any(counts.values()):
        return table, times, {}
    cells = pd.DataFrame(rows[kept], table.cells.index[kept], table.header)
    table = table._replace(cells=cells)
    received = None if times.received is None else read_received_times(form, table)
    times = _count_from_first_row(form, times._replace(time=time[kept], received=received))
    return table, times, {name: n for name, n in counts.items() if n}


def require_column(
    table: TextTable,
    name: str,
    what: str,
    section: str = "telemetry",
    candidates: list[str] | None = None,
) -> str:
    """Return the name of a column that must exist.

    Parameters
    ----------
    what : str
        Meaning of the column, for the message.
    section : str
        Table of the vehicle file that names the column, for the message.
    candidates : list of str, optional
        Columns of which `name` may be a misspelling; default: all.

    Raises
    ------
    MissingColumn
        There is no such column. The message suggests a similar name, if there is one.
    """
    if name not in table.header:
        near = _find_similar_name(name, table.header if candidates is None else candidates)
        do = f"add it, or name the right column under [{section}] in the vehicle file"
        raise MissingColumn(
            f"column {name!r} ({what}) is missing",
            got="columns " + ", ".join(table.header),
            do=do if near is None else f"did you mean {near!r}? {do[0].upper()}{do[1:]}",
            where=table.where,
        )
    return name


def _find_similar_name(name: str, names: list[str]) -> str | None:
    """Return the most similar of `names`, compared without case and punctuation; None if none is similar enough (`NEAR`).

    Signs count, as +x and -x are two panels.
    """
    name_of_letters = {re.sub(r"[^a-z0-9+-]", "", each.lower()): each for each in names}
    letters = re.sub(r"[^a-z0-9+-]", "", name.lower())
    nearest = get_close_matches(letters, name_of_letters, n=1, cutoff=NEAR)
    return name_of_letters[nearest[0]] if nearest else None


def _unused_columns(vehicle: Vehicle, table: TextTable, columns: list[str]) -> list[str]:
    """Return the columns of the file that are not read; `columns` are those of the panels."""
    form = vehicle.telemetry
    used = {*_clock_columns(form), form.voltage_column, "phase", *columns}
    used |= {name for sensor in sensor_columns(vehicle) for name in sensor.columns}
    used |= {*form.temperature_columns.values(), *form.voltage_columns.values()}
    return [name for name in table.header if name not in used]


def _missing_sensors(vehicle: Vehicle, table: TextTable, unused: list[str]) -> list[str]:
    """Return the sensors that have no column in the file, with their columns in parentheses.

    Raises
    ------
    TelemetryError
        A sensor has only some of its columns, or a column with a similar name.
    """
    missing = []
    for sensor in sensor_columns(vehicle):
        absent = [name for name in sensor.columns if name not in table.header]
        misspelt = [name for name in absent if _find_similar_name(name, unused)]
        if misspelt or 0 < len(absent) < len(sensor.columns):
            # raises the error for a missing column
            require_column(table, (misspelt or absent)[0], sensor.name, sensor.section, unused)
        if absent:
            missing.append(f"{sensor.name} ({', '.join(sensor.columns)})")
    return missing
