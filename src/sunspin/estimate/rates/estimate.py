"""Body rates and attitude from where the Sun was, seen now and then: from directions, panel powers, with or without a gyro."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin.base.errors import InputError, sentence
from sunspin.base.provenance import provenance
from sunspin.dynamics.torques import Torque, acting
from sunspin.dynamics.torques.acting import needed
from sunspin.environment import Environment
from sunspin.environment.frames import J2000, SUN_Z_LOCAL
from sunspin.environment.orbit import Orbit, SunAlongZ
from sunspin.estimate.effort import USUAL, Effort, allowed, may_go_on
from sunspin.estimate.field_calibration import FieldCalibration, field_calibration
from sunspin.estimate.passes import AS_STATED, DOUBTFUL, UNCHECKED, PassMotions, speeds, table
from sunspin.estimate.rates.alternatives import Others, Trial, alternatives, counted, weighed
from sunspin.estimate.rates.clock import lateness, suspected
from sunspin.estimate.rates.common import LOOSER, Clock, Common, with_common
from sunspin.estimate.rates.dense import Dense
from sunspin.estimate.rates.hypotheses import AS_STATED as AS_READ
from sunspin.estimate.rates.hypotheses import Fit, Hypothesis, odd_one, ranked, sensors_left_out
from sunspin.estimate.rates.images import either_side, images_of, not_told
from sunspin.estimate.rates.link import linked
from sunspin.estimate.rates.motion import Body, require_followed
from sunspin.estimate.rates.noise import HIGHER_NOISES, choose, quick_evidence, refined, settled
from sunspin.estimate.rates.observe import observations, passes, usable
from sunspin.estimate.rates.residuals import Fitted, residuals
from sunspin.estimate.rates.seed import distinct, distinct_index, field_leads, guesses, out_of_field, search
from sunspin.estimate.rates.smooth import cost_limit, smooth
from sunspin.estimate.rates.spread import with_spread
from sunspin.estimate.rates.start import coarse
from sunspin.estimate.rates.state import Motion, Observations, Track, joined
from sunspin.estimate.rates.wheels import wheel_momenta
from sunspin.estimate.terms.earth_light import faint
from sunspin.estimate.terms.magnetic_torque import MagneticTorque
from sunspin.estimate.terms.magnetometer import TURN_RATE
from sunspin.estimate.terms.panels import Panels
from sunspin.estimate.terms.sensors import SENSORS
from sunspin.estimate.terms.term import SUN_N
from sunspin.estimate.verdict import NARROWER, answers, misfit
from sunspin.estimate.wiring import Better, better
from sunspin.solve.rotations import turn_between
from sunspin.vehicle import Vehicle
from sunspin.vehicle.sensors import Clock as Lateness
from sunspin.vehicle.timeline import utc_after

MAX_MODES = 6
"""Modes reported for each pass."""

TURNS = 6
"""Turns about the Sun that are tried where a torque depends on them."""

LEAST_WEIGHT = 1e-3
"""Modes of less weight are not reported."""

NOISE_RANGE = (1e-9, 1.0)
"""rad/s^1.5; the smallest lets a rate wander by 2e-5 deg/s in a day, the largest by a turn in 20 s: no satellite is outside."""

DEFAULT_MAX_RATE = 1.0
"""rad/s; the search goes no farther unless told, however dense the samples: every sixth of a turn more is another start."""

NOISE_SHARE, SEARCH_SHARE, WIRING_SHARE = 0.3, 0.75, 0.4
"""Of the effort: as far as the choice of the torques' strength may go, and the search of all passes; beside it, for wirings."""

FEW_MODES = 3
"""Modes that are fitted with all unknowns where the effort is spent."""

DECIDED = 0.9
"""A mode with at least this weight is called decided."""


NAMED = 0.05
"""Another model of the motion is named where the one as stated holds less of the weight."""

MOST_LATE = 0.1
"""A lateness that nobody spoke of is not reported beyond this part of the longest pass."""

SUSPECTED = "the data alone, not counted"
"""Where a lateness comes from that the vehicle file does not speak of."""


class Pass(NamedTuple):
    """The modes of one pass, best first, with weights that add to one; `index` are all of its samples, `kept` those that the
    smoother has used, on which `cost` is counted. `mean` (K, 3) is the rate averaged over all samples, with `mean_sigma` (K, 3);
    `residual`: by sensor (K, n), see :func:`sunspin.estimate.rates.residuals.residuals`; `model`: the hypothesis that holds most
    of the weight, and how much of it."""

    index: np.ndarray
    kept: np.ndarray
    track: Track
    weight: np.ndarray
    mean: np.ndarray
    mean_sigma: np.ndarray
    residual: dict[str, np.ndarray]
    model: tuple[str, float] = (AS_READ, 1.0)

    def take(self, order: np.ndarray, weight: np.ndarray) -> Pass:
        """The modes `order` with these weights."""
        left = {name: part[order] for name, part in self.residual.items()}
        mean, sigma = self.mean[order], self.mean_sigma[order]
        return Pass(self.index, self.kept, self.track.take(order), weight, mean, sigma, left, self.model)


