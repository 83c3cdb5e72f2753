"""Clear Sun where elements put the Earth's shadow: then the elements or the times of the telemetry are wrong.

In the full shadow there is neither sunlight nor light from the Earth, so that a bright panel there contradicts the orbit at any
attitude and without a magnetometer. The place along the track is open within the prior; the edge of the shadow is left out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sunspin.environment.earth import EQUATOR_M, sun_J2000_m
from sunspin.environment.light import sunlit_fraction
from sunspin.environment.orbit import Orbit
from sunspin.estimate.orbit.invariants import SEEN_IN_SHADOW
from sunspin.telemetry.assess import Assessment
from sunspin.telemetry.quality import DROPPED, SPIKE_FACTOR, find_late_frames
from sunspin.telemetry.repeats import PANELS
from sunspin.telemetry.sun import signals
from sunspin.telemetry.units import UNITS
from sunspin.vehicle.response.panels import brightness

CLEAR_SHARE, CLEAR_SIGMAS = 0.4, 8.0
"""A panel has clear Sun above this share of full Sun and this many sigma of noise. The Earth gives a panel 0.25 at reflectivity
0.3; the brightest panel of a cube has 0.58 or more."""

MISFIT, ALIKE, SCATTER = 0.35, 0.6, 0.3
"""A sample is of sunlight if its misfit Delta to the best direction is smaller than the first: light of the Earth up to 30 % of
full Sun leaves 0.32, equal readings of all panels (an offset) 0.44 to 0.7. If full Sun itself is estimated from the file, the
second share of the bright samples must be so, and their brightness scatter by less than the third. On simulated cubes with three
to six panels it scatters by 0.25 in sunlight and by 0.34 to 0.43 in noise alone."""

DEPTH_M, LEEWAY_S = 20e3, 10.0
"""The full shadow is that of an Earth so much smaller, and the prior of the offset is so much wider on both sides. Sunlight that
the air bends reaches a low orbit 20 km deep from rays 5 km high, where it is spread over five times the area and mostly absorbed:
less than `CLEAR_SHARE`. A clock may be off by seconds: a satellite at 500 km crosses the 20 km in 7 s or more."""

FEW, CHANCE_SIGMAS = 3, 2.0
"""More samples with clear Sun in the shadow than the first contradict the orbit, if they are also more than `SEEN_IN_SHADOW` makes
by chance: its mean and so many sigma."""

MOST_SAMPLES = 600
"""Samples of the file that are compared, spread evenly."""

STEP_S, COARSE_S, SIDE_S = 10.0, 30.0, 600.0
"""Steps of the along-track offset: within the prior, beyond it, and of the drift at one sample; a shadow lasts longer."""


class SunInShadow(NamedTuple):
    """Samples with clear Sun in the full shadow, at the offset within the prior that leaves fewest, and all samples there.

    `behind_s`, `ahead_s`: the least errors (s) of a clock that is behind or ahead of UTC, or of elements that are as far off, that
    remove the contradiction; NaN if none does. All are 0 without a contradiction.
    """

    samples: int = 0
    of: int = 0
    behind_s: float = 0.0
    ahead_s: float = 0.0

    @property
    def beyond_s(self) -> float:
        """The smaller of the two errors, s; NaN if no error of the clock removes the contradiction."""
        known = [each for each in (self.behind_s, self.ahead_s) if np.isfinite(each)]
        return min(known, default=np.nan)

    def __str__(self) -> str:
        """Return the contradiction in words; empty if there is none."""
        if not self.samples:
            return ""
        sides = [
            f"{_least(each)} or more if it is {word} UTC"
            for each, word in ((self.behind_s, "behind"), (self.ahead_s, "ahead of"))
            if np.isfinite(each)
        ]
        off = "no clock error explains it, so the orbit is another one"
        if sides:
            off = (
                f"the elements or the telemetry's clock are off: the clock by {', or '.join(sides)}"
            )
        return (
            f"the elements do not fit: {self.samples} of {self.of} samples deep in the Earth's shadow "
            f"have clear Sun; {off}"
        )


def _least(size_s: float) -> str:
    """Return a time in words, rounded down."""
    return f"{size_s // 60:.0f} min" if size_s >= 120 else f"{size_s:.0f} s"


def sun_in_shadow(orbit: Orbit, assessment: Assessment, sigmas: float) -> SunInShadow:
    """Return how the light contradicts an orbit at every along-track offset within so many `sigmas` of its prior.

    There is no contradiction if the samples are consistent with one of these offsets.
    """
    t_s, clear = clear_sun(assessment)
    if clear.sum() <= FEW:
        return SunInShadow()
    # most orbits are consistent with the offset of the elements, which saves the search of the others
    own_offset = np.zeros(1)
    if not _contradicted(*_count_in_shadow(orbit, t_s, clear, own_offset, sigmas)).all():
        return SunInShadow()
    half_period = orbit.elements[0].period_s / 2
    prior_sigma = float(np.hypot(orbit.shift_sigma_s, orbit.clock_sigma_s))
    reach = min(sigmas * prior_sigma + LEEWAY_S, half_period)
    within_prior = np.linspace(-reach, reach, 2 * int(np.ceil(reach / STEP_S)) + 1)
    sunlit, in_shadow = _count_in_shadow(orbit, t_s, clear, within_prior, sigmas)
    if not _contradicted(sunlit, in_shadow).all():
        return SunInShadow()
    steps = int(half_period / COARSE_S)
    whole_orbit = COARSE_S * np.arange(-steps, steps + 1)
    contradicted = _contradicted(*_count_in_shadow(orbit, t_s, clear, whole_orbit, sigmas))
    consistent = whole_orbit[~contradicted]
    # a satellite that is ahead of its place has a clock that is behind; the contradiction may end a step of the grid earlier
    behind, ahead = (
        float(sizes.min() - COARSE_S) if sizes.size else np.nan
        for sizes in (consistent[consistent > 0], -consistent[consistent < 0])
    )
    fewest = int(sunlit.argmin())
    return SunInShadow(int(sunlit[fewest]), int(in_shadow[fewest]), behind, ahead)


def _count_in_shadow(
    orbit: Orbit, t_s: np.ndarray, clear: np.ndarray, offsets_s: np.ndarray, sigmas: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers (K) of samples in the full shadow that have clear Sun, and of all samples there.

    `t_s`, `clear` (n): times, and which samples have clear Sun; `offsets_s` (K), `sigmas`: as in :func:`_in_full_shadow`.
    """
    dark = _in_full_shadow(orbit, t_s, offsets_s, sigmas)
    return (dark & clear).sum(axis=1), dark.sum(axis=1)


