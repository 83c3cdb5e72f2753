"""Reading of NetCDF-4 files that may be damaged, with one kind of error for all failures.

On some damaged files HDF5 never returns, its wrappers raise arbitrary exceptions, and a half-opened file prints to stderr when it
is collected. A file is therefore read in a separate, limited process first, and each failure becomes one error sentence. Without
that process 7 of 2,000 damaged files hang (`validation corrupt --unguarded --only telemetry.nc` and results files).
"""

from __future__ import annotations

import gc
import re
import sys
import warnings
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import xarray as xr

from sunspin.base.errors import SunspinError
from sunspin.base.untrusted import IsolatedRunError, is_nonempty_file, run_isolated

MAX_BYTES = 2_000_000_000
"""Limit for a file, and for its variables in memory: a compressed or mostly empty variable may state any size."""

PROBE_S, PROBE_BYTES_PER_S = 4, 20_000_000
"""CPU time (s) allowed for the first reading of a file, and the file size (bytes) that allows one more second."""

REPAIR = "it is damaged or not NetCDF-4: write it again"
"""Advice in the errors about damaged files."""


def read_netcdf(path: Path, where: str, error_type: type[SunspinError]) -> xr.Dataset:
    """Read the root group of a NetCDF-4 file into memory; `where` names the file in errors of `error_type`."""
    return read_groups(path, where, error_type, times=True)["/"]


def _read_failure(path: Path) -> str:
    """Return why a separate process cannot read a file, or an empty text if it can."""
    try:
        size = path.stat().st_size
        if not is_nonempty_file(path):
            return "it is empty, or no regular file"
        if size > MAX_BYTES:
            return f"it has more than {MAX_BYTES / 1e9:g} GB"
        if sys.executable:
            script = Path(__file__).with_name("netcdf_probe.py")
            run_isolated(script, str(path), seconds=PROBE_S + size // PROBE_BYTES_PER_S)
    except (OSError, IsolatedRunError) as error:
        return getattr(error, "strerror", None) or str(error)
    return ""


def read_groups(
    path: Path, where: str, error_type: type[SunspinError], probe: bool = True, times: bool = False
) -> dict[str, xr.Dataset]:
    """Read all groups of a NetCDF-4 file into memory and return them by their paths.

    `where` names the file in errors of `error_type`. `probe`: read it in a separate process first; False for a file that this
    program wrote or has already probed. `times`: convert variables with units such as "s since ..." to dates.
    """
    failure = _read_failure(path) if probe else ""
    if failure:
        raise error_type(f"this NetCDF file cannot be read ({failure})", do=REPAIR, where=where)
    hook = sys.unraisablehook
    try:
        # xarray warns of attributes that it does not know
        with warnings.catch_warnings(action="ignore"), ExitStack() as stack:
            options: Any = {"engine": "h5netcdf", "decode_times": times, "decode_timedelta": False}
            groups = xr.open_groups(path, **options)
            for data in groups.values():
                stack.callback(data.close)
            size = sum(data.nbytes for data in groups.values())
            if size > MAX_BYTES:
                what = f"the file would take {size / 1e9:.3g} GB of memory"
                raise error_type(what, do="cut it into parts", where=where)
            # lone surrogates stand for bytes that are no UTF-8 text; they could not be printed or written again
            for data in groups.values():
                attributes = [data.attrs, *(variable.attrs for variable in data.variables.values())]
                names_and_values = [
                    each for attrs in attributes for pair in attrs.items() for each in pair
                ]
                all_texts = " ".join(map(str, (*data.variables, *data.dims, *names_and_values)))
                if re.search("[\ud800-\udfff]", all_texts):
                    what = "a name or an attribute in it is not UTF-8 text"
                    raise error_type(what, do=REPAIR, where=where)
            # the encoding (packing, compression) of a file from outside must not be used for files written from it
            return {name: data.load().drop_encoding() for name, data in groups.items()}
    except SunspinError:
        raise
    except Exception as error:
        # half-opened files print to stderr when they are collected: collect them now, without output
        sys.unraisablehook = lambda _: None
        failure = f"{type(error).__name__}: {str(error)[:200]}"
    gc.collect()
    sys.unraisablehook = hook
    raise error_type(f"this NetCDF file cannot be read ({failure})", do=REPAIR, where=where)
