"""What can be said, drawn and written of one kind of result."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import xarray as xr

from sunspin.output.folder import write_netcdf


class Summary(dict[str, Any]):
    """The main numbers of a result as plain data; as text, `lines` and then `notes`, what a person should know beside them."""

    def __init__(
        self, numbers: Mapping[str, Any], lines: Sequence[str], notes: Sequence[str] = ()
    ) -> None:
        super().__init__(numbers)
        self.lines, self.notes = list(lines), list(notes)

    def __str__(self) -> str:
        return "\n".join([*self.lines, *self.notes])


class Drawing(NamedTuple):
    """A figure to draw: file name, function that makes it, what it shows in words, caption."""

    name: str
    make: Callable[[], Any]
    alt: str
    caption: str


class Beside(NamedTuple):
    """What lay beside a result when it was made: the samples, and the vehicle by name, path or itself; None where not known."""

    telemetry: xr.Dataset | None = None
    vehicle: Any = None


def no_drawings(_: Any, __: Beside) -> Iterable[Drawing]:
    return ()


@dataclass(frozen=True)
class Kind:
    """`command`: whose results folders these are; `main`: the file that holds the result itself."""

    command: str
    main: str
    summary: Callable[[Any], Summary]
    drawings: Callable[[Any, Beside], Iterable[Drawing]] = no_drawings
    tables: Callable[[Any, Path, Beside], Any] = lambda *_: None

    def write(self, data: Any, folder: Path, beside: Beside) -> None:
        """The result as NetCDF, and its tables; a DataArray as the Dataset that knows its kind when it is read again."""
        if isinstance(data, xr.DataArray):
            data = data.to_dataset().assign_attrs(
                {key: value for key, value in data.attrs.items() if key != "units"}
            )
        if self.main:
            write_netcdf(folder / self.main, data)
        self.tables(data, folder, beside)


def synthetic_label(data: Any) -> str:
    """The first line of a table made from synthetic telemetry."""
    return "# synthetic telemetry\n" if data.attrs.get("synthetic") else ""


def synthetic_note(data: Any) -> str:
    """The same at the end of a caption."""
    return synthetic_words(data.attrs.get("synthetic"))


def synthetic_words(synthetic: Any) -> str:
    return " Synthetic telemetry." if synthetic else ""


def vector(values: Iterable[float]) -> str:
    return "[" + ", ".join(f"{value:z.5g}" for value in values) + "]"
