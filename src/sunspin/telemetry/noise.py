"""The noise of a reading as the file itself tells it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

HALF_NORMAL_MEDIAN = 0.6745
"""Half of the values of a normal law lie within this many sigma of its middle."""

LEAST_NEGATIVE = 8
"""Readings below zero from which noise is told: its sigma is then good to a third."""


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
