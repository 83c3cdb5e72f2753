"""From telemetry to what a fit sees: terms of sensors and torques at all samples, passes, and the momentum of the wheels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.dynamics.friction import spin_down_speed
from sunspin.dynamics.torques import NOTHING, Acting
from sunspin.environment import Environment, Surroundings
from sunspin.estimate.model import Model, Observations
from sunspin.estimate.settings import PassSettings
from sunspin.estimate.terms.directions import UNREAD, SunDirections
from sunspin.estimate.terms.field import FieldChange, FieldDirection, KnownField, reads_directions
from sunspin.estimate.terms.inertial import AttitudeChange, GyroRates, Latency, RateMagnitudes
from sunspin.estimate.terms.panels import Panels
from sunspin.estimate.terms.term import Term
from sunspin.estimate.terms.torques import GravityTorque, MagneticTorque, StatedDipole
from sunspin.telemetry.assess import Assessment
from sunspin.telemetry.quality import EMPTY, IDLE, LATE, STALE, find_late_frames
from sunspin.vehicle import Vehicle

if TYPE_CHECKING:
    from sunspin.estimate.orbit.calibration import FieldCalibration

ALONE = "dropped: fewer than three samples between gaps (in no pass)"
NOT_SELECTED = "dropped: in another pass than the one asked for"

FIELD = "field"
"""Source of directions if a magnetometer stands for the Sun."""

FIELD_ONLY = "used: the field alone; "
"""Prefix to the status of a sample that shows no Sun but a field whose direction in space an orbit gives."""

NO_SUN = ("dropped: no panel lit", IDLE, EMPTY, UNREAD)
"""Statuses of samples that are dropped only because they show no Sun."""

LONGEST_PASSES = 2
"""Passes, those with the most samples, by whose evidence models and signs of the wheels are compared."""

MEASURED = "measured"
HELD = "held at the nominal speed"
COASTING = "coasting from the nominal speed at the first sample"

TIME_UNITS_S, NEAR_UNIT = (1.0, 0.864, 0.1, 0.0864), 1e-3
"""Units to which times may have been rounded, s, the coarsest first: seconds, days with five digits after the point, tenths, days
with six; and tolerance of multiples, in units: the last digit of milliseconds may be lost on the way."""

COAST_FROM = "coast_from_s"
"""Attribute of samples that were cut out of a file: time of the file's first sample, from which its wheels may coast."""


@dataclass(frozen=True)
class FileReadings:
    """What all samples of a file show; `why` (n): status of each ("used" or "dropped", and why); `source` of the Sun directions."""

    obs: Observations
    why: np.ndarray
    source: str

    @property
    def dipole_modelled(self) -> bool:
        """Return whether the dipole that the vehicle file states acts, in a measured field."""
        return self.obs.of_kind(StatedDipole) is not None

    @property
    def usable(self) -> np.ndarray:
        """Return the indices of samples that are not dropped and show the Sun, or a field of known direction in space."""
        dropped = np.array([text.startswith("dropped") for text in self.why])
        field_only = np.array([text.startswith(FIELD_ONLY) for text in self.why])
        return np.flatnonzero((self.obs.sees_sun | field_only) & ~dropped)


@dataclass(frozen=True)
class Pass:
    """A stretch of samples without a long gap.

    `samples` (n): their indices in the file; `kept`: indices in the file of those that the search uses; `number`: from zero.
    """

    samples: np.ndarray
    kept: np.ndarray
    number: int

    @property
    def kept_in_pass(self) -> np.ndarray:
        """Return the indices of the kept samples among those of the pass."""
        return np.searchsorted(self.samples, self.kept)

    def model_of_kept(self, nominal: Model) -> Model:
        """Return the model of the samples that the search keeps; `nominal`: that of the whole file."""
        return replace(nominal, obs=nominal.obs.of_pass(self.samples).take(self.kept_in_pass))


