"""The body rate in short windows of passes that no free motion fits."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from sunspin.output.figures import COLOURS, GREY, axes_grid, escape_name, styled
from sunspin.output.text import clock_text

SHOWN = 6
"""Passes that are drawn."""


@styled
def windows_figure(result: xr.Dataset) -> Any:
    """Draw the rate components (deg/s) of each window with one sigma, a column for each pass; open marks are not decided."""
    from matplotlib.lines import Line2D

    passes = np.unique(result["window_pass"].values)[:SHOWN]
    title = f"Body rate of {escape_name(result.attrs['vehicle'])} in short windows"
    layout = {"sharey": "row", "sharex": "col", "squeeze": False}
    figure, grid = axes_grid(max(7.5, 2.6 * len(passes)), 6.4, 3, len(passes), title, **layout)
    for column, number in zip(grid.T, passes, strict=True):
        one = result.isel(window=np.flatnonzero(result["window_pass"].values == number))
        begin = float(one["window_begin"].values[0])
        middle = (one["window_time"].values - begin) / 60
        decided = one["window_decided"].values
        for k, axes in enumerate(column):
            rate = np.degrees(one["window_omega_B"].values[:, k])
            sigma = np.degrees(one["window_sigma_B"].values[:, k])
            for which, fill in ((decided, COLOURS[k]), (~decided, "none")):
                style = {"color": COLOURS[k], "markerfacecolor": fill, "ms": 5, "lw": 1}
                axes.errorbar(middle[which], rate[which], sigma[which], fmt="o", **style)
            axes.axhline(0, color=GREY, lw=0.5)
        column[0].set_title(f"pass {number}, {clock_text(result, begin)}", fontsize=8)
        column[-1].set_xlabel("time (min)")
    for k, row in enumerate(grid):
        row[0].set_ylabel(rf"$\omega_{'xyz'[k]}$ (deg/s)")
    filled = Line2D([], [], color=GREY, marker="o", ls="", label="decided")
    hollow = Line2D([], [], color=GREY, marker="o", ls="", markerfacecolor="none")
    hollow.set_label("not decided")
    figure.legend(handles=[filled, hollow], loc="outside lower center", ncols=2)
    return figure
