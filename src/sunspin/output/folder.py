"""Results folders: who may write where, and files that appear whole or not at all."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sunspin.base import atomic_write
from sunspin.base.errors import OutputError, sentence
from sunspin.base.untrusted import is_own
from sunspin.vehicle.file import vehicle_text

MARKER = ".sunspin-results"
"""A file that says that sunspin made the folder, and with which command."""


CITE = (
    "T. Baranyai, A. Balázs and P. L. Várkonyi: Partial reconstruction of the rotational motion of Philae spacecraft during its "
    "landing on comet 67P/Churyumov–Gerasimenko"
)
"""The source of the model."""


class Picture(NamedTuple):
    """A PNG in the results folder, what it shows in words, and its caption."""

    path: Path
    alt: str
    caption: str


def results_folder(path: Any, command: str) -> Path:
    """Create (or take again) a results folder of this command; a folder with anything else in it is refused."""
    folder = Path(path)
    try:
        atomic_write.make_folder(folder)
        marker = folder / MARKER
        if is_own(marker):
            if (made := maker(marker)) != command:
                raise OutputError(
                    sentence(
                        f"the folder holds results of `sunspin {made}`",
                        do="choose another --out",
                        where=str(folder),
                    )
                )
        elif {*folder.iterdir()} - atomic_write.left(folder):
            raise OutputError(
                sentence(
                    "the folder is not empty and not a results folder",
                    do="choose another --out",
                    where=str(folder),
                )
            )
        atomic_write.sweep(folder)
        write_whole(marker, lambda part: part.write_text(command + "\n", "utf-8"))
    except OSError as error:
        raise OutputError(
            sentence(
                f"results cannot be written here ({error.strerror or error})",
                do="choose another --out",
                where=str(folder),
            )
        ) from None
    return folder


def maker(marker: Path) -> str:
    """The command that a folder's marker names: a word, whatever somebody wrote there."""
    with open(marker, "rb") as file:
        return file.read(40).decode("utf-8", "replace").strip()


def write_whole(target: Path, write: Callable[[Path], Any]) -> Path:
    """As :func:`sunspin.base.atomic_write.write_whole`; where the file cannot be written, one sentence."""
    try:
        return atomic_write.write_whole(target, write)
    except OSError as error:
        raise OutputError(
            sentence(
                f"the file cannot be written ({error.strerror or error}) and nothing that was there is lost",
                do="free space or choose another --out",
                where=str(target),
            )
        ) from None


def write_json(target: Path, data: Any) -> Path:
    """Write plain data as JSON; numbers that are not finite become null, half characters of file names escapes."""
    text = json.dumps(plain(data), indent=1, ensure_ascii=False, allow_nan=False)
    return write_whole(
        target, lambda part: part.write_bytes((text + "\n").encode("utf-8", "backslashreplace"))
    )


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
            dataset.dump_to_store(store)
            store.sync()
    return write_whole(target, lambda part: part.write_bytes(buffer.getbuffer()))


def write_run(
    folder: Path,
    summary: dict[str, Any],
    vehicle: Any = None,
    telemetry: Any = None,
    pictures: Sequence[Picture] = (),
) -> None:
    """Write what a report of the run needs beside its results: `summary.json`, the vehicle's file, the samples, the captions.

    Parameters
    ----------
    summary : dict
        Of the command, with "command", the line that repeats the run.
    vehicle : name of a built-in vehicle or path of a vehicle file
    telemetry : Dataset of `read_telemetry`
    """
    if vehicle is not None:
        text = vehicle_text(vehicle)
        write_whole(folder / "vehicle.toml", lambda part: part.write_text(text, "utf-8"))
    if telemetry is not None:
        write_netcdf(folder / "telemetry.nc", telemetry)
    if pictures:
        write_json(
            folder / "figures.json",
            [{"file": p.path.name, "alt": p.alt, "caption": p.caption} for p in pictures],
        )
    write_json(folder / "summary.json", {"version": metadata.version("sunspin"), **summary})