def rates(
    vehicle: Vehicle,
    telemetry: xr.Dataset,
    *,
    source: str | None = None,
    max_rate_rad_s: float | None = None,
    acceleration_noise: float | None = None,
    gap_s: float | None = None,
    pass_id: int | None = None,
    environment: Environment | None = None,
    calibration: FieldCalibration | None = None,
    torques: Sequence[str | Torque] = (),
    wirings: bool = False,
    effort: float = 1.0,
    progress: bool = False,
) -> xr.Dataset:
    """Body rates and attitude of every pass of a telemetry file, all modes that the data cannot tell apart.

    Every turn, and every number of turns up to the largest rate, that takes the Sun from one sample to the next is a start;
    starts grow over the pass by smoothing (:mod:`sunspin.estimate.rates.smooth`): rigid-body motion with the vehicle's inertia
    and wheels (nearly a sphere where no inertia is known) and white angular acceleration for what it leaves out, measurements with
    Student tails.

    Parameters
    ----------
    telemetry : Dataset of `read_telemetry`, or of `sun_directions`
        A gyro or magnetometer in it is used where the vehicle describes one.
    source : {"panels", "sun_sensor", "directions"}, optional
        Where the Sun comes from; default: what the telemetry has.
    max_rate_rad_s : float, optional
        No rate is faster; default: the vehicle's, else one and a half turns in the shorter intervals, at most
        1 rad/s.
    acceleration_noise : float, optional
        rad/s^1.5; default: the vehicle's, else the best supported by the first passes.
    gap_s : float, optional
        A longer gap parts two passes; default: six usual intervals.
    pass_id : int, optional
        Only this pass, counted from zero as in the result; default: all.
    environment : Environment, optional
        What surrounds the body, on the telemetry's clock: an orbit (:func:`sunspin.environment.orbit.in_orbit`), or with z of its N
        to the Sun (:func:`sunspin.environment.circular`). In an orbit the field, the shadow and the direction of the Earth's light
        are known: a magnetometer, calibrated along the orbit, gives directions, and samples without a Sun count. The orbit is
        believed; :func:`sunspin.estimate.orbit.judged_orbit` judges it before.
    calibration : FieldCalibration, optional
        Of the magnetometer along the orbit (:func:`sunspin.estimate.field_calibration.field_calibration`), by a longer file say;
        default: by this telemetry.
    torques : list, optional
        Torques that act on the body, by name (`sunspin.dynamics.torques.TORQUES`). Where they depend on directions beside the
        Sun's, the turn about z of N is no longer arbitrary, and several are tried.
    wirings : bool
        Where a pass does not fit, try on the one with the most samples other wirings of panels and sensors
        (:mod:`sunspin.estimate.wiring`), and if none fits to leave out each sensor, the Sun's too
        (:mod:`sunspin.estimate.rates.hypotheses`); this takes minutes. Name what fits.
    effort : float
        How much may be computed, in units of what is usual (about a minute and a half of one core, counted in motions and not in
        seconds: :mod:`sunspin.estimate.effort`); infinite: whatever is needed. Where it does not suffice the best so far is kept,
        `search_complete` is false and the verdict says that the search was cut short.
    progress : bool
        Show what is being done, and how long it will take at most.

    Returns
    -------
    xarray.Dataset
        On `time` (all samples used; the search keeps 40 of a pass, the motion carries what it finds to the others), of each
        pass's best mode: `omega_B` (rad/s), `omega_cov_B`, `sun_B`, `sun_sigma_rad`,
        `B_from_N` (quaternion, scalar last; N is local to the pass, z to the Sun, the turn about z arbitrary; in an orbit with a
        magnetometer J2000, `attrs["frame_N"]` says which), `turn_sigma_rad` (of the turn about the Sun, in an orbit), `pass_id`.
        On `pass_id` and `mode`: `weight`, `omega_mean_B`, `omega_sigma_B` (of that mean, rad/s), `cost`, NaN where a pass has
        fewer modes; `cost_limit` (pass_id): beyond it no motion fits; `omega_sigma_all_B` (pass_id, axis): about the best mode's
        mean, all modes counted. What may be believed, and the motions at the sample nearest to the middle: the variables of
        `passes.csv` (:func:`sunspin.estimate.passes.table`); `model`, `model_weight`: the hypothesis of the motion
        (:mod:`sunspin.estimate.rates.alternatives`) and its weight, NaN where the effort left none for others; `misfit` (pass_id,
        sensor, figure) of the best mode.
        On `sample`: `why`: what became of each sample of the file. attrs: `verdict`, `source`, the settings; `sensors_late_s`,
        `sensors_late_sigma_s`; `wiring_doubt`, where another wiring or a sensor left out would make a pass fit.

    Raises
    ------
    InputError
        Too few samples, or no rate below the largest fits.
    MotionError
        A torque without the environment that it needs.
    """
    local = _along_the_sun(environment)
    forces = acting(torques, local)
    orbit = local.orbit if isinstance(local, SunAlongZ) else None
    calibration = calibration or (None if orbit is None else field_calibration(orbit, vehicle, telemetry))
    o, why, source = observations(vehicle, telemetry, source, local, calibration)
    parts = passes(o, why, gap_s)
    ids = _asked_for(pass_id, len(parts))
    parts = [parts[k] for k in ids]
    sensors = vehicle.sensors
    rate_max = _rate_max(sensors.disturbance.max_rate_rad_s if max_rate_rad_s is None else max_rate_rad_s, o, parts)
    given = _known_noise(vehicle, o, acceleration_noise)
    body = Body.of(vehicle, sensors.disturbance.dipole, torques_known=given is not None, acting=forces)
    momenta = wheel_momenta(vehicle, telemetry)
    for part in parts:
        require_followed(body, np.concatenate([momentum[part] for momentum in momenta.values()]), np.diff(o.t_s[part]).max())
    spent = Effort(allowed(effort), "rates" if progress else None)
    spent.doing("how strong torques are")
    with spent.part(NOISE_SHARE * spent.most) as judged:
        noise, o, wheels = choose(o, parts, body, rate_max, given, momenta)
    motion = Motion(body, noise, rate_max / 2)
    use = usable(o, why)
    wholes = [use[(use >= part[0]) & (use <= part[-1])] for part in parts]
    tracks, cut = _searched(o, parts, motion, rate_max, spent)
    if not _torque_told(vehicle, o):
        o = replace(o, terms=(*o.terms, MagneticTorque.beside(noise, o.freed().field_N)))
    ready = [(o.take(part).freed(), track) for part, (_, track) in zip(parts, tracks, strict=True)]
    with spent:
        spent.doing("errors in common")
        if given is None:
            motion = replace(motion, noise=refined(ready, motion))
        clock, late = _clock(sensors.clock, ready, motion)
        others = Others(given is None, partial(_clock_time, telemetry.attrs.get("epoch_utc")))
        each, fewer = _all_finished(o, wholes, parts, tracks, motion, clock, rate_max, noise, spent, others)
    found, walk = link(o, each, motion)
    cut = np.logical_or(cut, fewer) | judged.cut
    missed = np.array([coarse(o.take(part), motion, rate_max) for part in parts])
    result = _dataset(vehicle, telemetry, o, why, found, source, motion, rate_max, given is None)
    result = _in_space(result, local, found, o) if isinstance(local, SunAlongZ) else result
    result = result.assign_coords(pass_id=ids).assign(_believed(o, found, motion, missed | cut, telemetry.attrs.get("epoch_utc")))
    result = result.assign_attrs(
        late, wheels=wheels, walk_between_passes=np.nan if walk is None else walk, coarse_passes=int(missed.sum()),
        cut_passes=int(cut.sum()), effort=spent.spent / USUAL, no_sphere=int(body.spherical and noise >= HIGHER_NOISES[0]),
    )  # fmt: skip
    if source == "panels" and (alike := not_told(vehicle)):
        result.attrs["alike"] = alike
    if wirings and not result["fits"].values.all():
        with Effort(WIRING_SHARE * spent.most, "wirings" if progress else None) as tried:
            result = _other_wiring(result, vehicle, telemetry, rate_max, environment, calibration, torques)
            if "wiring_doubt" not in result.attrs and may_go_on():
                bad = [p for p, fits in zip(found, result["fits"].values, strict=True) if not fits]
                result.attrs |= _odd_sensor(o, max(bad, key=lambda p: len(p.index)), motion, clock, rate_max, noise)
        result = result.assign_attrs(wirings_cut=int(tried.close()))
    return result.assign_attrs(verdict=verdict(result))


