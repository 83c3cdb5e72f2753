"""A `[telemetry]` section for a file whose columns the vehicle file does not know, from the names and values of its columns.

Readings may be currents, powers, or angles of the Sun at each panel and their cosines. A face of the spacecraft is recognised by
its axis and sign: `px`, `+X`, `iXm`, `solar_panel_x_plus_current`, `I_ny [mA]`. Columns whose names differ only in the face form a
group, such as all currents. The group with the most faces is taken.
"""

from __future__ import annotations

import json
import re
from collections import defaultdict
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sunspin.base.tables import DECIMAL_COMMA, THOUSANDS, TextTable
from sunspin.base.untrusted import plain_number
from sunspin.telemetry.date_parts import join_date_parts
from sunspin.telemetry.dates import (
    TIME_OF_DAY,
    find_day_first,
    has_no_order,
    is_compact_date,
    is_compact_time,
    rewrite_date,
)
from sunspin.telemetry.fractions import (
    CLOCK_WORDS,
    FRACTION_WORDS,
    PLAIN_SIGNS,
    UNITS_S,
    find_fractions,
)
from sunspin.telemetry.layout import pivot_series
from sunspin.telemetry.noise import find_wrapped_counts
from sunspin.telemetry.sensors import read_numbers
from sunspin.telemetry.times import advise_on_time, parse_utc, strip_scale, zone_of_name
from sunspin.telemetry.timescales import (
    COUNTS,
    FIRST_UNIX_S,
    FIRST_YEAR,
    J2000_UTC,
    LAST_CLOCK_S,
    LAST_YEAR,
    MOST_DAYS,
    TIME_SCALES,
    WEEK_S,
    WEEKS_TO_ROLLOVER,
    YEAR_S,
    counts_in_words,
    likely_counts,
)
from sunspin.vehicle.craft import LOCAL_FORMATS

PLUS = ("+", "p", "pos", "plus", "positive")
"""Words for the plus side of an axis; the other signs of `FACE` are those of its minus side."""

FACE = re.compile(
    r"(?:(?P<before>[+-]|{begin}(?:pos|plus|positive|neg|minus|negative|[pmn]))[ _]*(?P<first>[xyz])"
    r"|{begin}(?P<second>[xyz])[ _(]*(?P<after>[+-]|pos|plus|positive|neg|minus|negative|[pmn]))(?![a-z])".replace(
        "{begin}", r"(?:(?<![a-z])|(?<=(?<![a-z])[iptuv]))"
    )
)
"""A face in a name in small letters whose words are separated by blanks: the sign before or after the axis. One letter may stand
before it, as in IXP (current), PXP (power) or TXP."""

UNITS = {
    "a": ("current_A", 1.0),
    "ma": ("current_A", 1e-3),
    "ua": ("current_A", 1e-6),
    "na": ("current_A", 1e-9),
    "w": ("power_W", 1.0),
    "mw": ("power_W", 1e-3),
    "uw": ("power_W", 1e-6),
    "%": ("power_W", 0.01),
}
"""Unit in small letters -> quantity, and its size in A or W."""

MULTIPLE = re.compile(
    r"[x*×]? ?(?P<factor>\d+(\.\d+)?(e-?\d+)?) ?[x*×]? ?(?P<unit>[munµμ]?[aw])( ?/ ?(lsb|counts?|bit|dn))?"
)
"""A unit that is a multiple of another, in small letters, such as 10 uA or x0.122 mA."""

UNIT_WORD = re.compile(r"(?P<prefix>milli|micro|)(?:(?P<A>amp(?:[eè]re)?s?)|(?P<W>watts?))")
"""A unit of currents or powers as a word, in small letters."""

WORDS = {
    "current_A": (
        *("i", "cur", "curr", "current", "currents", "amp", "amps", "isol"),
        *("strom", "solarstrom", "panelstrom", "courant", "corriente", "corrente"),
    ),
    "power_W": (
        *("p", "pwr", "power", "watt", "watts"),
        *("leistung", "solarleistung", "puissance", "potencia", "potenza"),
    ),
    "": (
        *("spannung", "tension", "tensi", "tensione", "voltaje", "temperatur", "temperatura"),
        *("v", "u", "volt", "volts", "voltage", "voltages", "vsol", "mv"),
        *("t", "tmp", "temp", "temps", "temperature", "degc", "c", "k"),
        *("b", "mag", "magnetometer", "field", "gyro", "w", "omega", "rate", "wheel", "rpm", "q"),
    ),
}
"""Words in the name of a column -> its quantity; empty for readings that are not of panels' currents or powers.

German, French, Spanish and Italian ones too: "tensi" begins the word with an accent."""

ANGLE_WORDS = {
    "elevation_deg": ("el", "elev", "elevation", "elevations", "altitude"),
    "incidence_deg": ("inc", "aoi", "incidence", "incident", "zenith"),
    "cosine": ("cos", "cosine", "cosines"),
    "": ("angle", "angles", "ang"),
}
"""Words in the name of a column -> quantity of angles of the Sun; empty: by the values."""

DEG_PER_RAD = 57.29578

ANGLE_UNITS = {"deg": 1.0, "degree": 1.0, "degrees": 1.0, "°": 1.0, "rad": DEG_PER_RAD}
"""Unit of an angle in small letters -> its size in degrees."""

OPPOSITE = 0.1
"""Elevations of the Sun at two opposite panels, and cosines, cancel: their sum is less than this part of the largest one."""

LARGEST_COSINE, LARGEST_RAD = 1.2, 3.3
"""A cosine is no larger, and an angle in rad, noise included."""

MILLI = 30.0
"""A reading without a unit above this is in thousandths: no single panel gives 30 A or 30 W."""

TIME_WORDS = ("time", "timestamp", "date", "datetime", "utc", "unix", "epoch", "uptime", "ts", "t")
TIME_WORDS += ("stamp", "met", "obt", "sclk", "scet", "mjd", "jd", "julian")
TIME_WORDS += ("cuc", "tai", "gpst", "j2000", "ntp", "datenum", "filetime", "ticks")
"""Words in the name of a time column, the likeliest first."""

