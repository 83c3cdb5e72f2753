"""Events and phases of a case, in UTC and in seconds from the case's epoch."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from zoneinfo import ZoneInfo

from sunspin.base.errors import InputError, SunspinError, VehicleError
from sunspin.base.untrusted import read_toml
from sunspin.vehicle.part import Name, Number, Part, keys_of, part


@part
class Event(Part):
    """A named instant: its UTC as published, a refined one where known, and `t_s` (s from the epoch) of the better."""

    name: Name
    utc: str
    t_s: Number
    source: str
    note: str = ""
    refined_utc: str | None = None
    refined_source: str | None = None


@part
class Phase(Part):
    """The stretch ``begin_s <= t < end_s`` (s from the epoch) between two events; `end_s` is inf where open."""

    name: Name
    begin_s: Number
    end_s: Number
    note: str = ""


@part
class Timeline(Part):
    """Events in order of time and the phases between them."""

    epoch_utc: str
    events: tuple[Event, ...] = ()
    phases: tuple[Phase, ...] = ()

    def event(self, name: str) -> Event:
        """The event called `name`, or an `InputError` that lists the names there are."""
        return _find_named(self.events, name, "event")

    def phase(self, name: str) -> Phase:
        """The phase called `name`, or an `InputError` that lists the names there are."""
        return _find_named(self.phases, name, "phase")

    def seconds(self, begin: str, end: str) -> float:
        """Seconds from one named event to another."""
        return self.event(end).t_s - self.event(begin).t_s

    def phase_at(self, t_s: float) -> str | None:
        """Name of the phase that holds at `t_s`, None outside all of them."""
        return next(
            (phase.name for phase in self.phases if phase.begin_s <= t_s < phase.end_s), None
        )


def utc_seconds(utc: str, epoch_utc: str) -> float:
    """Seconds from `epoch_utc` to `utc`, both ISO-8601 UTC (days of 86400 s: no leap second is counted)."""
    return (_require_instant(utc) - _require_instant(epoch_utc)).total_seconds()


def utc_after(seconds: float, epoch_utc: str, digits: int = 0) -> str:
    """The time (ISO-8601 UTC) so many seconds after `epoch_utc`, rounded to so many decimals, at most three; beyond the calendar
    epoch and seconds. All times of a column have one form: to the second without `digits`, else always three decimals."""
    unit = 10 ** (6 - digits)
    try:
        exact = _require_instant(epoch_utc) + timedelta(seconds=seconds)
        instant = exact + timedelta(
            microseconds=round(exact.microsecond / unit) * unit - exact.microsecond
        )
    except OverflowError:
        return f"{epoch_utc} and {seconds:g} s"
    return instant.isoformat(timespec="milliseconds" if digits else "seconds").replace(
        "+00:00", "Z"
    )


def parse_instant(text: str) -> datetime | None:
    """The instant that an ISO-8601 time means, UTC where it names no zone; None if it is none."""
    try:
        moment = datetime.fromisoformat(text)
        return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    except (
        TypeError,
        ValueError,
        OverflowError,
    ):  # a time near the year 1 or 9999 leaves the calendar when its zone is taken off
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
    except (
        KeyError,
        ValueError,
        OSError,
    ):  # ZoneInfo's errors for a name that is not one of its files
        what = "telemetry.time_zone is not known"
        do = "give a name such as Europe/Berlin, or an offset such as +02:00"
        raise VehicleError(what, got=text, do=do) from None


def _require_instant(utc: str) -> datetime:
    moment = parse_instant(utc)
    if moment is None:
        raise InputError(
            "a time must be ISO-8601 UTC such as 2014-11-12T15:34:04", got=utc, do="correct it"
        )
    return moment


def parse_timeline(text: str, where: str) -> Timeline:
    """Read the text of a ``timeline.toml``; `where` names the file in messages."""
    table = read_toml(text, where, InputError)
    try:
        epoch = table["epoch_utc"]
        events = sorted(
            (_read_event(entry, epoch) for entry in table.get("event", [])),
            key=lambda event: event.t_s,
        )
        timeline = Timeline(epoch, tuple(events))
        return Timeline(
            epoch,
            tuple(events),
            tuple(_read_phase(entry, timeline) for entry in table.get("phase", [])),
        )
    except KeyError as error:
        raise InputError(f"key {error.args[0]!r} is missing", do="add it", where=where) from None
    except SunspinError as error:
        raise InputError(f"{where}: {error}") from None
    except (TypeError, AttributeError, RecursionError) as error:
        what = f"an entry has not the form of a timeline's ({error})"
        raise InputError(what, do="correct it", where=where) from None


def _read_event(entry: dict, epoch_utc: str) -> Event:
    _refuse_unknown(entry, {*keys_of(Event)} - {"t_s"}, "event")
    event = Event(t_s=utc_seconds(entry.get("refined_utc") or entry["utc"], epoch_utc), **entry)
    if not event.source.strip():
        raise InputError(
            f"event {event.name!r} has an empty source", do="say where its time comes from"
        )
    return event


def _read_phase(entry: dict, timeline: Timeline) -> Phase:
    _refuse_unknown(entry, {"name", "begin", "end", "note"}, "phase")
    begin = timeline.event(entry["begin"]).t_s
    end = timeline.event(entry["end"]).t_s if "end" in entry else float("inf")
    if not begin < end:
        raise InputError(
            f"phase {entry['name']!r} ends before it begins", got=f"{begin:g} s to {end:g} s"
        )
    return Phase(entry["name"], begin, end, entry.get("note", ""))


def _refuse_unknown(entry: dict, known: set[str], kind: str) -> None:
    for key in entry:
        if key not in known:
            raise InputError(
                f"unknown key {key!r} in [[{kind}]]", do=f"known keys: {', '.join(sorted(known))}"
            )


def _find_named(items: tuple, name: str, kind: str):
    for item in items:
        if item.name == name:
            return item
    known = ", ".join(item.name for item in items) or "none"
    raise InputError(f"the timeline has no {kind} of this name", got=name, do=f"known: {known}")
