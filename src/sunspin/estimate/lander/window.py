"""Observations of a lander from telemetry: every reading of one stretch without impacts, dark ones too."""

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
from sunspin.estimate.terms.given import Given, require_known
from sunspin.estimate.terms.powers import PanelPowers
from sunspin.telemetry.assess import Assessment
from sunspin.telemetry.signals import signals
from sunspin.telemetry.sun import LIT_SIGMAS, is_reconstructed, sun_directions
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response import panels
from sunspin.vehicle.response.planes import sphere

FREE_PHASE = "first_rebound"
"""Phase that is used if a file has several and none is given: of Philae's, the one without an impact and with its wheel running."""

MOST_SAMPLES = 600
"""If there are more samples, evenly spaced ones are used: fewer determine the motion as well."""

MOST_NAMED = 12
"""Phases that the refusal of an unknown phase names, at most."""

LIKELY_UNIT = 0.5, 1.2
"""Estimated brightness between which stated gains in W or A may be right, if few panels determine it."""

BRIGHTEST = 40
"""Number of the brightest samples that determine the brightness."""

BETWEEN_RAD = 0.03
"""Largest angle of a direction from the nearest of those that are tried for the brightness."""

BRIGHTNESS_STEP, DIMMEST, WIDEST = 0.02, 0.03, 3.0
"""Step of the log brightness, and its limits over the brightest reading."""


