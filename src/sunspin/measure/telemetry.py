"""The only reader of mission files: CSV -> Dataset with flags and provenance, or one sentence on what is wrong.

Column names, units, clock and what to do with bad rows come from the vehicle file (`[telemetry]`), so that nobody has to
rewrite a file to have it read.
"""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.errors import TelemetryError, sentence
from sunspin.vehicle import TelemetryForm, Vehicle

MAX_FILE_BYTES = 500_000_000
"""A year of 1 Hz samples of six panels is about this much."""

FLAGS = {0: "good", 1: "not_a_number", 2: "negative", 4: "time_not_increasing"}
"""Bits of `flag`."""

NEGATIVE_SIGMAS = 5.0
"""With a stated noise, values down to minus this many sigma are noise around zero and not an error."""

UNITS = {"power_W": "W", "current_A": "A"}


class Table(NamedTuple):
    """A CSV file as text: header, rows of cells, the line each row stands on, comments, hash."""

    header: list[str]
    rows: list[list[str]]
    lines: list[int]
    comments: list[str]
    sha256: str


def read_telemetry(path: Any, vehicle: Vehicle) -> xr.Dataset:
    """Read panel powers or currents from a CSV file.

    Parameters
    ----------
    path : str or path
    vehicle : Vehicle
        Its `telemetry` says which columns, unit, clock; its panels which columns must be there.

    Returns
    -------
    xarray.Dataset
        `power_W` (or `current_A`) over (time, panel), `flag (time)` (bits, 0 is good), coordinate `time` in s from
        ``attrs["epoch_utc"]``, `phase (time)` where the file has such a column; attrs name the file, its hash and whether
        it calls itself synthetic.

    Raises
    ------
    TelemetryError
        Naming file, line, column, what was found and what to do.
    """
    path = Path(path)
    vehicle.require_panels()
    form = vehicle.telemetry
    table = _read_table(path)
    columns = _panel_columns(vehicle, table, path)
    time_at = _column(table, form.time_column, "the time", path)
    time, epoch = _times(form, [row[time_at] for row in table.rows], table, path)
    values, flag = _values(form, table, columns, path)
    flag |= _order_flags(form, time, table, path)
    return _dataset(vehicle, path, table, time, epoch, values, flag)


def _read_table(path: Path) -> Table:
    where = str(path)
    try:
        if path.is_dir():
            raise TelemetryError(sentence("this is a folder, not a telemetry file", where=where))
        if path.stat().st_size > MAX_FILE_BYTES:
            raise TelemetryError(
                sentence(f"the file is larger than {MAX_FILE_BYTES / 1e6:.0f} MB", do="cut it into parts", where=where)
            )
        content = path.read_bytes()
    except OSError as error:
        raise TelemetryError(
            sentence(f"the file cannot be read ({error.strerror or error})", do="check the path", where=where)
        ) from None
    except ValueError as error:
        raise TelemetryError(sentence(f"this is not a path ({error})", where=repr(where))) from None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise TelemetryError(
            sentence("the file is not UTF-8 text", do="save it as CSV in UTF-8", where=f"{where}, line {line}")
        ) from None
    if not text.strip():
        raise TelemetryError(sentence("the file is empty", do="a CSV with a header and one row per sample", where=where))
    if "\0" in text:
        raise TelemetryError(sentence("the file holds binary data", do="save it as CSV in UTF-8", where=where))
    return _split(text, where, hashlib.sha256(content).hexdigest())


def _split(text: str, where: str, sha256: str) -> Table:
    comments: list[str] = []
    lines = text.splitlines()
    skipped = 0
    while skipped < len(lines) and (lines[skipped].startswith("#") or not lines[skipped].strip()):
        comments.append(lines[skipped].lstrip("# ").strip())
        skipped += 1
    reader = csv.reader(lines[skipped:], strict=True)
    records = _records(reader, skipped, where)
    header = next(records, (0, []))[1]
    header = [cell.strip() for cell in header]
    rows, numbers = [], []
    for number, cells in records:
        if len(cells) != len(header):
            raise TelemetryError(
                sentence(
                    f"the row has {len(cells)} values but the header names {len(header)} columns",
                    do="complete or remove the row",
                    where=f"{where}, line {number}",
                )
            )
        rows.append(cells)
        numbers.append(number)
    if not rows:
        raise TelemetryError(sentence("the file has a header but no samples", where=where))
    repeated = sorted({name for name in header if header.count(name) > 1})
    if repeated:
        raise TelemetryError(sentence("two columns share a name", got=repeated[0], do="rename one", where=where))
    return Table(header, rows, numbers, [c for c in comments if c], sha256)


def _records(reader: Any, skipped: int, where: str) -> Iterator[tuple[int, list[str]]]:
    while True:
        try:
            cells = next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            raise TelemetryError(
                sentence(f"this is not valid CSV ({error})", where=f"{where}, line {skipped + reader.line_num}")
            ) from None
        if cells and any(cell.strip() for cell in cells):
            yield skipped + reader.line_num, cells


