"""Body rates and attitude from what the Sun lights and what a gyro reads, sample by sample."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import repeat

import numpy as np
import xarray as xr
from tqdm import tqdm

from sunspin.base.errors import InputError
from sunspin.base.provenance import with_units
from sunspin.compute.pool import process_pool, worker_count
from sunspin.dynamics.step import load as load_step
from sunspin.dynamics.torques import acting
from sunspin.environment import Environment
from sunspin.environment.orbit import Orbit, SunAlongZ
from sunspin.estimation.alternatives import alternatives
from sunspin.estimation.between import link_passes
from sunspin.estimation.budget import USUAL, Budget
from sunspin.estimation.carry import nutation, require_followed
from sunspin.estimation.chain import Chain, Fit
from sunspin.estimation.columns import check_columns, name_of_wheels
from sunspin.estimation.evidence import (
    PassFits,
    ladder,
    leading,
    likeliest,
    likeliest_cost,
    restated,
    share_noise,
    united,
)
from sunspin.estimation.field_led import begun, field_of, in_axes_of, searched
from sunspin.estimation.images import images_of, with_images
from sunspin.estimation.model import (
    AS_STATED,
    SUN_N,
    Body,
    Model,
    Noise,
    Observations,
    Track,
)
from sunspin.estimation.observe import (
    FileReadings,
    Pass,
    asked,
    observe,
    split,
    wheel_models,
    why_not_used,
    with_momentum,
)
from sunspin.estimation.orbit.calibration import along_orbit
from sunspin.estimation.periods import PeriodSeen, weigh_by_periods, without_periods
from sunspin.estimation.rates_dataset import (
    believed,
    dataset,
    in_space,
    latency_attributes,
    repeats_doubted,
)
from sunspin.estimation.search import search
from sunspin.estimation.settings import (
    LARGEST_RATE,
    LARGEST_TURNS,
    RATES,
    RatesSettings,
    SearchSettings,
)
from sunspin.estimation.solutions import Solutions, solutions
from sunspin.estimation.starts import (
    allowed_directions,
    fine_up_to,
    pair_starts,
    pairs_to_try,
    relatives,
)
from sunspin.estimation.swings import swings_by_all_ways
from sunspin.estimation.terms.field import FieldCalibration
from sunspin.estimation.terms.panels import Panels
from sunspin.estimation.verdict import count_of_passes, more_effort, rates_words, slower
from sunspin.estimation.wheel_signs import (
    Reversed,
    doubted_signs,
    log_evidence,
    momentum_of_each,
    reversed_momenta,
)
from sunspin.telemetry.assess import Assessment, assess
from sunspin.vehicle import Vehicle

NOISE_RANGE = (1e-9, 1.0)
"""rad/s^1.5; the smallest lets a rate wander by 2e-5 deg/s in a day, the largest by a turn in 20 s: no satellite is outside."""

ALONG_Z = 1e-6
"""The Sun of an environment is off z by less than this."""

LONGEST_PASSES = 2
"""Passes, those with the most samples, that say what the wheels do."""

WIDE_RAD = 1.0
"""A sample that allows directions to the Sun so far apart leaves its direction open."""

UNSEEN_RAD = 0.05
"""Torques that turn a body by more between the closest two samples may stand for a nutation, its moments being unknown."""


class PassBar(tqdm):
    """A progress bar without a thread that watches it: a process with a second thread is not copied for workers."""

    monitor_interval = 0


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
    periods: Sequence[PeriodSeen] = (),
    column_tests: bool = False,
    effort: float = 1.0,
    workers: int = 1,
    progress: bool | Callable[[str], None] = False,
    settings: RatesSettings = RATES,
) -> xr.Dataset:
    """Estimate body rates and attitude of every pass of a telemetry file: all solutions that the data cannot tell apart.

    Every turn, and every number of turns up to the largest rate, that takes the Sun from one sample to the next is a start; starts
    grow over the pass and are fitted with the equations of motion, under torques of every strength.

    Parameters
    ----------
    telemetry : Dataset of `read_telemetry` or its Assessment, or Dataset of `sun_directions`
        A gyro, magnetometer or attitude sensor in it is used if the vehicle describes one.
    source : {"panels", "sun_sensor", "directions"}, optional
        Where the Sun comes from; default: what the telemetry has.
    max_rate_rad_s : float, optional
        No rate is faster; default: the vehicle's, else one and a half turns in the shorter intervals, at most 1 rad/s.
    acceleration_noise : float, optional
        Strength of unknown torques, rad/s^1.5; default: the vehicle's, else every strength is tried.
    gap_s : float, optional
        A longer gap parts two passes; default: six usual intervals.
    pass_id : int, optional
        Only this pass, counted from zero as in the result; default: all.
    environment : Environment, optional
        What surrounds the body, on the telemetry's clock: an orbit (:func:`sunspin.environment.orbit.in_orbit`), or with z of its N
        to the Sun (:func:`sunspin.environment.circular`). In an orbit field, shadow and Earth's light are known: a calibrated
        magnetometer gives directions, and samples without a Sun count. The orbit is believed.
    calibration : FieldCalibration, optional
        Of the magnetometer along the orbit, by a longer file for example; default: by this telemetry.
    torques : list, optional
        Torques that act on the body, by name (`sunspin.dynamics.torques.TORQUES`).
    periods : list of Period, optional
        Periods seen from outside, of the precession, the spin or their sum: the solutions are weighted by them
        (:mod:`sunspin.estimation.periods`). `probability_without_periods (pass_id, solution)` has the probabilities without, and
        attrs["periods"], in JSON, what each decided.
    column_tests : bool
        If a pass does not fit, try other columns, axes and signs of panels and sensors on the one with the most samples
        (:mod:`sunspin.estimation.column_tests`), and name what fits; this takes up to minutes. So too if panels alone fit under
        strong torques, or if their samples, each by itself, fit other columns far better, or as well.
    effort : float
        How much may be computed; one is usual. If it does not suffice the best so far is kept, and the pass is not decided.
    workers : int
        Processes that estimate passes side by side; the result does not depend on it. A script that asks for more than one needs
        `if __name__ == "__main__":`.
    progress : bool, or a function of a line
        Show a progress bar of passes; a function is called once, when the inputs are accepted and the search begins.
    settings : RatesSettings
        What tunes the estimate.

    Returns
    -------
    xarray.Dataset
        On `time` (all samples used) of each pass's best solution: `omega_B` (rad/s), `omega_cov_B`, `sun_B`, `sun_sigma_rad`,
        `B_from_N` (quaternion, scalar last; N is local to the pass, z to the Sun, the turn about z arbitrary; in an orbit with a
        magnetometer J2000), `turn_sigma_rad` (of the turn about the Sun, in an orbit), `pass_of`. On
        `curve_time` the same between the samples. On `pass_id` and `solution`: probabilities, mean rates, and what may be believed:
        the variables of `passes.csv`. On `sample`: `why`, what became of each sample of the file. attrs: `verdict`, the settings.

    Raises
    ------
    InputError
        Too few samples, no rate below the largest fits, or a period was seen at a time of no pass.
    MotionError
        A torque without the environment that it needs.
    """
    assessment = assess(vehicle, telemetry)
    local = along_the_sun(environment)  # axes N with z to the Sun
    calibration = along_orbit(local, assessment) if calibration is None else calibration
    seen = observe(
        assessment, source, local, calibration, acting(torques, local)
    )  # all samples, and why each is used or not
    every = split(seen, gap_s, settings.passes)
    chosen = asked(every, pass_id)
    passes = [every[k] for k in chosen]
    why = why_not_used(seen, every, chosen)
    noise = stated_noise(vehicle, acceleration_noise, seen.dipole_modelled)
    # the same estimate of another vehicle or another file, as one pass: to try other columns
    again = partial(
        rates,
        source=None if seen.source == "directions" else seen.source,
        max_rate_rad_s=largest_rate(vehicle, max_rate_rad_s, seen.obs.t_s, passes),
        gap_s=np.inf,
        environment=environment,
        calibration=calibration,
        torques=torques,
        effort=effort,
        settings=settings,
    )
    if noise is not None:  # a stated strength is a ladder of one rung
        settings = replace(settings, ladder=replace(settings.ladder, rungs=(noise,)))
    body = Body.of(vehicle, torques_stated=noise is not None)
    rate_max = largest_rate(vehicle, max_rate_rad_s, seen.obs.t_s, passes)
    stated = Model(seen.obs, body, Noise(settings.search.noise), rate_max / 2)
    budget = Budget.of(effort)
    if callable(progress):
        progress(_said_before(passes))

    require_directions(stated, passes)
    tasks = max(len(passes), len(wheel_models(vehicle, assessment.telemetry)))
    if (processes := min(worker_count(workers), tasks)) > 1:
        load_step()
    with process_pool(processes) as pool:
        run = map if pool is None else pool.map
        # Wheels without a measured speed are held or coast: the longest passes say which.
        seen, wheels, done = decide_wheels(assessment, seen, stated, passes, settings, budget, run)
        stated = replace(stated, obs=seen.obs)
        # all samples of each pass, and the models of those that the search keeps
        whole = [stated.obs.of_pass(one.samples) for one in passes]
        models = [
            replace(stated, obs=obs.take(one.kept_in_pass))
            for obs, one in zip(whole, passes, strict=True)
        ]
        open_still = [k for k in range(len(passes)) if k not in done]
        fitted = run(one_pass, [models[k] for k in open_still], repeat(settings), repeat(budget))
        if progress is True:
            fitted = PassBar(fitted, "rates", len(open_still), leave=False, unit="pass")
        done |= dict(zip(open_still, fitted, strict=True))
        fits = [done[k] for k in range(len(passes))]
        doubt = doubted_wheels(
            assessment, seen, wheels, passes, models, fits, settings, budget, run
        )

    # Passes help each other: the same torques act in all of them, and from one to the next a rate changes only so much.
    fits = share_noise(fits, settings.ladder)
    solved = [
        solutions(one, obs, p.kept_in_pass, settings.solutions, settings.search)
        for one, obs, p in zip(fits, whole, passes, strict=True)
    ]
    solved, of_periods = weigh_by_periods(solved, stated.body, periods, chosen)
    middles = [float(seen.obs.t_s[p.samples].mean()) for p in passes]
    solved, walk = link_passes(solved, middles, stated.rate_sigma)
    solved = [
        one.listed(settings.solutions, len(images_of(model)))
        for one, model in zip(solved, models, strict=True)
    ]

    stated = stated.under(common_noise(fits))
    result = dataset(assessment, seen, why, passes, solved, stated, noise is not None)
    result = result.assign_coords(pass_id=chosen)
    doubts, coarse = doubts_of(result, models, fits, solved, noise is None, effort, settings)
    epoch = assessment.telemetry.attrs.get("epoch_utc")
    result = result.assign(believed(passes, solved, doubts, stated.rate_sigma, epoch))
    result = result.assign(without_periods(solved))
    result = in_space(repeats_doubted(result, assessment), local, solved, seen)
    result = result.assign_attrs(
        latency_attributes(vehicle, solved)
        | coarse
        | of_periods
        | {
            "wheels": wheels,
            "walk_between_passes": walk,
            "effort": float(sum(one.used for one in fits)) / (USUAL * len(fits)),
            "samples_searched": sum(len(p.kept) for p in passes),
            "symmetric_unlisted": 0,
        }
    )
    tested = again if column_tests else None
    result = check_columns(
        result, assessment, doubt, tested, isinstance(local, SunAlongZ), settings, budget
    )
    return with_units(result.assign_attrs(verdict=rates_words(result)))


def one_pass(
    stated: Model, settings: RatesSettings, budget: Budget, known: Track | None = None
) -> PassFits:
    """Return every motion of one pass under every model that may explain it, with evidence.

    `stated`: the nominal model of the samples kept for the search. `known`: motions that a search of the pass leaves under a model
    that hardly differs.
    """
    s = settings
    budget = replace(budget)  # passes work side by side, each with its own

    def fits_under(noise: float) -> list[Fit]:
        """Return fits on all rungs of the motions that a search under unknown torques of this strength leaves."""
        motions = []
        # axes that follow the field turn: a motion that misses the limit there is no reason to begin elsewhere too
        led = field_of(stated) is not None
        of_search = replace(s.search, more_places=0) if led else s.search
        search_again = known is None or noise != s.search.noise
        if known is not None and not search_again:
            motions.append(known)
        for loose in searched(stated, Noise(noise)) if search_again else ():
            chain, starts = Chain(loose, s.search), pair_starts(loose, s.search)
            one = search(chain, starts, of_search, budget, pairs_to_try(loose, s.search))
            motions.append(in_axes_of(stated, loose, no_faster(loose, one, s.search), s.search))
        fits = []
        for one in motions:
            begin = begun(stated.under(noise), with_images(one, stated, s.search))
            fits += ladder(stated, begin, s.ladder, s.search, noise)
        return united(fits, s.ladder, s.search)

    fits = fits_under(s.search.noise)
    limit = stated.obs.cost_limit
    # An inertia that is wrong looks like torques: if no motion fits, search as if strong ones acted. Asked of the most probable
    # motion, as under the strongest torques nearly everything fits.
    if len(stated.body.errors) and likeliest_cost(fits) > limit:
        fits = min(fits, fits_under(s.ladder.strong), key=likeliest_cost)
    if not any(len(one) for one in fits):
        raise InputError(
            "no motion has a well-defined probability",
            got=f"{len(stated.obs)} samples in the pass from {stated.obs.t_s[0]:.0f} s",
            do="add samples, or check their errors",
        )

    # Motions that a search with the inertia held fast may lose: whole turns more or less, and bodies of another shape.
    begin = leading(fits, s.alternatives.relatives_of, s.search)
    others = relatives(begin, stated, s.alternatives)
    budget.spend(len(others) * len(stated.obs))
    fits += ladder(stated, others, s.ladder, s.search, s.ladder.strong)
    fits = united(fits, s.ladder, s.search)

    # What else may have moved the body.
    shorter = replace(s.ladder, hopeless=s.alternatives.hopeless)
    # The generator sees `fits` grow: a second step of the rate is added to the first.
    for model in alternatives(stated, fits, s.alternatives):
        if budget.exhausted():
            break
        best = likeliest(fits)
        begin = leading(fits, s.alternatives.begin_with, s.search)
        nominal = likeliest([one for one in fits if one.model.what == AS_STATED])
        # under the torques that the nominal model wants an alternative can grow; a stated strength may be too stiff for that
        rung = nominal.model.noise.acceleration
        rung = rung if len(s.ladder.rungs) > 1 else max(rung, s.search.noise)
        top = float(best.log_evidence.max())
        begin = restated(begin, nominal.model, model.under(rung))
        more = ladder(model, begin, shorter, s.search, rung, top)
        budget.spend(sum(len(one) for one in more) * len(stated.obs))
        fits += [one for one in more if one.log_evidence.max() > top - shorter.hopeless]
    if sees_sun_alone(stated.obs) and likeliest_cost(fits) <= limit and len(s.ladder.rungs) > 1:
        # a stated strength of torques says that the body does not swing
        fits += swings_by_all_ways(stated, fits, s.alternatives, s.ladder)
    even = np.full(len(s.ladder.rungs), -np.log(len(s.ladder.rungs)))
    return PassFits(stated, tuple(fits), s.ladder.rungs, even, budget.used, budget.cut)


def no_faster(model: Model, motions: Track, s: SearchSettings) -> Track:
    """Return motions without those that turn faster than the largest rate in the mean, if one that does not fits.

    A start at the largest rate may end beyond it: at even samples in an alias that no reading rules out.
    """
    speed = np.linalg.norm(motions.omega, axis=2).mean(axis=1)
    slow = np.flatnonzero(speed <= model.rate_max)
    fits = motions.cost[slow].min(initial=np.inf) < s.good_enough * model.obs.cost_limit
    return motions.take(slow) if fits else motions


def sees_sun_alone(obs: Observations) -> bool:
    """Return whether no sensor but the Sun's reads anything."""
    return not any(term.present().any() for term in obs.terms if not term.of_sun)