def observe(
    assessment: Assessment,
    source: str | None = None,
    local: Environment | None = None,
    calibration: FieldCalibration | None = None,
    torques: Acting = NOTHING,
) -> FileReadings:
    """Return the terms of all samples of a file, the status of each sample in words, and the source of the Sun directions.

    `source`: "directions", "sun_sensor" or "panels"; default: the first of these that the telemetry has, else the magnetometer.
    `local`: the environment in axes N with z to the Sun; `calibration`: of the magnetometer along its orbit; `torques` that act.
    The momentum of the wheels is left at zero (:func:`wheel_models`).
    """
    vehicle, telemetry, sensors = assessment.vehicle, assessment.telemetry, assessment.sensors
    has_field = calibration is not None or reads_directions(vehicle, telemetry)
    source = _source(telemetry, source, has_field)
    t_s = np.asarray(telemetry["time"], dtype=np.float64)
    surroundings = None if local is None else local.at(t_s)
    sun: Term | None = None
    if source == "panels":
        sun, why = Panels.read(assessment)
        sun = sun if surroundings is None else sun.placed(surroundings)
    elif source != FIELD:
        sun, why = SunDirections.read(sensors, source)
    elif calibration is None and vehicle.sensors.magnetometer is not None:
        sun, why = FieldDirection.alone(vehicle.sensors.magnetometer, sensors)
    else:
        why = np.full(len(t_s), UNREAD, dtype=object)

    # A magnetometer shows directions if the field is known in space, else the change of the field between neighbouring samples.
    field_change = FieldChange.read(vehicle, sensors)
    known_field = None
    field_is_known = surroundings is not None and surroundings.field_N is not None
    if field_change is not None and calibration is not None and field_is_known:
        known_field = KnownField.of(field_change, surroundings, calibration)
        # samples that were dropped only because they show no Sun are used after all
        for k in np.flatnonzero(known_field.present() & np.isin(why, NO_SUN)):
            why[k] = FIELD_ONLY + why[k].removeprefix("dropped: ")
    elif field_change is not None:  # along an orbit the calibration has the zero offset
        field_change = field_change.with_own_zero()
    if source != "panels":
        why[assessment.repeats.frozen] = STALE
    why[find_late_frames(telemetry)] = LATE

    clock = vehicle.sensors.clock
    terms = (
        sun,
        GyroRates.read(vehicle, sensors),
        RateMagnitudes.read(vehicle, sensors),
        None if isinstance(sun, FieldDirection) else known_field or field_change,
        AttitudeChange.read(vehicle, sensors),
        *_torques(vehicle, t_s, field_change, surroundings, torques),
        None if clock is None else Latency(clock.late_s, clock.sigma_s),
    )
    terms = [term for term in terms if term is not None]
    # an error that is uniform over the unit has the variance unit^2 / 12; a copy seconds later is no interval of the device
    time_sigma_s = rounded_to_s(t_s[~assessment.repeats.frozen]) / np.sqrt(12)
    obs = Observations(t_s, np.zeros((len(t_s), 3)), tuple(terms), time_sigma_s)
    return FileReadings(obs, why, source)


def rounded_to_s(t_s: np.ndarray) -> float:
    """Return the unit (s) to which times (n) seem to be rounded, zero if they count as exact.

    They are rounded if all intervals are whole multiples of the unit, above one, and have no larger common divisor: the rounded
    times of a device that samples every 10.3 s have intervals of 10 and 11 s. Samples at a fixed interval, also with gaps, are
    exact.
    """
    intervals = np.diff(np.unique(t_s))
    for unit in TIME_UNITS_S:
        count = np.round(intervals / unit)
        if len(count) and (np.abs(intervals / unit - count) < NEAR_UNIT).all():
            uneven = np.gcd.reduce(count.astype(np.int64)) == 1 and count.min() > 1
            return unit if uneven else 0.0
    return 0.0


