"""Times of the rows of a telemetry file: formats, time zones, time scales, boots; with sentences on assumptions about the clock."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

import numpy as np

from sunspin.base.errors import TelemetryError
from sunspin.base.tables import TextTable
from sunspin.base.untrusted import plain_number
from sunspin.telemetry.restarts import (
    FALL_INTERVALS,
    STORED_LONG_S,
    USUAL_DELAY_S,
    Frames,
    Restart,
    assign_boots,
    estimate_boot_epochs,
    find_boot_starts,
    find_clock_set_back,
    find_uptime_restart,
    has_live_rows,
)
from sunspin.telemetry.timescales import (
    COUNTS,
    DAY_S,
    FIRST_UNIX_S,
    GPS_ZERO_S,
    J2000_UTC,
    LAST_CLOCK_S,
    MOST_DAYS,
    TAI_AHEAD_OF_GPS_S,
    TAI_ZERO_S,
    TIME_SCALES,
    TT_AHEAD_OF_TAI_S,
    UNIX_ZERO,
    WEEK_S,
    WEEKS_TO_ROLLOVER,
    YEAR_S,
    counts_in_words,
    likely_counts,
    tai_ahead,
    utc_of_tai,
)
from sunspin.vehicle import TelemetryForm
from sunspin.vehicle.timeline import parse_instant, parse_zone, utc_after

LATEST_UNIX_S = 1e11
"""Largest number of seconds (about 3000 years) that is accepted as a time."""

DECADES_S = 5 * 365.25 * DAY_S
"""Rows more than five years from all others were dated by a clock that was reset: no mission pauses for so long."""

CLOCKS_END = datetime(2038, 1, 19, tzinfo=UTC)
"""Overflow of Unix time in 32 bits: if there is another group of dates, rows from here on are of a clock without a date."""

SAME_WEEK_S = 6 * 3600.0
"""If the seconds of the week fall by a whole week less this, a new week begins; a smaller fall is a row out of order."""

MANY_MISDATED = 0.2
"""A group of rows with more than this share of the file is not a few damaged dates."""

OVERFLOWS = tuple(2**bits for bits in range(8, 33))
"""Counts after which a counter of elapsed time begins again at zero."""

SURE_OVERFLOW = 2**16
"""Smaller counts are taken as overflows if there are two, or by `RARE_RESET`: a clock that was reset may have stood near one."""

RARE_RESET = 1 / 2000
"""Smaller counts are taken as overflows if a reset would be followed by a usual interval as rarely as this."""

OVERFLOW_INTERVALS = 3.0
"""A counter has overflowed if with the added counts the row follows the one before within so many usual intervals."""

AHEAD_OF_SCALE_S = {"gps": TAI_AHEAD_OF_GPS_S, "tai": 0.0, "tt": -TT_AHEAD_OF_TAI_S}
"""TAI minus each time scale, s."""

NO_ZONE = "times name no zone: taken as UTC"
ZONES = {
    **{"cet": "+01:00", "mez": "+01:00", "cest": "+02:00", "mesz": "+02:00"},
    **{"eet": "+02:00", "eest": "+03:00", "msk": "+03:00", "jst": "+09:00", "kst": "+09:00"},
    **{"est": "-05:00", "edt": "-04:00", "pst": "-08:00", "pdt": "-07:00"},
}
"""Zones in names of columns, without those that several countries use for different ones."""

NO_ZONE_RECEIVED = "received times name no zone: taken as UTC"

SHOWN_BOOTS = 4
"""Boots that a sentence names by their time zero."""


class Times(NamedTuple):
    """Times of the rows (n) of a file.

    `time` (n): s from `epoch` (UTC); `received` (n): time of reception, Unix seconds, NaN if a row has none, None without such a
    column; `notes`: sentences on the clock; `misdated` (n): rows dated years from all others.
    """

    time: np.ndarray
    epoch: datetime
    received: np.ndarray | None
    notes: tuple[str, ...]
    misdated: np.ndarray

    def take(self, rows: np.ndarray) -> Times:
        """Return the times of some rows (m)."""
        received = None if self.received is None else self.received[rows]
        return self._replace(time=self.time[rows], received=received, misdated=self.misdated[rows])


def parse_utc(text: str) -> datetime | None:
    """Return the instant that a text states, in UTC if it names no zone; None if it is not a time."""
    iso = _to_iso(text)
    return None if iso is None else parse_instant(iso)


def _to_iso(text: str) -> str | None:
    """Return a time in the notation of ISO 8601; None for a day of the year that does not exist.

    Converts "UTC" or "GMT" at the end, slashes in dates, and days of the year. Any other text is returned as it is.
    """
    text = re.sub(r"\s*(UTC|GMT)$", "Z", text.strip()).replace("/", "-")
    # year, day of the year and time of day, as in CCSDS 301.0-B, ASCII code B
    ordinal = re.fullmatch(r"(\d{4})-(\d{3})([T ].*)?", text, re.ASCII)
    try:
        if ordinal:
            new_year = datetime(int(ordinal[1]), 1, 1, tzinfo=UTC)
            day = new_year + timedelta(days=int(ordinal[2]) - 1)
            return day.date().isoformat() + (ordinal[3] or "")
    except (ValueError, OverflowError):  # no such year or day
        return None
    return text


def strip_scale(text: str, time_format: str) -> str:
    """Return a date without the name of its time scale after it; TDB is read as TT."""
    text = text.strip().removesuffix("TDB" if time_format == "tt" else "").rstrip()
    return text.removesuffix(time_format.upper()).rstrip()


def zone_of_name(name: str) -> str | None:
    """Return the zone in the name of a column of times, such as "+01:00" for "Time (CET)"; None if it names none, or UTC."""
    words = re.findall(r"[a-z]+", name.lower())
    if offset := re.search(r"(?:utc|gmt) ?([+-])(\d{1,2})(?::?(\d\d))?(?!\d)", name.lower()):
        hours, minutes = int(offset[2]), int(offset[3] or 0)
        zone = f"{offset[1]}{hours:02d}:{minutes:02d}"
        return zone if 0 < hours * 60 + minutes <= 14 * 60 else None
    return next((ZONES[word] for word in words if word in ZONES), None)


def _kind_of_zone(text: str) -> str | None:
    """Return "utc" or "local" for a time that names a zone; None for a time without a zone and for other texts."""
    try:
        moment = datetime.fromisoformat(_to_iso(text) or "")
    except ValueError:
        return None
    if moment.tzinfo is None:
        return None
    return "local" if moment.utcoffset() else "utc"


def read_received_times(form: TelemetryForm, table: TextTable) -> np.ndarray | None:
    """Read the time of reception of each row (n), Unix seconds; NaN for cells without a time; None if there is no such column.

    Raises
    ------
    TelemetryError
        No cell has a time in the stated format.
    """
    if form.receive_time_column is None:
        return None
    cells = table.cells[form.receive_time_column]
    if form.receive_time_format == "unix":
        seconds = np.array([plain_number(cell) for cell in cells])
        received = np.where(np.abs(seconds) < LATEST_UNIX_S, seconds, np.nan)
        expected = "Unix seconds"
    else:
        moments = [parse_utc(cell) for cell in cells]
        received = np.array([_unix(moment) if moment else np.nan for moment in moments])
        expected = "ISO-8601 dates"
    filled = np.array([bool(cell.strip()) for cell in cells])
    if filled.any() and not np.isfinite(received).any():  # a few cells may be damaged, not all
        what = f"received times are expected to be {expected}"
        do = "correct them, or set receive_time_format under [telemetry]: utc for dates, unix for seconds"
        raise _cell_error(table, form.receive_time_column, int(filled.argmax()), what, do)
    return received


def read_times(form: TelemetryForm, table: TextTable, reading_columns: set[str]) -> Times:
    """Read the times of all rows in the file's order.

    The epoch is that of the vehicle file. If it states none, the epoch follows from received times, or it is the time of the first
    row.

    Parameters
    ----------
    reading_columns : set of str
        Columns with readings: rows that repeat them are one frame, received again.

    Raises
    ------
    TelemetryError
        A cell is not a time, or the epoch of the vehicle file is none. The setting ``bad_rows`` of the vehicle file adds:

        - "refuse": the clock was set back or started again, or rows are dated years from all others;
        - "flag": the clock was set back or started again; misdated rows are only marked in the result;
        - "sort": nothing. Rows may be in any order, so that falling times are no evidence of a clock that was set back.
    """
    received = read_received_times(form, table)
    notes = []
    fixed = None if form.epoch_utc is None else parse_utc(form.epoch_utc)
    if form.epoch_utc is not None and fixed is None:
        what = "telemetry.epoch_utc of the vehicle is not an ISO-8601 time"
        raise TelemetryError(what, got=form.epoch_utc)
    if received is not None and form.receive_time_format == "utc":
        zones = [_kind_of_zone(cell) for cell in table.cells[form.receive_time_column]]
        if np.isfinite(received).any() and not any(zones):
            notes.append(NO_ZONE_RECEIVED)
    names = [name for name in table.header if name in reading_columns]
    frames = Frames(np.char.strip(table.cells[names].to_numpy().astype(str)))
    if form.time_format == "elapsed":
        # elapsed times name no dates: no row is misdated, and clocks that start again are handled there as boots
        time, epoch, clock_notes = _read_elapsed(form, table, received, fixed, frames)
        misdated = np.zeros(len(time), dtype=bool)
        return Times(time, epoch, received, (*notes, *clock_notes), misdated)
    time, epoch, local, clock_notes = _read_calendar(form, table, fixed)
    misdated, misdated_notes = _find_misdated(time, epoch)
    if form.bad_rows != "sort":
        clock_notes += _check_set_back(form, table, time, frames, local, ~misdated)
    if form.bad_rows == "refuse" and misdated.any():
        do = 'correct or remove them, or set bad_rows = "flag" under [telemetry], which leaves them out'
        where = table.place(int(misdated.argmax()), form.time_column)
        raise TelemetryError(misdated_notes[0], do=do, where=where)
    return Times(time, epoch, received, (*notes, *clock_notes, *misdated_notes), misdated)


def _cell_error(
    table: TextTable, name: str, row: int, what: str, do: str, got: str | None = None
) -> TelemetryError:
    """Return the error for the cell of column `name` in a row; `got`: text shown instead of the cell."""
    cell = table.cells[name].iat[row]
    return TelemetryError(
        what, got=got or cell or "an empty cell", do=do, where=table.place(row, name)
    )


def _read_seconds(form: TelemetryForm, table: TextTable, kind: str) -> np.ndarray:
    """Read the time column (n) in s; raise a `TelemetryError` that expects `kind` for a cell without a plausible number."""
    numbers = np.array([plain_number(cell) for cell in table.cells[form.time_column]])
    numbers = numbers * form.time_scale_s
    if (bad := ~(np.abs(numbers) <= LATEST_UNIX_S)).any():
        row = int(bad.argmax())
        do = "correct it, or set time_format under [telemetry] in the vehicle file"
        if likely := likely_counts(plain_number(table.cells[form.time_column].iat[row])):
            do = f"correct it, or set {counts_in_words(likely)} under [telemetry]"
        raise _cell_error(table, form.time_column, row, f"{kind} are expected", do)
    return numbers


def _read_unix(form: TelemetryForm, table: TextTable) -> tuple[np.ndarray, list[str]]:
    """Read Unix times (n, s), and say if they are counted in ms, us or ns: as seconds they would lie thousands of years ahead.

    FILETIME and ticks of .NET are read as such. Numbers that may be seconds or days from another instant are named. A unit that the
    vehicle file states (`time_scale_s`) is not changed.
    """
    numbers = np.abs([plain_number(cell) for cell in table.cells[form.time_column]])
    typical = float(np.nanmedian(numbers)) if np.isfinite(numbers).any() else 0.0
    if form.time_scale_s != 1.0:
        return _read_seconds(form, table, "Unix seconds"), []
    if typical <= LATEST_UNIX_S:
        seconds = _read_seconds(form, table, "Unix seconds")
        return seconds, _name_other_counts(seconds)
    for key in likely_counts(typical):  # as Unix times in ns they would be of 1974 or 1990
        form = replace(form, time_format=key)
        note = f'times taken as {COUNTS[key].what} by their size (time_format = "{key}")'
        return _read_counts(form, table), [note]
    for unit, scale in {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}.items():
        if typical * scale <= LATEST_UNIX_S:
            form = replace(form, time_scale_s=scale)
            note = f"times taken as Unix {unit} by their size (time_scale_s = {scale:g})"
            return _read_seconds(form, table, "Unix seconds"), [note]
    return _read_seconds(form, table, "Unix seconds"), []


def _name_other_counts(seconds: np.ndarray) -> list[str]:
    """Return a sentence if numbers (n) that were read as Unix seconds may be seconds or days from another instant than 1970."""
    typical, steps = float(np.median(seconds)), np.abs(np.diff(seconds))
    likely = {} if FIRST_UNIX_S < typical < LAST_CLOCK_S else likely_counts(typical)
    if steps.any() and float(np.median(steps[steps > 0])) > MOST_DAYS:
        likely = {key: year for key, year in likely.items() if COUNTS[key].unit_s < DAY_S}
    if not likely:
        return []
    year = 1970 + int(typical / YEAR_S)
    return [
        f"as Unix times these are of {year}: if not, set {counts_in_words(likely)} under [telemetry]"
    ]


def _read_counts(form: TelemetryForm, table: TextTable) -> np.ndarray:
    """Read Julian Dates and other `COUNTS` of UTC as s from 1970 (n), to 0.1 ms."""
    count = COUNTS[form.time_format]
    numbers = np.array([plain_number(cell) for cell in table.cells[form.time_column]])
    # as for Unix times, counts of seconds may be in ms; days and ticks have units of their own
    seconds = count.unix_s(numbers * (form.time_scale_s if count.unit_s == 1 else 1.0))
    if (bad := ~(np.abs(seconds) <= LATEST_UNIX_S)).any():
        example = f"{(1_769_904_000 - count.zero_s) / count.unit_s:.1f}".removesuffix(".0")
        what = f"{count.what} are expected, such as {example} (1 February 2026)"
        do = "correct it, or set time_format under [telemetry] in the vehicle file"
        raise _cell_error(table, form.time_column, int(bad.argmax()), what, do)
    return seconds


def _read_elapsed(
    form: TelemetryForm,
    table: TextTable,
    received: np.ndarray | None,
    fixed: datetime | None,
    frames: Frames,
) -> tuple[np.ndarray, datetime, list[str]]:
    """Return elapsed times (n, s) from an epoch, that epoch, and sentences on boots and leap seconds.

    `fixed` is the epoch of the vehicle file, if it states one.
    """
    uptime, notes = _read_seconds(form, table, "seconds"), list[str]()
    if received is not None and np.isfinite(received).any():
        time, zero, epoch, notes = _date_boots(uptime, received, fixed, frames)
    elif fixed is None:
        raise TelemetryError("elapsed times need telemetry.epoch_utc in the vehicle file")
    else:
        if form.bad_rows != "sort":
            uptime, notes = _unwrap_uptime(form, table, uptime)
        restart = None if form.bad_rows == "sort" else find_uptime_restart(uptime, frames)
        if restart is not None and restart.sure:
            raise _restart_error(form, table, restart)
        time, zero, epoch = uptime, np.zeros(len(uptime)), fixed
        if restart is not None:
            at = table.row_place(restart.row)
            notes.append(
                f"elapsed times fall by {_format_span(restart.back_s)} at {at}: taken for rows out of order; "
                "if the clock was reset there, set receive_time_column under [telemetry]"
            )
    if fixed is not None:
        time, leap_notes = _apply_leap_seconds(form, uptime, zero, epoch)
        notes += leap_notes
    return time, epoch, notes


def _unwrap_uptime(
    form: TelemetryForm, table: TextTable, uptime: np.ndarray
) -> tuple[np.ndarray, list[str]]:
    """Return elapsed times (n, s) that rise across overflows of their counter, and a sentence if there are any.

    A counter has overflowed if a row follows the one before at a usual interval once `OVERFLOWS` counts are added to it. Shorter or
    longer intervals than all others are not usual: a reset after a minute is no overflow of 2^16 ms.
    """
    steps = np.diff(uptime)
    if not (steps > 0).any() or not (steps < 0).any():
        return uptime, []
    rising, count_s = steps[steps > 0], 1.5 * form.time_scale_s
    shortest_s = rising.min() - count_s
    longest_s = min(rising.max() + count_s, OVERFLOW_INTERVALS * float(np.median(rising)))
    for count in OVERFLOWS:
        full_s = count * form.time_scale_s
        new_steps = steps + full_s
        over = (new_steps > max(shortest_s, 0.0)) & (new_steps <= longest_s)
        is_rare = (longest_s - max(shortest_s, 0.0)) < RARE_RESET * full_s
        is_sure = over.sum() > (0 if count >= SURE_OVERFLOW or is_rare else 1)
        # the rest must be in order: the counter would not fall otherwise
        if is_sure and (steps[~over] >= 0).all() and uptime.min() >= 0 and uptime.max() < full_s:
            added = full_s * np.cumsum(np.concatenate([[0], over]))
            at = table.row_place(int(over.argmax()) + 1)
            times = "" if over.sum() == 1 else f", {over.sum()} times in all"
            what = f"elapsed times begin again after {count} counts at {at}{times}"
            return uptime + added, [f"{what}: taken as an overflow of the counter"]
    return uptime, []


def _date_boots(
    uptime: np.ndarray, received: np.ndarray, fixed: datetime | None, frames: Frames
) -> tuple[np.ndarray, np.ndarray, datetime, list[str]]:
    """Return the times of rows from their uptime and the received times of their boot.

    Parameters
    ----------
    uptime : (n), s
    received : (n), Unix seconds
        NaN for a row without a received time.
    fixed : datetime or None
        Epoch of the vehicle file, if it states one.

    Returns
    -------
    time : (n), s from the epoch
    zero : (n), s from the epoch
        Instant of uptime zero of the row's boot.
    epoch : datetime
        `fixed`, which then belongs to the boot that began nearest to it; else the instant of uptime zero of the first boot.
    notes : list of str
    """
    starts, notes = find_boot_starts(uptime, received, frames), []
    boot = assign_boots(uptime, received, starts)  # number of each row's boot
    boot_zeros = estimate_boot_epochs(uptime, received, boot, len(starts))  # Unix seconds
    epoch_boot = 0 if fixed is None else int(np.argmin(np.abs(boot_zeros - _unix(fixed))))
    epoch = fixed or UNIX_ZERO + timedelta(seconds=round(float(boot_zeros[0]), 3))
    # from here on, times of the other boots relative to that of the epoch
    zero = np.round(boot_zeros - boot_zeros[epoch_boot], 3)[boot]
    time = uptime + zero
    of_epoch = boot == epoch_boot
    live = has_live_rows(uptime[of_epoch], received[of_epoch])
    if live and abs(boot_zeros[epoch_boot] - _unix(epoch)) > USUAL_DELAY_S:
        by_received = utc_after(float(boot_zeros[epoch_boot]), UNIX_ZERO.isoformat())
        notes.append(
            f"received times put time zero at {by_received}; epoch_utc says {utc_after(0, epoch.isoformat())}"
        )
    if len(boot_zeros) > 1:
        boot_dates = [
            utc_after(float(boot_zero - boot_zeros[epoch_boot]), epoch.isoformat())
            for boot_zero in boot_zeros[:SHOWN_BOOTS]
        ]
        ellipsis = ", ..." if len(boot_zeros) > SHOWN_BOOTS else ""
        notes.append(
            f"the uptime starts again: {len(boot_zeros)} boots, each dated by its received times, from "
            f"{', '.join(boot_dates)}{ellipsis}"
        )
    stored = received - _unix(epoch) - time  # s from the sample to its reception
    boot_before_s = np.diff(boot_zeros, prepend=boot_zeros[0])[
        boot
    ]  # duration of the boot before a row's own
    # stored telemetry whose uptime the boot before had reached as well
    ambiguous = (stored > USUAL_DELAY_S) & (uptime < boot_before_s)
    if ambiguous.any():
        notes.append(
            f"{_rows_are(ambiguous)} stored telemetry of this boot or of the one before: dated by the last boot before reception"
        )
    if (long := stored > STORED_LONG_S).any():
        notes.append(
            f"{_rows_are(long)} dated up to {np.nanmax(stored) / DAY_S:.1f} days before reception: stored on board, or the uptime "
            "started again"
        )
    if (early := stored < -STORED_LONG_S).any():
        notes.append(
            f"{_rows_are(early)} dated up to {-np.nanmin(stored) / DAY_S:.1f} days after reception: "
            "check epoch_utc under [telemetry]"
        )
    return time, zero, epoch, notes


def _rows_are(which: np.ndarray) -> str:
    """Return the number of true values as the beginning of a sentence: "1 row is" or "5 rows are"."""
    n = int(np.count_nonzero(which))
    return "1 row is" if n == 1 else f"{n} rows are"


def _restart_error(form: TelemetryForm, table: TextTable, restart: Restart) -> TelemetryError:
    """Return the error for elapsed times that start again without received times."""
    before = table.cells[form.time_column].iat[restart.before]
    cell = table.cells[form.time_column].iat[restart.row]
    what = "elapsed times start again and run through known times with other readings: a clock that was reset"
    do = (
        "name the column of received times as receive_time_column under [telemetry], or give each boot a file and an epoch_utc of "
        'its own; if the rows are only out of order, set bad_rows = "sort"'
    )
    return _cell_error(table, form.time_column, restart.row, what, do, f"{cell} after {before}")


def _apply_leap_seconds(
    form: TelemetryForm, uptime: np.ndarray, zero: np.ndarray, epoch: datetime
) -> tuple[np.ndarray, list[str]]:
    """Return times (n), s from the epoch in days of 86,400 s, of `uptime` (n, s) since the `zero` (n, s) of its boot.

    If the vehicle file does not state whether the clock counts leap seconds, and there were some, they are not counted, and a
    sentence says so.
    """
    begin, time = (
        _unix(epoch) + zero,
        uptime + zero,
    )  # `begin` (n): start of each row's boot, UTC in s from 1970
    leaps = round(float(np.max(tai_ahead(begin + uptime) - tai_ahead(begin))))
    if leaps <= 0 or form.counts_leap_seconds is False:
        return time, []
    if form.counts_leap_seconds:
        return utc_of_tai(begin + tai_ahead(begin) + uptime) - _unix(epoch), []
    clock = "as GPS time and TAI do"
    if _unix(epoch) == GPS_ZERO_S:  # then the clock is probably GPS time itself
        clock = 'such as GPS time (time_format = "gps")'
    return time, [
        f"{leaps} leap second{'s' * (leaps > 1)} after epoch_utc not counted: if the clock counts them, {clock}, all times are "
        f"{leaps} s late; set counts_leap_seconds = true or false under [telemetry]"
    ]


def _unix(moment: datetime) -> float:
    """Return an instant in s from 1970."""
    return (moment - UNIX_ZERO).total_seconds()


def _read_calendar(
    form: TelemetryForm, table: TextTable, fixed: datetime | None
) -> tuple[np.ndarray, datetime, bool, list[str]]:
    """Return dated times (n, s) from an epoch, that epoch, whether they name no zone, and sentences on the clock.

    The epoch is `fixed` if the vehicle file states it, else the time of the first row.
    """
    notes, local = [], False
    if form.time_format == "utc":
        # subtracted as whole microseconds: s from 1970 as a float would lose digits
        micro, local, notes = _read_utc(form, table)
        epoch = fixed or UNIX_ZERO + timedelta(microseconds=int(micro[0]))
        time = (micro - (epoch - UNIX_ZERO) // timedelta(microseconds=1)) / 1e6
    else:
        if form.time_format == "unix":
            seconds, notes = _read_unix(form, table)
        elif form.time_format in COUNTS:
            seconds, notes = _read_counts(form, table), []
            if form.time_zone is not None:
                micro, bare = np.round(seconds * 1e6).astype(np.int64), np.ones(len(seconds), bool)
                micro, notes = _convert_local_times(form, table, micro, bare)
                seconds = micro / 1e6
        else:
            seconds, notes = _read_atomic(form, table), []
        epoch = fixed or UNIX_ZERO + timedelta(seconds=float(seconds[0]))
        time = seconds - _unix(epoch)
    return time, epoch, local, notes


def _check_set_back(
    form: TelemetryForm,
    table: TextTable,
    time: np.ndarray,
    frames: Frames,
    local: bool,
    dated: np.ndarray,
) -> list[str]:
    """Return a sentence if the times (n, s) of the rows `dated` (n) may be those of a clock that was set back.

    Raises
    ------
    TelemetryError
        The clock was certainly set back.
    """
    rows = np.flatnonzero(dated)
    back = find_clock_set_back(time[rows], Frames(frames.cells[rows]), local)
    if back is None:
        return []
    back = back._replace(row=int(rows[back.row]), before=int(rows[back.before]))
    if back.sure:
        raise _set_back_error(form, table, back, local)
    if local:
        do = "if a local clock was set back there, set time_zone under [telemetry]"
    else:
        do = "if the clock was set back there, correct the times from there on"
    return [
        f"times fall back once, by {_format_span(back.back_s)} at {table.row_place(back.row)}: taken for rows out of order; {do}"
    ]


def _format_span(seconds: float) -> str:
    """Return a length of time in words: days, hours or minutes."""
    if seconds >= DAY_S:
        return f"{seconds / DAY_S:.1f} days"
    minutes = round(seconds / 60)
    return f"{minutes // 60} h" if minutes and minutes % 60 == 0 else f"{minutes} min"


def _set_back_error(
    form: TelemetryForm, table: TextTable, back: Restart, local: bool
) -> TelemetryError:
    """Return the error for a clock that was set back; `local`: the times name no zone."""
    cells = table.cells[form.time_column]
    span = _format_span(back.back_s)
    what = f"all times from here on go back by {span}, as a clock that is set back"
    if local:
        do = 'set time_zone under [telemetry], such as time_zone = "Europe/Berlin"'
    else:
        do = "give the rows from here on as a file of their own, with their times corrected"
    do += '; if the rows are only out of order, set bad_rows = "sort"'
    got = f"{cells.iat[back.row]} after {cells.iat[back.before]}"
    return _cell_error(table, form.time_column, back.row, what, do, got)


def _read_utc(form: TelemetryForm, table: TextTable) -> tuple[np.ndarray, bool, list[str]]:
    """Read dates (n) in microseconds from 1970; also return whether none of them names a zone, and sentences on the zone."""
    cells = table.cells[form.time_column].tolist()
    moments = [moment for cell in cells if (moment := parse_utc(cell)) is not None]
    if len(moments) < len(cells):
        i = next(k for k, cell in enumerate(cells) if parse_utc(cell) is None)
        what = "an ISO-8601 UTC time is expected"
        raise _cell_error(table, form.time_column, i, what, _advise_on_cell(cells[i]))
    zones = np.array([_kind_of_zone(cell) or "" for cell in cells])
    bare = zones == ""
    micro = np.array([(moment - UNIX_ZERO) // timedelta(microseconds=1) for moment in moments])
    if form.time_zone is not None:  # of the times that name no zone
        utc, zone_notes = _convert_local_times(form, table, micro, bare)
        return utc, False, zone_notes
    if bare.any() and (zones == "local").any():  # those without a zone may be local or UTC
        what = "other times of this file have a time zone and this one has none"
        do = "give each its zone, or Z for UTC"
        raise _cell_error(table, form.time_column, int(bare.argmax()), what, do)
    notes = []
    if bare.all():
        notes = [NO_ZONE]
        if zone := zone_of_name(form.time_column):
            notes = [
                f'{NO_ZONE}, but the name of column {form.time_column!r} says otherwise: set time_zone = "{zone}"'
            ]
    elif bare.any():
        n = int(bare.sum())
        notes = [f"{'1 time names' if n == 1 else f'{n} times name'} no zone: taken as UTC"]
    return micro, bool(bare.all()), [*notes, *_name_other_scale(form.time_column, micro)]


def _name_other_scale(name: str, micro: np.ndarray) -> list[str]:
    """Return a sentence if the name of a column of dates (n, microseconds from 1970) says TAI, TT or TDB.

    It may also say GPST; "gps" alone also names receivers, and these print UTC.
    """
    words = [word for word in re.findall("[a-z]+", name.lower()) if word in TIME_SCALES]
    if not words or words[0] == "gps":
        return []
    scale = TIME_SCALES[words[0]]
    ahead_s = float(tai_ahead(float(np.median(micro)) / 1e6)) - AHEAD_OF_SCALE_S[scale]
    return [
        f"dates are read as UTC, and the name of column {name!r} says {words[0].upper()}: if so, all times are {ahead_s:.0f} s "
        f'late; set time_format = "{scale}" under [telemetry]'
    ]


def _convert_local_times(
    form: TelemetryForm, table: TextTable, micro: np.ndarray, bare: np.ndarray
) -> tuple[np.ndarray, list[str]]:
    """Convert local times of the stated zone to UTC; return them (n), microseconds from 1970, and sentences on the zone.

    Parameters
    ----------
    micro : (n), microseconds from 1970
        Times as the clock shows them, read as UTC.
    bare : (n)
        The time names no zone; the others are UTC.
    """
    first, second = _utc_of_both_passes(form, table, micro, bare)
    utc, undecided = _decide_double_hours(micro, first, second)
    notes = [f"times without a zone are read in {form.time_zone}"] if bare.any() else []
    if undecided:
        lie = "1 time lies" if undecided == 1 else f"{undecided} times lie"
        notes.append(f"{lie} in the hour that a clock there shows twice, and may be an hour off")
    return utc, notes


def _utc_of_both_passes(
    form: TelemetryForm, table: TextTable, micro: np.ndarray, bare: np.ndarray
) -> np.ndarray:
    """Return the UTC of each time in the first and in the second pass of a double hour (2, n), microseconds from 1970.

    At the end of summer time a clock shows one hour twice, first in summer time. For all other times both rows are equal. `micro`
    and `bare` are those of `_convert_local_times`.

    Raises
    ------
    TelemetryError
        A time does not exist in the zone: the clock skips an hour at the beginning of summer time.
    """
    zone, zero = parse_zone(str(form.time_zone)), datetime(1970, 1, 1)
    both = np.stack([micro, micro])
    for i in np.flatnonzero(bare).tolist():
        local = zero + timedelta(microseconds=int(micro[i]))
        for fold in (0, 1):  # Python's name of the first and the second pass
            try:
                utc = local - (local.replace(tzinfo=zone, fold=fold).utcoffset() or timedelta())
            except OverflowError:  # at the ends of the calendar
                utc = local
            both[fold, i] = (utc - zero) // timedelta(microseconds=1)
        if both[0, i] > both[1, i]:  # Python's sign of a time in the skipped hour
            what = f"{local:%H:%M:%S} does not exist in {form.time_zone} on {local:%Y-%m-%d}: the times are not of this zone"
            do = "correct time_zone under [telemetry], or leave it out for times in UTC"
            raise _cell_error(table, form.time_column, i, what, do)
    return both


def _decide_double_hours(
    micro: np.ndarray, first: np.ndarray, second: np.ndarray
) -> tuple[np.ndarray, int]:
    """Return the UTC of local times (n), microseconds from 1970, and the number of times in double hours that may be an hour off.

    The second pass of a double hour begins where the times fall back. If they do not fall, the pass that is nearer to the
    neighbouring times is taken. If the neighbours are far away, that decides nothing.

    Parameters
    ----------
    micro : (n), microseconds from 1970
        Times as the clock shows them.
    first, second : (n), microseconds from 1970
        Their UTC in the first and in the second pass; equal outside the double hours.
    """
    rises, falls = (np.count_nonzero(sign * np.diff(micro) > 0) for sign in (1, -1))
    # a file with the newest row first is read backward
    rows = np.arange(len(micro))[:: 1 if rises >= falls else -1]
    intervals = np.abs(np.diff(micro)[np.diff(micro) != 0])
    few_intervals = FALL_INTERVALS * float(np.median(intervals)) if intervals.size else 0.0
    double = second[rows] > first[rows]
    falls_outside = (np.diff(micro[rows]) < 0) & ~(double[1:] & double[:-1])
    # if rows are in order outside the double hours, any fall inside them is the clock's, else only one of many intervals
    disorder = few_intervals if falls_outside.any() else 0.0
    far_apart = np.abs(np.diff(micro[rows])) > DAY_S * 1e6
    stretches = np.split(np.arange(len(rows)), np.flatnonzero(np.diff(double) | far_apart) + 1)
    utc, undecided = first.copy(), 0
    for part in (part for part in stretches if double[part[0]]):
        stretch = rows[part]
        steps = np.diff(first[stretch])
        if steps.size and steps.min() < -disorder:
            second_pass = stretch[int(steps.argmin()) + 1 :]
            utc[second_pass] = second[second_pass]
            continue
        # to the row before if this is the first pass, and to the row after if it is the second
        gap_before, gap_after = np.inf, np.inf
        if part[0] > 0 and first[stretch[0]] >= utc[rows[part[0] - 1]] - disorder:
            gap_before = first[stretch[0]] - utc[rows[part[0] - 1]]
        if part[-1] + 1 < len(rows):
            gap_after = max(first[rows[part[-1] + 1]] - second[stretch[-1]], 0)
        if gap_after < gap_before:
            utc[stretch] = second[stretch]
        undecided += len(stretch) if min(gap_before, gap_after) > few_intervals else 0
    return utc, undecided


def _read_atomic(form: TelemetryForm, table: TextTable) -> np.ndarray:
    """Return the UTC (n), s from 1970, of rows whose clock shows GPS time, TAI or TT.

    Cells are dates in that scale or, of GPS time and TAI, seconds: with a column of GPS weeks those since the week began.
    """
    scale = form.time_format.upper()
    ahead_s = AHEAD_OF_SCALE_S[form.time_format]  # TAI minus that scale
    cells = table.cells[form.time_column].tolist()
    cells = [strip_scale(cell, form.time_format) for cell in cells]
    words = re.findall("[a-z]+", form.time_column.lower())
    if any(TIME_SCALES.get(word) == form.time_format for word in words):
        # vehicle file and name agree: programs append Z to any date
        cells = [cell.removesuffix("Z") for cell in cells]
    has_numbers = bool(np.isfinite([plain_number(cell) for cell in cells]).any())
    if form.week_column is None and (scale == "TT" or not has_numbers):
        dates = []  # s from 1970, read as if they were UTC
        for i, cell in enumerate(cells):
            moment = parse_utc(cell)
            if moment is None or _kind_of_zone(cell) is not None:
                what = f"{scale} seconds are expected, or a date in {scale} time without a zone"
                do = 'correct it, or set time_format = "utc" under [telemetry]'
                if scale == "TT":
                    what = "a date in TT without a zone is expected"
                    do = f'correct it, or for seconds set time_format = "elapsed" and epoch_utc = "{J2000_UTC}"'
                raise _cell_error(table, form.time_column, i, what, do)
            dates.append(_unix(moment))
        return utc_of_tai(np.array(dates) + ahead_s)
    seconds = _read_seconds(form, table, f"{scale} seconds")
    if scale == "TAI":
        return utc_of_tai(seconds + TAI_ZERO_S)
    return utc_of_tai(_add_gps_weeks(form, table, seconds) + GPS_ZERO_S + ahead_s)


def _add_gps_weeks(form: TelemetryForm, table: TextTable, seconds: np.ndarray) -> np.ndarray:
    """Return GPS time (n), s from its epoch of 1980, from the numbers of the time column (n, s).

    With a column of GPS weeks, these are seconds of the week. The rollovers that the vehicle file states are added to weeks of ten
    bits.

    Raises
    ------
    TelemetryError
        The week is missing, wrong or does not advance, or it is unknown how often it has begun again.
    """
    weeks = seconds / WEEK_S
    if form.week_column is None and (np.abs(seconds) <= WEEK_S).all():
        what = "these are seconds of the week, and no column names the week"
        do = "set week_column under [telemetry]"
        raise _cell_error(table, form.time_column, 0, what, do)
    if form.week_column is not None:
        weeks = np.array([plain_number(cell) for cell in table.cells[form.week_column]])
        bad = ~((weeks >= 0) & (weeks < LATEST_UNIX_S / WEEK_S) & (weeks == np.floor(weeks)))
        if bad.any():
            row = int(bad.argmax())
            raise _cell_error(
                table, form.week_column, row, "a GPS week is a whole number", "correct it"
            )
        if (bad := ~((seconds >= 0) & (seconds < WEEK_S + 1))).any():
            what = "seconds of the week are from 0 to 604800"
            do = "set time_scale_s under [telemetry], 0.001 for milliseconds"
            raise _cell_error(table, form.time_column, int(bad.argmax()), what, do)
        stuck = (np.diff(seconds) < SAME_WEEK_S - WEEK_S) & (np.diff(weeks) == 0)
        if stuck.any():
            what = "the seconds of the week begin again, and the week stays the same"
            do = "correct the weeks from here on"
            raise _cell_error(table, form.week_column, int(stuck.argmax()) + 1, what, do)
        seconds = seconds + WEEK_S * weeks
    # a week below 1024 is ambiguous unless the file states the rollovers; with rollovers, one above is no week of ten bits
    if form.gps_rollovers is None and (early := weeks < WEEKS_TO_ROLLOVER).any():
        raise _rollover_error(form, table, int(early.argmax()), seconds)
    if form.gps_rollovers and (full := weeks >= WEEKS_TO_ROLLOVER).any():
        column = form.week_column or form.time_column
        what = f"the GPS week is not of ten bits, which end at {WEEKS_TO_ROLLOVER - 1}: it has not begun again"
        do = "leave gps_rollovers out under [telemetry]"
        raise _cell_error(table, column, int(full.argmax()), what, do)
    return seconds + WEEKS_TO_ROLLOVER * WEEK_S * (form.gps_rollovers or 0)


def _rollover_error(
    form: TelemetryForm, table: TextTable, row: int, seconds: np.ndarray
) -> TelemetryError:
    """Return the error for ambiguous GPS weeks, with the date of a row for each possible number of rollovers.

    `seconds` (n) are GPS time in s from its epoch without rollovers.
    """
    unix_s = [
        GPS_ZERO_S + float(seconds[row]) + rollovers * WEEKS_TO_ROLLOVER * WEEK_S
        for rollovers in range(3)
    ]
    days = [(UNIX_ZERO + timedelta(seconds=each)).date() for each in unix_s]
    what = f"the GPS week is below {WEEKS_TO_ROLLOVER}, which is {days[0]}, or a week number that has begun again"
    do = f"set gps_rollovers under [telemetry]: 2 for {days[2]}, 1 for {days[1]}, 0 for {days[0]}"
    return _cell_error(table, form.week_column or form.time_column, row, what, do)


def _find_misdated(time: np.ndarray, epoch: datetime) -> tuple[np.ndarray, list[str]]:
    """Return the rows (n) dated years from all others, as by a clock that was reset, and a sentence for each group of them.

    A reset clock goes back to its default date. Of the groups with a large share of the rows, the latest before `CLOCKS_END` is
    therefore right. The result does not depend on the current date. Sentences are in the order in which their groups begin.
    """
    ordered = np.sort(time)
    edges = np.flatnonzero(np.diff(ordered) > DECADES_S) + 1
    groups = np.split(ordered, edges)  # ascending
    end_s = (CLOCKS_END - epoch).total_seconds()
    large = [group for group in groups if len(group) > MANY_MISDATED * len(time)]
    plausible = [group for group in large if group[0] < end_s]
    kept = plausible[-1] if plausible else max(groups, key=len)
    notes = {}  # first row of a group in the file -> its sentence
    for group in groups:
        if group is kept:
            continue
        first, last = (utc_after(float(each), epoch.isoformat()) for each in group[[0, -1]])
        years = max(group[0] - kept[-1], kept[0] - group[-1]) / (365.25 * DAY_S)
        until = f" to {last}" if len(group) > 1 else ""
        side = "before" if group[0] < kept[0] else "after"
        rows = f"{len(group)} row{'s' * (len(group) > 1)} dated {first}{until}"
        share = len(group) / len(time)
        many = f": {100 * share:.0f} % of the file, check that" if share > MANY_MISDATED else ""
        first_row = int(np.argmax((time >= group[0]) & (time <= group[-1])))
        notes[first_row] = (
            f"{rows}, {years:.0f} years {side} the others, by a clock that was reset{many}"
        )
    return (time < kept[0]) | (time > kept[-1]), [notes[row] for row in sorted(notes)]


def _advise_on_cell(cell: str) -> str:
    """Return advice on a cell that is not a date in UTC."""
    size = abs(plain_number(cell))
    if np.isfinite(size):
        likely = likely_counts(size)
        advice = f"set {counts_in_words(likely)} under [telemetry]" if likely else ""
        other = 'if it is Unix time in ms, us or ns, set time_format = "unix" under [telemetry]'
        if size <= LATEST_UNIX_S:
            other = (
                'if it is in seconds, set time_format = "unix" (since 1970), "gps", "tai" or "elapsed" under [telemetry] in the '
                "vehicle file"
            )
        elif likely:  # a time in 100 ns, which is no Unix time
            return advice
        return f"{advice}; {other}" if likely else other
    return advise_on_time(cell) or (
        "write it as 2026-01-31T23:59:59Z, or set time_format under [telemetry] in the vehicle file"
    )


def advise_on_time(cell: str) -> str:
    """Return advice on a text that looks like a time but is none; empty if there is none."""
    if re.search(r":\d\d:60(?!\d)", cell):
        return "leap seconds are not known: write the second before or after, or remove the row"
    if re.fullmatch(r"\d{1,2}:\d\d\.\d", cell.strip()):
        return "a spreadsheet left minutes and seconds of it: export dates as text, or as yyyy-mm-dd hh:mm:ss.000"
    if re.fullmatch(r"\d{1,2}:\d\d(:\d\d\S*)?", cell.strip()):
        return "name the column of dates as date_column under [telemetry]"
    return ""
