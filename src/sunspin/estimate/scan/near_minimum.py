"""The near-minimum set of a scan: motions whose distance is close to the smallest, or below a threshold (paper, eq. 14)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.base.netcdf import read_netcdf
from sunspin.base.provenance import provenance
from sunspin.dynamics.batch import Outcome
from sunspin.estimate.scan.lines import fit_lines
from sunspin.estimate.scan.volume import RATES
from sunspin.vehicle.assumptions import TABLES


def near_minimum(emd: xr.DataArray, factor: float = 1.1) -> np.ndarray:
    """Return the grid points (n, 3) in rad/s with `emd` below `factor` times the smallest (paper, eq. 14 with factor 1.1).

    If the smallest is 0, they are the points with 0. Rows whose `outcome` says that they could not be computed are left out.

    Parameters
    ----------
    emd : DataArray over omega_x, omega_y, omega_z
        As returned by `scan`: EMD or E.

    Raises
    ------
    InputError
        The factor is not above 1, or no row could be computed.
    """
    if not factor > 1:
        raise InputError("the factor of the near-minimum set must exceed 1", got=factor)
    # if the smallest is 0, only 0 is below the least positive number
    return below(emd, max(factor * _smallest(emd), np.nextafter(0.0, 1.0)))


def below(emd: xr.DataArray, threshold: float) -> np.ndarray:
    """Return the grid points (n, 3) in rad/s whose EMD or E is below a threshold, without rows that could not be computed."""
    indices = np.nonzero(where_computed(emd).values < threshold)
    rates = [emd[rate].values[i] for rate, i in zip(RATES, indices, strict=True)]
    return np.stack(rates, axis=-1)


def where_computed(volume: xr.DataArray) -> xr.DataArray:
    """Return the EMD or E (n_x, n_y, n_z) of a scan, NaN where a motion could not be computed.

    The EMD of such a motion is that of the part that was computed.
    """
    if "outcome" in volume.coords:
        volume = volume.where(volume["outcome"] == Outcome.FINE)
    return volume.transpose(*RATES)


def _smallest(volume: xr.DataArray) -> float:
    """Return the smallest EMD or E of a scan; raise InputError if no motion could be computed."""
    values = where_computed(volume).values
    if not np.isfinite(values).any():
        raise InputError(
            "no motion of the grid could be computed", do="see its coordinate `outcome`"
        )
    return float(np.nanmin(values))


def with_near_minimum(
    volume: xr.DataArray,
    telemetry: xr.Dataset,
    factor: float,
    threshold: float | None,
    n_lines: int,
    seed: int,
) -> xr.Dataset:
    """Return the scan that `sunspin scan` writes: the volume, its near-minimum set, and straight lines fitted to the set.

    `volume`: an EMD or E over the grid, as returned by `scan`. The set is the variable `near_minimum (near_point, rate_axis)`,
    rad/s: the motions of :func:`near_minimum` with `factor`, or those with a value below `threshold` if that is given. The lines
    are those of :func:`sunspin.fit_lines` with `seed`; there are none if the set has fewer than two points for each line. Raises
    `InputError` if no motion is below the threshold.
    """
    points = near_minimum(volume, factor) if threshold is None else below(volume, threshold)
    if not len(points):
        raise InputError(
            "no motion of the grid comes below --threshold",
            got=threshold,
            do=f"the smallest is {_smallest(volume):.4f}",
        )
    criterion = {"factor": factor} if threshold is None else {"threshold": threshold}
    scan = volume.to_dataset().assign(
        near_minimum=(("near_point", "rate_axis"), points, {"units": "rad s-1"} | criterion)
    )
    if n_lines and len(points) >= 2 * n_lines:
        lines = fit_lines(points, n_lines, seed=seed)
        # The points `n` of the lines are those of the set. Components of directions, which are no rates, share the dimension `axis`
        # of the lines, so it is not `rate_axis`. "override" keeps the attributes of the scan.
        lines = lines.rename({"axis": "line_axis", "n": "near_point"})
        scan = scan.merge(lines, combine_attrs="override")
    of_vehicle = {key: volume.attrs[key] for key in ("vehicle", "changes") if key in volume.attrs}
    return scan.assign_attrs(provenance("scan", telemetry, **of_vehicle, seed=seed))


def stored_vehicle(path: Path) -> dict[str, str]:
    """Return the attributes `vehicle` (name) and `changes` (if there were any) of a stored scan; empty if there is no such file.

    Changes of the assumptions of a study, which are not part of the vehicle, are left out.
    """
    if not path.is_file():
        return {}
    attrs = read_netcdf(path, str(path), InputError).attrs
    of_study = tuple(f"{table}." for table in TABLES)
    lines = str(attrs.get("changes", "")).splitlines()
    changes = "\n".join(line for line in lines if not line.startswith(of_study))
    return {"vehicle": str(attrs.get("vehicle", ""))} | ({"changes": changes} if changes else {})


def stored_near_minimum(path: Path, factor: float) -> np.ndarray:
    """Return the body rates (n, 3), rad/s, within `factor` times the smallest value of a stored scan.

    Raises `InputError` if the file does not exist, is not a scan, or is damaged.
    """
    if not path.is_file():
        raise InputError(
            "there is no such file",
            do="give scan.nc as `sunspin scan --out` writes it",
            where=str(path),
        )
    file = read_netcdf(path, str(path), InputError)
    volume = file.get("emd", file.get("E"))
    if volume is None or set(volume.dims) != set(RATES) or not set(RATES) <= set(volume.coords):
        raise InputError(
            "this is no scan", do="give scan.nc as `sunspin scan` writes it", where=str(path)
        )
    if not all(part.dtype.kind in "biuf" for part in (volume, *volume.coords.values())):
        raise InputError("this scan holds what is no number", do="write it again", where=str(path))
    return near_minimum(volume, factor)
