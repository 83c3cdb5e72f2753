"""Panels that never read anything although the Sun must have been on them: their neighbours say where it was.

At full light the readings of the others leave only directions, some samples only directions on one side, in which a silent panel
would be lit. No turn of a few degrees hides that, whichever lit patterns geometry forbids.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtrc  # scipy.stats takes longer to import than a short pass to estimate

from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import panel_power, turned_sigma
from sunspin.vehicle.response.protocol import sphere

DIRECTIONS = 4000
"""Directions of the Sun that are tried, 3 degrees apart."""

ERROR = 0.06
"""Of each reading, as a share of full Sun: the Earth's light, the gain, and half of the distance between directions."""

QUIET_SIGMAS = 4.0
"""Readings within so many sigmas of nothing are noise."""

DARK = 0.05
"""Share of full Sun below which a panel is as good as dark."""

CLEARLY = 10.0
"""Squared residuals by which some sample must fit better without a panel before that is lost: of 70 files of turned panels,
all whole, none came to 3."""

UNEXPLAINED, ODD_SHARE = 1e-3, 0.1
"""A sample less probable than this at full light is not explained by the loss either; where such are more than this share of those
that miss the panel, it is the battery that makes them dim, or something else."""

MOST, CHUNK = 3000, 500
"""Samples that are looked at, evenly chosen: a day at 1 Hz must not take minutes; and how many at once."""


def lost(vehicle: Vehicle, relative: np.ndarray, noise: float) -> np.ndarray:
    """Which panels (inputs) are lost, one after the other, the clearest first.

    Parameters
    ----------
    relative : (n, n_panel)
        Readings over gains, 1 at full Sun; NaN where there is none.
    noise : float
        One sigma of a reading in the unit of the gains over full Sun.
    """
    gains = vehicle.input_gains
    found = np.zeros(len(gains), dtype=bool)
    read = relative[np.isfinite(relative).all(axis=1)]
    read = read[(read > DARK).any(axis=1)]
    silent = (read < np.maximum(DARK, QUIET_SIGMAS * noise / gains)).all(axis=0)
    read = read[:: max(1, -(-len(read) // MOST))]
    if vehicle.throttled or silent.all() or not len(read):  # the battery may limit any sample: there is no full light
        return found
    light, sigma = panel_power(vehicle, sphere(DIRECTIONS)) / gains, _sigma(vehicle, noise)
    while (left := np.flatnonzero(silent & ~found)).size:
        gain = [_gain(read, light, sigma, found, k) for k in left]
        if max(gain) < CLEARLY:
            break
        found[left[np.argmax(gain)]] = True
    return found


def _sigma(vehicle: Vehicle, noise: float) -> np.ndarray:
    """Of each input's reading (n_panel), as a share of full Sun; panels may be turned by the sigmas that the file states."""
    return np.sqrt(ERROR**2 + (turned_sigma(vehicle) ** 2 + noise**2) / vehicle.input_gains**2)


def _gain(read: np.ndarray, light: np.ndarray, sigma: np.ndarray, found: np.ndarray, k: int) -> float:
    """By how much some sample fits better without panel `k`, those `found` being left out; nothing where others fit badly
    even so."""
    others = ~found & (np.arange(len(found)) != k)
    model, extra = (light / sigma)[:, others], (np.maximum(light[:, k] - DARK, 0.0) / sigma[k]) ** 2
    without, gain = np.empty(len(read)), np.empty(len(read))
    for start in range(0, len(read), CHUNK):
        part = slice(start, start + CHUNK)
        seen = (read[part] / sigma)[:, others]
        square = (seen**2).sum(axis=1)[:, None] - 2 * seen @ model.T + (model**2).sum(axis=1)
        without[part] = square.min(axis=1)
        gain[part] = (square + extra).min(axis=1) - without[part]
    odd = chdtrc(others.sum(), without) < UNEXPLAINED
    missing = gain[~odd & (gain > CLEARLY)]
    return float(missing.max(initial=0.0)) if odd.sum() <= ODD_SHARE * len(missing) else 0.0