def _torques(
    vehicle: Vehicle,
    t_s: np.ndarray,
    field_change: FieldChange | None,
    surroundings: Surroundings | None,
    torques: Acting,
) -> list[Term]:
    """Return the terms of the torques: of a magnetic dipole if a field is measured or known, and of the gravity gradient if it
    acts.

    There is one dipole: the stated one in the measured field, else an unknown one in the orbit's field, else in an unknown field.
    """
    terms: list[Term] = []
    dipole = vehicle.sensors.disturbance.dipole
    field_B = None if field_change is None else field_change.field_B
    if dipole is not None and field_B is not None and np.isfinite(field_B).any():
        terms.append(StatedDipole(np.asarray(dipole), np.nan_to_num(field_B)))
    elif surroundings is not None and surroundings.field_N is not None:
        terms.append(MagneticTorque.in_field(surroundings.field_N))
    elif field_B is not None:
        terms.append(MagneticTorque.in_field(None))
    if torques.needs_attitude:
        assert surroundings is not None and surroundings.nadir_N is not None
        inertia = vehicle.require_inertia()
        strength = np.full(len(t_s), torques.gradient_strength())
        inertia = inertia / (np.trace(inertia) / 3)
        terms.append(GravityTorque(surroundings.nadir_N, strength, inertia))
    return terms


def _source(telemetry: xr.Dataset, wanted: str | None, has_field: bool) -> str:
    """Return the source of the Sun directions: the `wanted` one, or the first that the telemetry has.

    Without any it is :data:`FIELD` if `has_field`: directions of a magnetometer can stand for the Sun. Else raise InputError.
    """
    has = {
        "directions": "sun_B" in telemetry and "sun_cov_B" in telemetry,
        "sun_sensor": "sun_sensor_B" in telemetry,
        "panels": "power_W" in telemetry or "current_A" in telemetry,
    }
    wanted = wanted or next((name for name, exists in has.items() if exists), None)
    if wanted in (None, FIELD) and has_field:
        return FIELD
    if wanted is None or not has.get(wanted, False):
        available = ", ".join(name for name, exists in has.items() if exists)
        if wanted is None and "field_B" in telemetry:
            raise InputError(
                "the telemetry has no Sun",
                got="a magnetometer",
                do="a magnetometer alone needs its `noise` in the vehicle file, or an orbit (--tle)",
            )
        raise InputError(
            f"the telemetry has no Sun from {wanted or 'panels or Sun sensors'}",
            got=available or "nothing of the Sun",
            do=f"use {', '.join(has)}",
        )
    return wanted


def split_passes(readings: FileReadings, gap_s: float | None, s: PassSettings) -> list[Pass]:
    """Return the passes of a file: stretches without a long gap, cut if they last too long, each with the samples a search keeps.

    A gap is long if it exceeds `gap_s` (s), by default `s.gap_intervals` median intervals. With the default a pass also continues
    over a gap in which a magnetometer was read (:func:`_field_bridges`). Pieces of less than three samples are left out. Raise
    `InputError` if the file has less than three usable samples, or no pass.
    """
    usable = readings.usable
    if len(usable) < 3:
        raise InputError(
            "fewer than three samples say where the Sun is",
            got=f"{len(usable)} of {len(readings.why)}",
            do=_why_unused(readings),
        )
    t_s = readings.obs.t_s[usable]
    median_s = float(np.median(np.diff(t_s)))
    gap = s.gap_intervals * median_s if gap_s is None else gap_s
    # indices into `usable` of the samples that a long gap follows: the last samples of passes
    ends = np.flatnonzero(np.diff(t_s) > gap)
    # readings of a field whose direction in space is unknown
    magnetometer = readings.obs.of_kind(FieldChange)
    is_read = magnetometer is not None and magnetometer.present().any()
    if is_read and gap_s is None:
        field_s = readings.obs.t_s[np.isfinite(magnetometer.field_B).all(axis=1)]
        is_bridged = [_field_bridges(field_s, t_s[k], t_s[k + 1], gap, s) for k in ends]
        ends = ends[~np.array(is_bridged, dtype=bool)]
    # A field of unknown direction is taken to rotate evenly, which holds for a short pass only. In a known field passes may be
    # long, unless the longest would have so many samples that the search keeps too few of them.
    field_is_known = readings.obs.of_kind(KnownField) is not None
    too_many = field_is_known and s.longest_s > s.most_in_field * median_s
    longest_s = s.longest_field_s if is_read or too_many else s.longest_s
    passes = []
    # `part`: indices into `usable` of the samples between two long gaps
    for part in np.split(np.arange(len(usable)), ends + 1):
        # cut into as few pieces of equal duration as possible, none of them over the longest
        duration_s = t_s[part[-1]] - t_s[part[0]]
        pieces = max(1, int(np.ceil(duration_s / longest_s)))
        edges_s = t_s[part[0]] + np.arange(1, pieces) * duration_s / pieces
        for piece in np.split(usable[part], np.searchsorted(t_s[part], edges_s)):
            if len(piece) >= 3:
                dense_from = _dense_from(readings.obs.sees_sun[piece], s)
                kept = piece[thinned(len(piece), s, dense_from)]
                passes.append(Pass(piece, kept, len(passes)))
    if not passes:
        raise InputError(
            "no pass has three samples", got=f"gap between passes {gap:.4g} s", do="raise --gap"
        )
    return passes