def _searched(
    o: Observations, parts: list[np.ndarray], motion: Motion, rate_max: float, spent: Effort
) -> tuple[list[tuple[Observations, Track]], list[bool]]:
    """The heavier modes of each pass, and whether its search was cut short: each may take its part of what is left."""
    tracks, cut = [], []
    for k, part in enumerate(parts):
        spent.doing(f"pass {k + 1} of {len(parts)}")
        with spent.part((SEARCH_SHARE * spent.most - spent.spent) / (len(parts) - k)) as own:
            tracks.append((o.take(part), leading(o.take(part), motion, rate_max)))
        cut.append(own.cut)
    return tracks, cut


def _all_finished(
    o: Observations, wholes: list[np.ndarray], parts: list[np.ndarray], tracks: list[tuple[Observations, Track]], motion: Motion,
    clock: Clock | None, rate_max: float, begin: float, spent: Effort, others: Others,
) -> tuple[list[Pass], list[bool]]:
    """All passes `finished`, and where only some of the modes were, and no other model, the effort being spent."""
    found, fewer = [], []
    for k, (whole, part, (_, track)) in enumerate(zip(wholes, parts, tracks, strict=True)):
        spent.doing(f"fit of pass {k + 1} of {len(parts)}")
        fewer.append(not may_go_on())
        track = track.take(slice(FEW_MODES)) if fewer[-1] else track
        found.append(finished(o, whole, part, track, motion, clock, rate_max, begin, None if fewer[-1] else others))
    spent.close()
    return found, fewer


