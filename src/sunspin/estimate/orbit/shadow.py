"""Test of an orbit by sunlight: clear Sun in the predicted shadow of the Earth shows that elements or times are wrong.

In the full shadow there is neither sunlight nor light from the Earth. A bright panel there contradicts the orbit at any attitude
and without a magnetometer. Every along-track offset within its prior is allowed, and the edge of the shadow is left out.
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
from sunspin.telemetry.signals import signals
from sunspin.telemetry.units import UNITS
from sunspin.vehicle.response.panels import brightness

CLEAR_SHARE, CLEAR_SIGMAS = 0.4, 8.0
"""A panel has clear Sun above this share of full Sun and this many sigma of noise. The Earth gives a panel 0.25 at reflectivity
0.3; the brightest panel of a cube has 0.58 or more."""

MISFIT = 0.35
"""A sample is of sunlight if its misfit Delta to the best direction is smaller than this. Light of the Earth up to 30 % of full Sun
leaves 0.32, equal readings of all panels (an offset) 0.44 to 0.7."""

FITTING_SHARE, SCATTER = 0.6, 0.3
"""If full Sun itself is estimated from the file, at least this share of the bright samples must be of sunlight by `MISFIT`, and
their relative brightness must scatter by less than `SCATTER`. On simulated cubes with three to six panels it scatters by 0.25 in
sunlight and by 0.34 to 0.43 in noise alone."""

DEPTH_M, LEEWAY_S = 20e3, 10.0
"""The full shadow is that of an Earth whose radius is smaller by `DEPTH_M`, and offsets are tried `LEEWAY_S` beyond the prior.
Sunlight that the air bends 20 km into the shadow of a low orbit comes from rays 5 km high, is spread over five times the area and
mostly absorbed: less than `CLEAR_SHARE`. A satellite at 500 km crosses the 20 km in 7 s or more, and a clock may be off by
seconds."""

FEW, CHANCE_SIGMAS = 3, 2.0
"""Sunny samples in the shadow contradict an orbit if there are more than `FEW`, and more than the share `SEEN_IN_SHADOW` gives by
chance: their expected number and so many sigma of it."""

MOST_SAMPLES = 600
"""Samples of the file that are compared, spread evenly."""

STEP_S, COARSE_S, DRIFT_STEP_S = 10.0, 30.0, 600.0
"""Steps, in s, of the along-track offset within the prior, of the offset beyond it, and of the part that the drift adds at one
sample. A shadow lasts longer than any of them."""


class SunInShadow(NamedTuple):
    """Contradiction of an orbit by clear Sun in its shadow; all fields are 0 if there is none.

    `samples` of all samples (`of`) in the full shadow have clear Sun, at the along-track offset with the fewest such samples.
    `behind_s`, `ahead_s`: least errors (s) of a clock behind or ahead of UTC, or of elements that are as far off, that remove the
    contradiction; NaN if none does.
    """

    samples: int = 0
    of: int = 0
    behind_s: float = 0.0
    ahead_s: float = 0.0

    @property
    def beyond_s(self) -> float:
        """The smaller of the two errors, s; NaN if no error of the clock removes the contradiction."""
        return min((s for s in (self.behind_s, self.ahead_s) if np.isfinite(s)), default=np.nan)

    def __str__(self) -> str:
        """Return the contradiction in words; empty if there is none."""
        if not self.samples:
            return ""
        clocks = [
            (f"{size_s // 60:.0f} min" if size_s >= 120 else f"{size_s:.0f} s")
            + f" or more if it is {side} UTC"
            for side, size_s in (("behind", self.behind_s), ("ahead of", self.ahead_s))
            if np.isfinite(size_s)
        ]
        why = "no clock error explains it, so the orbit is another one"
        if clocks:
            why = f"the elements or the telemetry's clock are off: the clock by {', or '.join(clocks)}"
        return (
            f"the elements do not fit: {self.samples} of {self.of} samples deep in the Earth's shadow "
            f"have clear Sun; {why}"
        )


def sun_in_shadow(orbit: Orbit, assessment: Assessment, sigmas: float) -> SunInShadow:
    """Return the contradiction of an orbit by clear Sun in its shadow at every along-track offset within `sigmas` of its prior.

    There is none if the light is consistent with one of these offsets.
    """
    t_s, clear = clear_sun(assessment)
    if clear.sum() <= FEW:
        return SunInShadow()

    def counts(offsets_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return arrays (K) at offsets (K) in s: sunny samples in the full shadow, all there, and whether too many are sunny."""
        dark = _in_full_shadow(orbit, t_s, offsets_s, sigmas)
        sunny, total = (dark & clear).sum(axis=1), dark.sum(axis=1)
        by_chance = SEEN_IN_SHADOW * total
        most = np.maximum(FEW, by_chance + CHANCE_SIGMAS * np.sqrt(by_chance))
        return sunny, total, sunny > most

    # most orbits are consistent with their own offset, so that no others need to be tried
    if not counts(np.zeros(1))[2].all():
        return SunInShadow()
    half_period = orbit.elements[0].period_s / 2
    largest = min(sigmas * orbit.offset_sigma_s + LEEWAY_S, half_period)
    within_prior = np.linspace(-largest, largest, 2 * int(np.ceil(largest / STEP_S)) + 1)
    sunny, total, contradicted = counts(within_prior)
    if not contradicted.all():
        return SunInShadow()
    # The orbit is contradicted. Which offsets beyond the prior, up to half a revolution, would be consistent?
    steps = int(half_period / COARSE_S)
    offsets_s = COARSE_S * np.arange(-steps, steps + 1)
    consistent = offsets_s[~counts(offsets_s)[2]]
    # If the clock is behind UTC, the satellite seems ahead of its elements: positive offsets. The contradiction may end up to one
    # step before the first consistent offset.
    behind_s, ahead_s = (
        float(sizes[sizes > 0].min(initial=np.inf)) - COARSE_S
        for sizes in (consistent, -consistent)
    )
    behind_s, ahead_s = (size if np.isfinite(size) else np.nan for size in (behind_s, ahead_s))
    best = int(sunny.argmin())  # the offset with the fewest sunny samples
    return SunInShadow(int(sunny[best]), int(total[best]), behind_s, ahead_s)


