"""Gains of the panels from their readings: in full Sun all samples have one brightness, whichever panels are lit.

The brightness of a sample is the factor by which its readings exceed the model at the direction that fits them best. Gains that
are wrong make it depend on the direction; those with which it does not are found by reweighted least squares under a prior about
the vehicle file's values. In the Earth's light the difference of opposite panels counts: the difference of the light on the two
sides of a plane is linear in its normal for any source, so that the Earth adds a vector to the Sun's and changes no gain. Where
the panels do not look all around, an oblique Sun looks like a dim one, and gains are not determined.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit  # scipy.stats takes longer to import than a short pass

from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import brightness, opposite_panels

PRIOR_SIGMA, UNTOLD_SIGMA = 0.1, 0.02
"""Relative uncertainty of a gain whose sigma the vehicle file does not state, as a prior: wide enough for a string of cells that
is dead (with half of it twins with all faults missed by half as much again). And by how much one reading errs beside that where the
scatter of brightness tells nothing: faces of other temperatures, shadows of edges."""

UNKNOWN_SIGMA = 0.2
"""The same of a gain that is left to the motion to tell (:mod:`sunspin.estimate.rates.common_errors`): no brightness refutes a
vehicle file whose full scale is wrong by a third, and a wide prior costs little where 40 samples of a motion tell it to a few
percent."""

FEWEST, MOST = 15, 1500
"""Samples needed; and used, evenly chosen."""

FREEDOM = 4.0
"""Of the Student law of brightness: one sample in ten may be none of the Sun's."""

STEPS, STEP = 6, 1e-4
"""Gauss-Newton steps, and the step of the differences."""

COMMON_SHARE = 0.5
"""Error that all gains share, as a part of the scatter of brightness: where negative readings are cut to zero the noise of dark
panels has a mean, which the difference takes from the lit ones (0.3 % at a noise of 0.5 %)."""

FAINT = 0.03
"""Earth's light, as a share of full Sun, up to which it is not estimated, as the noise of panels hides it, and up to which gains
are fitted without differences of opposite panels. These add the noise of dark panels, which is biased where readings are cut at
zero: the gain of a panel that was seldom lit was off by 3 %."""

WEAK_SIGMAS = 3.0
"""A panel is weak if its gain is lower than those of the others by so many sigmas of fit and vehicle file together."""

WEAK_SIGMA, WEAK_CHANCE = 0.03, 1e-3
"""If the file states no sigma: relative uncertainty of each gain at least; and the chance, by Student's law, that gains which
scatter as those of the other panels do are so low. Of 220 files with gains that scatter by 5 or 8 % at an albedo of 0.3 none was
accused, and 49 of 80 panels weaker by 15 % were named; without the fits' errors in the scatter, 18 and 69."""


class Gains(NamedTuple):
    """`factor` (n_panel) on the vehicle's gains and its `covariance`; `spread`, the relative scatter of the brightness of
    samples in full Sun (None where nothing is told); `told` in words; `weak` (n_panel), which panels are weak."""

    factor: np.ndarray
    covariance: np.ndarray
    spread: float | None
    source: str
    weak: np.ndarray

    @property
    def sigma(self) -> np.ndarray:
        return np.sqrt(np.diag(self.covariance))


def looks_all_around(vehicle: Vehicle, lost: np.ndarray) -> bool:
    """Whether three independent panels that are not `lost` (n_panel) are lit wherever the Sun stands."""
    response = vehicle.response_in()
    sun, lit = response.regions()
    return all(
        row.sum() >= 3 and response.rank(row, at) == 3
        for at, row in zip(sun, lit & ~lost, strict=True)
    )


def with_gains(vehicle: Vehicle, factor: np.ndarray) -> Vehicle:
    """The vehicle with the gains of each input's panels times `factor` (n_input)."""
    gain = np.array([panel.gain for panel in vehicle.panels])
    for channel, value in zip(vehicle.inputs, factor, strict=True):
        gain[list(channel.panels)] *= value
    panels = zip(vehicle.panels, gain.tolist(), strict=True)
    return replace(vehicle, panels=tuple(replace(panel, gain=value) for panel, value in panels))


def stated_sigmas(vehicle: Vehicle) -> np.ndarray:
    """Relative uncertainty of the gain of each input (of a channel: of its least known panel) as the vehicle file states it; NaN
    where it does not."""
    sigma = np.full(len(vehicle.panels), np.nan)
    for k, panel in enumerate(vehicle.panels):
        for key in ("gain_W", "gain_A", "relative_gain"):
            fact = vehicle.facts.get(f"panel.{panel.name}.{key}")
            stated = fact is not None and isinstance(fact.sigma, float) and fact.sigma > 0
            if stated and panel.gain > 0:
                sigma[k] = fact.sigma / panel.gain
    return np.array([sigma[list(channel.panels)].max() for channel in vehicle.inputs])