SECOND_WORDS = ("s", "sec", "secs", "second", "seconds", "coarse", "tv")
"""Words in the name of a column of whole seconds, whose fractions may have a column of their own."""

LONGEST_S = 1e8
"""Numbers of seconds above this (three years) are times and no durations."""

LAST_OLD_UNIX_S = 1.5e9
"""Numbers up to this may be GPS seconds, of mid-2027, where the name of the file says so: as Unix times they end in mid-2017."""

BOARD_CLOCKS = ("obt", "sclk", "scet", "met", "spacecraft", "sc", "onboard")
"""Words in the name of a time column of a clock on board, whose time zero the mission sets."""

TT_1970_UTC = "1969-12-31T23:59:17.816Z"
"""1 January 1970, 00:00 TT, 42.184 s ahead of UTC as of 1972."""

CUC_EPOCHS = {
    1958: 'time_format = "tai"',
    1970: 'time_format = "unix"',
    1980: 'time_format = "gps"',
    2000: 'time_format = "elapsed"',
}
"""Years from which CUC counts seconds -> the entry that reads them."""

LAST_GPS_S = 1.6e9
"""Largest number of a clock on board that may be GPS seconds, then in 2030; as Unix time it is of 2020."""

FIRST_JD, LAST_JD = 2_440_000.0, 2_470_000.0
"""Days of the Julian Date from 1968 to 2050."""

YEAR_WORDS = ("year", "years", "yr", "doy")
"""Words in the name of a column whose numbers are years, or days in one: no times that can be read."""

WEEK_WORDS, SECONDS_OF_WEEK_WORDS = ("week", "weeks", "wn", "gpsweek"), ("tow", "sow", "itow")
"""Words in the names of the columns of GPS weeks and of seconds of the week."""

STRING_WORDS = ("string", "strings", "str")
STRING_PAIRS = ("a", "b", "c", "d", "left", "right", "upper", "lower", "inner", "outer")
"""Words that tell the strings of cells of one panel apart; `STRING_PAIRS` only if each column has one."""

WING_WORDS = ("wing", "wings", "flügel", "fluegel", "deployable", "deployed")
"""Words in the name of a column of a deployed panel, which is on no face."""

RECEIVED_WORDS = ("received", "receive", "recv", "reception", "rx", "ert", "ground", "downlink")
"""Words in the name of a column of times of reception, which are later than those of the samples."""

COUNT_WORDS = ("adc", "raw", "count", "counts", "cnt", "dn", "lsb")
"""Words in the name of a column of raw counts of a converter."""

COUNT_UNITS = (*COUNT_WORDS, "adu", "du", "bit", "bits", "digit", "digits", "step", "steps")
COUNT_UNITS += ("zähler", "zaehler", "zählwert", "stufen", "coups", "cuentas", "conteggi")
"""Units of raw counts in small letters, German, French, Spanish and Italian ones too."""

EXTREME_WORDS = ("min", "minimum", "max", "maximum", "std", "stddev", "sigma")
"""Words in the name of a column of other statistics than the mean of an interval."""

SENSOR_WORDS = {
    "gyro": (
        *("gyro", "gyr", "gyros", "gyroscope", "omega", "rate", "rates"),
        *("drehrate", "drehraten", "gyroskop", "kreisel"),
    ),
    "magnetometer": ("mag", "magn", "magnetometer", "mtm", "mgm", "field", "magnetfeld"),
}
"""Table of the vehicle file -> words in the names of the columns of that sensor."""

SENSOR_UNITS = {
    "gyro": {
        "dps": 1 / DEG_PER_RAD,
        "deg/s": 1 / DEG_PER_RAD,
        "°/s": 1 / DEG_PER_RAD,
        "mdps": 1e-3 / DEG_PER_RAD,
        "rad/s": 1.0,
    },
    "magnetometer": {
        "nt": 1e-9,
        "ut": 1e-6,
        "mt": 1e-3,
        "t": 1.0,
        "mg": 1e-7,
        "mgauss": 1e-7,
        "gauss": 1e-4,
    },
}
"""Table of the vehicle file -> unit in small letters -> its size in rad/s or T."""

LAST_UNIX_S = 5e9
"""Largest number of seconds that is taken for a Unix time, of 2128; times after `LAST_CLOCK_S` are named."""

FIRST_DAY, LAST_DAY = 35_000.0, 50_000.0
"""Days of a spreadsheet from 1995 to 2036."""

LAST_MJD = 65_000.0
"""Days of the Modified Julian Date from 1995 to 2036 follow up to here; below `FIRST_DAY` they count from 2000 (MJD2000)."""

LONG_UNITS_S = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("min", "mins", "minute", "minutes"), 60.0),
    **dict.fromkeys(("h", "hr", "hrs", "hour", "hours"), 3600.0),
    **dict.fromkeys(("d", "day", "days"), 86_400.0),
}
"""Words in the name of a column of times -> their unit, s; units below a second are in `UNITS_S`."""

UNIT_NAMES = {1.0: "s", 1e-3: "ms", 1e-6: "us", 1e-9: "ns"}
UNIT_NAMES |= {60.0: "minutes", 3600.0: "hours", 86_400.0: "days"}
"""Size of a unit of time, s -> its name."""

READ_SHARE = 0.5
"""Share of the cells that must be dates or numbers for a column to be taken as one of times or readings."""


class Suggestion(NamedTuple):
    """How a table may be read.

    `section`: text of a `[telemetry]` section; `columns`: the column of each face ("+X" ...); `largest`: the largest reading of
    each face in W or A, NaN for angles; `sensors`: columns of a gyro and a magnetometer. `notes`: those comments of the section
    that say what may be misread, or is not read although it is of the same panels.
    """

    section: str
    columns: dict[str, str]
    largest: dict[str, float]
    sensors: dict[str, AxisColumns]
    notes: list[str]


class AxisColumns(NamedTuple):
    """Columns x, y, z of a sensor along its own axes, and the size of their unit in rad/s or T; None if no name has a unit."""

    columns: tuple[str, str, str]
    unit: float | None


class _Times(NamedTuple):
    """The column of times, lines of the section on how to read them, and further columns that these lines name."""

    column: str
    lines: list[str]
    others: tuple[str, ...] = ()

    @property
    def notes(self) -> list[str]:
        """Sentences in the lines on what may be misread."""
        return [line.removeprefix("# ") for line in self.lines if line.startswith("# ")]