@dataclass(frozen=True)
class Window:
    """Observations of one stretch of telemetry; their times count from its first sample, `start_s` after the epoch.

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

    `begin_s`, `end_s` (s from the epoch) or `phase` bound the stretch. Raises `InputError` for fewer than three samples with a lit
    panel, an unknown phase or observation.
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
    threshold = float(vehicle.telemetry.lit_threshold or 0.0)
    lit = (used & (power > threshold)).any(axis=1)
    if np.count_nonzero(lit) < 3:
        raise InputError(
            "a motion needs three samples with a lit panel",
            got=f"{np.count_nonzero(lit)} in the window",
            do="widen the window; `sunspin check` says what is wrong with samples",
        )
    sigma, noise_from = assessment.noise
    guess = _brightness(vehicle, power, used, sigma, threshold)
    require_known(observations, float(times[index[0]]), float(times[index[-1]]))

    # an observation becomes a sample without panels, unless there is a sample at exactly its time
    given_s = np.array([float(observation["t_s"]) for observation in observations])
    t_s, sample_of = np.unique(np.concatenate([times[index], given_s]), return_inverse=True)
    at_samples, at_given = np.split(sample_of.ravel(), [len(index)])
    whole_power, whole_used = (np.zeros((len(t_s), power.shape[1]), kind) for kind in (float, bool))
    whole_power[at_samples], whole_used[at_samples] = power, used
    read = PanelPowers(
        power=whole_power,
        used=whole_used,
        sigma=np.asarray(sigma, dtype=np.float64),
        threshold=threshold,
        largest=float(power[used].max()),
        response=vehicle.response_in(),
        brightness=guess,
        throttled=vehicle.throttled,
    )
    given = tuple(
        Given.of(observation, int(sample), len(t_s))
        for observation, sample in zip(observations, at_given, strict=True)
    )
    obs = Observations(t_s - t_s[0], np.zeros((len(t_s), 3)), (read, *given))
    return Window(obs, float(t_s[0]), noise_from, tuple(remarks))


def _stretch(
    telemetry: xr.Dataset,
    times: np.ndarray,
    begin_s: float | None,
    end_s: float | None,
    phase: str | None,
) -> tuple[np.ndarray, list[str]]:
    """Return which samples (n) lie in the requested stretch, and remarks in words."""
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
            exist = f"it has {', '.join(names[:MOST_NAMED])}" if names else "it names none"
            raise InputError("the telemetry has no such phase", got=phase, do=exist)
        inside &= phases == phase
    inside &= times >= (-np.inf if begin_s is None else begin_s)
    inside &= times <= (np.inf if end_s is None else end_s)
    return inside, remarks


def _left_out(quality: xr.Dataset, number: np.ndarray, inside: np.ndarray) -> list[str]:
    """Return remarks on samples that were left out wholly or in part, with the reasons.

    `number` (n, p): readings that are finite.
    """
    measured, why = quality["measured"].values, quality["why"].values
    whole = inside & ~measured.any(axis=1)
    part = inside & ~whole & (number & ~measured & ~quality["missed"].values).any(axis=1)
    reasons = Counter(str(text) for text in why[whole | part] if not text.startswith("used"))
    return [
        f"left out in {count} sample{'s' * (count > 1)}: {text.partition(': ')[2]}"
        for text, count in reasons.most_common()
    ]


def _brightness(
    vehicle: Vehicle, power: np.ndarray, used: np.ndarray, sigma: np.ndarray, threshold: float
) -> float:
    """Return a first guess of the brightness, the signal of a panel of gain one at normal incidence, from readings (n, p).

    1. It is the median over samples that give a direction, if there are any.
    2. Else, if gains have a unit and the likeliest brightness is near one (`LIKELY_UNIT`), the gains are believed: one.
    3. Else it is the likeliest brightness.

    For a direction only panels lit clearly beyond the noise count. With a small threshold half of the dark panels would pass as
    lit: at 2 to 4 % noise one guess in three was off by more than 10 %, and then no start settled.
    """
    surely_lit = np.maximum(threshold, LIT_SIGMAS * sigma)
    value = np.where(used, power, 0.0)
    status = sun_directions(vehicle, value, noise=sigma, lit_threshold=surely_lit)["status"].values
    has_direction = is_reconstructed(status) & used.all(axis=1)
    if has_direction.any():
        return float(np.median(panels.brightness(vehicle, value[has_direction])))
    likeliest = _likeliest_brightness(vehicle, np.maximum(value, 0.0), used, sigma)
    gains_believed = vehicle.gain_unit is not None and LIKELY_UNIT[0] < likeliest < LIKELY_UNIT[1]
    return 1.0 if gains_believed else likeliest


def _likeliest_brightness(
    vehicle: Vehicle, power: np.ndarray, used: np.ndarray, sigma: np.ndarray
) -> float:
    """Return the brightness under which readings (n, p) are the likeliest, each sample's direction being anywhere on the sphere.

    That every sample has a direction is not enough: too bright a Sun is not contradicted where no panel looks along it. But
    directions near the edge of what panels see would have to be the rule then, and readings just below the largest rare.
    """
    s = GridSettings()
    light = power / vehicle.input_gains
    samples = np.argsort(-np.linalg.norm(light, axis=1), kind="stable")[:BRIGHTEST]
    # the dark samples of an eclipse bound nothing
    samples = samples[light[samples].max(axis=1) > 0]
    largest = light[samples].max(axis=1)
    low = max(float(np.median(largest)), DIMMEST * float(largest.max()))
    tried = np.exp(np.arange(np.log(low), np.log(WIDEST * largest.max()), BRIGHTNESS_STEP))
    shape = panels.panel_power(vehicle, sphere(s.directions))
    density = np.zeros(len(tried))
    for i, scale in enumerate(tried):
        spread = np.hypot(sigma, BETWEEN_RAD * scale * vehicle.input_gains)
        for k in samples:
            square = np.minimum(((scale * shape - power[k]) / spread) ** 2, s.cap) @ used[k]
            density[i] += float(logsumexp(-0.5 * square)) - float(np.log(spread) @ used[k])
    return float(tried[np.argmax(density)])


def with_unknowns(obs: Observations, read: PanelPowers) -> Observations:
    """Return observations with other panels: `read` are the same panels with their unknowns."""
    terms = tuple(read if isinstance(term, PanelPowers) else term for term in obs.terms)
    return replace(obs, terms=terms)
