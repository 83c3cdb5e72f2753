"""How noisy a file's readings are: one sigma of a lit panel, and above which reading a panel counts as lit.

Taken from the file itself, so that telemetry noisier than the synthetic one is not read with the latter's figures: noise on dark
panels would otherwise light them, in patterns that the Sun cannot make.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from scipy.stats import chi2

from sunspin.telemetry.case import Case
from sunspin.telemetry.noise import HALF_NORMAL_MEDIAN
from sunspin.telemetry.sun import SunStatus, signals, sun_directions
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import lit_patterns

BRIGHT = 0.2
"""A panel that reads more than this part of the file's largest reading is in the Sun for certain."""

LEAST = 8
"""Readings needed for a sigma; it is then good to a third."""

DARK_SIGMAS = 4.0
"""A panel counts as lit above this many sigma of a dark one's reading: of a thousand dark readings none is taken for lit."""

MOST_OF_LARGEST = 0.1
"""The lit threshold is at most this part of the largest reading: what reads more on panels that should be dark is no noise, and
has to show as a lit pattern that no Sun makes."""

ROUGH_SIGMAS = 6.0
"""What lies beyond this many rough sigma is not noise: a reflection, a shadow, a wrong column."""

DIGITS = 3
"""Noise and threshold are rounded to so many: no machine's last bit changes a file's identity."""


@dataclass(frozen=True)
class ReadingNoise:
    """`lit`: one sigma of a lit panel's reading; `dark`: of a dark one's; `lit_threshold`; all in the unit of the readings.

    `told`: in words, where they come from.
    """

    lit: float
    dark: float
    lit_threshold: float
    told: str


def reading_noise(vehicle: Vehicle, telemetry: xr.Dataset, whole: np.ndarray) -> ReadingNoise:
    """Noise and lit threshold of a file; the vehicle's figures stand in where it holds too few samples.

    Parameters
    ----------
    whole : (n_time,) bool
        Samples in which nothing is known to shadow the panels.
    """
    dark, n_dark = dark_sigma(vehicle, signals(telemetry))
    own = vehicle.telemetry.lit_threshold or 0.0
    largest = float(np.nan_to_num(signals(telemetry)).max(initial=0.0))
    threshold = max(own, _rounded(min(DARK_SIGMAS * dark, MOST_OF_LARGEST * largest)))
    lit, n_lit = _lit_sigma(vehicle, telemetry, whole, threshold)
    unit = vehicle.gain_unit or ("W" if vehicle.telemetry.quantity == "power_W" else "A")
    told = (
        f"noise of a lit panel {lit:g} {unit}, from the misfit of {n_lit} samples with more than three lit panels"
        if n_lit >= LEAST
        else f"noise of a lit panel {lit:g} {unit}, the vehicle file's: too few samples to tell"
    )
    told += (
        f"; dark panels read 0 +- {dark:.2g} {unit} ({n_dark} readings), lit above {threshold:g} {unit}"
        if dark > 0
        else f"; dark panels read zero, lit above {threshold:g} {unit}"
    )
    return ReadingNoise(lit, dark, threshold, told)


def dark_sigma(vehicle: Vehicle, power: np.ndarray) -> tuple[float, int]:
    """One sigma of a dark panel's reading (zero where they read exactly zero or less), and from how many readings.

    Dark for certain is a panel that geometry never lights together with one that is bright.
    """
    together = np.zeros((len(vehicle.panels),) * 2, dtype=bool)
    for pattern in lit_patterns(vehicle):
        lit = np.array([name in pattern for name in vehicle.panel_names])
        together |= np.outer(lit, lit)
    known = np.where(np.isfinite(power), power, 0.0)
    bright = known > BRIGHT * known.max(initial=0.0)
    dark = (bright.astype(int) @ (~together).astype(int) > 0) & ~bright & np.isfinite(power)
    above = known[
        dark & (known > 0)
    ]  # half of the noise, also where negative readings were cut to zero
    if above.size < LEAST:
        return 0.0, int(dark.sum())
    sigma = float(np.median(above)) / HALF_NORMAL_MEDIAN
    return float(np.median(above[above < ROUGH_SIGMAS * sigma])) / HALF_NORMAL_MEDIAN, int(
        dark.sum()
    )


def _lit_sigma(
    vehicle: Vehicle, telemetry: xr.Dataset, whole: np.ndarray, threshold: float
) -> tuple[float, int]:
    """What the misfit leaves, rms: of L lit panels L - 3 are redundant, scale and direction being fitted. Of panels with noises of
    their own it is the median, their ratio being as stated."""
    sun = sun_directions(vehicle, telemetry, lit_threshold=threshold)
    checked = whole & (sun["status"].values == SunStatus.OK)
    noise = vehicle.input_noise
    if checked.sum() < LEAST:
        return 0.0 if noise is None else float(np.median(noise)), int(checked.sum())
    ratio = 1.0 if noise is None else np.sqrt(np.mean((noise / np.median(noise)) ** 2))
    size = np.linalg.norm(np.nan_to_num(signals(telemetry)[checked]), axis=1)
    freedom = sun["n_lit"].values[checked] - 3
    left = sun["delta"].values[checked] * size
    rough = float(np.median(left / np.sqrt(chi2.ppf(0.5, freedom))))
    sound = left < ROUGH_SIGMAS * rough * np.sqrt(freedom)
    sigma = float(np.sqrt((left[sound] ** 2).sum() / freedom[sound].sum()) / ratio)
    return _rounded(sigma), int(checked.sum())


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def _as_set(vehicle: Vehicle, found: ReadingNoise) -> ReadingNoise:
    """The same with the noise and the lit threshold that were set for this run, where they were."""
    form, keys = vehicle.telemetry, {one.key for one in vehicle.changes}
    for key, name, value in (
        ("noise", "lit", form.noise),
        ("lit_threshold", "lit_threshold", form.lit_threshold),
    ):
        if f"telemetry.{key}" in keys and value is not None:
            told = f"{found.told}; {key.replace('_', ' ')} set to {value:g} for this run"
            found = replace(found, **{name: value}, told=told)
    return found


def with_own_noise(case: Case, whole: np.ndarray) -> tuple[Case, ReadingNoise]:
    """The case with noise and lit threshold of its telemetry in its vehicle, so that every part uses them; noises of panels keep
    their stated ratio."""
    vehicle, form, stated = case.vehicle, case.vehicle.telemetry, case.vehicle.input_noise
    noise = _as_set(vehicle, reading_noise(vehicle, case.telemetry, whole))
    usual = 1.0 if stated is None else float(np.median(stated))
    common = noise.lit * ((form.noise or usual) / usual)
    form = replace(form, noise=common, lit_threshold=noise.lit_threshold)
    panels = tuple(
        replace(x, noise=x.noise and noise.lit * (x.noise / usual)) for x in vehicle.panels
    )
    copy = replace(case, vehicle=replace(vehicle, telemetry=form, panels=panels))
    copy.__dict__["telemetry"] = case.telemetry
    return copy, noise
