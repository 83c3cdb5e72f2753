"""From telemetry to what a fit sees: terms at all samples, passes, the samples that the search keeps, and wheels."""

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
from sunspin.estimate.model import Observations
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
NOT_ASKED = "dropped: in another pass than the one asked for"

FIELD = "field"
"""Where directions come from without a Sun: a magnetometer."""

FIELD_ALONE = "used: the field alone; "
"""Begin of what is said of a sample without a Sun whose field an orbit makes a direction."""

NOT_SEEN = ("dropped: no panel lit", IDLE, EMPTY, UNREAD)
"""What is said of samples whose only fault is that they show no Sun."""

MEASURED = "measured"
HELD = "held at the nominal speed"
COASTING = "coasting from the nominal speed at the first sample"

TIME_UNITS_S, NEAR_UNIT = (1.0, 0.1), 1e-3
"""Units to which times may have been rounded, s, the coarsest first; and how near to a multiple times are, in units: single digits
of milliseconds may be lost on the way."""

COAST_FROM = "coast_from_s"
"""Attribute of samples that were cut out of a file: time of the file's first sample, from which its wheels may coast."""


@dataclass(frozen=True)
class FileReadings:
    """What all samples of a file show; `why` (n): what became of each, in words; `source`: where the Sun comes from."""

    obs: Observations
    why: np.ndarray
    source: str

    @property
    def dipole_modelled(self) -> bool:
        """Return whether the dipole that the vehicle file states acts, in a measured field."""
        return any(isinstance(term, StatedDipole) for term in self.obs.terms)

    @property
    def usable(self) -> np.ndarray:
        """Indices of the samples that show the Sun, or a field whose direction is known, and are not dropped."""
        dropped = np.array([text.startswith("dropped") for text in self.why])
        field_alone = np.array([text.startswith(FIELD_ALONE) for text in self.why])
        return np.flatnonzero((self.obs.sees_sun | field_alone) & ~dropped)


@dataclass(frozen=True)
class Pass:
    """A stretch of samples without a long gap.

    `samples` (n): their indices in the file; `kept`: of those that the search uses; `number` of the pass, counted from zero.
    """

    samples: np.ndarray
    kept: np.ndarray
    number: int

    @property
    def kept_in_pass(self) -> np.ndarray:
        """Indices of the kept samples among those of the pass."""
        return np.searchsorted(self.samples, self.kept)


def observe(
    assessment: Assessment,
    source: str | None = None,
    local: Environment | None = None,
    calibration: FieldCalibration | None = None,
    torques: Acting = NOTHING,
) -> FileReadings:
    """Return what all samples of a file show: terms, what became of each sample in words, and where the Sun comes from.

    `source`: "directions", "sun_sensor" or "panels"; default: the first of these that the telemetry has, else the magnetometer.
    `local`: the environment, with z of its N to the Sun; `calibration`: of the magnetometer along its orbit; `torques` that act.
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

    # A magnetometer: its directions if the field is known in space, else the change of the field between neighbours.
    fields = FieldChange.read(vehicle, sensors)
    known = None
    field_is_known = surroundings is not None and surroundings.field_N is not None
    if fields is not None and calibration is not None and field_is_known:
        known = KnownField.of(fields, surroundings, calibration)
        # a sample that is not used only since it shows no Sun still shows the direction of the field
        for k in np.flatnonzero(known.present() & np.isin(why, NOT_SEEN)):
            why[k] = FIELD_ALONE + why[k].removeprefix("dropped: ")
    elif fields is not None:
        fields = fields.with_own_zero()
    if source != "panels":
        why[assessment.repeats.frozen] = STALE
    why[find_late_frames(telemetry)] = LATE

    clock = vehicle.sensors.clock
    terms = (
        sun,
        GyroRates.read(vehicle, sensors),
        RateMagnitudes.read(vehicle, sensors),
        None if isinstance(sun, FieldDirection) else known or fields,
        AttitudeChange.read(vehicle, sensors),
        *_torques(vehicle, t_s, fields, surroundings, torques),
        None if clock is None else Latency(clock.late_s, clock.sigma_s),
    )
    terms = [term for term in terms if term is not None]
    obs = Observations(t_s, np.zeros((len(t_s), 3)), tuple(terms), rounded_to_s(t_s) / np.sqrt(12))
    return FileReadings(obs, why, source)


def rounded_to_s(t_s: np.ndarray) -> float:
    """Return the unit (s) to which times (n) were rounded, zero if they are exact; the error is uniform over the unit.

    They were if all of them are whole multiples of a unit from the first one, and no larger unit divides all intervals: a device
    that samples every 10 s and was rounded shows 10 and 11 s. Samples at a fixed interval, also with gaps, are taken as exact.
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
    fields: FieldChange | None,
    surroundings: Surroundings | None,
    torques: Acting,
) -> list[Term]:
    """Return the torques of a stated or an unknown dipole if the field is measured or known, and those that are named."""
    terms: list[Term] = []
    dipole = vehicle.sensors.disturbance.dipole
    # one dipole: the stated one in the field as read, else an unknown one in the orbit's field, else in an unknown field
    if dipole is not None and fields is not None and np.isfinite(fields.field_B).any():
        terms.append(StatedDipole(np.asarray(dipole), np.nan_to_num(fields.field_B)))
    elif surroundings is not None and surroundings.field_N is not None:
        terms.append(MagneticTorque.in_field(surroundings.field_N))
    elif fields is not None:
        terms.append(MagneticTorque.in_field(None))
    if torques.needs_attitude:
        assert surroundings is not None and surroundings.nadir_N is not None
        inertia = vehicle.require_inertia()
        strength = np.full(len(t_s), torques.gradient_strength())
        inertia = inertia / (np.trace(inertia) / 3)
        terms.append(GravityTorque(surroundings.nadir_N, strength, inertia))
    return terms