def _odd_sensor(
    o: Observations, p: Pass, motion: Motion, clock: Clock | None, rate_max: float, begin: float
) -> dict[str, str]:
    """Of a pass that does not fit: the sensor without which it does, in words, if there is one."""
    stated = Hypothesis(AS_READ, o.take(p.index), np.searchsorted(p.index, p.kept), motion, clock)

    def run(one: Hypothesis) -> Fit | None:
        if one is stated:
            return Fit(p.track.log_weight, False)
        part = one.o.take(one.kept)
        try:
            track = leading(part, replace(motion, noise=begin), rate_max)
        except InputError:
            return None
        made = finished(one.o, np.arange(len(one.o)), one.kept, track, motion, clock, rate_max, begin)
        fits = all(misfit(left[0]).fits for left in made.residual.values())
        explained = not part.of_sun or made.track.cost[0] <= cost_limit(part)  # the limit is of passes that see the Sun
        return Fit(made.track.log_weight, bool(fits and explained))

    odd = odd_one(ranked([stated, *sensors_left_out(stated)], run))
    if odd is None:
        return {}
    return {"odd_sensor": f"{odd.hypothesis.what} the other readings fit: it does not see what they see"}


def _other_wiring(result, vehicle, telemetry, rate_max, environment, calibration, torques) -> xr.Dataset:
    """The result with the wiring that fits the longest pass that does not fit as stated, or the sensor that is in its way."""
    bad = np.flatnonzero(~result["fits"].values)
    k = bad[np.argmax(result["samples"].values[bad])]
    times, first = np.unique(telemetry["time"].values, return_index=True)
    part = telemetry.isel(time=first[np.isin(times, result["time"].values[result["pass_of"].values == k])])
    source = None if result.attrs["source"] == "directions" else result.attrs["source"]
    setting: dict[str, Any] = {"source": source, "max_rate_rad_s": rate_max, "gap_s": np.inf, "environment": environment,
                               "calibration": calibration}  # fmt: skip

    def evidence(other: Vehicle, data: xr.Dataset) -> float:
        try:
            o, why, _ = observations(other, data, source)
            return quick_evidence(o, passes(o, why, np.inf)[0], Body.of(other, acting=acting(torques, environment)), rate_max)
        except InputError:
            return -np.inf

    def run(other: Vehicle, data: xr.Dataset) -> xr.Dataset | None:
        try:
            return rates(other, data, torques=torques, **setting)
        except InputError:
            return None

    found = better(vehicle, part, evidence, run, TURN_RATE)
    if found is None:
        return result
    if isinstance(found, Better):
        result = result.assign(wiring=("pass_id", np.where(result["fits"].values, result["wiring"].values, DOUBTFUL)))
    return result.assign_attrs(wiring_doubt=found.words)


def _clock_time(epoch_utc: str | None, t_s: float) -> str:
    """A time (s) as a person says it."""
    return f"{t_s:.0f} s" if epoch_utc is None else utc_after(t_s, epoch_utc)[11:19]
def _in_space(result: xr.Dataset, local: SunAlongZ, found: list[Pass], o: Observations) -> xr.Dataset:
    """The result with the turn about the Sun and its sigma; where a magnetometer was used, with attitudes from J2000."""
    best = [p.track.take(np.array([0])) for p in found]
    sun, covariance = (np.concatenate(parts) for parts in zip(*((t.sun_B[0], t.covariance[0]) for t in best), strict=True))
    sigma = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", sun, covariance[:, :3, :3], sun), 0.0))
    about = {"units": "rad", "long_name": "one sigma of the turn about the Sun"}
    result = result.assign(turn_sigma_rad=("time", sigma, about)).assign_attrs(
        orbit=local.orbit.elements[0].number, orbit_shift_s=local.orbit.shift_s,
        orbit_shift_sigma_s=float(np.hypot(local.orbit.shift_sigma_s, local.orbit.clock_sigma_s)),
    )  # fmt: skip
    if o.freed().field_N is None:
        return result
    attitude = Rotation.from_quat(result["B_from_N"].values).as_matrix() @ local.N_from_J2000(result["time"].values)
    turned = ("time", "quaternion"), Rotation.from_matrix(attitude).as_quat(), {"units": "1"}
    return result.assign(B_from_N=turned).assign_attrs(frame_N=J2000)


def _asked_for(pass_id: int | None, count: int) -> list[int]:
    """Which of so many passes are estimated."""
    if pass_id is None:
        return list(range(count))
    if isinstance(pass_id, bool) or not isinstance(pass_id, int | np.integer) or not 0 <= pass_id < count:
        raise InputError(sentence("there is no such pass", got=pass_id, do=f"the file has passes 0 to {count - 1}"))
    return [int(pass_id)]