def clear_sun(assessment: Assessment) -> tuple[np.ndarray, np.ndarray]:
    """Return times (n) in s of samples that show whether the Sun is up, and which of them (n) surely show sunlight.

    Panels show it; without panels, Sun sensors that have a column for their light. A direction without that column does not: it may
    be computed, or be an old one that was kept. Bright panel readings that repeat earlier ones may be frozen and are left out; so
    are repeated readings of Sun sensors, and late frames. At most `MOST_SAMPLES` are returned.
    """
    telemetry, sensors = assessment.telemetry, assessment.vehicle.sensors
    shows = clear = np.zeros(telemetry.sizes["time"], dtype=bool)
    if assessment.has_panels:
        bright, clear = _sunlit_by_panels(assessment)
        value = signals(telemetry)
        frozen = np.append(False, (value[1:] == value[:-1]).all(axis=1))
        frozen |= assessment.repeats.repeated(PANELS)
        shows = np.isfinite(value).any(axis=1) & ~(frozen & bright)
    elif (
        "sun_sensor_B" in telemetry
        and sensors.sun_vector is None
        and all(sensor.light_column for sensor in sensors.sun_sensors)
    ):
        clear = np.asarray(np.isfinite(assessment.sensors["sun_sensor_B"].values).all(axis=1))
        shows = ~assessment.repeats.repeated("sun_sensor_B")
    use = np.flatnonzero(shows & ~find_late_frames(telemetry))
    if len(use) > MOST_SAMPLES:
        use = use[np.linspace(0, len(use) - 1, MOST_SAMPLES).astype(int)]
    return telemetry["time"].values[use], clear[use]


def _sunlit_by_panels(assessment: Assessment) -> tuple[np.ndarray, np.ndarray]:
    """Return which samples (n) have a bright panel, and which of them (n) are surely in sunlight by panels that fit one Sun."""
    vehicle, quality = assessment.vehicle, assessment.quality
    value = signals(assessment.telemetry)
    full = quality.attrs["full_sun"] * vehicle.input_gains
    noise = np.maximum(np.nan_to_num(assessment.noise[0]), quality["noise"].values)
    bright = (value > CLEAR_SHARE * full) & (value > CLEAR_SIGMAS * noise)
    sound = (bright & (value <= SPIKE_FACTOR * full)).any(axis=1)
    sound &= quality["use"].values != DROPPED
    clear = np.asarray(sound & (assessment.sun["delta"].values < MISFIT))
    full_sun_is_estimated = vehicle.gain_unit != UNITS[vehicle.telemetry.quantity]
    if clear.any() and full_sun_is_estimated:
        # The estimate is by the brighter samples, which may be noise: then they scatter. From 16 to 84 % are two sigmas.
        of_sound = brightness(vehicle, np.nan_to_num(value[sound]))
        low, median, high = np.quantile(of_sound, [0.16, 0.5, 0.84])
        if clear.sum() < FITTING_SHARE * sound.sum() or high - low > 2 * SCATTER * median:
            clear = np.zeros_like(clear)
    return np.asarray(bright.any(axis=1)), clear


def _in_full_shadow(
    orbit: Orbit, t_s: np.ndarray, offsets_s: np.ndarray, sigmas: float
) -> np.ndarray:
    """Return which samples (K, n) are in the full shadow of the Earth at each of K along-track offsets, whatever the drift.

    `t_s` (n): times of the samples, s; `offsets_s` (K), s: added to the offset of the orbit. A sample counts only if it is in the
    shadow for every drift within `sigmas` standard deviations of the orbit's. To leave out the edge of the shadow, in which the air
    bends sunlight, the Earth counts as smaller by `DEPTH_M`.
    """
    when = orbit.instants(t_s)
    sun, ahead_s = sun_J2000_m(when), orbit.ahead_s(when) + offsets_s[:, None]
    # the most that the drift's error adds to the offset at each sample (n), up to half a revolution; below 1 s it is neglected
    drift_s = sigmas * orbit.drift_sigma_s_day * np.abs(orbit.days(when))
    drift_s = np.minimum(drift_s, orbit.elements[0].period_s / 2)
    steps = int(np.ceil(drift_s.max() / DRIFT_STEP_S)) if drift_s.max() > 1.0 else 0
    dark = np.ones(ahead_s.shape, dtype=bool)
    # fractions of the largest drift, from -1 to 1
    for fraction in np.linspace(-1, 1, 2 * steps + 1) if steps else [0.0]:
        position, _ = orbit.states(when, ahead_s + fraction * drift_s)
        # `sunlit_fraction` knows only the whole Earth. As the Sun is far away, the smaller Earth has the same shadow, scaled down.
        # So the position is scaled up by the ratio of the radii.
        enlarged = position * EQUATOR_M / (EQUATOR_M - DEPTH_M)
        dark &= sunlit_fraction(enlarged, np.broadcast_to(sun, position.shape)) == 0
    return dark
