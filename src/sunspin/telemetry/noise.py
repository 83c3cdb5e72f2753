"""The noise of a reading: as the file itself shows it, and what is assumed where nothing does."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sunspin.vehicle import Vehicle

HALF_NORMAL_MEDIAN = 0.6745
"""Half of the values of a normal law lie within this many sigma of its middle."""

LEAST_NEGATIVE = 8
"""Readings below zero from which noise is told: its sigma is then good to a third."""


ASSUMED_SHARE = 0.03
"""Noise of a panel reading, as a share of full Sun, where the vehicle file states none and the readings show none. Cautious: the
vehicle files of this package state 0.007 (the example of `sunspin init`), 0.01 (skCUBE) and 0.02 (Philae)."""

DARK_FROM = "estimated from readings below zero"
ASSUMED_FROM = "assumed: the vehicle file states none and the readings show none"
"""Where a noise that is not stated comes from, in results."""

WILD = 20.0
"""A reading this many times the usual brightest one of a sample is no light: a wrapped count, a filler, a broken converter."""

BRIGHT_QUANTILE = 0.9
"""Of the samples' largest readings: what the panels give in full Sun, spikes apart."""

NEGATIVE_SIGMAS = 5.0
"""Values down to minus this many sigma are noise around zero and not an error: of the stated noise, or of the file's own."""

NEGATIVE_SHARE = 0.05
"""Without a stated noise, values below zero up to this part of full light show the noise; if few do, no lower value is noise."""

ROUNDS = 4
"""Times that the noise widens the limit within which it is looked for: from a third of its size it comes within 5 %."""


def dark_noise(values: npt.ArrayLike, least: int = LEAST_NEGATIVE) -> float | None:
    """One sigma of a reading, told by those below zero: panels in the dark, whose noise lies on both sides of it.

    Parameters
    ----------
    values : (n, n_panel), in any unit; what is not finite is left out
    least : int
        None is told with fewer readings below zero than this, as in files whose negative readings were cut to zero.

    Returns
    -------
    float or None, in the unit of the values
    """
    known = np.asarray(values, dtype=np.float64)
    below = -known[np.isfinite(known) & (known < 0)]
    return float(np.median(below)) / HALF_NORMAL_MEDIAN if len(below) >= max(1, least) else None


def assumed_noise(values: npt.ArrayLike) -> float:
    """Noise of a reading where nothing else gives it: `ASSUMED_SHARE` of what the panels read in full Sun; NaN where all are dark.

    Parameters
    ----------
    values : (n, n_panel), in any unit; what is not finite is left out

    Returns
    -------
    float, in the unit of the values
    """
    bright = bright_reading(values)
    return ASSUMED_SHARE * bright if np.isfinite(bright) else float("nan")


def bright_reading(values: npt.ArrayLike) -> float:
    """Return the largest reading of a bright sample; infinite where nothing is lit.

    Parameters
    ----------
    values : (n, n_panel), in any unit; what is not finite is left out
    """
    known = np.asarray(values, dtype=np.float64)
    largest = np.where(np.isfinite(known), known, 0.0).max(axis=1, initial=0.0)
    lit = largest[largest > 0]
    return float(np.quantile(lit, BRIGHT_QUANTILE)) if len(lit) else float("inf")


def lowest_reading(vehicle: Vehicle, values: np.ndarray) -> float | np.ndarray:
    """Return the lowest value that is still noise of a dark panel (or of each, if noise is stated)."""
    if (noise := vehicle.input_noise) is not None:
        return -NEGATIVE_SIGMAS * noise[: values.shape[1]]
    below = -values[np.isfinite(values) & (values < 0)]
    largest = np.where(np.isfinite(values), values, 0.0).max(axis=1, initial=0.0)
    lit = largest[largest > 0]
    if not len(below):
        return 0.0
    full = (
        float(np.quantile(lit[lit <= WILD * np.median(lit)], BRIGHT_QUANTILE)) if len(lit) else 0.0
    )
    limit = NEGATIVE_SHARE * full
    if np.count_nonzero(below <= limit) < LEAST_NEGATIVE:
        return -min(NEGATIVE_SIGMAS * float(np.median(below)) / HALF_NORMAL_MEDIAN, limit)
    # fill values lie apart: the noise of those within the limit sets the next limit
    for _ in range(ROUNDS):
        near = below[below <= limit]
        limit = NEGATIVE_SIGMAS * float(np.median(near)) / HALF_NORMAL_MEDIAN
    return -limit
