"""Conversion of GPS time and TAI to UTC with the table of leap seconds of ERFA, and counts of days, seconds and ticks."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import cache
from typing import NamedTuple

import numpy as np

UNIX_ZERO = datetime(1970, 1, 1, tzinfo=UTC)

GPS_ZERO_S = (datetime(1980, 1, 6, tzinfo=UTC) - UNIX_ZERO).total_seconds()
"""Epoch of GPS time, 6 January 1980, in s from 1970 (IS-GPS-200)."""

TAI_AHEAD_OF_GPS_S = 19.0
"""TAI minus GPS time, which is constant."""

TT_AHEAD_OF_TAI_S = 32.184
"""TT minus TAI, which is constant; TDB differs from TT by less than 2 ms (IAU 2006 resolution B3)."""

J2000_UTC = "2000-01-01T11:58:55.816Z"
"""The epoch J2000: 12:00 TT, 32.184 s ahead of TAI, which was 32 s ahead of UTC."""

TAI_ZERO_S = (datetime(1958, 1, 1, tzinfo=UTC) - UNIX_ZERO).total_seconds()
"""Epoch of a count of TAI seconds, 1 January 1958 (CCSDS 301.0-B), in s from 1970."""

WEEK_S = 604_800.0

WEEKS_TO_ROLLOVER = 1024
"""Weeks after which the ten-bit week number of GPS begins again."""

DAY_S = 86_400.0

YEAR_S = 365.25 * DAY_S

FIRST_YEAR, LAST_YEAR = 2000, 2032
"""Years of telemetry in files whose epoch is not known."""

FIRST_UNIX_S, LAST_CLOCK_S = 9e8, 2.0**31
"""Unix times from 1998 to 2038; others may be counts from another instant."""

MOST_DAYS = 0.05
"""The largest interval of samples in days; as seconds it would be shorter than any."""

TIME_SCALES = {"gps": "gps", "gpst": "gps", "tai": "tai", "tt": "tt", "tdb": "tt"}
"""Words in the name of a time column -> the `time_format` of its time scale."""


class Count(NamedTuple):
    """A count of UTC from another instant than 1970: its name, its zero in s from 1970, and its unit in s."""

    what: str
    zero_s: float
    unit_s: float

    def unix_s(self, number: np.ndarray) -> np.ndarray:
        """Return counts (n) in s from 1970, to 0.1 ms."""
        return np.round(number * self.unit_s + self.zero_s, 4)


COUNTS = {
    "jd": Count("days of the Julian Date", -2_440_587.5 * DAY_S, DAY_S),
    "mjd": Count("days of the Modified Julian Date", -40_587 * DAY_S, DAY_S),
    "excel": Count("days since 1899-12-30, as in spreadsheets", -25_569 * DAY_S, DAY_S),
    "datenum": Count("days of datenum in MATLAB", -719_529 * DAY_S, DAY_S),
    "labview": Count("seconds since 1904, as in LabVIEW", -24_107 * DAY_S, 1.0),
    "ntp": Count("seconds since 1900, as in NTP", -25_567 * DAY_S, 1.0),
    "filetime": Count("FILETIME of Windows, 100 ns since 1601", -134_774 * DAY_S, 1e-7),
    "ticks": Count("ticks of .NET, 100 ns since the year 1", -719_162 * DAY_S, 1e-7),
}
"""Values of `time_format` for counts that are no Unix time."""


def likely_counts(number: float) -> dict[str, int]:
    """Return those of `COUNTS` by which a number is a time from `FIRST_YEAR` to `LAST_YEAR`, each with its year."""
    seconds = {key: number * count.unit_s + count.zero_s for key, count in COUNTS.items()}
    years = {key: 1970 + unix_s / YEAR_S for key, unix_s in seconds.items()}
    return {key: int(year) for key, year in years.items() if FIRST_YEAR <= year < LAST_YEAR + 1}


def counts_in_words(likely: dict[str, int]) -> str:
    """Return in words which `time_format` reads a number as which count, of which year; `likely`: see :func:`likely_counts`."""
    texts = [f'"{key}" for {COUNTS[key].what} ({year})' for key, year in likely.items()]
    return f"time_format = {' or '.join(texts)}"


@cache
def leap_table() -> tuple[np.ndarray, np.ndarray]:
    """Return the table of leap seconds from 1972: instants (n), UTC in s from 1970, and TAI - UTC (n) in s from each instant on."""
    import erfa

    rows = erfa.leap_seconds.get()
    rows = rows[rows["year"] >= 1972]  # before 1972 the UTC second was not the SI second
    begins = [datetime(int(row["year"]), int(row["month"]), 1, tzinfo=UTC) for row in rows]
    since = np.array([(begin - UNIX_ZERO).total_seconds() for begin in begins])
    return since, rows["tai_utc"].astype(np.float64)


def tai_ahead(utc_s: np.ndarray | float) -> np.ndarray:
    """Return TAI - UTC (s) at a UTC in s from 1970: 10 s, the value of 1972, for earlier times; the last entry after the table."""
    since, ahead = leap_table()
    return ahead[np.maximum(np.searchsorted(since, utc_s, "right") - 1, 0)]


def leap_seconds_between(first_utc_s: float, last_utc_s: float) -> int:
    """Return the number of leap seconds from one UTC (s from 1970) to another."""
    return round(float(tai_ahead(last_utc_s) - tai_ahead(first_utc_s)))


def utc_of_tai(tai_s: np.ndarray) -> np.ndarray:
    """Return UTC (n), in s from 1970 with days of 86,400 s, of times `tai_s` (n): TAI in s from 1970 by the TAI calendar.

    A day of 86,400 s has no place for a leap second. So the two seconds of TAI that end with a leap second are mapped to one second
    of UTC, and times still increase. Within these two seconds UTC is wrong by at most half a second.
    """
    since, ahead = leap_table()
    since_tai = since + ahead  # TAI from which each entry holds: the end of its leap second
    tai_s = np.asarray(tai_s, dtype=np.float64)
    following = np.searchsorted(since_tai, tai_s, "right")  # index of the next entry
    utc = tai_s - ahead[np.maximum(following - 1, 0)]
    following = np.minimum(following, len(since_tai) - 1)
    left = since_tai[following] - tai_s  # s to the end of the next leap second; negative if none
    # the first entry, of 1972, is no leap second
    compressed = (left > 0) & (left <= 2) & (following > 0)
    return np.where(compressed, since[following] - left / 2, utc)
