"""A scan together with the motions chosen from it and the lines that they lie on: what `sunspin scan` keeps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.base.netcdf import read_netcdf
from sunspin.base.provenance import provenance
from sunspin.estimate.scan.lines import fit_lines
from sunspin.estimate.scan.volume import below, near_minimum
from sunspin.vehicle.assumptions import TABLES


def with_chosen(
    volume: xr.DataArray,
    telemetry: xr.Dataset,
    factor: float,
    threshold: float | None,
    n_lines: int,
    seed: int,
) -> xr.Dataset:
    """The volume with `near_minimum (near_point, rate_axis)`, rad/s, and the lines of :func:`sunspin.fit_lines` through them.

    Parameters
    ----------
    factor, threshold : float
        Motions within `factor` times the smallest value, or below `threshold` where it is given.
    n_lines, seed : int
        Lines, if there are enough points for so many.

    Raises
    ------
    InputError
        No motion below the threshold.
    """
    points = near_minimum(volume, factor) if threshold is None else below(volume, threshold)
    if not len(points):
        raise InputError(
            "no motion of the grid comes below --threshold",
            got=threshold,
            do=f"the smallest is {float(volume.min()):.4f}",
        )
    by = {"factor": factor} if threshold is None else {"threshold": threshold}
    scan = volume.to_dataset().assign(
        near_minimum=(("near_point", "rate_axis"), points, {"units": "rad s-1"} | by)
    )
    if n_lines and len(points) >= 2 * n_lines:
        lines = fit_lines(points, n_lines, seed=seed).rename(
            {"axis": "line_axis", "n": "near_point"}
        )
        scan = scan.merge(lines, combine_attrs="override")
    of_vehicle = {key: volume.attrs[key] for key in ("vehicle", "changes") if key in volume.attrs}
    return scan.assign_attrs(provenance("scan", telemetry, **of_vehicle, seed=seed))


def stored_vehicle(path: Path) -> dict[str, str]:
    """What a scan in a file says of its vehicle: name, and its changes where there were any; empty where there is no such file."""
    if not path.is_file():
        return {}
    attrs = read_netcdf(path, str(path), InputError).attrs
    rules = tuple(f"{table}." for table in TABLES)
    changes = "\n".join(
        line for line in str(attrs.get("changes", "")).splitlines() if not line.startswith(rules)
    )
    return {"vehicle": str(attrs.get("vehicle", ""))} | ({"changes": changes} if changes else {})


def stored_near_minimum(path: Path, factor: float) -> np.ndarray:
    """Body rates (n, 3), rad/s, within `factor` times the smallest value of a scan in a file.

    Raises
    ------
    InputError
        The file is not there, is no scan, or is damaged.
    """
    if not path.is_file():
        raise InputError(
            "there is no such file",
            do="give scan.nc as `sunspin scan --out` writes it",
            where=str(path),
        )
    file = read_netcdf(path, str(path), InputError)
    volume = file.get("emd", file.get("E"))
    if (
        volume is None
        or set(volume.dims) != {"omega_x", "omega_y", "omega_z"}
        or not set(volume.dims) <= set(volume.coords)
    ):
        raise InputError(
            "this is no scan", do="give scan.nc as `sunspin scan` writes it", where=str(path)
        )
    if not all(part.dtype.kind in "biuf" for part in (volume, *volume.coords.values())):
        raise InputError("this scan holds what is no number", do="write it again", where=str(path))
    return near_minimum(volume, factor)