class _Group(NamedTuple):
    """Columns of one kind: the column of each face, the quantity, the size of the file's unit, and how both are known.

    `template`: the name of the columns as :func:`_words` writes it, with # for the face; `unit`: that in the names.
    """

    columns: dict[str, str]
    quantity: str
    scale: float
    reason: str
    template: str
    unit: str

    def like_named(self, column: str) -> bool:
        """Return whether a column is named as those of the group, but with another word for the face.

        The name of a wing may have other words too, if it says that the quantity is the same: Panel +X current, Wing 1 current.
        """
        name, unit = _split_unit(column)
        words = _words(name)
        before, after = map(re.escape, self.template.split("#"))
        has_word = re.fullmatch(rf"{before}\w+{after}", words) is not None
        if has_word and unit == self.unit and bool(before.strip() or after.strip()):
            return True
        quantity = _words_of(self.template) & {*WORDS.get(self.quantity, ())}
        is_wing = bool({*re.findall(r"[^\W\d_]+", words)} & {*WING_WORDS})
        says_quantity = quantity <= _words_of(words) and bool(quantity or unit in UNITS)
        return is_wing and says_quantity and unit == self.unit

    def in_another_unit(self, column: str) -> bool:
        """Return whether a column is named as those of the group, with a face that these lack, and in another unit."""
        name, unit = _split_unit(column)
        words = _words(name)
        if (match := FACE.search(words)) is None or unit == self.unit or unit not in UNITS:
            return False
        return _template_of(match) == self.template and _face_of(match) not in self.columns


def suggest_section(table: TextTable, panels: dict[str, str] | None = None) -> Suggestion | None:
    """Return a section that would read a table; None without a column of times or of two faces.

    The table may have one value a row (:func:`sunspin.telemetry.layout.pivot_series`). `panels`: names of a vehicle's panels by
    the face on which they are; default: the face itself.
    """
    if (time := _find_times(table)) is None:
        return None
    table = _name_units(table, pivot_series(table, time.column, set()).table)
    if (group := _best_group(table)) is None:
        return None
    wraps_at = find_wrapped_counts(read_numbers(table, list(group.columns.values())))
    wraps = [_entry(f"wraps_at = {wraps_at}", "check this: negative numbers by the size")]
    lines = [
        "[telemetry]",
        _entry(f'quantity = "{group.quantity}"', ""),
        _entry(f"time_column = {toml_string(time.column)}", ""),
        *time.lines,
        _entry(f"scale = {group.scale:g}", group.reason),
        *(wraps if wraps_at else []),
        _entry('bad_rows = "flag"', "sort rows, merge repeats, name what cannot be used"),
        "[telemetry.columns]",
        *(
            f"{toml_string((panels or {}).get(face, face))} = {toml_string(column)}"
            for face, column in sorted(group.columns.items(), key=lambda pair: pair[0][::-1])
            if panels is None or face in panels
        ),
    ]
    used = {time.column, *time.others, *group.columns.values()}
    if others := [name for name in table.header if name not in used]:
        shown = ", ".join(map(toml_string, others[:12])) + (", ..." * (len(others) > 12))
        lines.append(f"# not read: {shown}")
    if like := [name for name in others if group.like_named(name) and _is_numeric(table, name)]:
        names = ", ".join(map(toml_string, like))
        lines.append(
            f"# perhaps panels whose names say no face, such as wings; each needs a [[panel]]: {names}"
        )
    notes = []
    if strings := _further_strings(table, [*group.columns.values()], others):
        names = ", ".join(map(toml_string, strings))
        notes.append(
            f"perhaps further strings of these panels, not read; each needs a [[panel]] with the same normal_B: {names}"
        )
    if other := [name for name in others if group.in_another_unit(name)]:
        names = ", ".join(map(toml_string, other))
        notes.append(
            f"PANELS IN ANOTHER UNIT, which one scale does not read; convert them: {names}"
        )
    lines += [f"# {note}" for note in notes]
    notes = [*time.notes, *notes]
    largest = {
        face: group.scale * float(np.nanmax(read_numbers(table, [column]), initial=-np.inf))
        for face, column in group.columns.items()
    }
    if group.quantity in ANGLE_WORDS:
        largest = dict.fromkeys(largest, np.nan)
    section, sensors = "\n".join(lines) + "\n", _sensor_columns(table, used)
    return Suggestion(section, group.columns, largest, sensors, notes)


def _name_units(table: TextTable, pivoted: TextTable) -> TextTable:
    """Return a pivoted table with the unit of the column that had the values in `table`, if its name has one."""
    dropped = [name for name in table.header if name not in pivoted.header]
    units = {unit for name in dropped if (unit := _unit_of(table, name)[1]) in UNITS}
    if len(units) != 1:
        return pivoted
    return pivoted._replace(units=dict.fromkeys(pivoted.header, units.pop()))


def explain_missing(table: TextTable) -> tuple[str, str]:
    """Return in words why no section is suggested for a table (times, panels or numbers are missing), and what to do."""
    has_times = _find_times(table) is not None
    for column in table.header:
        if FACE.search(_words(_split_unit(column)[0])) and (
            cell := _unreadable_cell(table, column)
        ):
            what = f"column {column!r} may be of a panel, but its cells are not numbers, such as {cell[:30]!r}"
            do = "write plain decimals, such as -1.5e-3"
            if re.match(r"\s*[-+]?[\d.,]+\s*(?!x)[^\W\d]", cell):
                do = "export raw values without units (in Grafana without `Formatted data`), such as 0.412"
            return what, do
    for column in table.header if has_times else []:
        name, unit = _unit_of(table, column)
        has_formula = re.search(r"\d|count|lsb", unit) is not None
        if has_formula and FACE.search(_words(name)) and _is_numeric(table, column):
            what = f"column {column[:60]!r} may be of a panel, but its unit is not known"
            return what, "write a [telemetry] section by hand, with quantity, scale and zero"
    for column in [] if has_times else table.header:
        is_named = bool(_words_of(_words(column)) & set(TIME_WORDS))
        if is_named and (cell := _unreadable_cell(table, column)):
            what = (
                f"column {column!r} may hold times, but they cannot be read, such as {cell[:40]!r}"
            )
            return what, advise_on_time(cell) or "write them as 2026-01-31T23:59:59Z"
    times = "" if has_times else "times"
    panels = "" if _best_group(table) else "currents or powers of panels on two faces"
    do = (
        "names such as `time` or `ts_ms`, `px`, `I_X+ [mA]` are recognised: rename the columns, or write [telemetry] by hand "
        "(`sunspin init DIR` has an example)"
    )
    return f"no columns look like {' and '.join(filter(None, (times, panels)))}", do


