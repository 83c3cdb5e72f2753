"""What each kind of result has: its numbers in words, its figures, its tables, its files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import xarray as xr


class Summary(dict[str, Any]):
    """The main numbers of a result as plain data; as text, `lines` and then `notes`, what a person should know with them.

    `table`: lines of a console table, printed after the first line; a page shows `in_words`, sentences, in their place.
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
        first, rest = list(lines[:1]), list(lines[1:])
        self.lines, self.notes = [*first, *table, *rest], list(notes)
        self.sentences = [*first, *in_words, *rest]

    def __str__(self) -> str:
        return "\n".join([*self.lines, *self.notes])


class Drawing(NamedTuple):
    """A figure to draw: file name, function that returns the matplotlib figure, what it shows in words, caption."""

    name: str
    make: Callable[[], Any]
    alt: str
    caption: str


class Table(NamedTuple):
    """A table to write as CSV.

    `frame`: the pandas DataFrame; `shown`: its columns on the page, with their headings there (none: the file only);
    `comment`: a last line of the file; `prose`: sentences, whose commas are kept between quotation marks.
    """

    name: str
    frame: Any
    title: str = ""
    shown: Mapping[str, str] = {}
    comment: str = ""
    prose: bool = False


class Context(NamedTuple):
    """What a result was computed from: the samples, and the vehicle by name, path or itself; None where not known."""

    telemetry: xr.Dataset | None = None
    vehicle: Any = None

    def craft(self) -> Any:
        """The vehicle itself, or None."""
        from sunspin.vehicle import Vehicle, load_vehicle

        known = self.vehicle is None or isinstance(self.vehicle, Vehicle)
        return self.vehicle if known else load_vehicle(self.vehicle)


@dataclass(frozen=True)
class Kind:
    """A kind of result.

    Attributes
    ----------
    command : the command whose results folders these are
    main : the NetCDF file that holds the result itself; empty if `datasets` has all
    summary, drawings, tables : what it says, its figures, its tables
    datasets : further NetCDF files, by name
    """

    command: str
    main: str
    summary: Callable[[Any], Summary]
    drawings: Callable[[Any, Context], Iterable[Drawing]] = lambda *_: ()
    tables: Callable[[Any], Iterable[Table]] = lambda _: ()
    datasets: Callable[[Any, Context], Mapping[str, xr.Dataset]] = lambda *_: {}


KINDS: dict[str, Kind] = {}
"""`attrs["kind"]` -> what can be said, drawn and written of it; :mod:`sunspin.output.kinds` fills it."""


def synthetic_words(synthetic: Any) -> str:
    """The end of a caption of what was made from synthetic telemetry."""
    return " Synthetic telemetry." if synthetic else ""
