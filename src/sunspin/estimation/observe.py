"""From telemetry to what a fit sees: terms at all samples, passes, the samples that the search keeps, and wheels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.dynamics.friction import spin_down_speed
from sunspin.estimation.model import Observations
from sunspin.estimation.settings import PassSettings
from sunspin.estimation.terms.directions import SunDirections
from sunspin.estimation.terms.inertial import Gyro
from sunspin.estimation.terms.panels import Panels
from sunspin.telemetry.assess import Assessment
from sunspin.telemetry.quality import LATE, STALE, find_late_frames
from sunspin.vehicle import Vehicle

ALONE = "dropped: fewer than three samples between gaps (in no pass)"
NOT_ASKED = "dropped: in another pass than the one asked for"

MEASURED = "measured"
HELD = "held at the nominal speed"
COASTING = "coasting from the nominal speed at the first sample"


@dataclass(frozen=True)
class Seen:
    """What all samples of a file show; `why` (n): what became of each, in words; `source`: where the Sun comes from."""

    obs: Observations
    why: np.ndarray
    source: str

    @property
    def usable(self) -> np.ndarray:
        """Indices of the samples that show the Sun and are not dropped."""
        dropped = np.array([text.startswith("dropped") for text in self.why])
        return np.flatnonzero(self.obs.sees_sun & ~dropped)


@dataclass(frozen=True)
class Pass:
    """A stretch of samples without a long gap: indices of all its samples (n), and of those that the search keeps."""

    samples: np.ndarray
    kept: np.ndarray

    @property
    def places(self) -> np.ndarray:
        """Places of the kept samples among all of the pass."""
        return np.searchsorted(self.samples, self.kept)


def observe(assessment: Assessment, source: str | None = None) -> Seen:
    """Return terms and times of all samples, a sentence for each, and where the Sun comes from.

    `source`: "directions", "sun_sensor" or "panels"; default: the first of these that the telemetry has.
    """
    telemetry = assessment.telemetry
    source = _source(telemetry, source)
    t_s = np.asarray(telemetry["time"], dtype=np.float64)
    if source == "panels":
        sun, why = Panels.read(assessment)
    else:
        sun, why = SunDirections.read(assessment.sensors, source)
        why[assessment.repeats.frozen] = STALE
    why[find_late_frames(telemetry)] = LATE
    gyro = Gyro.read(assessment.vehicle, assessment.sensors)
    terms = tuple(term for term in (sun, gyro) if term is not None)
    return Seen(Observations(t_s, np.zeros((len(t_s), 3)), terms), why, source)


def _source(telemetry: xr.Dataset, wanted: str | None) -> str:
    """Return where the Sun comes from."""
    has = {
        "directions": "sun_B" in telemetry and "sun_cov_B" in telemetry,
        "sun_sensor": "sun_sensor_B" in telemetry,
        "panels": "power_W" in telemetry or "current_A" in telemetry,
    }
    wanted = wanted or next((name for name, exists in has.items() if exists), None)
    if wanted is None or not has.get(wanted, False):
        exist = ", ".join(name for name, exists in has.items() if exists)
        raise InputError(
            f"the telemetry has no Sun from {wanted or 'panels or Sun sensors'}",
            got=exist or "nothing of the Sun",
            do=f"use {', '.join(has)}",
        )
    return wanted


def split(seen: Seen, gap_s: float | None, s: PassSettings) -> list[Pass]:
    """Return the passes of a file: parted by gaps, and cut if they are too long; of each the samples that the search keeps."""
    use = seen.usable
    if len(use) < 3:
        raise InputError(
            "fewer than three samples say where the Sun is",
            got=f"{len(use)} of {len(seen.why)}",
            do=_why_unused(seen),
        )
    t_s = seen.obs.t_s
    gap = s.gap_intervals * float(np.median(np.diff(t_s[use]))) if gap_s is None else gap_s
    passes = []
    for part in np.split(use, np.flatnonzero(np.diff(t_s[use]) > gap) + 1):
        duration = t_s[part[-1]] - t_s[part[0]]
        pieces = max(1, int(np.ceil(duration / s.longest_s)))
        edges = t_s[part[0]] + np.arange(1, pieces) * duration / pieces
        for piece in np.split(part, np.searchsorted(t_s[part], edges)):
            if len(piece) >= 3:
                passes.append(Pass(piece, piece[thinned(len(piece), s)]))
    if not passes:
        raise InputError(
            "no pass has three samples", got=f"gap between passes {gap:.4g} s", do="raise --gap"
        )
    return passes


def asked(passes: Sequence[Pass], pass_id: int | None) -> list[int]:
    """Return which passes are estimated."""
    if pass_id is None:
        return list(range(len(passes)))
    whole = isinstance(pass_id, int | np.integer) and not isinstance(pass_id, bool)
    if not whole or not 0 <= pass_id < len(passes):
        raise InputError(
            "there is no such pass", got=pass_id, do=f"the file has passes 0 to {len(passes) - 1}"
        )
    return [int(pass_id)]


def why_not_used(seen: Seen, passes: Sequence[Pass], chosen: Sequence[int]) -> np.ndarray:
    """Return what became of each sample (n), in words, if only some passes are estimated."""
    why = seen.why.copy()
    why[np.setdiff1d(seen.usable, np.concatenate([one.samples for one in passes]))] = ALONE
    for k in set(range(len(passes))) - set(chosen):
        why[passes[k].samples] = NOT_ASKED
    return why


def thinned(count: int, s: PassSettings) -> np.ndarray:
    """Return at most `s.kept` places of `count` samples, the first and the last among them.

    Close together where the rate is determined first, then ever farther apart: each step is at most `s.growth` times the one
    before, so that what is known of the rate always predicts the next sample.
    """
    if count <= s.kept:
        return np.arange(count)
    growing = s.growth ** np.arange(s.kept - 1)
    low, high = 1.0, float(count)
    for _ in range(60):  # bisection for the largest step with which the steps reach the end
        widest = (low + high) / 2
        reached = np.minimum(growing, widest).sum() >= count - 1
        low, high = (low, widest) if reached else (widest, high)
    place = np.concatenate([[0.0], np.cumsum(np.minimum(growing, high))])
    return np.unique(np.minimum(np.round(place), count - 1).astype(int))


def _why_unused(seen: Seen) -> str:
    """Return why most samples are not used, and what to do."""
    dropped = [text.removeprefix("dropped: ") for text in seen.why if text.startswith("dropped")]
    if not dropped:
        return "add samples with a Sun direction"
    reason, count = Counter(dropped).most_common(1)[0]
    return f"{count} dropped: {reason}; `sunspin check` says why samples are dropped"


def wheel_models(vehicle: Vehicle, telemetry: xr.Dataset) -> dict[str, np.ndarray]:
    """Return what the wheels may do, in words, with their momentum at each sample (n, 3) in mean moments times rad/s.

    Measured speeds leave one possibility. Without them the wheels are held, or coast from the first sample with the friction of the
    vehicle file or one of its alternatives: which, is for the data to say.
    """
    t_s = np.asarray(telemetry["time"], dtype=np.float64)
    if vehicle.inertia_kg_m2 is None or not vehicle.wheels:
        return {"none": np.zeros((len(t_s), 3))}
    nominal = np.array([wheel.speed_rad_s for wheel in vehicle.wheels])
    if "wheel_speed_rad_s" in telemetry:
        speeds = {MEASURED: _bridged(t_s, telemetry, nominal)}
    else:
        speeds = {HELD: np.broadcast_to(nominal, (len(t_s), len(nominal)))}
        speeds |= _coasting(vehicle, t_s) if nominal.any() else {}
    axes = np.array([w.inertia_kg_m2 * np.asarray(w.axis_B) for w in vehicle.wheels])
    unit = float(np.trace(vehicle.inertia_kg_m2)) / 3
    return {what: speed @ axes / unit for what, speed in speeds.items()}


def _coasting(vehicle: Vehicle, t_s: np.ndarray) -> dict[str, np.ndarray]:
    """Return the speeds (n, n_wheel) of wheels that coast from the first sample, for each friction that the file names."""
    speeds = {}
    names = dict.fromkeys(name for w in vehicle.wheels for name in w.alternative_frictions)
    for name in (None, *names):
        frictions = [
            w.friction if name is None else w.alternative_frictions.get(name, w.friction)
            for w in vehicle.wheels
        ]
        if not any(one.coulomb_N_m or one.viscous_N_m_s for one in frictions):
            continue
        speed = [
            spin_down_speed(
                one.coulomb_N_m,
                one.viscous_N_m_s,
                w.inertia_kg_m2,
                w.speed_rad_s,
                t_s - t_s[0],
            )
            for one, w in zip(frictions, vehicle.wheels, strict=True)
        ]
        speeds[COASTING + (f", friction {name!r}" if name else "")] = np.stack(speed, axis=1)
    return speeds


def _bridged(t_s: np.ndarray, telemetry: xr.Dataset, nominal: np.ndarray) -> np.ndarray:
    """Return measured speeds (n, n_wheel) with gaps bridged linearly; a wheel that was never read keeps its nominal speed."""
    read = telemetry["wheel_speed_rad_s"].values
    speed = np.empty(read.shape)
    for k, usual in enumerate(nominal):
        known = np.flatnonzero(np.isfinite(read[:, k]))
        known = known[np.argsort(t_s[known], kind="stable")]
        speed[:, k] = np.interp(t_s, t_s[known], read[known, k]) if len(known) else usual
    return speed


def wheels_untold(vehicle: Vehicle, telemetry: xr.Dataset) -> list[str]:
    """Return the names of wheels of whose speed neither the vehicle file nor the telemetry says anything: taken for standing."""
    if vehicle.inertia_kg_m2 is None:
        return []
    read = np.full((1, len(vehicle.wheels)), np.nan)
    if "wheel_speed_rad_s" in telemetry:
        read = telemetry["wheel_speed_rad_s"].values
    return [
        wheel.name
        for k, wheel in enumerate(vehicle.wheels)
        if wheel.speed_rad_s == 0 and not np.isfinite(read[:, k]).any()
    ]


def with_momentum(seen: Seen, momentum: np.ndarray) -> Seen:
    """Return what is seen with wheels of this momentum (n, 3)."""
    return replace(seen, obs=replace(seen.obs, momentum=momentum))