def decide_wheels(
    assessment: Assessment,
    seen: FileReadings,
    stated: Model,
    passes: Sequence[Pass],
    settings: RatesSettings,
    budget: Budget,
    run: Callable,
) -> tuple[FileReadings, str, dict[int, PassFits]]:
    """Return what is seen with the momentum of the wheels, what they do, in words, and the passes that are fitted with that.

    If several things are possible, the one under which the longest passes have the largest evidence.
    """
    momenta = wheel_models(assessment.vehicle, assessment.telemetry)
    names = list(momenta)
    for one in passes:
        longest_s = float(np.diff(seen.obs.t_s[one.kept]).max())
        for momentum in momenta.values():
            require_followed(stated.body.inertia, momentum[one.kept], longest_s)
    if len(names) == 1:
        return with_momentum(seen, momenta[names[0]]), names[0], {}
    longest = sorted(range(len(passes)), key=lambda k: -len(passes[k].samples))[:LONGEST_PASSES]
    models = {
        name: [
            replace(
                stated,
                obs=with_momentum(seen, momenta[name])
                .obs.of_pass(passes[k].samples)
                .take(passes[k].kept_in_pass),
            )
            for k in longest
        ]
        for name in names
    }
    # Wheels that turn the body nearly alike have the same motions: one search serves them. The others are searched side by side.
    near = [name for name in names[1:] if _turn_alike(models[names[0]], models[name], settings)]
    alone = [name for name in names if name not in near]
    fitted = _fits_of_models(models, alone, [None] * len(longest), settings, budget, run)
    motions = [
        None if one is None else leading(one.fits, settings.search.most, settings.search)
        for one in fitted[names[0]]
    ]
    known = [one if one is not None and len(one) else None for one in motions]
    fitted |= _fits_of_models(models, near, known, settings, budget, run)
    total = {
        name: sum(-np.inf if one is None else log_evidence(one) for one in fitted[name])
        for name in names
    }
    if not np.isfinite(
        [log_evidence(one) for each in fitted.values() for one in each if one]
    ).any():
        one_pass(models[names[0]][0], settings, budget)  # raises an error that says why
    best = max(names, key=lambda name: total[name])
    above = total[best] - max(total[name] for name in names if name != best)
    words = f"{best} (evidence {above:.1f} above any other)"
    done = {k: one for k, one in zip(longest, fitted[best], strict=True) if one is not None}
    return with_momentum(seen, momenta[best]), words, done


