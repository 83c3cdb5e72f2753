"""Whether panel readings and the vehicle file are in one unit: mA read as A, or a noise in mW beside powers in W."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import panel_power

UNITS = {"power_W": "W", "current_A": "A"}

BEYOND = 30.0
"""Full Sun as read over as stated, or its inverse: nothing but a wrong unit or a wrong gain makes it more. At Jupiter it is 27."""

THOUSANDS = 4.0
"""A ratio within this factor of a power of 1000 is that power."""

BRIGHTEST = 200
"""Samples that are looked at."""

BRIGHT_QUANTILE = 0.9
"""Of the samples' largest readings: what the panels give in full Sun, spikes apart."""

FITS = 0.15
"""Median misfit (Delta) of the brightest samples up to which the Sun made them, and not noise in the dark."""

DISTINCT, LIT_SHARE = 10, 0.2
"""Sunlight has at least so many different readings, and usually two panels above this share of the largest: counts of noise have
not."""

STEADY = 0.43
"""Width of the middle 80 % of the brightest samples' brightness, over the median, up to which the Sun made them. Sunlight is as
bright in one sample as in the next: with the Earth's light or a tenth of noise the width is 0.05 to 0.3, of four faces up to 0.41.
Noise in the dark has 0.45 to 0.97; cut off at zero, its misfit alone looks like the Sun's in every second file."""

LEAST_SAMPLES = 5

SHUFFLES = 99
"""Of noise in the dark no panel knows of the others. Sunlight must fit better than each of so many orders of the same readings
among panels, as noise does in one file of a hundred, whatever its size: of few samples the numbers above say too little."""

SHUFFLED = 40
"""Samples, of the brightest, of which this is asked."""


class WrongUnit(NamedTuple):
    """What the readings show, and the key of the vehicle file to change: its table, its name, the value it should have (None: not
    known)."""

    what: str
    table: str
    key: str
    value: float | None = None

    def __str__(self) -> str:
        return self.at("")

    def at(self, line: str) -> str:
        """The sentence, with a line of the file named in it."""
        do = f"set {self.key} = {self.value:.6g}" if self.value is not None else f"check {self.key}"
        return f"{self.what}; {do} under [{self.table}]{line} of the vehicle file"


Solver = Callable[[Vehicle, np.ndarray], tuple[np.ndarray, np.ndarray]]


def panel_unit(vehicle: Vehicle, value: np.ndarray, directions: Solver) -> WrongUnit | None:
    """The wrong unit of panel readings (n, n_panel), or None; `directions` finds the Sun and its misfit, as `best_directions`."""
    known = np.where(np.isfinite(value), value, 0.0)
    largest = known.max(axis=1, initial=0.0)
    if np.count_nonzero(largest > 0) < LEAST_SAMPLES:
        return None
    full = float(np.quantile(largest[largest > 0], BRIGHT_QUANTILE))
    return _against_gains(vehicle, known, largest, directions) or _against_noise(vehicle, known, largest, full, directions)


