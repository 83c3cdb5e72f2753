"""Body rates and attitude from telemetry of panels, Sun sensors, gyro and magnetometer: the whole estimate, pass by pass."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.special import logsumexp
from tqdm import tqdm

from sunspin.base.errors import InputError
from sunspin.base.provenance import with_units
from sunspin.compute.pool import process_pool, worker_count
from sunspin.dynamics.step import load as load_step
from sunspin.dynamics.torques import acting
from sunspin.environment import Environment
from sunspin.environment.orbit import Orbit, SunAlongZ
from sunspin.estimate.between import link_passes, momentum_sizes
from sunspin.estimate.budget import USUAL, Budget
from sunspin.estimate.changed_wheel import changed_wheel
from sunspin.estimate.columns import check_columns, cost_of_silent_panels
from sunspin.estimate.equivalence import CLEARLY, wheel_changes
from sunspin.estimate.evidence import PassFits, best_fit, share_noise
from sunspin.estimate.images import images_of
from sunspin.estimate.model import SUN_N, Body, Model, Noise
from sunspin.estimate.observe import (
    MEASURED,
    Pass,
    longest_passes,
    observe,
    select_passes,
    split_passes,
    wheel_models,
    with_unused_samples,
)
from sunspin.estimate.one_pass import PassFitter
from sunspin.estimate.orbit.calibration import FieldCalibration, calibrate_magnetometer
from sunspin.estimate.other_passes import fit_from_other_passes
from sunspin.estimate.periods import PeriodSeen, weigh_by_periods, without_periods
from sunspin.estimate.quick import sum_of_log_sigmas
from sunspin.estimate.rates_dataset import (
    latency_attributes,
    motion_dataset,
    verdict_variables,
    with_doubted_passes,
    with_doubted_repeats,
    with_space_axes,
)
from sunspin.estimate.settings import LARGEST_RATE, LARGEST_TURNS, RATES, RatesSettings
from sunspin.estimate.solutions import Solutions, solutions
from sunspin.estimate.starts import allowed_directions, fine_up_to
from sunspin.estimate.terms.panels import Panels
from sunspin.estimate.verdict import (
    WHEEL_CHANGES,
    WHEEL_LACKS,
    advise_lower_limit,
    count_of_passes,
    more_effort,
    rates_words,
)
from sunspin.estimate.wheels import (
    Reversed,
    decide_wheels,
    doubted_signs,
    search_reversed,
)
from sunspin.telemetry.assess import Assessment, assess
from sunspin.vehicle import Vehicle

NOISE_RANGE = (1e-9, 1.0)
"""Accepted strengths of unknown torques, rad/s^1.5: from 2e-5 deg/s in a day to a revolution in 20 s."""

OFF_Z = 1e-6
"""The Sun of an environment may be off the z axis by this, as a vector."""

WIDE_RAD = 1.0
"""A sample determines the direction to the Sun if all directions that it allows are nearer to each other than this."""

NUTATION_RAD = 0.05
"""If the torques turn a body of unknown inertia by more between the closest two samples, they may stand for a nutation."""

WHEEL_STRENGTH = 2e-3
"""Strength of the torques, rad/s^1.5, from which a wheel may turn that the file does not state. Of six bodies with several thrusts
two had 1e-3, and were right; 2 of 3 passes that were wrong as the file lacks a wheel had 3e-3."""


class PassBar(tqdm):
    """A progress bar without a monitoring thread: a process with a second thread cannot safely be copied for workers."""

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
    column_tests: bool = True,
    effort: float = 1.0,
    workers: int = 1,
    progress: bool | Callable[[str], None] = False,
    settings: RatesSettings = RATES,
) -> xr.Dataset:
    """Estimate body rates and attitude of every pass of a telemetry file: all solutions that the data cannot tell apart.

    The search starts with all rotations up to the largest rate that take the Sun from one sample to the next. The motions that fit
    the whole pass are fitted with the equations of motion, under unknown torques of every strength.

    Parameters
    ----------
    telemetry : Dataset of `read_telemetry` or its Assessment, or Dataset of `sun_directions`
        A gyro, magnetometer or attitude sensor in it is used if the vehicle describes one.
    source : {"panels", "sun_sensor", "directions"}, optional
        Where the Sun comes from; default: what the telemetry has.
    max_rate_rad_s : float, optional
        Largest rate; default: the vehicle's, else one and a half turns in the shorter intervals, at most 1 rad/s. If neither
        states it, no inertia is known and only the Sun is measured, a fast body is searched up to twice that.
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
        (:mod:`sunspin.estimate.periods`). `probability_without_periods (pass_id, solution)` has the probabilities without, and
        attrs["periods"], in JSON, what each decided.
    column_tests : bool
        If a pass does not fit, try other columns, axes and signs of panels and sensors on the one with the most samples
        (:mod:`sunspin.estimate.column_tests`), and name what fits; this takes up to minutes. So too if panels alone fit, but their
        samples, each by itself, fit other columns far better, or as well. Without these tests a pass whose columns are exchanged
        may be decided: switch them off only if the columns are known to be right.
    effort : float
        Computing budget of each pass; one is usual. If it does not suffice the best so far is kept, and the pass is not decided.
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
        magnetometer J2000), `turn_sigma_rad` (of the turn about the Sun, in an orbit), `pass_of`. On `curve_time` the same between
        the samples. On `pass_id` and `solution`: probabilities, mean rates and the checks, as in `passes.csv`. On `sample`: `why`,
        whether each sample of the file was used. attrs: `verdict`, the settings.

    Raises
    ------
    InputError
        Too few samples, no rate below the largest fits, or a period was seen at a time of no pass.
    MotionError
        A torque without the environment that it needs.
    """
    # the readings of all samples, why each is used or not, and the passes that they form
    assessment = assess(vehicle, telemetry)
    local = along_the_sun(environment)  # axes N with z to the Sun
    calibration = calibrate_magnetometer(local, assessment) if calibration is None else calibration
    readings = observe(assessment, source, local, calibration, acting(torques, local))
    every_pass = split_passes(readings, gap_s, settings.passes)
    passes = select_passes(every_pass, pass_id)
    readings = with_unused_samples(readings, every_pass, passes)
    kept = sum(len(a_pass.kept) for a_pass in passes)

    # the same estimate for another vehicle or another file, as one pass: to try other columns
    estimate_again = partial(
        rates,
        source=None if readings.source == "directions" else readings.source,
        max_rate_rad_s=max_rate_rad_s,
        acceleration_noise=acceleration_noise,
        gap_s=np.inf,
        column_tests=False,
        environment=environment,
        calibration=calibration,
        torques=torques,
        effort=effort,
        settings=settings,
    )

    # what is known before the data: the nominal model of the whole file
    noise = stated_noise(vehicle, acceleration_noise, readings.dipole_modelled)
    rate_max, beyond = largest_rate(vehicle, max_rate_rad_s, readings.obs.t_s, passes, settings)
    if noise is not None:  # a stated strength is a ladder of one rung
        settings = replace(settings, ladder=replace(settings.ladder, rungs=(noise,)))
    settings = replace(settings, alternatives=replace(settings.alternatives, beyond=beyond))
    body = Body.of(vehicle, torques_stated=noise is not None)
    nominal = Model(readings.obs, body, Noise(settings.search.noise), rate_max / 2)
    budget = Budget.of(effort)
    if callable(progress):
        used = sum(len(a_pass.samples) for a_pass in passes)
        thin = f", thinned to {kept} for the search" if kept < used else ""
        progress(f"{used} samples used in {count_of_passes(len(passes))}{thin}")

    # the fits of all passes; `tasks`: reversed wheels, and passes or models of wheels, that may be computed side by side
    require_directions(nominal, passes)
    tasks = len(wheel_changes(vehicle))
    tasks += max(len(passes), len(wheel_models(vehicle, assessment.telemetry)))
    if (processes := min(worker_count(workers), tasks)) > 1:
        load_step()
    with process_pool(processes) as pool:
        fitter = PassFitter(settings, budget, map if pool is None else pool.map)
        fitted = fit_passes(assessment, nominal, passes, fitter, show_bar=progress is True)

    # the solutions of each pass; other passes and observed periods change their probabilities
    fits, solved, pass_attrs = solve_passes(fitted, passes, periods, settings)

    # the result and its checks
    nominal = fitted.nominal.under(common_noise(fits))
    result = motion_dataset(assessment, readings, passes, solved, nominal, noise is not None)
    result = result.assign_attrs(wheels=fitted.wheels, wheel_change=fitted.wheel_change)
    left_open, counts = left_open_by_search(result, fits, solved, effort, settings)
    epoch = assessment.telemetry.attrs.get("epoch_utc")
    result = result.assign(verdict_variables(passes, solved, left_open, nominal.rate_sigma, epoch))
    result = result.assign(without_periods(solved))
    result = with_doubted_passes(with_doubted_repeats(result, assessment))
    result = with_space_axes(result, local, solved, readings)
    result = result.assign_attrs(
        latency_attributes(vehicle, solved)
        | counts
        | pass_attrs
        | {
            "effort": float(sum(pass_fits.used for pass_fits in fits)) / (USUAL * len(fits)),
            "samples_searched": kept,
            "max_rate_assumed": int(beyond > 1),
            "times_rounded_to_s": float(readings.obs.time_sigma_s * np.sqrt(12)),
            **log_evidence_of_passes(assessment, fitted, passes),
            "symmetric_unlisted": 0,
        }
    )
    trial_estimate = estimate_again if column_tests else None
    result = check_columns(result, assessment, fitted.doubt, trial_estimate, settings, budget)
    return with_units(result.assign_attrs(verdict=rates_words(result)))


class FittedPasses(NamedTuple):
    """The fits of all passes of a file.

    `nominal`: the nominal model of the whole file, with the momentum of the wheels. In words: `wheels`, what these do, and
    `wheel_change`, how the speed of one changes in a pass. `fits`: of each pass. `doubt`: wheels that may turn the other way, None
    if there are none.
    """

    nominal: Model
    wheels: str
    wheel_change: str
    fits: list[PassFits]
    doubt: Reversed | None


def fit_passes(
    assessment: Assessment,
    nominal: Model,
    passes: Sequence[Pass],
    fitter: PassFitter,
    *,
    show_bar: bool,
) -> FittedPasses:
    """Fit all passes, and decide by the fits of the longest ones what the wheels do and which may turn the other way.

    `nominal`: nominal model of the whole file; its momentum of the wheels is replaced. `show_bar`: show a progress bar in the
    terminal.
    """
    longest = passes[longest_passes(passes)[0]]
    # Searches with reversed wheels need a model of the wheels. They may run in other processes while that model is decided; until
    # then they assume the probable one. That is the second, wheels that coast, if there are several.
    names = list(wheel_models(assessment.vehicle, assessment.telemetry))
    probable = names[1] if len(names) > 1 else names[0]
    searches = search_reversed(assessment, probable, nominal, longest, fitter)
    wheels = decide_wheels(assessment, nominal, passes, fitter)
    if wheels.name != probable:
        searches = search_reversed(assessment, wheels.name, nominal, longest, fitter)
    nominal = nominal.with_momentum(wheels.momentum)
    # the longest passes have their fits already if there were several models of the wheels
    unfitted = [k for k in range(len(passes)) if k not in wheels.fits]
    new_fits = fitter.fits([passes[k].model_of_kept(nominal) for k in unfitted])
    if show_bar:
        new_fits = PassBar(new_fits, "rates", len(unfitted), leave=False, unit="pass")
    fits_by_pass = wheels.fits | dict(zip(unfitted, new_fits, strict=True))
    fits = fit_from_other_passes([fits_by_pass[k] for k in range(len(passes))], fitter.settings)
    compared = longest_passes(passes)
    of_file = [(passes[k], fits[k]) for k in compared]
    doubt = doubted_signs(nominal.obs, of_file, *searches, fitter)
    as_stated = FittedPasses(nominal, wheels.words, "", fits, doubt)
    vehicle = assessment.vehicle
    speeds_known = "wheel_speed_rad_s" in assessment.telemetry or vehicle.inertia_kg_m2 is None
    if not vehicle.wheels or speeds_known:
        return as_stated

    # A wheel may have changed its speed. But one that turns the other way may look so: if that fits as well, its sign is in doubt.
    changed = changed_wheel(vehicle, nominal, passes, fits, fitter)
    if changed is None:
        return as_stated
    gain = sum(changed.fits[k].log_evidence - fits[k].log_evidence for k in compared)
    if doubt is not None and doubt.gain > gain - CLEARLY:
        return as_stated
    # a reversed wheel may change its speed too
    obs, words = changed.nominal.obs, changed.change.words(vehicle)
    searches = search_reversed(
        assessment, wheels.name, changed.nominal, longest, fitter, obs.momentum - wheels.momentum
    )
    with_change = [(passes[k], changed.fits[k]) for k in compared]
    doubt = doubted_signs(obs, with_change, *searches, fitter)
    return FittedPasses(changed.nominal, wheels.words, words, changed.fits, doubt)


def solve_passes(
    fitted: FittedPasses,
    passes: Sequence[Pass],
    periods: Sequence[PeriodSeen],
    settings: RatesSettings,
) -> tuple[list[PassFits], list[Solutions], dict[str, Any]]:
    """Return fits and solutions of each pass, their probabilities by all passes and observed `periods`, and attributes on these.

    Passes determine each other's probabilities: the same torques act in all, and a rate changes little from one to the next.
    """
    obs, body = fitted.nominal.obs, fitted.nominal.body
    fits = share_noise(fitted.fits, settings.ladder)
    solved = []
    for pass_fits, a_pass in zip(fits, passes, strict=True):
        whole, kept = obs.of_pass(a_pass.samples), a_pass.kept_in_pass
        solved.append(solutions(pass_fits, whole, kept, settings.solutions, settings.search))
    numbers = [a_pass.number for a_pass in passes]
    solved, period_attrs = weigh_by_periods(solved, body, periods, numbers)
    middle_s = [float(obs.t_s[a_pass.samples].mean()) for a_pass in passes]
    sizes = [momentum_sizes(of_pass, body) for of_pass in solved]
    solved, walk = link_passes(solved, middle_s, fitted.nominal.rate_sigma, sizes)
    solved = [
        of_pass.listed(settings.solutions, len(images_of(pass_fits.nominal)))
        for of_pass, pass_fits in zip(solved, fits, strict=True)
    ]
    return fits, solved, period_attrs | {"walk_between_passes": walk}


def along_the_sun(environment: Environment | None) -> Environment | None:
    """Return the environment in axes N whose z is the direction to the Sun; raise InputError if it has other axes and no orbit."""
    if isinstance(environment, Orbit):
        return SunAlongZ(environment)
    if environment is not None and not isinstance(environment, SunAlongZ):
        sun = environment.at(0.0).sun_N[0]
        if np.linalg.norm(sun - SUN_N) > OFF_Z:
            raise InputError(
                "rates needs an environment with z of its N to the Sun",
                got=f"the Sun at {np.round(sun, 3)}",
            )
    return environment


def stated_noise(
    vehicle: Vehicle, given: float | None, dipole_modelled: bool = False
) -> float | None:
    """Return the strength of unknown torques (rad/s^1.5): the `given` one, else the vehicle's; None if neither states it.

    A file with a magnetic dipole states another one for the case that no field is measured, so that the dipole is not modelled.
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
    vehicle: Vehicle,
    given: float | None,
    t_s: np.ndarray,
    passes: Sequence[Pass],
    settings: RatesSettings,
) -> tuple[float, float]:
    """Return the largest rate (rad/s) of the search, and by which factor a body may exceed it (`AlternativeSettings.beyond`).

    The rate is `given`, or that of the vehicle; the factor is one then. If neither states it, it is :data:`LARGEST_TURNS`
    revolutions in the shorter intervals between kept samples, but at most :data:`LARGEST_RATE`. `t_s` (n): times of all samples of
    the file.
    """
    given = vehicle.sensors.disturbance.max_rate_rad_s if given is None else given
    if given is not None:
        if not (np.isfinite(given) and given > 0):
            raise InputError("max_rate_rad_s must be positive", got=given)
        return float(given), 1.0
    # the mean of the shortest eighth of the intervals of each pass, two at least
    shorter = [
        np.sort(np.diff(t_s[a_pass.kept]))[: max(2, len(a_pass.kept) // 8)].mean()
        for a_pass in passes
    ]
    rate_max = min(LARGEST_TURNS * 2 * np.pi / float(np.median(shorter)), LARGEST_RATE)
    return rate_max, min(settings.alternatives.beyond, LARGEST_RATE / rate_max)


def require_directions(nominal: Model, passes: Sequence[Pass]) -> None:
    """Raise InputError if each row has readings of some panels only, and no two neighbours determine the direction to the Sun.

    Such rows arise if each panel has packets of its own. If another sensor is read, directions may be missing.
    """
    panels = nominal.obs.of_kind(Panels)
    if panels is None or not nominal.obs.only_sun:
        return
    # the most panels that are read in a row, and those that are used at all
    read = int(np.isfinite(panels.sigma).sum(axis=1).max())
    count = panels.sigma.shape[1] - len(panels.left_out)
    if read >= count:
        return
    for a_pass in passes:
        of_pass = replace(nominal, obs=nominal.obs.of_pass(a_pass.kept))
        model = of_pass.for_search(nominal.noise)[0]
        known_before = False  # the direction at the sample before
        for sample in range(len(a_pass.kept)):
            allowed = allowed_directions(model, sample)
            # by the largest angle between any two directions that the sample allows
            is_known = bool((allowed @ allowed.T).min() > np.cos(WIDE_RAD))
            if known_before and is_known:
                return
            known_before = is_known
    raise InputError(
        "too few Sun directions to estimate a rate",
        got=f"rows with readings of {read} of {count} panels at most",
        do="set sample_span_s under [telemetry] to the time in which all are read",
    )


def common_noise(fits: Sequence[PassFits]) -> float:
    """Return the strength of unknown torques (rad/s^1.5) with the largest evidence of all passes together.

    It is assumed to be the same in all passes, and each strength of the ladder (rung) to be equally probable beforehand. All passes
    have the same rungs.
    """
    # (pass, rung), minus infinity where a pass has no fit under a rung
    log_evidence = np.array([pass_fits.log_evidence_of_rungs() for pass_fits in fits])
    total = log_evidence.sum(axis=0)
    if not np.isfinite(total).any():
        # No rung has a fit in every pass. A missing fit counts as -1e6, far below others: the rung that misses fewest is best.
        total = np.maximum(log_evidence, -1e6).sum(axis=0)
    return fits[0].rungs[int(np.argmax(total))]


def log_evidence_of_passes(
    assessment: Assessment, fitted: FittedPasses, passes: Sequence[Pass]
) -> dict[str, list[float]]:
    """Return attributes with a number for each pass: `log_evidence`, and `log_sigmas`, the logs of the sigmas of panels in it.

    The evidence is summed over motions and models, and averaged over the strengths of torques. A constant that depends only on the
    number of readings is left out. So files whose columns are exchanged can be compared.
    """
    log_evidence, log_sigmas = [], []
    for pass_fits, a_pass in zip(fitted.fits, passes, strict=True):
        # The costs of fits leave out the sigmas of the panels' readings, and all readings of panels without any signal. Both depend
        # on the order of the columns.
        panels = pass_fits.nominal.obs.of_kind(Panels)
        silent = 0.0 if panels is None else cost_of_silent_panels(assessment, a_pass.kept)
        evidence = logsumexp(pass_fits.log_evidence_of_rungs()) - np.log(len(pass_fits.rungs))
        log_sigmas.append(0.0 if panels is None else sum_of_log_sigmas(panels))
        log_evidence.append(float(evidence - log_sigmas[-1] - silent))
    return {"log_evidence": log_evidence, "log_sigmas": log_sigmas}


def left_open_by_search(
    result: xr.Dataset,
    fits: Sequence[PassFits],
    solved: Sequence[Solutions],
    effort: float,
    settings: RatesSettings,
) -> tuple[list[str], dict[str, float]]:
    """Return for each pass in words why its search may be incomplete and what would help; and attributes that count such passes.

    `result`: its attributes name wheels and panels with unknown values. The reasons (torques only if their strength is estimated):

    - the search was cut short by the budget, or its starts were too coarse for the largest rate;
    - the inertia is unknown, the body is taken for a sphere, and the torques are stronger than on nearly any satellite or turn the
      body far between two samples: the nutation of a body that is no sphere looks like such torques;
    - the inertia is stated, no wheel is, only the Sun is measured, and the torques reach `WHEEL_STRENGTH`: a wheel may run. Of 10
      files that lack a wheel with 0.1 to 2 times the momentum of the body three were decided and wrong, two under such torques;
    - the rate has several steps, and no column gives the speed of a wheel, which may have changed: of 24 passes with a braked wheel
      one had such a fit, and was decided 20 sigma off;
    - the speed of a wheel is unknown, or the gain of a panel is and only the Sun is measured.
    """
    wheels, gains = result.attrs["wheels_untold"], result.attrs["gains_unknown"]
    strength_estimated = len(settings.ladder.rungs) > 1  # a stated one is the only rung
    fine = [fine_up_to(pass_fits.nominal, settings.search) for pass_fits in fits]
    words, no_sphere = [], 0
    for pass_fits, of_pass, limit in zip(fits, solved, fine, strict=True):
        model = pass_fits.nominal
        # torques of the strength q turn a body by q sqrt(T^3 / 3) over the shortest interval T
        shortest_s = float(np.diff(model.obs.t_s).min())
        far = of_pass.noise[0] * np.sqrt(shortest_s**3 / 3) > NUTATION_RAD
        strong = of_pass.noise[0] >= settings.ladder.strong
        reasons = []
        if pass_fits.cut:
            reasons.append(f"budget reached: {more_effort(effort)}")
        if np.isfinite(limit):
            reasons.append(f"coarse: {advise_lower_limit(limit)}")
        if strength_estimated and model.body.sphere and (far or strong):
            no_sphere += 1
            reasons.append(
                "torques too strong for a satellite, or the body is no sphere: give its inertia"
            )
        wheel_lacks = of_pass.noise[0] >= WHEEL_STRENGTH and not model.obs.momentum.any()
        if strength_estimated and wheel_lacks and model.obs.only_sun and not model.body.sphere:
            reasons.append(WHEEL_LACKS)
        wheel_may_change = model.obs.momentum.any() and result.attrs["wheels"] != MEASURED
        if wheel_may_change and len(best_fit(pass_fits.fits).model.noise.steps) > 1:
            reasons.append(WHEEL_CHANGES)
        if wheels:
            reasons.append(
                f"the speed of wheel {wheels} is unknown: give speed_rad_s or a speed_column"
            )
        if gains and model.obs.only_sun:
            reasons.append(
                f"the gain of panel {gains} is not known: give cells, gain_W, gain_A, or a sigma"
            )
        words.append("; ".join(reasons))
    coarse = [limit for limit in fine if np.isfinite(limit)]
    return words, {
        "effort_given": effort,
        "fine_up_to_rad_s": min(coarse, default=np.nan),
        "coarse_passes": len(coarse),
        "cut_passes": sum(pass_fits.cut for pass_fits in fits),
        "no_sphere": no_sphere,
    }