def _unreadable_cell(table: TextTable, column: str) -> str:
    """Return the first cell of a column with digits whose cells are mostly no numbers; empty if the column is another one."""
    cell = next((cell.strip() for cell in table.cells[column] if cell.strip()), "")
    return cell if any(map(str.isdigit, cell)) and not _is_numeric(table, column) else ""


def _further_strings(table: TextTable, used: list[str], others: list[str]) -> list[str]:
    """Return the columns of `others` that may be of further strings of cells of the panels whose columns are `used`.

    Their names differ from a used one only in the face, in numbers and in words for strings (`STRING_WORDS`, `STRING_PAIRS`), and
    their readings differ from those of all used columns.
    """
    kinds = {_string_kind(table, name, marks) for name in used for marks in (False, True)}
    readings = read_numbers(table, used)
    return [
        name
        for name in others
        if (_string_kind(table, name, False) in kinds or _string_kind(table, name, True) in kinds)
        and _is_numeric(table, name)
        and not (readings == read_numbers(table, [name])).all(axis=0).any()
    ]


def _string_kind(table: TextTable, column: str, has_mark: bool) -> tuple[str, ...]:
    """Return the words and the unit in a column's name without face, numbers and words for strings; unique if it has no face.

    `has_mark`: a word of `STRING_PAIRS` is left out too, and columns without one are unlike all others.
    """
    name, unit = _unit_of(table, column)
    words = _words(name)
    if (face := FACE.search(words)) is None:
        return (column,)
    tokens = re.findall(r"[a-zµμ%]+", f"{words[: face.start()]} {words[face.end() :]}")
    kept = [word for word in tokens if word not in STRING_WORDS]
    if has_mark:
        pairs = [word for word in kept if word in STRING_PAIRS]
        if len(pairs) != 1:
            return (column,)
        kept = ["*" if word in STRING_PAIRS else word for word in kept]
    return (*kept, f"[{unit}]")


def _sensor_columns(table: TextTable, used: set[str]) -> dict[str, AxisColumns]:
    """Return the columns of a gyro and of a magnetometer by the words in their names, without the columns in `used`.

    Three columns whose names differ only in the axis are those of a sensor. Of several triples the first is taken.
    """
    triples: dict[str, dict[str, str]] = defaultdict(dict)
    for column in table.header:
        words = _words(column)
        axis = re.search(r"(?<![a-z])[xyz](?![a-z])", words)
        if axis is not None and column not in used and _is_numeric(table, column):
            template = f"{words[: axis.start()]}#{words[axis.end() :]}"
            triples[template].setdefault(axis[0], column)
    sensors: dict[str, AxisColumns] = {}
    for template, columns in triples.items():
        if len(columns) < 3:
            continue
        words = _words_of(template)
        _, unit = _unit_of(table, columns["x"])
        for sensor, known in SENSOR_WORDS.items():
            if sensor not in sensors and words & set(known):
                sizes = SENSOR_UNITS[sensor]
                # not the words of the template, in which a capital letter begins a word: uT would be T
                parts = re.split(r"[_ .,-]+", _plain_unit(columns["x"]))
                pairs = [f"{first}/{last}" for first, last in pairwise(parts)]  # such as deg_s
                by_word = (sizes[word] for word in [*parts, *pairs] if word in sizes)
                size = sizes.get(unit, next(by_word, None))
                sensors[sensor] = AxisColumns((columns["x"], columns["y"], columns["z"]), size)
    return sensors


def _entry(text: str, comment: str) -> str:
    """Return a line of TOML with a comment."""
    return f"{text:<37} # {comment}" if comment else text


def toml_string(name: str) -> str:
    """Return a text as a TOML string."""
    return json.dumps(name, ensure_ascii=False)


def _split_unit(name: str) -> tuple[str, str]:
    """Return the name of a column without its unit, and the unit in small letters, empty if there is none.

    The unit is in brackets, or the last word after a blank, underscore, dot, comma or slash, or the first one. As a word, A and W
    are written in capital letters, and are no first word.
    """
    if first := re.fullmatch(r"([muµμæ][AW])[_ .]+(.*)", name):
        name = f"{first[2]} {first[1]}"
    in_brackets = re.fullmatch(r"(.*?)\s*[\[(]([^\])]*)[\])]\s*", name)
    if in_brackets and FACE.fullmatch(in_brackets[2].strip().lower()):  # such as I[+X]
        return name, ""
    match = in_brackets or re.fullmatch(
        r"(.*?)\s*[_ .,/]\s*([muµμæ]A|[mu]a|A|[muµμæ]W|[mu]w|W|deg|rad)", name
    )
    return (match[1], _plain_unit(match[2])) if match else (name, "")


def _plain_unit(text: str) -> str:
    """Return a unit in small letters, with u for micro and one spelling of ampere and watt."""
    unit = text.strip(" []()").lower().translate(PLAIN_SIGNS)
    if word := UNIT_WORD.fullmatch(unit):
        unit = {"milli": "m", "micro": "u", "": ""}[word["prefix"]] + ("a" if word["A"] else "w")
    return unit


def _unit_of(table: TextTable, column: str) -> tuple[str, str]:
    """Return the name of a column without its unit, and the unit by its name or by the row of units, empty if there is none."""
    name, unit = _split_unit(column)
    if re.search(r"[_ .]A$", column) and f"{column[:-1]}B" in table.header:
        name, unit = column, ""  # strings A and B of a panel, and no ampere
    return name, unit or _plain_unit(table.units.get(column, ""))


