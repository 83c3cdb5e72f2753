"""Time scales, Earth orientation and the Sun, by ERFA (the IAU's SOFA): frames TEME, Earth-fixed and J2000.

J2000 here means the axes of the GCRS, which agree with the mean equator and equinox of J2000.0 to 0.02 arcseconds. UT1 is
replaced by UTC, from which it differs by less than 0.9 s (13 arcseconds of Earth rotation), so that no data need to be
downloaded.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from datetime import datetime
from functools import lru_cache, wraps
from typing import Any, NamedTuple

import numpy as np

EQUATOR_M, FLATTENING = 6_378_137.0, 1 / 298.257223563
"""The Earth's equatorial radius (m) and flattening: WGS 84."""

MU_M3_S2 = 3.986004418e14
"""The Earth's gravitational parameter (m3/s2): WGS 84."""

SUN_M = 6.957e8
"""The Sun's radius (m): IAU 2015, resolution B3."""

NODES_DAYS = 0.25
"""Interval at which precession and nutation are computed; between, they are interpolated with an error of 1e-9."""

DAY_S = 86400.0
"""Seconds of a day."""

TT_AHEAD_OF_TAI_S, TAI_AHEAD_OF_GPS_S = 32.184, 19.0
"""Fixed offsets (s) between time scales."""

TIME_SCALES = ("UTC", "UT1", "TAI", "TT", "TDT", "TDB", "GPS")
"""Time scales that can be converted to UTC; UT1 is taken as UTC."""


class Instants(NamedTuple):
    """UTC Julian dates as a day `jd` (n) and a `fraction` (n) of it, and TT - UTC in days."""

    jd: np.ndarray
    fraction: np.ndarray
    tt_ahead: float

    @classmethod
    def of(cls, epoch_utc: str, t_s: np.ndarray) -> Instants:
        """Return the instants at times (n) in s from an ISO-8601 UTC epoch.

        A leap second in between is not counted, as in Unix time; TT - UTC is that of the epoch.
        """
        import erfa

        moment = datetime.fromisoformat(epoch_utc.replace("Z", "+00:00"))
        jd_at_midnight = moment.toordinal() + 1_721_424.5  # ordinal 1 is 0001-01-01, JD 1721425.5
        fraction = (
            moment.hour * 3600 + moment.minute * 60 + moment.second + moment.microsecond / 1e6
        ) / DAY_S
        # ERFA warns of years for which leap seconds have not been announced
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", erfa.ErfaWarning)
            tai_ahead = float(erfa.dat(moment.year, moment.month, moment.day, fraction))
        days = fraction + np.asarray(t_s, dtype=np.float64) / DAY_S  # from that midnight
        whole_days = np.floor(days)
        tt_ahead = (tai_ahead + TT_AHEAD_OF_TAI_S) / DAY_S
        return cls(jd_at_midnight + whole_days, days - whole_days, tt_ahead)

    def later(self, seconds: Any) -> Instants:
        """Return the instants `seconds` later, a number or (..., n); the fraction of the day may then exceed 1 or be negative."""
        return self._replace(fraction=self.fraction + np.asarray(seconds) / DAY_S)

    @property
    def middle_jd(self) -> float:
        """UTC Julian date halfway between the first and the last instant."""
        jd = self.jd + self.fraction
        return float((jd.min() + jd.max()) / 2)

    def interpolate_slow(
        self, function: Callable[[np.ndarray, np.ndarray], np.ndarray]
    ) -> np.ndarray:
        """Return a slowly changing function of TT at these instants, interpolated linearly between nodes `NODES_DAYS` apart.

        `function` takes a two-part Julian date, arrays (m), and returns values (m, ...). Precession and nutation take too long to
        be computed at every instant.
        """
        tt = self.jd + self.fraction + self.tt_ahead
        # multiples of the interval, so that the values at an instant do not depend on the other instants
        first = NODES_DAYS * np.floor(tt.min() / NODES_DAYS)
        nodes = first + NODES_DAYS * np.arange(int(np.ceil((tt.max() - first) / NODES_DAYS)) + 2)
        values = function(np.full(len(nodes), first), nodes - first)
        intervals = (tt - first) / NODES_DAYS
        before = intervals.astype(int)  # index of the node before each instant
        # fraction of the interval after that node, with the dimensions of the values
        share = (intervals - before).reshape(-1, *(1,) * (values.ndim - 1))
        return (1 - share) * values[before] + share * values[before + 1]