def _contradicted(sunlit: np.ndarray, in_shadow: np.ndarray) -> np.ndarray:
    """Return whether so many samples with clear Sun (K), of all in the full shadow (K), contradict the orbit and are not chance."""
    chance = SEEN_IN_SHADOW * in_shadow
    return sunlit > np.maximum(FEW, chance + CHANCE_SIGMAS * np.sqrt(chance))


def clear_sun(assessment: Assessment) -> tuple[np.ndarray, np.ndarray]:
    """Return the times (n) in s of samples that say whether the Sun is up, and in which (n) only sunlight makes the readings.

    Panels say it, or Sun sensors with a column for their light: a direction alone may be computed or left over. A bright sample
    that repeats the one before it may be a frozen reading and says nothing.
    """
    telemetry, sensors = assessment.telemetry, assessment.vehicle.sensors
    known = clear = np.zeros(telemetry.sizes["time"], dtype=bool)
    if assessment.has_panels:
        bright, clear = _sunlit_by_panels(assessment)
        value = signals(telemetry)
        repeated = np.append(False, (value[1:] == value[:-1]).all(axis=1))
        repeated |= assessment.repeats.repeated(PANELS)
        known = np.isfinite(value).any(axis=1) & ~(repeated & bright)
    elif "sun_sensor_B" in telemetry and sensors.sun_vector is None:
        if all(sensor.light_column for sensor in sensors.sun_sensors):
            clear = np.asarray(np.isfinite(assessment.sensors["sun_sensor_B"].values).all(axis=1))
            known = ~assessment.repeats.repeated("sun_sensor_B")
    use = np.flatnonzero(known & ~find_late_frames(telemetry))
    if len(use) > MOST_SAMPLES:
        use = use[np.linspace(0, len(use) - 1, MOST_SAMPLES).astype(int)]
    return telemetry["time"].values[use], clear[use]


def _sunlit_by_panels(assessment: Assessment) -> tuple[np.ndarray, np.ndarray]:
    """Return which samples (n) have a bright panel, and which of them (n) only sunlight makes."""
    vehicle, quality = assessment.vehicle, assessment.quality
    value = signals(assessment.telemetry)
    full = quality.attrs["full_sun"] * vehicle.input_gains
    noise = np.maximum(np.nan_to_num(assessment.noise[0]), quality["noise"].values)
    high = (value > CLEAR_SHARE * full) & (value > CLEAR_SIGMAS * noise)
    usable = (high & (value <= SPIKE_FACTOR * full)).any(axis=1)
    usable &= quality["use"].values != DROPPED
    clear = usable & (assessment.sun["delta"].values < MISFIT)
    if clear.any() and vehicle.gain_unit != UNITS[vehicle.telemetry.quantity]:
        # full Sun is what the brighter samples of the file give, be it noise
        low, middle, top = np.quantile(
            brightness(vehicle, np.nan_to_num(value[usable])), [0.16, 0.5, 0.84]
        )
        if clear.sum() < ALIKE * usable.sum() or top - low > 2 * SCATTER * middle:
            clear = np.zeros_like(clear)
    return np.asarray(high.any(axis=1)), np.asarray(clear)


def _in_full_shadow(
    orbit: Orbit, t_s: np.ndarray, offsets_s: np.ndarray, sigmas: float
) -> np.ndarray:
    """Return whether samples (K, n) are in the full shadow at along-track offsets (K) in s from the orbit's own, with any drift
    within so many `sigmas`."""
    when = orbit.instants(t_s)
    sun, ahead = sun_J2000_m(when), orbit.ahead_s(when) + offsets_s[:, None]
    drift = sigmas * orbit.drift_sigma_s_day * np.abs(orbit.days(when))
    drift = np.minimum(drift, orbit.elements[0].period_s / 2)
    sides = int(np.ceil(drift.max() / SIDE_S)) if drift.max() > 1.0 else 0
    dark = np.ones(ahead.shape, dtype=bool)
    for side in np.linspace(-1, 1, 2 * sides + 1) if sides else (0.0,):
        place, _ = orbit.states(when, ahead + side * drift)
        # a place farther out sees the Earth as a smaller one is seen
        outward = place * EQUATOR_M / (EQUATOR_M - DEPTH_M)
        dark &= sunlit_fraction(outward, np.broadcast_to(sun, place.shape)) == 0
    return dark
