"""Quality of panel readings: dead panels, power-limited samples, albedo, spikes and stale frames, each with its reason in words.

Nothing is discarded without a message. A reading that cannot come from the Sun has an infinite sigma, one that may have another
cause has a larger sigma, and every sample has a sentence.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.base.provenance import provenance
from sunspin.telemetry.gains import (
    FAINT,
    PRIOR_SIGMA,
    READING_SIGMA,
    WIDE_SIGMA,
    Gains,
    estimate_gains,
    prior_sigmas,
    scale_gains,
    stated_sigmas,
)
from sunspin.telemetry.noise import ASSUMED_SHARE, dark_noise, lowest_reading
from sunspin.telemetry.repeats import PANELS, Repeats, find_repeats
from sunspin.telemetry.signals import signals
from sunspin.telemetry.silent import find_lost_panels
from sunspin.telemetry.units import UNITS, WrongUnit
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import brightness, opposite_panels, panel_power
from sunspin.vehicle.response.planes import sphere

DEAD_FRACTION = 0.05
"""A panel that never exceeds this fraction of its gain, in a file that is long enough, is taken as dead."""

DARK_SIGMAS = 4.0
"""A sample is dark if no reading exceeds so many sigma of noise. In the shadow, noise makes one of six panels exceed it in 2 of
10,000 samples. With three sigma it would be one sample in 120, which panels on some sides only would take for an oblique Sun."""

DEAD_SAMPLES = 20
"""Samples with some panel lit before a panel may be called dead."""

LIMITED_FRACTION = 0.85
"""If the panels together are below this fraction of full Sun, the battery sets the current, or a dead panel is lit."""

SPIKE_FACTOR = 1.6
"""A reading above this many times full Sun is a wrapped counter or a spike; Earth's albedo adds at most 0.4."""

EARTH_LEFT = 0.25
"""Share of the light on unlit panels that a smooth model of the Earth cannot explain: clouds and coasts."""

ALBEDO_DEFAULT = 0.06
"""Light on unlit panels, as a share of full Sun, if the file has too few readings to estimate it."""

ALBEDO_READINGS = 10
"""Smallest number of readings of panels that face away from the Sun from which Earth's light is estimated."""

LIT_SHARE = 0.5
"""Largest ratio of the Earth's light on a panel to the Sun's, averaged over the samples in which the panel is lit."""

FACED = 0.3
"""A panel that gets this share of full Sun looks at the Sun, and the one opposite to it does not."""

COSINE_QUANTILE = 0.68
"""84 % quantile, over all directions, of the cosine between a panel's normal and the Earth; negative cosines count as zero."""

PASSING_NEAR, PASSING_MOST = 2, 0.3
"""Samples before and after one on whose panels its Earth's light may fall too; and the largest share of full Sun that counts as
such light."""

PASSING_INTERVALS = 4
"""Usual sampling intervals within which samples are near each other: a lost packet does not part them, the gap between
passes does."""

SURELY_LIT = 2.0
"""A reading of more than this many times the albedo comes from the Sun; a lower one may come from the Earth."""

QUANTUM_SAMPLES = 20_000
"""Largest number of distinct readings searched for a quantisation step."""

IDLE_FRACTION = 0.35
"""Samples below this fraction of full Sun are dropped: on skCUBE the current then came from panels that were less in the Sun."""

GAIN_SIGMAS = 2.0
"""Samples are dropped only if they are still dim with gains lower by so many sigmas of the vehicle file. A guess with a sigma of
0.3 otherwise lost each sample with the Sun on a panel of a third of the cells."""

LIMITED_SIGMA = 0.5
"""Error of a power-limited reading, as a fraction of the sample's largest: the lit panels are right, the ratios are not."""

LIMITED_DARK_SIGMA = 1.0
"""Error, as above, of a panel with a low reading in such a sample: it may be in the Sun while another feeds the battery."""

LIMITED_SCALE = 2.0
"""Relative uncertainty of the scale of a power-limited sample: practically unknown."""

CLEAN_SCALE = 0.06
"""Relative uncertainty of the scale of a sample in full Sun: cell temperature and spread of gains."""

NOT_INCREASING = 4
"""Bit of `flag` for a time that does not increase (`sunspin.telemetry.reader.FLAGS`)."""

