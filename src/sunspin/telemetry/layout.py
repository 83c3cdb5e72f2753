"""Files that have no row for each sample: one row for each value, or one row for each packet with the other columns empty.

Both become a table with a row for each sample, as all other readers expect it.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
import pandas as pd

from sunspin.base.errors import TelemetryError
from sunspin.base.series import name_series
from sunspin.base.tables import TextTable
from sunspin.base.untrusted import plain_number
from sunspin.telemetry.times import parse_utc
from sunspin.telemetry.timescales import UNIX_ZERO

VALUE_NAMES = ("value", "_value", "val", "metric_value")
"""Names of the column with the values in files of one value a row, in small letters: Grafana, InfluxDB, JSON lines."""

ENGINEERING_NAMES = ("eng value", "eng_value", "engineering value", "engvalue", "calibrated value")
"""Names of that column next to one of raw values, in small letters."""

SERIES_NAMES = ("series", "metric", "name", "_field", "field", "parameter", "mnemonic", "channel")
"""Names of the column that says what each value is, in small letters; used where no cell has a name of the vehicle file."""

PART_NAMES = ("parameter name", "parameter_name", "metric name", "metric_name", "panel", "face")
"""Names of such columns that are used if there is none of `SERIES_NAMES`, or in addition if its names are not enough."""


LABEL_NAMES = ("labels", "tags")
"""Names of such columns with several labels in a cell, such as `{panel="xp",job="eps"}` or `panel=xp,host=obc`."""

LABEL_PREFIXES = tuple(f"{name}." for name in LABEL_NAMES)
"""Beginnings of the names of columns with one label each, from objects in JSON lines."""

LABEL = re.compile(r'"?(?P<key>[\w.-]+)"?\s*[=:]\s*(?:"(?P<quoted>[^"]*)"|(?P<bare>[^",{}]+))')
"""A label in a cell."""


class Samples(NamedTuple):
    """A table with a row for each sample, and the sentences that say how it was made; no sentences if nothing was changed."""

    table: TextTable
    notes: tuple[str, ...] = ()


def pivot_series(table: TextTable, time_column: str, names: set[str]) -> Samples:
    """Return a table of one value a row as a table with a row for each time, in order, and a column for each series.

    Each row of such a file has a time, a value and the name of its series, such as "P1_W". The value is in the one column with a
    name of `VALUE_NAMES`, else of `ENGINEERING_NAMES`, else in the only one next to the time and a name of the series. The name
    is in the column whose cells are most often one of `names`, else in one called as in `SERIES_NAMES` or `PART_NAMES`. If it
    has two values at a time, the column of `PART_NAMES`, or what differs in that of `LABEL_NAMES`, is put before it, as in
    "xp.current_mA". So is what differs in columns of one label each (`LABEL_PREFIXES`). Other columns are dropped.
    A cell is empty if its series has no value at that time.

    `names`: the columns that the vehicle file reads, empty if there is none. The table is returned unchanged if its header has one
    of them, or if it lacks the time, the value (or has several) or the name.

    Raises
    ------
    TelemetryError
        The file has two different values of a series for one time.
    """
    small = {name: name.strip().lower() for name in table.header}
    values = [name for name in small if small[name] in VALUE_NAMES]
    values = values or [name for name in small if small[name] in ENGINEERING_NAMES]
    if not values and len(small) == 3:
        # time, series and a value such as current_mA
        known = (*SERIES_NAMES, *PART_NAMES)
        values = [name for name in small if name != time_column and small[name] not in known]
    if names & set(table.header) or time_column not in table.header or len(values) != 1:
        return Samples(table)
    value_column = values[0]
    others = [name for name in table.header if name not in (time_column, value_column)]
    # for each column, how many of its cells name a column of the vehicle file
    wanted = {name: table.cells[name].str.strip().isin(names).sum() for name in others}
    series_column = max(wanted, key=lambda name: wanted[name], default="")
    if not wanted.get(series_column):
        usual = [name for name in others if small[name] in SERIES_NAMES]
        parts = [name for name in others if small[name] in (*PART_NAMES, *LABEL_NAMES)]
        if not usual and not parts:
            return Samples(table)
        series_column = (usual or parts)[0]
        # labels of nested JSON have columns of their own, such as labels.face
        nested = [name for name in others if small[name].startswith(LABEL_PREFIXES)]
        columns = parts[:1] or nested
        by_part = table.cells[[time_column, series_column, *columns]].drop_duplicates()
        if usual and columns and by_part.duplicated([time_column, series_column]).any():
            names_of_rows, first = table.cells[series_column].str.strip(), table.cells[columns[0]]
            if small[columns[0]] in PART_NAMES:  # such as panel xp and metric current_mA
                joined = first.str.strip() + "." + names_of_rows
            else:
                labels = map(_labels_of, first) if parts else table.cells[nested].to_dict("records")
                labelled = zip(labels, names_of_rows, strict=True)
                joined = name_series([{**of_row, "": name} for of_row, name in labelled], "")
            table = table._replace(cells=table.cells.assign(**{series_column: joined}))
    times, series, cells = (
        table.cells[name].str.strip().to_numpy()
        for name in (time_column, series_column, value_column)
    )
    instants = np.array(sorted(set(times.tolist()), key=_sort_key), dtype=object)
    row_of_time = {time: row for row, time in enumerate(instants)}
    column_of_series = {name: k for k, name in enumerate(dict.fromkeys(series.tolist()))}
    rows = np.full((len(instants), len(column_of_series)), "", dtype=object)
    # the number in the file of the first row of each time, by which messages name the sample
    first_line = np.zeros(len(instants), dtype=np.int64)
    for i, (time, name, cell) in enumerate(zip(times, series, cells, strict=True)):
        row, k = row_of_time[time], column_of_series[name]
        if rows[row, k] and cell and rows[row, k] != cell:
            what = f"there are two values of {name!r} for one time"
            got = f"{rows[row, k]} and {cell} at {time}"
            do = f"keep the rows of one source{_describe_sources(table, others, series_column)}"
            raise TelemetryError(what, got=got, do=do, where=f"{table.where}, {table.row_place(i)}")
        rows[row, k] = rows[row, k] or cell
        first_line[row] = first_line[row] or table.cells.index[i]
    collected = pd.DataFrame(rows, first_line, list(column_of_series))
    collected.insert(0, time_column, instants)
    note = (
        f"{len(series)} rows of one value each, named in column {series_column!r}, are {len(instants)} samples "
        f"of {len(column_of_series)} values"
    )
    return Samples(table._replace(cells=collected), (note,))


def _labels_of(cell: str) -> dict[str, str]:
    """Return the labels in a cell by their keys; empty if it has none."""
    return {label["key"]: label["quoted"] or label["bare"] or "" for label in LABEL.finditer(cell)}


def _sort_key(text: str) -> tuple[float, str]:
    """Return a key by which times are sorted: numbers and dates by size, any other text by its letters."""
    number = plain_number(text)
    if np.isnan(number):
        # a date without a zone counts as UTC: only the order within the file matters
        moment = parse_utc(text)
        number = (moment - UNIX_ZERO).total_seconds() if moment else 0.0
    return number, text


def _describe_sources(table: TextTable, columns: list[str], series_column: str) -> str:
    """Return the other columns in which rows differ, with two of their values, in words for advice; empty if there are none."""
    texts = []
    for name in columns:
        values = list(dict.fromkeys(table.cells[name].tolist()))
        if name != series_column and len(values) > 1:
            texts.append(f"{name!r} has {values[0]!r}, {values[1]!r} ...")
    return f" (column {'; '.join(texts)})" if texts else ""


def join_packets(
    table: TextTable, time: np.ndarray, span_s: float, reading_columns: set[str]
) -> tuple[Samples, np.ndarray]:
    """Return a table in which rows within `span_s` of the first one are joined to one sample, and the rows (m) that begin a sample.

    `time` (n): increasing times of the rows, s. A row that has a reading in a column of `reading_columns` which the sample already
    has begins the next sample. The time of a sample is that of its first row. A sentence says how much later columns are read.
    """
    cells = table.cells.to_numpy(copy=True)
    filled = np.array([[bool(cell.strip()) for cell in row] for row in cells])
    is_reading = np.array([name in reading_columns for name in table.header])
    begins: list[int] = []
    late = np.full(filled.shape, np.nan)  # s from the sample's time to that of each of its cells
    for i in range(len(cells)):
        if (
            not begins
            or time[i] - time[begins[-1]] > span_s
            or (filled[i] & filled[begins[-1]] & is_reading).any()
        ):
            begins.append(i)
        start = begins[-1]
        new = filled[i] & (~filled[start] | (i == start))
        cells[start, new], late[start, new] = cells[i, new], time[i] - time[start]
        filled[start] |= filled[i]
    rows = np.array(begins)
    if len(rows) == len(cells):
        return Samples(table), rows
    joined = pd.DataFrame(cells[rows], table.cells.index[rows], table.header)
    delays = {
        name: float(np.nanmedian(late[rows, k]))
        for k, name in enumerate(table.header)
        if is_reading[k] and np.isfinite(late[rows, k]).any()
    }
    notes = [f"{len(cells)} rows are {len(rows)} samples, each of rows within {span_s:g} s"]
    later: dict[str, list[str]] = {}  # delay in words -> columns
    for name, delay in delays.items():
        if delay > 0:
            later.setdefault(f"{delay:.3g}", []).append(name)
    if later:
        by_delay = "; ".join(f"{', '.join(names)} by {delay} s" for delay, names in later.items())
        keys = "offset_s of a panel, or -sensors_late_s under [clock] for the other sensors"
        notes.append(f"columns read later than the sample's time: {by_delay} ({keys})")
    return Samples(table._replace(cells=joined), tuple(notes)), rows
