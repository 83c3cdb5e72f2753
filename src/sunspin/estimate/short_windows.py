"""The rate against time in short windows of passes that no free body explains: what an operator gets of a controlled satellite.

Thrusters, and wheels whose speeds were not read, change the rate as no free body's does. Over a few samples the change is small,
and the method of :func:`sunspin.estimate.rates.rates` fits: windows are passes.

The angular momentum of a free body has the same size in all windows. With the inertia J and the momentum h of wheels whose speeds
are known it is |J omega + h|. Something acts on the body if no motion fits the whole pass, most windows fit, and the sizes in two
of them differ beyond their errors.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.estimate.model import Body
from sunspin.estimate.observe import take_samples, wheel_models
from sunspin.estimate.rates import rates
from sunspin.estimate.settings import RATES, RatesSettings
from sunspin.vehicle import Vehicle

SAMPLES = 7
"""Samples of a window, about. Passes of up to six samples are also tried without each of them, which takes four times as long."""

MOST_WINDOWS = 40
"""Windows of a file, at most: longer passes have longer windows. Each takes a second or two."""

FEWEST_WINDOWS = 3
"""Fewest windows of a pass that fit with a single solution, for anything to be said of how its rate changes."""

MOST_FIT = 0.75
"""Share of the windows of a pass that fit. Where fewer do, the readings are at fault, or the rate changes within a window."""

SIGMAS = 4.0
"""Sigmas by which the sizes of the momentum in two windows differ, for the rate to change as no free body's does."""


def rates_in_windows(
    vehicle: Vehicle,
    telemetry: xr.Dataset,
    result: xr.Dataset,
    settings: RatesSettings = RATES,
    **options: Any,
) -> xr.Dataset:
    """Return the result of `rates` with the rate in short windows of each pass that does not fit, and what they say of control.

    Parameters
    ----------
    telemetry : Dataset
        That of which `result` was estimated.
    result : Dataset
        Of :func:`sunspin.estimate.rates.rates`; it is returned as it is if all passes fit, or if columns of the file are doubted:
        each window may fit with wrong columns.
    options
        Of `rates`: source, max_rate_rad_s, environment, calibration, torques, effort and workers.

    Returns
    -------
    Dataset
        Also has variables on `window`. `window_time` (s) is its middle sample, with `window_begin` and `window_end` (s),
        `window_pass` and `window_samples`. `window_omega_B` and `window_sigma_B` (rad/s) are those of the most probable solution
        there. `window_decided` and `window_why` say whether it is decided, or why not.
        attrs["controlled"] has a line for each pass whose rate changes as no free body's does; `why_not_decided` of the pass and
        attrs["verdict"] say so too.
    """
    failed = np.flatnonzero(~result["fits"].values)
    if "columns_doubt" in result.attrs:
        return result
    parts, sentences = [], {}
    share = [int((result["pass_of"].values == k).sum()) for k in failed]
    for k, count in zip(failed, share, strict=True):
        most = max(FEWEST_WINDOWS, int(MOST_WINDOWS * count / sum(share)))
        pieces = min(round(count / SAMPLES), most)
        if pieces < FEWEST_WINDOWS:
            continue
        t_s = result["time"].values[result["pass_of"].values == k]
        part = _windows_of(vehicle, telemetry, t_s, pieces, settings, options)
        if part is None:
            continue
        part["window_pass"] = "window", np.full(part.sizes["window"], result["pass_id"].values[k])
        parts.append(part)
        if words := _as_no_free_body(vehicle, telemetry, part):
            sentences[k] = words
    if not parts:
        return result
    windows = xr.concat(parts, "window")
    why = [
        f"{text}; {sentences[k]}" if k in sentences else text
        for k, text in enumerate(result["why_not_decided"].values.astype(str))
    ]
    notes = [f"pass {result['pass_id'].values[k]}: {words}" for k, words in sentences.items()]
    attrs = {}
    if notes:
        attrs["controlled"] = "\n".join(notes)
        attrs["verdict"] = "\n".join([str(result.attrs["verdict"]), *notes])
    result = result.assign(windows.data_vars).assign(why_not_decided=("pass_id", why))
    return result.assign_attrs(attrs)


