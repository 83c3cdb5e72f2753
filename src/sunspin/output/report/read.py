"""Reading of a results folder for its page: files that were changed or damaged are named and left out.

The hashes in the manifest reveal damage and accidental changes. They do not protect against forgery, because a sender can write any
manifest.
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
from sunspin.output.folder import MARKER, read_command, read_manifest, verify_file
from sunspin.vehicle import Vehicle
from sunspin.vehicle.file import read_vehicle
from sunspin.vehicle.timeline import Timeline, parse_timeline

MAX_DATA_BYTES = 500_000_000
"""Size of a NetCDF file above which it is named and not read."""

MAX_ROWS = 200
"""Number of rows of a table that the page shows."""


class PageTable(NamedTuple):
    """A table as text: `title`, `head` (headings), `rows`, the `file` with the whole table, `left` (number of omitted rows)."""

    title: str
    head: list[str]
    rows: list[list[str]]
    file: str = ""
    left: int = 0


class PageFigure(NamedTuple):
    """A figure: `name` and `content` of its SVG or PNG file, `alt` (what it shows, in words), `caption`."""

    name: str
    content: bytes
    alt: str
    caption: str


@dataclass
class Results:
    """The contents of a results folder, for its page.

    Attributes
    ----------
    command : which `sunspin` command wrote the folder
    summary : its `summary.json`
    data : name of file and group -> Dataset, in the order of the manifest
    figures, tables : as the page shows them
    vehicle, timeline : None if the folder has none
    problems : sentences on parts that could not be read or shown
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

    def with_variables(self, *names: str) -> Iterator[tuple[str, xr.Dataset]]:
        """Yield name and Dataset of the data that hold all these variables."""
        for file, data in self.data.items():
            if all(name in data.variables for name in names):
                yield file, data

    def first_with(self, *names: str) -> xr.Dataset | None:
        """Return the first Dataset, in the order of the manifest, that holds all these variables, or None."""
        return next((data for _, data in self.with_variables(*names)), None)

    @property
    def synthetic(self) -> bool:
        """Return whether the summary or a file says that the telemetry is synthetic."""
        marks = [data.attrs.get("synthetic") for data in self.data.values()]
        return bool(self.summary.get("synthetic_telemetry")) or any(mark == 1 for mark in marks)

    def attempt(self, what: str, read: Callable[[], Any]) -> Any:
        """Return what `read` returns; if it fails, add a sentence on `what` to `problems` and return None.

        The page is then made without this part.
        """
        try:
            return read()
        except Exception as error:  # files from anywhere may raise anything
            kind = "" if isinstance(error, SunspinError) else f"{type(error).__name__}: "
            why = f"{kind}{error}"
            self.problems.append(f"{printable(what)} could not be read or shown: {printable(why)}")
            return None


def read_results(folder: str | Path) -> Results:
    """Read a folder that a `sunspin` command wrote.

    Raises
    ------
    InputError
        There is no such folder, it is no results folder, or its manifest is missing or damaged.
    """
    path = Path(folder)
    manifest = read_manifest(path)
    results = Results(path, read_command(path / MARKER))

    def read_entry(entry: Any, read: Callable[[Path, Any], Any]) -> Any:
        """Return what `read` makes of the file of a manifest entry, and of the entry; None if it fails."""
        name = entry.get("file") if isinstance(entry, dict) else entry
        what = name[:200] if isinstance(name, str) else "an entry of the manifest"
        return results.attempt(what, lambda: read(verify_file(path, manifest, name), entry))

    # a summary that is no JSON object becomes an error of dict(), and so a problem
    results.summary = (
        read_entry("summary.json", lambda file, _: dict(json.loads(file.read_text("utf-8")))) or {}
    )
    for entry in manifest["data"]:
        results.data |= read_entry(entry, _read_data) or {}
    for entry in manifest["figures"]:
        figure = read_entry(entry, _read_figure)
        results.figures += [] if figure is None else [figure]
    for entry in manifest["tables"]:
        results.tables += read_entry(entry, _read_tables) or []
    if "vehicle.toml" in manifest["sha256"]:
        results.vehicle = read_entry("vehicle.toml", lambda file, _: read_vehicle(file))
    if "timeline.toml" in manifest["sha256"]:
        results.timeline = read_entry(
            "timeline.toml", lambda file, _: parse_timeline(file.read_text("utf-8"), file.name)
        )
    return results


def _read_data(path: Path, _: Any) -> dict[str, xr.Dataset]:
    """Read the groups of a NetCDF file, by name of file and group, each with the attributes of the root added.

    Groups without variables are left out, unless the file has no other.
    """
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


def _read_figure(path: Path, entry: Any) -> PageFigure:
    """Read the file of a figure."""
    alt, caption = (str(entry.get(key, "")) for key in ("alt", "caption"))
    return PageFigure(path.name, path.read_bytes(), alt, caption)


def _read_tables(path: Path, entry: Any) -> list[PageTable]:
    """Read the table of a CSV file; the list is empty if the page shows none of its columns."""
    headings = entry.get("shown")  # columns that the page shows -> their headings
    if not isinstance(headings, dict) or not headings:
        return []
    lines = [line for line in path.read_text("utf-8").splitlines() if not line.startswith("#")]
    rows = csv.reader(io.StringIO("\n".join(lines)))
    names = next(rows)
    columns = [name for name in headings if name in names]
    indices = [names.index(name) for name in columns]
    cells = [[_cell_text(row[index]) for index in indices] for row in islice(rows, MAX_ROWS)]
    omitted = sum(1 for _ in rows)  # the rows after `MAX_ROWS`
    title = str(entry.get("title", ""))
    head = [str(headings[name]) for name in columns]
    return [PageTable(title, head, cells, path.name, omitted)]


def _cell_text(text: str) -> str:
    """Return a cell for the page: a number with four digits; integers and other text unchanged."""
    try:
        return text if text.lstrip("-").isdigit() else f"{float(text):.4g}"
    except ValueError:
        return text
