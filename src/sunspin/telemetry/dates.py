"""Dates in other notations than ISO 8601, as spreadsheets, dashboards and archives write them, rewritten to ISO 8601."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

from sunspin.base.errors import TelemetryError
from sunspin.base.tables import TextTable
from sunspin.base.untrusted import plain_number
from sunspin.telemetry.date_parts import join_date_parts
from sunspin.telemetry.times import parse_utc, strip_scale
from sunspin.vehicle import TelemetryForm
from sunspin.vehicle.craft import DATED_FORMATS

MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
"""First letters of the English names of the months."""

GERMAN_MONTHS = {"mär": "mar", "mrz": "mar", "mai": "may", "okt": "oct", "dez": "dec"}
"""First letters of German names of months -> those of the English ones, if they differ."""

WEEKDAY = r"(?:(?:mon|tue|wed|thu|fri|sat|sun)[a-z]*\.?,? +)?"

UNORDERED = r"(?P<first>\d{1,2})[/-](?P<second>\d{1,2})[/-](?P<year>\d{4}|\d\d)"
"""A date whose day and month are in an order that differs between countries."""

DATES = (
    r"(?P<year>\d{4})[-/.](?P<month>\d{1,2})[-/.](?P<day>\d{1,2})",
    r"(?P<year>\d{4})[-/.:](?P<day_of_year>\d{3})",
    r"(?P<year>\d\d)[-/](?P<day_of_year>\d{3})(?=[-:/t ]\d\d?:\d\d)",
    r"(?P<year>\d{4})(?P<month>\d\d)(?P<day>\d\d)(?= ?\d{6})",
    r"(?P<day>\d{1,2})\.(?P<month>\d{1,2})\.(?P<year>\d{4}|\d\d)",
    r"(?P<day>\d{1,2})\.?[- ]?(?P<name>[a-zä]{3,9})\.?[- ,]*(?P<year>\d{4})",
    r"(?P<day>\d{1,2})-(?P<name>[a-z]{3})-(?P<year>\d\d)(?!:)",
    r"(?P<name>[a-z]{3,9})\.? (?P<day>\d{1,2}),? (?P<year>\d{4})",
    UNORDERED,
)
"""Notations of a date: year first, day of the year, without separators before a time of six digits, day first with points, with the
name of the month, and day or month first."""

CLOCK = (
    r"(?P<hour>\d{1,2})(?P<colon>[:.]?)(?P<minute>\d\d)(?:(?P=colon)(?P<second_s>\d\d)(?:[.,:](?P<fraction>\d+))?)?"
    r"(?: *(?P<half>[ap])\.?m\.?)?"
)
"""A time of day, of 24 hours, or of 12 hours with AM or PM."""

ZONE = r" *(?P<utc>z|utc|gmt)? *(?P<offset>[+-]\d\d:?\d\d)?(?: utc)?(?: \(.*\))?"
"""The zone of a time, with its name in parentheses as JavaScript writes it; Go writes `+0000 UTC`."""

NOTATIONS = tuple(
    re.compile(rf"{WEEKDAY}{date}(?:(?: *[t@,:/-] *| +|\.|(?<=\d)(?=\d{{6}})){CLOCK}{ZONE})?")
    for date in DATES
)

BEGINS_UNORDERED = re.compile(rf"{WEEKDAY}{UNORDERED}\b")

YEAR_LAST = re.compile(
    rf"({WEEKDAY}[a-z]{{3,9}} +\d{{1,2}}) +(\d\d?:\d\d:\d\d\S*)( [a-z]{{3}})? (\d{{4}})"
)
"""A date with the year after the time of day, in small letters, as C and Unix write it: sat jan 31 11:58:00 utc 2026."""

COMPACT_TIME = re.compile(r"(?:[01]\d|2[0-3])[0-5]\d[0-5]\d(?:[.,]\d+)?", re.ASCII)
"""A time such as 091500.25, which stands next to a date such as 20260131."""

TIME_OF_DAY = re.compile(rf"{CLOCK}{ZONE}")


def rewrite_date(text: str, day_first: bool | None = None) -> str:
    """Return a date and time in ISO 8601; a text in none of the notations is returned as it is.

    `day_first`: order of day and month in dates such as 31/01/2026; None: such a date is returned as it is.
    """
    if parse_utc(text) is not None:
        return text
    small = re.sub("[年月]", "-", text).replace("日", " ").strip().lower()
    small = YEAR_LAST.sub(r"\1 \4 \2\3", re.sub(" *uhr$", "", re.sub(" +", " ", small)))
    match = next((found for each in NOTATIONS if (found := each.fullmatch(small))), None)
    if match is None:
        return text
    part = match.groupdict()
    year = part["year"] if len(part["year"]) == 4 else f"20{part['year']}"
    day, month = part.get("day"), part.get("month")
    if part.get("first"):
        if day_first is None:
            return text
        day, month = (part["first"], part["second"])[:: 1 if day_first else -1]
    if name := part.get("name"):
        name = GERMAN_MONTHS.get(name[:3], name)
        month = str(MONTHS.index(name[:3]) + 1) if name[:3] in MONTHS else "0"
    date = f"{year}-{part['day_of_year']}" if part.get("day_of_year") else ""
    date = date or f"{year}-{month:0>2}-{day:0>2}"
    if part["hour"] is None:
        return date if parse_utc(date) else text
    hour = int(part["hour"])
    if part["half"]:
        if not 1 <= hour <= 12:
            return text
        hour = hour % 12 + 12 * (part["half"] == "p")
    zone = part["offset"] or ("Z" if part["utc"] else "")
    seconds = f"{part['second_s'] or '00'}.{part['fraction'] or '0'}"
    iso = f"{date}T{hour:02d}:{part['minute']}:{seconds}{zone}"
    return iso if parse_utc(iso) else text


def is_compact_date(text: str) -> bool:
    """Return whether a text is a date such as 20260131."""
    digits = text.strip()
    return re.fullmatch(r"(19|20)\d{6}", digits, re.ASCII) is not None and (
        parse_utc(f"{digits[:4]}-{digits[4:6]}-{digits[6:]}") is not None
    )


def pad_time(text: str) -> str:
    """Return a time such as 91500.25 with the first zeros that a spreadsheet has dropped: 091500.25."""
    return re.sub(r"^\d+", lambda digits: digits[0].zfill(6), text.strip())


def is_compact_time(text: str) -> bool:
    """Return whether a text is a time of day such as 091500.25, perhaps without its first zeros."""
    return COMPACT_TIME.fullmatch(pad_time(text)) is not None


def find_day_first(texts: Iterable[str]) -> bool | None:
    """Return whether the day is before the month in dates such as 31/01/2026; None if no date shows it."""
    found = (BEGINS_UNORDERED.match(text.strip().lower()) for text in texts)
    pairs = np.array([(int(each["first"]), int(each["second"])) for each in found if each])
    if not len(pairs):
        return None
    first, second = pairs.max(axis=0) > 12
    if first != second:
        return bool(first)
    return True if (pairs[:, 0] == pairs[:, 1]).all() else None


def has_no_order(text: str) -> bool:
    """Return whether a text is a date of which it must be known whether the day is before the month."""
    return BEGINS_UNORDERED.match(text.strip().lower()) is not None


def rewrite_dates(form: TelemetryForm, table: TextTable) -> TextTable:
    """Return a table whose columns of times have dates in ISO 8601 only, each date and time of day joined in the column of times.

    If there is no column of times, but columns of year, month, day and so on, these are joined too.

    Raises
    ------
    TelemetryError
        The order of day and month is neither stated nor shown by a date of the file.
    """
    if form.time_format in DATED_FORMATS:
        table = join_date_parts(table, form.time_column, form.columns.values())
    cells = table.cells.copy()
    if form.date_column in table.header and form.time_column in table.header:
        dates = cells.pop(form.date_column)
        times = cells[form.time_column].str.strip()
        if all(map(is_compact_date, dates)) and all(map(is_compact_time, times)):
            times = [pad_time(time) for time in times]
        cells[form.time_column] = dates.str.strip() + " " + times
    columns = [form.time_column] if form.time_format in DATED_FORMATS else []
    if form.receive_time_column is not None and form.receive_time_format == "utc":
        columns.append(form.receive_time_column)
    for name in columns:
        texts = cells[name].tolist() if name in cells else []
        if name == form.time_column and form.time_format != "utc":  # GPS, TAI or TT after the date
            texts = [strip_scale(text, form.time_format) for text in texts]
        if form.time_format != "utc" and np.isfinite([plain_number(text) for text in texts]).any():
            continue
        day_first = find_day_first(texts) if form.day_first is None else form.day_first
        for row, text in enumerate(texts):
            if day_first is None and has_no_order(text):
                what = "these dates do not show whether the day is before the month"
                do = "set day_first under [telemetry]: true for 31/01/2026, false for 01/31/2026"
                raise TelemetryError(what, got=text, do=do, where=table.place(row, name))
        if texts:
            cells[name] = [rewrite_date(text, day_first) for text in texts]
    return table._replace(cells=cells)
