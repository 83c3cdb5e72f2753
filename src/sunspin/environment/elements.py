"""Orbital elements as others publish them: TLE and OMM (CCSDS 502.0-B) in, one sentence on what is wrong with them."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from string import digits as DIGITS
from typing import Any
from xml.etree import ElementTree

import numpy as np

from sunspin.base.errors import InputError
from sunspin.base.untrusted import plain_number

OLD_DAYS = 10.0
"""Elements farther than this from the telemetry are warned about: the place along the track is no longer known to a few seconds."""

THREE = r"(?:\d{3}| \d\d|  \d)"
"""A whole number of at most three digits, at the right of its columns: SGP4's own reader takes `1 5` for 1."""

LINE_1 = re.compile(
    rf"1 [0-9A-Z ][0-9 ]{{4}}[ -~] [ -~]{{8}} \d\d{THREE}\.\d{{8}} [-+ ][ .\d]\d{{8}} "
    r"[-+ ]\d{5}[-+]\d [-+ ]\d{5}[-+]\d [ \d] [ \d]{4}\d",
    re.ASCII,
)
LINE_2 = re.compile(
    rf"2 [0-9A-Z ][0-9 ]{{4}} {THREE}\.\d{{4}} {THREE}\.\d{{4}} \d{{7}} {THREE}\.\d{{4}} {THREE}\.\d{{4}} "
    r"[ \d]\d\.\d{8}[ \d]{5}\d",
    re.ASCII,
)
"""Columns of the two lines, checksum included."""

KEYS = (
    "EPOCH",
    "MEAN_MOTION",
    "ECCENTRICITY",
    "INCLINATION",
    "RA_OF_ASC_NODE",
    "ARG_OF_PERICENTER",
    "MEAN_ANOMALY",
    "NORAD_CAT_ID",
    "BSTAR",
    "MEAN_MOTION_DOT",
    "MEAN_MOTION_DDOT",
)
"""What SGP4 needs of an OMM."""

ASSUMED = {
    "EPHEMERIS_TYPE": "0",
    "CLASSIFICATION_TYPE": "U",
    "ELEMENT_SET_NO": "0",
    "REV_AT_EPOCH": "0",
    "OBJECT_ID": "",
    "OBJECT_NAME": "",
    "MEAN_MOTION_DDOT": "0",
}


