"""Kinds of results: how each kind is summarised, drawn and written."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import xarray as xr


class Summary(dict[str, Any]):
    """The main numbers of a result as plain data; `str()` returns them as text for the console.

    Parameters
    ----------
    numbers : dict of plain data, as written to `summary.json`
    lines : lines of text; the first one is the verdict or heading
    notes : remarks, printed after the lines
    table : lines of a console table, printed after the first line
    in_words : sentences that a page shows in the place of the table
    """

    def __init__(
        self,
        numbers: Mapping,
        lines: Sequence[str],
        notes: Sequence[str] = (),
        table: Sequence[str] = (),
        in_words: Sequence[str] = (),
    ) -> None:
        super().__init__(numbers)
        heading, others = list(lines[:1]), list(lines[1:])
        self.lines, self.notes = [*heading, *table, *others], list(notes)
        self.sentences = [*heading, *in_words, *others]

    def __str__(self) -> str:
        return "\n".join([*self.lines, *self.notes])


class Drawing(NamedTuple):
    """A figure to draw.

    `name`: file name without suffix; `make`: function that returns the matplotlib figure; `alt`: what the figure shows, for those
    who cannot see it; `caption`: the text below it.
    """

    name: str
    make: Callable[[], Any]
    alt: str
    caption: str


class Picture(NamedTuple):
    """A figure that was drawn: `files` holds the content of each of its files by suffix; the rest is that of its `Drawing`."""

    name: str
    alt: str
    caption: str
    files: Mapping[str, bytes]


class Table(NamedTuple):
    """A table to write as CSV.

    `name`: file name without suffix; `frame`: the pandas DataFrame; `title`: heading on the page; `shown`: columns on the page ->
    their headings (empty: not on the page); `comment`: last line of the file; `prose`: cells are sentences, so commas are kept and
    cells are quoted.
    """

    name: str
    frame: Any
    title: str = ""
    shown: Mapping[str, str] = {}
    comment: str = ""
    prose: bool = False


class Context(NamedTuple):
    """What a result was computed from: the telemetry, and the vehicle (name, path or `Vehicle`); None if not known."""

    telemetry: xr.Dataset | None = None
    vehicle: Any = None

    def craft(self) -> Any:
        """Return the vehicle as a `Vehicle`, loaded from its file if needed, or None."""
        from sunspin.vehicle import Vehicle, load_vehicle

        if self.vehicle is None or isinstance(self.vehicle, Vehicle):
            return self.vehicle
        return load_vehicle(self.vehicle)


@dataclass(frozen=True)
class Kind:
    """A kind of result: the functions that summarise, draw and write it.

    Attributes
    ----------
    command : the command that writes results of this kind
    main : name of the NetCDF file that holds the result; empty if `datasets` returns all of it
    summary : result -> its summary
    drawings : result and context -> its figures
    tables : result -> its tables
    datasets : result and context -> further NetCDF files, by name
    """

    command: str
    main: str
    summary: Callable[[Any], Summary]
    drawings: Callable[[Any, Context], Iterable[Drawing]] = lambda *_: ()
    tables: Callable[[Any], Iterable[Table]] = lambda _: ()
    datasets: Callable[[Any, Context], Mapping[str, xr.Dataset]] = lambda *_: {}


KINDS: dict[str, Kind] = {}
"""`attrs["kind"]` of a result -> its `Kind`. The modules of :mod:`sunspin.output.kinds` fill it."""


def synthetic_words(synthetic: Any) -> str:
    """Return the sentence that is added to the captions of a result from synthetic telemetry; empty for measured telemetry."""
    return " Synthetic telemetry." if synthetic else ""