def _judge_angles(
    table: TextTable, words: set[str], unit: str, columns: dict[str, str]
) -> tuple[str, float, str] | None:
    """Return quantity, factor to degrees and the reason for a group of angles of the Sun or of cosines; None if it is no such.

    By the words of the names, then by the values: of opposite panels elevations and cosines cancel, and angles from the normal add
    to half a turn. No panel gives a negative power.
    """
    named = [name for name, known in ANGLE_WORDS.items() if words & set(known)]
    other_words = {word for known in WORDS.values() for word in known}
    if (unit and unit not in ANGLE_UNITS) or (not named and words & other_words):
        return None
    value = {face: read_numbers(table, [column])[:, 0] for face, column in columns.items()}
    largest = max(float(np.nanmax(np.abs(one), initial=0.0)) for one in value.values())
    below = any(np.nanmin(one, initial=0.0) < -0.1 * largest for one in value.values())
    pairs = [(value.get(f"+{axis}"), value.get(f"-{axis}")) for axis in "XYZ"]
    sums = [
        float(np.nanmedian(first + second))
        for first, second in pairs
        if first is not None and second is not None and np.isfinite(first + second).any()
    ]
    opposite = bool(sums) and max(map(abs, sums)) < OPPOSITE * largest
    size = f"(up to {largest:.4g})"
    if "cosine" in named or not (named or unit) and below and opposite and largest < LARGEST_COSINE:
        how = (
            "by the header"
            if named
            else f"check this: by opposite panels, whose readings cancel {size}"
        )
        return ("cosine", 1.0, f"cosines, {how}") if largest < LARGEST_COSINE else None
    if not named and not unit and not (below and opposite):
        return None
    reason = f"{unit}, by the header"
    factor = ANGLE_UNITS.get(unit, DEG_PER_RAD if largest < LARGEST_RAD else 1.0)
    if not unit:
        reason = f"{'deg' if factor == 1.0 else 'rad'}, guessed by the size {size}"
    quantity = next((name for name in named if name), "")
    if not quantity and (below or opposite):
        quantity, reason = "elevation_deg", f"{reason}; negative behind the panel"
    elif not quantity:
        sure = largest * factor > 100.0  # an elevation is at most 90 deg
        quantity = "incidence_deg"
        reason += (
            "; more than 90 deg behind the panel" if sure else "; check this: or elevation_deg"
        )
    return quantity, factor, reason


def _words(name: str) -> str:
    """Return a name in small letters with blanks between its words; a change from small to capital letters begins a word."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", name)
    return re.sub(r"[._/:|#]+", " ", spaced).lower()


def _words_of(name: str) -> set[str]:
    """Return the words of letters in a name in small letters."""
    return set(re.findall(r"[a-z]+", name))


def _face_of(match: re.Match[str]) -> str:
    """Return the face that a match of `FACE` names, such as "+X"."""
    sign = match["before"] or match["after"]
    return ("+" if sign in PLUS else "-") + (match["first"] or match["second"]).upper()


def _template_of(match: re.Match[str]) -> str:
    """Return the name in which a match of `FACE` was found, with # in the place of the face."""
    return f"{match.string[: match.start()]}#{match.string[match.end() :]}"


def _best_group(table: TextTable) -> _Group | None:
    """Return the group of columns that are most probably currents or powers of panels; None if no group has two faces."""
    groups: dict[tuple[str, str], dict[str, str]] = defaultdict(dict)
    for column in table.header:
        name, unit = _unit_of(table, column)
        words = _words(name)
        face = FACE.search(words)
        if face is None or not _is_numeric(table, column):
            continue
        groups[_template_of(face), unit].setdefault(_face_of(face), column)
    # faces may have numbers too, or several strings: without the numbers they are one group, if it says that it is of panels
    without_numbers: dict[tuple[str, str], dict[str, str]] = defaultdict(dict)
    for (template, unit), columns in groups.items():
        plain = " ".join(re.sub(r"\d+", "", template).split())
        if unit in UNITS or {*plain.split()} & {*WORDS["current_A"], *WORDS["power_W"]}:
            without_numbers[plain, unit] = columns | without_numbers[plain, unit]
    judged = []
    for (template, unit), columns in [*groups.items(), *without_numbers.items()]:
        quantity, scale, reason = _judge_quantity(table, template, unit, columns)
        # a minus alone is no face: `mx`, `my`, `mz` are a magnetometer's
        if quantity and len(columns) > 1 and any(face[0] == "+" for face in columns):
            # of groups with the same faces means before extremes, calibrated values before counts, then the one with a stated
            # unit, then currents
            words = _words_of(f"{template} {unit}")
            is_plain = not words & {*EXTREME_WORDS}, not words & {*COUNT_WORDS} or unit in UNITS
            rank = (len(columns), *is_plain, bool(unit), quantity == "current_A")
            judged.append((rank, _Group(columns, quantity, scale, reason, template, unit)))
    return max(judged, key=lambda pair: pair[0])[1] if judged else None


def _judge_quantity(
    table: TextTable, template: str, unit: str, columns: dict[str, str]
) -> tuple[str, float, str]:
    """Return quantity, size of the unit and the reason for a group; an empty quantity if it is neither current nor power."""
    if unit in UNITS:
        return *UNITS[unit], f"{unit.replace('w', 'W').replace('a', 'A')}, by the header"
    if multiple := MULTIPLE.fullmatch(unit):
        quantity, size = UNITS[multiple["unit"]]
        return quantity, float(multiple["factor"]) * size, f"{unit}, by the header; check this"
    words, in_counts = _words_of(template), unit in COUNT_UNITS
    angles = None if in_counts else _judge_angles(table, words, unit, columns)
    if angles is not None:
        return angles
    quantities = [name for name, known in WORDS.items() if words & set(known)]
    if (unit and not in_counts) or quantities == [""]:
        return "", 1.0, ""
    if in_counts or words & set(COUNT_WORDS):
        return "current_A", 1.0, "raw counts: A in this file and in what is printed means counts"
    quantity = next((name for name in quantities if name), "power_W")
    largest = float(np.nanmax(read_numbers(table, list(columns.values())), initial=0.0))
    letter = quantity[-1]
    guess = "check this: no column says what it holds; " if not any(quantities) else ""
    if largest > MILLI:
        return quantity, 1e-3, f"{guess}m{letter}, guessed by the size (up to {largest:.4g})"
    return quantity, 1.0, f"{guess}{letter}, guessed by the size (up to {largest:.4g})"


