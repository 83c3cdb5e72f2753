"""Panel signals: measured, and predicted from a motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from sunspin.output.figures import COLOURS, axes_grid, axis_labels, escape_name, styled
from sunspin.output.figures.rates import clock_text
from sunspin.telemetry.sun import signals
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import panel_power

MOST_RUNS = 4
"""Motions that are drawn, each in a column: those with the most samples."""

LONGEST_S = 900.0
"""Time (s) from the begin of each motion that is drawn; a tumbling body makes up to sixty revolutions in it."""


@styled
def panel_signals_figure(
    telemetry: xr.Dataset,
    runs: Sequence[tuple[str, xr.Dataset]],
    vehicle: Vehicle,
    used: np.ndarray | None = None,
    left_out: Sequence[str] = (),
) -> Any:
    """Draw measured signals as dots and predicted signals as lines: a row for each panel, a column for each motion.

    The predicted signals of a motion are multiplied by one factor, which is fitted to the samples.

    Parameters
    ----------
    runs : list of (title, Dataset)
        Motions with `sun_B` (time, 3), the Sun direction in body axes, at times close enough to draw a line.
    used : array of bool (n,), optional
        Samples to which the factor is fitted, such as those that are not power-limited; default: all.
    left_out : list of str
        Names of panels without signal, which count for no factor.
    """
    measured, time = signals(telemetry), telemetry["time"].values
    dead = np.isin(telemetry["panel"].values, list(left_out))
    # `used` of a part of the file only, as with --from, cannot be assigned to its samples
    assignable = used is not None and used.shape == time.shape
    fitted = used if assignable and used.any() else np.ones(len(time), bool)
    ends = [run["time"].values[[0, -1]] for _, run in runs]
    inside = [(time >= first) & (time <= last) for first, last in ends]
    shown = sorted(sorted(range(len(runs)), key=lambda k: -int(inside[k].sum()))[:MOST_RUNS])
    names = axis_labels(telemetry["panel"].values)
    size = (max(7.5, 2.6 * len(shown) + 1), 1.05 * len(names) + 1.2)
    title = "Panel signals: samples (dots) and the motion's prediction (lines)"
    layout = {"sharex": "col", "sharey": "row", "squeeze": False}
    figure, grid = axes_grid(*size, len(names), len(shown), title, **layout)
    for column, k in zip(grid.T, shown, strict=True):
        title, run = runs[k]
        t0 = float(run["time"].values[0])
        early = run["time"].values <= t0 + LONGEST_S
        t, sun = run["time"].values[early], run["sun_B"].values[early]
        model = panel_power(vehicle, sun / np.linalg.norm(sun, axis=1, keepdims=True))
        at = inside[k] & (time <= t0 + LONGEST_S)
        factor = _fit_factor(time[at & fitted], measured[at & fitted][:, ~dead], t, model[:, ~dead])
        for panel, axes in enumerate(column):
            mark, colour, line, ls = (".", COLOURS[6], COLOURS[1], "-")
            if dead[panel]:
                mark, colour, line, ls = ("x", COLOURS[7], COLOURS[7], ":")
            axes.plot((t - t0) / 60, factor * model[:, panel], lw=1, color=line, ls=ls)
            axes.plot((time[at] - t0) / 60, measured[at, panel], mark, ms=5, color=colour)
        column[0].set_title(f"{escape_name(title)}\n{clock_text(run, t0)}", fontsize=8)
        column[-1].set_xlabel("time (min)")
    unit = "W" if "power_W" in telemetry else "A"
    for panel, row in enumerate(grid):
        left = "\nnever lit" if dead[panel] else ""
        space = " " if len(names[panel]) < 10 else "\n"
        row[0].set_ylabel(f"{names[panel]}{space}({unit}){left}", fontsize=8)
    return figure


def _fit_factor(
    time: np.ndarray, measured: np.ndarray, model_time: np.ndarray, model: np.ndarray
) -> float:
    """Return the least-squares factor by which the model signals (m, panel) fit the measured ones (n, panel); 1 without samples."""
    complete = np.isfinite(measured).all(axis=1)
    predicted = np.stack([np.interp(time[complete], model_time, p) for p in model.T], axis=1)
    power = float((predicted**2).sum()) if complete.any() else 0.0
    return float((predicted * measured[complete]).sum()) / power if power > 0 else 1.0