LATE = "dropped: duplicate or out-of-order frame"
EMPTY = "dropped: no panel has a number"
NEGATIVE = "dropped: negative readings beyond noise (fill values)"
STALE = "dropped: identical to the previous sample (stale frame)"
COPY = "dropped: identical to an earlier sample (copy of a frame)"
HELD = "dropped: panels repeat their last readings while other sensors change (held values)"
BELOW_FULL = (
    "down-weighted: signal below full Sun (battery-limited current, or a failed panel is sunlit)"
)
IDLE = "dropped: far below full Sun (current set by the battery, not by the Sun)"
BEYOND_FULL = "down-weighted: a reading beyond full Sun (wrapped count or spike) was excluded"
BELOW_NOISE = "down-weighted: a negative reading beyond noise (fill value) was excluded"
PARTLY_HELD = (
    "down-weighted: a held value was excluded (the panel is read less often than the others)"
)

MISREAD_SHARE = 0.5
"""If more than this share of the samples is beyond full Sun, the unit is wrong and no reading is a spike."""

FULL_SHARE = 0.05
"""If fewer than this share of the lit samples reach full Sun, the gains are too high and the battery does not limit the current."""

OBLIQUE = "used: signal below full Sun (oblique Sun, or battery-limited; the data cannot distinguish them)"

DIRECTIONS = 3000
"""Trial directions of the Sun, evenly spread over the sphere, about 4 degrees apart."""

OBLIQUE_MISFIT = 0.08
"""Rms misfit of the readings, as a fraction of full Sun, up to which a Sun of full strength explains a sample."""

CHUNK = 20_000
"""Samples computed at once."""

USED, DOWNWEIGHTED, DROPPED = 0, 1, 2
"""Values of `use`."""


class _Readings(NamedTuple):
    """Readings of panels that may come from the Sun.

    `value` (n, n_panel): NaN if negative, not finite or held. `negative`, `held` (n, n_panel): masks of what was removed. `dropped`
    (n): no reading of the sample can be used, with `reason` (n) as a sentence.
    """

    value: np.ndarray
    negative: np.ndarray
    held: np.ndarray
    dropped: np.ndarray
    reason: np.ndarray

    @property
    def kept(self) -> np.ndarray:
        """Mask (n) of the samples that are not dropped."""
        return ~self.dropped


class _Light(NamedTuple):
    """What the readings say of panels and samples, before Earth's light and gains are estimated.

    `full`: reading of full Sun as a multiple of the gain, and `full_from`, its origin in words. On panel: `noise`, one sigma of a
    reading with its quantisation; `dead`; `missed`, dead although the others show that the Sun was on it. `spike` (n, n_panel): a
    reading beyond full Sun. `value` (n, n_panel): readings, zero where none can be used.

    On time: `bright`, brightness as a multiple of the gains; `level` (n, 1), that of full Sun; `dark`, no panel is lit; `idle`,
    `limited`, `oblique` as in `_find_dim_samples`.
    """

    full: float
    full_from: str
    noise: np.ndarray
    dead: np.ndarray
    missed: np.ndarray
    spike: np.ndarray
    value: np.ndarray
    bright: np.ndarray
    level: np.ndarray
    dark: np.ndarray
    idle: np.ndarray
    limited: np.ndarray
    oblique: np.ndarray


class _Errors(NamedTuple):
    """Earth's light, gains and the errors of readings.

    `albedo`: light on unlit panels as a share of full Sun, from `albedo_samples` readings. `earth`: Earth's light on a panel that
    looks at it. `fitted`: gains and weak panels. `gains` (n_panel) with the covariance `gain_cov`, relative to the vehicle file's.
    `sigma`, `sigma_beside_gains`, `sigma_modelled` (n, n_panel): of each reading with all its errors, without those of the gains,
    and without those and the Earth's light; infinite if not used.
    """

    albedo: float
    albedo_samples: int
    earth: float
    fitted: Gains
    gains: np.ndarray
    gain_cov: np.ndarray
    sigma: np.ndarray
    sigma_beside_gains: np.ndarray
    sigma_modelled: np.ndarray


