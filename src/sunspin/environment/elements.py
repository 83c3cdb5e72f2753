"""Orbital elements as published: TLE and OMM (CCSDS 502.0-B), with one error sentence for each defect."""

from __future__ import annotations

import csv
import io
import json
import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from difflib import get_close_matches
from functools import lru_cache
from string import digits as DIGITS
from typing import Any
from xml.etree import ElementTree

import numpy as np

from sunspin.base.errors import InputError
from sunspin.base.untrusted import plain_number
from sunspin.environment.earth import TIME_SCALES, Instants, ahead_of_utc_s

OLD_DAYS = 10.0
"""Age of elements beyond which a warning is given: the position along the track is not known to a few seconds any more."""

THREE_DIGITS = r"(?:\d{3}| \d\d|  \d)"
"""A whole number of up to three digits, right-aligned: SGP4's own reader would take `1 5` for 1."""

LINE_1 = re.compile(
    rf"1 [0-9A-Z ][0-9 ]{{4}}[ -~] [ -~]{{8}} \d\d{THREE_DIGITS}\.\d{{8}} [-+ ][ .\d]\d{{8}} "
    r"[-+ ]\d{5}[-+]\d [-+ ]\d{5}[-+]\d [ \d] [ \d]{4}\d",
    re.ASCII,
)
LINE_2 = re.compile(
    rf"2 [0-9A-Z ][0-9 ]{{4}} {THREE_DIGITS}\.\d{{4}} {THREE_DIGITS}\.\d{{4}} \d{{7}} "
    rf"{THREE_DIGITS}\.\d{{4}} {THREE_DIGITS}\.\d{{4}} "
    r"[ \d]\d\.\d{8}[ \d]{5}\d",
    re.ASCII,
)
"""Columns of the two lines, checksum included."""

EPHEMERIS_COLUMN = 62
"""Index in line 1 of the ephemeris type, which names the propagator of the elements."""

FOR_SGP4 = ("0", "1", "2", "3")
"""Ephemeris types of elements for SGP4: 0 in nearly all, 1 (SGP), 2 (SGP4) and 3 (SDP4, its deep-space part) in a few.
Type 4 is SGP4-XP, whose elements SGP4 propagates to wrong positions without an error."""

NUMERIC_KEYS = (
    "MEAN_MOTION",
    "ECCENTRICITY",
    "INCLINATION",
    "RA_OF_ASC_NODE",
    "ARG_OF_PERICENTER",
    "MEAN_ANOMALY",
    "BSTAR",
    "MEAN_MOTION_DOT",
    "MEAN_MOTION_DDOT",
)
"""Numbers of an OMM that SGP4 needs."""

REQUIRED_KEYS = ("EPOCH", *NUMERIC_KEYS[:6], "NORAD_CAT_ID", *NUMERIC_KEYS[6:])
"""Keys that an OMM must have."""

DEFAULTS = {
    "CENTER_NAME": "EARTH",
    "REF_FRAME": "TEME",
    "TIME_SYSTEM": "UTC",
    "MEAN_ELEMENT_THEORY": "SGP4",
    "EPHEMERIS_TYPE": "0",
    "OBJECT_NAME": "",
    "MEAN_MOTION_DDOT": "0",
}
"""Meaning of an OMM without a key: the first four hold for all published elements for SGP4."""

THEORIES = {"SGP", "SGP4", "SGPSGP4", "SDP4", "SGP4SDP4"}
TEME = {"TEME", "TEMEOFDATE"} | {
    f"TRUEEQUATOR{link}MEANEQUINOX{date}" for link in ("", "AND") for date in ("", "OFDATE")
}
"""Names of the theory and of the frame, in capitals, with letters and digits only."""

FIRST_YEAR = 1957
"""Year of the first satellite."""

UNUSED_KEYS = {
    "NORAD_CAT_ID": "0",
    "EPHEMERIS_TYPE": "0",
    "CLASSIFICATION_TYPE": "U",
    "ELEMENT_SET_NO": "0",
    "REV_AT_EPOCH": "0",
    "OBJECT_ID": "",
}
"""Values of keys that the library `sgp4` requires but that do not affect the orbit; it accepts no number above 339999."""