def _windows_of(
    vehicle: Vehicle,
    telemetry: xr.Dataset,
    t_s: np.ndarray,
    pieces: int,
    settings: RatesSettings,
    options: dict[str, Any],
) -> xr.Dataset | None:
    """Return variables on `window` of a pass with samples at times t_s (n), cut evenly; None if no window has a motion."""
    time = telemetry["time"].values
    inside = (time >= t_s[0]) & (time <= t_s[-1])
    # a hair more than the even length, which rounding might cut once more
    longest = float(t_s[-1] - t_s[0]) / pieces * (1 + 1e-9)
    of_windows = replace(settings.passes, longest_s=longest, longest_field_s=longest)
    try:
        result = rates(
            vehicle,
            take_samples(telemetry, np.flatnonzero(inside)),
            gap_s=float(t_s[-1] - t_s[0]) + 1.0,
            column_tests=False,
            settings=replace(settings, passes=of_windows),
            **options,
        )
    except InputError:
        return None
    count = result.sizes["pass_id"]
    omega = np.stack([result[f"omega_{axis}"].values[:, 0] for axis in "xyz"], axis=1)
    sigma = np.stack([result[f"sigma_{axis}"].values[:, 0] for axis in "xyz"], axis=1)
    times = [result["time"].values[result["pass_of"].values == k] for k in range(count)]
    middle = [float(t[np.argmin(np.abs(t - (t[0] + t[-1]) / 2))]) for t in times]
    return xr.Dataset(
        {
            "window_time": ("window", middle),
            "window_begin": ("window", [float(t[0]) for t in times]),
            "window_end": ("window", [float(t[-1]) for t in times]),
            "window_samples": ("window", [len(t) for t in times]),
            "window_omega_B": (("window", "axis"), omega),
            "window_sigma_B": (("window", "axis"), sigma),
            "window_speed_sigma": ("window", result["speed_sigma"].values),
            "window_decided": ("window", result["decided"].values),
            "window_unique": ("window", result["unique"].values),
            "window_fits": ("window", result["fits"].values),
            "window_why": ("window", result["why_not_decided"].values.astype(str)),
        }
    )


def _as_no_free_body(vehicle: Vehicle, telemetry: xr.Dataset, windows: xr.Dataset) -> str:
    """Return in words that the rate changes as no free body's does; empty if a free body may do so, or the windows do not say."""
    fits, sigma = windows["window_fits"].values, windows["window_sigma_B"].values
    use = np.flatnonzero(fits & windows["window_unique"].values & np.isfinite(sigma).all(axis=1))
    if len(use) < FEWEST_WINDOWS or fits.mean() < MOST_FIT:
        return ""
    body, omega = Body.of(vehicle), windows["window_omega_B"].values[use]
    times = windows["window_time"].values[use]
    # rows that came late need not be in the order of time
    at = np.abs(telemetry["time"].values - times[:, None]).argmin(axis=1)
    extremes = None
    # wheels without a measured speed may be held or coast: none of that may explain the change
    for wheels in wheel_models(vehicle, telemetry).values():
        momentum = omega @ body.inertia + wheels[at]  # H = I w + h, in mean moments times rad/s
        size = np.linalg.norm(momentum, axis=1)
        along = momentum / np.maximum(size, 1e-12)[:, None]
        # |H| changes by H/|H| . (I dw) with the rate, and by H/|H| . (dI w) with one sigma of each error of the inertia
        by_inertia = np.einsum("ki,eij,kj->ke", along, body.errors, omega)
        error = np.sqrt(((along @ body.inertia * sigma[use]) ** 2).sum(1) + (by_inertia**2).sum(1))
        apart = (size[:, None] - size) / np.hypot(error[:, None], error)
        fast, slow = np.unravel_index(int(np.argmax(apart)), apart.shape)
        if not apart[fast, slow] > SIGMAS:
            return ""
        extremes = fast, slow
    assert extremes is not None
    fast, slow = extremes
    high, low = np.degrees(np.linalg.norm(omega[[fast, slow]], axis=1))
    return (
        f"the rate changes as no free body's does ({low:.2g} and {high:.2g} deg/s within {abs(times[fast] - times[slow]):.0f} s): "
        "control, or wheels whose speeds are not given"
    )