def _turn_alike(first: Sequence[Model], second: Sequence[Model], settings: RatesSettings) -> bool:
    """Return whether wheels turn the rate alike in each of some passes: no motion leaves the basin in which a fit finds it.

    `first`, `second`: the models of each pass. The angle counts from the median sample: motions agree there and differ at the ends.
    """
    turned = []
    for one, other in zip(first, second, strict=True):
        rate = nutation(one.body.inertia, other.obs.momentum - one.obs.momentum)
        middle = len(rate) // 2
        halves = slice(middle + 1), slice(middle, None)
        turned += [float(np.trapezoid(rate[half], one.obs.t_s[half])) for half in halves]
    return max(turned) < settings.search.basin_rad


def _fits_of_models(
    models: dict[str, list[Model]],
    names: Sequence[str],
    known: Sequence[Track | None],
    settings: RatesSettings,
    budget: Budget,
    run: Callable,
) -> dict[str, list[PassFits | None]]:
    """Return the fits of passes under some of the models of their wheels; `known`: motions of each pass, instead of a search."""
    every = [model for name in names for model in models[name]]
    shared = [
        None if one is None else Track.free(one.attitude, one.omega)
        for one in [*known] * len(names)
    ]
    fits = list(run(_pass_if_any, every, repeat(settings), repeat(budget), shared))
    count = len(known)
    return {name: fits[i * count : (i + 1) * count] for i, name in enumerate(names)}


