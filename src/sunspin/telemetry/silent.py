"""Lost panels: they never read anything although readings of the other panels show that the Sun was on them.

In full Sun the readings of the other panels leave only directions in which a silent panel would be lit. A misalignment of a few
degrees cannot explain that, for any set of impossible illumination patterns. A battery that limits the current could: it lowers the
readings of the sample, too. With a battery, however, the estimated Sun jumps at these samples towards the silent panel and back;
with a lost panel its path stays smooth.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc  # importing scipy.stats takes longer than estimating a short pass

from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import misalignment_signal_sigma, panel_power
from sunspin.vehicle.response.planes import sphere

DIRECTIONS = 4000
"""Trial directions of the Sun, evenly spread, 3 degrees apart."""

ERROR = 0.06
"""Error of a reading, as a share of full Sun: from the Earth's light, the gain, and half the distance between trial directions."""

QUIET_SIGMAS = 4.0
"""A panel is silent if its readings are below so many sigmas of noise."""

DARK = 0.05
"""Share of full Sun below which a panel counts as dark."""

CLEAR_CHI2 = 10.0
"""Decrease of chi-square, in at least one sample, from which a panel is taken as lost. In 70 files with misaligned panels, none of
them lost, the largest decrease was below 3."""

UNEXPLAINED, UNEXPLAINED_SHARE = 1e-3, 0.1
"""A sample whose chi-square is less probable than the first number is not explained by the loss either. If there are more of these
than the second number times the samples that miss the panel, the cause is the battery or something else."""

SMOOTHER_RATIO, ROUGHER_RATIO = 0.8, 2.0
"""Limits on the bending of the Sun's path if the panel is lost, relative to its bending if the battery dims the samples. Above the
second limit the panel is not lost, below the first it is. In between, the panel is lost if the path can be followed from sample to
sample, or if dimmed samples would hardly look so by chance."""

FOLLOWED_CHORD, CHANCE_LIMIT = 0.5, 0.1
"""Mean bend from sample to sample (a chord of the unit sphere) below which a path can be followed, and the limit on that chance."""

MOST, CHUNK = 3000, 500
"""Largest number of samples used, evenly chosen (a day at 1 Hz must not take minutes), and samples computed at once."""


