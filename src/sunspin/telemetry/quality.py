"""What each panel reading is worth: dead panels, power-limited samples, albedo, spikes, stale frames; and why, in words.

Nothing is thrown away in silence. A reading that cannot be the Sun's gets an infinite sigma, one that may be something else
as well gets a larger sigma, and every sample carries a sentence.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.provenance import provenance
from sunspin.telemetry.gains import (
    UNKNOWN_SIGMA,
    UNTOLD_SIGMA,
    estimate_gains,
    prior_sigmas,
)
from sunspin.telemetry.noise import ASSUMED_SHARE, dark_noise, lowest_reading
from sunspin.telemetry.repeats import PANELS, Repeats, find_repeats
from sunspin.telemetry.signals import signals
from sunspin.telemetry.silent import lost
from sunspin.telemetry.units import UNITS, WrongUnit
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import brightness, opposite_panels, panel_power
from sunspin.vehicle.response.planes import sphere

DEAD_FRACTION = 0.05
"""A panel that never exceeds this fraction of its gain, in a file that is long enough, is taken as dead."""

DARK_SIGMAS = 4.0
"""Without a reading of so many sigma of noise a sample tells of no Sun: in the shadow noise makes one of six panels read as much in
2 of 10,000 samples, and at three sigma in one of 120, which panels on some sides only would take for a Sun that stands aside."""

DEAD_SAMPLES = 20
"""Samples with some panel lit before a panel may be called dead."""

LIMITED_FRACTION = 0.85
"""Panels together below this fraction of full Sun: the battery, not the Sun, sets the current, or a dead panel is lit."""

SPIKE_FACTOR = 1.6
"""A reading above this many times full Sun is a wrapped counter or a spike; Earth's albedo adds at most 0.4."""

EARTH_LEFT = 0.25
"""Part of the light on dark panels that no smooth beam explains: clouds and coasts."""

ALBEDO_DEFAULT = 0.06
"""Fraction of full Sun that Earth's light may put on a dark panel, where the file has too few samples to tell."""

TOLD_READINGS = 10
"""Readings of faces away from the Sun that tell the Earth's light."""

LIT_SHARE = 0.5
"""Of the Earth's light on a panel to the Sun's, averaged over the samples in which it is lit, at most."""

FACED = 0.3
"""A panel that gets this share of full Sun looks at the Sun, and one opposite to it does not."""

COSINE_QUANTILE = 0.68
"""The 84 % quantile of a face's cosine to the Earth, none being negative, over all directions."""

SURELY_LIT = 2.0
"""A reading of more than this many times the albedo is the Sun's; below, it may be the Earth's."""

QUANTUM_SAMPLES = 20_000
"""Readings looked at for their quantisation."""

IDLE_FRACTION = 0.35
"""Below this fraction of full Sun nothing is learnt: on skCUBE the panels that stood less in the Sun then gave the current."""

LIMITED_SIGMA = 0.5
"""Error of a power-limited reading, as a fraction of the sample's largest: the lit side is right, the ratio is not."""

LIMITED_DARK_SIGMA = 1.0
"""The same of a panel that gives little in such a sample: it may stand in the Sun while another feeds the battery."""

LIMITED_SCALE = 2.0
"""Relative uncertainty of the scale of a power-limited sample: as good as unknown."""

CLEAN_SCALE = 0.06
"""Relative uncertainty of the scale of a sample in full Sun: cell temperature and spread of gains."""

NOT_INCREASING = 4
"""The bit of `flag` of a time that does not increase (`sunspin.telemetry.reader.FLAGS`)."""

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
"""If more than this part of the samples is beyond full Sun, the unit is wrong and no reading is a spike."""

FULL_SHARE = 0.05
"""If fewer lit samples than this part reach full Sun, the gains are too high and not the battery limits the current."""

ASIDE = "used: signal below full Sun (oblique Sun, or battery-limited; the data cannot distinguish them)"

DIRECTIONS = 3000
"""Directions (about 4 degrees apart) among which the Sun is looked for beside the panels."""

