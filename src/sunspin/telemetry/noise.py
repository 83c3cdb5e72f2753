"""Noise of panel readings: estimated from the file's readings below zero, or assumed if there are too few of these."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sunspin.vehicle import Vehicle

HALF_NORMAL_MEDIAN = 0.6745
"""Half of the values of a normal distribution lie within this many sigma of its mean."""

LEAST_NEGATIVE = 8
"""Smallest number of readings below zero from which noise is estimated; its sigma is then known to a third."""

ASSUMED_SHARE = 0.03
"""Noise of a panel reading, as a share of full Sun, if the vehicle file states none and the readings show none. The value is
cautious: the vehicle files of this package state 0.007 (the example of `sunspin init`), 0.01 (skCUBE) and 0.02 (Philae)."""

DARK_FROM = "estimated from readings below zero"
ASSUMED_FROM = "assumed: the vehicle file states none and the readings show none"
"""Origin of a noise that the vehicle file does not state, as results name it."""

WILD = 20.0
"""A largest reading of a sample above this many times the median one is not light but a wrapped count, a fill value or a defect."""

BRIGHT_QUANTILE = 0.9
"""Quantile of the samples' largest readings that counts as the reading of a bright sample; the few above it may be spikes."""

NEGATIVE_SIGMAS = 5.0
"""Readings down to minus this many sigma are noise of a dark panel; lower ones are errors."""

NEGATIVE_SHARE = 0.05
"""Without a stated noise, the noise is estimated first from readings below zero of at most this share of full light. If these are
few, no lower reading counts as noise."""

ROUNDS = 4
"""Iterations in which the estimated noise sets the limit of the readings from which it is estimated. They bring a noise that starts
at a third of its size to within 5 %."""


CONVERTERS = (2**16, 2**24, 2**32)
"""Counts of converters whose negative numbers appear as large ones."""

NEAR_FULL, FAR_FROM_FULL = 0.95, 0.5
"""Readings above the first share of a converter's counts are negative numbers if no other is above the second share."""

LEAST_WRAPPED = 3
"""Different readings near full scale; a single one is a fill value or saturation."""


LARGEST_COUNTS = tuple(2.0**bits - 1 for bits in (8, 10, 12, 14, 16))
"""Largest counts of common converters."""

JUST_BELOW, NEAR = 0.98, 0.7
"""Readings above the first share of the largest count are compared in number with those at it; some readings must lie above the
second: else the largest count is a fill value."""

LEAST_SATURATED, LEAST_NEAR = 5, 3
"""Smallest number of readings at the largest count, and of readings near it."""


def find_wrapped_counts(values: np.ndarray) -> int | None:
    """Return the counts of the converter if whole numbers near its full scale look like negative ones; None if none do."""
    known = values[np.isfinite(values)]
    for full in CONVERTERS:
        high = np.unique(known[(known > NEAR_FULL * full) & (known < full)])
        low = known[known <= NEAR_FULL * full]
        is_whole = bool((known == np.round(known)).all())
        if len(high) >= LEAST_WRAPPED and is_whole and known.max() < full and len(low):
            return full if low.max() < FAR_FROM_FULL * full else None
    return None


def describe_saturation(values: np.ndarray, columns: list[str]) -> tuple[str, ...]:
    """Return a sentence on columns whose readings pile up at the largest count of a converter; none if there are none.

    Parameters
    ----------
    values : (n, n_column), unit of the file
    columns : list of str
        Their names.
    """
    known = values[np.isfinite(values)]
    largest = known.max(initial=0.0)
    if largest not in LARGEST_COUNTS or not (known == np.round(known)).all():
        return ()
    at_end = np.count_nonzero(values == largest, axis=0)
    below = values < largest
    # of a rotating panel whose largest reading happens to be that count, more readings lie just below it than at it
    just_below = np.count_nonzero(below & (values >= JUST_BELOW * largest), axis=0)
    near = np.count_nonzero(below & (values >= NEAR * largest), axis=0)
    piled = (at_end >= LEAST_SATURATED) & (at_end > just_below) & (near >= LEAST_NEAR)
    if not piled.any():
        return ()
    names = ", ".join(f"{columns[k]!r} ({at_end[k]})" for k in np.flatnonzero(piled))
    bits = int(largest + 1).bit_length() - 1
    return (
        f"readings pile up at {largest:.0f}, the largest count of {bits} bits, in column {names}: the converter is saturated "
        "there and the light is stronger than they say, or they are fill values",
    )