def find_lost_panels(
    vehicle: Vehicle, t_s: np.ndarray, relative: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """Return the panels (n_panel) that are lost; where panels share inputs, the inputs.

    Panels are declared lost one after the other, the one with the clearest evidence first.

    Parameters
    ----------
    t_s : (n,) s
    relative : (n, n_panel)
        Readings over gains, 1 at full Sun; NaN without a reading.
    noise : (n_panel,)
        One sigma of a reading in the unit of the gains, divided by the same brightness of full Sun as `relative`.
    """
    gains = vehicle.input_gains
    lost = np.zeros(len(gains), dtype=bool)
    # complete samples with some panel lit
    lit = np.isfinite(relative).all(axis=1) & (np.nan_to_num(relative) > DARK).any(axis=1)
    t_s, readings = t_s[lit], relative[lit]
    silent = (readings < np.maximum(DARK, QUIET_SIGMAS * noise / gains)).all(axis=0)
    stride = max(1, -(-len(readings) // MOST))
    t_s, readings = t_s[::stride], readings[::stride]
    # with throttled inputs the battery may limit any sample, so no sample is known to be in full Sun
    if vehicle.throttled or silent.all() or not len(readings):
        return lost
    light = (
        panel_power(vehicle, sphere(DIRECTIONS)) / gains
    )  # model of the readings for each trial direction
    # error of a reading, as a share of full Sun, with the misalignments that the vehicle file states
    sigma = np.sqrt(ERROR**2 + (misalignment_signal_sigma(vehicle) ** 2 + noise**2) / gains**2)
    while (candidates := np.flatnonzero(silent & ~lost)).size:
        fits = {k: _fit_without(k, readings, light, sigma, lost) for k in candidates}
        clearest = max(candidates, key=lambda k: fits[k].evidence)
        fit = fits[clearest]
        if fit.evidence < CLEAR_CHI2:
            break
        if _explained_by_battery(clearest, fit, t_s, readings, light, sigma, lost):
            break
        lost[clearest] = True
    return lost


class SunFit(NamedTuple):
    """Fit of the Sun in each sample (n) without a silent panel.

    `sun`: index of the best trial direction; `square`: chi-square; `unexplained`: not explained without the panel either;
    `missing`: explained, and clearly better without the panel, which should have been lit; `decrease` of chi-square without the
    panel.
    """

    sun: np.ndarray
    square: np.ndarray
    unexplained: np.ndarray
    missing: np.ndarray
    decrease: np.ndarray

    @property
    def evidence(self) -> float:
        """Largest decrease of chi-square of a sample that misses the panel; 0 if too many samples are unexplained."""
        if self.unexplained.sum() > UNEXPLAINED_SHARE * self.missing.sum():
            return 0.0
        return float(self.decrease[self.missing].max(initial=0.0))


def _fit_without(
    k: int, readings: np.ndarray, light: np.ndarray, sigma: np.ndarray, lost: np.ndarray
) -> SunFit:
    """Fit a trial direction to each sample of readings (n, n_panel) without panel `k` and without the panels `lost` (n_panel).

    `light` (n_direction, n_panel) is the model of the readings, `sigma` (n_panel) their error, both as shares of full Sun.
    """
    used = ~lost & (np.arange(len(lost)) != k)
    model = (light / sigma)[:, used]
    # chi-square that panel k adds by reading nothing, for each direction
    penalty = (np.maximum(light[:, k] - DARK, 0.0) / sigma[k]) ** 2
    n = len(readings)
    sun, best, decrease = np.empty(n, dtype=np.intp), np.empty(n), np.empty(n)
    for start in range(0, n, CHUNK):
        part = slice(start, start + CHUNK)
        measured = (readings[part] / sigma)[:, used]
        # |measured - model|^2 of each sample and direction, multiplied out
        square = (
            (measured**2).sum(axis=1)[:, None] - 2 * measured @ model.T + (model**2).sum(axis=1)
        )
        sun[part], best[part] = square.argmin(axis=1), square.min(axis=1)
        decrease[part] = (square + penalty).min(axis=1) - best[part]
    unexplained = chdtrc(used.sum(), best) < UNEXPLAINED
    return SunFit(sun, best, unexplained, ~unexplained & (decrease > CLEAR_CHI2), decrease)


def _explained_by_battery(
    k: int,
    fit: SunFit,
    t_s: np.ndarray,
    readings: np.ndarray,
    light: np.ndarray,
    sigma: np.ndarray,
    lost: np.ndarray,
) -> bool:
    """Return whether a battery that limits the current explains the samples that miss panel `k` as well as its loss does.

    Compares chi-squares, then how much the Sun's path bends under both explanations. If neither decides, the other samples show how
    often dimmed samples would miss the panel by chance.

    Parameters
    ----------
    fit : Fit
        Fit of the samples without panel `k`, at the times `t_s` (n, s).
    readings, light, sigma, lost
        As in `_fit_without`.
    """
    dimmed = _fit_dimmed((readings / sigma)[:, ~lost], (light / sigma)[:, ~lost])
    if (dimmed.square - fit.square)[fit.missing].sum() > CLEAR_CHI2:
        return False
    if len(t_s) > 2:  # a path of two samples does not bend
        bend_if_lost = _bend(t_s, fit.sun, fit.missing)
        bend_if_dimmed = _bend(t_s, dimmed.sun, fit.missing)
        bend_ratio = bend_if_lost / max(bend_if_dimmed, 1e-9)
        if bend_ratio > ROUGHER_RATIO:
            return True
        every_sample = np.ones(len(readings))
        dimmed_path_can_be_followed = _bend(t_s, dimmed.sun, every_sample) < FOLLOWED_CHORD * len(
            readings
        )
        # samples so close that the path can be followed would bend clearly more under a wrong loss: here they do not
        if bend_ratio < SMOOTHER_RATIO or dimmed_path_can_be_followed:
            return False
    # the path cannot be followed: how often would the remaining samples miss the panel, too, if they were dimmed as much?
    level = np.median(dimmed.brightness[fit.missing])
    control = level * readings[~fit.missing & ~fit.unexplained]
    share = _fit_without(k, control, light, sigma, lost).missing.mean() if len(control) else 1.0
    return share ** fit.missing.sum() > CHANCE_LIMIT


class DimmedFit(NamedTuple):
    """Fit of the Sun in each sample (n) if all its readings may be lowered by one factor.

    `sun`: index of the best trial direction; `square`: chi-square; `brightness`: that factor, 0 to 1.
    """

    sun: np.ndarray
    square: np.ndarray
    brightness: np.ndarray


def _fit_dimmed(readings: np.ndarray, model: np.ndarray) -> DimmedFit:
    """Fit a trial direction and a brightness to each sample of `readings` (n, n_panel), with the model (n_direction, n_panel).

    Both are in units of the error of a reading.
    """
    n = len(readings)
    sun, best, brightness = np.empty(n, dtype=np.intp), np.empty(n), np.empty(n)
    model_square = np.maximum((model**2).sum(axis=1), 1e-12)
    for start in range(0, n, CHUNK):
        part = slice(start, start + CHUNK)
        product = readings[part] @ model.T
        factor = np.clip(product / model_square, 0.0, 1.0)  # the best brightness for each direction
        # |reading - factor * model|^2, multiplied out
        square = (readings[part] ** 2).sum(axis=1)[:, None] + factor * (
            factor * model_square - 2 * product
        )
        sun[part], best[part] = square.argmin(axis=1), square.min(axis=1)
        brightness[part] = factor[np.arange(len(product)), sun[part]]
    return DimmedFit(sun, best, brightness)


def _bend(t_s: np.ndarray, sun: np.ndarray, which: np.ndarray) -> float:
    """Return by how much the Sun's path in the body bends at the samples `which` (n) and their neighbours, as a sum of chords.

    `sun` (n) are indices of trial directions. The change of velocity is multiplied by the shorter of the two adjacent intervals, so
    that a gap does not count as a bend.
    """
    with_neighbours = np.convolve(which, [1, 1, 1], "same") > 0
    step_s = np.maximum(np.diff(t_s), 1e-9)
    velocity = np.diff(sphere(DIRECTIONS)[sun], axis=0) / step_s[:, None]
    bend = np.linalg.norm(np.diff(velocity, axis=0), axis=1) * np.minimum(step_s[1:], step_s[:-1])
    return float(bend[with_neighbours[1:-1]].sum())