ASIDE_FRACTION = 0.08
"""Misfit of each reading, as a fraction of full Sun, up to which a Sun of full strength explains a sample."""

CHUNK = 20_000
"""Samples looked at once."""

USED, DOWNWEIGHTED, DROPPED = 0, 1, 2


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
        Gives the wrong unit of the readings, which is named where no panel is lit.
    repeats : Repeats, optional
        Samples that repeat earlier ones; default: they are looked for.

    Returns
    -------
    xarray.Dataset
        `sigma` (time, panel), in the unit of the gains, infinite where a reading tells nothing, and `sigma_beside_earth`, the same
        where the Earth's light is modelled; `scale` (time), the factor between gain and reading at full Sun, and its relative
        uncertainty `scale_sigma` (time); `use` (time): 0 used, 1 down-weighted, 2 dropped; `why` (time): a sentence;
        `reading` (time, panel): the panel was read, in the light or not; `measured` (time, panel): the reading depends on the Sun
        direction alone. Of each panel: `dead`, it reads nothing and is left out; `missed`, the others show that the Sun was on it
        nevertheless; `weak`, its gain is too low for those of the others; `gain`, `gain_sigma`, `gain_cov`; `noise`, of a reading
        with its quantisation. attrs:
        `full_sun` (scale of a clean sample), `albedo` (fraction of full Sun on dark panels), `spread` (relative scatter of full
        Sun; NaN: not told), `noise` (the median of that over panels), `full_sun_from`, `gains_from`.
    """
    value, negative = known_readings(vehicle, signals(telemetry))
    gains = vehicle.input_gains
    usable = ~came_late(telemetry) & np.isfinite(value).any(axis=1)
    sound_value = without_spikes(vehicle, value)
    repeats = find_repeats(telemetry, sound_value, usable) if repeats is None else repeats
    dropped, why = _unusable(telemetry, sound_value, value, negative, repeats)
    held = np.zeros(value.shape, dtype=bool) if repeats.columns is None else repeats.columns
    value = np.where(held, np.nan, value)
    relative = value / gains
    good = ~dropped
    full, source = _full_sun(vehicle, relative[good])
    spike = np.isfinite(relative) & (relative > SPIKE_FACTOR * full)
    stated = vehicle.input_noise
    noise = np.hypot(
        np.zeros(len(gains)) if stated is None else stated, _quantum(value[good]) / np.sqrt(12)
    )
    sound = good & ~spike.any(axis=1)
    missed = lost(vehicle, telemetry["time"].values[sound], relative[sound] / full, noise / full)
    dead = _dead(relative[good], full) | missed
    use_value = np.where(np.isfinite(value) & ~spike & ~dead, value, 0.0)
    bright = brightness(vehicle, use_value)
    dark = bright < DEAD_FRACTION * full
    dark |= ~_beyond_noise(
        vehicle,
        value,
        use_value,
        noise,
        full,
        _albedo(vehicle, relative[sound & ~dark] / full)[0],
    )
    idle = good & ~dark & (bright < IDLE_FRACTION * full)
    limited = good & ~dark & ~idle & (bright < LIMITED_FRACTION * full)
    level = np.full((len(value), 1), full)  # of a sample in the light that its brightness says
    if vehicle.throttled:  # the battery may limit any sample, and all readings of it alike
        idle, limited = np.zeros((2, len(dark)), dtype=bool)
        level = np.maximum(bright, 1e-12)[:, None]
    aside = (idle | limited) & _aside(vehicle, use_value, full, dead)
    idle, limited = idle & ~aside, limited & ~aside
    clean = good & ~limited & ~idle & ~dark
    albedo, seen = _albedo(vehicle, (relative / level)[clean])
    earth = _earth_light(albedo, seen, float(np.median(noise) / (full * np.median(gains))))
    fitted = estimate_gains(vehicle, use_value[clean], full, dead, missed, earth)
    gains = gains * fitted.factor
    of_lit, own = fitted.spread, fitted.covariance
    if of_lit is None:
        # gains may be off by their prior: a string of cells may be dead or a full scale wrong, and all samples have that in common
        of_lit = np.hypot(albedo, fitted.sigma * use_value / (level * gains))
        own = np.diag(prior_sigmas(vehicle, UNKNOWN_SIGMA) ** 2)
    # what the Earth adds to a lit panel on average is taken for its gain
    gain_cov = own + np.eye(len(gains)) * (LIT_SHARE * earth) ** 2
    share = np.where(use_value > SURELY_LIT * albedo * level * gains, of_lit, albedo)
    # what no beam explains; noise that the file does not state is in that light too: as much as full Sun scatters, else all of it
    unknown = albedo if fitted.spread is None else min(fitted.spread, albedo)
    left = max(EARTH_LEFT * albedo, unknown if stated is None else 0.0)
    beside = np.minimum(share, np.hypot(left, np.where(share == albedo, 0.0, UNTOLD_SIGMA)))
    floor = np.hypot(share * level * gains, noise)
    largest = use_value.max(axis=1, initial=0.0)[:, None]
    by_battery = np.where(use_value > LIMITED_SIGMA * largest, LIMITED_SIGMA, LIMITED_DARK_SIGMA)
    sigma = by_battery * largest * limited[:, None]
    nothing = ~np.isfinite(value) | spike | dead[None] | (dropped | dark | idle)[:, None]
    beside = np.where(nothing, np.inf, np.hypot(sigma, np.hypot(beside * level * gains, noise)))
    sigma = np.where(nothing, np.inf, np.hypot(sigma, floor))
    wrong = wrong_unit() if dark[good].any() else None
    nothing_lit = "dropped: no panel lit" if wrong is None else f"dropped: {wrong}"
    partly = spike.any(axis=1), negative.any(axis=1), held.any(axis=1)
    down = np.logical_or.reduce([limited, *partly])
    use = np.select([dropped | dark | idle, down], [DROPPED, DOWNWEIGHTED], USED)
    why = np.select(
        [dropped, dark, idle, limited, *partly, aside],
        [why, nothing_lit, IDLE, BELOW_FULL, BEYOND_FULL, BELOW_NOISE, PARTLY_HELD, ASIDE],
        "used",
    )
    missed |= dead & vehicle.throttled
    # a file all beyond full Sun, or all below, has other units or gains, which is reported as such: its readings are readings
    lit = good & ~dark
    beyond = partly[0][good].sum() > MISREAD_SHARE * good.sum()
    below = (bright[lit] >= LIMITED_FRACTION * full).sum() < FULL_SHARE * lit.sum()
    read = np.isfinite(value) & (beyond | ~spike) & ~missed & good[:, None]
    # the Sun may be where no panel looks; if panels look everywhere, a dark sample is in the shadow
    shadow = dark & (wrong is None and sees_everywhere(vehicle))
    # what full Sun gives must be stated: by the file's brighter samples alone a shadowed panel looks like a full battery
    stated_full = vehicle.gain_unit == UNITS[vehicle.telemetry.quantity]
    dim = (idle | limited) & (not below)
    measured = read & ~((dim | shadow) & (stated_full and not beyond))[:, None]
    scale = np.where(limited, np.maximum(bright, 1e-12), level[:, 0])
    scale_sigma = np.where(limited | vehicle.throttled, LIMITED_SCALE, fitted.spread or CLEAN_SCALE)
    stated_gains = vehicle.input_gains
    uses = {"flag_values": [0, 1, 2], "flag_meanings": "used downweighted dropped"}
    of_earth = "the same where the Earth's light is modelled"
    variables: dict[str, Any] = {
        "sigma": (sigma, {"long_name": "one sigma of a reading, unit of the gains"}),
        "sigma_beside_earth": (beside, {"long_name": of_earth}),
        "reading": (read, {"long_name": "the panel was read"}),
        "measured": (measured, {"long_name": "the reading depends on the Sun direction alone"}),
        "scale": (scale, {"units": "1"}),
        "scale_sigma": (scale_sigma, {"units": "1"}),
        "use": (use.astype(np.int8), uses),
        "why": (why.astype(np.str_), {}),
    }
    of_panels = {
        "gain": (gains, {"long_name": "gain of each panel, unit of the vehicle's gains"}),
        "gain_sigma": (np.sqrt(np.diag(gain_cov)) * stated_gains, {}),
        "gain_cov": (gain_cov * np.outer(stated_gains, stated_gains), {}),
        "noise": (noise, {}),
        "dead": (dead, {}),
        "weak": (fitted.weak, {}),
        "missed": (missed, {}),
    }
    return xr.Dataset(
        {name: (("time", "panel")[: v.ndim], v, about) for name, (v, about) in variables.items()}
        | {
            name: (("panel", "panel2")[: v.ndim], v, about)
            for name, (v, about) in of_panels.items()
        },
        coords={name: telemetry[name] for name in ("time", "panel") if name in telemetry.coords},
        attrs=provenance("panel_quality", telemetry, **vehicle.result_attributes)
        | {
            "full_sun": float(full),
            "albedo": float(albedo),
            "albedo_samples": seen,
            "full_sun_from": source,
            "gains_from": fitted.source,
            "earth_light": earth,
            "noise": float(np.median(noise)),
            "spread": np.nan if fitted.spread is None else fitted.spread,
        },
    )


def came_late(telemetry: xr.Dataset) -> np.ndarray:
    """Return which samples (n) are late or repeated frames: their time does not increase."""
    time = np.asarray(telemetry["time"], dtype=np.float64)
    late = np.concatenate([[False], time[1:] <= np.fmax.accumulate(time)[:-1]])[: len(time)]
    if "flag" in telemetry:
        late |= np.asarray(telemetry["flag"]) & NOT_INCREASING != 0
    return late


def known_readings(vehicle: Vehicle, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return readings (n, n_panel) without those far below zero, which no panel gives, and which those are (n, n_panel)."""
    negative = value < lowest_reading(vehicle, value)
    return np.where(negative | ~np.isfinite(value), np.nan, value), negative


