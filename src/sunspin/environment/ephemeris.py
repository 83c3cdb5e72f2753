"""Orbits as tables of positions: OEM (CCSDS 502.0-B, KVN and XML), CSV and SPK, with one error sentence for each defect.

The positions of a segment are interpolated by a spline of degree seven. Segments end where the file says so (segments of an
OEM) and where positions are missing. The error of the spline is estimated by leaving out every second position.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sunspin.base.errors import InputError
from sunspin.base.lazy import lazy
from sunspin.base.tables import TelemetryError, read_table
from sunspin.base.untrusted import (
    LARGEST,
    IsolatedRunError,
    decode_text,
    decode_western,
    plain_number,
    read_bytes,
    run_isolated,
)
from sunspin.environment.earth import (
    DAY_S,
    EQUATOR_M,
    MU_M3_S2,
    TIME_SCALES,
    Instants,
    J2000_from_TEME,
    ahead_of_utc_s,
    earth_from_J2000,
    rotate_vectors,
)
from sunspin.environment.elements import Elements, parse_elements, parse_xml

if TYPE_CHECKING:
    from scipy import interpolate
else:
    interpolate = lazy("scipy.interpolate")

MAX_FILE_BYTES = 50_000_000
"""Limit for a file; positions of a month, one a minute, are 5 MB."""

DEGREE, MIN_POSITIONS = 7, 9
"""Degree of the spline, and the fewest positions of a segment."""

GAP_STEPS = 5.0
"""A gap of more than this many usual steps separates two segments."""

MAX_SPLINE_ERROR_M = 10.0
"""A table with a larger interpolation error is refused."""

MAX_RADIUS_M = 1e8
"""Farther from the Earth's centre, its field and shadow do not matter."""

VELOCITY_TOLERANCE_M_S = 30.0
"""Largest difference between given velocities and those of the spline; a larger one means another unit or frame."""

NEWTON_STEPS = 20
"""Iterations of Kepler's equation; a few suffice for an orbit of small eccentricity."""

OUTSIDE_S = 1.0
"""Time by which telemetry may exceed a table, whose times may be cut to whole seconds."""

SPK_STEP_S, SPK_CPU_S, MAX_STATES = 60.0, 60, 200_000
"""Time step of states read from an SPK, CPU time for reading it, and the largest number of states."""

INERTIAL = {"EME2000", "GCRF", "ICRF", "J2000", "ICRF2", "ICRF3"}
"""Names of frames that agree with J2000 within the accuracy needed."""
TIME = re.compile(r"(\d{4})-(?:(\d{3})|\d\d-\d\d)(T\d\d(?::\d\d(?::\d\d(?:\.\d*)?)?)?)?", re.ASCII)
"""A calendar time or a time with a day of the year. Groups: year, day of the year if there is one, "T" and time of the day."""

EARTH_FIXED = re.compile(r"ITRF(-?\d+)?|WGS-?84|ECEF|EFG|GRC")
"""Names of Earth-fixed frames."""