def doubted_wheels(
    assessment: Assessment,
    seen: FileReadings,
    wheels: str,
    passes: Sequence[Pass],
    models: Sequence[Model],
    fits: Sequence[PassFits],
    settings: RatesSettings,
    budget: Budget,
    run: Callable,
) -> Reversed | None:
    """Return the wheels that may turn the other way, by the longest passes; `wheels`: what they do, in words."""
    vehicle, telemetry = assessment.vehicle, assessment.telemetry
    each = momentum_of_each(vehicle, telemetry, name_of_wheels(wheels))
    momenta = reversed_momenta(vehicle, each, models[0].body.inertia, seen.obs.t_s)
    longest = sorted(range(len(passes)), key=lambda k: -len(passes[k].samples))[:LONGEST_PASSES]
    return doubted_signs(
        seen.obs,
        momenta,
        [passes[k] for k in longest],
        [models[k] for k in longest],
        [fits[k] for k in longest],
        lambda turned: list(run(_pass_if_any, turned, repeat(settings), repeat(budget))),
        settings,
        budget,
    )


def _pass_if_any(
    stated: Model, settings: RatesSettings, budget: Budget, known: Track | None = None
) -> PassFits | None:
    """Return the fits of a pass as :func:`one_pass` does; None if the model allows no motion at all."""
    try:
        return one_pass(stated, settings, budget, known)
    except InputError:
        return None


