"""Results folders: who may write where, and files that appear whole or not at all."""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Callable
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
from sunspin.output.kind import Drawing, Table
from sunspin.vehicle.file import read_vehicle_text

MARKER = ".sunspin-results"
"""A file that says that sunspin made the folder, and with which command."""

CITE = (
    "T. Baranyai, A. Balázs and P. L. Várkonyi: Partial reconstruction of the rotational motion of Philae spacecraft during its "
    "landing on comet 67P/Churyumov–Gerasimenko"
)
"""The source of the model."""

MANIFEST = "manifest.json"
"""The list of the folder's data, figures and tables, of which a page shows these and nothing else; and the SHA-256 of each file."""

MAX_JSON_BYTES, LARGEST_SVG_BYTES = 20_000_000, 1_000_000


def results_folder(path: Any, command: str) -> Path:
    """Create (or take again) a results folder of this command; a folder with anything else in it is refused."""
    folder = Path(path)
    marker, what = folder / MARKER, ""
    try:
        _CLAIMED.append(_Claim.of(folder))
        atomic_write.make_folder(folder)
        atomic_write.remove_abandoned(folder)
        if is_file_not_link(marker):
            if (owner := maker(marker)) != command:
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
    """A results folder that this process asked for: `missing`, it and the folders above it that did not exist, innermost first;
    `marked`, whether it had a marker."""

    folder: Path
    missing: tuple[Path, ...]
    marked: bool

    @classmethod
    def of(cls, folder: Path) -> _Claim:
        every = (folder, *folder.parents)
        missing = tuple(path for path in every if not os.path.lexists(path))
        return cls(folder, missing, os.path.lexists(folder / MARKER))


_CLAIMED: list[_Claim] = []
"""Results folders that the running command claimed."""


def leave_no_empty_folder() -> None:
    """Remove each claimed folder that did not exist before and holds nothing but the marker: the command was refused."""
    while _CLAIMED:
        claim = _CLAIMED.pop()
        with suppress(OSError, ValueError):
            if not claim.marked and {entry.name for entry in claim.folder.iterdir()} == {MARKER}:
                (claim.folder / MARKER).unlink()
            for path in claim.missing:  # rmdir refuses a folder that is not empty
                path.rmdir()


def keep_folders() -> None:
    """Forget which folders were claimed: the command has ended well."""
    _CLAIMED.clear()


def maker(marker: Path) -> str:
    """The command that a folder's marker names: a word, whatever somebody wrote there."""
    with open(marker, "rb") as file:
        return file.read(40).decode("utf-8", "replace").strip()


def write_whole(target: Path, content: str | bytes | Callable[[Path], Any]) -> Path:
    """Write text (half characters of names become escapes), bytes or what a function writes, as
    :func:`sunspin.base.atomic_write.write_atomically`; where the file cannot be written, one sentence."""
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
    """Write plain data as JSON; numbers that are not finite become null."""
    text = json.dumps(plain(data), indent=1, ensure_ascii=False, allow_nan=False)
    return write_whole(target, text + "\n")


def plain(value: Any) -> Any:
    """Data as JSON knows it: lists, dicts, text, numbers, null."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def write_netcdf(target: Path, data: Any) -> Path:
    """Write an xarray Dataset, DataArray or DataTree (each node a group) as NetCDF-4.

    Made in memory first: where the disk is full, HDF5 fails in ways that end the process.
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
    """What a results folder holds besides its summary: data (name -> dataset), figures that are drawn already, tables."""

    data: dict[str, Any] = field(default_factory=dict)
    figures: list[Drawing] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    vehicle: Any = None
    telemetry: Any = None
    synthetic: bool = False


def write_contents(folder: Path, summary: dict[str, Any], contents: Contents) -> None:
    """Write data, tables, the vehicle's file, the samples, `summary.json` and the manifest that lists them, with the hash of each
    file: figures, and whatever else belongs to the folder, must be there already.

    Parameters
    ----------
    summary : dict
        Of the command, with "command", the line that repeats the run, and "sentences", what it says to a person.
    contents : Contents
        `vehicle`: name of a built-in vehicle or path of a vehicle file; `telemetry`: Dataset of `read_telemetry`.
    """
    data = contents.data | ({} if contents.telemetry is None else {"telemetry": contents.telemetry})
    for name, dataset in data.items():
        write_netcdf(folder / f"{name}.nc", dataset)
    for table in contents.tables:
        write_whole(folder / f"{table.name}.csv", table_text(table, contents.synthetic))
    if contents.vehicle is not None:
        write_whole(folder / "vehicle.toml", read_vehicle_text(contents.vehicle))
    manifest = {
        "data": [f"{name}.nc" for name in data],
        "figures": [
            {"file": _shown(folder, each.name), "alt": each.alt, "caption": each.caption}
            for each in contents.figures
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
    """Return a table as CSV, its header first and comments last, as `numpy.genfromtxt` and `pandas.read_csv` read it."""
    comments = ["synthetic telemetry"] if synthetic else []
    comments += [table.comment] if table.comment else []
    texts = table.frame.select_dtypes(exclude="number")
    plain_texts = {} if table.prose else {name: texts[name].map(plain_cell) for name in texts}
    text = table.frame.assign(**plain_texts).to_csv(index=False, float_format="%.9g")
    return text + "".join(f"# {comment}\n" for comment in comments)


def _shown(folder: Path, name: str) -> str:
    """The file of a drawing that a page shows: SVG, or PNG where very many points make that large."""
    svg = folder / f"{name}.svg"
    return f"{name}.png" if svg.is_file() and svg.stat().st_size > LARGEST_SVG_BYTES else svg.name


def _digest(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a results folder.

    Raises
    ------
    InputError
        No such folder, not one of ours, a run that did not end, or a damaged manifest.
    """
    what, do = "", "run the command again"
    manifest: dict[str, Any] = {}
    command = maker(folder / MARKER) if is_file_not_link(folder / MARKER) else ""
    if not command:
        what = f"this is not a results folder of sunspin: it has no file {MARKER}"
        what, do = what if folder.is_dir() else "there is no such folder", "give a command's --out"
    elif not is_file_not_link(folder / MANIFEST):
        what = f"the folder has no {MANIFEST}: the run did not end"
    else:
        try:
            content = read_bytes(folder / MANIFEST, MAX_JSON_BYTES, "file", InputError, do)
            manifest = json.loads(content)
            complete = all(isinstance(manifest[key], list) for key in ("data", "figures", "tables"))
            complete &= isinstance(manifest["sha256"], dict)
        except (ValueError, LookupError, TypeError, RecursionError, OSError):
            complete = False
        what = "" if complete else f"its {MANIFEST} is damaged"
    if what:
        raise InputError(what, do=do, where=str(folder))
    return manifest


def as_written(folder: Path, manifest: dict[str, Any], name: Any) -> Path:
    """The file of this name in a results folder, if it is as it was written.

    Raises
    ------
    InputError
        It is missing, a link, or not what the manifest's SHA-256 says.
    """
    known = isinstance(name, str) and Path(name).name == name and name in manifest["sha256"]
    if not known or not is_file_not_link(folder / name):
        what, do = "this is not a regular file of the folder", "put the file itself there"
        raise InputError(what, do=do, where=str(name)[:200])
    if _digest(folder / name) != manifest["sha256"][name]:
        what = "this file was changed or damaged after sunspin wrote it"
        raise InputError(what, do="run the command again", where=name)
    return folder / name