def _source(telemetry: xr.Dataset, wanted: str | None, has_field: bool) -> str:
    """Return where the Sun comes from; :data:`FIELD` without a Sun, if the directions of a magnetometer are of use."""
    has = {
        "directions": "sun_B" in telemetry and "sun_cov_B" in telemetry,
        "sun_sensor": "sun_sensor_B" in telemetry,
        "panels": "power_W" in telemetry or "current_A" in telemetry,
    }
    wanted = wanted or next((name for name, exists in has.items() if exists), None)
    if wanted in (None, FIELD) and has_field:
        return FIELD
    if wanted is None or not has.get(wanted, False):
        exist = ", ".join(name for name, exists in has.items() if exists)
        if wanted is None and "field_B" in telemetry:
            raise InputError(
                "the telemetry has no Sun",
                got="a magnetometer",
                do="a magnetometer alone needs its `noise` in the vehicle file, or an orbit (--tle)",
            )
        raise InputError(
            f"the telemetry has no Sun from {wanted or 'panels or Sun sensors'}",
            got=exist or "nothing of the Sun",
            do=f"use {', '.join(has)}",
        )
    return wanted


def split_passes(readings: FileReadings, gap_s: float | None, s: PassSettings) -> list[Pass]:
    """Return the passes of a file: parted by gaps, and cut if they are too long; of each the samples that the search keeps.

    Over a gap that nobody stated a pass goes on if a magnetometer was read in it. Pieces of less than three samples are left out.
    """
    use = readings.usable  # indices
    if len(use) < 3:
        raise InputError(
            "fewer than three samples say where the Sun is",
            got=f"{len(use)} of {len(readings.why)}",
            do=_why_unused(readings),
        )
    t_s = readings.obs.t_s
    usual = float(np.median(np.diff(t_s[use])))
    gap = s.gap_intervals * usual if gap_s is None else gap_s
    ends = np.flatnonzero(np.diff(t_s[use]) > gap)  # places in `use` of the last samples of passes
    compared = [term for term in readings.obs.terms if isinstance(term, FieldChange)]
    fields = [term for term in compared if term.present().any()]
    if fields and gap_s is None:
        read = t_s[np.isfinite(fields[0].field_B).all(axis=1)]
        ends = [k for k in ends if not _goes_on(read, t_s[use[k]], t_s[use[k + 1]], gap, s)]
    # Passes are cut shorter if the field's direction is unknown, as it turns unevenly over a long pass; and in a known field if a
    # pass would have so many samples that the search keeps too few of them.
    known = any(isinstance(term, KnownField) for term in readings.obs.terms)
    many = known and s.longest_s > s.many * usual
    longest = s.longest_field_s if fields or many else s.longest_s
    passes = []
    for part in np.split(use, np.asarray(ends, dtype=int) + 1):
        duration = t_s[part[-1]] - t_s[part[0]]
        pieces = max(1, int(np.ceil(duration / longest)))
        edges = t_s[part[0]] + np.arange(1, pieces) * duration / pieces
        for piece in np.split(part, np.searchsorted(t_s[part], edges)):
            if len(piece) >= 3:
                dense_from = _dense_from(readings.obs.sees_sun[piece], s)
                kept = piece[thinned(len(piece), s, dense_from)]
                passes.append(Pass(piece, kept, len(passes)))
    if not passes:
        raise InputError(
            "no pass has three samples", got=f"gap between passes {gap:.4g} s", do="raise --gap"
        )
    return passes


