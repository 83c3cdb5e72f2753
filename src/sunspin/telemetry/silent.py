"""Panels that never read anything although the Sun must have been on them: their neighbours say where it was.

At full light the readings of the others leave only directions, some samples only directions on one side, in which a silent panel
would be lit. No turn of a few degrees hides that, whichever lit patterns geometry forbids. A battery that dims such a sample leaves
less light, too; but then the Sun would have sprung aside to the panel and back, and without it goes on as before.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc  # scipy.stats takes longer to import than a short pass to estimate

from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import misalignment_signal_sigma, panel_power
from sunspin.vehicle.response.planes import sphere

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

SMOOTHER, ROUGHER = 0.8, 2.0
"""Of the bends of the Sun's path in the body, if a panel is lost, to those if a battery dims the samples that miss it: beyond the
latter it is not lost, nor within both if the path bends too much to be followed and dimmed samples would look so by chance."""

FOLLOWED, BY_CHANCE = 0.5, 0.1
"""Mean bend from sample to sample, as a chord, of a path that can be followed; and such a chance."""

MOST, CHUNK = 3000, 500
"""Samples that are looked at, evenly chosen: a day at 1 Hz must not take minutes; and how many at once."""


def lost(vehicle: Vehicle, t_s: np.ndarray, relative: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Which panels (inputs) are lost, one after the other, the clearest first.

    Parameters
    ----------
    t_s : (n,) s
    relative : (n, n_panel)
        Readings over gains, 1 at full Sun; NaN where there is none.
    noise : (n_panel,)
        One sigma of a reading in the unit of the gains over full Sun.
    """
    gains = vehicle.input_gains
    gone = np.zeros(len(gains), dtype=bool)
    of_sun = np.isfinite(relative).all(axis=1) & (np.nan_to_num(relative) > DARK).any(axis=1)
    t_s, read = t_s[of_sun], relative[of_sun]
    silent = (read < np.maximum(DARK, QUIET_SIGMAS * noise / gains)).all(axis=0)
    every = max(1, -(-len(read) // MOST))
    t_s, read = t_s[::every], read[::every]
    if (
        vehicle.throttled or silent.all() or not len(read)
    ):  # the battery may limit any sample: there is no full light
        return gone
    light = panel_power(vehicle, sphere(DIRECTIONS)) / gains
    # of a reading, as a share of full Sun; panels may be turned by the sigmas that the file states
    sigma = np.sqrt(ERROR**2 + (misalignment_signal_sigma(vehicle) ** 2 + noise**2) / gains**2)
    while (left := np.flatnonzero(silent & ~gone)).size:
        fits = {k: _without(k, read, light, sigma, gone) for k in left}
        k = max(left, key=lambda panel: fits[panel].clear)
        if fits[k].clear < CLEARLY or _by_battery(k, fits[k], t_s, read, light, sigma, gone):
            break
        gone[k] = True
    return gone


class Fit(NamedTuple):
    """Of readings (n) without a panel: where the Sun was, squared residuals, which are not explained so, which miss the panel, and
    by how much they fit better than with it."""

    sun: np.ndarray
    square: np.ndarray
    odd: np.ndarray
    missing: np.ndarray
    gain: np.ndarray

    @property
    def clear(self) -> float:
        """By how much some sample fits better; nothing where others fit badly even so."""
        few = self.odd.sum() <= ODD_SHARE * self.missing.sum()
        return float(self.gain[self.missing].max(initial=0.0)) if few else 0.0


def _without(
    k: int, read: np.ndarray, light: np.ndarray, sigma: np.ndarray, gone: np.ndarray
) -> Fit:
    """Readings (n, P) without panel `k`, those `gone` being left out."""
    others = ~gone & (np.arange(len(gone)) != k)
    model, extra = (light / sigma)[:, others], (np.maximum(light[:, k] - DARK, 0.0) / sigma[k]) ** 2
    sun, best, gain = np.empty(len(read), dtype=np.intp), np.empty(len(read)), np.empty(len(read))
    for start in range(0, len(read), CHUNK):
        part = slice(start, start + CHUNK)
        seen = (read[part] / sigma)[:, others]
        square = (seen**2).sum(axis=1)[:, None] - 2 * seen @ model.T + (model**2).sum(axis=1)
        sun[part], best[part] = square.argmin(axis=1), square.min(axis=1)
        gain[part] = (square + extra).min(axis=1) - best[part]
    odd = chdtrc(others.sum(), best) < UNEXPLAINED
    return Fit(sun, best, odd, ~odd & (gain > CLEARLY), gain)


def _by_battery(
    k: int,
    lost: Fit,
    t_s: np.ndarray,
    read: np.ndarray,
    light: np.ndarray,
    sigma: np.ndarray,
    gone: np.ndarray,
) -> bool:
    """Whether a battery that dims the samples which miss panel `k` says it as well."""
    sun, square, level = _dimmed((read / sigma)[:, ~gone], (light / sigma)[:, ~gone])
    if (square - lost.square)[lost.missing].sum() > CLEARLY:
        return False
    bends = _bend(t_s, lost.sun, lost.missing) / max(_bend(t_s, sun, lost.missing), 1e-9)
    if (
        bends > ROUGHER
        or bends < SMOOTHER
        or _bend(t_s, sun, np.ones(len(read))) < FOLLOWED * len(read)
    ):
        return bends > ROUGHER
    dimmed = np.median(level[lost.missing]) * read[~lost.missing & ~lost.odd]
    alike = _without(k, dimmed, light, sigma, gone).missing.mean() if len(dimmed) else 1.0
    return alike ** lost.missing.sum() > BY_CHANCE


def _dimmed(seen: np.ndarray, model: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the Sun was (n), squared residuals (n) and brightness (n), if readings (n, P) may be dimmed alike, all in sigmas."""
    sun, best, level = np.empty(len(seen), dtype=np.intp), np.empty(len(seen)), np.empty(len(seen))
    size = np.maximum((model**2).sum(axis=1), 1e-12)
    for start in range(0, len(seen), CHUNK):
        part = slice(start, start + CHUNK)
        along = seen[part] @ model.T
        bright = np.clip(along / size, 0.0, 1.0)
        square = (seen[part] ** 2).sum(axis=1)[:, None] + bright * (bright * size - 2 * along)
        sun[part], best[part] = square.argmin(axis=1), square.min(axis=1)
        level[part] = bright[np.arange(len(along)), sun[part]]
    return sun, best, level


def _bend(t_s: np.ndarray, sun: np.ndarray, which: np.ndarray) -> float:
    """By how much the Sun's path over directions (n) bends at the samples of `which` (n) and next to them; a gap bends nothing."""
    near = np.convolve(which, [1, 1, 1], "same") > 0
    step_s = np.maximum(np.diff(t_s), 1e-9)
    change = np.diff(np.diff(sphere(DIRECTIONS)[sun], axis=0) / step_s[:, None], axis=0)
    bend = np.linalg.norm(change, axis=1) * np.minimum(step_s[1:], step_s[:-1])
    return float(bend[near[1:-1]].sum())
