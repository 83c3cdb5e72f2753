"""Time axis on which the pauses between passes that are far apart are drawn shorter."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.output.figures import COLOURS

APART = 0.6
"""Fraction of the whole time that pauses must take for them to be drawn shorter."""

SHORT_H = 1.5
"""Records shorter than this (h) have an axis in minutes."""

PAUSE_WIDTH = 0.04
"""Width of a shortened pause, as a fraction of all passes together."""

MOST_TICKS = 12
"""Passes whose begin is written on the axis."""

PAUSE = 10
"""Number of usual intervals between samples from which a gap is a pause."""


class TimeAxis(NamedTuple):
    """The position of each time on an axis.

    Attributes
    ----------
    hours : times (2 n) of begin and end of each pass, h; empty if no pause is shortened
    places : positions (2 n) of these times on the axis; empty if no pause is shortened
    in_min : whether the axis without shortened pauses is in minutes, not in hours
    """

    hours: np.ndarray
    places: np.ndarray
    in_min: bool = False

    def x(self, hours: np.ndarray) -> np.ndarray:
        """Return the positions on the axis of times (h)."""
        if self.hours.size:
            return np.interp(hours, self.hours, self.places)
        return hours * (60 if self.in_min else 1)


def find_gaps(hours: np.ndarray) -> np.ndarray:
    """Return the indices of the samples that follow a pause; `hours`: sorted times (n) of the samples."""
    steps = np.diff(hours)
    return np.flatnonzero(steps > PAUSE * np.median(steps)) + 1 if steps.size else np.zeros(0, int)


def build_time_axis(time_s: np.ndarray) -> TimeAxis:
    """Return the time axis for samples at these times (s): with shortened pauses if they take more than `APART` of the time."""
    hours = np.sort(np.asarray(time_s, dtype=np.float64)) / 3600
    after_pauses = find_gaps(hours)  # indices
    pauses = hours[after_pauses] - hours[after_pauses - 1]
    span = float(np.ptp(hours)) if hours.size else 0.0
    if not pauses.size or pauses.sum() < APART * span:
        return TimeAxis(np.zeros(0), np.zeros(0), span < SHORT_H)
    passes = np.split(hours, after_pauses)
    # a pass of one sample has the length 1e-6 h and ends 1e-9 h later, so that positions increase with time
    lengths = np.array([max(times[-1] - times[0], 1e-6) for times in passes])
    begins = np.cumsum(lengths + PAUSE_WIDTH * lengths.sum()) - lengths
    ends = [end for times in passes for end in (times[0], times[-1] + 1e-9)]
    return TimeAxis(np.array(ends), np.stack([begins, begins + lengths], axis=1).ravel())


def label_time_axis(axes: Any, data: xr.Dataset, time_axis: TimeAxis) -> None:
    """Write the title of a time axis; if pauses are shortened, also the UTC at which passes begin, and shade the pauses."""
    epoch = data.attrs.get("epoch_utc")
    if not time_axis.hours.size:
        unit = "min" if time_axis.in_min else "h"
        axes.set_xlabel(f"time ({unit}) since {epoch or 'the first sample'}")
        return
    begins, places = time_axis.hours[::2], time_axis.places[::2]  # time (h) and position of begins
    labelled = [0]  # passes whose begin is written: each far enough from the last one
    for k in range(1, len(places)):
        if places[k] - places[labelled[-1]] > (places[-1] - places[0]) / MOST_TICKS:
            labelled.append(k)
    time_zero = np.datetime64(str(epoch or "1970-01-01").removesuffix("Z"), "s")
    utc = time_zero + np.round(3600 * begins[labelled]).astype("timedelta64[s]")
    texts = [str(time)[:16].replace("T", "\n") for time in utc]
    # the year is written if passes are of different years
    first_character = 0 if len({text[:4] for text in texts}) > 1 else len("2026-")
    axes.set_xticks(places[labelled], [text[first_character:] for text in texts])
    for end, begin in zip(time_axis.places[1:-1:2], time_axis.places[2::2], strict=True):
        axes.axvspan(end, begin, color=COLOURS[7], alpha=0.12, lw=0, zorder=0)
    longest = 60 * float(np.diff(time_axis.hours.reshape(-1, 2), axis=1).max())
    text = f"the longest is {longest:.3g} min; grey: pauses, shortened"
    axes.set_xlabel(f"UTC at which each pass begins ({text})")