def _is_numeric(table: TextTable, column: str) -> bool:
    """Return whether enough cells of a column are numbers, also with commas or thousands separators, which are refused later."""
    cells = [cell for cell in table.cells[column] if cell.strip()]
    numbers = [
        np.isfinite(plain_number(cell))
        or any(notation.fullmatch(cell) for notation in (DECIMAL_COMMA, THOUSANDS))
        for cell in cells
    ]
    return bool(cells) and float(np.mean(numbers)) >= READ_SHARE


def _find_times(table: TextTable) -> _Times | None:
    """Return the column of times and how it is read; None if there is none."""
    ranked = []
    for place, column in enumerate(table.header):
        named = _time_words(column)
        words = set(named)
        by_name = [k for k, word in enumerate(TIME_WORDS) if word in words]
        cells = table.cells[column].tolist()
        scale = next((TIME_SCALES[word] for word in named if word in TIME_SCALES), "")
        if scale:  # which may also stand after each date
            cells = [strip_scale(cell, scale) for cell in cells]
        lines = _describe_times(cells, named)
        # 20260131 may be a number if no times of day stand next to it
        is_bare = all(map(is_compact_date, cells)) and _clock_column(table, column) is None
        if lines is not None and not is_bare:
            is_date = lines[0].startswith('time_format = "utc"')
            has_zone = any(
                re.search(r"(Z|[+-]\d\d:?\d\d)$", rewrite_date(cell)) for cell in cells[:1]
            )
            how = "by the name of the column; check this"
            is_unix = lines[0].startswith('time_format = "unix"')
            if is_unix and not scale and "gps" in _file_words(table) and _may_be_gps(cells, words):
                scale, how = "gps", "by the name of the file; check this"
                note = '# check time_format: "gps" by the name of the file; as "unix" the times are ten years earlier'
                lines = [*lines, note]
            if scale and is_date and has_zone:
                named_scale = next(word for word in named if word in TIME_SCALES).upper()
                note = f"# check time_format: the name of the column says {named_scale}, and the dates UTC, by which they are read"
                lines = [*lines, note]
            elif scale and is_date or (is_unix and scale in ("gps", "tai")):
                lines = [_entry(f'time_format = "{scale}"', how), *lines[1:]]
            zone = zone_of_name(column) if is_date and not has_zone and not scale else None
            if zone is not None:
                stated = f'time_zone = "{zone}"'
                lines = [*lines, _entry(stated, "by the name of the column; check this")]
            # dates with times of day before dates alone, these before numbers, then UTC of samples, by the name, then the first
            rank = 2 - is_date * (2 if any(":" in cell or "T" in cell for cell in cells) else 1)
            is_other = bool(scale) or bool(words & {*RECEIVED_WORDS, *FRACTION_WORDS})
            ranked.append((rank, is_other, min(by_name, default=99), place, column, lines))
    rank, *_, column, lines = min(ranked, default=(3, "", []))
    if (not lines or "elapsed" in lines[0]) and (gps := _gps_weeks(table)) is not None:
        return gps
    name = "time" if "time" not in table.header else "date_time"
    joined = join_date_parts(table, name) if not lines or "elapsed" in lines[0] else table
    if joined is not table and (times := _find_times(joined)) is not None:
        parts = tuple(column for column in table.header if column not in joined.header)
        return times._replace(others=(*times.others, *parts))
    if not ranked:
        return None
    others: tuple[str, ...] = ()
    if rank == 1 and (clock := _clock_column(table, column)) is not None:
        lines = [_entry(f"date_column = {toml_string(column)}", ""), *lines]
        column, others = clock, (column,)
        if (zone := zone_of_name(clock)) is not None and not any("time_zone =" in x for x in lines):
            lines.append(_entry(f'time_zone = "{zone}"', "by the name of the column; check this"))
    if not any("time_scale_s" in line for line in lines):
        fraction_lines, names = _describe_fractions(table, column)
        lines, others = [*lines, *fraction_lines], (*others, *names)
    return _Times(column, lines, others)


def _file_words(table: TextTable) -> set[str]:
    """Return the words in the name of a table's file."""
    return _words_of(_words(Path(table.where).stem))


def _may_be_gps(cells: list[str], words: set[str]) -> bool:
    """Return whether numbers in a column, with these words in its name, may be GPS seconds: as Unix times they are old."""
    numbers = np.array([plain_number(cell) for cell in cells])
    typical_s = float(np.nanmedian(numbers)) if np.isfinite(numbers).any() else 0.0
    return FIRST_UNIX_S < typical_s < LAST_OLD_UNIX_S and not words & {"unix", "utc"}


def _gps_weeks(table: TextTable) -> _Times | None:
    """Return the columns of GPS weeks and of seconds of the week by their names; None if one of them is missing."""
    found = {}
    for column in table.header:
        words = _words_of(_words(column))
        is_seconds = words & {*SECONDS_OF_WEEK_WORDS} or words >= {"of", "week"}
        kind = "seconds" if is_seconds else "week" if words & {*WEEK_WORDS} else ""
        if kind and _is_numeric(table, column):
            found.setdefault(kind, column)
    if len(found) < 2:
        return None
    weeks, seconds = (read_numbers(table, [found[kind]])[:, 0] for kind in ("week", "seconds"))
    lines = [
        _entry('time_format = "gps"', "by the names of the columns"),
        _entry(f"week_column = {toml_string(found['week'])}", ""),
    ]
    if np.nanmax(seconds, initial=0.0) > WEEK_S:
        lines.append(_entry("time_scale_s = 0.001", "ms, by the size"))
    if np.nanmax(weeks, initial=0.0) < WEEKS_TO_ROLLOVER:
        lines.append(_entry("gps_rollovers = 2", "check this: how often the weeks began again"))
    if np.nanmax(seconds, initial=0.0) <= WEEK_S:
        fraction_lines, others = _describe_fractions(table, found["seconds"])
        return _Times(found["seconds"], [*lines, *fraction_lines], (found["week"], *others))
    return _Times(found["seconds"], lines, (found["week"],))


