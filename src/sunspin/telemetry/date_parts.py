"""Dates whose parts stand in columns of their own, such as year, month, day, hour, minute and second, joined to one column."""

from __future__ import annotations

import re
from collections.abc import Collection
from datetime import datetime, timedelta

import numpy as np

from sunspin.base.tables import TextTable
from sunspin.base.untrusted import plain_number

PARTS = {
    "year": ("year", "yyyy", "yr", "yy", "years"),
    "month": ("month", "mon", "mm", "mo", "months"),
    "day": ("day", "dd", "dom", "day month", "days"),
    "day_of_year": ("doy", "ddd", "yday", "day year", "dayofyear", "jday"),
    "hour": ("hour", "hh", "hr", "hours", "h", "hour day", "hours day"),
    "minute": ("minute", "min", "mm", "mi", "mn", "minutes"),
    "second": ("second", "sec", "ss", "s", "seconds", "secs"),
    "second_of_day": ("sod", "second day", "seconds day", "sec day", "secs day", "secondofday"),
}
"""Part of a date -> names of its column in small letters without `OTHER_WORDS`; MM may be the month and mm the minutes."""

OTHER_WORDS = ("utc", "time", "date", "of", "t", "obt", "obc", "the")
"""Words in the name of such a column that do not say which part it has."""

BEGIN, END = {"day_of_year": 1, "month": 1, "day": 1}, {"hour": 24, "minute": 60, "second": 61}
END |= {"second_of_day": 86_401, "day_of_year": 367, "month": 13, "day": 32, "year": 10_000}
"""Smallest value of each part (default 0), and the value that it does not reach."""


def find_date_parts(header: list[str]) -> dict[str, str]:
    """Return the column of each part of `PARTS` that makes up a date and a time of day; empty if some are missing."""
    columns: dict[str, str] = {}
    for column in header:
        words = re.findall(r"[a-z]+", re.sub(r"[\[(].*?[\])]", "", column.lower()))
        name = " ".join(word for word in words if word not in OTHER_WORDS)
        if " ".join(words).endswith("time of day"):  # such as time_of_day [s]
            name = "second day"
        if name in PARTS["second"] and {*words} & {"time", "t", "obt", "obc"}:
            continue  # such as time_s: seconds since some instant, not of the minute
        kind = next((kind for kind in PARTS if name in PARTS[kind] and kind not in columns), None)
        if kind is not None:
            columns[kind] = column
    if "day_of_year" in columns and "day" not in columns and "minute" not in columns:
        # of YYYY, DDD, HH, MM, SS the fourth is no month
        if month := columns.pop("month", None):
            columns["minute"] = month
    date = ("year", "day_of_year") if "day_of_year" in columns else ("year", "month", "day")
    clock = ("second_of_day",) if "second_of_day" in columns else ("hour", "minute")
    optional = ("second",) if "hour" in clock and "second" in columns else ()
    # fractions of the day of the year may be the time of day
    if "day_of_year" in date and not {*clock, "hour", "minute", "second"} & {*columns}:
        clock = ()
    names = (*date, *clock, *optional)
    return {kind: columns[kind] for kind in names} if columns.keys() >= {*names} else {}


def join_date_parts(table: TextTable, name: str, kept: Collection[str] = ()) -> TextTable:
    """Return a table with a column `name` of dates in ISO 8601, without a zone, in the place of the columns of their parts.

    Columns in `kept` are no parts, even if their names are such. A row whose parts are no date has them joined by blanks, as
    messages show them. A table is returned unchanged if it has a column of this name, or not all parts.
    """
    columns = find_date_parts([column for column in table.header if column not in kept])
    if not columns or name in table.header:
        return table
    texts = table.cells[[*columns.values()]].to_numpy()
    numbers = np.array([[plain_number(cell) for cell in row] for row in texts])
    if "hour" not in columns and "second_of_day" not in columns:  # whole days are no times
        if (numbers[:, 1] == np.round(numbers[:, 1])).all():
            return table
    cells = table.cells.drop(columns=[*columns.values()])
    dates = [
        _join(dict(zip(columns, row, strict=True))) or " ".join(text)
        for row, text in zip(numbers.tolist(), texts.tolist(), strict=True)
    ]
    cells.insert(0, name, dates)
    note = f"times are made of columns {', '.join(columns.values())}"
    return table._replace(cells=cells, notes=(*table.notes, note))


def _join(parts: dict[str, float]) -> str | None:
    """Return the date that the parts state, in ISO 8601; None if they are none. A year of two digits is one of 2000 to 2099."""
    if not all(BEGIN.get(kind, 0) <= value < END[kind] for kind, value in parts.items()):
        return None
    fine = ("second", "second_of_day", "day_of_year")
    if any(value != round(value) for kind, value in parts.items() if kind not in fine):
        return None
    year = int(parts["year"]) + 2000 * (parts["year"] < 100)
    try:
        day = datetime(year, int(parts.get("month", 1)), int(parts.get("day", 1)))
        moment = day + timedelta(
            days=parts.get("day_of_year", 1) - 1,
            hours=parts.get("hour", 0),
            minutes=parts.get("minute", 0),
            seconds=parts.get("second", parts.get("second_of_day", 0)),
        )
    except (ValueError, OverflowError):  # such as 30 February
        return None
    return moment.isoformat(timespec="microseconds")
