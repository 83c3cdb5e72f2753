"""Body rates and attitude from where the Sun was, seen now and then: from directions, panel powers, with or without a gyro."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.base.provenance import with_units
from sunspin.compute.pool import may_fork, process_pool, worker_count
from sunspin.dynamics.torques import acting
from sunspin.environment import Environment
from sunspin.environment.orbit import Orbit, SunAlongZ
from sunspin.estimate.effort import USUAL, Effort, allowed, may_go_on
from sunspin.estimate.equivalence import (
    AS_WRITTEN,
    CLEARLY,
    Observed,
    alike,
    column_changes,
    equivalence,
    rate_under,
    unseen_changes,
    wheel_change,
    wheel_changes,
)
from sunspin.estimate.orbit.field_calibration import FieldCalibration, field_calibration
from sunspin.estimate.passes import AS_STATED, DOUBTFUL, UNCHECKED
from sunspin.estimate.rates.alternatives import Others
from sunspin.estimate.rates.clock import lateness, suspected
from sunspin.estimate.rates.common_errors import Clock
from sunspin.estimate.rates.finish import Pass, finished, leading, link
from sunspin.estimate.rates.gyro_axes import wrong_gyro_axes
from sunspin.estimate.rates.hypotheses import AS_STATED as AS_READ
from sunspin.estimate.rates.hypotheses import Fit, Hypothesis, odd_one, ranked, sensors_left_out
from sunspin.estimate.rates.images import SAME_SIGMAS
from sunspin.estimate.rates.motion import Body, load, require_followed
from sunspin.estimate.rates.noise import (
    HIGHER_NOISES,
    Task,
    choose,
    evidence_of_noises,
    quick_evidence,
    refined,
)
from sunspin.estimate.rates.observe import in_passes, observations, passes, usable
from sunspin.estimate.rates.period import weighted, without_periods
from sunspin.estimate.rates.residuals import panels_as_read
from sunspin.estimate.rates.result import (
    SUSPECTED,
    believed,
    cures,
    dataset_of,
    in_space,
    in_the_field,
    verdict,
)
from sunspin.estimate.rates.rough import roughly
from sunspin.estimate.rates.side_by_side import begun, each
from sunspin.estimate.rates.smooth import cost_limit
from sunspin.estimate.rates.start import coarse, finest
from sunspin.estimate.rates.state import Motion, Observations, Track
from sunspin.estimate.rates.wheel_signs import (
    Anew,
    Reversed,
    doubted_signs,
    reversed_momenta,
    tasks,
)
from sunspin.estimate.rates.wheels import momentum_of_each, wheel_momenta
from sunspin.estimate.terms.magnetic_torque import MagneticTorque
from sunspin.estimate.terms.magnetometer import TURN_RATE
from sunspin.estimate.terms.period import Period
from sunspin.estimate.terms.sensors import FIELD
from sunspin.estimate.terms.term import SUN_N
from sunspin.estimate.verdict import alike_motions, misfit
from sunspin.estimate.wiring import Better, Named, better, implausible
from sunspin.telemetry.assess import Assessment, assess
from sunspin.vehicle import Vehicle
from sunspin.vehicle.sensors import Clock as Lateness
from sunspin.vehicle.timeline import utc_after

NOISE_RANGE = (1e-9, 1.0)
"""rad/s^1.5; the smallest lets a rate wander by 2e-5 deg/s in a day, the largest by a turn in 20 s: no satellite is outside."""

DEFAULT_MAX_RATE = 1.0
"""rad/s; the search goes no farther unless told, however dense the samples: every sixth of a turn more is another start."""

NOISE_SHARE, SEARCH_SHARE, WIRING_SHARE, SIGN_SHARE = 0.3, 0.75, 0.4, 0.6
"""Of the effort: as far as the choice of the torques' strength may go, and the search of all passes; beside it, for wirings and for
wheels that turn the other way."""

STRAINED, CALMER = 1e-4, 4.0
"""Acceleration noise (rad/s^1.5) chosen by the data from which a file that fits may have other columns than it states: of nine
files with two columns exchanged that fit six wanted as much, of their right ones none more than 5e-6. And by what factor a change
must lower it."""

MUCH_MORE = 1.5
"""A search that was cut short begins anew where it may take so many times more."""

PASSES_EACH = 4
"""Of a process that is no copy of this one, at least: it takes as long to begin as a pass or two."""

ROUND = 8
"""Passes after which it is asked whether the effort is spent: a number of its own, so that workers change nothing."""

UNSEEN_RAD = 0.05
"""Torques that turn a body by more between the closest two samples may stand for a nutation, its moments being unknown."""

FEW_MODES = 3
"""Modes that are fitted with all unknowns where the effort is spent."""

MOST_LATE = 0.1
"""A lateness that nobody spoke of is not reported beyond this part of the longest pass."""

NOT_LATE = {
    "sensors_late_s": np.nan,
    "sensors_late_sigma_s": np.nan,
    "sensors_late_from": "taken as read together",
}
"""What is said where sensors neither are nor seem late."""


def rates(
    vehicle: Vehicle,
    telemetry: xr.Dataset | Assessment,
    *,
    source: str | None = None,
    max_rate_rad_s: float | None = None,
    acceleration_noise: float | None = None,
    gap_s: float | None = None,
    pass_id: int | None = None,
    environment: Environment | None = None,
    calibration: FieldCalibration | None = None,
    torques: Sequence[str] = (),
    periods: Sequence[Period] = (),
    column_tests: bool = False,
    effort: float = 1.0,
    workers: int = 1,
    progress: bool | Callable[[str], None] = False,
) -> xr.Dataset:
    """Body rates and attitude of every pass of a telemetry file, all solutions that the data cannot tell apart.

    Every turn, and every number of turns up to the largest rate, that takes the Sun from one sample to the next is a start;
    starts grow over the pass by smoothing (:mod:`sunspin.estimate.rates.smooth`): rigid-body motion with the vehicle's inertia
    and wheels (nearly a sphere where no inertia is known) and white angular acceleration for what it leaves out, measurements with
    Student tails.

    Parameters
    ----------
    telemetry : Dataset of `read_telemetry` or its Assessment, or Dataset of `sun_directions`
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
        believed; :func:`sunspin.estimate.orbit.judged.judged_orbit` judges it before.
    calibration : FieldCalibration, optional
        Of the magnetometer along the orbit, by a longer file say
        (:func:`sunspin.estimate.orbit.field_calibration.field_calibration`); default: by this telemetry.
    torques : list, optional
        Torques that act on the body, by name (`sunspin.dynamics.torques.TORQUES`). Where they depend on directions beside the
        Sun's, the turn about z of N is no longer arbitrary, and several are tried.
    periods : list of Period, optional
        Periods seen from outside, of the precession, the spin or their sum: the solutions are weighted by them
        (:mod:`sunspin.estimate.rates.period`). `probability_without_periods (pass_id, solution)` has the probabilities without, and
        attrs["periods"], in JSON, what each decided.
    column_tests : bool
        Where a pass does not fit, try on the one with the most samples other columns, axes and signs of panels and sensors
        (:mod:`sunspin.estimate.wiring`), and if none fits to leave out each sensor, the Sun's too
        (:mod:`sunspin.estimate.rates.hypotheses`); this takes minutes. Name what fits.
    effort : float
        How much may be computed, in units of what is usual (about a minute and a half of one core, counted in motions and not in
        seconds: :mod:`sunspin.estimate.effort`); infinite: whatever is needed. Where it does not suffice the best so far is kept,
        `search_complete` is false and the verdict says that the search was cut short.
    workers : int
        Processes that estimate passes side by side, copies of this one where that is safe, else four passes each at least; the
        result does not depend on it. A script that asks for more than one needs `if __name__ == "__main__":`.
    progress : bool, or a function of a line
        Show what is being done, how long it will take at most, and of each pass a rough speed as soon as its first motions are
        found (:mod:`sunspin.estimate.rates.rough`); a function is called once, when the inputs are accepted and the search begins.

    Returns
    -------
    xarray.Dataset
        On `time` (all samples used; the search keeps 40 of a pass, the motion carries what it finds to the others), of each
        pass's best solution: `omega_B` (rad/s), `omega_cov_B`, `sun_B`, `sun_sigma_rad`,
        `B_from_N` (quaternion, scalar last; N is local to the pass, z to the Sun, the turn about z arbitrary; in an orbit with a
        magnetometer J2000, `attrs["frame_N"]` says which), `turn_sigma_rad` (of the turn about the Sun, in an orbit), `pass_id`.
        On `curve_time`, even instants of each pass, the same between the samples, by the equations of motion: `curve_omega_B`,
        `curve_omega_sigma_B`, `curve_B_from_N`, `curve_pass_of`.
        On `pass_id` and `solution`: `probability`, `omega_mean_B`, `omega_sigma_B` (of that mean, rad/s), `cost`, NaN where a pass
        has fewer solutions; `cost_limit` (pass_id): beyond it no motion fits; `omega_sigma_all_B` (pass_id, axis): about the mean
        of the best solution, all solutions counted. What may be believed, and the motions at the sample nearest to the middle: the
        variables of `passes.csv` (:func:`sunspin.estimate.passes.table`); `model`, `model_probability`: the hypothesis of the
        motion (:mod:`sunspin.estimate.rates.alternatives`) and its probability, NaN where the effort left none for others; `misfit`
        (pass_id, sensor, figure) and `residual` (sensor, time), sigmas, of the best solution;
        `estimate_value`, `estimate_sigma` (pass_id, estimate): what was estimated with it.
        On `sample`: `why`: what became of each sample of the file. attrs: `verdict`, `source`, the settings; `sensors_late_s`,
        `sensors_late_sigma_s`; `columns_doubt`, where other columns or a sensor left out would make a pass fit.

    Raises
    ------
    InputError
        Too few samples, no rate below the largest fits, or a period was seen at a time of no pass.
    MotionError
        A torque without the environment that it needs.
    """
    assessment = assess(vehicle, telemetry)
    telemetry = assessment.telemetry
    local = _along_the_sun(environment)
    forces = acting(torques, local)
    calibration = calibration or (
        field_calibration(local.orbit, vehicle, assessment)
        if isinstance(local, SunAlongZ)
        else None
    )
    o, why, source = observations(vehicle, assessment, source, local, calibration)
    use, every = usable(o, why), passes(o, why, gap_s)
    ids = _asked_for(pass_id, len(every))
    parts = [every[k] for k in ids]
    # passes hold samples thinned for the search; between their ends lie all that are used
    wholes = [np.intersect1d(use, np.arange(part[0], part[-1] + 1)) for part in every]
    why, wholes = in_passes(use, why, wholes, ids), [wholes[k] for k in ids]
    rate_max = _rate_max(
        vehicle.sensors.disturbance.max_rate_rad_s if max_rate_rad_s is None else max_rate_rad_s,
        o,
        parts,
    )
    given = _known_noise(vehicle, o, acceleration_noise)
    body = Body.of(
        vehicle, vehicle.sensors.disturbance.dipole, torques_known=given is not None, acting=forces
    )
    momenta = wheel_momenta(vehicle, telemetry)
    for part in parts:
        require_followed(
            body,
            np.concatenate([momentum[part] for momentum in momenta.values()]),
            np.diff(o.t_s[part]).max(),
        )
    _begin(body, (wholes, parts), effort, progress)
    with process_pool(_useful(workers, parts, momenta, vehicle, forces.torques)) as pool:
        spent = Effort(allowed(effort), "rates" if progress is True else None)
        with spent.part(NOISE_SHARE * spent.most) as judged:
            noise, o, wheels = choose(
                o, parts, body, rate_max, given, momenta, partial(_evidences, spent, judged, pool)
            )
        signs = _signs(
            o,
            parts,
            reversed_momenta(vehicle, telemetry, wheels, o),
            noise,
            body,
            rate_max,
            given,
            spent,
            pool,
        )
        motion = Motion(body, noise, rate_max / 2)
        tracks, cut = _searched(o, parts, motion, rate_max, spent, pool)
        o, more = _with_magnetic_torque(vehicle, o, noise)
        with spent:
            spent.doing("errors in common")
            leads = [track for _, track in tracks]
            o = panels_as_read(o, zip(wholes, parts, leads, strict=True), motion)
            ready = [
                (o.take(part).freed(), track) for part, track in zip(parts, leads, strict=True)
            ]
            if given is None:
                motion = replace(motion, noise=refined(ready, motion))
            clock, late = _clock(vehicle.sensors.clock, ready, motion)
            others = Others(given is None, partial(_clock_time, telemetry.attrs.get("epoch_utc")))
            modes, fewer = _all_finished(
                o, wholes, parts, tracks, motion, clock, rate_max, noise, spent, others, pool
            )
        turned = signs(
            o,
            list(zip(wholes, parts, modes, strict=True)),
            Anew(body, rate_max, given, clock, others, more),
        )
    found, walk, period_attrs = _linked(o, modes, motion, periods, ids)
    cut = np.logical_or(cut, fewer) | judged.cut
    missed, unmet, fine = _doubted(o, parts, motion, rate_max, given)
    result = dataset_of(vehicle, telemetry, o, why, found, source, motion, rate_max, given is None)
    result = result.assign_coords(pass_id=ids).assign_attrs(
        effort_given=effort, fine_up_to_rad_s=fine
    )
    result = in_space(result, local, found, o) if isinstance(local, SunAlongZ) else result
    result = in_the_field(result) if source == FIELD and calibration is None else result
    said = believed(
        o, found, motion, cures(result.attrs, cut, missed, unmet), telemetry.attrs.get("epoch_utc")
    )
    result = result.assign(said | without_periods(found)).assign_attrs(
        late | period_attrs,
        wheels=wheels,
        walk_between_passes=np.nan if walk is None else walk,
        coarse_passes=int(missed.sum()),
        cut_passes=int(cut.sum()),
        effort=spent.spent / USUAL,
        no_sphere=int(unmet.sum()),
        samples_searched=sum(map(len, parts)),
    )
    observed = _observed(vehicle, telemetry, wheels, source, isinstance(local, SunAlongZ))
    result = _symmetric_checked(_columns_checked(result, observed, telemetry), observed, telemetry)
    if column_tests and (
        not result["fits"].values.all() or _suspicious(result, observed, telemetry)
    ):
        with Effort(WIRING_SHARE * spent.most, "columns" if progress is True else None) as tried:
            result = _other_wiring(
                result, observed, telemetry, rate_max, environment, calibration, torques
            )
            bad = [p for p, fits in zip(found, result["fits"].values, strict=True) if not fits]
            if bad and "columns_doubt" not in result.attrs and turned is None and may_go_on():
                result.attrs |= _odd_sensor(
                    o, max(bad, key=lambda p: len(p.index)), motion, clock, rate_max, noise
                )
        result = result.assign_attrs(column_tests_cut=int(tried.close()))
    result = _wheel_doubted(result, turned, observed, telemetry)
    return _judged(_repeats_doubted(result, assessment), assessment)


def _observed(
    vehicle: Vehicle, telemetry: xr.Dataset, wheels: str, source: str, in_orbit: bool
) -> Observed:
    """What the telemetry has read, as far as it tells changes of columns, signs and axes apart; `wheels`: what they do."""
    momenta = momentum_of_each(vehicle, telemetry, wheels)
    observed = Observed.of(vehicle, telemetry, momenta=momenta, in_orbit=in_orbit)
    return replace(observed, panels=observed.panels and source == "panels")


def _columns_checked(result: xr.Dataset, observed: Observed, telemetry: xr.Dataset) -> xr.Dataset:
    """The result with what panels cannot tell apart: motions, in attrs["alike"], and changes of columns that look the same as the
    file as it is written, in attrs["columns_unseen"] (JSON: what, and the matrix by which directions change); where there are none
    of the latter the data confirm the columns."""
    if not observed.panels:
        return result
    if words := alike_motions(observed.vehicle):
        result = result.assign_attrs(alike=words)
    unseen = unseen_changes(replace(observed, sun_B=result["sun_B"].values), telemetry)
    if not unseen:
        return result.assign(
            columns_checked=(
                "pass_id",
                np.where(
                    result["columns_checked"].values == UNCHECKED,
                    AS_STATED,
                    result["columns_checked"].values,
                ),
            )
        )
    told = [
        {"what": change.what, "matrix": np.round(matrix, 6).tolist()} for change, matrix in unseen
    ]
    return result.assign_attrs(columns_unseen=json.dumps(told))


def _symmetric_checked(result: xr.Dataset, observed: Observed, telemetry: xr.Dataset) -> xr.Dataset:
    """The result with no pass unique whose panels read the same in a motion that is not listed: the file is equivalent to itself
    by a rotation or mirror of the body, as where the lit panels lie in a plane."""
    if not observed.panels or "noise" not in result.attrs:
        return result
    decided, unique, why = (
        result[name].values.copy() for name in ("decided", "unique", "why_not_decided")
    )
    why = why.astype(object)
    doubted, noise = 0, observed.vehicle.input_noise
    noise = result.attrs["noise"] if noise is None else noise
    for k in np.flatnonzero(unique & result["fits"].values):
        lit = Observed.of(observed.vehicle, _longest(result, telemetry, np.array([k]))).lit
        sun = result["sun_B"].values[result["pass_of"].values == k]
        seen = replace(observed, lit=lit, sun_B=sun)
        omega, sigma = (
            np.stack([result[f"{what}_{axis}"].values[k] for axis in "xyz"], axis=1)
            for what in ("omega", "sigma")
        )
        if _unlisted(seen, omega, sigma, noise):
            decided[k] = unique[k] = False
            doubted += 1
            why[k] = "; ".join(
                filter(None, (str(why[k]), "several motions: a symmetric one is not listed"))
            )
    flags = {name: ("pass_id", value) for name, value in (("decided", decided), ("unique", unique))}
    return result.assign(
        flags | {"why_not_decided": ("pass_id", why.astype(np.str_))}
    ).assign_attrs(symmetric_unlisted=doubted)


def _unlisted(seen: Observed, omega: np.ndarray, sigma: np.ndarray, noise: Any) -> bool:
    """Whether the first of some motions, of rates (K, 3) with sigmas (K, 3), rad/s, at one time, has a symmetric one that gives
    the same readings within their `noise` (W or A, or in gains) and is none of them."""
    power = seen.vehicle.response_in().power
    for m in equivalence(seen, AS_WRITTEN, AS_WRITTEN):
        listed = (np.abs(rate_under(m, omega[0]) - omega) < SAME_SIGMAS * sigma).all(
            axis=1
        )  # NaN: there is no such motion
        if (
            not listed.any()
            and (((power(seen.sun_B @ m.T) - power(seen.sun_B)) / noise) ** 2).sum() / 2 <= CLEARLY
        ):
            return True
    return False


def _suspicious(result: xr.Dataset, observed: Observed, telemetry: xr.Dataset) -> bool:
    """Whether a file of panels alone that fits may do so only because strong torques were allowed, or because gains were."""
    if not observed.panels or observed.sensors:
        return False
    return _strained(result) or implausible(
        observed.vehicle, _longest(result, telemetry, np.arange(result.sizes["pass_id"]))
    )


def _strained(result: xr.Dataset) -> bool:
    chosen = result.attrs["acceleration_noise_from"] != "given" and not result.attrs[
        "body"
    ].startswith("nearly a sphere")
    return chosen and result.attrs["acceleration_noise"] >= STRAINED


def _longest(result: xr.Dataset, telemetry: xr.Dataset, which: np.ndarray) -> xr.Dataset:
    """The samples used of the pass with the most of them, of some passes."""
    k = which[np.argmax(result["samples"].values[which])]
    times, first = np.unique(telemetry["time"].values, return_index=True)
    return telemetry.isel(
        time=first[np.isin(times, result["time"].values[result["pass_of"].values == k])]
    )


def _undecided(result: xr.Dataset, what: str) -> xr.Dataset:
    """The result with no pass decided, as `what` is in doubt, which is the same for the whole file."""
    why = ["; ".join(filter(None, (str(one), what))) for one in result["why_not_decided"].values]
    doubted = {
        name: ("pass_id", np.full(len(why), one))
        for name, one in (("decided", False), ("columns_checked", DOUBTFUL))
    }
    return result.assign(doubted | {"why_not_decided": ("pass_id", why)})


def _repeats_doubted(result: xr.Dataset, assessment: Assessment) -> xr.Dataset:
    """Return the result with no pass decided whose samples may be held values, too few different ones being left to tell."""
    repeats = assessment.repeats
    times = assessment.telemetry["time"].values[repeats.unsure]
    of = result["pass_of"].values[np.isin(result["time"].values, times)]
    unsure = np.isin(np.arange(result.sizes["pass_id"]), of)
    why = [
        "; ".join(filter(None, (str(one), repeats.doubt if doubted else "")))
        for one, doubted in zip(result["why_not_decided"].values, unsure, strict=True)
    ]
    return result.assign(
        decided=("pass_id", result["decided"].values & ~unsure), why_not_decided=("pass_id", why)
    )


def _begin(
    body: Body,
    passes: tuple[list[np.ndarray], list[np.ndarray]],
    effort: float,
    progress: bool | Callable[[str], None],
) -> None:
    """Load the compiled step of a body, once a function `progress` has been called with what is searched and how long that may
    take: an effort of one is about a minute and a half of one core. `passes`: samples of each, and those that the search keeps."""
    if callable(progress):
        most = 1.5 * allowed(effort) / USUAL * (1 + WIRING_SHARE)
        if np.isinf(most):
            long = "as long as it needs"
        else:
            long = f"up to {most:.2g} minutes of one core" if most > 0.02 else "a second"
        used, kept = (sum(map(len, each)) for each in passes)
        thinned = f", thinned to {kept} for the search" if kept < used else ""
        number = f"{len(passes[0])} pass{'es' if len(passes[0]) > 1 else ''}"
        progress(f"{used} samples used in {number}{thinned}; the search takes {long}")
    load(body)


def _judged(result: xr.Dataset, assessment: Assessment) -> xr.Dataset:
    """The result with its verdict. A gyro along other axes than stated looks like a late one: then these are named."""
    if result.attrs["sensors_late_from"] == SUSPECTED:
        if "columns_doubt" not in result.attrs and (axes := wrong_gyro_axes(assessment)):
            result = result.assign_attrs(columns_doubt=axes)
        if "columns_doubt" in result.attrs:
            result = result.assign_attrs(NOT_LATE)
    return with_units(result.assign_attrs(verdict=verdict(result)))


def _doubted(
    o: Observations, parts: list[np.ndarray], motion: Motion, rate_max: float, given: float | None
) -> tuple[np.ndarray, np.ndarray, float]:
    """Of which passes the search was coarse, which may not have met their motion, and up to which rate (rad/s) the search is fine
    in all of the coarse ones, NaN where there is none."""
    missed = np.array([coarse(o.take(part), motion, rate_max) for part in parts])
    fine = min(
        (finest(o.take(part)) for part, much in zip(parts, missed, strict=True) if much),
        default=np.nan,
    )
    return (
        missed,
        np.array([not_met(motion, given, float(np.diff(o.t_s[part]).min())) for part in parts]),
        fine,
    )


def not_met(motion: Motion, given: float | None, apart_s: float) -> bool:
    """Whether the search, which took a body of unknown inertia for a sphere, may not have met its motion: with moments as they may
    be, too, the data want torques as strong as hardly any satellite has, or that turn the body far between samples `apart_s` s
    apart, as a nutation does that was not seen."""
    far = motion.noise * np.sqrt(apart_s**3 / 3) > UNSEEN_RAD
    return given is None and bool(
        motion.body.spherical and (far or motion.noise >= HIGHER_NOISES[0])
    )


def _useful(
    workers: int,
    parts: list[np.ndarray],
    momenta: dict[str, np.ndarray],
    vehicle: Vehicle,
    torques: Sequence[object],
) -> int:
    """Processes of use, as the signs of wheels are asked in them; none where torques bring an environment: it stays in this one."""
    tasks = (
        max(len(parts), len(momenta), 2 * bool(vehicle.wheels))
        if may_fork()
        else len(parts) // PASSES_EACH
    )
    return 1 if torques else min(worker_count(workers), tasks)


def _evidences(
    spent: Effort, part: Effort, pool: Executor | None, tasks: Sequence[Task]
) -> list[np.ndarray]:
    """The evidence of noises of each task, each having an equal share of what is left of a part of the effort."""
    spent.doing("how strong torques are")
    found: list[np.ndarray] = []
    for (evidence, rough), cut in each(
        evidence_of_noises, tasks, max(part.left, 0.0) / len(tasks), part, pool
    ):
        spent.say(rough)
        part.cut |= cut
        found.append(evidence)
    return found


def _searched(
    o: Observations,
    parts: list[np.ndarray],
    motion: Motion,
    rate_max: float,
    spent: Effort,
    pool: Executor | None,
) -> tuple[list[tuple[Observations, Track]], list[bool]]:
    """The heavier modes of each pass, and whether its search was cut short. All may take an equal part of what is left; what some
    do not need goes to those that were cut, which begin anew if that is much more."""
    tasks = [(o.take(part), motion, rate_max) for part in parts]
    tracks: dict[int, Track] = {}
    cut, share = [True] * len(parts), -1.0
    while any(cut):
        left = min(SEARCH_SHARE * spent.most - spent.spent, spent.left)
        if (more := max(left, 0.0) / sum(cut)) <= MUCH_MORE * share:
            break
        share, to_do = more, [k for k, again in enumerate(cut) if again]
        for k, made in zip(
            to_do, each(leading, [tasks[k] for k in to_do], share, spent, pool), strict=True
        ):
            tracks[k], cut[k] = made
            spent.say(roughly(tasks[k][0], tracks[k]))
            spent.doing(f"pass {k + 1} of {len(parts)}")
    return [(part, tracks[k]) for k, (part, *_) in enumerate(tasks)], cut


def _all_finished(
    o: Observations,
    wholes: list[np.ndarray],
    parts: list[np.ndarray],
    tracks: list[tuple[Observations, Track]],
    motion: Motion,
    clock: Clock | None,
    rate_max: float,
    begin: float,
    spent: Effort,
    others: Others,
    pool: Executor | None,
) -> tuple[list[Pass], list[bool]]:
    """All passes `finished`, and where only some of the modes were, and no other model, the effort being spent."""
    found: list[Pass] = []
    fewer: list[bool] = []
    every = list(zip(wholes, parts, [track for _, track in tracks], strict=True))
    for start in range(0, len(every), ROUND):
        spent.doing(f"fit of pass {start + 1} of {len(every)}")
        less = not may_go_on()
        tasks = [
            (
                o,
                whole,
                part,
                track.take(slice(FEW_MODES)) if less else track,
                motion,
                clock,
                rate_max,
                begin,
                None if less else others,
            )
            for whole, part, track in every[start : start + ROUND]
        ]
        found += [made for made, _ in each(finished, tasks, spent.left, spent, pool)]
        fewer += [less] * len(tasks)
    spent.close()
    return found, fewer


def _linked(
    o: Observations, each: list[Pass], motion: Motion, periods: Sequence[Period], ids: Sequence[int]
) -> tuple[list[Pass], float | None, dict[str, str]]:
    """The passes with weights that count periods and neighbours in, the walk between them, and in JSON what periods decided."""
    if not periods:
        return *link(o, each, motion), {}
    each, said = weighted(o, each, motion, periods)
    return *link(o, each, motion), {
        "periods": json.dumps([{**one, "pass": int(ids[one["pass"]])} for one in said])
    }


Doubts = Callable[[Observations, list[tuple[np.ndarray, np.ndarray, Pass]], Anew], Reversed | None]
"""Of what is observed, the passes as :func:`doubted_signs` has them, and what they are estimated with: the wheels whose sign the
data doubt."""


def _signs(
    o: Observations,
    parts: list[np.ndarray],
    momenta: dict[tuple[int, ...], np.ndarray],
    noise: float,
    body: Body,
    rate_max: float,
    given: float | None,
    spent: Effort,
    pool: Executor | None,
) -> Doubts:
    """What tells the wheels whose sign the data doubt, as far as a share of the effort goes, once passes are found with the signs
    as stated. What does not hang on these other processes begin with now."""
    asked, most = tasks(o, parts, body, noise, given, rate_max, momenta), SIGN_SHARE * spent.most
    evidences = begun(evidence_of_noises, asked, most / max(len(asked), 1), pool)

    def doubted(
        o: Observations, passes: list[tuple[np.ndarray, np.ndarray, Pass]], anew: Anew
    ) -> Reversed | None:
        with Effort(most) as own:
            return doubted_signs(
                o, momenta, passes, noise, anew, [evidence for (evidence, _), _ in evidences(own)]
            )

    return doubted


def _wheel_doubted(
    result: xr.Dataset, turned: Reversed | None, observed: Observed, telemetry: xr.Dataset
) -> xr.Dataset:
    """The result with nothing decided where the sign of a wheel is in doubt. Unless another change fits, it is named with all
    changes that look the same. If it does not fit either, and all others were tried, no change is named."""
    if turned is None:
        return result
    result = _undecided(result, "the sign of a wheel")
    if "columns_doubt" in result.attrs:
        return result
    change = wheel_change(observed.vehicle, turned.wheels)
    if not turned.fits and "column_tests_cut" in result.attrs:
        return result.assign_attrs(
            columns_doubt=f"with {change.what} the data fit better (log evidence better by {turned.gain:.0f}), and still badly: no "
            "single change of columns or signs explains them"
        )
    others = [*column_changes(observed.vehicle, telemetry), *wheel_changes(observed.vehicle)]
    at = int(np.argmin(np.abs(turned.t_s - (turned.t_s[0] + turned.t_s[-1]) / 2)))
    omega = turned.omega[at]
    same = alike(
        replace(observed, sun_B=turned.sun_B),
        change,
        [one for one in others if one.what != change.what],
    )
    named = (Named(change, omega), *(Named(one, rate_under(m, omega)) for one, m in same))
    return _named(result, Better(named, turned.gain, float(turned.t_s[at]), turned.fits))


def _named(result: xr.Dataset, better: Better) -> xr.Dataset:
    """The result with the changes that fit better than the file as it is written: a sentence, and in JSON
    attrs["columns_changes"]."""
    epoch = result.attrs.get("epoch_utc")
    rates_deg_s = [
        None if one.omega is None else np.degrees(one.omega).round(6).tolist()
        for one in better.named
    ]
    told = [
        {"what": one.change.what, "do": one.change.do, "at_s": better.at_s, "omega_deg_s": rate}
        for one, rate in zip(better.named, rates_deg_s, strict=True)
    ]
    return result.assign_attrs(
        columns_doubt=better.words(partial(_clock_time, epoch)), columns_changes=json.dumps(told)
    )


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
        made = finished(
            one.o, np.arange(len(one.o)), one.kept, track, motion, clock, rate_max, begin
        )
        fits = all(misfit(left[0]).fits for left in made.residual.values())
        explained = not part.of_sun or made.track.cost[0] <= cost_limit(
            part
        )  # the limit is of passes that see the Sun
        return Fit(made.track.log_weight, bool(fits and explained))

    odd = odd_one(ranked([stated, *sensors_left_out(stated)], run))
    if odd is None:
        return {}
    return {
        "odd_sensor": f"{odd.hypothesis.what} the other readings fit: it does not see what they see"
    }


def _other_wiring(
    result, observed, telemetry, rate_max, environment, calibration, torques
) -> xr.Dataset:
    """The result with the changes that fit the longest pass that does not fit as stated, or the sensor that is in its way. If all
    fit, the longest: then a change must explain the samples far better, each by itself or with far weaker torques."""
    bad = np.flatnonzero(~result["fits"].values)
    part = _longest(result, telemetry, bad if len(bad) else np.arange(result.sizes["pass_id"]))
    calmer = not len(bad) and not implausible(observed.vehicle, part)
    most_noise = result.attrs["acceleration_noise"] / CALMER if calmer else np.inf
    source = None if result.attrs["source"] == "directions" else result.attrs["source"]
    vehicle = observed.vehicle
    here = _observed(
        vehicle, part, result.attrs["wheels"], result.attrs["source"], observed.in_orbit
    )
    setting: dict[str, Any] = {
        "source": source,
        "max_rate_rad_s": rate_max,
        "gap_s": np.inf,
        "environment": environment,
        "calibration": calibration,
    }

    def evidence(other: Vehicle, data: xr.Dataset) -> float:
        try:
            o, why, _ = observations(other, data, source)
            return quick_evidence(
                o,
                passes(o, why, np.inf)[0],
                Body.of(other, acting=acting(torques, environment)),
                rate_max,
            )
        except InputError:
            return -np.inf

    def run(other: Vehicle, data: xr.Dataset) -> xr.Dataset | None:
        try:
            made = rates(other, data, torques=torques, **setting)
        except InputError:
            return None
        return made if made.attrs["acceleration_noise"] <= most_noise else None

    found = better(vehicle, part, here, evidence, run, TURN_RATE)
    if found is None:
        return result
    if isinstance(found, Better):
        return _named(_undecided(result, "columns, signs or axes"), found)
    return result.assign_attrs(columns_doubt=found.words())


def _clock_time(epoch_utc: str | None, t_s: float) -> str:
    """Return a time (s) in words: the clock on the day of the epoch, date and clock on any other day."""
    if epoch_utc is None:
        return f"{t_s:.0f} s"
    text = utc_after(t_s, epoch_utc)
    return text[11:19] if text[:10] == utc_after(0.0, epoch_utc)[:10] else text


def _asked_for(pass_id: int | None, count: int) -> list[int]:
    """Which of so many passes are estimated."""
    if pass_id is None:
        return list(range(count))
    if (
        isinstance(pass_id, bool)
        or not isinstance(pass_id, int | np.integer)
        or not 0 <= pass_id < count
    ):
        raise InputError(
            "there is no such pass", got=pass_id, do=f"the file has passes 0 to {count - 1}"
        )
    return [int(pass_id)]


def _along_the_sun(environment: Environment | None) -> Environment | None:
    """The environment in axes whose z is the Sun's direction."""
    if isinstance(environment, Orbit):
        return SunAlongZ(environment)
    sun = SUN_N if environment is None else environment.at(0.0).sun_N[0]
    if np.linalg.norm(sun - SUN_N) > 1e-6:
        raise InputError(
            "rates needs an environment with z of its N to the Sun",
            got=f"the Sun at {np.round(sun, 3)}",
        )
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
        raise InputError(
            f"acceleration_noise must lie between {low:g} and {high:g} rad/s^1.5", got=given
        )
    return given


