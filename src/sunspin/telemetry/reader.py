"""The only reader of mission files: CSV -> Dataset with flags and provenance, or one sentence on what is wrong.

Column names, units, clock and what to do with bad rows come from the vehicle file (`[telemetry]`), so that nobody has to
rewrite a file to have it read.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import TelemetryError, sentence
from sunspin.base.provenance import provenance
from sunspin.base.tables import Table, read_table
from sunspin.base.untrusted import plain_number
from sunspin.telemetry.columns import column_of, missing_sensors, unused_columns
from sunspin.telemetry.noise import dark_noise
from sunspin.telemetry.panel_unit import UNITS
from sunspin.telemetry.sensors import ABSURD, read_sensors
from sunspin.telemetry.stored import KIND, stored_telemetry
from sunspin.vehicle import TelemetryForm, Vehicle
from sunspin.vehicle.craft import OR_CHANNEL
from sunspin.vehicle.sensors import unwrapped
from sunspin.vehicle.timeline import instant

FLAGS = {0: "good", 1: "not_a_number", 2: "negative", 4: "time_not_increasing"}
"""Bits of `flag`."""

NEGATIVE_SIGMAS = 5.0
"""Values down to minus this many sigma are noise around zero and not an error: of the stated noise, or of the file's own."""

NEGATIVE_SHARE = 0.05
"""Without a stated noise, no value further below zero than this part of full light is taken for noise."""

COLDEST_C, HOTTEST_C = -200.0, 250.0
"""No solar panel in flight is colder or hotter: such a reading is none."""

UNIX_ZERO, LATEST_UNIX_S = datetime(1970, 1, 1, tzinfo=UTC), 1e11

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
        raise TelemetryError(
            sentence(what, do="give the vehicle first and then a table of samples", where=str(path))
        )
    table = read_table(path)
    if table.data is not None and str(table.data.attrs.get("kind")) == KIND:
        return stored_telemetry(table.data, vehicle, path)
    if (
        "frame" in table.header
        and form.time_column not in table.header
        and set(table.header) & {"timestamp", "observer"}
    ):
        what, do = (
            "the file holds raw frames and no readings",
            "turn them into a table first, as `sunspin decode` does for skCUBE",
        )
        raise TelemetryError(sentence(what, do=do, where=str(path)))
    sensors = read_sensors(vehicle, table)
    columns = _panel_columns(vehicle, table, path, optional=bool(sensors))
    time_at = column_of(table, form.time_column, "the time", path)
    received = _received(form, table, path)
    time, epoch = _times(form, [row[time_at] for row in table.rows], table, path, received)
    mended: dict[str, int] = {}
    if form.bad_rows == "flag":
        apart = {
            form.time_column,
            form.receive_time_column,
            *unused_columns(vehicle, table, columns),
        }
        read = {at for at, name in enumerate(table.header) if name not in apart}
        table, time, epoch, mended = _in_order(form, table, time, epoch, read)
        if mended:
            sensors, received = read_sensors(vehicle, table), _received(form, table, path)
    volts = _volts(vehicle, table, path) if columns and form.has_voltages else None
    values, flag = _values(form, table, columns, volts)
    values, warmth = _at_reference(vehicle, table, values, path)
    flag |= _order_flags(form, time, table, path)
    unused, missing = (
        unused_columns(vehicle, table, columns),
        missing_sensors(vehicle, table, columns, path),
    )
    if received is not None:
        about = {
            "units": "s",
            "long_name": "when the row was received, from the epoch of the times",
        }
        sensors["received_s"] = ("time", received - (epoch - UNIX_ZERO).total_seconds(), about)
    return _dataset(vehicle, path, table, time, epoch, values, flag, sensors | warmth).assign_attrs(
        unused_columns=", ".join(unused), missing_sensors="; ".join(missing), **mended
    )