def _column(table: Table, name: str, what: str, path: Path) -> int:
    if name not in table.header:
        raise TelemetryError(
            sentence(
                f"column {name!r} ({what}) is missing",
                got="columns " + ", ".join(table.header),
                do="add it, or name the right column under [telemetry] in the vehicle file",
                where=str(path),
            )
        )
    return table.header.index(name)


def _panel_columns(vehicle: Vehicle, table: Table, path: Path) -> list[int]:
    letter, unit = ("P", "W") if vehicle.telemetry.quantity == "power_W" else ("I", "A")
    found = []
    for panel in vehicle.panel_names:
        names = [vehicle.telemetry.columns.get(panel), panel, f"{letter}{panel}_{unit}"]
        present = [name for name in names if name is not None and name in table.header]
        if vehicle.telemetry.columns.get(panel) is not None or not present:
            present = [names[0] or names[2]]
        found.append(_column(table, present[0], f"panel {panel}", path))
    return found


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan


def _values(form: TelemetryForm, table: Table, columns: list[int], path: Path) -> tuple[np.ndarray, np.ndarray]:
    values = np.array([[_number(row[column]) for column in columns] for row in table.rows]) * form.scale
    floor = -NEGATIVE_SIGMAS * form.noise if form.noise is not None else 0.0
    flag = np.zeros(len(values), dtype=np.uint8)
    problems = (
        (1, ~np.isfinite(values), "a finite number is expected"),
        (2, np.isfinite(values) & (values < floor), "a panel cannot give a negative value"),
    )
    for bit, bad, what in problems:
        if form.bad_rows == "refuse" and bad.any():
            i, k = np.argwhere(bad)[0]
            raise TelemetryError(
                sentence(
                    what,
                    got=table.rows[i][columns[k]] or "an empty cell",
                    do='correct it, or set bad_rows = "flag" under [telemetry] in the vehicle file',
                    where=f"{path}, line {table.lines[i]}, column {table.header[columns[k]]!r}",
                )
            )
        flag |= np.where(bad.any(axis=1), np.uint8(bit), np.uint8(0))
    return values, flag


def _parse_utc(text: str) -> datetime | None:
    try:
        moment = datetime.fromisoformat(text.strip())
    except ValueError:
        return None
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)


def _times(form: TelemetryForm, cells: list[str], table: Table, path: Path) -> tuple[np.ndarray, datetime]:
    """Seconds from the epoch, and the epoch: the vehicle's, else the first sample."""
    fixed = None if form.epoch_utc is None else _parse_utc(form.epoch_utc)
    if form.epoch_utc is not None and fixed is None:
        raise TelemetryError(sentence("telemetry.epoch_utc of the vehicle is not an ISO-8601 time", got=form.epoch_utc))
    kind = {"utc": "an ISO-8601 UTC time", "unix": "Unix seconds", "elapsed": "seconds"}[form.time_format]

    def bad(i: int) -> TelemetryError:
        return TelemetryError(
            sentence(
                f"{kind} is expected",
                got=cells[i] or "an empty cell",
                do="correct it, or set time_format under [telemetry] in the vehicle file",
                where=f"{path}, line {table.lines[i]}, column {form.time_column!r}",
            )
        )

    if form.time_format == "utc":
        moments = [_parse_utc(cell) for cell in cells]
        if None in moments:
            raise bad(moments.index(None))
        epoch = fixed or moments[0]
        return np.array([(moment - epoch).total_seconds() for moment in moments]), epoch
    numbers = np.array([_number(cell) for cell in cells])
    if not np.all(np.isfinite(numbers)) or np.abs(numbers).max() > 1e11:
        raise bad(int(np.flatnonzero(~(np.abs(numbers) <= 1e11))[0]))
    if form.time_format == "elapsed":
        return numbers, fixed
    unix_zero = datetime(1970, 1, 1, tzinfo=UTC)
    epoch = fixed or unix_zero + timedelta(seconds=float(numbers[0]))
    return numbers - (epoch - unix_zero).total_seconds(), epoch


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


def _dataset(vehicle, path, table, time, epoch, values, flag) -> xr.Dataset:
    form = vehicle.telemetry
    coords: dict[str, Any] = {
        "time": ("time", time, {"units": "s", "long_name": "time since the epoch"}),
        "panel": list(vehicle.panel_names),
    }
    if "phase" in table.header:
        at = table.header.index("phase")
        coords["phase"] = ("time", np.array([row[at].strip() for row in table.rows], dtype=np.str_))
    attrs = {
        "vehicle": vehicle.name,
        "epoch_utc": epoch.isoformat().replace("+00:00", "Z"),
        "quantity": form.quantity,
        "file": path.name,
        "sha256": table.sha256,
        "comments": "\n".join(table.comments),
        "synthetic": int(any(comment.lower().startswith("synthetic") for comment in table.comments)),
        "sunspin_version": metadata.version("sunspin"),
    }
    flags = {"flag_masks": [k for k in FLAGS if k], "flag_meanings": " ".join(v for k, v in FLAGS.items() if k)}
    return xr.Dataset(
        {
            form.quantity: (("time", "panel"), values, {"units": UNITS[form.quantity]}),
            "flag": ("time", flag, flags),
        },
        coords=coords,
        attrs=attrs,
    )
