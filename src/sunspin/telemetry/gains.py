"""Gains of the panels from their readings: in full Sun all samples have the same brightness, for any illumination pattern.

The brightness of a sample is the factor between its readings and the model at the best-fitting direction. Wrong gains make it
depend on the direction. The gains that make it constant are estimated by reweighted least squares, with a prior around the values
of the vehicle file.

In the Earth's light, differences of opposite panels are used. For any light source, the difference of the light on the two sides
of a plane is linear in its normal. The Earth therefore adds a vector to that of the Sun and changes no gain. If the panels do not
cover all directions, an oblique Sun looks like a dim one, and gains are not determined.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit  # scipy.stats takes longer to import than a short pass

from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import brightness, opposite_panels

PRIOR_SIGMA = 0.1
"""Relative uncertainty of a gain whose sigma the vehicle file does not state, as a prior of the fit. It is wide enough for a dead
string of cells: with 0.05 the errors of simulated cases with all faults were half as large again."""

READING_SIGMA = 0.02
"""Relative error of a reading in addition to that of its gain, if the scatter of brightness is not known: panels have different
temperatures, and edges cast shadows."""

WIDE_SIGMA = 0.2
"""Relative uncertainty of a gain that is estimated with the motion (:mod:`sunspin.estimate.terms.panels`). The full scale of
a vehicle file may be wrong by a third without a contradiction in brightness. A wide prior costs little, because 40 samples of a
motion determine the gain to a few percent."""

FEWEST_SAMPLES, MOST_SAMPLES = 15, 1500
"""Smallest number of samples for a fit, and largest number used, evenly chosen."""

FREEDOM = 4.0
"""Degrees of freedom of Student's distribution of brightness: about one sample in ten may be an outlier."""

STEPS, STEP = 6, 1e-4
"""Gauss-Newton iterations, and step of the finite differences in the logarithm of a gain."""

COMMON_SHARE = 0.5
"""Error common to all gains, as a share of the scatter of brightness. If negative readings are cut to zero, the noise of dark
panels has a mean. The differences subtract it from the lit panels (0.3 % at a noise of 0.5 %)."""

FAINT = 0.03
"""Earth's light, as a share of full Sun, up to which it is not estimated, because the noise of the panels hides it. Up to this
share gains are fitted without differences of opposite panels. The differences add the noise of dark panels, which is biased if
readings are cut at zero: with them the gain of a panel that was seldom lit was wrong by 3 %."""

WEAK_SIGMAS = 3.0
"""A panel is weak if its gain is lower than those of the others by so many sigmas of fit and vehicle file together."""

WEAK_SIGMA, WEAK_CHANCE = 0.03, 1e-3
"""If the file states no sigma: smallest relative uncertainty of a gain, and the probability by Student's distribution, given the
scatter of the other panels' gains, below which a gain is too low. Test: 220 files with gains that scatter by 5 or 8 % at an albedo
of 0.3, and 80 panels weaker by 15 %. No sound panel was named, and 49 weak ones were. Without the errors of the fit in the scatter
the counts were 18 and 69."""


class Gains(NamedTuple):
    """Estimated gains of the panels.

    `factor` (n_panel): estimated gain over that of the vehicle file; `covariance` (n_panel, n_panel) of the factors; `spread`:
    relative scatter of the brightness of samples in full Sun, None if not determined; `source`: origin of the gains in words;
    `weak` (n_panel): the gain is too low compared with those of the other panels.
    """

    factor: np.ndarray
    covariance: np.ndarray
    spread: float | None
    source: str
    weak: np.ndarray

    @property
    def sigma(self) -> np.ndarray:
        """Standard deviation (n_panel) of each factor."""
        return np.sqrt(np.diag(self.covariance))


def covers_all_directions(vehicle: Vehicle, lost: np.ndarray) -> bool:
    """Return whether the Sun in any direction lights three panels with independent normals that are not `lost` (n_panel)."""
    response = vehicle.response_in()
    sun_B, lit = response.regions()
    return all(
        panels.sum() >= 3 and response.rank(panels, direction) == 3
        for direction, panels in zip(sun_B, lit & ~lost, strict=True)
    )