def judge_readings(
    vehicle: Vehicle,
    telemetry: xr.Dataset,
    wrong_unit: Callable[[], WrongUnit | None],
    repeats: Repeats | None = None,
) -> xr.Dataset:
    """Judge every reading and every sample of panel powers or currents.

    Parameters
    ----------
    telemetry : Dataset of `read_telemetry`
    wrong_unit : callable
        Returns the wrong unit of the readings. It is called, and the unit named, only if there are samples without a lit panel.
    repeats : Repeats, optional
        Samples that repeat earlier ones; by default they are searched for.

    Returns
    -------
    xarray.Dataset
        On (time, panel): `sigma`, one sigma of a reading in the unit of the gains, infinite if the reading is not used;
        `sigma_beside_gains`, the same if the errors of the gains are modelled; `sigma_beside_earth`, if the Earth's light is
        modelled too; `reading`, true if the panel was read, lit or not; `measured`, true if the reading depends on the Sun
        direction alone.

        On time: `scale`, the factor between gain and reading at full Sun, with its relative uncertainty `scale_sigma`; `use`
        (0 used, 1 down-weighted, 2 dropped); `why`, the reason as a sentence.

        On panel: `dead`, the panel reads nothing and is left out; `missed`, the others show that the Sun was on it nevertheless;
        `weak`, its gain is too low compared with the others; `gain`, `gain_sigma`, `gain_cov`; `noise` of a reading, with its
        quantisation.

        attrs: `full_sun`, scale of a clean sample; `albedo`, light on unlit panels as a share of full Sun; `albedo_samples`, number
        of readings that determine it; `earth_light` on a panel that looks at the Earth; `spread`, relative scatter of full Sun, NaN
        if not determined; `noise`, median over panels; `full_sun_from` and `gains_from`, origin in words.
    """
    readings = _select_readings(vehicle, telemetry, repeats)
    t_s = np.asarray(telemetry["time"].values, dtype=np.float64)
    light = _measure_light(vehicle, t_s, readings)
    errors = _estimate_errors(vehicle, t_s, readings, light)
    kept, dark, idle, limited = readings.kept, light.dark, light.idle, light.limited

    # use and reason of each sample; np.select takes the first that applies
    wrong = wrong_unit() if dark[kept].any() else None
    no_panel_lit = "dropped: no panel lit" if wrong is None else f"dropped: {wrong}"
    has_spike, has_negative, has_held = (
        mask.any(axis=1) for mask in (light.spike, readings.negative, readings.held)
    )
    reasons = [
        (readings.dropped, readings.reason),
        (dark, no_panel_lit),
        (idle, IDLE),
        (limited, BELOW_FULL),
        (has_spike, BEYOND_FULL),
        (has_negative, BELOW_NOISE),
        (has_held, PARTLY_HELD),
        (light.oblique, OBLIQUE),
    ]
    why = np.select([applies for applies, _ in reasons], [text for _, text in reasons], "used")
    downweighted = limited | has_spike | has_negative | has_held
    use = np.select([readings.dropped | dark | idle, downweighted], [DROPPED, DOWNWEIGHTED], USED)
    # if one factor may lower a whole sample, no sample shows that the Sun was not on a dead panel
    missed = light.missed | (light.dead & vehicle.throttled)

    # readings that exist, and those that depend on the Sun direction alone. If most samples are beyond full Sun, or nearly all
    # below, units or gains are wrong; that is reported elsewhere, and the readings stay readings.
    lit = kept & ~dark
    most_beyond = np.count_nonzero(has_spike & kept) > MISREAD_SHARE * kept.sum()
    few_full = (light.bright[lit] >= LIMITED_FRACTION * light.full).sum() < FULL_SHARE * lit.sum()
    was_read = np.isfinite(readings.value) & (most_beyond | ~light.spike) & ~missed & kept[:, None]
    # if panels cover all directions, a dark sample is in the shadow; else the Sun may be where no panel looks
    shadow = dark & (wrong is None and sees_everywhere(vehicle))
    # Full Sun must be stated: if it comes from the file's brighter samples, a shadowed panel looks like a full battery.
    stated_full = vehicle.gain_unit == UNITS[vehicle.telemetry.quantity]
    dim = (idle | limited) & (not few_full)
    measured = was_read & ~((dim | shadow) & (stated_full and not most_beyond))[:, None]

    fitted, stated_gains = errors.fitted, vehicle.input_gains
    scale = np.where(limited, np.maximum(light.bright, 1e-12), light.level[:, 0])
    scale_sigma = np.where(limited | vehicle.throttled, LIMITED_SCALE, fitted.spread or CLEAN_SCALE)
    uses = {"flag_values": [0, 1, 2], "flag_meanings": "used downweighted dropped"}
    gains_name = "the same where the errors of the gains are modelled"
    modelled_name = "the same where the Earth's light is modelled too"
    variables: dict[str, Any] = {
        "sigma": (errors.sigma, {"long_name": "one sigma of a reading, unit of the gains"}),
        "sigma_beside_gains": (errors.sigma_beside_gains, {"long_name": gains_name}),
        "sigma_beside_earth": (errors.sigma_modelled, {"long_name": modelled_name}),
        "reading": (was_read, {"units": "1", "long_name": "the panel was read"}),
        "measured": (measured, {"long_name": "the reading depends on the Sun direction alone"}),
        "scale": (scale, {"units": "1"}),
        "scale_sigma": (scale_sigma, {"units": "1"}),
        "use": (use.astype(np.int8), uses),
        "why": (why.astype(np.str_), {}),
    }
    gain_name = "gain of each panel, unit of the vehicle's gains"
    panel_variables = {
        "gain": (errors.gains, {"long_name": gain_name}),
        "gain_sigma": (np.sqrt(np.diag(errors.gain_cov)) * stated_gains, {}),
        "gain_cov": (errors.gain_cov * np.outer(stated_gains, stated_gains), {}),
        "noise": (light.noise, {}),
        "dead": (light.dead, {}),
        "weak": (fitted.weak, {}),
        "missed": (missed, {}),
    }
    return xr.Dataset(
        {name: (("time", "panel")[: v.ndim], v, about) for name, (v, about) in variables.items()}
        | {
            name: (("panel", "panel2")[: v.ndim], v, about)
            for name, (v, about) in panel_variables.items()
        },
        coords={name: telemetry[name] for name in ("time", "panel") if name in telemetry.coords},
        attrs=provenance("panel_quality", telemetry, **vehicle.result_attributes)
        | {
            "full_sun": float(light.full),
            "albedo": float(errors.albedo),
            "albedo_samples": errors.albedo_samples,
            "full_sun_from": light.full_from,
            "gains_from": fitted.source,
            "earth_light": errors.earth,
            "noise": float(np.median(light.noise)),
            "spread": np.nan if fitted.spread is None else fitted.spread,
        },
    )