def _describe_fractions(table: TextTable, column: str) -> tuple[list[str], tuple[str, ...]]:
    """Return the lines for a column of fractions of the whole seconds in `column`, and its name; both empty if there is none."""
    if (fractions := find_fractions(table, column)) is None:
        return [], ()
    how = "by the name of the column" if fractions.by_name else "check this: by the size"
    lines = [
        _entry(f"fraction_column = {toml_string(fractions.column)}", "fractions of a second"),
        _entry(f"fraction_unit_s = {fractions.unit_s:.9g}", how),
    ]
    return lines, (fractions.column,)


def _clock_column(table: TextTable, date_column: str) -> str | None:
    """Return the first column of times of day without dates; None if there is none."""
    compact_dates = all(map(is_compact_date, table.cells[date_column]))
    for column in table.header:
        cells = [cell.strip().lower() for cell in table.cells[column] if cell.strip()]
        # times such as 091500 stand next to dates such as 20260131
        is_named = _words_of(_words(column)) & {*TIME_WORDS}
        if not cells or column == date_column:
            continue
        if compact_dates and is_named and all(map(is_compact_time, cells)):
            return column
        are_times = [bool(TIME_OF_DAY.fullmatch(cell)) and ":" in cell for cell in cells]
        if np.mean(are_times) >= READ_SHARE:
            return column
    return None


def _time_words(column: str) -> list[str]:
    """Return the words in the name of a column of times, in small letters; seconds from J2000 have the word "j2000" last."""
    name = _words(column).translate(PLAIN_SIGNS)
    name = re.sub(r"(?<![a-z])time(sec|secs|seconds|ms|us|ns)(?![a-z])", r"time \1", name)  # COSMOS
    is_j2000 = re.search(r"(?<![a-z])(j ?2000|j2k|tdb|tt)(?![a-z0-9])", name) is not None
    # ephemeris time of SPICE; in other names "et" may be a French word
    is_j2000 |= re.fullmatch(r"(time )?et( time)?( [\[(]?s[\])]?)?", name) is not None
    return [*re.findall(r"[a-z]+", name), *(["j2000"] if is_j2000 else [])]


def _describe_times(cells: list[str], named: list[str]) -> list[str] | None:
    """Return the lines for a column of dates, or of numbers if a word of its name (`named`) means a time; None for other cells."""
    words = set(named)
    filled = [cell.strip() for cell in cells if cell.strip()]
    if not filled:
        return None
    day_first = find_day_first(filled)
    if "date" in words and all(map(is_compact_date, filled)):
        return [_entry('time_format = "utc"', "dates; add time_zone if they are local times")]
    ordered = [rewrite_date(cell, day_first is not False) for cell in filled]
    dates = sum(parse_utc(cell) is not None for cell in ordered if not cell.isdigit())
    if dates >= READ_SHARE * len(filled):
        lines = [_entry('time_format = "utc"', "dates; add time_zone if they are local times")]
        if any(has_no_order(cell) for cell in filled):  # such as 31/01/2026
            guess = "day before month, or false; by the dates"
            if day_first is None:
                guess = "check this: day before month, or false; the dates do not show it"
            lines.append(_entry(f"day_first = {str(day_first is not False).lower()}", guess))
        return lines
    numbers = np.array([plain_number(cell) for cell in filled])
    known = numbers[np.isfinite(numbers)]
    if len(known) < READ_SHARE * len(filled):
        return None
    # such as obc_seconds and tv_sec, but no durations: these are smaller than dates
    in_seconds = bool(words & {*SECOND_WORDS}) and words <= {*SECOND_WORDS, *CLOCK_WORDS}
    in_seconds = in_seconds and LONGEST_S < float(np.median(known)) < LAST_UNIX_S
    is_named = bool(words & {*TIME_WORDS}) or in_seconds
    if not is_named or words & {*YEAR_WORDS}:
        return None
    typical = float(np.median(known))
    # "tt" and "et" alone may name a temperature, or the time since the start of the file
    if words & {*TIME_WORDS} == {"j2000"} and words & {"tt", "et"} and typical < LONGEST_S:
        return None
    # whole Julian days are no times: their time of day is in another column
    in_julian_days = bool(words & {"jd", "julian"}) and FIRST_JD < typical < LAST_JD
    if in_julian_days and (known == np.round(known)).all():
        return None
    return _describe_counts(known, named)


