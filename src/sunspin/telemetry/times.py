"""When the rows of a telemetry file were taken: formats, time zones, time scales, boots; and what a reader must know of them."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

import numpy as np

from sunspin.base.errors import TelemetryError
from sunspin.base.tables import Table
from sunspin.base.untrusted import plain_number
from sunspin.telemetry.restarts import (
    FALL_INTERVALS,
    STORED_LONG_S,
    USUAL_DELAY_S,
    Frames,
    Restart,
    boot_epochs,
    boot_starts,
    boots_of,
    clock_set_back,
    received_live,
    uptime_restart,
)
from sunspin.telemetry.timescales import (
    GPS_ZERO_S,
    TAI_AHEAD_OF_GPS_S,
    TAI_ZERO_S,
    UNIX_ZERO,
    WEEK_S,
    WEEKS_TO_ROLLOVER,
    tai_ahead,
    utc_of_tai,
)
from sunspin.vehicle import TelemetryForm
from sunspin.vehicle.timeline import parse_instant, parse_zone, utc_after

LATEST_UNIX_S = 1e11

DAY_S = 86_400.0

DECADES_S = 5 * 365.25 * DAY_S
"""Rows that no other row joins within five years were dated by a clock that was reset: no mission pauses for so long."""

CLOCKS_END = datetime(2038, 1, 19, tzinfo=UTC)
"""When Unix time overflows in 32 bits: where there is another group of dates, rows from here on are of a clock without a date."""

SAME_WEEK_S = 6 * 3600.0
"""A fall of the seconds of the week by a whole week less this is its end, and no row out of order."""

MANY_MISDATED = 0.2
"""A group of rows with more than this part of the file is no damage to a few dates."""

NO_ZONE = "times name no zone: taken as UTC"
NO_ZONE_RECEIVED = "received times name no zone: taken as UTC"

SHOWN_BOOTS = 4
"""Boots that a sentence names by their time zero."""


class Times(NamedTuple):
    """Times of the rows (n), s from `epoch` (UTC); when each was `received`, Unix seconds, NaN where a row does not say, None
    without such a column; sentences on the clock; rows (n) that are `misdated`, with what is wrong with them."""

    time: np.ndarray
    epoch: datetime
    received: np.ndarray | None
    notes: tuple[str, ...]
    misdated: np.ndarray


def parse_utc(text: str) -> datetime | None:
    """Return the instant that a text means, UTC if it names no zone; None if it is no time."""
    written = _written(text)
    return None if written is None else parse_instant(written)


def _written(text: str) -> str | None:
    """Return a time as ISO-8601 writes it; None for a day of the year that does not exist."""
    text = re.sub(r"\s*(UTC|GMT)$", "Z", text.strip()).replace("/", "-")
    day = re.fullmatch(
        r"(\d{4})-(\d{3})([T ].*)?", text, re.ASCII
    )  # year and day of the year, as in CCSDS 301.0-B, ASCII code B
    try:
        if day:
            start = datetime(int(day[1]), 1, 1, tzinfo=UTC) + timedelta(days=int(day[2]) - 1)
            return start.date().isoformat() + (day[3] or "")
    except (ValueError, OverflowError):  # no such year or day
        return None
    return text


def _zone_of(text: str) -> str | None:
    """Return "utc" or "local" for a time that names a zone, None for one that names none or is no time."""
    try:
        moment = datetime.fromisoformat(_written(text) or "")
    except ValueError:
        return None
    if moment.tzinfo is None:
        return None
    return "local" if moment.utcoffset() else "utc"


def received_times(form: TelemetryForm, table: Table) -> np.ndarray | None:
    """Return when each row (n) was received, Unix seconds; NaN where it does not say; None if no column says."""
    if form.receive_time_column is None:
        return None
    cells = table.cells[form.receive_time_column]
    if form.receive_time_format == "unix":
        seconds = np.array([plain_number(cell) for cell in cells])
        received, expected = (
            np.where(np.abs(seconds) < LATEST_UNIX_S, seconds, np.nan),
            "Unix seconds",
        )
    else:
        moments = [parse_utc(cell) for cell in cells]
        received = np.array([_unix(each) if each else np.nan for each in moments])
        expected = "ISO-8601 dates"
    said = np.array([bool(cell.strip()) for cell in cells])
    if said.any() and not np.isfinite(received).any():  # a few cells may be damaged, not all
        what = f"received times are expected to be {expected}"
        do = "correct them, or set receive_time_format under [telemetry]: utc for dates, unix for seconds"
        raise _refused(table, form.receive_time_column, int(said.argmax()), what, do)
    return received


def read_times(form: TelemetryForm, table: Table, read: set[str]) -> Times:
    """Return the times of all rows in the file's order.

    The epoch is the vehicle's. Without one it follows from received times, or it is the first row's time.

    Parameters
    ----------
    read : set of str
        Columns with readings: rows that repeat them are one frame, received again.

    Raises
    ------
    TelemetryError
        For a cell that is no time, and for a clock that was set back or started again if the rows then have no date. With
        ``bad_rows = "refuse"`` also for rows that are misdated.
    """
    received = received_times(form, table)
    notes = []
    fixed = None if form.epoch_utc is None else parse_utc(form.epoch_utc)
    if form.epoch_utc is not None and fixed is None:
        what = "telemetry.epoch_utc of the vehicle is not an ISO-8601 time"
        raise TelemetryError(what, got=form.epoch_utc)
    if received is not None and form.receive_time_format == "utc":
        zones = [_zone_of(cell) for cell in table.cells[form.receive_time_column]]
        if np.isfinite(received).any() and not any(zones):
            notes.append(NO_ZONE_RECEIVED)
    names = [name for name in table.header if name in read]
    frames = Frames(np.char.strip(table.cells[names].to_numpy().astype(str)))
    if form.time_format == "elapsed":
        time, epoch, more = _elapsed(form, table, received, fixed, frames)
        return Times(time, epoch, received, (*notes, *more), np.zeros(len(time), dtype=bool))
    time, epoch, local, more = _calendar(form, table, fixed)
    misdated, words = _decades_off(time, epoch)
    if form.bad_rows != "sort":
        more += _set_back_words(form, table, time, frames, local, ~misdated)
    if form.bad_rows == "refuse" and misdated.any():
        do = 'correct or remove them, or set bad_rows = "flag" under [telemetry], which leaves them out'
        where = table.place(int(misdated.argmax()), form.time_column)
        raise TelemetryError(words[0], do=do, where=where)
    return Times(time, epoch, received, (*notes, *more, *words), misdated)


def _refused(
    table: Table, name: str, row: int, what: str, do: str, got: str | None = None
) -> TelemetryError:
    cell = table.cells[name].iat[row]
    return TelemetryError(
        what, got=got or cell or "an empty cell", do=do, where=table.place(row, name)
    )


def _numbers(form: TelemetryForm, table: Table, kind: str) -> np.ndarray:
    """Return the time column (n) in s."""
    numbers = np.array([plain_number(cell) for cell in table.cells[form.time_column]])
    numbers = numbers * form.time_scale_s
    if (bad := ~(np.abs(numbers) <= LATEST_UNIX_S)).any():
        do = "correct it, or set time_format under [telemetry] in the vehicle file"
        raise _refused(table, form.time_column, int(bad.argmax()), f"{kind} are expected", do)
    return numbers


def _elapsed(
    form: TelemetryForm,
    table: Table,
    received: np.ndarray | None,
    fixed: datetime | None,
    frames: Frames,
) -> tuple[np.ndarray, datetime, list[str]]:
    """Return elapsed times (n, s) from an epoch, that epoch, and sentences on boots and leap seconds."""
    uptime = _numbers(form, table, "seconds")
    if received is not None and np.isfinite(received).any():
        time, zero, epoch, notes = _by_received(uptime, received, fixed, frames)
    elif fixed is None:
        raise TelemetryError("elapsed times need telemetry.epoch_utc in the vehicle file")
    else:
        again = None if form.bad_rows == "sort" else uptime_restart(uptime, frames)
        if again is not None and again.sure:
            raise _starts_again(form, table, again)
        time, zero, epoch, notes = uptime, np.zeros(len(uptime)), fixed, []
        if again is not None:
            notes = [
                f"elapsed times fall by {_span(again.back_s)} at line {table.cells.index[again.row]}: taken for rows out of order; "
                "if the clock was reset there, set receive_time_column under [telemetry]"
            ]
    if fixed is not None:
        time, words = _leap_seconds(form, uptime, zero, epoch)
        notes += words
    return time, epoch, notes


def _by_received(
    uptime: np.ndarray, received: np.ndarray, fixed: datetime | None, frames: Frames
) -> tuple[np.ndarray, np.ndarray, datetime, list[str]]:
    """Return the times (n, s) of rows with a received time, each boot dated by its own; those of uptime zero (n, s) of their boots;
    their epoch, and sentences.

    The epoch is when the first boot had uptime zero, or `fixed`, which is that of the boot nearest to it.
    """
    starts, notes = boot_starts(uptime, received, frames), []
    boot = boots_of(uptime, received, starts)
    zeros = boot_epochs(uptime, received, boot, len(starts))
    own = 0 if fixed is None else int(np.argmin(np.abs(zeros - _unix(fixed))))
    epoch = fixed or UNIX_ZERO + timedelta(seconds=round(float(zeros[0]), 3))
    zero = np.round(zeros - zeros[own], 3)[boot]
    time = uptime + zero
    live = received_live(uptime[boot == own], received[boot == own])
    if live and abs(zeros[own] - _unix(epoch)) > USUAL_DELAY_S:
        by_received = utc_after(float(zeros[own]), UNIX_ZERO.isoformat())
        notes.append(
            f"received times put time zero at {by_received}; epoch_utc says {utc_after(0, epoch.isoformat())}"
        )
    if len(zeros) > 1:
        shown = [
            utc_after(float(zero - zeros[own]), epoch.isoformat()) for zero in zeros[:SHOWN_BOOTS]
        ]
        more = ", ..." if len(zeros) > SHOWN_BOOTS else ""
        notes.append(
            f"the uptime starts again: {len(zeros)} boots, each dated by its received times, from {', '.join(shown)}{more}"
        )
    stored = received - _unix(epoch) - time
    length = np.diff(zeros, prepend=zeros[0])[boot]  # of the boot before a row's own
    either = (stored > USUAL_DELAY_S) & (uptime < length)
    if either.any():
        notes.append(
            f"{_rows(either)} stored telemetry of this boot or of the one before: dated by the last boot before reception"
        )
    if (long := stored > STORED_LONG_S).any():
        notes.append(
            f"{_rows(long)} dated up to {np.nanmax(stored) / DAY_S:.1f} days before reception: stored on board, or the uptime "
            "started again"
        )
    if (early := stored < -STORED_LONG_S).any():
        notes.append(
            f"{_rows(early)} dated up to {-np.nanmin(stored) / DAY_S:.1f} days after reception: check epoch_utc under [telemetry]"
        )
    return time, zero, epoch, notes


def _rows(which: np.ndarray) -> str:
    n = int(np.count_nonzero(which))
    return "1 row is" if n == 1 else f"{n} rows are"


def _starts_again(form: TelemetryForm, table: Table, again: Restart) -> TelemetryError:
    before = table.cells[form.time_column].iat[again.before]
    cell = table.cells[form.time_column].iat[again.row]
    what = "elapsed times start again and run through known times with other readings: a clock that was reset"
    do = (
        "name the column of received times as receive_time_column under [telemetry], or give each boot a file and an epoch_utc of "
        'its own; if the rows are only out of order, set bad_rows = "sort"'
    )
    return _refused(table, form.time_column, again.row, what, do, f"{cell} after {before}")


def _leap_seconds(
    form: TelemetryForm, uptime: np.ndarray, zero: np.ndarray, epoch: datetime
) -> tuple[np.ndarray, list[str]]:
    """Return times (n, s) of `uptime` since its boot's `zero` (n, s) as days of 86,400 s count them, and a sentence if nobody has
    said how leap seconds count."""
    begin, time = _unix(epoch) + zero, uptime + zero
    leaps = round(float(np.max(tai_ahead(begin + uptime) - tai_ahead(begin))))
    if leaps <= 0 or form.counts_leap_seconds is False:
        return time, []
    if form.counts_leap_seconds:
        return utc_of_tai(begin + tai_ahead(begin) + uptime) - _unix(epoch), []
    clock = (
        'such as GPS time (time_format = "gps")'
        if _unix(epoch) == GPS_ZERO_S
        else "as GPS time and TAI do"
    )
    return time, [
        f"{leaps} leap second{'s' * (leaps > 1)} after epoch_utc not counted: if the clock counts them, {clock}, all times are "
        f"{leaps} s late; set counts_leap_seconds = true or false under [telemetry]"
    ]


def _unix(moment: datetime) -> float:
    return (moment - UNIX_ZERO).total_seconds()


def _calendar(
    form: TelemetryForm, table: Table, fixed: datetime | None
) -> tuple[np.ndarray, datetime, bool, list[str]]:
    """Return dated times (n, s) from an epoch, that epoch, whether they name no zone, and sentences on the clock."""
    notes, local = [], False
    if form.time_format == "utc":
        micro, local, notes = _utc(form, table)
        base = fixed or UNIX_ZERO + timedelta(microseconds=int(micro[0]))
        time = (micro - (base - UNIX_ZERO) // timedelta(microseconds=1)) / 1e6
        epoch = base
    else:
        if form.time_format == "unix":
            seconds = _numbers(form, table, "Unix seconds")
        else:
            seconds, notes = _atomic(form, table)
        epoch = fixed or UNIX_ZERO + timedelta(seconds=float(seconds[0]))
        time = seconds - _unix(epoch)
    return time, epoch, local, notes


def _set_back_words(
    form: TelemetryForm,
    table: Table,
    time: np.ndarray,
    frames: Frames,
    local: bool,
    dated: np.ndarray,
) -> list[str]:
    """Return a sentence on a fall of the times that may be a clock set back, of rows that are `dated` (n); refuse one that is."""
    rows = np.flatnonzero(dated)
    back = clock_set_back(time[rows], Frames(frames.cells[rows]), local)
    if back is None:
        return []
    back = back._replace(row=int(rows[back.row]), before=int(rows[back.before]))
    if back.sure:
        raise _set_back(form, table, back, local)
    if local:
        do = "if a local clock was set back there, set time_zone under [telemetry]"
    else:
        do = "if the clock was set back there, correct the times from there on"
    return [
        f"times fall back once, by {_span(back.back_s)} at line {table.cells.index[back.row]}: taken for rows out of order; {do}"
    ]


def _span(seconds: float) -> str:
    """Return a length of time in words: days, hours or minutes."""
    if seconds >= DAY_S:
        return f"{seconds / DAY_S:.1f} days"
    minutes = round(seconds / 60)
    return f"{minutes // 60} h" if minutes and minutes % 60 == 0 else f"{minutes} min"


def _set_back(form: TelemetryForm, table: Table, back: Restart, local: bool) -> TelemetryError:
    """Return the error for a clock that was set back; `local`: the times name no zone."""
    cells = table.cells[form.time_column]
    what = f"all times from here on go back by {_span(back.back_s)}, as a clock that is set back"
    if local:
        do = 'set time_zone under [telemetry], such as time_zone = "Europe/Berlin"'
    else:
        do = "give the rows from here on as a file of their own, with their times corrected"
    do += '; if the rows are only out of order, set bad_rows = "sort"'
    got = f"{cells.iat[back.row]} after {cells.iat[back.before]}"
    return _refused(table, form.time_column, back.row, what, do, got)


def _utc(form: TelemetryForm, table: Table) -> tuple[np.ndarray, bool, list[str]]:
    """Return the times (n) in microseconds from 1970, whether none of them names a zone, and sentences on the zone."""
    cells = table.cells[form.time_column].tolist()
    moments = [moment for cell in cells if (moment := parse_utc(cell)) is not None]
    if len(moments) < len(cells):
        i = next(k for k, cell in enumerate(cells) if parse_utc(cell) is None)
        what = "an ISO-8601 UTC time is expected"
        raise _refused(table, form.time_column, i, what, _how_to_write(cells[i]))
    zones = np.array([_zone_of(cell) or "" for cell in cells])
    bare = zones == ""
    micro = np.array([(each - UNIX_ZERO) // timedelta(microseconds=1) for each in moments])
    if form.time_zone is not None:
        return _in_zone(form, table, micro, bare)
    if bare.any() and (zones == "local").any():  # nobody knows whether those without a zone are UTC
        what = "other times of this file have a time zone and this one has none"
        do = "give each its zone, or Z for UTC"
        raise _refused(table, form.time_column, int(bare.argmax()), what, do)
    notes = []
    if bare.all():
        notes = [NO_ZONE]
    elif bare.any():
        n = int(bare.sum())
        notes = [f"{'1 time names' if n == 1 else f'{n} times name'} no zone: taken as UTC"]
    return micro, bool(bare.all()), notes


def _in_zone(
    form: TelemetryForm, table: Table, micro: np.ndarray, bare: np.ndarray
) -> tuple[np.ndarray, bool, list[str]]:
    """Return local times of a zone, given as if they were UTC (n, microseconds; those that are not `bare` are UTC), in UTC.

    The hour that a clock shows twice comes first in summer time. Its second pass begins where the times fall back; if they do not
    fall, the pass to which the neighbouring times are nearer is taken.
    """
    zone, hour = parse_zone(str(form.time_zone)), np.zeros((2, len(micro)), dtype=np.int64)
    for i in np.flatnonzero(bare).tolist():
        shown = datetime(1970, 1, 1) + timedelta(microseconds=int(micro[i]))
        for fold in (0, 1):
            try:
                offset = shown.replace(tzinfo=zone, fold=fold).utcoffset() or timedelta()
                utc_shown = shown - offset
            except OverflowError:  # at the ends of the calendar
                utc_shown = shown
            hour[fold, i] = (utc_shown - datetime(1970, 1, 1)) // timedelta(microseconds=1)
        if hour[0, i] > hour[1, i]:
            what = f"{shown:%H:%M:%S} does not exist in {form.time_zone} on {shown:%Y-%m-%d}: the times are not of this zone"
            do = "correct time_zone under [telemetry], or leave it out for times in UTC"
            raise _refused(table, form.time_column, i, what, do)
    first, second = np.where(bare, hour, micro)
    rises, falls = (np.count_nonzero(sign * np.diff(micro) > 0) for sign in (1, -1))
    rows = np.arange(len(micro))[:: 1 if rises >= falls else -1]  # newest first: read backward
    moved = np.abs(np.diff(micro)[np.diff(micro) != 0])
    disorder = FALL_INTERVALS * float(np.median(moved)) if moved.size else 0.0
    utc, undecided = first.copy(), 0
    twice = second[rows] > first[rows]
    outside = (np.diff(micro[rows]) < 0) & ~(twice[1:] & twice[:-1])
    if not outside.any():  # in order but for the clock: any fall is its
        disorder = 0.0
    near = max(disorder, FALL_INTERVALS * float(np.median(moved)) if moved.size else 0.0)
    apart = np.abs(np.diff(micro[rows])) > DAY_S * 1e6
    stretches = np.split(np.arange(len(rows)), np.flatnonzero(np.diff(twice) | apart) + 1)
    for part in (part for part in stretches if twice[part[0]]):
        stretch = rows[part]
        steps = np.diff(first[stretch])
        if steps.size and steps.min() < -disorder:
            again = stretch[int(steps.argmin()) + 1 :]
            utc[again] = second[again]
            continue
        # to the row before if this is the first pass, to the row after if it is the second
        gaps = [np.inf, np.inf]
        if part[0] > 0 and first[stretch[0]] >= utc[rows[part[0] - 1]] - disorder:
            gaps[0] = first[stretch[0]] - utc[rows[part[0] - 1]]
        if part[-1] + 1 < len(rows):
            gaps[1] = max(first[rows[part[-1] + 1]] - second[stretch[-1]], 0)
        if gaps[1] < gaps[0]:
            utc[stretch] = second[stretch]
        # a neighbour that is far away decides nothing
        undecided += len(stretch) if min(gaps) > near else 0
    notes = [f"times without a zone are read in {form.time_zone}"] if bare.any() else []
    if undecided:
        lie = "1 time lies" if undecided == 1 else f"{undecided} times lie"
        notes.append(f"{lie} in the hour that a clock there shows twice, and may be an hour off")
    return utc, False, notes


def _atomic(form: TelemetryForm, table: Table) -> tuple[np.ndarray, list[str]]:
    """Return UTC (n) in s from 1970 of GPS time or TAI: numbers of seconds, week and seconds of week, or dates of that scale."""
    gps = form.time_format == "gps"
    cells = table.cells[form.time_column].tolist()
    ahead = TAI_AHEAD_OF_GPS_S if gps else 0.0
    name = "GPS" if gps else "TAI"
    cells = [cell.strip().removesuffix(name).rstrip() for cell in cells]
    if form.week_column is None and not np.isfinite([plain_number(cell) for cell in cells]).any():
        moments = [parse_utc(cell) for cell in cells]
        for i, (cell, moment) in enumerate(zip(cells, moments, strict=True)):
            if moment is None or _zone_of(cell) is not None:
                what = f"{name} seconds are expected, or a date in {name} time without a zone"
                do = 'correct it, or set time_format = "utc" under [telemetry]'
                raise _refused(table, form.time_column, i, what, do)
        return utc_of_tai(np.array([_unix(each) for each in moments if each]) + ahead), []
    seconds = _numbers(form, table, f"{name} seconds")
    if not gps:
        return utc_of_tai(seconds + TAI_ZERO_S), []
    weeks = seconds / WEEK_S
    if form.week_column is None and (np.abs(seconds) <= WEEK_S).all():
        what = "these are seconds of the week, and no column names the week"
        do = "set week_column under [telemetry]"
        raise _refused(table, form.time_column, 0, what, do)
    if form.week_column is not None:
        weeks = np.array([plain_number(cell) for cell in table.cells[form.week_column]])
        bad = ~((weeks >= 0) & (weeks < LATEST_UNIX_S / WEEK_S) & (weeks == np.floor(weeks)))
        if bad.any():
            row = int(bad.argmax())
            raise _refused(
                table, form.week_column, row, "a GPS week is a whole number", "correct it"
            )
        if (bad := ~((seconds >= 0) & (seconds < WEEK_S + 1))).any():
            what = "seconds of the week are from 0 to 604800"
            do = "set time_scale_s under [telemetry], 0.001 for milliseconds"
            raise _refused(table, form.time_column, int(bad.argmax()), what, do)
        again = (np.diff(seconds) < SAME_WEEK_S - WEEK_S) & (np.diff(weeks) == 0)
        if again.any():
            what = "the seconds of the week begin again, and the week stays the same"
            do = "correct the weeks from here on"
            raise _refused(table, form.week_column, int(again.argmax()) + 1, what, do)
        seconds = seconds + WEEK_S * weeks
    if form.gps_rollovers is None and (early := weeks < WEEKS_TO_ROLLOVER).any():
        raise _rolled_over(form, table, int(early.argmax()), seconds)
    if form.gps_rollovers and (full := weeks >= WEEKS_TO_ROLLOVER).any():
        column = form.week_column or form.time_column
        what = f"the GPS week is not of ten bits, which end at {WEEKS_TO_ROLLOVER - 1}: it has not begun again"
        do = "leave gps_rollovers out under [telemetry]"
        raise _refused(table, column, int(full.argmax()), what, do)
    seconds = seconds + WEEKS_TO_ROLLOVER * WEEK_S * (form.gps_rollovers or 0)
    return utc_of_tai(seconds + GPS_ZERO_S + ahead), []


def _rolled_over(
    form: TelemetryForm, table: Table, row: int, seconds: np.ndarray
) -> TelemetryError:
    """Return the error for GPS weeks that begin again after 1024: which dates each number of rollovers gives."""
    days = [
        (
            UNIX_ZERO
            + timedelta(seconds=GPS_ZERO_S + float(seconds[row]) + k * WEEKS_TO_ROLLOVER * WEEK_S)
        ).date()
        for k in range(3)
    ]
    what = f"the GPS week is below {WEEKS_TO_ROLLOVER}, which is {days[0]}, or a week number that has begun again"
    do = f"set gps_rollovers under [telemetry]: 2 for {days[2]}, 1 for {days[1]}, 0 for {days[0]}"
    return _refused(table, form.week_column or form.time_column, row, what, do)


def _decades_off(time: np.ndarray, epoch: datetime) -> tuple[np.ndarray, list[str]]:
    """Return rows (n) dated years from all others, as by a clock that was reset, and sentences that name them.

    A reset clock goes back to its default: of groups with a good share of the rows, the latest before `CLOCKS_END` holds. The day
    of the run decides nothing, so that a file reads alike every day. Sentences are in the order in which their groups begin.
    """
    ordered = np.sort(time)
    edges = np.flatnonzero(np.diff(ordered) > DECADES_S) + 1
    groups = np.split(ordered, edges)
    end = (CLOCKS_END - epoch).total_seconds()
    large = [group for group in groups if len(group) > MANY_MISDATED * len(time)]
    past = [group for group in large if group[0] < end]
    kept = past[-1] if past else max(groups, key=len)
    notes = {}
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
        begins = int(np.argmax((time >= group[0]) & (time <= group[-1])))
        notes[begins] = (
            f"{rows}, {years:.0f} years {side} the others, by a clock that was reset{many}"
        )
    return (time < kept[0]) | (time > kept[-1]), [notes[row] for row in sorted(notes)]


def _how_to_write(cell: str) -> str:
    """Return what to do with a cell that is no time in UTC."""
    size = abs(plain_number(cell))
    if size > LATEST_UNIX_S:
        return 'if it is Unix time in milliseconds, set time_format = "unix" and time_scale_s = 0.001 under [telemetry]'
    if np.isfinite(size):
        return (
            'if it is in seconds, set time_format = "unix" (since 1970), "gps", "tai" or "elapsed" under [telemetry] in the '
            "vehicle file"
        )
    if re.search(r":\d\d:60(?!\d)", cell):
        return "leap seconds are not known: write the second before or after, or remove the row"
    return (
        "write it as 2026-01-31T23:59:59Z, or set time_format under [telemetry] in the vehicle file"
    )
