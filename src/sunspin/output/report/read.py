"""A results folder, read without trust: what cannot be read is named and left out.

It may come from somebody else, so nothing outside it is read: no link is followed, and sizes are looked at before files are.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError, SunspinError, printable, sentence
from sunspin.base.netcdf import read_elsewhere, read_groups
from sunspin.base.untrusted import is_own, read_bytes
from sunspin.output.folder import MARKER, Picture, maker
from sunspin.vehicle import Vehicle
from sunspin.vehicle.file import read_vehicle
from sunspin.vehicle.timeline import Timeline, parse_timeline

MAX_BYTES = 500_000_000
"""Larger result files are named and not read."""

MAX_TOTAL_BYTES = 2_000_000_000
"""Of all result files in memory."""

MAX_TEXT_BYTES = 20_000_000
"""Of a summary, a list of captions, a timeline."""

MAX_FILES = 500
"""NetCDF files and pictures: the largest of our folders has some sixty."""

MAX_UNREADABLE = 10
"""Damaged NetCDF files that are tried, as each may take seconds."""


@dataclass
class Results:
    """What a folder holds.

    Attributes
    ----------
    command : which `sunspin` command made the folder
    summary : its `summary.json`, empty where there is none
    data : file (and group) -> Dataset, in order of name
    problems : sentences on what could not be read or shown
    used, drawn : files, and figures by name, that the page shows
    """

    folder: Path
    command: str
    summary: dict[str, Any] = field(default_factory=dict)
    data: dict[str, xr.Dataset] = field(default_factory=dict)
    vehicle: Vehicle | None = None
    timeline: Timeline | None = None
    pictures: list[Picture] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    used: set[str] = field(default_factory=set)
    drawn: set[str] = field(default_factory=set)

    def having(self, *names: str) -> Iterator[tuple[str, xr.Dataset]]:
        """Files whose data hold all these variables."""
        for file, data in self.data.items():
            if all(name in data.variables for name in names):
                self.used.add(file)
                yield file, data

    def first(self, *names: str) -> xr.Dataset | None:
        """The first of them."""
        return next((data for _, data in self.having(*names)), None)

    def named(self, prefix: str) -> Iterator[tuple[str, xr.Dataset]]:
        """Files whose name begins so."""
        for file, data in self.data.items():
            if file.startswith(prefix):
                self.used.add(file)
                yield file, data

    def tree(self, stem: str) -> xr.DataTree | None:
        """The groups of a file as they stand in it; None where there is no such file or it has no groups."""
        groups = {name.removeprefix(stem): data for name, data in self.named(f"{stem}/")}
        if not groups:
            return None
        attrs = next(iter(groups.values())).attrs
        return xr.DataTree.from_dict({"/": xr.Dataset(attrs=attrs), **groups})

    def runs(self) -> dict[str, xr.Dataset]:
        """Runs of `sunspin outcomes` by their strategy, what was flown first."""
        found = [
            (str(data.attrs.get("strategy", name)), data)
            for name, data in self.having("rz_share", "omega_after_B")
        ]
        return dict(sorted(found, key=lambda item: item[0] != "off"))

    def row(self, name: str) -> dict[str, Any] | None:
        """The summary's row on this figure of the paper."""
        rows = self.summary.get("figures")
        found = (
            (row for row in rows if isinstance(row, dict) and row.get("id") == name)
            if isinstance(rows, list)
            else iter(())
        )
        return next(found, None)

    @property
    def why_nothing(self) -> str:
        """Why a study concludes nothing on the motion after the first touchdown; empty where it does, or is no study."""
        missing = self.summary.get("missing")
        if not isinstance(missing, dict) or "candidates" not in missing:
            return ""
        told = [str(missing[name]) for name in ("candidates", "level_set") if name in missing]
        reasons = [
            text.split(": not reproduced, as ", 1)[-1]
            for text in told
            if ": not reproduced, as " in text
        ]
        return (reasons or told)[0].rstrip(".")

    @property
    def synthetic(self) -> bool:
        marks = [np.asarray(data.attrs.get("synthetic", False)) for data in self.data.values()]
        return bool(self.summary.get("synthetic_telemetry")) or any(
            bool(mark) for mark in marks if mark.ndim == 0
        )

    @property
    def epoch_utc(self) -> str | None:
        """The epoch of the measured times, else of the timeline."""
        known = [data.attrs.get("epoch_utc") for data in self.data.values()]
        found = [str(epoch) for epoch in known if epoch] + (
            [self.timeline.epoch_utc] if self.timeline else []
        )
        return found[0] if found else None