def _select_readings(vehicle: Vehicle, telemetry: xr.Dataset, repeats: Repeats | None) -> _Readings:
    """Remove readings and samples that cannot come from the Sun at their time: late, repeated, negative or held ones."""
    value, negative = remove_negative_readings(vehicle, signals(telemetry))
    usable = ~find_late_frames(telemetry) & np.isfinite(value).any(axis=1)
    without_spikes = remove_spikes(vehicle, value)
    if repeats is None:
        repeats = find_repeats(telemetry, without_spikes, usable)
    dropped, reason = _unusable(telemetry, without_spikes, value, negative, repeats)
    held = np.zeros(value.shape, dtype=bool) if repeats.columns is None else repeats.columns
    return _Readings(np.where(held, np.nan, value), negative, held, dropped, reason)


def _measure_light(vehicle: Vehicle, t_s: np.ndarray, readings: _Readings) -> _Light:
    """Find full Sun, noise, dead panels and spikes, then the brightness of each sample, taken at the times `t_s` (n)."""
    value, kept = readings.value, readings.kept
    stated_gains, stated_noise = vehicle.input_gains, vehicle.input_noise
    relative = value / stated_gains
    full, full_from = _full_sun(vehicle, relative[kept])
    spike = np.isfinite(relative) & (relative > SPIKE_FACTOR * full)
    # the error of a rounded reading is uniform over one step
    quantisation = _quantisation_step(value[kept]) / np.sqrt(12)
    noise = np.hypot(
        np.zeros(len(stated_gains)) if stated_noise is None else stated_noise, quantisation
    )
    sound = kept & ~spike.any(axis=1)
    missed = find_lost_panels(vehicle, t_s[sound], relative[sound] / full, noise / full)
    # a fill value is no signal; if most samples are beyond full Sun, the unit is wrong
    misread = spike.any(axis=1).sum() > MISREAD_SHARE * len(value)
    dead = _find_dead_panels(np.where(spike & ~misread, np.nan, relative)[kept], full) | missed
    usable = np.where(np.isfinite(value) & ~spike & ~dead, value, 0.0)

    bright = brightness(vehicle, usable)
    dark = bright < DEAD_FRACTION * full
    unlit_light, _ = _estimate_albedo(_facing_away(vehicle, relative[sound & ~dark] / full))
    dark |= ~_beyond_noise(vehicle, value, usable, noise, full, unlit_light)
    level = np.full((len(value), 1), full)
    if vehicle.throttled:  # the battery may limit any sample, by one factor for all its readings
        level = np.maximum(bright, 1e-12)[:, None]
    idle, limited, oblique = _find_dim_samples(vehicle, usable, kept & ~dark, bright, full, dead)
    return _Light(
        full=full,
        full_from=full_from,
        noise=noise,
        dead=dead,
        missed=missed,
        spike=spike,
        value=usable,
        bright=bright,
        level=level,
        dark=dark,
        idle=idle,
        limited=limited,
        oblique=oblique,
    )


