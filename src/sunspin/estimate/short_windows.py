"""The rate in short windows of passes that no free body explains, as those of a controlled satellite.

Thrusters, and wheels whose speeds were not read, change the rate in another way than any free body. Over a few samples the change
is small, so each window is estimated as a pass by :func:`sunspin.estimate.rates.rates`.

The angular momentum of a free body, J omega + h with the inertia J and the momentum h of wheels of known speed, has the same size
in all windows. A torque acts if no motion fits the whole pass, most windows fit, and two sizes differ beyond their errors.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.estimate.model import Body
from sunspin.estimate.observe import middle_sample, take_samples, wheel_models
from sunspin.estimate.rates import rates
from sunspin.estimate.settings import RATES, RatesSettings
from sunspin.estimate.verdict import join_reasons
from sunspin.vehicle import Vehicle

WINDOW_SAMPLES = 7
"""Samples of a window, about. Passes of up to six samples are also tried without each of them, which takes four times as long."""

MOST_WINDOWS = 40
"""Windows of a file, at most: longer passes have longer windows. Each takes a second or two, with a magnetometer up to ten."""

FEWEST_WINDOWS = 3
"""Windows with a single solution that fits, at least, for a conclusion about a pass."""

LEAST_FITTING = 0.75
"""Share of the windows of a pass that must fit. If fewer do, readings are wrong, or the rate changes within a window."""

SIGMAS_APART = 4.0
"""Sigmas by which the sizes of the momentum in two windows must differ, for a rate that changes as no free body's does."""


def passes_for_windows(result: xr.Dataset) -> np.ndarray:
    """Return the indices of the passes of a result that do not fit; none if columns of the file are doubted.

    With wrong columns each window may fit, so the file is to be changed first.
    """
    return np.flatnonzero(~result["fits"].values & ("columns_doubt" not in result.attrs))


def rates_in_windows(
    vehicle: Vehicle,
    telemetry: xr.Dataset,
    result: xr.Dataset,
    settings: RatesSettings = RATES,
    **options: Any,
) -> xr.Dataset:
    """Return the result of `rates` with the rate in short windows of each pass that does not fit, and whether control explains it.

    Parameters
    ----------
    telemetry : Dataset
        The telemetry from which `result` was estimated.
    result : Dataset
        Of :func:`sunspin.estimate.rates.rates`; it is returned as it is if no pass asks for windows (:func:`passes_for_windows`).
    options
        Of `rates`: source, max_rate_rad_s, environment, calibration, torques, effort and workers.

    Returns
    -------
    Dataset
        Also has variables on `window`. `window_time` (s) is its middle sample, with `window_begin` and `window_end` (s),
        `window_pass` and `window_samples`. `window_omega_B` and `window_sigma_B` (rad/s) are those of the most probable solution
        there. `window_decided` and `window_why` say whether it is decided, or why not.
        attrs["controlled"] has a line for each pass whose rate changes as no free body's does; `why_not_decided` of the pass and
        attrs["verdict"] repeat it.
    """
    failed = passes_for_windows(result)
    counts = [int((result["pass_of"].values == k).sum()) for k in failed]  # of samples
    parts, sentences = [], {}
    for k, count in zip(failed, counts, strict=True):
        # the passes share the windows of a file by their samples
        most = max(FEWEST_WINDOWS, int(MOST_WINDOWS * count / sum(counts)))
        number = min(round(count / WINDOW_SAMPLES), most)
        if number < FEWEST_WINDOWS:
            continue
        t_s = result["time"].values[result["pass_of"].values == k]
        part = _windows_of(vehicle, telemetry, t_s, number, settings, options)
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
        join_reasons(text, sentences.get(k, ""))
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
    number: int,
    settings: RatesSettings,
    options: dict[str, Any],
) -> xr.Dataset | None:
    """Return estimates of a pass with samples at times `t_s` (n), s, cut into `number` windows; None if no window has a motion.

    The windows are equally long. The variables, on `window`, are those of :func:`rates_in_windows`. `options`: of `rates`.
    """
    time = telemetry["time"].values
    inside = (time >= t_s[0]) & (time <= t_s[-1])
    # `rates` cuts passes that are longer; a little is added, since rounding might make one window more
    longest_s = float(t_s[-1] - t_s[0]) / number * (1 + 1e-9)
    pass_settings = replace(settings.passes, longest_s=longest_s, longest_field_s=longest_s)
    try:
        result = rates(
            vehicle,
            take_samples(telemetry, np.flatnonzero(inside)),
            gap_s=float(t_s[-1] - t_s[0]) + 1.0,
            column_tests=False,
            settings=replace(settings, passes=pass_settings),
            **options,
        )
    except InputError:
        return None
    count = result.sizes["pass_id"]
    omega = np.stack([result[f"omega_{axis}"].values[:, 0] for axis in "xyz"], axis=1)
    sigma = np.stack([result[f"sigma_{axis}"].values[:, 0] for axis in "xyz"], axis=1)
    times = [result["time"].values[result["pass_of"].values == k] for k in range(count)]
    middle = [float(t[middle_sample(t)]) for t in times]
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
    """Return in words that the rate changes as no free body's does; empty if the windows do not show it.

    `windows`: of one pass. The sizes of the angular momentum are compared between all windows with a single solution that fits.
    """
    fits, sigma = windows["window_fits"].values, windows["window_sigma_B"].values
    use = np.flatnonzero(fits & windows["window_unique"].values & np.isfinite(sigma).all(axis=1))
    if len(use) < FEWEST_WINDOWS or fits.mean() < LEAST_FITTING:
        return ""
    body, omega = Body.of(vehicle), windows["window_omega_B"].values[use]
    covariance = sigma[use, :, None] ** 2 * np.eye(3)
    times = windows["window_time"].values[use]
    # rows that came late need not be in the order of time
    nearest_row = np.abs(telemetry["time"].values - times[:, None]).argmin(axis=1)
    fast = slow = 0
    # wheels without a measured speed may be held or coast: neither may explain the change
    for wheels in wheel_models(vehicle, telemetry).values():
        size, by_rate, by_inertia = body.momentum_size(omega, covariance, wheels[nearest_row])
        error = np.hypot(by_rate, by_inertia)
        # (window, window) differences in sigmas, and the pair with the largest one
        apart = (size[:, None] - size) / np.hypot(error[:, None], error)
        fast, slow = map(int, np.unravel_index(int(np.argmax(apart)), apart.shape))
        if not apart[fast, slow] > SIGMAS_APART:
            return ""
    high, low = np.degrees(np.linalg.norm(omega[[fast, slow]], axis=1))
    return (
        f"the rate changes as no free body's does ({low:.2g} and {high:.2g} deg/s within {abs(times[fast] - times[slow]):.0f} s): "
        "control, or wheels whose speeds are not given"
    )