@dataclass(frozen=True)
class Segment:
    """Positions (n, 3) m in J2000 at times (n) in s from a UTC Julian date."""

    jd: float
    t_s: np.ndarray
    position: np.ndarray

    @cached_property
    def spline(self) -> interpolate.BSpline:
        """Interpolating spline of the positions."""
        return interpolate.make_interp_spline(self.t_s, self.position, k=DEGREE)

    @property
    def span_jd(self) -> tuple[float, float]:
        """UTC Julian dates of the first and the last position."""
        return self.jd + self.t_s[0] / DAY_S, self.jd + self.t_s[-1] / DAY_S

    def outside_days(self, jd: np.ndarray) -> np.ndarray:
        """Return the days by which dates (n) are outside of the segment, 0 inside."""
        first, last = self.span_jd
        return np.maximum(np.maximum(first - jd, jd - last), 0.0)

    def state(self, t_s: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (..., 3) m and velocities (..., 3) m/s at times (...) in s."""
        return self.spline(t_s), self.spline(t_s, 1)

    def error_m(self) -> float:
        """Return the estimated interpolation error in m; 0 for segments too short for the estimate.

        A spline through every second position is compared with the positions in between. The error of the full spline is
        smaller by 2^(degree + 1), as its step is half as long.
        """
        if len(self.t_s) < 2 * MIN_POSITIONS:
            return 0.0
        coarse = interpolate.make_interp_spline(self.t_s[::2], self.position[::2], k=DEGREE)
        # odd indices, without the last one of an even number, which lies beyond the coarse spline
        between = slice(1, len(self.t_s) - 1 - (len(self.t_s) % 2 == 0), 2)
        error = np.linalg.norm(coarse(self.t_s[between]) - self.position[between], axis=1)
        return float(error.max()) / 2 ** (DEGREE + 1)


@dataclass(frozen=True)
class Ephemeris:
    """A satellite's positions as a table; :class:`sunspin.environment.orbit.Orbit` accepts it in place of elements."""

    segments: tuple[Segment, ...]
    number: str
    name: str
    where: str
    frame: str = "J2000"

    @property
    def epoch_jd(self) -> tuple[float, float]:
        """Middle of the table, as a UTC Julian date in two parts."""
        first, last = self.span_jd
        return first, (last - first) / 2

    @property
    def span_jd(self) -> tuple[float, float]:
        """UTC Julian dates of the first and the last position."""
        return self.segments[0].span_jd[0], self.segments[-1].span_jd[1]

    @property
    def period_s(self) -> float:
        """Orbital period of the Kepler ellipse at the middle of the first segment.

        For an unbound or suborbital state, as of a damaged file, it is that of an orbit at the Earth's surface.
        """
        first = self.segments[0]
        position, velocity = first.state(first.t_s[len(first.t_s) // 2])
        energy = velocity @ velocity / 2 - MU_M3_S2 / np.linalg.norm(position)
        semi_major_axis = max(-MU_M3_S2 / (2 * energy), EQUATOR_M)
        return float(2 * np.pi * np.sqrt(semi_major_axis**3 / MU_M3_S2))

    def days_to(self, jd: float) -> float:
        """Return the days from the table to a UTC Julian date: negative before it, positive after it, 0 within it."""
        first, last = self.span_jd
        return min(jd - first, 0.0) + max(jd - last, 0.0)

    def states(self, jd: np.ndarray, fraction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (n, 3) m and velocities (n, 3) m/s in J2000, at UTC Julian dates (n) and fractions of a day (n).

        Times outside the table occur although it covers the telemetry: a shift along the track, or the random phase of a
        comparison orbit, moves them. There the nearest segment is continued along a Kepler ellipse.
        """
        outside = [segment.outside_days(jd + fraction) for segment in self.segments]
        nearest = np.argmin(outside, axis=0)  # index of a segment for each time
        states = np.empty((2, len(jd), 3))
        for k, segment in enumerate(self.segments):
            is_nearest = nearest == k
            t_s = ((jd[is_nearest] - segment.jd) + fraction[is_nearest]) * DAY_S
            inside_s = np.clip(t_s, segment.t_s[0], segment.t_s[-1])
            states[:, is_nearest] = _propagate_ellipse(*segment.state(inside_s), t_s - inside_s)
        return states[0], states[1]

    def require_coverage(self, jd: np.ndarray) -> None:
        """Raise `InputError` if a date of the telemetry, UTC Julian dates (n), is not in the table.

        A date up to `OUTSIDE_S` before or after a segment of the table counts as in it.
        """
        outside = np.min([segment.outside_days(jd) for segment in self.segments], axis=0)
        missing = outside > OUTSIDE_S / DAY_S
        if missing.any():
            first, last, lacking = map(utc_from_jd, (*self.span_jd, float(jd[missing][0])))
            got = f"{first} to {last}, but not {lacking}"
            do = "give one that does, or only the telemetry that it covers"
            what = "the ephemeris does not cover the telemetry"
            raise InputError(what, got=got, do=do, where=self.where)


def _propagate_ellipse(
    position: np.ndarray, velocity: np.ndarray, t_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (n, 3) m and velocities (n, 3) m/s that states reach after times `t_s` (n) on their Kepler ellipses.

    `position`, `velocity` (n, 3): the states at the start. Those with a time of exactly zero, at which the spline holds, are
    returned unchanged. Kepler's equation is solved for the change of the eccentric anomaly by Newton's method. The state
    follows from Lagrange's f and g functions (Vallado, Fundamentals of Astrodynamics and Applications, section 2.3).
    """
    later = np.flatnonzero(t_s)
    r, v, t = position[later], velocity[later], t_s[later]
    radius = np.linalg.norm(r, axis=1)
    semi_major_axis = 1 / (2 / radius - (v**2).sum(axis=1) / MU_M3_S2)
    mean_motion = np.sqrt(MU_M3_S2 / semi_major_axis**3)
    # eccentricity times sine and cosine of the eccentric anomaly at the start
    e_sin = (r * v).sum(axis=1) / np.sqrt(MU_M3_S2 * semi_major_axis)
    e_cos = 1 - radius / semi_major_axis
    change = mean_motion * t  # of the eccentric anomaly: that of a circle at first
    for _ in range(NEWTON_STEPS):
        residual = change - e_cos * np.sin(change) + e_sin * (1 - np.cos(change)) - mean_motion * t
        change = change - residual / (1 - e_cos * np.cos(change) + e_sin * np.sin(change))
    f = 1 - semi_major_axis / radius * (1 - np.cos(change))
    g = t - (change - np.sin(change)) / mean_motion
    r_later = f[:, None] * r + g[:, None] * v
    radius_later = np.linalg.norm(r_later, axis=1)
    f_dot = -np.sqrt(MU_M3_S2 * semi_major_axis) / (radius * radius_later) * np.sin(change)
    g_dot = 1 - semi_major_axis / radius_later * (1 - np.cos(change))
    position, velocity = position.copy(), velocity.copy()
    position[later], velocity[later] = r_later, f_dot[:, None] * r + g_dot[:, None] * v
    return position, velocity


class _PositionTable(NamedTuple):
    """A table as it is in the file, in SI units.

    Positions (n, 3) in m and velocities (n, 3) in m/s (NaN: none) in a frame, at times (n) in s from an epoch in a time scale.
    """

    epoch: str
    scale: str
    t_s: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    frame: str


class OrbitFile(NamedTuple):
    """A file of elements or positions, and the satellite in it: its catalogue number or name, empty if the file has one only."""

    path: Path
    satellite: str = ""


def read_orbit(file: OrbitFile | Path | str) -> tuple[Elements, ...] | tuple[Ephemeris]:
    """Read elements (TLE, OMM) or the positions of one satellite (OEM in KVN or XML, CSV, SPK).

    A CSV has the columns `time_utc` (ISO-8601) and `x_km`, `y_km`, `z_km` (or `x_m` and so on). Velocities are optional:
    `vx_km_s`, `vy_km_s`, `vz_km_s` (or `vx_m_s`). A comment above states the frame: ``# frame: J2000`` (or TEME, ITRF).

    Raises
    ------
    InputError
        With the file, the line, the offending text and the advice.
    """
    path, satellite = file if isinstance(file, OrbitFile) else OrbitFile(Path(file))
    do = "give the path of a TLE, OMM, OEM, CSV or SPK"
    where, meta = str(path), dict[str, str]()
    content = read_bytes(path, MAX_FILE_BYTES, "file of elements", InputError, do)
    if content[:7] in (b"DAF/SPK", b"NAIF/DA"):
        tables = [_read_spk(path)]
    else:
        # a name of a satellite may have an accent; the lines of elements are checked for foreign characters
        text = decode_western(content) or decode_text(content, where, InputError, do)
        lines = (line for line in text.splitlines() if line.strip() and not line.startswith("#"))
        if "CCSDS_OEM_VERS" in text[:20_000] or "<oem" in text[:20_000]:
            read_oem = _read_oem_xml if text.lstrip()[:1] == "<" else _read_oem_kvn
            meta, tables = read_oem(text, where)
        elif re.search(r"\b(time_utc|[xyz]_k?m)\b", next(lines, "")):  # the header of a CSV
            tables = [_read_csv(path)]
        else:
            return parse_elements(text, where, satellite)
    if satellite:
        what = "a table of positions is of one satellite"
        raise InputError(what, got=satellite, do="leave --norad out", where=where)
    segments = [segment for table in tables for segment in _build_segments(table, where)]
    if not segments:
        what = f"the ephemeris has no {MIN_POSITIONS} positions in a row"
        raise InputError(what, do="give one with a position every minute or so", where=where)
    segments.sort(key=lambda segment: segment.span_jd[0])
    if (worst := max(segment.error_m() for segment in segments)) > MAX_SPLINE_ERROR_M:
        step = float(np.median(np.diff(segments[0].t_s)))
        what = f"the positions are {step:.0f} s apart, between which an orbit is known to {worst:.0f} m only"
        do = f"give them close enough for {MAX_SPLINE_ERROR_M:.0f} m, a minute in a low orbit"
        raise InputError(what, do=do, where=where)
    number, name = meta.get("OBJECT_ID", ""), meta.get("OBJECT_NAME", path.stem)
    return (Ephemeris(tuple(segments), number[:100], name[:100], where),)


def _build_segments(table: _PositionTable, where: str) -> list[Segment]:
    """Return the segments of a table, in UTC and J2000: its stretches without a gap that are long enough for a spline.

    Raises `InputError` if the times do not increase, positions are not those of an orbit about the Earth, or given velocities are
    not those of the positions.
    """
    if np.any(np.diff(table.t_s) <= 0):
        what, do = "the times of the ephemeris do not increase", "sort its rows, remove repeats"
        raise InputError(what, do=do, where=where)
    radius = np.linalg.norm(table.position, axis=1)
    # the polar radius is 0.997 of the equatorial one
    wrong = (radius <= 0.99 * EQUATOR_M) | (radius >= MAX_RADIUS_M)
    if wrong.any():
        what = "a position is not one of an orbit about the Earth"
        got = f"{radius[wrong][0] / 1e3:.6g} km from its centre"
        do = "check the unit (km in an OEM) and the centre"
        raise InputError(what, got=got, do=do, where=where)
    when = _utc_instants(table, where)
    position, velocity = _to_J2000(table, when, where)
    step = np.median(np.diff(table.t_s)) if len(radius) > 1 else 0.0
    segments = []
    jd = float(when.jd[0])
    t_s = (when.jd - jd + when.fraction) * DAY_S
    after_gaps = np.flatnonzero(np.diff(table.t_s) > GAP_STEPS * step) + 1
    for rows in np.split(np.arange(len(radius)), after_gaps):
        if len(rows) < MIN_POSITIONS:
            continue
        segment = Segment(jd, t_s[rows], position[rows])
        # NaN without given velocities; a few wrong rows, such as at a manoeuvre, are accepted
        difference = np.linalg.norm(segment.spline(segment.t_s, 1) - velocity[rows], axis=1)
        if (
            np.nanmax(np.append(difference, 0.0)) > VELOCITY_TOLERANCE_M_S
            and np.nanmedian(difference) > VELOCITY_TOLERANCE_M_S / 10
        ):
            what = f"the velocities are not those of the positions: {np.nanmedian(difference):.0f} m/s off in the median"
            do = "check units and frame: positions of a frame that turns with the Earth are ITRF, not J2000"
            raise InputError(what, do=do, where=where)
        segments.append(segment)
    return segments


def _utc_instants(table: _PositionTable, where: str) -> Instants:
    """Return the UTC instants of a table; raise `InputError` for an unknown epoch or time scale."""
    try:
        when = Instants.of(_normalise_time(table.epoch), table.t_s)
    except ValueError:
        what = "this is not a time such as 2026-01-31T12:00:00"
        raise InputError(what, got=table.epoch, where=where) from None
    if table.scale not in TIME_SCALES:
        what = "the time system of the ephemeris is not known"
        do = f"give one of {', '.join(TIME_SCALES)}"
        raise InputError(what, got=table.scale, do=do, where=where)
    return when.later(-ahead_of_utc_s(table.scale, when))


def _to_J2000(table: _PositionTable, when: Instants, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (n, 3) m and velocities (n, 3) m/s in J2000; raise `InputError` for an unknown frame.

    Velocities of an Earth-fixed frame become NaN, because they lack those of the Earth's rotation.
    """
    frame = table.frame.upper().replace(" ", "")
    if frame in INERTIAL:
        return table.position, table.velocity
    if frame == "TEME":
        matrix = J2000_from_TEME(when)
        return rotate_vectors(matrix, table.position), rotate_vectors(matrix, table.velocity)
    if EARTH_FIXED.fullmatch(frame):
        matrix = np.swapaxes(earth_from_J2000(when), -1, -2)
        return rotate_vectors(matrix, table.position), np.full_like(table.velocity, np.nan)
    do = f"give positions in one of {', '.join(sorted(INERTIAL))}, TEME, ITRF"
    raise InputError("the frame of the ephemeris is not known", got=table.frame, do=do, where=where)


# -------------------------------------------------------------------------------------------------------------------------- OEM


def _read_oem_kvn(text: str, where: str) -> tuple[dict[str, str], list[_PositionTable]]:
    """Return the metadata of the last segment and the tables of all segments of an OEM in KVN.

    A segment has metadata, then a row for each state (time, position, and possibly velocity and acceleration), and possibly
    covariances, which are skipped.
    """
    meta: dict[str, str] = {}
    rows: list[tuple[str, list[str]]] = []
    tables, in_metadata, in_covariance = [], False, False
    for number, line in enumerate(text.splitlines(), 1):
        line = line.strip()
        if not line or line.startswith("COMMENT"):
            continue
        if line == "META_START":
            tables += [_build_oem_table(meta, rows, where)] if rows else []
            meta, rows, in_metadata, in_covariance = {}, [], True, False
        elif line == "META_STOP":
            in_metadata = False
        elif line in ("COVARIANCE_START", "COVARIANCE_STOP"):
            in_covariance = line.endswith("START")
        elif in_metadata:
            key, _, value = line.partition("=")
            meta[key.strip()] = value.strip()
        elif "=" not in line and not in_covariance:  # lines with "=" are the header's
            cells = line.split()
            if len(cells) not in (4, 7, 10):
                what = "a line of an OEM has a time, three coordinates and three of velocity"
                raise InputError(what, got=line, where=f"{where}, line {number}")
            rows.append((cells[0], cells[1:7]))  # without accelerations
    tables += [_build_oem_table(meta, rows, where)] if rows else []
    return meta, tables


def _read_oem_xml(text: str, where: str) -> tuple[dict[str, str], list[_PositionTable]]:
    """Return the metadata of the last segment and the tables of all segments of an OEM in XML."""
    root = parse_xml(text, "OEM", where)
    tables, meta = [], {}
    for segment in root.iter("segment"):
        leaves = [leaf for part in segment.iter("metadata") for leaf in part if not len(leaf)]
        meta = {leaf.tag: (leaf.text or "").strip() for leaf in leaves}
        rows = []
        for vector in segment.iter("stateVector"):
            cells = {leaf.tag: (leaf.text or "").strip() for leaf in vector}
            keys = ("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")
            rows.append((cells.get("EPOCH", ""), [cells.get(key, "nan") for key in keys]))
        tables += [_build_oem_table(meta, rows, where)] if rows else []
    if not tables:
        what, do = "the XML is no OEM with positions", "give an OEM, a CSV or an SPK"
        raise InputError(what, do=do, where=where)
    return meta, tables


def _build_oem_table(
    meta: dict[str, str], rows: list[tuple[str, list[str]]], where: str
) -> _PositionTable:
    """Return the table of an OEM segment, whose numbers are in km and km/s; `rows`: time and text cells of each state.

    Raises `InputError` if metadata are missing or the positions are not about the Earth, and as :func:`_build_table`.
    """
    for key in ("CENTER_NAME", "REF_FRAME", "TIME_SYSTEM"):
        if not meta.get(key):
            do = "give the whole message"
            raise InputError("the OEM lacks a key", got=key, do=do, where=where)
    if meta["CENTER_NAME"].upper() != "EARTH":
        what = "the positions of the OEM are not about the Earth"
        raise InputError(what, got=meta["CENTER_NAME"], where=where)
    time_scale, frame = meta["TIME_SYSTEM"].upper(), meta["REF_FRAME"]
    return _build_table(rows, to_m=1e3, to_m_s=1e3, scale=time_scale, frame=frame, where=where)


def _build_table(
    rows: list[tuple[str, list[str]]],
    to_m: float,
    to_m_s: float,
    scale: str,
    frame: str,
    where: str,
) -> _PositionTable:
    """Return a table from rows of text: a time, and three cells of position or six of position and velocity.

    `to_m`, `to_m_s`: factors of the cells to m and m/s; `scale`: time scale. A velocity may be empty or "nan". Raises `InputError`
    for times and numbers that cannot be read, and for a missing position.
    """
    try:
        times = np.array([_normalise_time(time) for time, _ in rows], dtype="datetime64[us]")
    except ValueError as error:
        raise InputError(f"a time of the ephemeris cannot be read ({error})", where=where) from None
    t_s = (times - times[0]) / np.timedelta64(1, "us") / 1e6
    values = np.full((len(rows), 6), np.nan)
    for row, (_, cells) in zip(values, rows, strict=True):
        row[: len(cells)] = [plain_number(cell) for cell in cells]
        not_numbers = [
            cell for cell in cells if cell not in ("", "nan") and np.isnan(plain_number(cell))
        ]
        if not_numbers:
            what = "a coordinate of the ephemeris is no number"
            do = "write plain decimals, such as -6778.137"
            raise InputError(what, got=not_numbers[0], do=do, where=where)
    if not np.isfinite(values[:, :3]).all():
        raise InputError("a coordinate of the ephemeris is missing or not finite", where=where)
    return _PositionTable(
        rows[0][0], scale, t_s, to_m * values[:, :3], to_m_s * values[:, 3:], frame
    )


def _normalise_time(time: str) -> str:
    """Return a time as calendar date and time with at most microseconds; a day of the year becomes a date.

    Raises ValueError for other texts, of which NumPy would accept some, such as `today`.
    """
    time = time.rstrip("Z").replace(" ", "T")
    match = TIME.fullmatch(time)
    if match is None or (match[2] and not 1 <= int(match[2]) <= 366):
        raise ValueError(f"{time!r} is not a time such as 2026-01-31T12:00:00")
    if match[2]:  # year and day of the year
        time = str(np.datetime64(match[1], "D") + int(match[2]) - 1) + (match[3] or "")
    whole_seconds, _, fraction = time.partition(".")
    return f"{whole_seconds}.{fraction[:6]}" if fraction else whole_seconds


# ------------------------------------------------------------------------------------------------------------------- CSV and SPK


def _read_csv(path: Path) -> _PositionTable:
    """Return the table of a CSV file, in km or m, with or without velocities; raise `InputError` without columns or frame."""
    where = str(path)
    try:
        table = read_table(path)
    except TelemetryError as error:
        raise InputError(str(error)) from None
    matches = (re.fullmatch(r"(?i)frame\s*[:=]\s*(\S+)", line) for line in table.comments)
    frames = [match[1] for match in matches if match]
    unit = next((unit for unit in ("km", "m") if f"x_{unit}" in table.header), "")
    wanted = ["time_utc", *(f"{axis}_{unit}" for axis in "xyz")]
    missing = [name for name in wanted if name not in table.header]
    if not unit or missing:
        do = "name them time_utc, x_km, y_km, z_km (or x_m, ...), and vx_km_s, ... if you have velocities"
        got = "columns " + ", ".join(table.header)
        raise InputError("the table has no columns of an ephemeris", got=got, do=do, where=where)
    if not frames:
        what = "the ephemeris does not say its frame"
        do = "add a first line such as `# frame: J2000` (or TEME, ITRF)"
        raise InputError(what, do=do, where=where)
    speed_unit = next((unit for unit in ("km_s", "m_s") if f"vx_{unit}" in table.header), None)
    names = [*wanted, *(f"v{axis}_{speed_unit}" for axis in "xyz" if speed_unit)]
    if absent := [name for name in names if name not in table.header]:
        what = f"the column {absent[0]!r} of velocity is missing"
        raise InputError(what, where=where)
    rows = [(row[0], row[1:]) for row in table.cells[names].to_numpy().tolist()]
    to_m, to_m_s = (1e3 if unit == "km" else 1.0), (1e3 if speed_unit == "km_s" else 1.0)
    return _build_table(rows, to_m, to_m_s, "UTC", frames[0], where)


def _read_spk(path: Path) -> _PositionTable:
    """Return states of the only body in an SPK, one a minute, read in a separate process as a damaged kernel may crash SPICE.

    Without that process 1 of 7,000 damaged files ends this one (`validation corrupt --unguarded --only earth.bsp`, seeds 0 to
    3).
    """
    where = str(path)
    try:
        import spiceypy  # noqa: F401
    except ImportError:
        do = 'pip install "sunspin[spice]"'
        raise InputError("an SPK needs spiceypy", do=do, where=where) from None
    script = Path(__file__).with_name("spk_states.py")
    arguments = str(path.resolve()), str(SPK_STEP_S), str(MAX_STATES)
    try:
        printed = run_isolated(script, *arguments, seconds=SPK_CPU_S)
    except IsolatedRunError as error:
        raise InputError(f"the SPK cannot be used ({error})", where=where) from None
    values = np.frombuffer(printed, dtype=np.float64).reshape(-1, 7)  # TDB s, km, km/s
    if not len(values):
        raise InputError("the SPK has no states", where=where)
    if not (np.abs(values) < LARGEST).all():
        do = "give the whole file"
        raise InputError("the SPK holds a number beyond any orbit", do=do, where=where)
    # a calendar epoch near the table, as TT - UTC is taken at the epoch
    begin = int(values[0, 0])
    epoch = str(np.datetime64("2000-01-01T12:00:00") + np.timedelta64(begin, "s"))
    position, velocity = 1e3 * values[:, 1:4], 1e3 * values[:, 4:]
    return _PositionTable(epoch, "TDB", values[:, 0] - begin, position, velocity, "J2000")


def utc_from_jd(jd: float) -> str:
    """Return a UTC Julian date as a calendar time, to the second."""
    seconds = round((jd - 2440587.5) * DAY_S)
    return f"{np.datetime64(seconds, 's')}Z"