def longest_passes(passes: Sequence[Pass]) -> list[int]:
    """Return the indices of the :data:`LONGEST_PASSES` passes with the most samples, the longest first."""
    return sorted(range(len(passes)), key=lambda k: -len(passes[k].samples))[:LONGEST_PASSES]


def select_passes(passes: Sequence[Pass], pass_id: int | None) -> list[Pass]:
    """Return the passes to estimate: the one with the number `pass_id`, or all. Raise InputError if there is no such pass."""
    if pass_id is None:
        return list(passes)
    whole = isinstance(pass_id, int | np.integer) and not isinstance(pass_id, bool)
    if not whole or not 0 <= pass_id < len(passes):
        raise InputError(
            "there is no such pass", got=pass_id, do=f"the file has passes 0 to {len(passes) - 1}"
        )
    return [passes[pass_id]]


def with_unused_samples(
    readings: FileReadings, passes: Sequence[Pass], estimated: Sequence[Pass]
) -> FileReadings:
    """Return the readings with the reason why usable samples are not used: they are in no pass, or in one not `estimated`."""
    why = readings.why.copy()
    in_a_pass = np.concatenate([a_pass.samples for a_pass in passes])
    why[np.setdiff1d(readings.usable, in_a_pass)] = ALONE
    for left_out in set(range(len(passes))) - {a_pass.number for a_pass in estimated}:
        why[passes[left_out].samples] = NOT_SELECTED
    return replace(readings, why=why)


def _field_bridges(
    field_s: np.ndarray, start_s: float, end_s: float, gap_s: float, s: PassSettings
) -> bool:
    """Return whether the field was read without a long gap between two samples that show the Sun, so that a pass continues.

    A body with few panels turns them away from the Sun for a while. `field_s`: times of all readings of the field.
    """
    between = field_s[(field_s >= start_s) & (field_s <= end_s)]
    short = end_s - start_s < s.longest_dark_s
    return short and len(between) > 1 and bool(np.diff(between).max() <= gap_s)


def _dense_from(sees_sun: np.ndarray, s: PassSettings) -> int:
    """Return the sample of a pass around which the kept samples are close together; `sees_sun` (n): which samples show the Sun.

    It is the first sample if half of the `s.dense` samples from it on show the Sun. Else, as in a pass that begins in the Earth's
    shadow, it is the sample from which on most of `s.dense` do.
    """
    if len(sees_sun) <= s.most_kept:
        return 0
    # of each sample: how many of `s.dense` samples from it on show the Sun
    sunlit = np.convolve(sees_sun, np.ones(s.dense))[s.dense - 1 :]
    return 0 if sunlit[0] >= s.dense / 2 else int(np.argmax(sunlit))