def without_spikes(vehicle: Vehicle, value: np.ndarray) -> np.ndarray:
    """Return readings (n, n_panel) without those beyond full Sun, as fill values are; all of them if most samples have one."""
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
    """Return samples that cannot be used at all (n), and why (n); `sound` are the readings (n, n_panel) without spikes."""
    empty = ~np.isfinite(value).any(axis=1)
    late = came_late(telemetry)
    repeated = repeats.frozen
    again = np.zeros(len(value), dtype=bool)
    empty_cell = np.isnan(sound[1:]) | np.isnan(sound[:-1])
    again[1:] = np.all((sound[1:] == sound[:-1]) | empty_cell, axis=1)
    held = repeats.of(PANELS) & ~repeated
    reasons = [late, negative.any(axis=1) & empty, empty, repeated & again, repeated, held]
    why = np.select(reasons, [LATE, NEGATIVE, EMPTY, STALE, COPY, HELD], "").astype(object)
    return np.logical_or.reduce(reasons), why


def _full_sun(vehicle: Vehicle, relative: np.ndarray) -> tuple[float, str]:
    """The scale of readings in full Sun: one where gains are given in the reading's unit, else from the brightest samples."""
    if vehicle.gain_unit == UNITS[vehicle.telemetry.quantity]:
        return 1.0, "the gains of the vehicle file"
    bright = brightness(vehicle, np.nan_to_num(relative) * vehicle.input_gains)
    if not len(bright) or bright.max() <= 0:
        return 1.0, "nothing: no panel is lit"
    lit = bright[bright > 0.2 * np.median(bright[bright > 0])]
    return float(np.percentile(lit, 75)), "the brighter samples of the file"


