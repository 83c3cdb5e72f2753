"""Panel signals: measured, and predicted from a motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from sunspin.output.figures import (
    BLACK,
    COLOURS,
    GREY,
    axes_grid,
    axis_labels,
    escape_name,
    styled,
)
from sunspin.output.figures.rates import clock_text
from sunspin.telemetry.signals import signals
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import panel_power

MOST_MOTIONS = 4
"""Motions that are drawn, each in a column: those with the most samples."""

LONGEST_S = 900.0
"""Time (s) from the begin of each motion that is drawn; a tumbling body makes up to sixty revolutions in it."""


@styled
def panel_signals_figure(
    telemetry: xr.Dataset,
    motions: Sequence[tuple[str, xr.Dataset]],
    vehicle: Vehicle,
    used: np.ndarray | None = None,
    left_out: Sequence[str] = (),
) -> Any:
    """Draw measured signals as dots and predicted signals as lines: a row for each panel, a column for each motion.

    The predicted signals of a motion are multiplied by its `gain_factor` of each panel, if it has them, and by one factor, which is
    fitted to the samples.

    Parameters
    ----------
    motions : list of (title, Dataset)
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
    ends = [motion["time"].values[[0, -1]] for _, motion in motions]
    inside = [
        (time >= first) & (time <= last) for first, last in ends
    ]  # samples (n) of each motion
    by_samples = sorted(range(len(motions)), key=lambda k: -int(inside[k].sum()))
    drawn = sorted(by_samples[:MOST_MOTIONS])  # in the order of `motions`
    names = axis_labels(telemetry["panel"].values)
    size = (max(7.5, 2.6 * len(drawn) + 1), 1.05 * len(names) + 1.2)
    title = "Panel signals: samples (dots) and the motion's prediction (lines)"
    layout = {"sharex": "col", "sharey": "row", "squeeze": False}
    figure, grid = axes_grid(*size, len(names), len(drawn), title, **layout)
    for column, k in zip(grid.T, drawn, strict=True):
        motion_title, motion = motions[k]
        start_s = float(motion["time"].values[0])
        early = motion["time"].values <= start_s + LONGEST_S
        t, sun = motion["time"].values[early], motion["sun_B"].values[early]
        predicted = panel_power(vehicle, sun / np.linalg.norm(sun, axis=1, keepdims=True))
        if "gain_factor" in motion:
            factors = motion["gain_factor"].reindex(panel=telemetry["panel"].values)
            predicted = predicted * factors.fillna(1.0).values
        sampled = inside[k] & (time <= start_s + LONGEST_S)
        to_fit = sampled & fitted
        factor = _fit_factor(time[to_fit], measured[to_fit][:, ~dead], t, predicted[:, ~dead])
        minutes, sample_minutes = (t - start_s) / 60, (time[sampled] - start_s) / 60
        for panel, axes in enumerate(column):
            marks, line = {"marker": ".", "color": BLACK}, {"ls": "-", "color": COLOURS[1]}
            if dead[panel]:
                marks, line = {"marker": "x", "color": GREY}, {"ls": ":", "color": GREY}
            axes.plot(minutes, factor * predicted[:, panel], lw=1, **line)
            axes.plot(sample_minutes, measured[sampled, panel], ls="", ms=5, **marks)
        heading = f"{escape_name(motion_title)}\n{clock_text(motion, start_s)}"
        column[0].set_title(heading, fontsize=8)
        column[-1].set_xlabel("time (min)")
    quantity = "power_W" if "power_W" in telemetry else "current_A"
    unit = telemetry[quantity].attrs.get("units", quantity[-1])  # 1 for angles of the Sun
    for panel, row in enumerate(grid):
        remark = "\nnever lit" if dead[panel] else ""
        separator = " " if len(names[panel]) < 10 else "\n"  # a long name takes a line of its own
        row[0].set_ylabel(f"{names[panel]}{separator}({unit}){remark}", fontsize=8)
    return figure


def _fit_factor(
    time: np.ndarray, measured: np.ndarray, predicted_time: np.ndarray, predicted: np.ndarray
) -> float:
    """Return the least-squares factor by which predicted signals fit the measured ones (n, panel) at times (n).

    `predicted` (m, panel) at `predicted_time` (m) is interpolated. The factor is 1 without complete samples or predicted light.
    """
    complete = np.isfinite(measured).all(axis=1)
    at_samples = np.stack(
        [np.interp(time[complete], predicted_time, signal) for signal in predicted.T], axis=1
    )
    sum_of_squares = float((at_samples**2).sum()) if complete.any() else 0.0
    if sum_of_squares == 0:
        return 1.0
    return float((at_samples * measured[complete]).sum()) / sum_of_squares
