"""Scans of rate space and the lines in them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr

from sunspin.estimate.scan.volume import near_minimum
from sunspin.output.kind import Context, Drawing, Summary, Table, synthetic_note, vector
from sunspin.output.text import counted, rate_text

DIMS = ("omega_x", "omega_y", "omega_z")
DEFAULT_FACTOR = 1.1


def misfit(scan: Any) -> xr.DataArray:
    """The volume of E or EMD over the three rates, of a scan as returned or as stored."""
    volume = scan if isinstance(scan, xr.DataArray) else scan["emd" if "emd" in scan else "E"]
    return volume.transpose(*DIMS)


def chosen(scan: Any) -> tuple[np.ndarray, dict[str, float]]:
    """The motions (n, 3) near the smallest misfit, and the factor or threshold by which they were chosen."""
    if isinstance(scan, xr.Dataset) and "near_minimum" in scan:
        said = scan["near_minimum"].attrs
        return scan["near_minimum"].values, {
            key: float(said[key]) for key in ("factor", "threshold") if key in said
        }
    return near_minimum(misfit(scan), DEFAULT_FACTOR), {"factor": DEFAULT_FACTOR}


def scan_summary(scan: Any) -> Summary:
    """The smallest misfit, where it is, how many motions come near it, the lines fitted to them."""
    volume, (points, by) = misfit(scan), chosen(scan)
    values = [
        volume.sel(dict(zip(DIMS, p.tolist(), strict=True)), method="nearest").item()
        for p in points
    ]
    best = points[np.argmin(values)].tolist()
    numbers: dict[str, Any] = {
        "metric": str(volume.name),
        "rows": int(volume.size),
        "minimum": float(volume.min()),
        "best_omega_B": best,
        "near_minimum_points": len(points),
    }
    against = (
        f" against {volume.attrs['directions']} directions" if "directions" in volume.attrs else ""
    )
    near = f"within {by['factor']:g} times it" if "factor" in by else f"below {by['threshold']:g}"
    lines = [
        f"{volume.size} motions{against}: smallest {volume.name} {numbers['minimum']:.4f} at {rate_text(best)}; "
        f"{counted(len(points), 'point')} {near}"
    ]
    if isinstance(scan, xr.Dataset) and "point" in scan:
        told = lines_summary(scan)
        return Summary(numbers | {"lines": told["lines"]}, lines + told.lines)
    return Summary(numbers, lines)


def lines_summary(lines: Any) -> Summary:
    """Points and directions of fitted lines."""
    found: list[dict[str, Any]] = [
        {"point": p.tolist(), "direction": d.tolist(), "points": int(c)}
        for p, d, c in zip(
            lines["point"].values, lines["direction"].values, lines["count"].values, strict=True
        )
    ]
    text = [
        f"  line through {vector(x['point'])} rad/s along {vector(x['direction'])}" for x in found
    ]
    return Summary({"lines": found}, text)


def scan_drawings(scan: Any, _: Context) -> Iterator[Drawing]:
    from sunspin.output.figures.scan import scan_figure

    volume, (points, by) = misfit(scan), chosen(scan)
    metric = "EMD" if volume.name == "emd" else "E"
    near = (
        f"within {by['factor']:g} times the smallest {metric}"
        if "factor" in by
        else f"below {by.get('threshold', np.nan):g}"
    )
    yield Drawing(
        "scan",
        lambda: scan_figure(volume, points),
        f"Smallest {metric} over omega_z for every omega_x and omega_y; circles: the motions that fit nearly as well as the best.",
        f"The smallest {metric} over ωz. Circles: the {counted(len(points), 'motion')} {near}; any may be the true one."
        + synthetic_note(scan),
    )


def scan_tables(scan: Any) -> Iterator[Table]:
    """The lines fitted to the near-minimum set, if any."""
    import pandas as pd

    if "point" not in scan or "direction" not in scan:
        return
    columns: dict[str, Any] = {"points": scan["count"].values}
    for name in ("point", "direction"):
        unit = "_rad_s" if name == "point" else ""
        columns |= {f"{name}_{a}{unit}": scan[name].values[:, k] for k, a in enumerate("xyz")}
    shown = {name: name.replace("_rad_s", " (rad/s)").replace("_", " ") for name in columns}
    yield Table("lines", pd.DataFrame(columns), "Lines fitted to the near-minimum set", shown)
