"""Residuals of each sensor relative to the likeliest solution, in sigmas."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from scipy.special import ndtr

from sunspin.output.figures import COLOURS, empty_figure, escape_name, titled
from sunspin.output.figures.rates import SHOWN, clock_text, largest_passes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN_SIGMAS = 6.0
"""Residuals (sigmas) beyond this are drawn at the edge."""

LIMIT = 3.0
"""Residuals (sigmas) beyond this are counted."""


def residuals_figure(result: xr.Dataset) -> Figure:
    """Draw the residuals of a result of `rates`: a row of axes for each sensor that was used, a column for each pass.

    The share of residuals beyond `LIMIT`, over all passes, is written at each row.
    """
    residual = result["residual"].dropna("sensor", how="all")
    passes, sensors = largest_passes(result), residual["sensor"].values
    rows = max(len(sensors), 1)
    size = max(7.5, 2.1 * len(passes)), 1.9 * rows + 1.0
    figure = empty_figure(*size)
    grid = figure.subplots(rows, len(passes), sharex="col", sharey=True, squeeze=False)
    for row, sensor in zip(grid, sensors, strict=False):
        value = residual.sel(sensor=sensor).values
        for axes, number in zip(row, passes, strict=True):
            in_pass = result["pass_of"].values == number
            t = result["time"].values[in_pass]
            drawn = np.minimum(value[in_pass], SHOWN_SIGMAS)
            axes.plot((t - t[0]) / 60, drawn, ".", ms=5, color=COLOURS[0])
            axes.axhline(LIMIT, color=COLOURS[7], lw=1, ls="--")
            axes.set_ylim(0, 1.05 * SHOWN_SIGMAS)
        share = np.mean(value[np.isfinite(value)] > LIMIT)
        row[0].set_ylabel(
            f"{escape_name(sensor)} (sigma)\n{share:.1%} beyond {LIMIT:g}", fontsize=8
        )
    for column, number in zip(grid.T, passes, strict=True):
        first = float(result["time"].values[result["pass_of"].values == number][0])
        column[0].set_title(clock_text(result, first), fontsize=8)
        column[-1].set_xlabel("time (min)")
    count = result.sizes["pass_id"]
    part = f", {SHOWN} of {count} passes" if count > SHOWN else ""
    # of normal noise, 2 ndtr(-LIMIT) lies beyond LIMIT to both sides
    text = f"Readings less prediction{part}; of noise alone {2 * ndtr(-LIMIT):.1%} lie beyond {LIMIT:g} sigma"
    figure.suptitle(titled(text, result.attrs.get("synthetic")), fontsize=10)
    return figure