def _beyond_noise(
    vehicle: Vehicle,
    value: np.ndarray,
    light: np.ndarray,
    noise: np.ndarray,
    full: float,
    away: float,
) -> np.ndarray:
    """Which samples (n) have a reading of `light` (n, n_panel) that noise does not make: noise as stated, else what readings below
    zero of all `value` tell, else what panels that face away from the Sun read, `away` (of full Sun, which is `full` of the gain),
    but no more than the noise that is assumed: the rest is the Earth's light."""
    sigma = noise if vehicle.input_noise is not None else dark_noise(value)
    by_noise = (
        np.maximum(noise, sigma)
        if sigma is not None
        else full * min(away, ASSUMED_SHARE) * vehicle.input_gains
    )
    return np.asarray((light > DARK_SIGMAS * by_noise).any(axis=1))


def _dead(relative: np.ndarray, full: float) -> np.ndarray:
    high = np.nanmax(np.where(np.isfinite(relative), relative, -np.inf), axis=0, initial=-np.inf)
    lit = (np.nan_to_num(relative) > DEAD_FRACTION * full).any(axis=1).sum()
    return (high < DEAD_FRACTION * full) & (lit >= DEAD_SAMPLES) & (high < np.max(high))


def _aside(vehicle: Vehicle, value: np.ndarray, full: float, dead: np.ndarray) -> np.ndarray:
    """Samples (n) that a Sun of full strength in some direction explains although their panels together give less.

    Panels that do not look all around see the Sun shortened where it stands aside. A dead panel is none of them: that it is
    lit is a fault and no geometry.
    """
    light, gains = full * panel_power(vehicle, sphere(DIRECTIONS)), vehicle.input_gains[~dead]
    shown = light[:, ~dead].any(axis=1) & ~light[:, dead].any(axis=1)
    model = light[shown][:, ~dead] / gains
    aside = np.zeros(len(value), dtype=bool)
    for start in range(0, len(value) if len(model) else 0, CHUNK):
        rows = slice(start, start + CHUNK)
        seen = value[rows][:, ~dead] / gains
        square = (seen**2).sum(axis=1)[:, None] - 2 * seen @ model.T + (model**2).sum(axis=1)
        aside[rows] = square.min(axis=1) < len(gains) * (ASIDE_FRACTION * full) ** 2
    return aside