def require_directions(stated: Model, passes: Sequence[Pass]) -> None:
    """Raise `InputError` if rows hold readings of some panels only, and no two neighbours determine the direction of the Sun.

    `stated`: the nominal model of the whole file. Other sensors may do without directions.
    """
    panels = [term for term in stated.obs.terms if isinstance(term, Panels)]
    if not panels or not sees_sun_alone(stated.obs):
        return
    read = int(np.isfinite(panels[0].sigma).sum(axis=1).max())
    count = panels[0].sigma.shape[1] - len(panels[0].left_out)
    if read >= count:
        return
    for one in passes:
        of_pass = replace(stated, obs=stated.obs.of_pass(one.kept))
        model = of_pass.for_search(stated.noise)[0]
        # whether the direction of the Sun is known at a sample, and was at the one before
        known = False
        for sample in range(len(one.kept)):
            allowed = allowed_directions(model, sample)
            before, known = known, bool((allowed @ allowed.T).min() > np.cos(WIDE_RAD))
            if before and known:
                return
    raise InputError(
        "too few Sun directions to estimate a rate",
        got=f"rows with readings of {read} of {count} panels at most",
        do="set sample_span_s under [telemetry] to the time in which all are read",
    )


def along_the_sun(environment: Environment | None) -> Environment | None:
    """Return the environment in axes whose z is the direction to the Sun."""
    if isinstance(environment, Orbit):
        return SunAlongZ(environment)
    if environment is not None and not isinstance(environment, SunAlongZ):
        sun = environment.at(0.0).sun_N[0]
        if np.linalg.norm(sun - SUN_N) > ALONG_Z:
            raise InputError(
                "rates needs an environment with z of its N to the Sun",
                got=f"the Sun at {np.round(sun, 3)}",
            )
    return environment


