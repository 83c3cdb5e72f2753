"""Reading NetCDF-4 files that somebody may have damaged: one sentence, whatever the libraries below do."""

from __future__ import annotations

import gc
import sys
from typing import Any

import xarray as xr

from sunspin.errors import SunspinError, sentence

MAX_BYTES = 2_000_000_000
"""Of all variables in memory: a compressed file, or one that is nearly all fill value, may name any size."""


def read_netcdf(source: Any, where: str, error_type: type[SunspinError]) -> xr.Dataset:
    """A NetCDF-4 file (a path or a binary stream), loaded; `where` names it in messages.

    Files from outside: on damaged ones HDF5 and its wrappers raise whatever comes, and a half-opened file complains on stderr
    once more when it is thrown away. Both become the one sentence.
    """
    hook = sys.unraisablehook
    try:
        with xr.open_dataset(source, engine="h5netcdf", decode_timedelta=False) as data:
            if data.nbytes <= MAX_BYTES:
                return data.load()
            what = sentence(f"the file would take {data.nbytes / 1e9:.3g} GB of memory", do="cut it into parts", where=where)
    except Exception as error:
        sys.unraisablehook = lambda _: None
        what = sentence(f"this NetCDF file cannot be read ({type(error).__name__}: {str(error)[:200]})",
                        do="it is damaged or not NetCDF-4: write it again", where=where)  # fmt: skip
    gc.collect()  # closes what was half opened, while nobody listens
    sys.unraisablehook = hook
    raise error_type(what)
