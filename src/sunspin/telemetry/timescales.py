"""GPS time and TAI in UTC, by the table of leap seconds that ERFA brings along."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import cache

import numpy as np

UNIX_ZERO = datetime(1970, 1, 1, tzinfo=UTC)

GPS_ZERO_S = (datetime(1980, 1, 6, tzinfo=UTC) - UNIX_ZERO).total_seconds()
"""Calendar of GPS time zero, 6 January 1980, in s from 1970 (IS-GPS-200)."""

TAI_AHEAD_OF_GPS_S = 19.0
"""TAI minus GPS time, which is constant."""

TAI_ZERO_S = (datetime(1958, 1, 1, tzinfo=UTC) - UNIX_ZERO).total_seconds()
"""Calendar of the epoch of counted TAI seconds, 1 January 1958 (CCSDS 301.0-B), in s from 1970."""

WEEK_S = 604_800.0

WEEKS_TO_ROLLOVER = 1024
"""Weeks after which the ten-bit week number of GPS begins again."""


@cache
def leap_table() -> tuple[np.ndarray, np.ndarray]:
    """Return the instants (n) from which TAI - UTC holds, in s of UTC from 1970, and TAI - UTC (n) in s, from 1972 on."""
    import erfa

    rows = erfa.leap_seconds.get()
    rows = rows[rows["year"] >= 1972]  # UTC ran at another rate before
    begins = [datetime(int(row["year"]), int(row["month"]), 1, tzinfo=UTC) for row in rows]
    since = np.array([(begin - UNIX_ZERO).total_seconds() for begin in begins])
    return since, rows["tai_utc"].astype(np.float64)


def tai_ahead(utc_s: np.ndarray | float) -> np.ndarray:
    """Return TAI - UTC (s) at UTC in s from 1970; before 1972 the 10 s of that year, after the table its last entry."""
    since, ahead = leap_table()
    return ahead[np.maximum(np.searchsorted(since, utc_s, "right") - 1, 0)]


def leap_seconds_between(first_utc_s: float, last_utc_s: float) -> int:
    """Return the number of leap seconds from one UTC (s from 1970) to another."""
    return round(float(tai_ahead(last_utc_s) - tai_ahead(first_utc_s)))


def utc_of_tai(tai_s: np.ndarray) -> np.ndarray:
    """Return UTC (n) in s from 1970, with days of 86,400 s, of TAI in s from its own 1 January 1970.

    Such days have no place for a leap second. The second before it and the leap second itself share one, so that times increase;
    a time within them is off by half a second at most.
    """
    since, ahead = leap_table()
    midnight = since + ahead  # TAI at the end of each leap second
    tai_s = np.asarray(tai_s, dtype=np.float64)
    utc = tai_s - ahead[np.maximum(np.searchsorted(midnight, tai_s, "right") - 1, 0)]
    following = np.minimum(np.searchsorted(midnight, tai_s, "right"), len(midnight) - 1)
    left = midnight[following] - tai_s
    shared = (left > 0) & (left <= 2) & (following > 0)
    return np.where(shared, since[following] - left / 2, utc)
