"""Results of `sunspin scan`: the misfit over a grid of rates, the near-minimum set, and the lines fitted to it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr

from sunspin.estimate.scan.near_minimum import near_minimum, where_computed
from sunspin.output.figures import COLOURS, axes_grid, styled
from sunspin.output.kind import KINDS, Context, Drawing, Kind, Summary, Table
from sunspin.output.text import count_text, number_text, rate_text

DIMS = ("omega_x", "omega_y", "omega_z")

DEFAULT_FACTOR = 1.1
"""Near-minimum set of a scan without one: misfit below this factor times the smallest."""

SMALLEST_DRAWN = 1e-6
"""Smaller misfits are drawn as this, because colours follow the logarithm."""


def read_misfit(scan: Any) -> xr.DataArray:
    """Return the misfit (E or EMD) over the three rates, of a scan as returned or as stored; NaN if a motion could not be computed.

    The attribute `metric` of the DataArray says which misfit it is: "E" or "EMD".
    """
    volume = scan if isinstance(scan, xr.DataArray) else scan["emd" if "emd" in scan else "E"]
    metric = "EMD" if volume.name == "emd" else "E"
    return where_computed(volume).assign_attrs(scan.attrs, metric=metric)


def read_near_minimum(scan: Any) -> tuple[np.ndarray, str]:
    """Return the near-minimum set (n, 3), initial rates in rad/s, and its criterion in words."""
    if isinstance(scan, xr.Dataset) and "near_minimum" in scan:
        points, criterion = scan["near_minimum"].values, scan["near_minimum"].attrs
    else:
        points = near_minimum(read_misfit(scan), DEFAULT_FACTOR)
        criterion = {"factor": DEFAULT_FACTOR}
    if "factor" in criterion:
        return points, f"within {float(criterion['factor']):g} times the smallest"
    return points, f"below {float(criterion.get('threshold', np.nan)):g}"


def scan_summary(scan: Any) -> Summary:
    """Return the summary of a scan: the smallest misfit and its rate, the size of the near-minimum set, the fitted lines."""
    volume, (points, criterion) = read_misfit(scan), read_near_minimum(scan)
    grid_points = {name: xr.DataArray(points[:, k], dims="point") for k, name in enumerate(DIMS)}
    misfit_of_points = volume.sel(grid_points, method="nearest").values
    numbers: dict[str, Any] = {
        "metric": str(volume.name),
        "rows": int(volume.size),
        "minimum": float(volume.min()),
        "best_omega_B": points[np.argmin(misfit_of_points)].tolist(),
        "near_minimum_points": len(points),
    }
    directions = volume.attrs.get("directions")
    against = f" against {directions} directions" if directions is not None else ""
    best = f"{numbers['minimum']:.4f} at {rate_text(numbers['best_omega_B'])}"
    line = f"{volume.size} motions{against}: smallest {volume.metric} {best}; {count_text(len(points), 'point')} {criterion}"
    if isinstance(scan, xr.Dataset) and "point" in scan:
        fitted_lines = lines_summary(scan)
        return Summary(numbers | fitted_lines, [line, *fitted_lines.lines])
    return Summary(numbers, [line])


def lines_summary(lines: Any) -> Summary:
    """Return the summary of straight lines in rate space that were fitted to a near-minimum set (`estimate.scan.lines.fit_lines`).

    `lines` has the point (line, 3) of each in rad/s, its `direction` (line, 3), and the `count` of points of the set nearest to it.
    """
    columns = (lines[name].values.tolist() for name in ("point", "direction", "count"))
    rows = [
        {"point": point, "direction": direction, "points": int(count)}
        for point, direction, count in zip(*columns, strict=True)
    ]
    texts = [
        f"  line through {rate_text(row['point'])} along {number_text(row['direction'])}"
        for row in rows
    ]
    return Summary({"lines": rows}, texts)


def scan_drawings(scan: Any, _: Context) -> Iterator[Drawing]:
    """Yield the figure of a scan."""
    volume, (points, criterion) = read_misfit(scan), read_near_minimum(scan)
    metric = volume.metric
    yield Drawing(
        "scan",
        lambda: scan_figure(volume, points),
        f"Smallest {metric} over omega_z for every omega_x and omega_y; circles: the motions that fit nearly as well as the best.",
        f"The smallest {metric} over ωz. Circles: the {count_text(len(points), 'motion')} with an {metric} {criterion}; any may be "
        "the true one.",
    )


@styled
def scan_figure(volume: xr.DataArray, points: np.ndarray) -> Any:
    """Draw the smallest misfit over omega_z for each omega_x and omega_y, and the near-minimum set `points` (n, 3), rad/s."""
    figure, axes = axes_grid(7.5, 5.6, title="Scan of initial rates")
    least = volume.min("omega_z").transpose("omega_y", "omega_x").values  # rows: omega_y
    least = np.maximum(least, SMALLEST_DRAWN)
    rate_x, rate_y = (np.degrees(volume[name].values) for name in DIMS[:2])
    # if all misfits are equal, the scale of colours still needs two different ends
    high = max(np.nanmax(least), 1.001 * np.nanmin(least))
    style = {"shading": "nearest", "cmap": "cividis_r", "rasterized": True}
    image = axes.pcolormesh(rate_x, rate_y, least, norm="log", vmax=high, **style)
    figure.colorbar(image, ax=axes, label=f"smallest {volume.metric} over $\\omega_z$")
    label = "motions that fit nearly as well as the best"
    circles = {"ms": 5, "mfc": "none", "mec": COLOURS[1], "mew": 1.2}
    axes.plot(*np.degrees(points[:, :2]).T, "o", label=label, **circles)
    axes.set(xlabel=r"$\omega_x$ (deg/s)", ylabel=r"$\omega_y$ (deg/s)")
    for side, axis in (("top", "x"), ("right", "y")):  # second scales in rad/s
        second = getattr(axes, f"secondary_{axis}axis")(side, functions=(np.radians, np.degrees))
        second.tick_params(labelsize=8)
        second.set(**{f"{axis}label": rf"$\omega_{axis}$ (rad/s)"})
    figure.legend(loc="outside lower center")
    return figure


def scan_tables(scan: Any) -> Iterator[Table]:
    """Yield the table `lines`: the lines fitted to the near-minimum set, a row each; nothing if the scan has none.

    The file has the point of each line in rad/s and deg/s, the page in deg/s only.
    """
    import pandas as pd

    if "point" not in scan or "direction" not in scan:
        return
    point, direction = scan["point"].values, scan["direction"].values  # (line, 3)
    columns: dict[str, Any] = {"points": scan["count"].values}
    columns |= {f"point_{axis}_rad_s": point[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"direction_{axis}": direction[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"point_{axis}_deg_s": np.degrees(point[:, k]) for k, axis in enumerate("xyz")}
    headings = {"points": "points"}
    headings |= {f"point_{axis}_deg_s": f"point {axis} (deg/s)" for axis in "xyz"}
    headings |= {f"direction_{axis}": f"direction {axis}" for axis in "xyz"}
    yield Table("lines", pd.DataFrame(columns), "Lines fitted to the near-minimum set", headings)


KINDS.update(
    scan=Kind("scan", "scan", scan_summary, scan_drawings, scan_tables),
    lines=Kind("lines", "lines", lines_summary),
)
