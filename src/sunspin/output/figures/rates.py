"""Body rates and attitude of each pass of a result of `rates`, with the gyro for comparison."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from sunspin.output.figures import BLACK, COLOURS, GREY, axes_grid, escape_name, styled
from sunspin.output.text import clock_text

SHOWN = 8
"""Passes that are drawn; more would not be legible."""

OTHER_SENSORS = {
    "gyro": "gyro",
    "rate_size": "size of the rate",
    "field": "magnetometer",
    "attitude": "attitude",
}
"""Sensors other than the Sun's, by the attributes of a result that say which were used -> what the title calls them."""


@styled
def rates_figure(result: xr.Dataset, telemetry: xr.Dataset | None = None) -> Any:
    """Draw the rate (deg/s) of the likeliest solution over time (min), with one sigma: a column for each pass, a row for each axis.

    Only the passes with the most samples are drawn (:func:`largest_passes`). If `telemetry` has a gyro, so are its readings, less
    their estimated zero.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    passes = largest_passes(result)
    title = f"Body rates of {escape_name(result.attrs['vehicle'])} from {sensors_text(result)}, likeliest solution of each pass"
    layout = {"sharey": "row", "sharex": "col", "squeeze": False}
    figure, grid = axes_grid(max(7.5, 2.1 * len(passes)), 6.4, 3, len(passes), title, **layout)
    gyro = None if telemetry is None or "gyro_B" not in telemetry else telemetry["gyro_B"]
    for column, number in zip(grid.T, passes, strict=True):
        t = result["time"].values[result["pass_of"].values == number]
        for k, axes in enumerate(column):
            draw_component(axes, result, number, k)
            if gyro is not None:
                # readings from a second before the first sample to a second after the last one
                component = gyro.isel(axis=k).dropna("time").sel(time=slice(t[0] - 1, t[-1] + 1))
                minutes = (component["time"].values - t[0]) / 60
                readings = np.degrees(component.values - _estimated_zero(result, number, k))
                axes.plot(minutes, readings, "x", color=BLACK, ms=4)
        remark = f"probability {result['probability'].values[number, 0]:.2f}"
        if "fits" in result and not result["fits"].values[number]:
            remark += ", poor fit"
        elif "decided" in result and not result["decided"].values[number]:
            remark += ", not decided"
        column[0].set_title(f"{clock_text(result, t[0])}\n{remark}", fontsize=8)
        column[-1].set_xlabel("time (min)")
    for k, row in enumerate(grid):
        row[0].set_ylabel(rf"$\omega_{'xyz'[k]}$ (deg/s)")
        low, high = row[0].get_ylim()
        if low < 0 < high:  # else a line at zero would extend the axis and squeeze the curve
            for axes in row:
                axes.axhline(0, color=GREY, lw=0.5)
    # the legend is black and grey, as it is for all components, which have different colours
    curve = Line2D([], [], color=BLACK, lw=1, marker=".", ms=5)
    curve.set_label("solution: samples, and between them")
    band = Patch(color=GREY, alpha=0.5, lw=0, label="one sigma")
    handles: list[Any] = [curve, band]
    if gyro is not None:
        zeros = [_estimated_zero(result, number, k) for number in passes for k in range(3)]
        label = "gyro, less its estimated zero" if any(zeros) else "gyro"
        handles.append(Line2D([], [], color=BLACK, marker="x", ls="", ms=4, label=label))
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return figure


def _estimated_zero(result: xr.Dataset, number: int, k: int) -> float:
    """Return the estimated zero (rad/s) of axis `k` of the gyro in pass `number`; 0 if the file states it."""
    name = f"gyro_zero_{'xyz'[k]}"
    if "estimate" not in result or name not in result["estimate"].values:
        return 0.0
    return float(np.nan_to_num(result["estimate_value"].sel(estimate=name).values[number]))


def draw_component(
    axes: Any, result: xr.Dataset, number: int, k: int, label: str | None = None
) -> None:
    """Draw component `k` of the rate (deg/s) in pass `number` over minutes: dots at samples, a curve, and its one-sigma band.

    The curve is the motion between the samples if the result contains it (`curve_omega_B`). Else straight lines connect the
    samples.
    """
    inside = result["pass_of"].values == number
    t, rate_deg = result["time"].values[inside], np.degrees(result["omega_B"].values[inside, k])
    sigma, begin = np.sqrt(result["omega_cov_B"].values[inside, k, k]), t[0]  # rad/s
    axes.plot((t - begin) / 60, rate_deg, ".", color=COLOURS[k], ms=4)
    if "curve_omega_B" in result:
        curve = result.isel(curve_time=result["curve_pass_of"].values == number)
        t, rate_deg = curve["curve_time"].values, np.degrees(curve["curve_omega_B"].values[:, k])
        sigma = curve["curve_omega_sigma_B"].values[:, k]
    minutes, sigma_deg = (t - begin) / 60, np.degrees(sigma)
    band = {"color": COLOURS[k], "alpha": 0.25, "lw": 0}
    axes.fill_between(minutes, rate_deg - sigma_deg, rate_deg + sigma_deg, **band)
    axes.plot(minutes, rate_deg, color=COLOURS[k], lw=1, label=label)


@styled
def attitude_figure(result: xr.Dataset) -> Any:
    """Draw the attitude quaternion (scalar last) of the likeliest solution of each of the largest passes, by time.

    Above each pass is one sigma of the attitude (deg): the root of the mean square over its samples. The result must have
    `turn_sigma_rad`, which needs an orbit.
    """
    passes = largest_passes(result)  # at most `SHOWN`
    title = f"Attitude of {escape_name(result.attrs['vehicle'])}: rotation from {result.attrs['frame_N']} to body axes"
    layout = {"sharey": True, "squeeze": False}
    figure, (grid,) = axes_grid(max(7.5, 2.1 * len(passes)), 3.2, 1, len(passes), title, **layout)
    # errors of the Sun direction and of the rotation about it are perpendicular
    sigmas = result["sun_sigma_rad"].values, result["turn_sigma_rad"].values
    error = np.degrees(np.hypot(*sigmas))
    for axes, number in zip(grid, passes, strict=True):
        in_pass = result["pass_of"].values == number
        on_curve = result["curve_pass_of"].values == number
        t, begin = result["curve_time"].values[on_curve], result["time"].values[in_pass][0]
        for k, component in enumerate("xyzw"):
            curve = result["curve_B_from_N"].values[on_curve, k]
            axes.plot((t - begin) / 60, curve, lw=1, color=COLOURS[k], label=component)
        rms = np.sqrt(np.mean(error[in_pass] ** 2))
        axes.set_title(f"{clock_text(result, begin)}\none sigma {rms:.2g} deg", fontsize=8)
        axes.set_xlabel("time (min)")
        axes.set_ylim(-1.05, 1.05)
    grid[0].set_ylabel("quaternion (1)")
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def sensors_text(result: xr.Dataset) -> str:
    """Return the sensors from which the motion of a result of `rates` was estimated, in words."""
    direction_sources = {
        "panels": ["panel signals"],
        "sun_sensor": ["Sun sensors"],
        "directions": ["Sun directions"],
        "field": [],  # no Sun direction: the magnetometer is one of the sensors below
    }
    sensors = [word for name, word in OTHER_SENSORS.items() if result.attrs.get(f"{name}_used")]
    used = [*direction_sources[result.attrs["source"]], *sensors]
    return used[0] if len(used) == 1 else f"{', '.join(used[:-1])} and {used[-1]}"


def largest_passes(result: xr.Dataset) -> np.ndarray:
    """Return the numbers of the passes with the most samples, at most `SHOWN`, in the order of time."""
    count = np.bincount(result["pass_of"].values, minlength=result.sizes["pass_id"])
    return np.sort(np.argsort(-count, kind="stable")[:SHOWN])