def stated_noise(
    vehicle: Vehicle, given: float | None, dipole_modelled: bool = False
) -> float | None:
    """Return the strength of unknown torques (rad/s^1.5) that is given, else the vehicle's; None if neither states it.

    The torque of a magnetic dipole is modelled only in a measured field: else the vehicle file has another strength.
    """
    disturbance = vehicle.sensors.disturbance
    stated = (
        disturbance.acceleration_noise
        if disturbance.dipole is None or dipole_modelled
        else disturbance.noise_without_field
    )
    noise = stated if given is None else given
    low, high = NOISE_RANGE
    if noise is not None and not low <= noise <= high:
        raise InputError(
            f"acceleration_noise must lie between {low:g} and {high:g} rad/s^1.5", got=noise
        )
    return noise


def largest_rate(
    vehicle: Vehicle, given: float | None, t_s: np.ndarray, passes: Sequence[Pass]
) -> float:
    """Return the largest rate (rad/s) of the search: as given, else the vehicle's, else by the shorter intervals."""
    given = vehicle.sensors.disturbance.max_rate_rad_s if given is None else given
    if given is not None:
        if not (np.isfinite(given) and given > 0):
            raise InputError("max_rate_rad_s must be positive", got=given)
        return float(given)
    shorter = [
        np.sort(np.diff(t_s[one.kept]))[: max(2, len(one.kept) // 8)].mean() for one in passes
    ]
    return min(LARGEST_TURNS * 2 * np.pi / float(np.median(shorter)), LARGEST_RATE)


def common_noise(fits: Sequence[PassFits]) -> float:
    """Return the most probable strength of unknown torques (rad/s^1.5) if it is the same in all passes."""
    total = np.sum([one.log_evidence_of_rungs() for one in fits], axis=0)
    if not np.isfinite(total).any():  # no rung was hopeful in all passes
        total = np.sum([np.maximum(one.log_evidence_of_rungs(), -1e6) for one in fits], axis=0)
    return fits[0].rungs[int(np.argmax(total))]


def doubts_of(
    result: xr.Dataset,
    models: Sequence[Model],
    fits: Sequence[PassFits],
    solved: Sequence[Solutions],
    noise_free: bool,
    effort: float,
    settings: RatesSettings,
) -> tuple[list[str], dict[str, float]]:
    """Return what the search of each pass may have left out and what would help, in words; and attributes that count such passes.

    The search was cut short; its starts were too coarse for the largest rate; the speed of a wheel is unknown. Or it took a body
    without an inertia for a sphere, but the data want torques that hardly any satellite has. Torques that turn the body far between
    two samples are doubted too, as a nutation does that.
    """
    fine = [fine_up_to(model, settings.search) for model in models]
    no_sphere = []
    for model, one in zip(models, solved, strict=True):
        shortest = float(np.diff(model.obs.t_s).min())
        # what torques turn a body over the shortest interval T: noise T^1.5 / sqrt(3)
        far = one.noise[0] * np.sqrt(shortest**3 / 3) > UNSEEN_RAD
        strong = one.noise[0] >= settings.ladder.strong
        no_sphere.append(bool(noise_free and model.body.sphere and (far or strong)))
    wheels = result.attrs["wheels_untold"]
    cures = [
        {
            f"budget reached: {more_effort(effort)}": one.cut,
            f"coarse: {slower(limit)}" if np.isfinite(limit) else "": np.isfinite(limit),
            "torques too strong for a satellite, or the body is no sphere: give its inertia": odd,
            f"the speed of wheel {wheels} is unknown: give speed_rad_s or a speed_column": wheels,
        }
        for one, limit, odd in zip(fits, fine, no_sphere, strict=True)
    ]
    words = ["; ".join(what for what, so in one.items() if so) for one in cures]
    coarse = [limit for limit in fine if np.isfinite(limit)]
    return words, {
        "effort_given": effort,
        "fine_up_to_rad_s": min(coarse, default=np.nan),
        "coarse_passes": len(coarse),
        "cut_passes": sum(one.cut for one in fits),
        "no_sphere": sum(no_sphere),
    }


def _said_before(passes: Sequence[Pass]) -> str:
    """Return what is searched, in words."""
    used, kept = (sum(len(getattr(one, name)) for one in passes) for name in ("samples", "kept"))
    thinned = f", thinned to {kept} for the search" if kept < used else ""
    return f"{used} samples used in {count_of_passes(len(passes))}{thinned}"