def _describe_counts(known: np.ndarray, named: list[str]) -> list[str]:
    """Return the lines for a column of times that are numbers (n), from their size and steps and the words `named` of its name."""
    words = set(named)
    typical = float(np.median(known))
    steps = np.abs(np.diff(known))
    usual_step = float(np.median(steps[steps > 0])) if np.any(steps) else np.inf
    in_days = usual_step < MOST_DAYS
    sizes = LONG_UNITS_S | UNITS_S
    # "Time of day [s]" is in seconds, and "day_time" too if its numbers are too far apart for days
    units_s = [
        sizes[word] for word in " ".join(named).replace("of day", "").split() if word in sizes
    ]
    named_s = units_s[-1] if units_s else None
    if named_s is not None and named_s > 1 and named_s * usual_step > MOST_DAYS * 86_400:
        named_s = None
    may_be_days = in_days and named_s is None and not words & {"uptime", *BOARD_CLOCKS}
    if FIRST_JD < typical < LAST_JD and ("jd" in words or "julian" in words or may_be_days):
        lines = [_entry('time_format = "jd"', "days of the Julian Date; check this: of UTC")]
        if words & {"tt", "tdb", "tai"}:
            lines.append(
                "# check time_format: the name of the column says that the days are not of UTC, as which they are read: times are "
                "69 s late for TT and TDB, 37 s for TAI (2017 to 2026)"
            )
        return lines
    if _is_from_1970(typical, words):
        return [
            _entry('time_format = "elapsed"', "s of TT or TDB from 1970; check this"),
            _entry(f'epoch_utc = "{TT_1970_UTC}"', "00:00 TT, with the leap seconds of 1972"),
            _entry("counts_leap_seconds = true", ""),
        ]
    if "j2000" in words:
        small = (scale for scale in (1.0, 1e-3, 1e-6, 1e-9) if typical * scale < LAST_UNIX_S)
        in_days_s = 86_400.0 if in_days and typical < LAST_DAY else None
        scale = named_s or in_days_s or next(small, 1.0)
        return [
            _entry('time_format = "elapsed"', f"{UNIT_NAMES[scale]} from J2000"),
            _entry(f'epoch_utc = "{J2000_UTC}"', "12:00 TT; check this: or 12:00 UTC"),
            *([] if scale == 1 else [_entry(f"time_scale_s = {scale:g}", UNIT_NAMES[scale])]),
            _entry("counts_leap_seconds = true", ""),
        ]
    is_mjd = "mjd" in words or (LAST_DAY <= typical < LAST_MJD and in_days)
    if "mjd" in words and typical < FIRST_DAY:
        return [
            _entry('time_format = "elapsed"', "days of the Modified Julian Date from 2000"),
            _entry('epoch_utc = "2000-01-01T00:00:00Z"', "check this: or local time"),
            _entry("time_scale_s = 86400", "days"),
            _entry("counts_leap_seconds = false", ""),
        ]
    counts = ["mjd"] if is_mjd else ["excel"] * (FIRST_DAY < typical < LAST_DAY and in_days)
    for key in likely_counts(typical):
        is_sure = key in words or COUNTS[key].unit_s < 1 or (key == "datenum" and may_be_days)
        counts += [key] if is_sure and named_s in (None, COUNTS[key].unit_s) else []
    if counts:
        or_local = ": or local time, with time_zone" if counts[0] in LOCAL_FORMATS else ""
        what = f"{COUNTS[counts[0]].what}; check this{or_local}"
        return [_entry(f'time_format = "{counts[0]}"', what)]
    if "cuc" in words and (lines := _describe_cuc(typical * (named_s or 1.0))):
        scaled = [_entry(f"time_scale_s = {named_s:g}", UNIT_NAMES[named_s])] if named_s else []
        return [*lines, *(scaled if named_s != 1 else [])]
    is_unix = typical > FIRST_UNIX_S and (named_s is None or named_s >= 1)
    for scale in (1.0, 1e-3, 1e-6, 1e-9) if is_unix or named_s is None else (named_s,):
        if FIRST_UNIX_S < typical * scale < LAST_UNIX_S:
            scaled = [] if scale == 1 else [_entry(f"time_scale_s = {scale:g}", UNIT_NAMES[scale])]
            return [*_describe_large_count(typical * scale, UNIT_NAMES[scale], words), *scaled]
    is_scaled = named_s is not None and named_s != 1
    scaled = [_entry(f"time_scale_s = {named_s:g}", UNIT_NAMES[named_s])] if is_scaled else []
    return [
        _entry('time_format = "elapsed"', "the numbers are too small for dates"),
        _entry('epoch_utc = "2000-01-01T00:00:00Z"', "REPLACE by the UTC of time zero"),
        *scaled,
    ]


def _is_from_1970(typical: float, words: set[str]) -> bool:
    """Return whether a count of TT or TDB seconds (median `typical`) begins in 1970: from J2000 it is too late."""
    is_too_late = 2000 + typical / YEAR_S > LAST_YEAR and 1970 + typical / YEAR_S <= LAST_YEAR
    return bool(words & {"tt", "tdb", "et"}) and is_too_late


def _describe_cuc(typical_s: float) -> list[str]:
    """Return the lines for a CUC count whose median is `typical_s`, s; empty if no usual epoch gives a year of such telemetry.

    CCSDS 301.0-B recommends 1958; missions set others. Of several epochs the one with the latest year is taken.
    """
    years = {epoch: epoch + int(typical_s / YEAR_S) for epoch in CUC_EPOCHS}
    likely = [epoch for epoch, year in years.items() if FIRST_YEAR <= year <= LAST_YEAR]
    if not likely or typical_s < LONGEST_S:
        return []
    epoch = likely[-1]
    lines = [_entry(CUC_EPOCHS[epoch], f"CUC counted from {epoch}, by the year that it gives")]
    if epoch == 2000:
        lines.append(_entry('epoch_utc = "2000-01-01T00:00:00Z"', ""))
    others = [
        f"{other} ({CUC_EPOCHS[other].split(' = ')[1]}: {years[other]})" for other in likely[:-1]
    ]
    others_text = f", from {' or '.join(others)}" if others else ""
    lines.append(
        f"# check time_format: as CUC from {epoch} the times are of {years[epoch]}; the mission may count from another "
        f"epoch{others_text}"
    )
    return lines


def _describe_large_count(typical_s: float, unit: str, words: set[str]) -> list[str]:
    """Return the lines for a column of times that are as large as Unix times, with a remark if the clock may be another one.

    `typical_s`: their median in s; `unit`: that of the column in words; `words`: those of its name.
    """
    year = 1970 + int(typical_s / YEAR_S)
    lines = [_entry('time_format = "unix"', f"{unit} since 1970: {year}")]
    if "tai" in words and year <= LAST_YEAR:
        lines.append(
            f"# check time_format: as TAI from 1958 the times are of {year - 12}; for TAI from 1970 ({year}) set "
            'time_format = "elapsed", epoch_utc = "1969-12-31T23:59:50Z" and counts_leap_seconds = true'
        )
    elif words & {"gps", "gpst"} and year + 10 > LAST_YEAR:
        lines.append(
            f'# check time_format: as GPS seconds the times are of {year + 10}, as Unix times ("unix") of {year}'
        )
    if words & {"gps", "gpst", "tai", "unix", "utc"}:
        return lines
    if typical_s > LAST_CLOCK_S:
        likely = likely_counts(typical_s) if unit == UNIT_NAMES[1.0] else {}
        others = f"for others set {counts_in_words(likely)}" if likely else "TAI begins in 1958"
        lines.append(f"# check time_format: as Unix times these are of {year}; {others}")
    elif words & {*BOARD_CLOCKS} and typical_s < LAST_GPS_S:
        lines.append(
            f"# check time_format: as Unix times these are of {year}, by their size only; a clock on board that counts from 1980 "
            f"(GPS) shows {year + 10}"
        )
    return lines