def _panel_columns(vehicle: Vehicle, table: Table, path: Path, optional: bool = False) -> list[int]:
    powers = vehicle.telemetry.quantity == "power_W" and not vehicle.telemetry.has_voltages
    letter, unit = ("P", "W") if powers else ("I", "A")
    known = {
        panel: (vehicle.telemetry.columns.get(panel), panel, f"{letter}{panel}_{unit}")
        for panel in vehicle.input_names
    }
    if optional and not any(name in table.header for names in known.values() for name in names):
        return []
    found = []
    for panel, names in known.items():
        present = [name for name in names if name is not None and name in table.header]
        if vehicle.telemetry.columns.get(panel) is not None or not present:
            present = [names[0] or names[2]]
        found.append(column_of(table, present[0], f"panel {panel}", path))
    if twice := [at for at in found if found.count(at) > 1]:
        what = "two panels read one column"
        do = f"name the column of each under [telemetry.columns] in the vehicle file{OR_CHANNEL}"
        raise TelemetryError(sentence(what, got=table.header[twice[0]], do=do, where=str(path)))
    return found


def _volts(vehicle: Vehicle, table: Table, path: Path) -> np.ndarray:
    """Voltage (n, n_panel) of each current."""
    form = vehicle.telemetry
    names = [
        form.voltage_columns.get(panel, form.voltage_column or "") for panel in vehicle.input_names
    ]
    at = [
        column_of(table, name, f"voltage of panel {panel}", path)
        for name, panel in zip(names, vehicle.input_names, strict=True)
    ]
    volts = form.voltage_scale * table.numbers(at)
    volts = np.where((volts >= 0) & (volts < ABSURD), volts, np.nan)
    if form.bad_rows == "refuse" and not np.isfinite(volts).all():
        i, k = np.argwhere(~np.isfinite(volts))[0]
        raise _refused("a voltage is a number, zero or above", table, i, at[k])
    return volts


def _refused(what: str, table: Table, row: int, column: int) -> TelemetryError:
    """The error for a cell that cannot be used."""
    return TelemetryError(
        sentence(
            what,
            got=table.rows[row][column] or "an empty cell",
            do='correct it, or set bad_rows = "flag" under [telemetry] in the vehicle file',
            where=table.place(row, column),
        )
    )


