"""Body rates and the Sun's direction of each pass, with what other instruments say where there are any."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from sunspin.estimate.terms.sensors import SENSORS
from sunspin.output.figures import COLOURS, named, titled

SHOWN = 8
"""Passes drawn; more would not be legible."""


def rates_figure(result: xr.Dataset, telemetry: xr.Dataset | None = None) -> Figure:
    """Rate components (deg/s) of the best motion of each pass with one sigma, and the gyro where the telemetry has one."""
    passes = chosen_passes(result)
    figure = Figure(figsize=(max(7.5, 2.1 * len(passes)), 6.4), layout="constrained")
    grid = figure.subplots(3, len(passes), sharey="row", sharex="col", squeeze=False)
    gyro = None if telemetry is None or "gyro_B" not in telemetry else telemetry["gyro_B"]
    for column, number in enumerate(passes):
        at = np.flatnonzero(result["pass_of"].values == number)
        t = result["time"].values[at]
        for k, axes in enumerate(grid[:, column]):
            component(axes, result, number, k)
            if gyro is not None:
                _gyro(axes, gyro["time"].values, gyro.values[:, k], t)
        grid[0, column].set_title(
            f"{clock_text(result, t[0])}\n{_standing(result, number)}", fontsize=8
        )
        grid[2, column].set_xlabel("time (min)")
    for k, row in enumerate(grid):
        row[0].set_ylabel(rf"$\omega_{'xyz'[k]}$ (deg/s)")
        low, high = row[0].get_ylim()
        for axes in (
            row if low < 0 < high else ()
        ):  # a line that is out of sight would squeeze the curve
            axes.axhline(0, color=COLOURS[7], lw=0.5)
    figure.legend(
        handles=_legend(gyro is not None),
        fontsize=8,
        loc="outside lower center",
        ncols=4,
        frameon=False,
    )
    figure.suptitle(
        titled(
            f"Body rates of {named(result.attrs['vehicle'])} from {sources(result)}, best motion of each pass",
            result.attrs.get("synthetic"),
        ),
        fontsize=10,
        wrap=True,
    )
    return figure


def _standing(result: xr.Dataset, number: int) -> str:
    """The probability of the likeliest solution of a pass, and whether it may be believed."""
    probability = f"probability {result['probability'].values[number, 0]:.2f}"
    if "fits" in result and not bool(result["fits"].values[number]):
        return f"{probability}, FITS BADLY"
    return (
        probability
        if "decided" not in result or bool(result["decided"].values[number])
        else f"{probability}, not decided"
    )


def _legend(gyro: bool) -> list[Any]:
    """What curve, band and marks are, for components in any colour."""
    curve = Line2D(
        [],
        [],
        color=COLOURS[6],
        lw=1,
        marker=".",
        ms=5,
        label="motion found: samples, and between them",
    )
    band = Patch(color=COLOURS[7], alpha=0.5, lw=0, label="one sigma")
    return [
        curve,
        band,
        *(
            [Line2D([], [], color=COLOURS[6], marker="x", ls="", ms=4, label="gyro")]
            if gyro
            else []
        ),
    ]


def component(axes: Any, result: xr.Dataset, number: int, k: int, label: str | None = None) -> None:
    """A component of the rate in a pass: samples, and between them the curve and band that the results hold, if they do."""
    at = np.flatnonzero(result["pass_of"].values == number)
    t, mean, sigma = (
        result["time"].values[at],
        result["omega_B"].values[at, k],
        np.sqrt(result["omega_cov_B"].values[at, k, k]),
    )
    points, begin = np.degrees(mean), t[0]
    minutes = (t - begin) / 60
    if "curve_omega_B" in result:
        at = np.flatnonzero(result["curve_pass_of"].values == number)
        t, mean, sigma = (
            result[name].values[at]
            for name in ("curve_time", "curve_omega_B", "curve_omega_sigma_B")
        )
        mean, sigma = mean[:, k], sigma[:, k]
    mean, sigma = np.degrees(mean), np.degrees(sigma)
    axes.fill_between(
        (t - begin) / 60, mean - sigma, mean + sigma, color=COLOURS[k], alpha=0.25, lw=0
    )
    axes.plot((t - begin) / 60, mean, color=COLOURS[k], lw=1, label=label)
    axes.plot(minutes, points, ".", color=COLOURS[k], ms=4)


def attitude_figure(result: xr.Dataset) -> Figure:
    """The attitude in space of the best solution of each pass, as a quaternion, with its rms error in the title."""
    passes = chosen_passes(result)
    figure = Figure(figsize=(max(7.5, 2.1 * len(passes)), 3.2), layout="constrained")
    grid = figure.subplots(1, len(passes), sharey=True, squeeze=False)[0]
    sigmas = result["sun_sigma_rad"].values, result["turn_sigma_rad"].values
    error = np.degrees(np.hypot(*sigmas))
    for axes, number in zip(grid, passes, strict=True):
        at, fine = (result[name].values == number for name in ("pass_of", "curve_pass_of"))
        t, begin = result["curve_time"].values[fine], result["time"].values[at][0]
        for k, part in enumerate("xyzw"):
            curve = result["curve_B_from_N"].values[fine, k]
            axes.plot((t - begin) / 60, curve, lw=1, color=COLOURS[k], label=part)
        rms = np.sqrt(np.mean(error[at] ** 2))
        axes.set_title(f"{clock_text(result, begin)}\none sigma {rms:.2g} deg", fontsize=8)
        axes.set_xlabel("time (min)")
        axes.set_ylim(-1.05, 1.05)
    grid[0].set_ylabel("quaternion (1)")
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    text = f"Attitude of {named(result.attrs['vehicle'])}: rotation from {result.attrs['frame_N']} to body axes"
    figure.suptitle(titled(text, result.attrs.get("synthetic")), fontsize=10)
    return figure


def sources(result: xr.Dataset) -> str:
    """The sensors that a motion was found from, in words."""
    seen = {
        "panels": ["panel signals"],
        "sun_sensor": ["Sun sensors"],
        "directions": ["Sun directions"],
        "field": [],
    }
    used = [
        *seen[result.attrs["source"]],
        *(one.called for one in SENSORS if result.attrs.get(f"{one.name}_used")),
    ]
    return used[0] if len(used) == 1 else f"{', '.join(used[:-1])} and {used[-1]}"


def chosen_passes(result: xr.Dataset) -> np.ndarray:
    """The passes with the most samples, in the order of time."""
    count = np.bincount(result["pass_of"].values, minlength=result.sizes["pass_id"])
    return np.sort(np.argsort(-count, kind="stable")[:SHOWN])


def _gyro(axes: Any, time: np.ndarray, value: np.ndarray, t: np.ndarray) -> None:
    near = (time >= t[0] - 1) & (time <= t[-1] + 1) & np.isfinite(value)
    if near.any():
        axes.plot(
            (time[near] - t[0]) / 60,
            np.degrees(value[near]),
            "x",
            color=COLOURS[6],
            ms=4,
            label="gyro",
        )


def clock_text(result: xr.Dataset, t: float) -> str:
    start = np.datetime64(str(result.attrs.get("epoch_utc", "1970-01-01")).removesuffix("Z"), "ms")
    return str(
        (start + np.timedelta64(int(round(t * 1000)), "ms")).astype("datetime64[s]")
    ).replace("T", " ")
