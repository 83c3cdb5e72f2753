"""Results folders: which command owns one, what it holds, and files that are written completely or not at all."""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sunspin.base import atomic_write
from sunspin.base.cells import plain_cell
from sunspin.base.errors import InputError, OutputError
from sunspin.base.provenance import with_units
from sunspin.base.untrusted import is_file_not_link, read_bytes
from sunspin.output.kind import Drawing, Picture, Table
from sunspin.vehicle.file import read_vehicle_text

MARKER = ".sunspin-results"
"""File that marks a results folder and names the command that made it."""

CITE = (
    "T. Baranyai, A. Balázs and P. L. Várkonyi: Partial reconstruction of the rotational motion of Philae spacecraft during its "
    "landing on comet 67P/Churyumov–Gerasimenko"
)
"""The source of the model."""

MANIFEST = "manifest.json"
"""File that lists data, figures and tables of the folder, with the SHA-256 of each file. A page shows nothing else."""

WITHOUT_RESULTS = ("export", "decode")
"""Commands whose folders hold files for other programs or commands, and no manifest."""

MAX_JSON_BYTES = 20_000_000
"""Largest manifest that is read."""

LARGE_TIME_S = 1e5
"""From so many seconds on, nine digits of a time in a CSV file would show less than 0.1 ms."""

LARGEST_SVG_BYTES = 1_000_000
"""Largest SVG that a page shows; for a larger one it shows the PNG."""


def results_folder(path: Any, command: str) -> Path:
    """Create a results folder of this command, or reuse one, and return its path.

    Raises
    ------
    OutputError
        The folder holds other files or results of another command, or cannot be written.
    """
    folder = Path(path)
    marker, what = folder / MARKER, ""  # `what` is wrong with the folder, empty if nothing is
    try:
        _CLAIMED.append(_Claim.of(folder))  # before the folder is made
        atomic_write.make_folder(folder)
        atomic_write.remove_abandoned(folder)
        if is_file_not_link(marker):
            if (owner := read_command(marker)) != command:
                what = f"the folder holds results of `sunspin {owner}`"
        elif any(folder.iterdir()):
            what = "the folder is not empty and not a results folder"
        if not what:
            write_whole(marker, command + "\n")
    except OSError as error:
        what = f"results cannot be written here ({error.strerror or error})"
    if what:
        raise OutputError(what, do="choose another --out", where=str(folder))
    return folder


class _Claim(NamedTuple):
    """A results folder that this process claimed, and how it was before.

    `missing`: the folder and the folders above it that did not exist, innermost first; `marked`: whether it had a marker.
    """

    folder: Path
    missing: tuple[Path, ...]
    marked: bool

    @classmethod
    def of(cls, folder: Path) -> _Claim:
        """Return the claim on a folder, as it is now."""
        folders = (folder, *folder.parents)
        missing = tuple(path for path in folders if not os.path.lexists(path))
        return cls(folder, missing, os.path.lexists(folder / MARKER))


_CLAIMED: list[_Claim] = []
"""Results folders that the running command claimed."""


def remove_empty_folders() -> None:
    """Remove the claimed folders that the command created and left empty but for the marker: the command failed."""
    while _CLAIMED:
        claim = _CLAIMED.pop()
        with suppress(OSError, ValueError):
            if not claim.marked and {entry.name for entry in claim.folder.iterdir()} == {MARKER}:
                (claim.folder / MARKER).unlink()
            for path in claim.missing:  # rmdir refuses a folder that is not empty
                path.rmdir()


def keep_folders() -> None:
    """Keep the claimed folders, even an empty one, because the command succeeded."""
    _CLAIMED.clear()


def read_command(marker: Path) -> str:
    """Return the command that a folder's marker names.

    The file may come from somebody else, so at most 40 bytes are read, as text of any kind.
    """
    with open(marker, "rb") as file:
        return file.read(40).decode("utf-8", "replace").strip()


