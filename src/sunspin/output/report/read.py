"""A results folder, read without trust: its manifest says what is in it, and what cannot be read is named and left out.

The folder may come from somebody else, so nothing outside it is read: no link is followed, and sizes are checked before files
are opened.
"""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import xarray as xr

from sunspin.base.errors import InputError, SunspinError, printable
from sunspin.base.netcdf import read_groups, trouble
from sunspin.base.untrusted import is_own, read_bytes
from sunspin.output.folder import MANIFEST, MARKER, maker
from sunspin.output.kind import refuse_former
from sunspin.vehicle import Vehicle
from sunspin.vehicle.file import read_vehicle
from sunspin.vehicle.timeline import Timeline, parse_timeline

MAX_DATA_BYTES = 500_000_000
"""Of one NetCDF file; larger ones are named and not read."""

MAX_TOTAL_BYTES = 2_000_000_000
"""Of all data in memory."""

MAX_DAMAGED = 10
"""NetCDF files that cannot be read, after which no more are tried: each may take seconds."""

MAX_TEXT_BYTES = 20_000_000
"""Of a summary, a table, a picture."""

MAX_FILES = 200
"""Entries of each list of the manifest: the largest of our folders has some sixty."""

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


def read_results(folder: str | Path, own: bool = False) -> Results:
    """Read a folder that a `sunspin` command wrote; `own`: this process did just now, so that its data need no trial.

    Raises
    ------
    InputError
        No such folder, not one of ours, or of a version that wrote no manifest or had other names.
    """
    path = Path(folder)
    command = maker(path / MARKER) if path.is_dir() and is_own(path / MARKER) else ""
    what, do = "", "give the --out of an earlier command"
    if not path.is_dir():
        what = "there is no such folder"
    elif not is_own(path / MARKER):
        what = f"this is not a results folder of sunspin: it has no file {MARKER}"
    elif command in ("coverage", "worth"):
        what = f"results of `sunspin {command}` are no longer shown, as the command is gone"
        do = "python -m studies.coverage OUT repeats the study"
    elif not is_own(path / MANIFEST):
        what = f"the folder has no {MANIFEST}: an earlier version wrote it, or the run did not end"
        do = "run the command again"
    if what:
        raise InputError(what, do=do, where=str(path))
    results = Results(path, command)
    manifest = results.attempt(MANIFEST, lambda: _object(path / MANIFEST)) or {}
    results.summary = results.attempt("summary.json", lambda: _object(path / "summary.json")) or {}
    damaged, entries = 0, _entries(results, manifest, "data")
    files = [path / entry for entry in entries if isinstance(entry, str) and is_own(path / entry)]
    tried = own or not trouble(*files)  # one trial for all; where it fails, one for each
    for entry in entries:
        read = results.attempt(
            _name(entry), lambda entry=entry: _data(results, _own(path, entry), tried)
        )
        damaged += read is None
        size = sum(data.nbytes for data in results.data.values())
        if damaged == MAX_DAMAGED or size > MAX_TOTAL_BYTES:
            results.problems.append(f"Data listed after {_name(entry)} were not read.")
            break
    for data in results.data.values():
        refuse_former(data.attrs.get("kind"), (*data.variables, *data.dims), str(path))
    for entry in _entries(results, manifest, "figures"):
        figure = results.attempt(_name(entry), lambda entry=entry: _figure(path, entry))
        results.figures += [] if figure is None else [figure]
    for entry in _entries(results, manifest, "tables"):
        tables = results.attempt(_name(entry), lambda entry=entry: list(_table(path, entry)))
        results.tables += tables or []
    craft, line = "vehicle.toml", "timeline.toml"
    if os.path.lexists(path / craft):
        results.vehicle = results.attempt(craft, lambda: read_vehicle(_own(path, craft)))
    if os.path.lexists(path / line):
        timeline = results.attempt(line, lambda: parse_timeline(_text(_own(path, line)), line))
        results.timeline = timeline
    return results


def _entries(results: Results, manifest: dict[str, Any], key: str) -> list[Any]:
    entries = manifest.get(key, [])
    if not isinstance(entries, list):
        results.problems.append(f"{MANIFEST}: {key} is no list.")
        return []
    if len(entries) > MAX_FILES:
        what = f"{MANIFEST} lists more than {MAX_FILES} {key}"
        results.problems.append(f"{what}; the rest is left out.")
    return entries[:MAX_FILES]


def _name(entry: Any) -> str:
    name = entry.get("file") if isinstance(entry, dict) else entry
    return name[:200] if isinstance(name, str) else f"an entry of {MANIFEST}"


def _own(folder: Path, name: Any) -> Path:
    """The file of this name in the folder itself: no path, no link, no device."""
    if not isinstance(name, str) or Path(name).name != name or not is_own(folder / name):
        what, do = "this is not a regular file of the folder", "put the file itself there"
        raise InputError(what, do=do, where=str(name)[:200])
    return folder / name


def _text(path: Path) -> str:
    content = read_bytes(path, MAX_TEXT_BYTES, "file", InputError, "run the command again")
    return content.decode("utf-8")


def _object(path: Path) -> dict[str, Any]:
    value = json.loads(_text(_own(path.parent, path.name)))
    if not isinstance(value, dict):
        raise InputError("this is no JSON object", do="run the command again", where=path.name)
    return value


def _data(results: Results, path: Path, tried: bool) -> bool:
    if path.stat().st_size > MAX_DATA_BYTES:
        size = f"{MAX_DATA_BYTES / 1e6:.0f} MB"
        raise InputError(f"the file is larger than {size}", do="look into it with xarray")
    groups = read_groups(path, path.name, InputError, probe=not tried)
    root = dict(groups["/"].attrs) if "/" in groups else {}
    for name, data in groups.items():
        if data.variables or len(groups) == 1:
            data.attrs = root | data.attrs
            results.data[path.stem if name == "/" else f"{path.stem}{name}"] = data
    return True


def _figure(folder: Path, entry: Any) -> PageFigure:
    path = _own(folder, entry["file"])
    smaller = path.with_suffix(".png")
    if path.suffix == ".svg" and path.stat().st_size > 1_000_000 and is_own(smaller):
        path = smaller  # very many points
    content = read_bytes(path, MAX_TEXT_BYTES, "figure", InputError, "run the command again")
    return PageFigure(path.name, content, str(entry.get("alt", "")), str(entry.get("caption", "")))


def _table(folder: Path, entry: Any) -> Iterator[PageTable]:
    shown = entry.get("shown")
    if not isinstance(shown, dict) or not shown:
        return
    path = _own(folder, entry["file"])
    lines = [line for line in _text(path).splitlines() if not line.startswith("#")]
    rows = csv.reader(io.StringIO("\n".join(lines)))
    head = next(rows)
    places = [(head.index(name), str(heading)) for name, heading in shown.items() if name in head]
    cells = [[_cell(row[place]) for place, _ in places] for row in islice(rows, MAX_ROWS)]
    left = sum(1 for _ in rows)
    head = [text for _, text in places]
    yield PageTable(str(entry.get("title", "")), head, cells, path.name, left)


def _cell(text: str) -> str:
    """A number with four digits; other text as it is."""
    try:
        return text if text.lstrip("-").isdigit() else f"{float(text):.4g}"
    except ValueError:
        return text
