"""An axis of time on which passes that lie far apart stand side by side."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.output.figures import COLOURS

APART = 0.6
"""Part of the whole time, in pauses, from which the pauses are drawn shorter."""

SHORT_H = 1.5
"""Shorter records have an axis in minutes."""

PAUSE_WIDTH, MOST_TICKS = 0.04, 12
"""A shortened pause is this part of all passes together; at most so many passes are named on the axis."""

PAUSE = 10
"""Usual steps between samples after which a pause begins."""


class Passes(NamedTuple):
    """Where times stand on an axis: `hours` of passes' ends -> `places`; both empty if time runs evenly, in h or in min."""

    hours: np.ndarray
    places: np.ndarray
    in_min: bool = False

    def x(self, hours: np.ndarray) -> np.ndarray:
        """Places of times (h)."""
        if self.hours.size:
            return np.interp(hours, self.hours, self.places)
        return hours * (60 if self.in_min else 1)


def long_gaps(hours: np.ndarray) -> np.ndarray:
    """Indices of the samples that a pause precedes."""
    steps = np.diff(hours)
    return np.flatnonzero(steps > PAUSE * np.median(steps)) + 1 if steps.size else np.zeros(0, int)


def passes_together(time_s: np.ndarray) -> Passes:
    """The axis for samples at these times."""
    hours = np.sort(np.asarray(time_s, dtype=np.float64)) / 3600
    cuts = long_gaps(hours)
    whole = float(np.ptp(hours)) if hours.size else 0.0
    if not cuts.size or (hours[cuts] - hours[cuts - 1]).sum() < APART * whole:
        return Passes(np.zeros(0), np.zeros(0), whole < SHORT_H)
    passes = np.split(hours, cuts)
    lengths = np.array([max(each[-1] - each[0], 1e-6) for each in passes])
    begins = np.cumsum(lengths + PAUSE_WIDTH * lengths.sum()) - lengths
    ends = [time for each in passes for time in (each[0], each[-1] + 1e-9)]
    return Passes(np.array(ends), np.stack([begins, begins + lengths], axis=1).ravel())


def time_axis(axes: Any, data: xr.Dataset, place: Passes) -> None:
    """Title of a time axis, and on one with shortened pauses the time at which each pass begins."""
    epoch = data.attrs.get("epoch_utc")
    if not place.hours.size:
        unit = "min" if place.in_min else "h"
        axes.set_xlabel(f"time ({unit}) since {epoch or 'the first sample'}")
        return
    begins, at = place.hours[::2], place.places[::2]
    shown = [0]
    for k in range(1, len(at)):
        if at[k] - at[shown[-1]] > (at[-1] - at[0]) / MOST_TICKS:
            shown.append(k)
    zero = np.datetime64(str(epoch or "1970-01-01").removesuffix("Z"), "s")
    utc = zero + np.round(3600 * begins[shown]).astype("timedelta64[s]")
    texts = [str(time)[:16].replace("T", "\n") for time in utc]
    begin = 5 if len({text[:4] for text in texts}) == 1 else 0  # the year, if they do not share it
    axes.set_xticks(at[shown], [text[begin:] for text in texts])
    for end, begin in zip(place.places[1:-1:2], place.places[2::2], strict=True):
        axes.axvspan(end, begin, color=COLOURS[7], alpha=0.12, lw=0, zorder=0)
    longest = 60 * float(np.diff(place.hours.reshape(-1, 2), axis=1).max())
    text = f"the longest is {longest:.3g} min; grey: pauses, shortened"
    axes.set_xlabel(f"UTC at which each pass begins ({text})")
