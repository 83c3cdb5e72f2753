"""Signals of the panels as measured, and as a motion predicts them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from sunspin.output.figures import COLOURS, axes_grid, labels_of, named, styled
from sunspin.output.figures.rates import clock_text
from sunspin.telemetry.sun import signals
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import panel_power

MOST_RUNS = 4
"""Motions that are drawn, a column each: those with the most samples."""

LONGEST_S = 900.0
"""Of each motion these first seconds are drawn: a tumbling body makes up to sixty revolutions in them."""


@styled
def panel_signals_figure(
    telemetry: xr.Dataset,
    runs: Sequence[tuple[str, xr.Dataset]],
    vehicle: Vehicle,
    used: np.ndarray | None = None,
    left_out: Sequence[str] = (),
) -> Any:
    """A row for each panel, a column for each motion: samples as dots, the predicted signal as a line.

    Parameters
    ----------
    runs : (title, Dataset)
        Motions with `sun_B` (time, 3) in body axes on times fine enough to draw; their factor is fitted to the samples.
    used : (n,)
        The samples that count for the factor, not limited by the battery; all if there is none. `left_out`: names of dark panels
    """
    measured, time = signals(telemetry), telemetry["time"].values
    dead = np.isin(telemetry["panel"].values, list(left_out))
    of_file = used is not None and used.shape == time.shape  # else of a part of it
    counts = used if of_file and used.any() else np.ones(len(time), bool)
    ends = [run["time"].values[[0, -1]] for _, run in runs]
    inside = [(time >= first) & (time <= last) for first, last in ends]
    shown = sorted(sorted(range(len(runs)), key=lambda k: -int(inside[k].sum()))[:MOST_RUNS])
    names = labels_of(telemetry["panel"].values)
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
        factor = _factor(time[at & counts], measured[at & counts][:, ~dead], t, model[:, ~dead])
        for panel, axes in enumerate(column):
            mark, colour, line, ls = (".", COLOURS[6], COLOURS[1], "-")
            if dead[panel]:
                mark, colour, line, ls = ("x", COLOURS[7], COLOURS[7], ":")
            axes.plot((t - t0) / 60, factor * model[:, panel], lw=1, color=line, ls=ls)
            axes.plot((time[at] - t0) / 60, measured[at, panel], mark, ms=5, color=colour)
        column[0].set_title(f"{named(title)}\n{clock_text(run, t0)}", fontsize=8)
        column[-1].set_xlabel("time (min)")
    unit = "W" if "power_W" in telemetry else "A"
    for panel, row in enumerate(grid):
        left = "\nnever lit" if dead[panel] else ""
        space = " " if len(names[panel]) < 10 else "\n"
        row[0].set_ylabel(f"{names[panel]}{space}({unit}){left}", fontsize=8)
    return figure


def _factor(t: np.ndarray, measured: np.ndarray, when: np.ndarray, model: np.ndarray) -> float:
    """The factor, by least squares over the samples, that brings the model to the measured signals; 1 without samples."""
    known = np.isfinite(measured).all(axis=1)
    there = np.stack([np.interp(t[known], when, column) for column in model.T], axis=1)
    power = float((there**2).sum()) if known.any() else 0.0
    return float((there * measured[known]).sum()) / power if power > 0 else 1.0