def _along_the_sun(environment: Environment | None) -> Environment | None:
    """The environment in axes whose z is the Sun's direction."""
    if isinstance(environment, Orbit):
        return SunAlongZ(environment)
    sun = SUN_N if environment is None else environment.at(0.0).sun_N[0]
    if np.linalg.norm(sun - SUN_N) > 1e-6:
        raise InputError(sentence("rates needs an environment with z of its N to the Sun", got=f"the Sun at {np.round(sun, 3)}"))
    return environment


def _known_noise(vehicle: Vehicle, o: Observations, asked: float | None) -> float | None:
    """The acceleration noise asked for, else the vehicle's: another one where its dipole cannot be modelled, the field not being
    measured."""
    disturbance = vehicle.sensors.disturbance
    modelled = disturbance.dipole is None or _torque_told(vehicle, o)
    stated = disturbance.acceleration_noise if modelled else disturbance.noise_without_field
    given = stated if asked is None else asked
    if given is not None and not NOISE_RANGE[0] <= given <= NOISE_RANGE[1]:
        low, high = NOISE_RANGE
        raise InputError(sentence(f"acceleration_noise must lie between {low:g} and {high:g} rad/s^1.5", got=given))
    return given


def _torque_told(vehicle: Vehicle, o: Observations) -> bool:
    """Whether the vehicle file has a dipole, and the field that pulls at it is measured."""
    return vehicle.sensors.disturbance.dipole is not None and bool(np.isfinite(o.field_B).all(axis=1).any())


def _clock(
    told: Lateness | None, tracks: list[tuple[Observations, Track]], motion: Motion
) -> tuple[Clock | None, dict[str, float | str]]:
    """The clock with which the passes are finished, narrowed by all of them, and what is said of it."""
    nothing = {"sensors_late_s": np.nan, "sensors_late_sigma_s": np.nan, "sensors_late_from": "taken as read together"}
    if told is None:
        late = suspected(tracks, motion)
        longest = max(float(np.ptp(o.t_s)) for o, _ in tracks)
        if late is None or abs(late.late_s) > MOST_LATE * longest:  # it stands for a motion that does not fit
            return None, nothing
        return None, {"sensors_late_s": late.late_s, "sensors_late_sigma_s": late.sigma_s, "sensors_late_from": SUSPECTED}
    clock = Clock(told.late_s, told.sigma_s)
    late = lateness(tracks, motion, clock) if told.sigma_s > 0 else None
    if late is not None:
        clock = Clock(late.late_s, late.sigma_s)
    words = "vehicle file" if late is None else "vehicle file and data"
    return clock, {"sensors_late_s": clock.late_s, "sensors_late_sigma_s": clock.sigma_s, "sensors_late_from": words}


def leading(o: Observations, motion: Motion, rate_max: float) -> Track:
    """The heavier modes of one pass, best first."""
    found = []
    for guess in guesses(o):
        if found and not may_go_on():
            break
        track = search(guess, motion, rate_max)
        track = out_of_field(o, track, motion) if field_leads(o) else _turned_about_sun(guess, track, motion)
        order, weight = _ranked(track)
        heavy = weight[: max(2 * MAX_MODES, most_modes(o))] > LEAST_WEIGHT**2
        found.append(track.take(order[: max(1, int(np.count_nonzero(heavy)))]))
    return joined(found)


def most_modes(o: Observations) -> int:
    """Modes reported for each pass: two motions with all their images at least."""
    return max(MAX_MODES, 2 * len(images_of(o)))


def _turned_about_sun(o: Observations, track: Track, motion: Motion) -> Track:
    """The modes, tried with several turns about the Sun where torques tell one from the other: the search knows only the Sun."""
    if not needed(motion.body.acting.torques) or not len(track.omega):
        return track
    angles = 2 * np.pi / TURNS * np.arange(TURNS)[:, None] * SUN_N
    tried = [Track(track.attitude @ about, track.omega) for about in Rotation.from_rotvec(angles).as_matrix()]
    fitted = joined([smooth(o, one, motion, steps=12) for one in tried])
    return distinct(fitted, o.t_s)


def _ranked(track: Track) -> tuple[np.ndarray, np.ndarray]:
    """The hypotheses' order, heaviest first, and their weights in it, that of the first being one."""
    order = np.argsort(-track.log_weight, kind="stable")
    return order, np.exp(track.log_weight[order] - track.log_weight[order[0]])


def loosened(plain: Observations, motion: Motion, clock: Clock | None, rate_max: float) -> Common:
    """Modes found as if strong torques acted, then fitted with the inertia as it may be: where that of the file fits no motion."""
    loose = replace(motion, noise=max(LOOSER[0], motion.noise))
    return with_common(plain.freed(), leading(plain, loose, rate_max), motion, clock, begin=loose.noise)