def _estimate_errors(
    vehicle: Vehicle, t_s: np.ndarray, readings: _Readings, light: _Light
) -> _Errors:
    """Estimate Earth's light and the gains from samples in full Sun, then sigma of each reading, taken at the times `t_s` (n)."""
    value, level, noise = light.value, light.level, light.noise
    stated_gains, full = vehicle.input_gains, light.full
    clean = readings.kept & ~light.limited & ~light.idle & ~light.dark
    relative = readings.value / stated_gains
    away = _facing_away(vehicle, relative / level)
    albedo, albedo_samples = _estimate_albedo(away[clean])
    relative_noise = float(np.median(noise) / (full * np.median(stated_gains)))
    earth = _earth_light(albedo, albedo_samples, relative_noise)
    fitted = estimate_gains(vehicle, value[clean], full, light.dead, light.missed, earth)
    gains = stated_gains * fitted.factor
    gain_cov = fitted.covariance
    if fitted.spread is not None:
        lit_share = lit_beside_gains = fitted.spread
    else:
        # gains may be off by their prior: a string of cells may be dead or a full scale wrong, and all samples have that in common
        of_full = value / (level * gains)
        lit_share = np.hypot(albedo, fitted.sigma * of_full)
        lit_beside_gains = np.hypot(albedo, READING_SIGMA * of_full)
        gain_cov = np.diag(prior_sigmas(vehicle, WIDE_SIGMA) ** 2)
    # what the Earth adds to a lit panel on average appears as a larger gain
    gain_cov = gain_cov + np.eye(len(gains)) * (LIT_SHARE * earth) ** 2

    # sigma of each reading: a share of full Sun, which is the albedo for unlit panels, and the noise
    lit = value > SURELY_LIT * albedo * level * gains
    share = np.where(lit, lit_share, albedo)
    beside_gains = np.where(lit, lit_beside_gains, albedo)
    if earth <= FAINT:
        # Too faint to be modelled as a source. Only in a known orbit, and if the file does not say how much light there is, an
        # estimate models it all the same, with errors from `modelled_share`.
        least = max(SURELY_LIT * albedo, DARK_SIGMAS * relative_noise)
        passing = _passing_light(t_s, away, clean, least)[:, None]
        share, beside_gains = np.hypot(share, passing), np.hypot(beside_gains, passing)
    # With modelled Earth's light: what no smooth model explains. Light on unlit panels also contains a noise that the file does not
    # state, which is as large as the scatter of full Sun, or up to all of that light.
    unstated = 0.0
    if vehicle.input_noise is None:
        unstated = albedo if fitted.spread is None else min(fitted.spread, albedo)
    unmodelled = max(EARTH_LEFT * albedo, unstated)
    modelled_share = np.minimum(share, np.hypot(unmodelled, np.where(lit, READING_SIGMA, 0.0)))
    # in a power-limited sample a share of its largest reading in addition
    largest = value.max(axis=1, initial=0.0)[:, None]
    by_battery = np.where(value > LIMITED_SIGMA * largest, LIMITED_SIGMA, LIMITED_DARK_SIGMA)
    by_battery = by_battery * largest * light.limited[:, None]
    unused_samples = readings.dropped | light.dark | light.idle
    unused = ~np.isfinite(readings.value) | light.spike | light.dead[None] | unused_samples[:, None]
    sigmas = (
        np.where(unused, np.inf, np.hypot(by_battery, np.hypot(each * level * gains, noise)))
        for each in (share, beside_gains, modelled_share)
    )
    return _Errors(albedo, albedo_samples, earth, fitted, gains, gain_cov, *sigmas)