def thinned(count: int, s: PassSettings, dense_from: int = 0) -> np.ndarray:
    """Return the indices of at most `s.most_kept` of `count` samples, close together at `dense_from`, farther apart on both sides.

    The search determines the rate at `dense_from` first. Each step is at most `s.growth` times the one before, so that the rate
    known so far predicts the next sample. Of all ways to divide the samples between the two sides the one with the smallest largest
    step is taken. If none reaches both ends, steps grow from the first sample on; in a very long pass they end before the last.
    """
    if count <= s.most_kept:
        return np.arange(count)
    after, before = np.arange(dense_from, count), np.arange(dense_from, -1, -1)
    # from the first sample on: if `dense_from` is 0, or no division reaches both ends
    least_step, best = np.inf, _in_growing_steps(np.arange(count), s.most_kept, s.growth)
    for kept_before in range(2, s.most_kept) if dense_from else ():
        kept_after = s.most_kept + 1 - kept_before  # `dense_from` is on both sides
        later = _in_growing_steps(after, kept_after, s.growth)
        earlier = _in_growing_steps(before, kept_before, s.growth)
        if later[-1] == count - 1 and earlier[-1] == 0:
            largest_step = max(np.abs(np.diff(side)).max(initial=0) for side in (later, earlier))
            if largest_step < least_step:
                least_step, best = largest_step, np.unique(np.concatenate([later, earlier]))
    return best


def _in_growing_steps(indices: np.ndarray, most: int, growth: float) -> np.ndarray:
    """Return at most `most` of some indices, from the first on in steps of 1, growth, growth^2, ... up to a largest step.

    The largest step is the smallest with which they reach the last index; if none does, they end before it.
    """
    if len(indices) <= most:
        return indices
    growing = growth ** np.arange(most - 1)
    # bisection for the largest step
    low, high = 1.0, float(len(indices))
    for _ in range(60):
        middle = (low + high) / 2
        reaches = np.minimum(growing, middle).sum() >= len(indices) - 1
        low, high = (low, middle) if reaches else (middle, high)
    taken = np.concatenate([[0.0], np.cumsum(np.minimum(growing, high))])
    return indices[np.unique(np.minimum(np.round(taken), len(indices) - 1).astype(int))]


def _why_unused(readings: FileReadings) -> str:
    """Return in words why most samples of a file are not used, and what to do."""
    is_dropped = np.array([text.startswith("dropped") for text in readings.why], dtype=bool)
    panels = readings.obs.of_kind(Panels)
    in_shadow = np.zeros(len(readings.why), dtype=bool) if panels is None else panels.sun_up == 0
    only_shadow = (in_shadow & ~is_dropped).sum()
    if only_shadow > is_dropped.sum():
        return (
            f"by the orbit {only_shadow} are in the Earth's shadow: compare clock and elements with `sunspin check`, or leave out "
            "the orbit"
        )
    if not is_dropped.any():
        return "add samples with a Sun direction"
    reason, count = Counter(readings.why[is_dropped]).most_common(1)[0]
    reason = reason.removeprefix("dropped: ")
    return f"{count} dropped: {reason}; `sunspin check` says why samples are dropped"


def middle_sample(t_s: np.ndarray) -> int:
    """Return the index of the sample that is nearest to the middle between the first and the last of the times `t_s` (n)."""
    return int(np.argmin(np.abs(t_s - (t_s[0] + t_s[-1]) / 2)))


def take_samples(telemetry: xr.Dataset, samples: np.ndarray) -> xr.Dataset:
    """Return some samples (indices) of a file, with the time from which its wheels may coast: its first sample."""
    return telemetry.isel(time=samples).assign_attrs({COAST_FROM: _coast_from_s(telemetry)})


def _coast_from_s(telemetry: xr.Dataset) -> float:
    """Return the time (s) of the first sample of a file, or of the file from which these samples were cut out."""
    return float(telemetry.attrs.get(COAST_FROM, telemetry["time"].values[0]))


def wheel_models(vehicle: Vehicle, telemetry: xr.Dataset) -> dict[str, np.ndarray]:
    """Return the possible motions of the wheels, by name: the sum of their momenta (n, 3) at the n samples, in body axes.

    It is divided by the mean moment of inertia of the body: rad/s. The names are those of :func:`wheel_speeds`: one if speeds are
    measured; else held, then coasting with each friction. Without wheels or an inertia the only name is "none", with zeros.
    """
    t_s = np.asarray(telemetry["time"], dtype=np.float64)
    if vehicle.inertia_kg_m2 is None or not vehicle.wheels:
        return {"none": np.zeros((len(t_s), 3))}
    momentum_per_speed = np.array([w.inertia_kg_m2 * np.asarray(w.axis_B) for w in vehicle.wheels])
    mean_moment = float(np.trace(vehicle.inertia_kg_m2)) / 3
    speeds = wheel_speeds(vehicle, telemetry, t_s)
    return {what: speed @ momentum_per_speed / mean_moment for what, speed in speeds.items()}


