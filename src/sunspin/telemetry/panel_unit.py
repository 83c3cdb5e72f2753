"""Whether panel readings and the vehicle file are in one unit: mA read as A, or a noise in mW beside powers in W."""

from __future__ import annotations

from collections.abc import Callable
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


Solver = Callable[[Vehicle, np.ndarray], tuple[np.ndarray, np.ndarray]]


def panel_unit(vehicle: Vehicle, value: np.ndarray, directions: Solver) -> WrongUnit | None:
    """The wrong unit of panel readings (n, n_panel), or None; `directions` finds the Sun and its misfit, as `best_directions`."""
    known = np.where(np.isfinite(value), value, 0.0)
    largest = known.max(axis=1, initial=0.0)
    if np.count_nonzero(largest > 0) < LEAST_SAMPLES:
        return None
    full = float(np.quantile(largest[largest > 0], BRIGHT_QUANTILE))
    return _against_gains(vehicle, known, largest, directions) or _against_noise(
        vehicle, known, largest, full, directions
    )


def _brightest(known: np.ndarray, largest: np.ndarray) -> np.ndarray:
    """The brightest samples, the very brightest, which may be spikes, apart."""
    order = np.argsort(-largest, kind="stable")
    return known[order[: min(BRIGHTEST, max(LEAST_SAMPLES, len(order) // 2))]]


def _brightness(vehicle: Vehicle, bright: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """How bright (n) the Sun is that made these readings, over what is stated."""
    model = panel_power(vehicle, sun)
    return (bright * model).sum(axis=1) / np.maximum((model**2).sum(axis=1), 1e-300)


def _sunlit(vehicle: Vehicle, known: np.ndarray, largest: np.ndarray, directions: Solver) -> bool:
    """Whether the Sun made the brightest of these readings: their panels agree on a direction, which is the order's doing."""
    bright = _brightest(known, largest)
    two = np.median((bright > LIT_SHARE * bright.max(axis=1, keepdims=True)).sum(axis=1)) >= 2
    if len(vehicle.inputs) <= 3 or not two or len(np.unique(bright)) < DISTINCT:
        return False
    if not float(np.median(directions(vehicle, bright)[1])) < FITS:
        return False
    order = np.argsort(-largest, kind="stable")[:SHUFFLED]
    seen = known[
        order[largest[order] > BRIGHT_SHARE * float(np.quantile(largest, BRIGHT_QUANTILE))]
    ]
    return _in_order(vehicle, np.maximum(seen, 0.0), directions)


def _in_order(vehicle: Vehicle, seen: np.ndarray, directions: Solver) -> bool:
    """Whether readings (n, n_panel) fit directions better as they stand than in each of many random orders among the panels: with
    noise that is alike in the readings' unit, and with noise alike in parts of each panel's gain."""
    rng, gains = np.random.default_rng(0), vehicle.input_gains
    for unit in (np.ones_like(gains), gains)[: 1 if np.ptp(gains) == 0 else 2]:
        shuffled = rng.permuted(np.tile(seen / unit, (SHUFFLES, 1)), axis=1) * unit
        misfit = directions(vehicle, np.concatenate([seen, shuffled]))[1].reshape(-1, len(seen))
        off = np.mean(misfit**2, axis=1)
        if not off[0] < off[1:].min():
            return False
    return True


def _against_gains(
    vehicle: Vehicle, known: np.ndarray, largest: np.ndarray, directions: Solver
) -> WrongUnit | None:
    form = vehicle.telemetry
    unit = UNITS[form.quantity]
    if vehicle.gain_unit != unit:
        return None
    share = float(
        np.quantile((known / vehicle.input_gains).max(axis=1)[largest > 0], BRIGHT_QUANTILE)
    )
    if 1 / BEYOND < share < BEYOND:
        return None
    bright = _brightest(known, largest)
    ratio = float(np.median(_brightness(vehicle, bright, directions(vehicle, bright)[0])))
    if 1 / BEYOND < ratio < BEYOND or (
        ratio < 1 and not _sunlit(vehicle, known, largest, directions)
    ):
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
    if not _sunlit(vehicle, known, largest, directions):
        return None
    what = f"the brightest samples ({full:.3g} {unit}) show the Sun but do not reach the stated {low[0]} ({above[low[0]]:g} {unit})"
    scales = "scale, voltage_scale" if form.has_voltages else "scale"
    return WrongUnit(
        what + ": one of them is in another unit", "telemetry", f"{scales} or {low[0]}"
    )