@dataclass(frozen=True)
class Elements:
    """One set of mean elements for SGP4, as it was given: the two lines, or the keys of an OMM.

    `epoch_jd`: its instant, a UTC Julian date in two parts; `where` names file and line in messages.
    """

    given: tuple[str, str] | tuple[tuple[str, str], ...]
    number: int
    name: str
    epoch_jd: tuple[float, float]
    where: str
    frame: str = "TEME"

    def states(self, jd: np.ndarray, fraction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (n, 3) m and velocities (n, 3) m/s in the true equator and mean equinox of date, at UTC Julian dates (n) and
        fractions of a day (n). `InputError` where SGP4 gives none: the orbit has decayed, or is none."""
        error, place, speed = _satrec(self.given).sgp4_array(
            np.ascontiguousarray(jd), np.ascontiguousarray(fraction)
        )
        if error.any():
            from sgp4.api import SGP4_ERRORS

            what = f"these elements cannot be propagated to the telemetry: {SGP4_ERRORS[int(error[error > 0][0])]}"
            raise InputError(what, do="give elements of the telemetry's time", where=self.where)
        return 1e3 * place, 1e3 * speed

    def require(self, jd: np.ndarray) -> None:
        """SGP4 gives a place at any time."""

    @property
    def period_s(self) -> float:
        return float(2 * np.pi / _satrec(self.given).no_kozai * 60)

    def days_to(self, jd: float) -> float:
        """Days from the epoch to a UTC Julian date."""
        return jd - self.epoch_jd[0] - self.epoch_jd[1]


@lru_cache(maxsize=64)
def _satrec(given: tuple) -> Any:
    from sgp4 import omm
    from sgp4.api import Satrec

    if isinstance(given[0], str):
        return Satrec.twoline2rv(*given)
    satellite = Satrec()
    omm.initialize(satellite, dict(given))
    return satellite


def parse_elements(text: str, where: str) -> tuple[Elements, ...]:
    """The element sets of one satellite, oldest first: TLE, with names or without, or OMM as KVN, XML, CSV or JSON.

    `where` names the file in messages. `InputError` names file, line, what was found there and what to do.
    """
    begin = text.lstrip()[:1]
    if begin == "<":
        messages = _xml(text, where)
    elif begin in ("[", "{"):
        messages = _json(text, where)
    elif "MEAN_MOTION" in text.split("\n", 1)[0]:
        messages = csv.DictReader(io.StringIO(text.strip()))
    elif re.search(r"^\s*MEAN_MOTION\s*=", text, re.MULTILINE):
        messages = _kvn(text)
    else:
        messages = None
    if messages is None:
        sets = list(_lines(text, where))
    else:
        sets = [_from_omm(fields, where) for fields in messages]
    if not sets:
        do = "give two lines that begin with 1 and 2, or an OMM"
        raise InputError("no orbital elements here", do=do, where=where)
    numbers = sorted({elements.number for elements in sets})
    if len(numbers) > 1:
        what = f"the file has elements of {len(numbers)} satellites"
        do = "keep those of yours"
        raise InputError(what, got=", ".join(map(str, numbers[:4])), do=do, where=where)
    return tuple(sorted(sets, key=lambda elements: elements.epoch_jd))


def nearest(sets: tuple[Elements, ...], jd: float) -> Elements:
    """The elements whose epoch is nearest to a UTC Julian date."""
    return min(sets, key=lambda elements: abs(elements.days_to(jd)))


# ------------------------------------------------------------------------------------------------------------------------- TLE


def _lines(text: str, where: str) -> Iterator[Elements]:
    name, first = "", None
    for number, line in enumerate(text.splitlines(), 1):
        line, at = line.strip(), f"{where}, line {number}"
        if not line or line.startswith("#"):
            continue
        if first is None and line.startswith(("1 ", "2 ")):
            if line[0] == "2" and len(line) > 60:
                what = "line 2 of the elements comes before line 1"
                raise InputError(what, do="exchange the two lines", where=at)
            first = _checked(line, LINE_1, at)
        elif first is not None:
            if not line.startswith("2 "):
                what = "line 2 of the elements must follow their line 1"
                raise InputError(what, got=line, where=at)
            second = _checked(line, LINE_2, at)
            if first[2:7] != second[2:7]:
                what, got = "the two lines are of different satellites", (first[2:7], second[2:7])
                raise InputError(what, got=" and ".join(got), do="keep those of yours", where=at)
            if not 1 <= float(first[20:32]) < 367:
                what = "the epoch's day of the year must be from 1 to 366"
                raise InputError(what, got=first[20:32], where=at)
            yield _elements((first, second), name, at)
            name, first = "", None
        else:
            name = line.removeprefix("0 ").strip()[:100]
    if first is not None:
        raise InputError("line 1 of the elements has no line 2", do="add it", where=where)


def _checked(line: str, form: re.Pattern[str], at: str) -> str:
    if len(line) != 69:
        what = "a line of elements has 69 characters"
        raise InputError(what, got=f"{len(line)}", do="copy it whole", where=at)
    total = sum(int(c) if c in DIGITS else c == "-" for c in line[:68]) % 10
    if line[68] != str(total):
        what = f"the checksum of the line is {total}, but its last character says {line[68]!r}"
        raise InputError(what, do="the line was damaged or edited: copy it again", where=at)
    if not form.fullmatch(line):
        what = "the columns are not those of a line of elements"
        raise InputError(what, got=line, do="copy it again", where=at)
    return line


def _elements(given: tuple, name: str, at: str) -> Elements:
    try:
        satellite = _satrec(given)
    except (ValueError, TypeError, KeyError, RuntimeError) as error:
        what = f"the elements cannot be read ({error})"
        raise InputError(what, do="copy them again", where=at) from None
    if satellite.error or not satellite.no_kozai > 0:
        what, do = "the elements are those of no orbit", "check mean motion and eccentricity"
        raise InputError(what, do=do, where=at)
    epoch_jd = satellite.jdsatepoch, satellite.jdsatepochF
    return Elements(given, int(satellite.satnum), name, epoch_jd, at)


# ------------------------------------------------------------------------------------------------------------------------- OMM


def _from_omm(fields: dict[str, Any], where: str) -> Elements:
    known = ASSUMED | {
        str(key).strip(): str(value).strip()
        for key, value in fields.items()
        if key and value not in (None, "")
    }
    if missing := [key for key in KEYS if key not in known]:
        do = "give the whole message"
        raise InputError("the OMM lacks a key", got=missing[0], do=do, where=where)
    theory = known.get("MEAN_ELEMENT_THEORY", "SGP4")
    if theory.upper().replace("/", "") not in ("SGP4", "SGP", "SGPSGP4"):
        what, do = "the OMM's elements are not for SGP4", "give SGP4 elements"
        raise InputError(what, got=theory, do=do, where=where)
    for key in KEYS[1:]:
        if np.isnan(plain_number(known[key])):
            raise InputError(f"{key} must be a number", got=known[key], where=where)
    epoch = known["EPOCH"].rstrip("Z")
    if not re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?", epoch, re.ASCII):
        what = "EPOCH must be a UTC time such as 2026-01-31T12:00:00.0"
        raise InputError(what, got=known["EPOCH"], where=where)
    known["EPOCH"] = epoch if "." in epoch else epoch + ".0"
    wanted = {key: known[key] for key in (*KEYS, *ASSUMED)}
    return _elements(tuple(sorted(wanted.items())), known["OBJECT_NAME"][:100], where)


def _kvn(text: str) -> Iterator[dict[str, str]]:
    """Messages of keys and values; each begins with its version or name, of which a file may have either."""
    fields: dict[str, str] = {}
    for line in text.splitlines():
        key, equals, value = line.partition("=")
        key = key.strip()
        if not equals:
            continue
        if key in fields:
            yield fields
            fields = {}
        fields[key] = value.split("[")[0].strip()
    if fields:
        yield fields


def _json(text: str, where: str) -> list[dict[str, Any]]:
    try:
        table = json.loads(text)
    except (ValueError, RecursionError):
        raise InputError("this is not valid JSON", do="give the whole file", where=where) from None
    table = table if isinstance(table, list) else [table]
    if not all(isinstance(message, dict) for message in table):
        do = "give a list of messages with the keys of an OMM"
        raise InputError("the JSON is not an OMM", do=do, where=where)
    return table


def xml_root(text: str, kind: str, where: str) -> ElementTree.Element:
    """The root of an XML text, a `kind` of file, without entities: a few lines of those may stand for gigabytes."""
    if "<!" in text.replace("<!--", ""):
        raise InputError("the XML defines entities", do=f"give a plain {kind}", where=where)
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        what = f"this is not valid XML ({error})"
        raise InputError(what, do="give the whole file", where=where) from None


def _xml(text: str, where: str) -> Iterator[dict[str, str]]:
    root = xml_root(text, "OMM", where)
    for message in root.iter("omm"):
        yield {leaf.tag: leaf.text or "" for leaf in message.iter() if not len(leaf)}