def _brightest(known: np.ndarray, largest: np.ndarray) -> np.ndarray:
    """The brightest samples, the very brightest, which may be spikes, apart."""
    order = np.argsort(-largest, kind="stable")
    return known[order[: min(BRIGHTEST, max(LEAST_SAMPLES, len(order) // 2))]]


def _brightness(vehicle: Vehicle, bright: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """How bright (n) the Sun is that made these readings, over what is stated."""
    model = panel_power(vehicle, sun)
    return (bright * model).sum(axis=1) / np.maximum((model**2).sum(axis=1), 1e-300)


def _sunlit(vehicle: Vehicle, bright: np.ndarray, directions: Solver) -> bool:
    """Whether the Sun made these readings: panels agree on a direction, and samples on how bright it is; noise in the dark does not
    let them."""
    two = np.median((bright > LIT_SHARE * bright.max(axis=1, keepdims=True)).sum(axis=1)) >= 2
    sun, misfit = directions(vehicle, bright)
    low, middle, high = np.quantile(_brightness(vehicle, bright, sun), [0.1, 0.5, 0.9])
    agree = float(np.median(misfit)) < FITS and high - low < STEADY * middle
    several = len(vehicle.inputs) > 3 and bool(two) and len(np.unique(bright)) >= DISTINCT
    return bool(several and agree) and _in_order(vehicle, bright[:SHUFFLED], directions)


def _in_order(vehicle: Vehicle, bright: np.ndarray, directions: Solver) -> bool:
    """Whether readings (n, n_panel) fit one Sun better as they stand than in any of many random orders among the panels: of noise
    that is alike in the readings' unit, and of noise alike in parts of each panel's gain."""
    rng = np.random.default_rng(0)
    for unit in (1.0, vehicle.input_gains):
        turned = rng.permuted(np.tile(bright / unit, (SHUFFLES, 1)), axis=1) * unit
        every = np.concatenate([bright, turned])
        sun, misfit = directions(vehicle, every)
        off = _unlike(_brightness(vehicle, every, sun), misfit, len(bright))
        if off[0] >= off[1:].min():
            return False
    return True


def _unlike(brightness: np.ndarray, misfit: np.ndarray, size: int) -> np.ndarray:
    """By how much sets of `size` samples (sets x size) miss one Sun, which panels and samples see alike."""
    bright = brightness.reshape(-1, size)
    middle = np.median(bright, axis=1, keepdims=True)
    apart = (bright / np.where(middle > 0, middle, 1.0) - 1) ** 2
    return np.mean(np.minimum(misfit.reshape(-1, size) ** 2 + apart, 1.0), axis=1)


def _against_gains(vehicle: Vehicle, known: np.ndarray, largest: np.ndarray, directions: Solver) -> WrongUnit | None:
    form = vehicle.telemetry
    unit = UNITS[form.quantity]
    if vehicle.gain_unit != unit:
        return None
    share = float(np.quantile((known / vehicle.input_gains).max(axis=1)[largest > 0], BRIGHT_QUANTILE))
    if 1 / BEYOND < share < BEYOND:
        return None
    bright = _brightest(known, largest)
    ratio = float(np.median(_brightness(vehicle, bright, directions(vehicle, bright)[0])))
    if 1 / BEYOND < ratio < BEYOND or (ratio < 1 and not _sunlit(vehicle, bright, directions)):
        return None
    key = "scale or voltage_scale" if form.has_voltages else "scale"
    step = round(np.log10(ratio) / 3)
    exact = step != 0 and 1 / THOUSANDS < ratio / 1000.0**step < THOUSANDS
    times = f"{1000.0 ** abs(step):g}" if exact else f"{max(ratio, 1 / ratio):.2g}"
    more = "more" if ratio > 1 else "less"
    stated = f"{float(vehicle.input_gains.max()):.3g} {unit}"
    what = f"the brightest samples read about {times} times {more} than the stated full signal of a panel ({stated}): a wrong unit"
    factor = 1000.0**-step if exact else 1 / ratio
    sure = exact and not form.has_voltages  # else currents or voltages may be at fault
    return WrongUnit(what, "telemetry", key, float(f"{form.scale * factor:.6g}") if sure else None)


def _against_noise(
    vehicle: Vehicle, known: np.ndarray, largest: np.ndarray, full: float, directions: Solver
) -> WrongUnit | None:
    form = vehicle.telemetry
    unit = UNITS[form.quantity]
    above = {"noise": form.noise, "lit_threshold": form.lit_threshold}
    low = [key for key, limit in above.items() if limit is not None and full < limit]
    if not low:
        return None
    if not _sunlit(vehicle, _brightest(known, largest), directions):
        return None
    what = f"the brightest samples ({full:.3g} {unit}) show the Sun but do not reach the stated {low[0]} ({above[low[0]]:g} {unit})"
    scales = "scale, voltage_scale" if form.has_voltages else "scale"
    return WrongUnit(what + ": one of them is in another unit", "telemetry", f"{scales} or {low[0]}")