def scale_gains(vehicle: Vehicle, factor: np.ndarray) -> Vehicle:
    """Return the vehicle with the gains of each input's panels multiplied by `factor` (n_input)."""
    gain = np.array([panel.gain for panel in vehicle.panels])
    for channel, channel_factor in zip(vehicle.inputs, factor, strict=True):
        gain[list(channel.panels)] *= channel_factor
    panels = zip(vehicle.panels, gain.tolist(), strict=True)
    return replace(vehicle, panels=tuple(replace(panel, gain=value) for panel, value in panels))


def stated_sigmas(vehicle: Vehicle) -> np.ndarray:
    """Return the relative uncertainty (n_input) of each input's gain as the vehicle file states it; NaN if it does not.

    A channel has the uncertainty of its least known panel.
    """
    sigma = np.full(len(vehicle.panels), np.nan)
    for k, panel in enumerate(vehicle.panels):
        for key in ("gain_W", "gain_A", "relative_gain"):
            fact = vehicle.facts.get(f"panel.{panel.name}.{key}")
            stated = fact is not None and isinstance(fact.sigma, float) and fact.sigma > 0
            if stated and panel.gain > 0:
                sigma[k] = fact.sigma / panel.gain
    return np.array([sigma[list(channel.panels)].max() for channel in vehicle.inputs])


def prior_sigmas(vehicle: Vehicle, unstated: float = PRIOR_SIGMA) -> np.ndarray:
    """Return the relative uncertainty (n_input) of each input's gain; `unstated` if the vehicle file states none."""
    sigma = stated_sigmas(vehicle)
    return np.where(np.isnan(sigma), unstated, sigma)