def passes_asked_for(passes: Sequence[Pass], pass_id: int | None) -> list[Pass]:
    """Return the passes that are estimated: the one with this number, or all. Raises InputError if there is none."""
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
    """Return the readings with the reason of samples that show the Sun but are in no pass, or in one that is not `estimated`."""
    why = readings.why.copy()
    in_a_pass = np.concatenate([a_pass.samples for a_pass in passes])
    why[np.setdiff1d(readings.usable, in_a_pass)] = ALONE
    for left_out in set(range(len(passes))) - {a_pass.number for a_pass in estimated}:
        why[passes[left_out].samples] = NOT_ASKED
    return replace(readings, why=why)


def _goes_on(
    read_s: np.ndarray, start_s: float, end_s: float, gap_s: float, s: PassSettings
) -> bool:
    """Return whether the field was read without a gap between two samples that show the Sun, so that the pass goes on.

    A body with few panels turns them away from the Sun for a while. `read_s`: times of all readings of the field.
    """
    between = read_s[(read_s >= start_s) & (read_s <= end_s)]
    short = end_s - start_s < s.longest_dark_s
    return short and len(between) > 1 and bool(np.diff(between).max() <= gap_s)


def _dense_from(sees_sun: np.ndarray, s: PassSettings) -> int:
    """Return the sample of a pass around which the kept samples are close together; `sees_sun` (n): which samples show the Sun.

    It is the first sample if half of the next `s.dense` show the Sun. Else, as in a pass that begins in the shadow, it is the one
    of whose next `s.dense` most do.
    """
    if len(sees_sun) <= s.kept:
        return 0
    count_of_next = np.convolve(sees_sun, np.ones(s.dense))[s.dense - 1 :]
    return 0 if count_of_next[0] >= s.dense / 2 else int(np.argmax(count_of_next))


def thinned(count: int, s: PassSettings, dense_from: int = 0) -> np.ndarray:
    """Return the indices of at most `s.kept` of `count` samples.

    They are close together at `dense_from`, where the rate is determined first, then ever farther apart to both sides. Each step is
    at most `s.growth` times the one before, so that what is known of the rate predicts the next sample. Of all ways to share the
    samples between the two sides the one whose widest step is smallest is taken. If none reaches both ends, steps grow from the
    first sample on; in a very long pass they end before the last.
    """
    if count <= s.kept:
        return np.arange(count)
    after, before = np.arange(dense_from, count), np.arange(dense_from, -1, -1)
    # from the first sample on: if `dense_from` is 0, or no shares reach both ends
    smallest_widest, best = np.inf, _growing(np.arange(count), s.kept, s.growth)
    for kept_before in range(2, s.kept) if dense_from else ():
        kept_after = s.kept + 1 - kept_before  # `dense_from` is on both sides
        sides = _growing(after, kept_after, s.growth), _growing(before, kept_before, s.growth)
        # steps that grow to both sides do not reach the ends of a very long pass
        if sides[0][-1] == count - 1 and sides[1][-1] == 0:
            widest = max(np.abs(np.diff(side)).max(initial=0) for side in sides)
            if widest < smallest_widest:
                smallest_widest, best = widest, np.unique(np.concatenate(sides))
    return best


def _growing(indices: np.ndarray, most: int, growth: float) -> np.ndarray:
    """Return at most `most` of some indices, the first among them, in steps of 1, growth, growth^2, ... up to a bound.

    The bound is the smallest with which the steps reach the last index; with none that does, they end before it.
    """
    if len(indices) <= most:
        return indices
    growing = growth ** np.arange(most - 1)
    low, high = 1.0, float(len(indices))
    # bisection for the smallest bound of the steps with which they reach the end
    for _ in range(60):
        bound = (low + high) / 2
        reaches = np.minimum(growing, bound).sum() >= len(indices) - 1
        low, high = (low, bound) if reaches else (bound, high)
    taken = np.concatenate([[0.0], np.cumsum(np.minimum(growing, high))])
    return indices[np.unique(np.minimum(np.round(taken), len(indices) - 1).astype(int))]


