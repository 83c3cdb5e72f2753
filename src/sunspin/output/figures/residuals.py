"""How far each sensor's readings lie from the motion found, in sigmas, and whether they scatter as their noise says."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from scipy.special import ndtr

from sunspin.output.figures import COLOURS, named, titled
from sunspin.output.figures.rates import SHOWN, chosen_passes, clock_text
from sunspin.telemetry.assess import panel_quality
from sunspin.telemetry.sun import signals
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import panel_power

SHOWN_SIGMAS = 6.0
"""Residuals farther out are drawn at the edge."""

BEYOND = 3.0
"""Sigmas beyond which readings are counted."""


def residuals(
    result: xr.Dataset, telemetry: xr.Dataset, vehicle: Vehicle
) -> dict[str, tuple[list[str], np.ndarray]]:
    """Sensor -> (names of its m values, residuals (n, m) in sigmas at the result's times), NaN where it told nothing.

    Of the likeliest motion of each pass. What a pass has in common (the zero of a gyro whose error is stated) is taken off.
    """
    at = np.searchsorted(telemetry["time"].values, result["time"].values)
    at = np.minimum(at, telemetry.sizes["time"] - 1)
    same = telemetry["time"].values[at] == result["time"].values
    there = telemetry.isel(time=at)
    found: dict[str, tuple[list[str], np.ndarray]] = {}
    if "panel" in telemetry.coords:
        found["panels"] = (
            [str(name) for name in telemetry["panel"].values],
            _panels(result, telemetry, vehicle, at),
        )
    if "sun_sensor_B" in telemetry:
        found["Sun sensors"] = ["across", "along"], _sun_sensors(result, there)
    if "gyro_B" in telemetry and vehicle.sensors.gyro is not None:
        found["gyro"] = list("xyz"), _gyro(result, there, vehicle)
    for _, value in found.values():
        value[~same] = np.nan
    return {name: each for name, each in found.items() if np.isfinite(each[1]).any()}


def _panels(
    result: xr.Dataset, telemetry: xr.Dataset, vehicle: Vehicle, at: np.ndarray
) -> np.ndarray:
    """Of the whole file, so that quality is judged as it was for the motion. Dark panels that read nothing say nothing of noise."""
    quality = panel_quality(vehicle, telemetry)
    sun = result["sun_B"].values / np.linalg.norm(result["sun_B"].values, axis=1, keepdims=True)
    gain = quality["gain"].values / vehicle.input_gains
    model = quality["scale"].values[at, None] * gain * panel_power(vehicle, sun)
    sigma, read = quality["sigma"].values[at], signals(telemetry)[at]
    told = np.isfinite(sigma) & ((model > 0) | (read != 0))
    return (read - model) / np.where(told, sigma, np.nan)


def _sun_sensors(result: xr.Dataset, there: xr.Dataset) -> np.ndarray:
    """Along the axes of the sensors' error across the line of sight."""
    seen, covariance = there["sun_sensor_B"].values, there["sun_sensor_cov_B"].values
    known = np.isfinite(seen).all(axis=1)
    across = np.eye(3) - seen[:, :, None] * seen[:, None, :]
    square, axes = np.linalg.eigh(across[known] @ covariance[known] @ across[known])
    away = np.einsum("nik,ni->nk", axes, (result["sun_B"].values - seen)[known])[:, 1:]
    value = np.full((len(seen), 2), np.nan)
    value[known] = away / np.sqrt(square[:, 1:])
    return value


def _gyro(result: xr.Dataset, there: xr.Dataset, vehicle: Vehicle) -> np.ndarray:
    gyro = vehicle.sensors.gyro
    assert gyro is not None
    value = (there["gyro_B"].values - result["omega_B"].values) / gyro.noise_rad_s
    for number in np.unique(result["pass_of"].values):
        inside = result["pass_of"].values == number
        if gyro.zero_sigma.any() and np.isfinite(value[inside]).any():
            value[inside] -= np.nanmedian(value[inside], axis=0)
    return value


def residuals_figure(result: xr.Dataset, telemetry: xr.Dataset, vehicle: Vehicle) -> Figure:
    """Residuals of each sensor against time by pass; right: how they are distributed, beside the law of their stated noise."""
    found, passes = residuals(result, telemetry, vehicle), chosen_passes(result)
    figure = Figure(
        figsize=(max(8.5, 1.5 * len(passes) + 2.8), 2.1 * max(len(found), 1) + 0.9),
        layout="constrained",
    )
    widths = [2.0 if len(passes) < 4 else 1.0] * len(passes) + [1.3]
    grid = figure.subplots(
        max(len(found), 1), len(passes) + 1, sharey=True, squeeze=False, width_ratios=widths
    )
    for row, (sensor, (names, value)) in zip(grid, found.items(), strict=False):
        shown = np.clip(value, -SHOWN_SIGMAS, SHOWN_SIGMAS)
        for axes, number in zip(row, passes, strict=False):
            at = np.flatnonzero(result["pass_of"].values == number)
            t = result["time"].values[at]
            for k, name in enumerate(names):
                label = (
                    named(name) if np.isfinite(value[:, k]).any() else f"{named(name)}: left out"
                )
                axes.plot(
                    (t - t[0]) / 60, shown[at, k], ".", ms=4, color=COLOURS[k % 8], label=label
                )
            axes.axhspan(-1, 1, color=COLOURS[7], alpha=0.2, lw=0)
        row[0].set_ylabel(f"{sensor}{_unused(result, sensor)}\nresidual (sigma)", fontsize=8)
        row[-2].legend(
            fontsize=7,
            ncols=2 if len(names) > 4 else 1,
            loc="center left",
            bbox_to_anchor=(1.0, 0.5),
            frameon=False,
            handletextpad=0.1,
            columnspacing=0.4,
        )
        _distribution(row[-1], shown[np.isfinite(value)])
    for axes, number in zip(grid[0], passes, strict=False):
        axes.set_title(
            clock_text(result, result["time"].values[result["pass_of"].values == number][0]),
            fontsize=8,
        )
    for axes in grid[-1, :-1]:
        axes.set_xlabel("time (min)", fontsize=8)
    grid[-1, -1].set_xlabel("readings", fontsize=8)
    for axes in grid.ravel():
        axes.tick_params(labelsize=8)
        axes.set_ylim(-1.05 * SHOWN_SIGMAS, 1.05 * SHOWN_SIGMAS)
    left = (
        f", {SHOWN} of {result.sizes['pass_id']} passes" if result.sizes["pass_id"] > SHOWN else ""
    )
    figure.suptitle(
        titled(f"Readings less what the motion predicts{left}", result.attrs.get("synthetic")),
        fontsize=10,
    )
    return figure


def _unused(result: xr.Dataset, sensor: str) -> str:
    used = {
        "gyro": bool(result.attrs.get("gyro_used")),
        "panels": result.attrs.get("source") == "panels",
        "Sun sensors": result.attrs.get("source") == "sun_sensor",
    }
    return "" if used[sensor] else " (not used)"


def _distribution(axes: Any, value: np.ndarray) -> None:
    edges = np.linspace(-SHOWN_SIGMAS, SHOWN_SIGMAS, 25)
    axes.hist(
        value, edges, histtype="stepfilled", orientation="horizontal", color=COLOURS[0], alpha=0.5
    )
    x = np.linspace(-SHOWN_SIGMAS, SHOWN_SIGMAS, 200)
    axes.plot(
        len(value) * (edges[1] - edges[0]) * np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi),
        x,
        color=COLOURS[6],
        lw=1,
    )
    far, expected = np.mean(np.abs(value) > BEYOND), 2 * ndtr(-BEYOND)
    axes.set_title(
        f"{far:.1%} beyond {BEYOND:g} sigma\n(of noise alone: {expected:.1%})", fontsize=7
    )