def _values(
    form: TelemetryForm, table: Table, columns: list[int], volts: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    values = table.numbers(columns)
    values = np.where(np.abs(values) < ABSURD, values, np.nan)
    values = (unwrapped(values, form.wraps_at) - form.zero) * form.scale
    values = values if volts is None else values * volts
    floor = _floor(form, values)
    flag = np.zeros(len(values), dtype=np.uint8)
    problems = (
        (1, ~np.isfinite(values), "a finite number is expected"),
        (2, np.isfinite(values) & (values < floor), "a panel cannot give a negative value"),
    )
    for bit, bad, what in problems:
        if form.bad_rows == "refuse" and bad.any():
            i, k = np.argwhere(bad)[0]
            raise _refused(what, table, i, columns[k])
        flag |= np.where(bad.any(axis=1), np.uint8(bit), np.uint8(0))
    return values, flag


def _floor(form: TelemetryForm, values: np.ndarray) -> float:
    """The lowest value that is still noise of a dark panel: of the stated noise, or of that which the file tells."""
    if form.noise is not None:
        return -NEGATIVE_SIGMAS * form.noise
    sigma = dark_noise(values, least=1)
    if sigma is None:
        return 0.0
    full = float(np.quantile(np.nanmax(np.where(np.isfinite(values), values, 0.0), axis=1), 0.9))
    return -min(NEGATIVE_SIGMAS * sigma, NEGATIVE_SHARE * max(full, 0.0))


def _at_reference(
    vehicle: Vehicle, table: Table, values: np.ndarray, path: Path
) -> tuple[np.ndarray, dict[str, Any]]:
    """Values at the panels' reference temperature, and the temperatures; a panel without a reading takes the others' mean."""
    form = vehicle.telemetry
    if not form.temperature_columns or not values.shape[1]:
        return values, {}
    strange = [name for name in form.temperature_columns if name not in vehicle.input_names]
    if strange:
        raise TelemetryError(
            sentence(
                "telemetry.temperature_columns names a panel that the vehicle has not",
                got=strange[0],
            )
        )
    warm = np.full(values.shape, np.nan)
    for panel, name in form.temperature_columns.items():
        at = column_of(table, name, f"temperature of panel {panel}", path)
        warm[:, vehicle.input_names.index(panel)] = table.numbers([at])[:, 0]
    warm *= form.temperature_scale
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


def _received(form: TelemetryForm, table: Table, path: Path) -> np.ndarray | None:
    """When each row (n) was received, Unix seconds; NaN where it does not say; None if no column says."""
    name = form.receive_time_column
    if name is None:
        return None
    at = column_of(table, name, "the time of reception", path)
    cells = [row[at] for row in table.rows]
    if form.receive_time_format == "unix":
        seconds = np.array([plain_number(cell) for cell in cells])
        return np.where(np.abs(seconds) < LATEST_UNIX_S, seconds, np.nan)
    moments = [parse_utc(cell) for cell in cells]
    return np.array(
        [np.nan if moment is None else (moment - UNIX_ZERO).total_seconds() for moment in moments]
    )


def _times(
    form: TelemetryForm, cells: list[str], table: Table, path: Path, received: np.ndarray | None
) -> tuple[np.ndarray, datetime]:
    """Seconds from the epoch, and the epoch: the vehicle's, else by when rows were received, else the first sample."""
    fixed = None if form.epoch_utc is None else parse_utc(form.epoch_utc)
    if form.epoch_utc is not None and fixed is None:
        raise TelemetryError(
            sentence(
                "telemetry.epoch_utc of the vehicle is not an ISO-8601 time", got=form.epoch_utc
            )
        )
    kind = {"utc": "an ISO-8601 UTC time", "unix": "Unix seconds", "elapsed": "seconds"}[
        form.time_format
    ]

    def bad(i: int) -> TelemetryError:
        return TelemetryError(
            sentence(
                f"{kind} is expected",
                got=cells[i] or "an empty cell",
                do=_how_to_write(cells[i]) if form.time_format == "utc" else OTHER_FORM,
                where=f"{path}, line {table.lines[i]}, column {form.time_column!r}",
            )
        )

    if form.time_format == "utc":
        parsed = [parse_utc(cell) for cell in cells]
        moments = [moment for moment in parsed if moment is not None]
        if len(moments) < len(parsed):
            raise bad(parsed.index(None))
        _one_clock(cells, table, path, form)
        epoch = fixed or moments[0]
        return np.array([(moment - epoch).total_seconds() for moment in moments]), epoch
    numbers = np.array([plain_number(cell) for cell in cells]) * form.time_scale_s
    if not np.all(np.isfinite(numbers)) or np.abs(numbers).max() > LATEST_UNIX_S:
        raise bad(int(np.flatnonzero(~(np.abs(numbers) <= LATEST_UNIX_S))[0]))
    if form.time_format == "elapsed":
        if fixed is None and received is not None and np.isfinite(received).any():
            fixed = UNIX_ZERO + timedelta(seconds=round(float(np.nanmedian(received - numbers)), 3))
        if fixed is None:
            raise TelemetryError(
                sentence("elapsed times need telemetry.epoch_utc in the vehicle file")
            )
        return numbers, fixed
    epoch = fixed or UNIX_ZERO + timedelta(seconds=float(numbers[0]))
    return numbers - (epoch - UNIX_ZERO).total_seconds(), epoch


OTHER_FORM = "correct it, or set time_format under [telemetry] in the vehicle file"


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


def _one_clock(cells: list[str], table: Table, path: Path, form: TelemetryForm) -> None:
    """Refuse times with a zone other than UTC beside times without any: of the latter nobody knows whether they are UTC."""
    zones = [re.search(r":.*([+-]\d\d:?\d\d|Z|UTC|GMT)$", cell.strip()) for cell in cells]
    local = any(zone and zone[1].strip("+-:0") not in ("", "Z", "UTC", "GMT") for zone in zones)
    if local and None in zones:
        i = zones.index(None)
        raise TelemetryError(
            sentence(
                "other times of this file have a time zone and this one has none",
                got=cells[i],
                do="give each its zone, or Z for UTC",
                where=f"{path}, line {table.lines[i]}, column {form.time_column!r}",
            )
        )


def _in_order(
    form: TelemetryForm, table: Table, time: np.ndarray, epoch: datetime, read: set[int]
) -> tuple[Table, np.ndarray, datetime, dict[str, int]]:
    """Rows sorted by time, those of one instant that do not contradict each other in what is `read` merged (the station's name may
    differ, and when it heard them); and how many were moved and merged."""
    rows: list[list[str]] = []
    kept: list[int] = []
    for i in np.argsort(time, kind="stable"):
        if (
            kept
            and time[i] == time[kept[-1]]
            and (both := _merged(rows[-1], table.rows[i], read)) is not None
        ):
            rows[-1] = both
        else:
            rows.append(table.rows[i])
            kept.append(int(i))
    late = int(np.count_nonzero(time[1:] < np.maximum.accumulate(time)[:-1]))
    counts = {"rows_sorted": late, "rows_merged": len(time) - len(kept)}
    if not any(counts.values()):
        return table, time, epoch, {}
    time = time[kept]
    if form.epoch_utc is None and form.time_format != "elapsed":
        epoch, time = epoch + timedelta(seconds=float(time[0])), time - time[0]
    return (
        table._replace(rows=rows, lines=[table.lines[i] for i in kept]),
        time,
        epoch,
        {k: n for k, n in counts.items() if n},
    )


def _merged(first: list[str], second: list[str], read: set[int]) -> list[str] | None:
    """Two rows of one instant as one, with each other's empty cells filled; None where they contradict each other."""
    cells = enumerate(zip(first, second, strict=True))
    if any(a != b and a.strip() and b.strip() for k, (a, b) in cells if k in read):
        return None
    return [a if a.strip() else b for a, b in zip(first, second, strict=True)]


def _order_flags(form: TelemetryForm, time: np.ndarray, table: Table, path: Path) -> np.ndarray:
    latest = np.maximum.accumulate(time)
    late = np.concatenate([[False], time[1:] <= latest[:-1]])
    if form.bad_rows == "refuse" and late.any():
        i = int(np.flatnonzero(late)[0])
        raise TelemetryError(
            sentence(
                "time does not increase",
                got=table.rows[i][table.header.index(form.time_column)],
                do='sort the rows and remove repeats, or set bad_rows = "flag" under [telemetry] in the vehicle file',
                where=f"{path}, line {table.lines[i]}",
            )
        )
    return np.where(late, np.uint8(4), np.uint8(0))


def _dataset(vehicle, path, table, time, epoch, values, flag, sensors) -> xr.Dataset:
    form = vehicle.telemetry
    coords: dict[str, Any] = {
        "time": ("time", time, {"units": "s", "long_name": "time since the epoch"}),
        "panel": list(vehicle.input_names),
    }
    if "phase" in table.header:
        at = table.header.index("phase")
        coords["phase"] = ("time", np.array([row[at].strip() for row in table.rows], dtype=np.str_))
    attrs = provenance("telemetry", **vehicle.said) | {
        "epoch_utc": epoch.isoformat().replace("+00:00", "Z"),
        "quantity": form.quantity,
        "file": path.name.encode("utf-8", "backslashreplace").decode(
            "utf-8"
        ),  # attributes hold no half characters
        "sha256": table.sha256,
        "comments": "\n".join(table.comments),
        "synthetic": int(
            any(comment.lower().startswith("synthetic") for comment in table.comments)
        ),
    }
    flags = {
        "flag_masks": [k for k in FLAGS if k],
        "flag_meanings": " ".join(v for k, v in FLAGS.items() if k),
    }
    panels = (
        {form.quantity: (("time", "panel"), values, {"units": UNITS[form.quantity]})}
        if values.shape[1]
        else {}
    )
    if not panels:
        del coords["panel"]
    if sensors:
        coords["axis"] = ["x", "y", "z"]
    return xr.Dataset(
        {**panels, "flag": ("time", flag, flags), **sensors},
        coords=coords,
        attrs=attrs,
    )