def read_results(folder: str | Path, ours: bool = False) -> Results:
    """Read a folder that a `sunspin` command wrote; `ours`: this process, just now, so that its files need no probe.

    Raises
    ------
    InputError
        No such folder, or not one of ours.
    """
    path = Path(folder)
    try:
        if not path.is_dir():
            raise InputError(
                sentence(
                    "there is no such folder",
                    do="give the --out of an earlier command",
                    where=str(path),
                )
            )
        marker = path / MARKER
        if not is_own(marker):
            raise InputError(
                sentence(
                    f"this is not a results folder of sunspin: it has no file {MARKER}",
                    do="give the --out of an earlier command",
                    where=str(path),
                )
            )
        command = maker(marker)
        if command in ("coverage", "worth"):
            raise InputError(
                sentence(
                    f"results of `sunspin {command}` are no longer shown, as the command is gone",
                    do="python -m studies.coverage OUT makes the study anew",
                    where=str(path),
                )
            )
        files = sorted(path.iterdir())
    except OSError as error:
        raise InputError(
            sentence(f"the folder cannot be read ({error.strerror or error})", where=str(path))
        ) from None
    found = Results(path, command)
    files = _own_files(found, files)
    found.summary = _json(found, "summary.json", dict)
    _all_netcdf(found, [file for file in files if file.suffix == ".nc"], ours)
    found.vehicle = _toml(found, "vehicle.toml", lambda p: read_vehicle(p))
    found.timeline = _toml(found, "timeline.toml", lambda p: parse_timeline(_text(p), p.name))
    found.pictures = _pictures(found, files)
    return found


def _own_files(found: Results, files: list[Path]) -> list[Path]:
    """The files of the folder that may be read; what has the name of a result and is a link, a folder or a device is named."""
    results = [file for file in files if file.suffix in (".nc", ".png", ".json", ".toml")]
    drawn = [file for file in results if file.suffix in (".nc", ".png")]
    if len(drawn) > MAX_FILES:
        what = f"the folder has more than {MAX_FILES} NetCDF files and pictures, which no command writes"
        raise InputError(
            sentence(
                what,
                got=len(drawn),
                do="move away what sunspin did not write",
                where=str(found.folder),
            )
        )
    own = [file for file in results if is_own(file)]
    strange = [printable(file.name) for file in results if file not in own]
    found.problems += [
        f"{name} is a link or no regular file and was not read."
        for name in strange[:MAX_UNREADABLE]
    ]
    if len(strange) > MAX_UNREADABLE:
        found.problems.append(f"Nor were {len(strange) - MAX_UNREADABLE} more of such.")
    return own


def _text(path: Path) -> str:
    return read_bytes(path, MAX_TEXT_BYTES, "file", InputError, "write it again").decode("utf-8")


def _json(found: Results, name: str, kind: type) -> Any:
    path = found.folder / name
    if not is_own(path):
        return kind()
    try:
        value = json.loads(_text(path))
    except (OSError, ValueError, RecursionError):
        value = None
    if not isinstance(value, kind):
        found.problems.append(f"{name} could not be read, so what it says is missing here.")
        return kind()
    return value


def _toml(found: Results, name: str, read: Any) -> Any:
    path = found.folder / name
    if not is_own(path):
        return None
    try:
        return read(path)
    except (OSError, UnicodeDecodeError, SunspinError) as error:
        found.problems.append(f"{name} could not be read: {error}.")
        return None


def _all_netcdf(found: Results, files: list[Path], ours: bool) -> None:
    """Read them in order of name, until too many were damaged or they fill the memory."""
    unreadable, sound = 0, ours or (len(files) > 1 and read_elsewhere(files))
    for number, file in enumerate(files, 1):
        unreadable += not _netcdf(found, file, sound)
        full = sum(data.nbytes for data in found.data.values()) > MAX_TOTAL_BYTES
        if (full or unreadable == MAX_UNREADABLE) and number < len(files):
            why = (
                f"those before fill {MAX_TOTAL_BYTES / 1e9:g} GB"
                if full
                else f"{unreadable} before could not be read"
            )
            found.problems.append(
                f"{len(files) - number} more NetCDF files were not read, as {why}."
            )
            return


def _netcdf(found: Results, file: Path, sound: bool) -> bool:
    """Read one file, of which it is known or not that it can be; whether that could be done."""
    name = printable(file.name)
    try:
        if file.stat().st_size > MAX_BYTES:
            found.problems.append(
                f"{name} is larger than {MAX_BYTES // 1_000_000} MB and was not read."
            )
            return True
        groups = read_groups(file, file.name, InputError, probe=not sound)
    except (OSError, InputError) as error:
        found.problems.append(f"{name} could not be read: {error}")
        return False
    for path, data in groups.items():
        if data.variables or (path == "/" and len(groups) == 1):
            found.data[file.stem if path == "/" else f"{file.stem}{path}"] = data
    if (
        "/" in groups and len(groups) > 1 and groups["/"].attrs
    ):  # attributes of the whole stand with its first group
        first = next((name for name in found.data if name.startswith(f"{file.stem}/")), None)
        if first is not None:
            found.data[first].attrs = dict(groups["/"].attrs) | found.data[first].attrs
    return True


def _pictures(found: Results, files: list[Path]) -> list[Picture]:
    """Drawn figures, with their captions where figures.json gives them."""
    told = {}
    for entry in _json(found, "figures.json", list):
        if isinstance(entry, dict) and isinstance(entry.get("file"), str):
            told[entry["file"]] = str(entry.get("alt", "")), str(entry.get("caption", ""))
    order = {name: k for k, name in enumerate(told)}
    images = sorted(
        (f for f in files if f.suffix == ".png"),
        key=lambda f: (order.get(f.name, len(order)), f.name),
    )
    return [
        Picture(f, *told.get(f.name, (f"Figure {f.stem.replace('_', ' ')}", f.name)))
        for f in images
    ]