CSV_DELIMITERS = ",;\t"
"""Characters between the columns of an OMM as CSV; the one that occurs most often in the header is used."""

ALPHA_5 = "0123456789ABCDEFGHJKLMNPQRSTUVWXYZ"
"""Alpha-5: the ten thousands of a catalogue number as one character, without I and O."""


@dataclass(frozen=True)
class Elements:
    """A set of mean elements for SGP4, as given: two lines, or keys of an OMM.

    `epoch_jd`: its epoch, a UTC Julian date in two parts; `where` names file and line in messages.
    """

    given: tuple[str, str] | tuple[tuple[str, str], ...]
    number: int
    name: str
    epoch_jd: tuple[float, float]
    where: str
    frame: str = "TEME"

    def states(self, jd: np.ndarray, fraction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (n, 3) m and velocities (n, 3) m/s in TEME, at UTC Julian dates (n) and fractions of a day (n).

        Raises `InputError` if SGP4 fails, for example as the orbit has decayed.
        """
        error, position_km, velocity_km_s = _satrec(self.given).sgp4_array(
            np.ascontiguousarray(jd), np.ascontiguousarray(fraction)
        )
        if error.any():
            from sgp4.api import SGP4_ERRORS

            why = SGP4_ERRORS[int(error[error > 0][0])]
            what = f"these elements cannot be propagated to the telemetry: {why}"
            raise InputError(what, do="give elements of the telemetry's time", where=self.where)
        return 1e3 * position_km, 1e3 * velocity_km_s

    def require_coverage(self, jd: np.ndarray) -> None:
        """Accept any time, as SGP4 has no limits in time."""

    @property
    def period_s(self) -> float:
        """Orbital period."""
        return float(2 * np.pi / _satrec(self.given).no_kozai * 60)  # mean motion in rad/min

    def days_to(self, jd: float) -> float:
        """Return the days from the epoch to a UTC Julian date."""
        return jd - self.epoch_jd[0] - self.epoch_jd[1]


@lru_cache(maxsize=64)
def _satrec(given: tuple) -> Any:
    """Return the object of the library `sgp4` for elements."""
    from sgp4 import omm
    from sgp4.api import Satrec

    if isinstance(given[0], str):
        return Satrec.twoline2rv(*given)
    satellite = Satrec()
    omm.initialize(satellite, dict(given))
    return satellite


def parse_elements(text: str, where: str, satellite: str = "") -> tuple[Elements, ...]:
    """Parse the element sets of one satellite, oldest first: TLE, with or without names or in JSON, or OMM as KVN, XML, CSV, JSON.

    A text with several satellites, as catalogues publish them, needs `satellite`: its catalogue number, or its name in capitals or
    small letters. `where` names the file in messages. Raises `InputError` with the file, the line, the offending text and the
    advice.
    """
    # the form of an OMM shows at the begin of the text, or by its keys; each message is a dict of the keys
    first_character = text.lstrip()[:1]
    if first_character == "<":
        messages = _read_xml(text, where)
    elif first_character in ("[", "{"):
        messages = _read_json(text, where)
    elif "MEAN_MOTION" in (header := text.strip().split("\n", 1)[0]):
        delimiter = max(CSV_DELIMITERS, key=header.count)
        messages = csv.DictReader(io.StringIO(text.strip()), delimiter=delimiter)
    elif re.search(r"^\s*MEAN_MOTION\s*=", text, re.MULTILINE):
        messages = _read_kvn(text)
    else:
        messages = None
    if messages is None:
        sets = list(_read_tle(text, where))
    else:
        messages, sets = list(messages), []
        for k, fields in enumerate(messages, 1):
            at = where if len(messages) == 1 else f"{where}, message {k}"
            if lines := _lines_in_message(fields):
                sets += _read_tle(lines, at)
            else:
                sets.append(_from_omm(fields, at))
    if not sets:
        do = "give two lines that begin with 1 and 2, an OMM, or a CSV with time_utc, x_km, y_km, z_km"
        raise InputError("no orbital elements here", do=do, where=where)
    if satellite:
        sets = _select_satellite(sets, satellite, where)
    numbers = sorted({elements.number for elements in sets})
    if len(numbers) > 1:
        what = f"the file has elements of {len(numbers)} satellites"
        do = "name yours with --norad and its catalogue number"
        raise InputError(what, got=_describe_satellites(sets), do=do, where=where)
    return tuple(sorted(sets, key=lambda elements: elements.epoch_jd))


def _select_satellite(sets: list[Elements], satellite: str, where: str) -> list[Elements]:
    """Return the element sets of the satellite with this catalogue number or name; raise `InputError` if there are none.

    A name that only begins or ends so is not taken: the satellites of a launch differ by their last letter.
    """
    wanted = satellite.strip()
    is_number = re.fullmatch(r"\d{1,9}|[A-Z]\d{4}", wanted, re.ASCII) is not None
    number = _parse_catalogue_number(wanted, where) if is_number else None
    chosen = [
        elements
        for elements in sets
        if elements.number == number or elements.name.casefold() == wanted.casefold()
    ]
    if not chosen:
        names = {elements.name.casefold(): elements for elements in sets if elements.name}
        similar = get_close_matches(wanted.casefold(), names, n=4, cutoff=0.4)
        near = [names[name] for name in similar] or sets
        what = f"the file has no elements of {wanted[:100]!r}"
        do = f"give one of its {len({each.number for each in sets})} satellites, by number or name"
        raise InputError(what, got=_describe_satellites(near), do=do, where=where)
    return chosen


def _describe_satellites(sets: list[Elements]) -> str:
    """Return the catalogue numbers, with names where there are any, of the first four satellites."""
    satellites = dict.fromkeys((elements.number, elements.name) for elements in sets)
    return ", ".join(
        f"{number} ({name[:24]})" if name else str(number) for number, name in [*satellites][:4]
    )


def nearest(sets: tuple[Elements, ...], jd: float) -> Elements:
    """Return the elements whose epoch is nearest to a UTC Julian date."""
    return min(sets, key=lambda elements: abs(elements.days_to(jd)))


# ------------------------------------------------------------------------------------------------------------------------- TLE


def _read_tle(text: str, where: str) -> Iterator[Elements]:
    """Yield the element sets of a text in lines; a line before each pair may be a name."""
    name, first = "", None
    for number, line in enumerate(text.splitlines(), 1):
        line, at = line.strip(), f"{where}, line {number}"
        if not line or line.startswith("#"):
            continue
        # a blank of any kind: `_check_line` names one that is not plain
        if first is None and re.match(r"[12]\s", line):
            # a short line that begins with 2 is damaged, which `_check_line` reports
            if line[0] == "2" and len(line) > 60:
                what = "line 2 of the elements comes before line 1"
                raise InputError(what, do="exchange the two lines", where=at)
            first = _check_line(line, LINE_1, at)
            _require_SGP4(first[EPHEMERIS_COLUMN].replace(" ", "0"), at)
        elif first is not None:
            if not re.match(r"2\s", line):
                what = "line 2 of the elements must follow their line 1"
                raise InputError(what, got=line, where=at)
            second = _check_line(line, LINE_2, at)
            # columns 3 to 7: catalogue number; 21 to 32 of line 1: day of the year of the epoch
            satellites = [_parse_catalogue_number(each[2:7], at) for each in (first, second)]
            if satellites[0] != satellites[1]:
                what, got = "the two lines are of different satellites", (first[2:7], second[2:7])
                raise InputError(what, got=" and ".join(got), do="keep those of yours", where=at)
            if not 1 <= float(first[20:32]) < 367:
                what = "the epoch's day of the year must be from 1 to 366"
                raise InputError(what, got=first[20:32], where=at)
            # the library reads catalogue numbers padded with zeros only
            given = tuple(
                f"{each[:2]}{each[2:7].strip():0>5}{each[7:]}" for each in (first, second)
            )
            yield _build_elements(given, satellites[0], name, at)
            name, first = "", None
        else:
            name = line.removeprefix("0 ").strip()[:100]
    if first is not None:
        raise InputError("line 1 of the elements has no line 2", do="add it", where=where)


def _check_line(line: str, columns: re.Pattern[str], at: str) -> str:
    """Return a line of elements unchanged if its length, checksum and columns are valid; raise `InputError` otherwise.

    `columns`: `LINE_1` or `LINE_2`; `at` names file and line.
    """
    # a copy from a web page or a text processor looks right and is not
    if foreign := re.search(r"[^ -~]", line):
        name = unicodedata.name(foreign[0], "a control character").lower()
        what = f"the line contains a character that no line of elements has, in column {foreign.start() + 1}"
        got, do = f"{name}, U+{ord(foreign[0]):04X}", "copy the line again"
        if foreign[0].isspace():
            do = "write a plain blank there"
        elif foreign[0] == "\N{MINUS SIGN}" or unicodedata.category(foreign[0]) == "Pd":
            do = "write a plain minus (-) there"
        raise InputError(what, got=got, do=do, where=at)
    if len(line) != 69:
        what = "a line of elements has 69 characters"
        raise InputError(what, got=f"{len(line)}", do="copy it whole", where=at)
    # sum of all digits, where a minus sign counts as 1, modulo 10
    checksum = sum(int(c) if c in DIGITS else c == "-" for c in line[:68]) % 10
    if line[68] != str(checksum):
        what = f"the checksum of the line is {checksum}, but its last character says {line[68]!r}"
        raise InputError(what, do="the line was damaged or edited: copy it again", where=at)
    if not columns.fullmatch(line):
        what = "the columns are not those of a line of elements"
        raise InputError(what, got=line, do="copy it again", where=at)
    return line


def _parse_catalogue_number(text: str, at: str) -> int:
    """Return the catalogue number of a satellite: digits, possibly padded with blanks or zeros, or Alpha-5.

    A spreadsheet may have written it as 25544.0.
    """
    text = text.strip()
    if digits := re.fullmatch(r"0*(\d{1,9})(\.0*)?", text, re.ASCII):
        return int(digits[1])
    if re.fullmatch(r"[A-Z]\d{4}", text, re.ASCII) and text[0] in ALPHA_5:
        return ALPHA_5.index(text[0]) * 10_000 + int(text[1:])
    what = "the catalogue number of the satellite cannot be read"
    do = "write up to nine digits, or in Alpha-5 a letter other than I and O and four digits"
    raise InputError(what, got=text, do=do, where=at)


def _require_SGP4(ephemeris_type: str, at: str) -> None:
    """Raise `InputError` for elements of another propagator, by their ephemeris type."""
    if ephemeris_type not in FOR_SGP4:
        xp = " (SGP4-XP)" if ephemeris_type == "4" else ""
        what = "the ephemeris type says that the elements are not for SGP4"
        do = "get elements for SGP4, of ephemeris type 0 to 3"
        raise InputError(what, got=f"{ephemeris_type}{xp}", do=do, where=at)


def _build_elements(given: tuple, number: int, name: str, at: str) -> Elements:
    """Return elements that SGP4 accepts; raise `InputError` otherwise."""
    try:
        satellite = _satrec(given)
    except (ValueError, TypeError, KeyError, RuntimeError) as error:
        what = f"the elements cannot be read ({error})"
        raise InputError(what, do="copy them again", where=at) from None
    if satellite.error or not satellite.no_kozai > 0:
        what, do = "the elements are those of no orbit", "check mean motion and eccentricity"
        raise InputError(what, do=do, where=at)
    epoch_jd = satellite.jdsatepoch, satellite.jdsatepochF
    return Elements(given, number, name, epoch_jd, at)


# ------------------------------------------------------------------------------------------------------------------------- OMM


def _from_omm(fields: dict[str, Any], where: str) -> Elements:
    """Return the elements of one OMM.

    Raises `InputError` if its theory, frame, centre or time system is not supported.
    """
    # keys without a value have the default
    known = DEFAULTS | {
        str(key).strip().upper(): text
        for key, value in fields.items()
        if key and value is not None and (text := str(value).strip())
    }
    if _normalise_name(known["MEAN_ELEMENT_THEORY"]) not in THEORIES:
        what, do = "the OMM's elements are not for SGP4", "give SGP4 elements"
        raise InputError(what, got=known["MEAN_ELEMENT_THEORY"], do=do, where=where)
    ephemeris_type = known["EPHEMERIS_TYPE"].removesuffix(".0").lstrip("0") or "0"  # 0.0 and 00: 0
    _require_SGP4(ephemeris_type, where)
    if known["CENTER_NAME"].upper() not in ("EARTH", "399"):  # 399 is NAIF's number of the Earth
        what, do = "CENTER_NAME of the OMM is not EARTH", "give elements about the Earth"
        raise InputError(what, got=known["CENTER_NAME"], do=do, where=where)
    if _normalise_name(known["REF_FRAME"]) not in TEME:
        what = "REF_FRAME of the OMM is not TEME, the frame of SGP4"
        do = "get SGP4 elements, whose frame is TEME: a changed label would turn the orbit"
        raise InputError(what, got=known["REF_FRAME"], do=do, where=where)
    if missing := [key for key in REQUIRED_KEYS if key not in known]:
        do = "give the whole message"
        raise InputError("the OMM lacks a key", got=missing[0], do=do, where=where)
    for key in NUMERIC_KEYS:
        if np.isnan(plain_number(known[key])):
            raise InputError(f"{key} must be a number", got=known[key], where=where)
    number = _parse_catalogue_number(known["NORAD_CAT_ID"], where)
    epoch = known["EPOCH"]
    if "." not in epoch and "EPOCH_MICROSECONDS" in known:  # former messages of Space-Track
        epoch = f"{epoch}.{known['EPOCH_MICROSECONDS']:0>6}"
    epoch = _parse_epoch(epoch, known["TIME_SYSTEM"], where).isoformat(timespec="microseconds")
    given = UNUSED_KEYS | {key: known[key] for key in NUMERIC_KEYS} | {"EPOCH": epoch}
    return _build_elements(tuple(sorted(given.items())), number, known["OBJECT_NAME"][:100], where)


def _normalise_name(name: str) -> str:
    """Return a name in capitals, with letters and digits only."""
    return re.sub(r"[^A-Z0-9]", "", name.upper())


def _parse_epoch(epoch: str, scale: str, where: str) -> datetime:
    """Return the UTC of an epoch given in a time scale, as a calendar date or a day of the year.

    Raises `InputError` if the epoch is no time since 1957, or its time scale cannot be converted.
    """
    # groups: date and time to the second, day of the year if there is one, fraction of the second
    match = re.fullmatch(
        r"(\d{4}-(?:\d\d-\d\d|(\d{3}))[T ]\d\d:\d\d:\d\d)(\.\d+)?Z?", epoch, re.ASCII
    )
    try:
        if match is None:
            raise ValueError
        date_format = "%Y-%j" if match[2] else "%Y-%m-%d"
        given = datetime.strptime(match[1].replace(" ", "T"), f"{date_format}T%H:%M:%S")
        if given.year < FIRST_YEAR or given.year != int(match[1][:4]):  # day 366 of a common year
            raise ValueError
    except ValueError:
        what = "EPOCH must be a time such as 2026-01-31T12:00:00.0"
        raise InputError(what, got=epoch, where=where) from None
    given += timedelta(seconds=float(match[3] or 0))
    exact = [each for each in TIME_SCALES if each != "UT1"]  # known to 0.9 s only, 7 km of flight
    if scale.upper() not in exact:
        what = "TIME_SYSTEM of the OMM cannot be converted to UTC"
        do = f"give EPOCH and TIME_SYSTEM in one of {', '.join(exact)}"
        raise InputError(what, got=scale, do=do, where=where)
    utc = given
    # the number of leap seconds depends on the UTC, which is known after the first iteration
    for _ in range(2):
        when = Instants.of(utc.isoformat(), np.zeros(1))
        utc = given - timedelta(seconds=ahead_of_utc_s(scale.upper(), when))
    return utc


def _read_kvn(text: str) -> Iterator[dict[str, str]]:
    """Yield the messages of a text in KVN, a line `key = value` for each field, as dicts key -> value.

    Comments, units in brackets and semicolons after a value are left out. A key that the message already has begins the next one.
    """
    fields: dict[str, str] = {}
    for line in text.splitlines():
        key, equals, value = line.partition("=")
        key = key.strip()
        if not equals or key.startswith("COMMENT"):
            continue
        if key in fields:
            yield fields
            fields = {}
        fields[key] = value.split("[")[0].strip().removesuffix(";").rstrip()
    if fields:
        yield fields


def _read_json(text: str, where: str) -> list[dict[str, Any]]:
    """Return the messages of a JSON text; raise `InputError` for anything else.

    The text is an object, a list of objects, an object that holds such a list (a page of a web interface), or an object a line.
    """
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        try:
            data = [json.loads(line) for line in text.splitlines() if line.strip()]
        except (ValueError, RecursionError):
            do = "give the whole file"
            raise InputError("this is not valid JSON", do=do, where=where) from None
    messages = data if isinstance(data, list) else [data]
    if isinstance(data, dict):
        lists = [item for item in data.values() if isinstance(item, list) and item]
        messages = lists[0] if len(lists) == 1 else messages
    if not all(isinstance(message, dict) for message in messages):
        do = "give a list of messages with the keys of an OMM"
        raise InputError("the JSON is not an OMM", do=do, where=where)
    return messages


def _lines_in_message(fields: dict[str, Any]) -> str:
    """Return the two lines of elements in a message without the keys of an OMM, after the name if there is one; else an empty text.

    Web interfaces such as those of SatNOGS and N2YO send lines under keys of their own.
    """
    texts = {str(key).lower(): value for key, value in fields.items() if isinstance(value, str)}
    lines = [line.strip() for text in texts.values() for line in text.splitlines()]
    pair = [next((line for line in lines if line[:2] == start), "") for start in ("1 ", "2 ")]
    if not all(pair) or "mean_motion" in texts or "MEAN_MOTION" in fields:
        return ""
    names = (texts.get(key, "") for key in ("tle0", "object_name", "name", "satname"))
    return "\n".join([next(filter(None, names), ""), *pair])


def parse_xml(text: str, kind: str, where: str) -> ElementTree.Element:
    """Return the root of an XML text; `kind` ("OMM" or "OEM") names the file in messages.

    Entities are refused, as a few lines of them can expand to gigabytes.
    """
    # declarations begin with "<!", as do comments and plain texts (CDATA), which are allowed
    if "<!" in text.replace("<!--", "").replace("<![CDATA[", ""):
        what = "the XML has a document type, which can define entities"
        raise InputError(
            what, do=f"remove it (<!DOCTYPE ...>), or give a plain {kind}", where=where
        )
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        what = f"this is not valid XML ({error})"
        raise InputError(what, do="give the whole file", where=where) from None


def _read_xml(text: str, where: str) -> Iterator[dict[str, str]]:
    """Yield the messages of an XML text: the texts of the elements without children, by name."""
    root = parse_xml(text, "OMM", where)
    for message in root.iter():
        if _tag_name(message) == "omm":
            yield {_tag_name(leaf): leaf.text or "" for leaf in message.iter() if not len(leaf)}


def _tag_name(element: ElementTree.Element) -> str:
    """Return the name of an XML element without its namespace; empty for a comment."""
    return str(element.tag).rpartition("}")[2]