def finished(
    every: Observations, index: np.ndarray, kept: np.ndarray, track: Track, motion: Motion, clock: Clock | None,
    rate_max: float, begin: float, others: Others | None = None,
) -> Pass:
    """The modes of one pass with their weights (masses of the posterior, by Laplace's method) and sigmas, at the Sun's instants:
    found at the samples `kept` of `index` under an acceleration noise `begin`, carried to all of them; with what else may have
    moved the body counted in, if `others` are to be tried."""
    plain = every.take(kept)
    o = plain.freed()
    fit = settled(o, track, motion, clock, begin)
    if len(motion.body.errors) and fit.track.cost.min() > cost_limit(o):
        other = loosened(plain, motion, clock, rate_max)
        fit = other if other.track.cost.min() < fit.track.cost.min() else fit
    fit = fit.take(distinct_index(fit.track, o.t_s))  # with their common errors two hypotheses may have become one
    stated = weighed(Hypothesis(AS_READ, every.take(index), np.searchsorted(index, kept), motion, clock), fit)
    trials = [stated] if others is None else alternatives(stated, others)
    groups = counted(trials)
    used = sorted({i for group in groups for i, _ in group.members})
    heads = {group.members[0][0] for group in groups}
    each = {i: completed(trials[i], stated.hypothesis, index, kept, i in heads) for i in used}
    modes = [mixed([each[i].take(np.array([k]), np.ones(1)) for i, k in group.members], group.weights) for group in groups]
    shares = [(trials[i].hypothesis.what, float(w)) for one in groups for (i, _), w in zip(one.members, one.weights, strict=True)]
    found = stacked(modes)._replace(model=(AS_READ, np.nan) if others is None else likeliest(shares))
    return found.take(np.arange(len(modes)), np.array([group.weights.sum() for group in groups]))


def completed(trial: Trial, stated: Hypothesis, index: np.ndarray, kept: np.ndarray, whole_story: bool = True) -> Pass:
    """A trial's modes with their sigmas, at all samples, with residuals of sensors as good as stated if the `whole_story` is asked
    for."""
    one, fit, o = trial.hypothesis, trial.fit, trial.hypothesis.fitted()
    between = Dense.of(one.o, np.arange(len(one.o)), one.kept, fit.seen, one.motion)
    track, sigma = with_spread(o, one.motion, between.mean_map(), fit, one.clock)
    whole = between.filled(replace(track, attitude=fit.seen.attitude, omega=fit.seen.omega))
    left = {}
    if whole_story:
        left = residuals(stated.o.freed(), one.kept, whole, Fitted(o, fit.track, fit.error, one.motion, one.clock))
    hidden = sum(term.hidden_variance(np.diff(o.t_s)) for term in o.of_motion)
    whole.covariance[..., 3:, 3:] += hidden * np.eye(3)
    whole = replace(whole, log_weight=trial.log_evidence)
    weight = np.exp(trial.log_evidence - trial.best)
    return Pass(index, kept, whole, weight, whole.omega.mean(axis=1), np.sqrt(sigma**2 + hidden / len(o)), left)


def mixed(members: list[Pass], weights: np.ndarray) -> Pass:
    """One motion that several hypotheses lead to: as the heaviest has it, with what the others are off counted in its sigmas."""
    head = members[0]
    covariance, variance = np.zeros_like(head.track.covariance), np.zeros_like(head.mean_sigma)
    for one, share in zip(members, weights / weights.sum(), strict=True):
        turned = turn_between(head.track.attitude, one.track.attitude)
        off = np.concatenate([turned, one.track.omega - head.track.omega], axis=-1)
        covariance += share * (one.track.covariance + off[..., :, None] * off[..., None, :])
        variance += share * (one.mean_sigma**2 + (one.mean - head.mean) ** 2)
    log_weight = np.logaddexp.reduce([one.track.log_weight for one in members])
    track = replace(head.track, covariance=covariance, log_weight=log_weight)
    return head._replace(track=track, mean_sigma=np.sqrt(variance))


def stacked(modes: list[Pass]) -> Pass:
    """All of a pass's modes."""
    first = modes[0]
    left = {name: np.concatenate([one.residual[name] for one in modes]) for name in first.residual}
    weight, mean, sigma = (np.concatenate([getattr(one, name) for one in modes]) for name in ("weight", "mean", "mean_sigma"))
    return Pass(first.index, first.kept, joined([one.track for one in modes]), weight, mean, sigma, left)


def likeliest(shares: list[tuple[str, float]]) -> tuple[str, float]:
    """Of what hypotheses say, each with a weight, what is named, and its weight: the model as stated unless that is improbable."""
    total = {AS_READ: 0.0}
    for what, weight in shares:
        total[what] = total.get(what, 0.0) + weight
    return (AS_READ, total[AS_READ]) if total[AS_READ] > NAMED else max(total.items(), key=lambda one: one[1])


def link(o: Observations, found: list[Pass], motion: Motion) -> tuple[list[Pass], float | None]:
    """The passes with weights that count their neighbours in, best mode first, hopeless ones left out; and the walk."""
    middle = [float(o.t_s[p.index].mean()) for p in found]
    means, sigmas = [p.mean for p in found], [p.mean_sigma for p in found]
    weights, walk = linked(middle, means, sigmas, [p.weight for p in found], motion.rate_prior)
    result = []
    for p, weight in zip(found, weights, strict=True):
        order = np.argsort(-weight, kind="stable")
        keep = order[: max(1, int(np.count_nonzero(weight[order[: most_modes(o)]] > LEAST_WEIGHT)))]
        result.append(p.take(keep, weight[keep]))
    return result, walk


