"""Whether panel readings and the vehicle file are in one unit: mA read as A, or a noise in mW beside powers in W."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sunspin.telemetry.noise import BRIGHT_QUANTILE
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import panel_power

UNITS = {"power_W": "W", "current_A": "A"}

BEYOND = 30.0
"""Full Sun as read over as stated, or its inverse: nothing but a wrong unit or a wrong gain makes it more. At Jupiter it is 27."""

THOUSANDS = 4.0
"""A ratio within this factor of a power of 1000 is that power."""

BRIGHTEST = 200
"""Samples that are looked at."""

FITS = 0.15
"""Median misfit (Delta) of the brightest samples up to which the Sun made them, and not noise in the dark."""

DISTINCT, LIT_SHARE = 10, 0.2
"""Sunlight has at least so many different readings, and usually two panels above this share of the largest: counts of noise have
not."""

LEAST_SAMPLES = 5

FINEST = 1e5
"""Readings over their noise, which words of 16 bits hold: more is another unit."""

OTHER_UNIT = "one of them is in another unit"

SHUFFLES = 99
"""Of noise in the dark no panel knows of the others. Sunlight must fit better than each of so many random orders of its readings
among the panels, which noise does in one file of a hundred, however small."""

SHUFFLED, BRIGHT_SHARE = 60, 0.3
"""Samples of which this is asked, at most: the brightest of those above this part of what is bright."""


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


def panel_unit(vehicle: Vehicle, value: np.ndarray) -> WrongUnit | None:
    """The wrong unit of panel readings (n, n_panel): of their scale against the gains, or of the stated noise; None if neither is
    wrong."""
    form, unit = vehicle.telemetry, UNITS[vehicle.telemetry.quantity]
    value = np.where(np.isfinite(value), value, 0.0)
    largest = value.max(axis=1, initial=0.0)
    if np.count_nonzero(largest > 0) < LEAST_SAMPLES:
        return None
    if vehicle.gain_unit == unit and (wrong := _against_gains(vehicle, value, largest)):
        return wrong
    full = float(np.quantile(largest[largest > 0], BRIGHT_QUANTILE))
    limits = {"noise": form.noise, "lit_threshold": form.lit_threshold}
    above = [key for key, limit in limits.items() if limit is not None and full < limit]
    if above and _sunlit(vehicle, value, largest):
        key = above[0]
        what = f"the brightest samples ({full:.3g} {unit}) show the Sun but do not reach the stated {key} ({limits[key]:g} {unit})"
        scales = "scale, voltage_scale" if form.has_voltages else "scale"
        return WrongUnit(f"{what}: {OTHER_UNIT}", "telemetry", f"{scales} or {key}")
    if form.noise is not None and full > FINEST * form.noise:
        times = f"more than {FINEST:g} times the stated noise ({form.noise:g})"
        what = f"readings of {full:.3g} are {times}, which no telemetry resolves"
        return WrongUnit(f"{what}: {OTHER_UNIT}", "telemetry", "scale or noise")
    return None


def _against_gains(vehicle: Vehicle, value: np.ndarray, largest: np.ndarray) -> WrongUnit | None:
    """The wrong scale of readings (n, n_panel), if full Sun is far from the gains."""
    form, gains = vehicle.telemetry, vehicle.input_gains
    share = float(np.quantile((value / gains).max(axis=1)[largest > 0], BRIGHT_QUANTILE))
    if 1 / BEYOND < share < BEYOND:
        return None
    bright = _brightest(value, largest)
    light = panel_power(vehicle, vehicle.response_in().best(bright)[0])
    brightness = (bright * light).sum(axis=1) / np.maximum((light**2).sum(axis=1), 1e-300)
    ratio = float(np.median(brightness))
    if 1 / BEYOND < ratio < BEYOND or (ratio < 1 and not _sunlit(vehicle, value, largest)):
        return None
    step = round(np.log10(ratio) / 3)
    exact = step != 0 and 1 / THOUSANDS < ratio / 1000.0**step < THOUSANDS
    times = f"{1000.0 ** abs(step):g}" if exact else f"{max(ratio, 1 / ratio):.2g}"
    stated = f"{float(gains.max()):.3g} {UNITS[form.quantity]}"
    what = (
        f"the brightest samples read about {times} times {'more' if ratio > 1 else 'less'} than the stated full signal "
        f"of a panel ({stated}): a wrong unit"
    )
    if form.has_voltages:  # currents or voltages may be at fault
        return WrongUnit(what, "telemetry", "scale or voltage_scale")
    scale = float(f"{form.scale * 1000.0**-step:.6g}") if exact else None
    return WrongUnit(what, "telemetry", "scale", scale)


def _brightest(value: np.ndarray, largest: np.ndarray) -> np.ndarray:
    """The brightest samples, without the very brightest, which may be spikes."""
    order = np.argsort(-largest, kind="stable")
    return value[order[: min(BRIGHTEST, max(LEAST_SAMPLES, len(order) // 2))]]


def _sunlit(vehicle: Vehicle, value: np.ndarray, largest: np.ndarray) -> bool:
    """Whether the Sun made the brightest of these readings: they fit directions, and better as they stand than in each of many
    random orders among the panels, with noise that is alike in the readings' unit, and in parts of each panel's gain."""
    bright = _brightest(value, largest)
    two = np.median((bright > LIT_SHARE * bright.max(axis=1, keepdims=True)).sum(axis=1)) >= 2
    if len(vehicle.inputs) <= 3 or not two or len(np.unique(bright)) < DISTINCT:
        return False
    best = vehicle.response_in().best
    if not float(np.median(best(bright)[1])) < FITS:
        return False
    order = np.argsort(-largest, kind="stable")[:SHUFFLED]
    floor = BRIGHT_SHARE * float(np.quantile(largest, BRIGHT_QUANTILE))
    seen = np.maximum(value[order[largest[order] > floor]], 0.0)
    rng, gains = np.random.default_rng(0), vehicle.input_gains
    for unit in (np.ones_like(gains), gains)[: 1 if np.ptp(gains) == 0 else 2]:
        shuffled = rng.permuted(np.tile(seen / unit, (SHUFFLES, 1)), axis=1) * unit
        misfit = best(np.concatenate([seen, shuffled]))[1].reshape(-1, len(seen))
        square = np.mean(misfit**2, axis=1)
        if not square[0] < square[1:].min():
            return False
    return True
