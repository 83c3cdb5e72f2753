"""The events of a case, in UTC and in seconds from its epoch."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sunspin.errors import InputError, sentence


@dataclass(frozen=True)
class Event:
    """A moment: name, UTC, seconds from the timeline's epoch, where the time comes from."""

    name: str
    utc: datetime
    t_s: float
    source: str


@dataclass(frozen=True)
class Timeline:
    """Events in order of time; ``timeline["collision"]`` is one of them."""

    epoch_utc: datetime
    events: tuple[Event, ...]

    def __getitem__(self, name: str) -> Event:
        for event in self.events:
            if event.name == name:
                return event
        known = ", ".join(event.name for event in self.events)
        raise InputError(sentence(f"no event is called {name!r}", do=f"known: {known}"))

    def between(self, first: str, second: str) -> float:
        """Seconds from one event to another."""
        return self[second].t_s - self[first].t_s

    def seconds(self, utc: datetime) -> float:
        """Seconds from the epoch to a UTC time."""
        return (utc - self.epoch_utc).total_seconds()


def parse_timeline(text: str) -> Timeline:
    """Read a timeline from the text of a ``timeline.toml`` (keys: epoch, event = [{name, utc, source}])."""
    table: Mapping[str, Any] = tomllib.loads(text)
    epoch = datetime.fromisoformat(table["epoch"])
    events = []
    for entry in table["event"]:
        utc = datetime.fromisoformat(entry["utc"])
        events.append(Event(entry["name"], utc, (utc - epoch).total_seconds(), entry["source"]))
    return Timeline(epoch, tuple(sorted(events, key=lambda event: event.utc)))