def prior_sigmas(vehicle: Vehicle, unstated: float = PRIOR_SIGMA) -> np.ndarray:
    """Relative uncertainty of the gain of each input, `unstated` where the vehicle file states none."""
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
    """Gains from readings (n, n_panel) in full Sun, `full` being their brightness with the vehicle's own gains. Panels that are
    `dark` (n_panel) never read anything; of these the `lost` ones are dead, while the others may never have been in the Sun.
    `earth_light`: on a panel that looks at the Earth, as a share of full Sun."""
    prior, around = prior_sigmas(vehicle), looks_all_around(vehicle, lost)
    why = "the panels do not cover all directions, so a low signal may only mean an oblique Sun"
    if vehicle.throttled:
        why = "inputs are throttled, so no sample need be in full Sun"
    elif around and len(value) < FEWEST:
        why = f"fewer than {FEWEST} samples in full Sun"
    covariance, none = np.diag(prior_sigmas(vehicle, UNTOLD_SIGMA) ** 2), np.zeros(len(prior), bool)
    why = f"not determined by the data: {why}"
    nothing = Gains(np.ones(len(prior)), covariance, None, why, none)
    if vehicle.throttled or len(value) < FEWEST or not around:
        return nothing
    value = value[:: -(-len(value) // MOST)]
    paired = earth_light > FAINT and not vehicle.channels
    pairs = np.argwhere(opposite_panels(vehicle.response_in().facing_B)) if paired else []

    def log_brightness(log: np.ndarray) -> np.ndarray:
        gains, light = vehicle.input_gains * np.exp(log), value.copy()
        for i, j in pairs:
            difference = value[:, i] / gains[i] - value[:, j] / gains[j]
            light[:, i] = gains[i] * np.maximum(difference, 0.0)
        return np.log(np.maximum(brightness(with_gains(vehicle, np.exp(log)), light), 1e-6))

    log, precision = np.zeros(len(prior)), np.diag(np.append(prior**-2, 0.0))
    level = float(np.median(log_brightness(log)))  # the brightness that all samples share
    for _ in range(STEPS):
        bright = log_brightness(log)
        columns = [log_brightness(log + STEP * unit) - bright for unit in np.eye(len(log))]
        jacobian = np.column_stack([np.stack(columns, axis=1) / STEP, -np.ones(len(value))])
        away = bright - level
        spread = max(1.4826 * float(np.median(np.abs(away))), 1e-3)
        weight = (FREEDOM + 1) / (FREEDOM + (away / spread) ** 2) / spread**2
        covariance = np.linalg.inv(jacobian.T @ (weight[:, None] * jacobian) + precision)
        slope = jacobian.T @ (weight * away) + precision @ np.append(log, 0.0)
        step = covariance @ slope
        log, level = np.clip(log - step[:-1], -1.0, 1.0), level - step[-1]
    weak = _weak(vehicle, log, covariance[:-1, :-1]) & ~dark
    if not looks_all_around(vehicle, dark):  # a dark panel may be dead, which the fit does not know
        return nothing._replace(weak=weak)
    with_level = np.column_stack([np.eye(len(log)), np.ones(len(log))])
    covariance = with_level @ covariance @ with_level.T + (COMMON_SHARE * spread) ** 2
    factor = np.exp(log + level) / full
    source = f"estimated from {len(value)} samples in full Sun"
    return Gains(factor, covariance * np.outer(factor, factor), spread, source, weak)


def _weak(vehicle: Vehicle, log: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Which panels have gains that are too low for those of the others, by the logarithms of their factors (n_panel)."""
    n, fitted = len(log), np.diag(covariance)
    stated = stated_sigmas(vehicle)
    weak = np.zeros(n, dtype=bool)
    for k in range(n if n > 3 else 0):
        weight = np.where(np.arange(n) == k, 0.0, 1 / (WEAK_SIGMA**2 + fitted))
        weight /= weight.sum()
        against = weight - (np.arange(n) == k)
        low, fit = against @ log, float(np.sqrt(against @ covariance @ against))
        if np.isnan(stated[k]):
            scatter = np.sqrt(weight @ (log - weight @ log) ** 2 * (n - 1) / (n - 2))
            by_chance = -stdtrit(n - 2, WEAK_CHANCE) * scatter
            weak[k] = low > np.hypot(WEAK_SIGMAS * np.hypot(fit, WEAK_SIGMA), by_chance)
        else:
            weak[k] = low > WEAK_SIGMAS * np.hypot(fit, stated[k])
    return weak
