"""Body rates and the Sun's direction of each pass, with what other instruments say where there are any."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

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
            _component(axes, result, number, k)
            if gyro is not None:
                _gyro(axes, gyro["time"].values, gyro.values[:, k], t)
        grid[0, column].set_title(f"{clock_text(result, t[0])}\nweight {result['weight'].values[number, 0]:.2f}", fontsize=8)
        grid[2, column].set_xlabel("time (min)")
    for k, row in enumerate(grid):
        row[0].set_ylabel(rf"$\omega_{'xyz'[k]}$ (deg/s)")
        low, high = row[0].get_ylim()
        for axes in row if low < 0 < high else ():  # a line that is out of sight would squeeze the curve
            axes.axhline(0, color=COLOURS[7], lw=0.5)
    figure.legend(handles=_legend(gyro is not None), fontsize=8, loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(titled(f"Body rates of {named(result.attrs['vehicle'])} from {sources(result)}, best motion of each pass",
                           result.attrs.get("synthetic")), fontsize=10, wrap=True)  # fmt: skip
    return figure


def _legend(gyro: bool) -> list[Any]:
    """What curve, band and marks are, for components in any colour."""
    curve = Line2D([], [], color=COLOURS[6], lw=1, marker=".", ms=5, label="motion found: samples, and between them")
    band = Patch(color=COLOURS[7], alpha=0.5, lw=0, label="one sigma")
    return [curve, band, *([Line2D([], [], color=COLOURS[6], marker="x", ls="", ms=4, label="gyro")] if gyro else [])]


def _component(axes: Any, result: xr.Dataset, number: int, k: int, label: str | None = None) -> None:
    """A component of the rate in a pass: samples, and between them the curve and band that the results hold, if they do."""
    at = np.flatnonzero(result["pass_of"].values == number)
    t, mean, sigma = result["time"].values[at], result["omega_B"].values[at, k], np.sqrt(result["omega_cov_B"].values[at, k, k])
    points, begin = np.degrees(mean), t[0]
    minutes = (t - begin) / 60
    if "curve_omega_B" in result:
        at = np.flatnonzero(result["curve_pass_of"].values == number)
        t, mean, sigma = (result[name].values[at] for name in ("curve_time", "curve_omega_B", "curve_omega_sigma_B"))
        mean, sigma = mean[:, k], sigma[:, k]
    mean, sigma = np.degrees(mean), np.degrees(sigma)
    axes.fill_between((t - begin) / 60, mean - sigma, mean + sigma, color=COLOURS[k], alpha=0.25, lw=0)
    axes.plot((t - begin) / 60, mean, color=COLOURS[k], lw=1, label=label)
    axes.plot(minutes, points, ".", color=COLOURS[k], ms=4)


def sources(result: xr.Dataset) -> str:
    """The sensors that a motion was found from, in words."""
    seen = {"panels": ["panel signals"], "sun_sensor": ["Sun sensors"], "directions": ["Sun directions"], "field": []}
    words = {"gyro_used": "gyro", "field_used": "magnetometer", "attitude_used": "attitude"}
    used = [*seen[result.attrs["source"]], *(word for key, word in words.items() if result.attrs.get(key))]
    return used[0] if len(used) == 1 else f"{', '.join(used[:-1])} and {used[-1]}"


def chosen_passes(result: xr.Dataset) -> np.ndarray:
    """The passes with the most samples, in the order of time."""
    count = np.bincount(result["pass_of"].values, minlength=result.sizes["pass_id"])
    return np.sort(np.argsort(-count, kind="stable")[:SHOWN])


def _gyro(axes: Any, time: np.ndarray, value: np.ndarray, t: np.ndarray) -> None:
    near = (time >= t[0] - 1) & (time <= t[-1] + 1) & np.isfinite(value)
    if near.any():
        axes.plot((time[near] - t[0]) / 60, np.degrees(value[near]), "x", color=COLOURS[6], ms=4, label="gyro")


def clock_text(result: xr.Dataset, t: float) -> str:
    start = np.datetime64(str(result.attrs.get("epoch_utc", "1970-01-01")).removesuffix("Z"), "ms")
    return str((start + np.timedelta64(int(round(t * 1000)), "ms")).astype("datetime64[s]")).replace("T", " ")


def sun_and_rates_figure(currents: xr.Dataset, sensors: xr.Dataset, beacons: xr.Dataset, shift_s: float) -> Figure:
    """Left: the Sun from panel currents against the Sun sensors' readings; right: rates from Sun sensors against the gyro.

    `currents`, `sensors`: results of `rates`; `beacons`: the telemetry of the latter, with its gyro; `shift_s`: time of the
    former's epoch on the latter's clock.
    """
    figure = Figure(figsize=(11, 7.2), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(1, 1.25), squeeze=False)[0]
    _sun_against_sensors(left, currents, beacons, shift_s)
    known = [n for n in chosen_passes(sensors) if np.isfinite(_gyro_at(sensors, beacons, n)).all()][-3:]
    grid = right.subplots(3, len(known), sharey="row", squeeze=False)
    for column, number in enumerate(known):
        at = np.flatnonzero(sensors["pass_of"].values == number)
        t = sensors["time"].values[at]
        for k, axes in enumerate(grid[:, column]):
            _component(axes, sensors, number, k, "Sun sensors, one sigma")
            gyro = np.degrees(_gyro_at(sensors, beacons, number)[:, k])
            axes.plot((t - t[0]) / 60, gyro, "x", color=COLOURS[6], ms=5, label="gyro")
        grid[0, column].set_title(clock_text(sensors, t[0]), fontsize=8)
        grid[2, column].set_xlabel("time (min)")
    for k, axes in enumerate(grid[:, 0]):
        axes.set_ylabel(rf"$\omega_{'xyz'[k]}$ (deg/s)")
        axes.legend(fontsize=7, loc="best")
    right.suptitle("Body rates, gyro not used", fontsize=10)
    return figure


def _gyro_at(result: xr.Dataset, telemetry: xr.Dataset, number: int) -> np.ndarray:
    at = result["pass_of"].values == number
    return telemetry["gyro_B"].sel(time=result["time"].values[at]).values


def _sun_against_sensors(figure: Any, currents: xr.Dataset, beacons: xr.Dataset, shift_s: float) -> None:
    count = currents.sizes["pass_id"]
    grid = figure.subplots(3, count, sharey=True, squeeze=False)
    for number in range(count):
        at = np.flatnonzero(currents["pass_of"].values == number)
        t = currents["time"].values[at] + shift_s
        near = (beacons["time"].values > t[0] - 60) & (beacons["time"].values < t[-1] + 60)
        minutes = (beacons["time"].values[near] - t[0]) / 60
        for k, axes in enumerate(grid[:, number]):
            sun, sigma = currents["sun_B"].values[at, k], currents["sun_sigma_rad"].values[at]
            axes.errorbar((t - t[0]) / 60, sun, yerr=sigma, fmt=".", ms=5, lw=0.8, color=COLOURS[k], label="currents")
            error = np.sqrt(beacons["sun_sensor_cov_B"].values[near, k, k])
            axes.errorbar(minutes, beacons["sun_sensor_B"].values[near, k], yerr=error, fmt="s", ms=4, lw=0.6,
                          color=COLOURS[6], mfc="none", label="Sun sensors")  # fmt: skip
            axes.set_ylim(-1.3, 1.3)
        grid[0, number].set_title(clock_text(currents, currents["time"].values[at][0]), fontsize=8)
        grid[2, number].set_xlabel("time (min)")
    for k, axes in enumerate(grid[:, 0]):
        axes.set_ylabel(rf"Sun direction $n_{'xyz'[k]}$")
        axes.legend(fontsize=7, loc="best")
    figure.suptitle("The Sun: smoothed from currents, read by sensors", fontsize=10)
