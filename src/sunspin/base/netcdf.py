"""Reading NetCDF-4 files that somebody may have damaged: one sentence, whatever the libraries below do."""

from __future__ import annotations

import gc
import io
import re
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import xarray as xr

from sunspin.base.errors import SunspinError
from sunspin.base.provenance import changed_attribute, is_ours
from sunspin.base.untrusted import Elsewhere, elsewhere, is_plain

MAX_BYTES = 2_000_000_000
"""Of all variables in memory: a compressed file, or one that is nearly all fill value, may name any size."""

PROBE_S, PROBE_BYTES_PER_S = 4, 20_000_000
"""CPU time (s) that a file may take to be read the first time, and what a larger one may have besides."""

SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""How a NetCDF-4 file begins."""

MEND = "it is damaged or not NetCDF-4: write it again"


def read_netcdf(source: Any, where: str, error_type: type[SunspinError]) -> xr.Dataset:
    """A NetCDF-4 file (a path or a binary stream), loaded; `where` names it in messages.

    HDF5 computes for ever on some damaged files, its wrappers raise whatever comes, and a half-opened file complains on stderr
    once more when it is thrown away. So it is read in another process first, with limits; each of these becomes the one sentence.
    Without that process 7 of 2,000 damaged files hang (`validation corrupt --unguarded --only telemetry.nc`, `trajectory.nc`).
    """
    return _guarded(source, where, error_type, lambda: _one(source), probe=True)


def read_elsewhere(paths: Sequence[Path]) -> bool:
    """Whether another process reads all of these files well: one start for many. Where not, each is to be read alone."""
    try:
        size = sum(path.stat().st_size for path in paths)
        if size > MAX_BYTES or not all(
            is_plain(path) and _first_bytes(path) == SIGNATURE for path in paths
        ):
            return False
        _in_another_process(*map(str, paths), size=size)
    except (OSError, Elsewhere):
        return False
    return True


def read_groups(
    path: Path, where: str, error_type: type[SunspinError], probe: bool = True
) -> dict[str, xr.Dataset]:
    """The groups of a NetCDF-4 file by their paths, times undecoded; `probe` false for a file that this program wrote or that
    another process has read."""
    return _guarded(path, where, error_type, lambda: _tree(path), probe)


class _Refused(Exception):
    """What is wrong with a file that can be read, and what to do."""


def _one(source: Any) -> xr.Dataset:
    with xr.open_dataset(source, engine="h5netcdf", decode_timedelta=False) as data:
        return _loaded(data, data.nbytes, is_ours(data.attrs))


def _tree(path: Path) -> dict[str, xr.Dataset]:
    with xr.open_datatree(path, engine="h5netcdf", decode_times=False) as tree:
        groups = {node.path: node.to_dataset(inherit=False) for node in tree.subtree}
        size = sum(data.nbytes for data in groups.values())
        ours = is_ours(tree.attrs) or any(is_ours(data.attrs) for data in groups.values())
        return {name: _loaded(data, size, ours) for name, data in groups.items()}


def _loaded(data: xr.Dataset, size: int, ours: bool) -> xr.Dataset:
    if size > MAX_BYTES:
        raise _Refused(f"the file would take {size / 1e9:.3g} GB of memory", "cut it into parts")
    about = [data.attrs, *(variable.attrs for variable in data.variables.values())]
    texts = [str(text) for attrs in about for pair in attrs.items() for text in pair]
    if re.search("[\ud800-\udfff]", " ".join(map(str, (*data.variables, *data.dims, *texts)))):
        raise _Refused("a name or an attribute in it is not UTF-8 text", MEND)
    if ours and (changed := changed_attribute(data.attrs, data.variables)):
        raise _Refused(
            f"this file was changed after sunspin wrote it: {changed}",
            "make it again, or mend the attribute",
        )
    return (
        data.load().drop_encoding()
    )  # how a file from outside was packed is no rule for the files that are written from it


def _guarded(
    source: Any, where: str, error_type: type[SunspinError], read: Any, probe: bool
) -> Any:
    if probe and (trouble := _probed(source)) is not None:
        what = f"this NetCDF file cannot be read ({trouble})"
        raise error_type(what, do=MEND, where=where)
    hook = sys.unraisablehook
    try:
        with warnings.catch_warnings(action="ignore"):  # of attributes that mean nothing to xarray
            return read()
    except _Refused as error:
        what, do = error.args
    except Exception as error:
        sys.unraisablehook = lambda _: None
        cause = f"{type(error).__name__}: {str(error)[:200]}"
        what, do = f"this NetCDF file cannot be read ({cause})", MEND
    gc.collect()  # closes what was half opened, while nobody listens
    sys.unraisablehook = hook
    raise error_type(what, do=do, where=where)


def _first_bytes(path: Any) -> bytes:
    with open(path, "rb") as file:
        return file.read(len(SIGNATURE))


def _probed(source: Any) -> str | None:
    """What went wrong when another process read the file, or None."""
    stream = isinstance(source, io.BytesIO)
    content = source.getvalue() if stream else None
    try:
        size = len(content) if content is not None else Path(source).stat().st_size
        if not size or (content is None and not is_plain(Path(source))):
            return "it is empty, or no regular file"
        begins = content if content is not None else _first_bytes(source)
    except OSError as error:
        return error.strerror or str(error)
    if not begins.startswith(SIGNATURE):
        return "it does not begin as one"
    try:
        _in_another_process("-" if stream else str(source), content=content or b"", size=size)
    except Elsewhere as error:
        return str(error)
    return None


def _in_another_process(*paths: str, size: int, content: bytes = b"") -> None:
    if sys.executable:
        script = Path(__file__).with_name("netcdf_probe.py")
        elsewhere(script, *paths, content=content, seconds=PROBE_S + size // PROBE_BYTES_PER_S)
