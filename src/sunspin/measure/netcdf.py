"""Reading NetCDF-4 files that somebody may have damaged: one sentence, whatever the libraries below do."""

from __future__ import annotations

import gc
import io
import sys
from pathlib import Path
from typing import Any

import xarray as xr

from sunspin.errors import SunspinError, sentence
from sunspin.outside import Elsewhere, elsewhere

MAX_BYTES = 2_000_000_000
"""Of all variables in memory: a compressed file, or one that is nearly all fill value, may name any size."""

PROBE_S, PROBE_BYTES_PER_S = 4, 20_000_000
"""CPU time (s) that a file may take to be read the first time, and what a larger one may have besides."""

MEND = "it is damaged or not NetCDF-4: write it again"


def read_netcdf(source: Any, where: str, error_type: type[SunspinError]) -> xr.Dataset:
    """A NetCDF-4 file (a path or a binary stream), loaded; `where` names it in messages.

    Files from outside: on damaged ones HDF5 computes for ever or ends the process, its wrappers raise whatever comes, and a
    half-opened file complains on stderr once more when it is thrown away. So it is read in another process first, with
    limits; each of these becomes the one sentence.
    """
    if (trouble := _probed(source)) is not None:
        raise error_type(sentence(f"this NetCDF file cannot be read ({trouble})", do=MEND, where=where))
    hook = sys.unraisablehook
    try:
        with xr.open_dataset(source, engine="h5netcdf", decode_timedelta=False) as data:
            if data.nbytes <= MAX_BYTES:
                return data.load()
            what = sentence(f"the file would take {data.nbytes / 1e9:.3g} GB of memory", do="cut it into parts", where=where)
    except Exception as error:
        sys.unraisablehook = lambda _: None
        what = sentence(f"this NetCDF file cannot be read ({type(error).__name__}: {str(error)[:200]})", do=MEND, where=where)
    gc.collect()  # closes what was half opened, while nobody listens
    sys.unraisablehook = hook
    raise error_type(what)


def _probed(source: Any) -> str | None:
    """What went wrong when another process read the file, or None."""
    if not sys.executable:
        return None
    stream = isinstance(source, io.BytesIO)
    content = source.getvalue() if stream else None
    try:
        size = len(content) if content is not None else Path(source).stat().st_size
    except OSError as error:
        return error.strerror or str(error)
    script = Path(__file__).with_name("netcdf_probe.py")
    try:
        elsewhere(script, "-" if stream else str(source), content=content or b"", seconds=PROBE_S + size // PROBE_BYTES_PER_S)
    except Elsewhere as error:
        return str(error)
    return None