def _why_unused(readings: FileReadings) -> str:
    """Return why most samples are not used, and what to do."""
    reasons = [text for text in readings.why if text.startswith("dropped")]
    dropped = [text.removeprefix("dropped: ") for text in reasons]
    panels = [term for term in readings.obs.terms if isinstance(term, Panels)]
    down = panels[0].sun_up == 0 if panels else np.zeros(len(readings.why), dtype=bool)
    shadow = down.sum() - sum(text.startswith("dropped") for text in readings.why[down])
    if shadow > len(dropped):
        return (
            f"by the orbit {shadow} are in the Earth's shadow: compare clock and elements with `sunspin check`, or leave out "
            "the orbit"
        )
    if not dropped:
        return "add samples with a Sun direction"
    reason, count = Counter(dropped).most_common(1)[0]
    return f"{count} dropped: {reason}; `sunspin check` says why samples are dropped"


def take_samples(telemetry: xr.Dataset, samples: np.ndarray) -> xr.Dataset:
    """Return some samples of a file (indices), whose wheels still coast from the first sample of the whole file."""
    return telemetry.isel(time=samples).assign_attrs({COAST_FROM: _coast_from_s(telemetry)})


def _coast_from_s(telemetry: xr.Dataset) -> float:
    """Return the time (s) of the first sample of the file that these samples are, or were cut out of."""
    return float(telemetry.attrs.get(COAST_FROM, telemetry["time"].values[0]))


def wheel_models(vehicle: Vehicle, telemetry: xr.Dataset) -> dict[str, np.ndarray]:
    """Return what the wheels may do, in words, with their momentum at each sample (n, 3) in mean moments times rad/s."""
    t_s = np.asarray(telemetry["time"], dtype=np.float64)
    if vehicle.inertia_kg_m2 is None or not vehicle.wheels:
        return {"none": np.zeros((len(t_s), 3))}
    axes = np.array([w.inertia_kg_m2 * np.asarray(w.axis_B) for w in vehicle.wheels])
    unit = float(np.trace(vehicle.inertia_kg_m2)) / 3
    speeds = wheel_speeds(vehicle, telemetry, t_s)
    return {what: speed @ axes / unit for what, speed in speeds.items()}


def wheel_speeds(vehicle: Vehicle, telemetry: xr.Dataset, t_s: np.ndarray) -> dict[str, np.ndarray]:
    """Return what the wheels may do, in words, with their speeds (n, n_wheel) in rad/s at times (n).

    Measured speeds leave one possibility. Without them the wheels are held, or coast from the first sample with the friction of the
    vehicle file or one of its alternatives: which, is for the data to say.
    """
    nominal = np.array([wheel.speed_rad_s for wheel in vehicle.wheels])
    if "wheel_speed_rad_s" in telemetry:
        return {MEASURED: _bridged(t_s, telemetry, nominal)}
    held = {HELD: np.broadcast_to(nominal, (len(t_s), len(nominal)))}
    after_s = t_s - _coast_from_s(telemetry)
    return held | (_coasting(vehicle, after_s) if nominal.any() else {})


def _coasting(vehicle: Vehicle, after_s: np.ndarray) -> dict[str, np.ndarray]:
    """Return what coasting wheels may do, in words, with their speeds (n, n_wheel) `after_s` (n) seconds after they began.

    There is one entry for the frictions of the vehicle file and one for each name of alternative frictions. A wheel without that
    alternative has its usual friction. Without any friction the speeds are those of held wheels: no entry.
    """
    speeds = {}
    names = dict.fromkeys(name for w in vehicle.wheels for name in w.alternative_frictions)
    for name in (None, *names):  # None: the usual frictions
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


def _bridged(t_s: np.ndarray, telemetry: xr.Dataset, nominal: np.ndarray) -> np.ndarray:
    """Return measured speeds (n, n_wheel) at times (n) with gaps bridged linearly; a wheel never read keeps its nominal speed."""
    read, read_s = telemetry["wheel_speed_rad_s"].values, np.asarray(telemetry["time"], np.float64)
    speed = np.empty((len(t_s), len(nominal)))
    for k, usual in enumerate(nominal):
        known = np.flatnonzero(np.isfinite(read[:, k]))
        known = known[np.argsort(read_s[known], kind="stable")]
        at, value = read_s[known], read[known, k]
        speed[:, k] = np.interp(t_s, at, value) if len(known) else usual
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