def estimate_gains(
    vehicle: Vehicle,
    value: np.ndarray,
    full: float,
    dark: np.ndarray,
    lost: np.ndarray,
    earth_light: float,
) -> Gains:
    """Estimate the gains from samples in full Sun; if they are not determined, return those of the vehicle file.

    The gains are not determined if inputs are throttled, samples are few, or the panels do not cover all directions. If only the
    dark panels, which may be dead, leave directions uncovered, the fit still serves to find weak panels.

    Parameters
    ----------
    value : (n, n_panel)
        Readings of the samples in full Sun, in the unit of the gains.
    full : float
        Brightness of full Sun with the gains of the vehicle file, by which the fitted gains are scaled.
    dark : (n_panel)
        The panel never reads anything: it is dead, or was never in the Sun.
    lost : (n_panel)
        The panel is dark, and the other panels show that the Sun was on it.
    earth_light : float
        Earth's light on a panel that looks at the Earth, as a share of full Sun.
    """
    reason = "the panels do not cover all directions, so a low signal may only mean an oblique Sun"
    covered = covers_all_directions(vehicle, lost)
    if vehicle.throttled:
        reason = "inputs are throttled, so no sample need be in full Sun"
    elif covered and len(value) < FEWEST_SAMPLES:
        reason = f"fewer than {FEWEST_SAMPLES} samples in full Sun"
    unchanged = Gains(
        factor=np.ones(len(dark)),
        covariance=np.diag(prior_sigmas(vehicle, READING_SIGMA) ** 2),
        spread=None,
        source=f"not determined by the data: {reason}",
        weak=np.zeros(len(dark), bool),
    )
    if vehicle.throttled or len(value) < FEWEST_SAMPLES or not covered:
        return unchanged
    value = value[:: -(-len(value) // MOST_SAMPLES)]
    fit = _fit_brightness(vehicle, value, earth_light)
    weak = _find_weak_panels(vehicle, fit.log, fit.covariance[:-1, :-1]) & ~dark
    # a dark panel may be dead, which the fit does not know
    if not covers_all_directions(vehicle, dark):
        return unchanged._replace(weak=weak)
    # a factor is that of the fit times the common brightness: log + level
    factor = np.exp(fit.log + fit.level) / full
    with_level = np.column_stack([np.eye(len(fit.log)), np.ones(len(fit.log))])
    covariance = with_level @ fit.covariance @ with_level.T + (COMMON_SHARE * fit.spread) ** 2
    source = f"estimated from {len(value)} samples in full Sun"
    return Gains(factor, covariance * np.outer(factor, factor), fit.spread, source, weak)


class _BrightnessFit(NamedTuple):
    """Gains that make the brightness of samples in full Sun constant.

    `log` (n_panel): logarithm of each gain over that of the vehicle file; `level`: logarithm of the common brightness;
    `covariance` (n_panel + 1, n_panel + 1) of both; `spread`: scatter of the logarithm of the brightness.
    """

    log: np.ndarray
    level: float
    covariance: np.ndarray
    spread: float


def _fit_brightness(vehicle: Vehicle, value: np.ndarray, earth_light: float) -> _BrightnessFit:
    """Fit gains and a common brightness to samples in full Sun, with the readings `value` (n, n_panel).

    Each iteration is a Gauss-Newton step with Student's weights at the scatter of the current residuals. `earth_light` is that of
    `estimate_gains`: if it is not faint, differences of opposite panels are used.
    """
    paired = earth_light > FAINT and not vehicle.channels
    pairs = np.argwhere(opposite_panels(vehicle.response_in().facing_B)) if paired else []

    def log_brightness(log: np.ndarray) -> np.ndarray:
        """Return the logarithm of the brightness (n) for logarithms `log` (n_panel) of the factors on the gains."""
        gains, light = vehicle.input_gains * np.exp(log), value.copy()
        for i, j in pairs:
            difference = value[:, i] / gains[i] - value[:, j] / gains[j]
            light[:, i] = gains[i] * np.maximum(difference, 0.0)
        return np.log(np.maximum(brightness(scale_gains(vehicle, np.exp(log)), light), 1e-6))

    # the gains have a prior, the level has none
    prior = prior_sigmas(vehicle)
    log, precision = np.zeros(len(prior)), np.diag(np.append(prior**-2, 0.0))
    level = float(np.median(log_brightness(log)))
    for _ in range(STEPS):
        bright = log_brightness(log)
        columns = [log_brightness(log + STEP * unit) - bright for unit in np.eye(len(log))]
        jacobian = np.column_stack([np.stack(columns, axis=1) / STEP, -np.ones(len(value))])
        residual = bright - level
        # the median absolute deviation of a normal distribution is sigma / 1.4826
        spread = max(1.4826 * float(np.median(np.abs(residual))), 1e-3)
        weight = (FREEDOM + 1) / (FREEDOM + (residual / spread) ** 2) / spread**2
        covariance = np.linalg.inv(jacobian.T @ (weight[:, None] * jacobian) + precision)
        slope = jacobian.T @ (weight * residual) + precision @ np.append(log, 0.0)
        step = covariance @ slope
        log, level = np.clip(log - step[:-1], -1.0, 1.0), level - step[-1]
    return _BrightnessFit(log, level, covariance, spread)


def _find_weak_panels(vehicle: Vehicle, log: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the panels (n_panel) whose gain is too low compared with those of the others.

    `log` (n_panel) are the logarithms of the estimated factors, with their `covariance`. With three panels or fewer none is weak:
    the scatter of the others cannot be estimated.
    """
    n, variance = len(log), np.diag(covariance)
    stated = stated_sigmas(vehicle)
    weak = np.zeros(n, dtype=bool)
    if n <= 3:
        return weak
    for k in range(n):
        weight = np.where(np.arange(n) == k, 0.0, 1 / (WEAK_SIGMA**2 + variance))
        weight /= weight.sum()
        # weighted mean of the other panels minus this one: positive if the gain is low
        contrast = weight - (np.arange(n) == k)
        deficit, fit_sigma = contrast @ log, float(np.sqrt(contrast @ covariance @ contrast))
        if np.isnan(stated[k]):
            # scatter of the other n - 1 gains around their mean, with n - 2 degrees of freedom
            scatter = np.sqrt(weight @ (log - weight @ log) ** 2 * (n - 1) / (n - 2))
            by_chance = -stdtrit(n - 2, WEAK_CHANCE) * scatter
            by_fit = WEAK_SIGMAS * np.hypot(fit_sigma, WEAK_SIGMA)
            weak[k] = deficit > np.hypot(by_fit, by_chance)
        else:
            weak[k] = deficit > WEAK_SIGMAS * np.hypot(fit_sigma, stated[k])
    return weak
