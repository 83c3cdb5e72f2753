"""Fractions of a second in a column of their own, next to a time column in whole seconds."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np

from sunspin.base.errors import TelemetryError
from sunspin.base.tables import TextTable
from sunspin.base.untrusted import plain_number
from sunspin.vehicle import TelemetryForm

UNITS_S = {
    **dict.fromkeys(("ms", "msec", "msecs", "milli", "millis", "millisec"), 1e-3),
    **dict.fromkeys(("millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "usec", "usecs", "micro", "micros", "microsec"), 1e-6),
    **dict.fromkeys(("microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nano", "nanos", "nanosec"), 1e-9),
    **dict.fromkeys(("nanosecond", "nanoseconds"), 1e-9),
}
"""Words in the name of a column of fractions -> their unit, s."""

PLAIN_SIGNS = str.maketrans("µμæø", "uuu°")
"""Both characters for micro, and what micro and degree of DOS (cp437, cp850) become in a file read as cp1252."""

FRACTION_WORDS = ("fraction", "fractions", "frac", "fractional", "subsec", "subsecs", "subsecond")
FRACTION_WORDS += ("subseconds", "fine")
"""Words for fractions whose unit is known by their size only."""

CLOCK_WORDS = (
    "time",
    "times",
    "timestamp",
    "ts",
    "date",
    "utc",
    "gps",
    "tai",
    "unix",
    "epoch",
    "met",
)
CLOCK_WORDS += ("obc", "obt", "clock", "of", "part", "s", "sec", "second", "seconds", "t", "tv")
"""Other words in the name of such a column; with any further word it may be a duration."""

FULL_SCALES = (100, 256, 1000, 65_536, 1_000_000, 2**24, 10**9, 2**32)
"""Numbers of parts of a second that clocks count; the largest of many fractions is above half of it."""

HAS_FRACTION = re.compile(r":\d\d[.,]\d*[1-9]")

WHOLE_SECONDS = re.compile(r"(.*?[T ]\d\d:\d\d:\d\d)(?:[.,]0*)?((?![.,\d]).*)?")


class Fractions(NamedTuple):
    """The name of a column of fractions, their unit (s), and whether that is known from the name."""

    column: str
    unit_s: float
    by_name: bool


def find_fractions(table: TextTable, time_column: str) -> Fractions | None:
    """Return the column of fractions of a table whose times are whole seconds; None if it has none."""
    for cell in table.cells[time_column]:
        number = plain_number(cell)
        if HAS_FRACTION.search(cell) or (np.isfinite(number) and number != round(number)):
            return None
    known = {*CLOCK_WORDS, *re.findall(r"[a-z]+", time_column.lower())}
    for column in table.header:
        words = re.findall(r"[a-z]+", column.lower().translate(PLAIN_SIGNS))
        words = [re.sub(r"^time(?=(ms|us|ns)$)", "", word) for word in words]  # TIMEUS of COSMOS
        units = [UNITS_S[word] for word in words if word in UNITS_S]
        is_fraction = any(word in FRACTION_WORDS for word in words)
        others = {word for word in words if word not in UNITS_S} - {*FRACTION_WORDS} - known
        if column == time_column or others or not (len(units) == 1 or (is_fraction and not units)):
            continue
        numbers = np.array([plain_number(cell) for cell in table.cells[column]])
        if not (np.isfinite(numbers).all() and (numbers >= 0).all() and numbers.any()):
            continue
        largest = float(numbers.max())
        if not units:
            scales = [1, *FULL_SCALES] if (numbers != np.round(numbers)).any() else FULL_SCALES
            units = [1 / scale for scale in scales if scale / 2 < largest < scale]
        if units and largest * units[0] < 1:
            return Fractions(column, units[0], not is_fraction)
    return None


def unread_fractions(form: TelemetryForm, table: TextTable, unused: list[str]) -> tuple[str, ...]:
    """Return a sentence on a column of fractions that the vehicle file does not name; none if there is no such column."""
    if form.fraction_column is not None or form.time_scale_s != 1.0:
        return ()
    fractions = find_fractions(table, form.time_column)
    if fractions is None or fractions.column not in unused:
        return ()
    return (
        f"times are whole seconds, and column {fractions.column!r} is not read: if it has their fractions, set fraction_column = "
        f'"{fractions.column}" and fraction_unit_s = {fractions.unit_s:.9g} under [telemetry]',
    )


def add_fractions(form: TelemetryForm, table: TextTable) -> TextTable:
    """Return a table whose times (numbers, or dates in ISO 8601) have the fractions of the column that the vehicle file names.

    Raises
    ------
    TelemetryError
        A fraction is no number from 0 to below 1 s, or a time is no whole second.
    """
    if form.fraction_column is None or not table.has((form.fraction_column, form.time_column)):
        return table
    cells, added = table.cells.copy(), []
    pairs = zip(cells[form.time_column], cells[form.fraction_column], strict=True)
    for row, (text, part) in enumerate(pairs):
        fraction, number = plain_number(part) * form.fraction_unit_s, plain_number(text)
        if not 0 <= fraction < 1:
            what = "a fraction of a second is a number from 0 to below 1 s"
            do = "correct it, or fraction_unit_s under [telemetry]: 0.001 for milliseconds"
            where = table.place(row, form.fraction_column)
            raise TelemetryError(what, got=part or "an empty cell", do=do, where=where)
        date = WHOLE_SECONDS.fullmatch(text)
        if date is None and number != round(number if np.isfinite(number) else 0.0):
            what = "a time with fractions in a column of their own must be whole seconds"
            do = "leave fraction_column out under [telemetry], or correct the time"
            where = table.place(row, form.time_column)
            raise TelemetryError(what, got=text or "an empty cell", do=do, where=where)
        if date is None:
            added.append(repr(number + fraction / form.time_scale_s))
        else:
            micro = min(round(fraction * 1e6), 999_999)
            added.append(f"{date[1]}.{micro:06d}{date[2] or ''}")
    cells[form.time_column] = added
    return table._replace(cells=cells)