def _quantum(value: np.ndarray) -> float:
    """Step of quantised readings: the smallest difference, where most differences are whole multiples of it; else zero."""
    steps = np.unique(value[np.isfinite(value)][:QUANTUM_SAMPLES])
    gaps = np.diff(steps)
    gaps = gaps[gaps > 1e-9 * max(np.abs(steps).max(initial=0.0), 1e-300)]
    if len(gaps) < 5:
        return 0.0
    turns = gaps / gaps.min()
    return float(gaps.min()) if np.mean(np.abs(turns - np.round(turns)) < 0.01) > 0.9 else 0.0


def _albedo(vehicle: Vehicle, share: np.ndarray) -> tuple[float, int]:
    """Earth's light on panels that face away from the Sun: high quantile of what panels opposite to brighter ones read, and
    how many readings tell it."""
    response = vehicle.response_in()
    seen = response.power(sphere(DIRECTIONS)) / vehicle.input_gains
    both = (seen > 0).T.astype(int) @ (
        seen > FACED
    ) > 0  # a panel gets light where another faces the Sun
    away = np.argwhere(opposite_panels(response.facing_B) & ~both)
    readings = [share[share[:, j] > FACED, i] for i, j in away]
    dark = np.concatenate(readings) if readings else np.zeros(0)
    dark = dark[np.isfinite(dark)]
    enough = len(dark) >= TOLD_READINGS
    albedo = float(np.clip(np.percentile(dark, 84), 0.01, 0.3)) if enough else ALBEDO_DEFAULT
    return albedo, len(dark)


def _earth_light(albedo: float, seen: int, noise: float) -> float:
    """What a panel gets that looks straight at the Earth, a share of full Sun, if `albedo` is the quantile of what faces away
    from the Sun get, noise included; 0 where the file does not tell."""
    if seen < TOLD_READINGS:
        return 0.0
    return float(np.sqrt(max((albedo - noise) * (albedo + noise), 0.0)) / COSINE_QUANTILE)


def reasons(quality: Any) -> dict[str, int]:
    """Number of samples for each sentence, most frequent first."""
    texts, counts = np.unique(quality["why"].values, return_counts=True)
    return dict(
        sorted(zip(texts.tolist(), counts.tolist(), strict=True), key=lambda item: -item[1])
    )