def _with_magnetic_torque(
    vehicle: Vehicle, o: Observations, noise: float
) -> tuple[Observations, tuple[MagneticTorque, ...]]:
    """What is observed, with an unknown magnetic torque where the file does not tell it; and that."""
    more = () if _torque_told(vehicle, o) else (MagneticTorque.beside(noise, o.freed().field_N),)
    return replace(o, terms=(*o.terms, *more)), more


def _torque_told(vehicle: Vehicle, o: Observations) -> bool:
    """Whether the vehicle file has a dipole, and the field that pulls at it is measured."""
    return vehicle.sensors.disturbance.dipole is not None and bool(
        np.isfinite(o.field_B).all(axis=1).any()
    )


def _clock(
    told: Lateness | None, tracks: list[tuple[Observations, Track]], motion: Motion
) -> tuple[Clock | None, dict[str, float | str]]:
    """The clock with which the passes are finished, narrowed by all of them, and what is said of it."""
    if told is None:
        late = suspected(tracks, motion)
        longest = max(float(np.ptp(o.t_s)) for o, _ in tracks)
        if (
            late is None or abs(late.late_s) > MOST_LATE * longest
        ):  # it stands for a motion that does not fit
            return None, NOT_LATE
        return None, {
            "sensors_late_s": late.late_s,
            "sensors_late_sigma_s": late.sigma_s,
            "sensors_late_from": SUSPECTED,
        }
    clock = Clock(told.late_s, told.sigma_s)
    late = lateness(tracks, motion, clock) if told.sigma_s > 0 else None
    if late is not None:
        clock = Clock(late.late_s, late.sigma_s)
    words = "vehicle file" if late is None else "vehicle file and data"
    return clock, {
        "sensors_late_s": clock.late_s,
        "sensors_late_sigma_s": clock.sigma_s,
        "sensors_late_from": words,
    }


def _rate_max(given: float | None, o: Observations, parts: list[np.ndarray]) -> float:
    if given is not None:
        if not (np.isfinite(given) and given > 0):
            raise InputError("max_rate_rad_s must be positive", got=given)
        return float(given)
    usual = float(
        np.median(
            [np.sort(np.diff(o.t_s[part]))[: max(2, len(part) // 8)].mean() for part in parts]
        )
    )
    return min(1.5 * 2 * np.pi / usual, DEFAULT_MAX_RATE)