def _cached_by_instants(
    function: Callable[[Instants], np.ndarray],
) -> Callable[[Instants], np.ndarray]:
    """Decorate a function of instants so that it keeps its last four results, because a fit computes many orbits at the same times.

    Arrays cannot be keys of a cache, so the bytes of the instants are. The results cannot be written to.
    """

    @lru_cache(maxsize=4)
    def evaluate(jd: bytes, fraction: bytes, tt_ahead: float) -> np.ndarray:
        value = function(Instants(np.frombuffer(jd), np.frombuffer(fraction), tt_ahead))
        value.flags.writeable = False
        return value

    @wraps(function)
    def cached(when: Instants) -> np.ndarray:
        return evaluate(when.jd.tobytes(), when.fraction.tobytes(), when.tt_ahead)

    return cached


def ahead_of_utc_s(scale: str, when: Instants) -> float:
    """Return the offset in s of one of `TIME_SCALES` from UTC at these instants."""
    if scale in ("UTC", "UT1"):
        return 0.0
    tt_ahead = when.tt_ahead * DAY_S
    if scale == "TDB":  # Astronomical Almanac, page B7: annual term, from J2000.0
        days = when.middle_jd - 2451545.0
        return tt_ahead + 1.657e-3 * float(np.sin(6.24 + 0.017202 * days))
    if scale in ("TT", "TDT"):
        return tt_ahead
    tai_ahead = tt_ahead - TT_AHEAD_OF_TAI_S
    return tai_ahead - TAI_AHEAD_OF_GPS_S if scale == "GPS" else tai_ahead


def rotate_vectors(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Return matrices (n, 3, 3) times vectors (..., n, 3)."""
    return (matrix @ vector[..., None])[..., 0]


@_cached_by_instants
def J2000_from_TEME(when: Instants) -> np.ndarray:
    """Return matrices (n, 3, 3) from TEME, the true equator and mean equinox of SGP4, to J2000.

    The equinox of SGP4 differs from the true one by the equation of the equinoxes of 1994 (Vallado et al. 2006, AIAA
    2006-6753).
    """
    import erfa

    def matrix(jd1: np.ndarray, jd2: np.ndarray) -> np.ndarray:
        true = erfa.pnm06a(jd1, jd2)
        return np.swapaxes(erfa.rz(erfa.eqeq94(jd1, jd2), true), -1, -2)

    return when.interpolate_slow(matrix)


@_cached_by_instants
def earth_from_J2000(when: Instants) -> np.ndarray:
    """Return matrices (n, 3, 3) from J2000 to Earth-fixed axes (ITRF without polar motion, which is 0.3 arcseconds)."""
    import erfa

    return erfa.rz(erfa.era00(when.jd, when.fraction), when.interpolate_slow(erfa.c2i06a))


@_cached_by_instants
def sun_J2000_m(when: Instants) -> np.ndarray:
    """Return the apparent position of the Sun (n, 3) in m from the Earth's centre, with aberration, in J2000."""
    import erfa

    # position and velocity of the Earth relative to the Sun and to the barycentre, au and au/day
    heliocentric, barycentric = erfa.epv00(when.jd, when.fraction + when.tt_ahead)
    to_sun = -heliocentric["p"]
    distance = np.linalg.norm(to_sun, axis=-1, keepdims=True)
    # aberration: the direction is changed by the Earth's velocity over that of light
    apparent = to_sun / distance + barycentric["v"] * (erfa.DAU / DAY_S / erfa.CMPS)
    return erfa.DAU * distance * apparent / np.linalg.norm(apparent, axis=-1, keepdims=True)