def write_whole(target: Path, content: str | bytes | Callable[[Path], Any]) -> Path:
    """Write text, bytes or what a function writes to a path, completely or not at all, and return the path.

    Lone surrogates in text, from file names that are no UTF-8, become escapes. Raises `OutputError` if the file cannot be written.
    """
    if isinstance(content, str):
        content = content.encode("utf-8", "backslashreplace")
    try:
        if callable(content):
            return atomic_write.write_atomically(target, content)
        return atomic_write.write_atomically(target, lambda part: part.write_bytes(content))
    except OSError as error:
        what = f"the file cannot be written ({error.strerror or error}) and nothing that was there is lost"
        do = "free space or choose another --out"
        raise OutputError(what, do=do, where=str(target)) from None


def write_json(target: Path, data: Any) -> Path:
    """Write data as JSON, converted by :func:`to_plain_data`, and return the path; numbers that are not finite become null."""
    text = json.dumps(to_plain_data(data), indent=1, ensure_ascii=False, allow_nan=False)
    return write_whole(target, text + "\n")


def to_plain_data(value: Any) -> Any:
    """Return data as JSON knows it: lists, dicts, text, numbers; numbers that are not finite become None."""
    if isinstance(value, dict):
        return {str(key): to_plain_data(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [to_plain_data(item) for item in value]
    if isinstance(value, np.ndarray):
        return to_plain_data(value.tolist())
    if isinstance(value, np.generic):
        return to_plain_data(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def write_netcdf(target: Path, data: Any) -> Path:
    """Write an xarray Dataset, DataArray or DataTree (each node a group) as NetCDF-4, and return the path.

    The file is made in memory first, because HDF5 ends the process if the disk is full.
    """
    import h5netcdf
    import xarray as xr
    from xarray.backends import H5NetCDFStore

    if isinstance(data, xr.DataTree):
        groups = {node.path: node.to_dataset(inherit=False) for node in data.subtree}
    else:
        groups = {"/": data.to_dataset() if isinstance(data, xr.DataArray) else data}
    buffer = io.BytesIO()
    with h5netcdf.File(buffer, "w") as file:
        for path, dataset in groups.items():
            store = H5NetCDFStore(file, group=path, mode="a")
            with_units(dataset).dump_to_store(store)
            store.sync()
    return write_whole(target, buffer.getvalue())


@dataclass
class Contents:
    """What a results folder holds besides its summary.

    Attributes
    ----------
    data : NetCDF files, name -> Dataset or DataTree
    figures : figures whose files are already in the folder
    tables : tables to write as CSV
    vehicle : name of a built-in vehicle or path of a vehicle file
    telemetry : Dataset of `read_telemetry`
    synthetic : whether the result comes from synthetic telemetry
    """

    data: dict[str, Any] = field(default_factory=dict)
    figures: Sequence[Drawing | Picture] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    vehicle: Any = None
    telemetry: Any = None
    synthetic: bool = False


def _datasets(contents: Contents) -> dict[str, Any]:
    """Return the NetCDF files of a folder by name, the samples among them."""
    samples = {} if contents.telemetry is None else {"telemetry": contents.telemetry}
    return contents.data | samples


def write_data(folder: Path, contents: Contents) -> None:
    """Write data, samples, tables and vehicle file."""
    for name, dataset in _datasets(contents).items():
        write_netcdf(folder / f"{name}.nc", dataset)
    for table in contents.tables:
        write_whole(folder / f"{table.name}.csv", table_text(table, contents.synthetic))
    if contents.vehicle is not None:
        write_whole(folder / "vehicle.toml", read_vehicle_text(contents.vehicle))


def write_manifest(folder: Path, summary: dict[str, Any], contents: Contents) -> None:
    """Write `summary.json` and the manifest that lists all files with their hashes.

    Figures and all other files of the folder must have been written before, so that the manifest has their hashes.

    Parameters
    ----------
    summary : dict
        The summary of the command, with "command", the command line of the run, and "sentences", the summary in words.
    """
    manifest = {
        "data": [f"{name}.nc" for name in _datasets(contents)],
        "figures": [
            {"file": _page_file(folder, figure.name), "alt": figure.alt, "caption": figure.caption}
            for figure in contents.figures
        ],
        "tables": [
            {"file": f"{table.name}.csv", "title": table.title, "shown": dict(table.shown)}
            for table in contents.tables
        ],
    }
    write_json(folder / "summary.json", {"version": metadata.version("sunspin"), **summary})
    try:
        files = [path for path in sorted(folder.iterdir()) if is_file_not_link(path)]
        digests = {path.name: _digest(path) for path in files if path.name != MANIFEST}
    except OSError as error:
        what = f"a file of the results folder cannot be read back ({error.strerror or error})"
        raise OutputError(what, do="choose another --out", where=str(folder)) from None
    write_json(folder / MANIFEST, manifest | {"sha256": digests})


def table_text(table: Table, synthetic: bool) -> str:
    """Return a table as CSV text that `numpy.genfromtxt` and `pandas.read_csv` read: the header first, comments last.

    Texts become plain cells, without commas and quotes, unless they are prose. Numbers have nine digits, and times far from their
    epoch as many as they need for 0.1 ms.
    """
    comments = ["synthetic telemetry"] if synthetic else []
    comments += [table.comment] if table.comment else []
    texts = table.frame.select_dtypes(exclude="number")
    plain_texts = {} if table.prose else {name: texts[name].map(plain_cell) for name in texts}
    long_times = {
        name: column.map(lambda seconds: f"{seconds:.14g}", na_action="ignore")
        for name, column in table.frame.select_dtypes("float").items()
        if str(name).endswith("_s") and (column.abs() >= LARGE_TIME_S).any()
    }
    frame = table.frame.assign(**plain_texts, **long_times)
    text = frame.to_csv(index=False, float_format="%.9g")
    return text + "".join(f"# {comment}\n" for comment in comments)


def _page_file(folder: Path, name: str) -> str:
    """Return the file of a figure that a page shows: the SVG, or the PNG if very many points make the SVG too large."""
    svg = folder / f"{name}.svg"
    return f"{name}.png" if svg.is_file() and svg.stat().st_size > LARGEST_SVG_BYTES else svg.name


def _digest(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read the manifest of a results folder.

    Raises
    ------
    InputError
        There is no such folder, it is no results folder, its run did not end, or its manifest is damaged.
    """
    command = read_command(folder / MARKER) if is_file_not_link(folder / MARKER) else ""
    if not command:
        what = "there is no such folder"
        if folder.is_dir():
            what = f"this is not a results folder of sunspin: it has no file {MARKER}"
        raise InputError(what, do="give a command's --out", where=str(folder))
    do = "run the command again"
    if not is_file_not_link(folder / MANIFEST):
        what = f"the folder has no {MANIFEST}: the run did not end"
        if command in WITHOUT_RESULTS:
            what, do = (
                f"this folder holds files of `sunspin {command}`",
                "give that of another command",
            )
        raise InputError(what, do=do, where=str(folder))
    try:
        content = read_bytes(folder / MANIFEST, MAX_JSON_BYTES, "file", InputError, do)
        manifest = json.loads(content)
        complete = all(isinstance(manifest[key], list) for key in ("data", "figures", "tables"))
        complete &= isinstance(manifest["sha256"], dict)
        if not complete:
            raise ValueError
    except (ValueError, LookupError, TypeError, RecursionError, OSError):
        raise InputError(f"its {MANIFEST} is damaged", do=do, where=str(folder)) from None
    return manifest


def verify_file(folder: Path, manifest: dict[str, Any], name: Any) -> Path:
    """Return the path of a file of a results folder, after a check that it is unchanged since it was written.

    Raises
    ------
    InputError
        The file is missing, a link, or its SHA-256 differs from that in the manifest.
    """
    listed = isinstance(name, str) and Path(name).name == name and name in manifest["sha256"]
    if not listed or not is_file_not_link(folder / name):
        what, do = "this is not a regular file of the folder", "put the file itself there"
        raise InputError(what, do=do, where=str(name)[:200])
    if _digest(folder / name) != manifest["sha256"][name]:
        what = "this file was changed or damaged after sunspin wrote it"
        raise InputError(what, do="run the command again", where=name)
    return folder / name
