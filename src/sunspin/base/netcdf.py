"""Reading NetCDF-4 files that somebody may have damaged: one sentence, whatever the libraries below do.

HDF5 computes for ever on some damaged files, its wrappers raise whatever comes, and a half-opened file complains on stderr once
more when it is thrown away. So a file is read in another process first, with limits; each of these becomes the one sentence.
Without that process 7 of 2,000 damaged files hang (`validation corrupt --unguarded --only telemetry.nc` and results files).
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
"""Of files, and of all variables in memory: one that is compressed or nearly all fill value may name any size."""

PROBE_S, PROBE_BYTES_PER_S = 4, 20_000_000
"""CPU time (s) that a file may take to be read the first time, and what a larger one may have besides."""

REPAIR = "it is damaged or not NetCDF-4: write it again"


def read_netcdf(path: Path, where: str, error_type: type[SunspinError]) -> xr.Dataset:
    """The root group of a NetCDF-4 file, loaded; `where` names it in messages."""
    return read_groups(path, where, error_type, times=True)["/"]


def _read_failure(path: Path) -> str:
    """What goes wrong when another process reads this file; empty where nothing does."""
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
    """The groups of a NetCDF-4 file by their paths; `times` says whether texts in units such as "s since ..." make dates.

    `probe` is false for a file that this program wrote or that another process has read.
    """
    wrong = _read_failure(path) if probe else ""
    if wrong:
        raise error_type(f"this NetCDF file cannot be read ({wrong})", do=REPAIR, where=where)
    hook = sys.unraisablehook
    try:
        # without warnings of attributes that mean nothing to xarray
        with warnings.catch_warnings(action="ignore"), ExitStack() as stack:
            form: Any = {"engine": "h5netcdf", "decode_times": times, "decode_timedelta": False}
            groups = xr.open_groups(path, **form)
            for data in groups.values():
                stack.callback(data.close)
            size = sum(data.nbytes for data in groups.values())
            if size > MAX_BYTES:
                what = f"the file would take {size / 1e9:.3g} GB of memory"
                raise error_type(what, do="cut it into parts", where=where)
            for data in groups.values():
                about = [data.attrs, *(variable.attrs for variable in data.variables.values())]
                texts = [text for attrs in about for pair in attrs.items() for text in pair]
                every = " ".join(map(str, (*data.variables, *data.dims, *texts)))
                if re.search("[\ud800-\udfff]", every):
                    what = "a name or an attribute in it is not UTF-8 text"
                    raise error_type(what, do=REPAIR, where=where)
            # how a file from outside was packed is no rule for the files that are written from it
            return {name: data.load().drop_encoding() for name, data in groups.items()}
    except SunspinError:
        raise
    except Exception as error:
        sys.unraisablehook = lambda _: None
        wrong = f"{type(error).__name__}: {str(error)[:200]}"
    gc.collect()  # closes what was half opened, while nobody listens
    sys.unraisablehook = hook
    raise error_type(f"this NetCDF file cannot be read ({wrong})", do=REPAIR, where=where)
