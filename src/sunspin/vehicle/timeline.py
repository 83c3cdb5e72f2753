"""Events and phases of a case, in UTC and in seconds from the epoch of the case."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from zoneinfo import ZoneInfo

from sunspin.base.errors import InputError, SunspinError, VehicleError
from sunspin.base.untrusted import read_toml
from sunspin.vehicle.part import Name, Number, Part, keys_of, part


@part
class Event(Part):
    """A named instant: published UTC, a refined UTC if known, and `t_s`, the time of the better one in s from the epoch."""

    name: Name
    utc: str
    t_s: Number
    source: str
    note: str = ""
    refined_utc: str | None = None
    refined_source: str | None = None


@part
class Phase(Part):
    """The interval ``begin_s <= t < end_s`` (s from the epoch) between two events; `end_s` is inf if it has no end."""

    name: Name
    begin_s: Number
    end_s: Number
    note: str = ""


@part
class Timeline(Part):
    """Events in order of time, and the phases between them."""

    epoch_utc: str
    events: tuple[Event, ...] = ()
    phases: tuple[Phase, ...] = ()

    def event(self, name: str) -> Event:
        """Return the event called `name`; raise `InputError` with the known names if there is none."""
        return _find_named(self.events, name, "event")

    def phase(self, name: str) -> Phase:
        """Return the phase called `name`; raise `InputError` with the known names if there is none."""
        return _find_named(self.phases, name, "phase")

    def seconds(self, begin: str, end: str) -> float:
        """Return the time in seconds from one named event to another."""
        return self.event(end).t_s - self.event(begin).t_s

    def phase_at(self, t_s: float) -> str | None:
        """Return the name of the phase at `t_s`, None outside all phases."""
        return next(
            (phase.name for phase in self.phases if phase.begin_s <= t_s < phase.end_s), None
        )


def utc_seconds(utc: str, epoch_utc: str) -> float:
    """Return the seconds from `epoch_utc` to `utc`, both ISO-8601 UTC (days of 86400 s: leap seconds are not counted)."""
    return (_require_instant(utc) - _require_instant(epoch_utc)).total_seconds()


def utc_after(seconds: float, epoch_utc: str, digits: int = 0) -> str:
    """Return the ISO-8601 UTC time `seconds` after `epoch_utc`, rounded to `digits` decimals (at most three).

    All times of a column have the same length: whole seconds for zero digits, else three decimals. A time outside the calendar
    is given as the epoch and the seconds.
    """
    step_us = 10 ** (6 - digits)  # the last decimal in microseconds
    try:
        exact = _require_instant(epoch_utc) + timedelta(seconds=seconds)
        rounded_us = round(exact.microsecond / step_us) * step_us
        instant = exact + timedelta(microseconds=rounded_us - exact.microsecond)
    except OverflowError:
        return f"{epoch_utc} and {seconds:g} s"
    return instant.isoformat(timespec="milliseconds" if digits else "seconds").replace(
        "+00:00", "Z"
    )


def parse_instant(text: str) -> datetime | None:
    """Return the instant of an ISO-8601 time, taken as UTC if it names no zone; None if the text is not a time."""
    try:
        moment = datetime.fromisoformat(text)
        return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    # OverflowError: conversion to UTC takes a time near the year 1 or 9999 outside the calendar
    except (TypeError, ValueError, OverflowError):
        return None


def parse_zone(text: str) -> tzinfo:
    """Return the time zone of an IANA name, or of an offset from UTC such as +02:00.

    Raises
    ------
    VehicleError
        If no zone has this name.
    """
    offset = re.fullmatch(r"([+-])([01]\d|2[0-3]):?([0-5]\d)", text, re.ASCII)
    if offset:
        size = timedelta(hours=int(offset[2]), minutes=int(offset[3]))
        return timezone(size if offset[1] == "+" else -size)
    try:
        return ZoneInfo(text)
    except (KeyError, ValueError, OSError):  # errors of ZoneInfo for unknown names
        what = "telemetry.time_zone is not known"
        do = "give a name such as Europe/Berlin, or an offset such as +02:00"
        raise VehicleError(what, got=text, do=do) from None


def _require_instant(utc: str) -> datetime:
    """Return the instant of an ISO-8601 time; raise `InputError` if the text is not a time."""
    moment = parse_instant(utc)
    if moment is None:
        raise InputError(
            "a time must be ISO-8601 UTC such as 2014-11-12T15:34:04", got=utc, do="correct it"
        )
    return moment


def parse_timeline(text: str, where: str) -> Timeline:
    """Parse the text of a ``timeline.toml``; `where` names the file in messages. Raises `InputError`."""
    table = read_toml(text, where, InputError)
    try:
        epoch = table["epoch_utc"]
        events = sorted(
            (_read_event(entry, epoch) for entry in table.get("event", [])),
            key=lambda event: event.t_s,
        )
        # phases name events, which this first timeline finds
        timeline = Timeline(epoch, tuple(events))
        phases = [_read_phase(entry, timeline) for entry in table.get("phase", [])]
        return replace(timeline, phases=tuple(phases))
    except KeyError as error:
        raise InputError(f"key {error.args[0]!r} is missing", do="add it", where=where) from None
    except SunspinError as error:
        raise InputError(f"{where}: {error}") from None
    except (TypeError, AttributeError, RecursionError) as error:
        what = f"an entry has not the form of a timeline's ({error})"
        raise InputError(what, do="correct it", where=where) from None


def _read_event(entry: dict, epoch_utc: str) -> Event:
    """Return an event from its table; raise an error if it is not valid.

    Its time is that of the refined UTC, if stated.
    """
    _refuse_unknown(entry, {*keys_of(Event)} - {"t_s"}, "event")
    event = Event(t_s=utc_seconds(entry.get("refined_utc") or entry["utc"], epoch_utc), **entry)
    if not event.source.strip():
        raise InputError(
            f"event {event.name!r} has an empty source", do="say where its time comes from"
        )
    return event


def _read_phase(entry: dict, timeline: Timeline) -> Phase:
    """Return a phase from its table and the events of the timeline; raise an error if it is not valid.

    A phase without the key "end" has no end.
    """
    _refuse_unknown(entry, {"name", "begin", "end", "note"}, "phase")
    begin = timeline.event(entry["begin"]).t_s
    end = timeline.event(entry["end"]).t_s if "end" in entry else float("inf")
    if not begin < end:
        raise InputError(
            f"phase {entry['name']!r} ends before it begins", got=f"{begin:g} s to {end:g} s"
        )
    return Phase(entry["name"], begin, end, entry.get("note", ""))


def _refuse_unknown(entry: dict, known: set[str], kind: str) -> None:
    """Raise `InputError` if a table has unknown keys."""
    for key in entry:
        if key not in known:
            raise InputError(
                f"unknown key {key!r} in [[{kind}]]", do=f"known keys: {', '.join(sorted(known))}"
            )


def _find_named(items: tuple, name: str, kind: str):
    """Return the item called `name`; raise `InputError` with the known names if there is none."""
    for item in items:
        if item.name == name:
            return item
    known = ", ".join(item.name for item in items) or "none"
    raise InputError(f"the timeline has no {kind} of this name", got=name, do=f"known: {known}")
