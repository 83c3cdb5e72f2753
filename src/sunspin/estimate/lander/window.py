"""Observations of a lander from telemetry: every reading of one stretch without impacts, those of unlit panels too."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from scipy.special import logsumexp

from sunspin.base.errors import InputError
from sunspin.estimate.model import Observations
from sunspin.estimate.settings import GridSettings
from sunspin.estimate.terms.given import Given, require_usable
from sunspin.estimate.terms.powers import PanelPowers
from sunspin.telemetry.assess import Assessment
from sunspin.telemetry.signals import signals
from sunspin.telemetry.sun import LIT_SIGMAS, is_reconstructed, sun_directions
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response import panels
from sunspin.vehicle.response.planes import sphere

FREE_PHASE = "first_rebound"
"""Phase that is used if a file has several and none is asked for: of Philae's, the one without an impact and with its wheel
running."""

MOST_SAMPLES = 600
"""If there are more samples, evenly spaced ones are used: fewer determine the motion as well."""

MOST_NAMED = 12
"""Phases that an error for an unknown phase names, at most."""

LIKELY_UNIT = 0.5, 1.2
"""Limits of the likeliest brightness between which stated gains in W or A are taken to be right, if no sample gives a direction."""

BRIGHTEST = 40
"""Number of the brightest samples that determine the likeliest brightness."""

BETWEEN_RAD = 0.03
"""Largest angle of a direction from the nearest of those that are tried for the brightness."""

BRIGHTNESS_STEP, DIMMEST, WIDEST = 0.02, 0.03, 3.0
"""Step of the log of the brightness that is tried, and its limits as parts of the brightest reading over its gain."""


@dataclass(frozen=True)
class Window:
    """Observations of one stretch of telemetry; their times count from its first sample, which is `start_s` after the epoch.

    `noise_from`: source of the noise of the panels, in words; `remarks`: what was left out, in words.
    """

    obs: Observations
    start_s: float
    noise_from: str
    remarks: tuple[str, ...]


def observe_window(
    assessment: Assessment,
    begin_s: float | None = None,
    end_s: float | None = None,
    phase: str | None = None,
    observations: Sequence[Mapping[str, Any]] = (),
) -> Window:
    """Return all usable readings of a stretch of telemetry, and other observations, each at a sample of its own time.

    `begin_s`, `end_s` (s from the epoch) or `phase` bound the stretch; `observations` as in :func:`sunspin.posterior`. The wheels'
    momentum is zero here: `LanderModel` has the wheels. Raises `InputError` for fewer than three lit samples or an unknown name.
    """
    vehicle, telemetry, quality = assessment.vehicle, assessment.telemetry, assessment.quality
    vehicle.require_panels()
    power, times = signals(telemetry), np.asarray(telemetry["time"], dtype=np.float64)
    if power.ndim != 2 or power.shape[1] != len(vehicle.inputs):
        what = "the telemetry's panels are not the vehicle's"
        raise InputError(what, got=f"{power.shape[-1]} columns")
    inside, remarks = _stretch(telemetry, times, begin_s, end_s, phase)
    measured = quality["measured"].values
    index = np.flatnonzero(inside & np.isfinite(times) & measured.any(axis=1))
    remarks += _left_out(quality, np.isfinite(power), inside)
    remarks += [assessment.repeats.doubt] if assessment.repeats.unsure[index].any() else []
    if len(index) > MOST_SAMPLES:
        remarks.append(f"{len(index)} samples were thinned to {MOST_SAMPLES}")
        even = np.linspace(0, len(index) - 1, MOST_SAMPLES).round().astype(int)
        index = index[np.unique(even)]
    used = measured[index]
    power = np.where(used, power[index], 0.0)
    # (n_panel) the threshold of the directions to the Sun: that of the file; else one above the light on unlit panels, or the noise
    threshold = assessment.sun["lit_threshold"].values
    lit = (used & (power > threshold)).any(axis=1)
    if np.count_nonzero(lit) < 3:
        raise InputError(
            "a motion needs three samples with a lit panel",
            got=f"{np.count_nonzero(lit)} in the window",
            do="widen the window; `sunspin check` says what is wrong with samples",
        )
    sigma, noise_from = assessment.noise
    brightness = _brightness(vehicle, power, used, sigma, threshold)
    require_usable(observations, float(times[index[0]]), float(times[index[-1]]))

    # The samples are at all distinct times of readings and other observations. `place`: number of the sample of each reading, then
    # of each other observation. A sample that only another observation has is one without readings of panels.
    given_s = np.array([float(observation["t_s"]) for observation in observations])
    t_s, place = np.unique(np.concatenate([times[index], given_s]), return_inverse=True)
    place_read, place_given = np.split(place.ravel(), [len(index)])
    all_power, all_used = (np.zeros((len(t_s), power.shape[1]), kind) for kind in (float, bool))
    all_power[place_read], all_used[place_read] = power, used
    readings = PanelPowers(
        power=all_power,
        used=all_used,
        sigma=np.asarray(sigma, dtype=np.float64),
        threshold=threshold,
        largest=float(power[used].max()),
        response=vehicle.response_in(),
        brightness=brightness,
        throttled=vehicle.throttled,
    )
    given = tuple(
        Given.of(observation, int(sample), len(t_s))
        for observation, sample in zip(observations, place_given, strict=True)
    )
    obs = Observations(t_s - t_s[0], np.zeros((len(t_s), 3)), (readings, *given))
    return Window(obs, float(t_s[0]), noise_from, tuple(remarks))


def _stretch(
    telemetry: xr.Dataset,
    times: np.ndarray,
    begin_s: float | None,
    end_s: float | None,
    phase: str | None,
) -> tuple[np.ndarray, list[str]]:
    """Return which samples at `times` (n), s, lie in the requested stretch, as a mask (n), and remarks in words.

    Without phase and limits only FREE_PHASE is used if the file has several phases. Raises `InputError` if the file lacks the
    phase.
    """
    inside, remarks = np.ones(len(times), dtype=bool), []
    phases = np.array([], dtype=str)
    if "phase" in telemetry.coords:
        phases = np.asarray(telemetry["phase"]).astype(str)
    names = list(dict.fromkeys(phases.tolist()))
    if phase is None and begin_s is None and end_s is None and len(names) > 1:
        if FREE_PHASE not in names:
            raise InputError(
                "the telemetry has several phases, which are not one motion",
                got=", ".join(names),
                do="name one, or give begin and end",
            )
        phase = FREE_PHASE
        remarks.append(f"of the phases in the file only {phase} was used")
    if phase is not None:
        if phase not in names:
            available = f"it has {', '.join(names[:MOST_NAMED])}" if names else "it names none"
            raise InputError("the telemetry has no such phase", got=phase, do=available)
        inside &= phases == phase
    inside &= times >= (-np.inf if begin_s is None else begin_s)
    inside &= times <= (np.inf if end_s is None else end_s)
    return inside, remarks


def _left_out(quality: xr.Dataset, is_finite: np.ndarray, inside: np.ndarray) -> list[str]:
    """Return remarks on samples that were left out wholly or in part: how many for each reason.

    `quality`: use of each sample and reading; `is_finite` (n, p): readings that are numbers; `inside` (n): samples of the stretch.
    """
    measured, why = quality["measured"].values, quality["why"].values
    wholly = inside & ~measured.any(axis=1)
    # a panel that is dead in the whole file ("missed") is no reason of a single sample
    unused = is_finite & ~measured & ~quality["missed"].values
    partly = inside & ~wholly & unused.any(axis=1)
    # a text is "dropped: REASON", "down-weighted: REASON" or "used: REASON"
    reasons = Counter(str(text) for text in why[wholly | partly] if not text.startswith("used"))
    return [
        f"left out in {count} sample{'s' * (count > 1)}: {text.partition(': ')[2]}"
        for text, count in reasons.most_common()
    ]


def _brightness(
    vehicle: Vehicle, power: np.ndarray, used: np.ndarray, sigma: np.ndarray, threshold: np.ndarray
) -> float:
    """Return a first guess of the brightness, the signal of a panel of gain one at normal incidence, from readings (n, p).

    1. It is the median over samples whose readings determine a direction to the Sun, if there are any.
    2. Else, if gains have a unit and the likeliest brightness is near one (`LIKELY_UNIT`), the gains are believed: one.
    3. Else it is the likeliest brightness.

    Only panels lit clearly above the noise count for a direction. With a small threshold half of the dark panels would pass as
    lit: at 2 to 4 % noise one guess in three was off by more than 10 %, and then no start of the search settled.
    """
    surely_lit = np.maximum(threshold, LIT_SIGMAS * sigma)
    power = np.where(used, power, 0.0)
    status = sun_directions(vehicle, power, noise=sigma, lit_threshold=surely_lit)["status"].values
    has_direction = is_reconstructed(status) & used.all(axis=1)
    if has_direction.any():
        return float(np.median(panels.brightness(vehicle, power[has_direction])))
    likeliest = _likeliest_brightness(vehicle, np.maximum(power, 0.0), used, sigma)
    gains_believed = vehicle.gain_unit is not None and LIKELY_UNIT[0] < likeliest < LIKELY_UNIT[1]
    return 1.0 if gains_believed else likeliest


def _likeliest_brightness(
    vehicle: Vehicle, power: np.ndarray, used: np.ndarray, sigma: np.ndarray
) -> float:
    """Return the brightness under which readings (n, p) are the likeliest, if the directions of samples are uniform on the sphere.

    It is not enough that the Sun of each sample may have some direction: too bright a Sun is not contradicted if no panel faces it.
    But then most directions would have to be near the edge of what panels see, which is improbable.
    """
    grid = GridSettings()
    light = power / vehicle.input_gains
    samples = np.argsort(-np.linalg.norm(light, axis=1), kind="stable")[:BRIGHTEST]
    # the dark samples of an eclipse bound nothing
    samples = samples[light[samples].max(axis=1) > 0]
    largest = light[samples].max(axis=1)
    low = max(float(np.median(largest)), DIMMEST * float(largest.max()))
    tried = np.exp(np.arange(np.log(low), np.log(WIDEST * largest.max()), BRIGHTNESS_STEP))
    unit_power = panels.panel_power(vehicle, sphere(grid.directions))  # (directions, p)
    log_density = np.zeros(len(tried))
    for i, brightness in enumerate(tried):
        # The noise, and for an input in the light the change of its power from a direction to the nearest one that is tried. If
        # unlit ones had that too, each dark reading would favour a low brightness.
        change = np.where(unit_power > 0, BETWEEN_RAD * brightness * vehicle.input_gains, 0.0)
        spread = np.hypot(sigma, change)  # (directions, p)
        for k in samples:
            square = np.minimum(((brightness * unit_power - power[k]) / spread) ** 2, grid.cap)
            log_density[i] += float(logsumexp(-(0.5 * square + np.log(spread)) @ used[k]))
    return float(tried[np.argmax(log_density)])


def with_unknowns(obs: Observations, readings: PanelPowers) -> Observations:
    """Return observations with `readings`, the same panels with their unknowns, in place of the panels."""
    terms = tuple(readings if isinstance(term, PanelPowers) else term for term in obs.terms)
    return replace(obs, terms=terms)