def dark_noise(values: npt.ArrayLike, least: int = LEAST_NEGATIVE) -> float | None:
    """Return one sigma of a reading, estimated from the median of the readings below zero.

    Readings below zero come from panels in the dark, whose noise is symmetric about zero.

    Parameters
    ----------
    values : (n, n_panel), in any unit; values that are not finite are left out
    least : int
        Smallest number of readings below zero. Files whose negative readings were cut to zero have fewer.

    Returns
    -------
    float or None
        In the unit of the values; None if there are fewer than `least` readings below zero.
    """
    known = np.asarray(values, dtype=np.float64)
    below = -known[np.isfinite(known) & (known < 0)]
    return float(np.median(below)) / HALF_NORMAL_MEDIAN if len(below) >= max(1, least) else None


def assumed_noise(values: npt.ArrayLike) -> float:
    """Return the assumed noise of a reading: `ASSUMED_SHARE` of a bright reading; NaN if no panel is lit.

    Parameters
    ----------
    values : (n, n_panel), in any unit; values that are not finite are left out

    Returns
    -------
    float, in the unit of the values
    """
    bright = bright_reading(values)
    return ASSUMED_SHARE * bright if np.isfinite(bright) else float("nan")


def bright_reading(values: npt.ArrayLike) -> float:
    """Return the largest panel reading of a bright sample (quantile `BRIGHT_QUANTILE` over samples); infinite if no panel is lit.

    Parameters
    ----------
    values : (n, n_panel), in any unit; values that are not finite are left out
    """
    known = np.asarray(values, dtype=np.float64)
    largest = np.where(np.isfinite(known), known, 0.0).max(axis=1, initial=0.0)
    lit = largest[largest > 0]
    return float(np.quantile(lit, BRIGHT_QUANTILE)) if len(lit) else float("inf")


def lowest_reading(vehicle: Vehicle, values: np.ndarray) -> float | np.ndarray:
    """Return the lowest reading that can be noise of a dark panel: (n_panel) from the stated noise, else one number for all.

    Parameters
    ----------
    values : (n, n_panel)
        Readings in the unit of the stated noise; values that are not finite are left out.
    """
    if (noise := vehicle.input_noise) is not None:
        return -NEGATIVE_SIGMAS * noise[: values.shape[1]]  # a file without panels has no columns
    below = -values[np.isfinite(values) & (values < 0)]
    if not len(below):
        return 0.0
    # full light: the largest reading of a bright sample, without wild ones
    largest = np.where(np.isfinite(values), values, 0.0).max(axis=1, initial=0.0)
    lit = largest[largest > 0]
    # most samples may lie in the Earth's shadow, where the largest reading is noise as well: lit ones are above it
    above_noise = lit[lit > NEGATIVE_SIGMAS * float(np.median(below)) / HALF_NORMAL_MEDIAN]
    lit = above_noise if len(above_noise) else lit
    full = 0.0
    if len(lit):
        full = float(np.quantile(lit[lit <= WILD * np.median(lit)], BRIGHT_QUANTILE))
    limit = NEGATIVE_SHARE * full
    if np.count_nonzero(below <= limit) < LEAST_NEGATIVE:
        return -min(NEGATIVE_SIGMAS * float(np.median(below)) / HALF_NORMAL_MEDIAN, limit)
    # fill values lie far below the noise: readings within the limit give the noise, which sets the next limit
    for _ in range(ROUNDS):
        near = below[below <= limit]
        limit = NEGATIVE_SIGMAS * float(np.median(near)) / HALF_NORMAL_MEDIAN
    return -limit