def _rate_max(given: float | None, o: Observations, parts: list[np.ndarray]) -> float:
    if given is not None:
        if not (np.isfinite(given) and given > 0):
            raise InputError(sentence("max_rate_rad_s must be positive", got=given))
        return float(given)
    usual = float(np.median([np.sort(np.diff(o.t_s[part]))[: max(2, len(part) // 8)].mean() for part in parts]))
    return min(1.5 * 2 * np.pi / usual, DEFAULT_MAX_RATE)


def _spread(mean: np.ndarray, sigma: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Sigma (3) about the best mode's mean rate when the other modes, by their weights, are counted in."""
    share = (weight / weight.sum())[:, None]
    return np.sqrt((share * (sigma**2 + (mean - mean[0]) ** 2)).sum(axis=0))


def _believed(o: Observations, found: list[Pass], motion: Motion, missed: list[bool], epoch_utc: str | None) -> dict[str, Any]:
    """What may be believed of each pass, and its motions at the sample nearest to its middle."""
    rows, names = [], sorted({name for p in found for name in p.residual})
    misfits = {name: np.full((len(found), 3), np.nan) for name in names}
    for k, (p, is_missed) in enumerate(zip(found, missed, strict=True)):
        t = o.t_s[p.index]
        at = int(np.argmin(np.abs(t - (t[0] + t[-1]) / 2)))
        omega, covariance = p.track.omega[:, at], p.track.covariance[:, at, 3:, 3:]
        sigma = np.sqrt(np.einsum("kii->ki", covariance))
        told = {name: misfit(left[0]) for name, left in p.residual.items()}
        for name, one in told.items():
            misfits[name][k] = one
        explained = p.track.cost[0] <= cost_limit(o.take(p.kept))
        one = either_side(p.track) if len(images_of(o)) > 1 else np.arange(len(p.weight)) == 0
        unique = bool(p.weight[one].sum() >= DECIDED)
        said = answers(unique, _spread(omega, sigma, p.weight), motion.rate_prior, told, explained, not is_missed)
        row = PassMotions(
            len(t), t[0], t[-1], t[at], p.weight, omega, sigma, speeds(omega, covariance), said,
            UNCHECKED if list(told) == ["Sun"] else AS_STATED,
        )  # fmt: skip
        rows.append(row)
    about = {"long_name": "readings, share of them beyond three sigma, chance that those are strewn so little over time"}
    return table(rows, epoch_utc) | {
        "misfit": (("pass_id", "sensor", "figure"), np.stack([misfits[name] for name in names], axis=1), about),
        "sensor": names, "figure": ["readings", "beyond", "chance"],
        "model": ("pass_id", [p.model[0] for p in found], {"long_name": "what holds most of the weight of all that was tried"}),
        "model_weight": ("pass_id", [p.model[1] for p in found], {"units": "1"}),
    }  # fmt: skip


def _dataset(vehicle, telemetry, o, why, found: list[Pass], source, motion, rate_max, chosen) -> xr.Dataset:
    count = max(len(p.weight) for p in found)

    def padded(values: list[np.ndarray]) -> np.ndarray:
        out = np.full((len(values), count, *values[0].shape[1:]), np.nan)
        for row, value in zip(out, values, strict=True):
            row[: len(value)] = value
        return out

    index = np.concatenate([p.index for p in found])
    best = [p.track.take(np.array([0])) for p in found]
    attitude = np.concatenate([track.attitude[0] for track in best])
    covariance = np.concatenate([track.covariance[0] for track in best])
    sun = np.concatenate([track.sun_B[0] for track in best])
    means = [(p.mean, p.mean_sigma) for p in found]
    spread = np.array([_spread(*mean, p.weight) for mean, p in zip(means, found, strict=True)])
    across = np.eye(3) - sun[:, :, None] * sun[:, None, :]
    sun_sigma = np.sqrt(np.maximum(np.einsum("nij,njk,nik->n", across, covariance[:, :3, :3], across), 0.0))
    attrs: dict[str, Any] = provenance("rates", telemetry, **vehicle.said) | {
        "source": source, "acceleration_noise": motion.noise, "max_rate_rad_s": rate_max,
        "acceleration_noise_from": "evidence of the data" if chosen else "given",
        "body": "nearly a sphere (no inertia)" if motion.body.spherical else "rigid body with the vehicle's inertia and wheels",
        "earth_light": max((x.earth_share for x in o.terms if isinstance(x, Panels) and not faint(x.earth_share)), default=0.0),
        "frame_N": SUN_Z_LOCAL,
    }  # fmt: skip
    read = {x.name for x in o.terms if isinstance(x, SENSORS) and x.present()[index].any()}
    attrs |= {f"{sensor.name}_used": int(sensor.name in read) for sensor in SENSORS}
    result = xr.Dataset(
        {
            "omega_B": (("time", "axis"), np.concatenate([t.omega[0] for t in best]), {"units": "rad s-1"}),
            "omega_cov_B": (("time", "axis", "axis2"), covariance[:, 3:, 3:], {"units": "rad2 s-2"}),
            "sun_B": (("time", "axis"), sun, {"units": "1", "long_name": "direction to the Sun, smoothed"}),
            "sun_sigma_rad": ("time", sun_sigma, {"units": "rad"}),
            "B_from_N": (("time", "quaternion"), Rotation.from_matrix(attitude).as_quat(), {"units": "1"}),
            "pass_of": ("time", np.repeat(np.arange(len(found)), [len(p.index) for p in found])),
            "omega_mean_B": (("pass_id", "mode", "axis"), padded([m[0] for m in means]), {"units": "rad s-1"}),
            "omega_sigma_B": (("pass_id", "mode", "axis"), padded([m[1] for m in means]), {"units": "rad s-1"}),
            "omega_sigma_all_B": (("pass_id", "axis"), spread, {"units": "rad s-1"}),
            "cost": (("pass_id", "mode"), padded([p.track.cost for p in found]), {"units": "1"}),
            "cost_limit": ("pass_id", [cost_limit(o.take(p.kept)) for p in found], {"units": "1"}),
            "why": ("sample", why.astype(np.str_)),
        },
        coords={
            "time": ("time", o.t_s[index], {"units": "s"}), "sample": o.t_s, "axis": ["x", "y", "z"],
            "pass_id": np.arange(len(found)), "quaternion": ["x", "y", "z", "w"],
        },
        attrs=attrs,
    )  # fmt: skip
    return result


def _left_open(result: xr.Dataset, one: np.ndarray, several: np.ndarray) -> str:
    """What is said of passes with `one` motion that may see the Sun on either side, and of those with `several`."""
    text = ""
    if sides := int((one & (result["weight"].values[:, 0] < DECIDED)).sum()):
        text += f"; in {sides} the Sun may stand on either side of the body: the rates are the same, the attitude is not known"
    if several.any() and "alike" in result.attrs:
        return f"{text}; in the others several motions fit, because {result.attrs['alike']}; whole turns more or less may fit, too"
    if several.any():
        text += "; in the others several motions fit, mostly whole turns more or less between samples, and all are listed"
    return text


def verdict(result: xr.Dataset) -> str:
    """What the data can tell, in words."""
    decided, unique, fits = (result[name].values for name in ("decided", "unique", "fits"))
    informed = np.all([result[f"informed_{axis}"].values for axis in "xyz"], axis=0)
    text = f"{int(decided.sum())} of {len(decided)} passes are decided: one motion holds at least {DECIDED:.0%} of the weight, "
    text += f"fits, and each component is known to less than {NARROWER:g} of what was possible before"
    if not fits.all():
        text += f"; in {int((~fits).sum())} NO motion fits the samples: torques, a wheel that changes speed, or faults not modelled"
    for doubt in ("wiring_doubt", "odd_sensor"):
        text += f"; {result.attrs[doubt]}" if doubt in result.attrs else ""
    if count := int((fits & unique & ~informed).sum()):
        text += f"; in {count} one motion is left, but the data do not inform all of its components"
    if other := sum(one != AS_READ for one in result["model"].values):
        text += f"; in {other} the motion is not that of the model as stated: what it may be is named"
    text += _left_open(result, fits & unique, fits & ~unique)
    if cut := result.attrs["cut_passes"]:
        text += f"; in {cut} the SEARCH WAS CUT SHORT and the best so far is told: give more effort (`--effort 10`)"
    if result.attrs.get("wirings_cut"):
        text += "; not every other wiring was tried: give more effort (`--effort 10`)"
    if missed := result.attrs["coarse_passes"]:
        text += f"; in {missed} the search is coarse and a motion may have been missed: give a smaller largest rate if you know one"
    late = f"{result.attrs['sensors_late_s']:.2f} +- {result.attrs['sensors_late_sigma_s']:.2f} s"
    if result.attrs["sensors_late_from"] == SUSPECTED and "wiring_doubt" not in result.attrs:
        text += f"; gyro, magnetometer or attitude SEEM LATE by {late}, which is not counted: see [clock] of the vehicle file"
    elif np.isfinite(result.attrs["sensors_late_s"]) and result.attrs["sensors_late_from"] != SUSPECTED:
        text += f"; gyro, magnetometer and attitude are {late} late ({result.attrs['sensors_late_from']})"
    if not any(result.attrs[f"{sensor}_used"] for sensor in ("gyro", "field", "attitude")):
        text += "; the Sun alone was used: the turn about the Sun line is seen only through the motion"
        if result.attrs["no_sphere"]:
            text += "; the body is far from the sphere that the search takes it for, and another motion may fit: GIVE ITS INERTIA"
    return text