def wheel_speeds(vehicle: Vehicle, telemetry: xr.Dataset, t_s: np.ndarray) -> dict[str, np.ndarray]:
    """Return what the wheels may do, in words -> their speeds (n, n_wheel), rad/s, at times `t_s` (n).

    Measured speeds leave one possibility. Otherwise the wheels are held, or coast from the first sample with the friction of the
    vehicle file or one of its alternatives; the fits decide between these.
    """
    nominal = np.array([wheel.speed_rad_s for wheel in vehicle.wheels])
    if "wheel_speed_rad_s" in telemetry:
        return {MEASURED: _interpolated(t_s, telemetry, nominal)}
    held = {HELD: np.broadcast_to(nominal, (len(t_s), len(nominal)))}
    after_s = t_s - _coast_from_s(telemetry)
    # wheels at rest do not coast
    return held | (_coasting(vehicle, after_s) if nominal.any() else {})


def _coasting(vehicle: Vehicle, after_s: np.ndarray) -> dict[str, np.ndarray]:
    """Return the speeds (n, n_wheel) of coasting wheels `after_s` (n) seconds after the motors were switched off, by friction.

    There is one entry for the nominal frictions of the vehicle file and one for each name of alternative frictions. A wheel without
    that alternative has its nominal friction. Without any friction the wheels run as held ones, and there is no entry.
    """
    speeds = {}
    names = dict.fromkeys(name for w in vehicle.wheels for name in w.alternative_frictions)
    for name in (None, *names):  # None: the nominal frictions
        frictions = [
            w.friction if name is None else w.alternative_frictions.get(name, w.friction)
            for w in vehicle.wheels
        ]
        if not any(friction.coulomb_N_m or friction.viscous_N_m_s for friction in frictions):
            continue
        speed = [
            spin_down_speed(
                friction.coulomb_N_m,
                friction.viscous_N_m_s,
                w.inertia_kg_m2,
                w.speed_rad_s,
                after_s,
            )
            for friction, w in zip(frictions, vehicle.wheels, strict=True)
        ]
        speeds[COASTING + (f", friction {name!r}" if name else "")] = np.stack(speed, axis=1)
    return speeds


def _interpolated(t_s: np.ndarray, telemetry: xr.Dataset, nominal: np.ndarray) -> np.ndarray:
    """Return measured wheel speeds (n, n_wheel), rad/s, interpolated linearly to times (n).

    A wheel that was never read keeps its speed in `nominal` (n_wheel).
    """
    speeds, time = telemetry["wheel_speed_rad_s"].values, np.asarray(telemetry["time"], np.float64)
    out = np.empty((len(t_s), len(nominal)))
    for k, nominal_speed in enumerate(nominal):
        read = np.flatnonzero(np.isfinite(speeds[:, k]))
        read = read[np.argsort(time[read], kind="stable")]
        out[:, k] = np.interp(t_s, time[read], speeds[read, k]) if len(read) else nominal_speed
    return out


def wheels_of_unknown_speed(vehicle: Vehicle, telemetry: xr.Dataset) -> list[str]:
    """Return the names of wheels that count as at rest because neither the vehicle file nor the telemetry gives them a speed.

    A `speed_rad_s` of zero is the default of the file and does not count as given. Without an inertia there is none, as all wheels
    are then ignored (:func:`wheel_models`).
    """
    if vehicle.inertia_kg_m2 is None:
        return []
    measured = np.full((1, len(vehicle.wheels)), np.nan)
    if "wheel_speed_rad_s" in telemetry:
        measured = telemetry["wheel_speed_rad_s"].values
    return [
        wheel.name
        for k, wheel in enumerate(vehicle.wheels)
        if wheel.speed_rad_s == 0 and not np.isfinite(measured[:, k]).any()
    ]
