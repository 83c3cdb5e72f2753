"""A results folder read back: its manifest says what is in it; what is not as it was written is named and left out.

The hashes of the manifest show damage and changes by mistake. They are no seal: who sends a folder has written its manifest.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import xarray as xr

from sunspin.base.errors import InputError, SunspinError, printable
from sunspin.base.netcdf import read_groups
from sunspin.output.folder import MARKER, as_written, maker, read_manifest
from sunspin.vehicle import Vehicle
from sunspin.vehicle.file import read_vehicle
from sunspin.vehicle.timeline import Timeline, parse_timeline

MAX_DATA_BYTES = 500_000_000
"""Of one NetCDF file; larger ones are named and not read."""

MAX_ROWS = 200
"""Rows of a table that the page shows."""


class PageTable(NamedTuple):
    """A table as text: title, headings, rows, the file it is from, how many rows are left out."""

    title: str
    head: list[str]
    rows: list[list[str]]
    file: str = ""
    left: int = 0


class PageFigure(NamedTuple):
    """A figure as the bytes of an SVG or PNG file, what it shows in words, its caption."""

    name: str
    content: bytes
    alt: str
    caption: str


@dataclass
class Results:
    """What a folder holds.

    Attributes
    ----------
    command : which `sunspin` command wrote the folder
    summary : its `summary.json`
    data : file (and group) -> Dataset, in the manifest's order
    problems : sentences on what could not be read or shown
    """

    folder: Path
    command: str
    summary: dict[str, Any] = field(default_factory=dict)
    data: dict[str, xr.Dataset] = field(default_factory=dict)
    figures: list[PageFigure] = field(default_factory=list)
    tables: list[PageTable] = field(default_factory=list)
    vehicle: Vehicle | None = None
    timeline: Timeline | None = None
    problems: list[str] = field(default_factory=list)

    def having(self, *names: str) -> Iterator[tuple[str, xr.Dataset]]:
        """The data that hold all these variables."""
        for file, data in self.data.items():
            if all(name in data.variables for name in names):
                yield file, data

    def first(self, *names: str) -> xr.Dataset | None:
        """The first of them."""
        return next((data for _, data in self.having(*names)), None)

    @property
    def synthetic(self) -> bool:
        marks = [data.attrs.get("synthetic") for data in self.data.values()]
        return bool(self.summary.get("synthetic_telemetry")) or any(mark == 1 for mark in marks)

    def attempt(self, what: str, read: Callable[[], Any]) -> Any:
        """What `read` returns, or None and a sentence in `problems`: a page without one part is worth more than no page."""
        try:
            return read()
        except Exception as error:  # data of any origin
            kind = "" if isinstance(error, SunspinError) else f"{type(error).__name__}: "
            why = f"{kind}{error}"
            self.problems.append(f"{printable(what)} could not be read or shown: {printable(why)}")
            return None


def read_results(folder: str | Path) -> Results:
    """Read a folder that a `sunspin` command wrote.

    Raises
    ------
    InputError
        No such folder, not one of ours, or of a version that wrote no manifest or had other names.
    """
    path = Path(folder)
    manifest = read_manifest(path)
    results = Results(path, maker(path / MARKER))

    def attempt(entry: Any, read: Callable[[Path, Any], Any]) -> Any:
        """What `read` makes of a file of the manifest and of its entry there."""
        name = entry.get("file") if isinstance(entry, dict) else entry
        called = name[:200] if isinstance(name, str) else "an entry of the manifest"
        return results.attempt(called, lambda: read(as_written(path, manifest, name), entry))

    # a value that is no object becomes an error of dict()
    results.summary = (
        attempt("summary.json", lambda file, _: dict(json.loads(file.read_text("utf-8")))) or {}
    )
    for entry in manifest["data"]:
        results.data |= attempt(entry, _data) or {}
    for entry in manifest["figures"]:
        figure = attempt(entry, _figure)
        results.figures += [] if figure is None else [figure]
    for entry in manifest["tables"]:
        results.tables += attempt(entry, _tables) or []
    if "vehicle.toml" in manifest["sha256"]:
        results.vehicle = attempt("vehicle.toml", lambda file, _: read_vehicle(file))
    if "timeline.toml" in manifest["sha256"]:
        results.timeline = attempt(
            "timeline.toml", lambda file, _: parse_timeline(file.read_text("utf-8"), file.name)
        )
    return results


def _data(path: Path, _: Any) -> dict[str, xr.Dataset]:
    """The groups of a NetCDF file, each with the attributes of its root."""
    if path.stat().st_size > MAX_DATA_BYTES:
        size = f"{MAX_DATA_BYTES / 1e6:.0f} MB"
        raise InputError(f"the file is larger than {size}", do="look into it with xarray")
    groups = read_groups(path, path.name, InputError, probe=False)
    root = dict(groups["/"].attrs) if "/" in groups else {}
    return {
        path.stem if name == "/" else f"{path.stem}{name}": data.assign_attrs(root | data.attrs)
        for name, data in groups.items()
        if data.variables or len(groups) == 1
    }


def _figure(path: Path, entry: Any) -> PageFigure:
    alt, caption = (str(entry.get(key, "")) for key in ("alt", "caption"))
    return PageFigure(path.name, path.read_bytes(), alt, caption)


def _tables(path: Path, entry: Any) -> list[PageTable]:
    """The table of a CSV file, if the page shows columns of it."""
    shown = entry.get("shown")
    if not isinstance(shown, dict) or not shown:
        return []
    lines = [line for line in path.read_text("utf-8").splitlines() if not line.startswith("#")]
    rows = csv.reader(io.StringIO("\n".join(lines)))
    head = next(rows)
    places = [(head.index(name), str(heading)) for name, heading in shown.items() if name in head]
    cells = [[_cell(row[place]) for place, _ in places] for row in islice(rows, MAX_ROWS)]
    left = sum(1 for _ in rows)
    title = str(entry.get("title", ""))
    return [PageTable(title, [text for _, text in places], cells, path.name, left)]


def _cell(text: str) -> str:
    """A number with four digits; other text as it is."""
    try:
        return text if text.lstrip("-").isdigit() else f"{float(text):.4g}"
    except ValueError:
        return text