def find_late_frames(telemetry: xr.Dataset) -> np.ndarray:
    """Return the samples (n) whose time does not increase: late or repeated frames."""
    time = np.asarray(telemetry["time"], dtype=np.float64)
    # fmax ignores NaN; the last slice is for an empty file
    late = np.concatenate([[False], time[1:] <= np.fmax.accumulate(time)[:-1]])[: len(time)]
    if "flag" in telemetry:
        late |= np.asarray(telemetry["flag"]) & NOT_INCREASING != 0
    return late


def remove_negative_readings(vehicle: Vehicle, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return readings (n, n_panel) with NaN for those below zero beyond noise or not finite, and a mask of the former."""
    negative = value < lowest_reading(vehicle, value)
    return np.where(negative | ~np.isfinite(value), np.nan, value), negative


def remove_spikes(vehicle: Vehicle, value: np.ndarray) -> np.ndarray:
    """Return readings (n, n_panel) with NaN for those beyond full Sun, such as fill values.

    If most samples have such a reading, the unit is wrong, and the readings are returned unchanged.
    """
    relative = value / vehicle.input_gains
    spike = relative > SPIKE_FACTOR * _full_sun(vehicle, relative)[0]
    misread = spike.any(axis=1).sum() > MISREAD_SHARE * len(value)
    return np.where(spike & ~misread, np.nan, value)


def sees_everywhere(vehicle: Vehicle) -> bool:
    """Return whether each direction of the Sun lights some panel."""
    return bool((panel_power(vehicle, sphere(DIRECTIONS)) > 0).any(axis=1).all())


def _unusable(
    telemetry: xr.Dataset,
    sound: np.ndarray,
    value: np.ndarray,
    negative: np.ndarray,
    repeats: Repeats,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the samples (n) that cannot be used at all, and the reason (n) of each, empty for the others.

    Parameters
    ----------
    sound : (n, n_panel)
        Readings without spikes; `value` are those with them.
    negative : (n, n_panel)
        Readings that were removed because they are below zero beyond noise.
    """
    empty = ~np.isfinite(value).any(axis=1)
    equals_previous = np.zeros(len(value), dtype=bool)
    empty_cell = np.isnan(sound[1:]) | np.isnan(sound[:-1])
    equals_previous[1:] = np.all((sound[1:] == sound[:-1]) | empty_cell, axis=1)
    # the first reason that applies counts
    reasons = {
        LATE: find_late_frames(telemetry),
        NEGATIVE: negative.any(axis=1) & empty,
        EMPTY: empty,
        STALE: repeats.frozen & equals_previous,
        COPY: repeats.frozen,
        HELD: repeats.repeated(PANELS),
    }
    masks = list(reasons.values())
    return np.logical_or.reduce(masks), np.select(masks, list(reasons), "").astype(object)


def _full_sun(vehicle: Vehicle, relative: np.ndarray) -> tuple[float, str]:
    """Return the brightness of full Sun in readings over gains (n, n_panel), and its origin in words.

    It is 1 if the gains are in the unit of the readings. Else it is the upper quartile of the samples with light, those brighter
    than a fifth of the median.
    """
    if vehicle.gain_unit == UNITS[vehicle.telemetry.quantity]:
        return 1.0, "the gains of the vehicle file"
    bright = brightness(vehicle, np.nan_to_num(relative) * vehicle.input_gains)
    if not len(bright) or bright.max() <= 0:
        return 1.0, "nothing: no panel is lit"
    lit = bright[bright > 0.2 * np.median(bright[bright > 0])]
    return float(np.percentile(lit, 75)), "the brighter samples of the file"


def _find_dim_samples(
    vehicle: Vehicle,
    use_value: np.ndarray,
    lit: np.ndarray,
    bright: np.ndarray,
    full: float,
    dead: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the samples (n) that are idle (far below full Sun), limited (somewhat below it), and oblique, each in at most one.

    An oblique sample is as dim as these, but a Sun of full strength in some direction explains it. With throttled inputs no sample
    counts as dim, because the battery may limit any of them.

    Parameters
    ----------
    use_value : (n, n_panel)
        Readings; zero for spikes and dead panels.
    lit, bright : (n)
        Samples with the Sun on some panel, and the brightness of all samples.
    full : float
        Brightness of full Sun.
    dead : (n_panel)
    """
    if vehicle.throttled:
        idle, limited = np.zeros((2, len(lit)), dtype=bool)
    else:
        brightest = np.maximum(bright, brightness(_with_lowest_gains(vehicle), use_value))
        idle = lit & (brightest < IDLE_FRACTION * full)
        limited = lit & ~idle & (brightest < LIMITED_FRACTION * full)
    oblique = (idle | limited) & _is_oblique(vehicle, use_value, full, dead)
    return idle & ~oblique, limited & ~oblique, oblique


def _with_lowest_gains(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle with each gain as low as its stated sigma allows (`GAIN_SIGMAS`).

    The limits of dim samples allow for errors up to `PRIOR_SIGMA`: only what is beyond it counts.
    """
    stated = np.nan_to_num(stated_sigmas(vehicle))
    beyond = np.sqrt(np.maximum(stated**2 - PRIOR_SIGMA**2, 0.0))
    return scale_gains(vehicle, np.maximum(1 - GAIN_SIGMAS * beyond, DEAD_FRACTION))


def _beyond_noise(
    vehicle: Vehicle,
    value: np.ndarray,
    light: np.ndarray,
    noise: np.ndarray,
    full: float,
    unlit_light: float,
) -> np.ndarray:
    """Return the samples (n) with at least one reading that noise does not explain.

    The noise is that of the vehicle file, else it is estimated from readings below zero, else from panels that face away from the
    Sun. The latter is at most the assumed noise: a larger reading is Earth's light.

    Parameters
    ----------
    value : (n, n_panel)
        All readings, from which noise is estimated.
    light : (n, n_panel)
        Readings that are tested; zero for spikes and dead panels.
    noise : (n_panel)
        Stated noise with the quantisation of the readings.
    full : float
        Brightness of full Sun, as a factor on the gains.
    unlit_light : float
        Reading of panels that face away from the Sun, as a share of full Sun.
    """
    sigma = noise if vehicle.input_noise is not None else dark_noise(value)
    if sigma is None:
        sigma = full * min(unlit_light, ASSUMED_SHARE) * vehicle.input_gains
    else:
        sigma = np.maximum(noise, sigma)
    return np.asarray((light > DARK_SIGMAS * sigma).any(axis=1))


def _find_dead_panels(relative: np.ndarray, full: float) -> np.ndarray:
    """Return the panels (n_panel) that never read anything in a file in which enough samples are lit.

    `relative` (n, n_panel) are readings over gains, `full` their brightness in full Sun. The brightest panel is never dead.
    """
    largest = np.nanmax(np.where(np.isfinite(relative), relative, -np.inf), axis=0, initial=-np.inf)
    n_lit = (np.nan_to_num(relative) > DEAD_FRACTION * full).any(axis=1).sum()
    is_silent = (largest < DEAD_FRACTION * full) & (largest < np.max(largest))
    return is_silent & (n_lit >= DEAD_SAMPLES)


def _is_oblique(vehicle: Vehicle, value: np.ndarray, full: float, dead: np.ndarray) -> np.ndarray:
    """Return the samples (n) that a Sun of full strength in some direction explains although the panels together give less.

    Panels that do not cover all directions give less if the Sun is oblique to all of them. Directions that light a `dead` panel
    (n_panel) are left out: then the fault of the panel and not the geometry lowers the signal.
    """
    light, gains = full * panel_power(vehicle, sphere(DIRECTIONS)), vehicle.input_gains[~dead]
    allowed = light[:, ~dead].any(axis=1) & ~light[:, dead].any(axis=1)
    model = light[allowed][:, ~dead] / gains
    oblique = np.zeros(len(value), dtype=bool)
    if not len(model):
        return oblique
    for start in range(0, len(value), CHUNK):
        rows = slice(start, start + CHUNK)
        measured = value[rows][:, ~dead] / gains
        # |measured - model|^2 of each sample and direction, multiplied out
        square = (
            (measured**2).sum(axis=1)[:, None] - 2 * measured @ model.T + (model**2).sum(axis=1)
        )
        oblique[rows] = square.min(axis=1) < len(gains) * (OBLIQUE_MISFIT * full) ** 2
    return oblique


def _quantisation_step(value: np.ndarray) -> float:
    """Return the step of quantised readings, or zero if they are not quantised.

    It is the smallest difference between two readings, if nine of ten differences between successive levels are whole multiples of
    it, to 1 % of the step. With fewer than five differences this would prove nothing, and the step is zero.
    """
    levels = np.unique(value[np.isfinite(value)][:QUANTUM_SAMPLES])
    gaps = np.diff(levels)
    gaps = gaps[
        gaps > 1e-9 * max(np.abs(levels).max(initial=0.0), 1e-300)
    ]  # smaller ones are rounding
    if len(gaps) < 5:
        return 0.0
    multiples = gaps / gaps.min()
    whole = np.abs(multiples - np.round(multiples)) < 0.01
    return float(gaps.min()) if np.mean(whole) > 0.9 else 0.0


def _estimate_albedo(away: np.ndarray) -> tuple[float, int]:
    """Return the light on panels that face away from the Sun, as a share of full Sun, and the number of readings behind it.

    It is the 84 % quantile, 1 to 30 %, of the readings `away` (n, n_pair) of panels opposite to sunlit ones (:func:`_facing_away`).
    With fewer than `ALBEDO_READINGS` readings it is `ALBEDO_DEFAULT`.
    """
    dark = away[np.isfinite(away)]
    enough = len(dark) >= ALBEDO_READINGS
    albedo = float(np.clip(np.percentile(dark, 84), 0.01, 0.3)) if enough else ALBEDO_DEFAULT
    return albedo, len(dark)


def _facing_away(vehicle: Vehicle, share: np.ndarray) -> np.ndarray:
    """Return the readings (n, n_pair) of panels opposite to sunlit ones, NaN if the opposite one is not lit.

    `share` (n, n_panel) and the result are shares of full Sun.
    """
    response = vehicle.response_in()
    model = response.power(sphere(DIRECTIONS)) / vehicle.input_gains
    # both_lit[i, j]: in some direction panel i gets light while panel j faces the Sun, so i is not dark then
    both_lit = (model > 0).T.astype(int) @ (model > FACED) > 0
    pairs = np.argwhere(opposite_panels(response.facing_B) & ~both_lit)
    dark, lit = share[:, pairs[:, 0]], share[:, pairs[:, 1]] > FACED
    return np.where(lit, dark, np.nan)


def _passing_light(t_s: np.ndarray, away: np.ndarray, kept: np.ndarray, least: float) -> np.ndarray:
    """Return the light (n) on panels that face away from the Sun, where it is clearly more than in the rest of the file.

    The Earth's light that grows towards the end of a pass is not in the `albedo` of most samples. The light of a sample is the
    largest of those near it in rows and in time, because the rotation of the body shows it to other panels.

    Parameters
    ----------
    t_s : (n)
        Times of samples, s.
    away : (n, n_pair)
        Readings of panels opposite to sunlit ones, as :func:`_facing_away` returns them.
    kept : (n)
        Samples that count.
    least : float
        Smallest share of full Sun that is clearly more than in the rest of the file.
    """
    largest = np.nanmax(away, axis=1, initial=0.0)
    clear = kept & (largest > least) & (largest < PASSING_MOST)
    interval_s = np.median(np.diff(np.unique(t_s[kept]))) if kept.sum() > 1 else np.inf
    light = np.zeros(len(away))
    for row in np.flatnonzero(clear):
        rows = slice(max(row - PASSING_NEAR, 0), row + PASSING_NEAR + 1)
        near = np.abs(t_s[rows] - t_s[row]) <= PASSING_INTERVALS * interval_s
        light[rows] = np.maximum(light[rows], np.where(near, largest[row], 0.0))
    return light


def _earth_light(albedo: float, readings: int, noise: float) -> float:
    """Return the Earth's light on a panel whose normal points to the Earth, as a share of full Sun.

    `albedo`: 84 % quantile of the readings of panels that face away from the Sun; `noise`: one sigma of a reading (shares of full
    Sun). `readings`: number of these readings. With fewer than `ALBEDO_READINGS` the result is 0.

    A panel at the angle a from the Earth gets cos(a) of that light, so the 84 % quantile over random directions is
    `COSINE_QUANTILE` of it. The noise is subtracted in squares, as if quantiles of 84 % were sigmas of normal errors.
    """
    if readings < ALBEDO_READINGS:
        return 0.0
    # sqrt(albedo^2 - noise^2) as a product: squares of wrongly scaled readings would overflow
    return float(np.sqrt(max((albedo - noise) * (albedo + noise), 0.0)) / COSINE_QUANTILE)


def count_reasons(quality: Any) -> dict[str, int]:
    """Return the number of samples for each reason (sentence in `why`) of a Dataset of `judge_readings`, most frequent first."""
    texts, counts = np.unique(quality["why"].values, return_counts=True)
    return dict(
        sorted(zip(texts.tolist(), counts.tolist(), strict=True), key=lambda item: -item[1])
    )
