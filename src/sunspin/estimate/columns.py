"""Which column is which: whether the motion confirms columns, axes and signs, and what is said if it does not.

A file may be equivalent to itself, or to one with exchanged columns, by a rotation or mirror of the body: then no data distinguish
the motions, and none of them is decided unless all are listed. If a pass does not fit, other columns are tried on it. On a file of
panels alone that fits they are tried in three cases: its samples, each by itself, fit other columns far better; or they fit other
columns as well, and only the motion can tell which are right; or the data fit better with a wheel that turns the other way.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.estimate.alternatives import MISALIGNED
from sunspin.estimate.budget import USUAL, Budget
from sunspin.estimate.column_tests import (
    AS_PROBABLE,
    EXCLUDED,
    MOST_NAMED,
    MOST_SQUARE,
    Better,
    CostsOfSamples,
    Named,
    Trials,
    rival_exchanges,
    rival_words,
    silent_inputs,
    what_fits_better,
)
from sunspin.estimate.equivalence import (
    AS_WRITTEN,
    CLEARLY,
    Observed,
    column_changes,
    equivalence,
    equivalent_changes,
    rate_under,
    unseen_changes,
    wheel_change,
    wheel_changes,
)
from sunspin.estimate.images import SAME_SIGMAS
from sunspin.estimate.model import Body, Model, Noise
from sunspin.estimate.observe import observe, split_passes, take_samples, wheel_models
from sunspin.estimate.quick import quick_evidence
from sunspin.estimate.settings import RatesSettings
from sunspin.estimate.terms.panels import DARK
from sunspin.estimate.verdict import (
    COLUMNS_DOUBTED,
    COLUMNS_STATED,
    COLUMNS_UNCHECKED,
    alike_motions,
)
from sunspin.estimate.wheels import Reversed, momentum_of_each, name_of_wheels
from sunspin.telemetry.assess import Assessment, assess
from sunspin.telemetry.sun import signals
from sunspin.vehicle import Vehicle
from sunspin.vehicle.timeline import utc_after

SAMPLES_DENY = "the samples, each by itself, fit other columns far better"
"""Why a pass that fits is not decided, although no change of columns is named. Of some 700 right simulated files, faulty panels and
strong torques among them, none has a change that is better by more than 5 in log likelihood. Of 64 files with two columns exchanged
50 have one that is better by :data:`~sunspin.estimate.column_tests.WORTH_A_SEARCH`."""

TRY_COLUMNS = "estimate with `column_tests=True` (without `--no-column-tests`), which tries these"
"""What to do if no tests were asked for: in Python, and on the command line, where only that option prevents them."""

COLUMN_SHARE = 8.0
"""Budget of the column tests, in budgets of a pass: a quick search takes 2 to 8 % of one, a whole estimate a tenth, and up to 21
changes of a cube are tried."""

Again = Callable[[Vehicle, xr.Dataset], xr.Dataset]
"""Function that estimates a vehicle and its telemetry again, without column tests."""


def check_columns(
    result: xr.Dataset,
    assessment: Assessment,
    doubt: Reversed | None,
    again: Again | None,
    settings: RatesSettings,
    budget: Budget,
) -> xr.Dataset:
    """Return the result of `rates` with what the data say of columns, axes and signs.

    `doubt`: wheels that may turn the other way. `again`: how other columns are estimated, None if none are to be tried. Passes may
    lose `decided` and `unique`; `columns_checked` says what is known of the columns. Attributes: `alike`, `columns_unseen`,
    `columns_rivals`, `columns_doubt`, `columns_changes`, `column_tests_cut`, `symmetric_unlisted`.
    """
    vehicle, telemetry = assessment.vehicle, assessment.telemetry
    observed = what_was_observed(vehicle, telemetry, result.attrs)
    result = _with_unseen_changes(result, observed, telemetry)
    result = _with_symmetric_motions(result, observed, telemetry)
    of_tests = replace(budget, most=COLUMN_SHARE * budget.most)
    fits = bool(result["fits"].values.all())
    # only of panels without another sensor: with one a file of wrong columns does not fit
    costs = None
    if fits and observed.panels and not observed.sensors:
        costs = CostsOfSamples.of(vehicle, samples_of(result, telemetry, _longest(result)))
    denied = costs is not None and costs.deny_the_columns()
    # a file with exchanged columns may fit better with reversed wheels, and better still with the columns exchanged
    suspected = denied or (costs is not None and doubt is not None)
    others_tried = again is not None and (not fits or suspected)
    trials = None if again is None else trials_of(result, again, settings, of_tests)
    if trials is not None and others_tried:
        result = _with_other_columns(result, observed, telemetry, trials)
    if trials is not None and costs is not None and "columns_doubt" not in result.attrs:
        least = 0.0 if doubt is None else doubt.gain
        result = _with_rivals(result, observed, telemetry, costs, trials, least)
    if denied and "columns_doubt" not in result.attrs:
        how = "" if again is not None else f": {TRY_COLUMNS}"
        result = _undecided(result, SAMPLES_DENY).assign_attrs(columns_doubt=SAMPLES_DENY + how)
    # both kinds of tests share a budget
    if others_tried or of_tests.cut:
        result = result.assign_attrs(column_tests_cut=int(of_tests.cut))
    return _with_doubted_wheels(result, doubt, observed, telemetry, others_tried)


def what_was_observed(vehicle: Vehicle, telemetry: xr.Dataset, attrs: dict) -> Observed:
    """Return what the telemetry has read, as far as it distinguishes changes.

    `attrs`: of a result, which say what the wheels do, and if there is an orbit, in which Sun and field are known in space.
    """
    momenta = momentum_of_each(vehicle, telemetry, name_of_wheels(attrs["wheels"]))
    observed = Observed.of(vehicle, telemetry, momenta=momenta, in_orbit="orbit" in attrs)
    return replace(observed, panels=observed.panels and attrs["source"] == "panels")


def _with_unseen_changes(
    result: xr.Dataset, observed: Observed, telemetry: xr.Dataset
) -> xr.Dataset:
    """Return the result with changes of columns that look the same as the file as it is written, and with symmetric motions.

    attrs["columns_unseen"] is JSON, a row for each change: `what`, and the `matrix` by which directions change. Without such
    changes the data confirm the columns.
    """
    if not observed.panels:
        return result
    if words := alike_motions(observed.vehicle):
        result = result.assign_attrs(alike=words)
    unseen = unseen_changes(replace(observed, sun_B=result["sun_B"].values), telemetry)
    if not unseen:
        checked = result["columns_checked"].values
        confirmed = np.where(checked == COLUMNS_UNCHECKED, COLUMNS_STATED, checked)
        return result.assign(columns_checked=("pass_id", confirmed))
    rows = [
        {"what": change.what, "matrix": np.round(matrix, 6).tolist()} for change, matrix in unseen
    ]
    return result.assign_attrs(columns_unseen=json.dumps(rows))


def _with_symmetric_motions(
    result: xr.Dataset, observed: Observed, telemetry: xr.Dataset
) -> xr.Dataset:
    """Return the result with no pass unique whose panels read the same in a motion that is not listed.

    A rotation or mirror of the body then maps the file onto itself; a mirror does if all lit panels lie in a plane.
    """
    if not observed.panels or "noise" not in result.attrs:
        return result
    decided, unique = (result[name].values.copy() for name in ("decided", "unique"))
    why = result["why_not_decided"].values.astype(object)
    noise = noise_of(result, observed.vehicle)
    doubted = 0
    for k in np.flatnonzero(unique & result["fits"].values):
        lit = Observed.of(observed.vehicle, samples_of(result, telemetry, k)).lit
        sun = result["sun_B"].values[result["pass_of"].values == k]
        omega, sigma = (
            np.stack([result[f"{name}_{axis}"].values[k] for axis in "xyz"], axis=1)
            for name in ("omega", "sigma")
        )
        if has_unlisted_motion(replace(observed, lit=lit, sun_B=sun), omega, sigma, noise):
            decided[k] = unique[k] = False
            doubted += 1
            why[k] = join_reasons(why[k], "several motions: a symmetric one is not listed")
    return result.assign(
        decided=("pass_id", decided),
        unique=("pass_id", unique),
        why_not_decided=("pass_id", why.astype(np.str_)),
    ).assign_attrs(symmetric_unlisted=doubted)


def noise_of(result: xr.Dataset, vehicle: Vehicle) -> np.ndarray | float:
    """Return the noise of the panels' readings: that of the vehicle file, else the estimated one."""
    stated = vehicle.input_noise
    return result.attrs["noise"] if stated is None else stated


def has_unlisted_motion(
    observed: Observed, omega: np.ndarray, sigma: np.ndarray, noise: np.ndarray | float
) -> bool:
    """Return whether a motion has a symmetric one with the same readings that is not among the solutions.

    `omega`, `sigma` (K, 3) in rad/s: the rates of all solutions at one time, the motion first, NaN if there are fewer;
    `observed.sun_B`: the Sun along it; `noise`: of the readings, in W or A, or in gains.
    """
    power = observed.vehicle.response_in().power
    read = power(observed.sun_B)
    # rotations and mirrors of the body by which the file is equivalent to itself
    for m in equivalence(observed, AS_WRITTEN, AS_WRITTEN):
        off = np.abs(rate_under(m, omega[0]) - omega)
        is_listed = (off < SAME_SIGMAS * sigma).all(axis=1).any()
        # within the errors of the file they need not be exact: whether the readings of this pass stay the same is computed
        change = (power(observed.sun_B @ m.T) - read) / noise
        if not is_listed and (change**2).sum() / 2 <= CLEARLY:
            return True
    return False


def _with_other_columns(
    result: xr.Dataset, observed: Observed, telemetry: xr.Dataset, trials: Trials
) -> xr.Dataset:
    """Return the result with the changes that fit the longest pass that does not fit, or with the sensor that is in its way.

    If all passes fit, the longest is tried: its samples, each by itself, then fit other columns far better.
    """
    unfitted = np.flatnonzero(~result["fits"].values)
    part = samples_of(result, telemetry, _longest(result, unfitted if len(unfitted) else None))
    of_part = what_was_observed(observed.vehicle, part, result.attrs)
    better = what_fits_better(of_part, part, trials)
    if better is None:
        return result
    if isinstance(better, Better):
        return _with_named_changes(_undecided(result, "columns, signs or axes"), better)
    return result.assign_attrs(columns_doubt=better.words())


def _with_rivals(
    result: xr.Dataset,
    observed: Observed,
    telemetry: xr.Dataset,
    costs: CostsOfSamples,
    trials: Trials,
    least: float,
) -> xr.Dataset:
    """Return the result with changes that the samples allow as well and that fit the longest decided pass about as well, if any.

    `costs`: of the samples of the longest pass, decided or not; `least`: log evidence by which changes must be better, that of
    reversed wheels if their sign is in doubt. Changes that are better than `AS_PROBABLE` leave no pass decided. Others that the
    data do not exclude are said, with their rates, in attrs["columns_rivals"].
    """
    decided = np.flatnonzero(result["decided"].values)
    if "noise" not in result.attrs or not len(decided):
        return result
    k = _longest(result, decided)
    part = samples_of(result, telemetry, k)
    of_part = what_was_observed(observed.vehicle, part, result.attrs)
    of_part = replace(of_part, sun_B=result["sun_B"].values[result["pass_of"].values == k])
    if k != _longest(result):
        costs = CostsOfSamples.of(observed.vehicle, part)
    # a pass that is a part of the file was assessed with the rest, a change is estimated by itself
    alone = part.sizes["time"] == telemetry.sizes["time"]
    as_written = float(result.attrs["log_evidence"][k]) if alone else None
    noise = noise_of(result, observed.vehicle)
    rivals = rival_exchanges(of_part, part, costs, noise, trials, as_written)
    rivals = [rival for rival in rivals if rival.gain >= least or not least]
    # A small gain does not accuse the file, but the pass is not decided with it. Nor does evidence alone accuse it: of a slow body
    # that was searched up to 40 times its rate, a change of dark columns had 11.7 more although its best motion fitted worse.
    # Misaligned panels may stand for exchanged columns, and then their cost is low: the evidence accuses alone.
    misaligned = str(result["model"].values[k]).startswith(MISALIGNED)
    most = np.inf if misaligned else float(result["cost"].values[k, 0]) - CLEARLY
    accusing = [rival for rival in rivals if rival.gain > CLEARLY and rival.cost <= most]
    if accusing:
        best = accusing[0]
        near = [rival for rival in accusing if rival.gain > best.gain - CLEARLY]
        named = tuple(named for rival in near for named in rival.named)
        result = _undecided(result, "columns, signs or axes")
        return _with_named_changes(result, replace(best, named=named))
    omega, sigma = (
        np.array([result[f"{name}_{axis}"].values[k, 0] for axis in "xyz"])
        for name in ("omega", "sigma")
    )
    # the rate is right with either if it is the same with both
    others = [rival for rival in rivals if not _gives_the_rate(rival, omega, sigma)]
    as_probable = [rival for rival in others if rival.gain > AS_PROBABLE]
    if as_probable:
        names = [named.change.what for rival in as_probable for named in rival.named]
        what = " or with ".join(names[:MOST_NAMED])
        words = f"the data fit as well with {what}: find out which columns are right"
        reason = f"other columns fit as well (with {what})"
        return _undecided(result, reason, COLUMNS_UNCHECKED).assign_attrs(columns_doubt=words)
    not_excluded = [rival for rival in others if rival.gain > -EXCLUDED]
    if not not_excluded:
        return result
    checked = np.full(result.sizes["pass_id"], COLUMNS_UNCHECKED)
    clock = partial(clock_time, result.attrs.get("epoch_utc"))
    lines = [rival_words(rival, clock) for rival in not_excluded]
    return result.assign(columns_checked=("pass_id", checked)).assign_attrs(
        columns_rivals=f"columns unchecked: the data fit about as well {'; '.join(lines)}"
    )


def _gives_the_rate(rival: Better, omega: np.ndarray, sigma: np.ndarray) -> bool:
    """Return whether a change and all that look the same give the rate `omega` (3) within its errors `sigma` (3), in rad/s."""
    rates = [named.omega for named in rival.named if named.omega is not None]
    return all((np.abs(rate - omega) < SAME_SIGMAS * sigma).all() for rate in rates)


def trials_of(result: xr.Dataset, again: Again, settings: RatesSettings, budget: Budget) -> Trials:
    """Return how changes are judged, under the wheels and the largest rate of a result.

    If a solution of the file as it is written is faster than the largest rate, which nobody stated, quick searches go as far as
    its own search did.
    """
    attrs = result.attrs
    source = None if attrs["source"] == "directions" else attrs["source"]
    speed = np.sqrt(sum(result[f"omega_{axis}"].values ** 2 for axis in "xyz"))
    rate_max = attrs["max_rate_rad_s"]
    if (speed > rate_max).any():
        rate_max *= settings.alternatives.beyond

    def evidence(changed: Vehicle, data: xr.Dataset) -> float:
        """Return the log evidence of the pass by a quick search."""
        try:
            assessment = assess(changed, data)
            readings = observe(assessment, source)
            (whole, *_) = split_passes(readings, np.inf, settings.passes)
        except InputError:
            return -np.inf
        noise = Noise(settings.search.noise)
        nominal = Model(readings.obs, Body.of(changed), noise, rate_max / 2)
        momentum = wheel_models(changed, data)[name_of_wheels(attrs["wheels"])]
        nominal = nominal.with_momentum(momentum)
        silent = cost_of_silent_panels(assessment, whole.kept) if source == "panels" else 0.0
        return quick_evidence(nominal.seeing(whole.kept), settings, budget) - silent

    def run(changed: Vehicle, data: xr.Dataset) -> xr.Dataset | None:
        """Return the whole estimate of the pass, if there is one."""
        try:
            estimate = again(changed, data)
        except InputError:
            return None
        budget.spend(estimate.attrs["effort"] * USUAL * estimate.sizes["pass_id"])
        return estimate

    return Trials(evidence, run, budget)


def cost_of_silent_panels(assessment: Assessment, samples: np.ndarray) -> float:
    """Return minus the log likelihood of the readings at `samples` of panels that are left out, as they never show a signal.

    Such a panel is taken to have failed, and its readings for noise about zero. Which panels are so depends on the order of the
    columns: if these readings counted nothing, two exchanged columns without a signal were better by 125 in a right file.
    """
    quality = assessment.quality
    silent = silent_inputs(assessment)
    zeros = DARK * quality.attrs["full_sun"] * quality["gain"].values
    read = signals(assessment.telemetry)
    sigma = np.broadcast_to(np.hypot(quality["noise"].values, zeros), read.shape)
    read, sigma = read[samples][:, silent], sigma[samples][:, silent]
    square = np.minimum(np.nan_to_num(read / sigma) ** 2, MOST_SQUARE)
    return float((np.log(sigma) + square / 2).sum())


def _with_doubted_wheels(
    result: xr.Dataset,
    doubt: Reversed | None,
    observed: Observed,
    telemetry: xr.Dataset,
    others_tried: bool,
) -> xr.Dataset:
    """Return the result with nothing decided if the sign of a wheel is in doubt.

    Unless another change fits, the wheel is named with all changes that look the same. If it does not fit either, and all others
    were tried (`others_tried`), no change is named.
    """
    if doubt is None:
        return result
    result = _undecided(result, "the sign of a wheel")
    if "columns_doubt" in result.attrs:
        return result
    change = wheel_change(observed.vehicle, doubt.wheels)
    if not doubt.fits and others_tried:
        return result.assign_attrs(
            columns_doubt=f"with {change.what} the data fit better (log evidence better by {doubt.gain:.0f}), and still badly: no "
            "single change of columns or signs explains them"
        )
    others = [*column_changes(observed.vehicle, telemetry), *wheel_changes(observed.vehicle)]
    others = [other for other in others if other.what != change.what]
    at = int(np.argmin(np.abs(doubt.t_s - (doubt.t_s[0] + doubt.t_s[-1]) / 2)))
    omega = doubt.omega[at]
    same = equivalent_changes(replace(observed, sun_B=doubt.sun_B), change, others)
    named = (
        Named(change, omega),
        *(Named(equivalent, rate_under(m, omega)) for equivalent, m in same),
    )
    return _with_named_changes(result, Better(named, doubt.gain, float(doubt.t_s[at]), doubt.fits))


def _with_named_changes(result: xr.Dataset, better: Better) -> xr.Dataset:
    """Return the result with the changes that fit better than the file: a sentence, and in JSON attrs["columns_changes"]."""
    rows = [
        {
            "what": named.change.what,
            "do": named.change.do,
            "at_s": better.at_s,
            "omega_deg_s": None
            if named.omega is None
            else np.degrees(named.omega).round(6).tolist(),
        }
        for named in better.named
    ]
    clock = partial(clock_time, result.attrs.get("epoch_utc"))
    return result.assign_attrs(columns_doubt=better.words(clock), columns_changes=json.dumps(rows))


def _undecided(result: xr.Dataset, what: str, checked: str = COLUMNS_DOUBTED) -> xr.Dataset:
    """Return the result with no pass decided, since `what` is in doubt for the whole file."""
    why = [join_reasons(reason, what) for reason in result["why_not_decided"].values]
    count = result.sizes["pass_id"]
    return result.assign(
        decided=("pass_id", np.zeros(count, dtype=bool)),
        columns_checked=("pass_id", np.full(count, checked)),
        why_not_decided=("pass_id", why),
    )


def join_reasons(*reasons: str) -> str:
    """Return reasons as one text, without empty ones."""
    return "; ".join(str(reason) for reason in reasons if str(reason))


def clock_time(epoch_utc: str | None, t_s: float) -> str:
    """Return a time (s) in words: the clock on the day of the epoch, date and clock on any other day."""
    if epoch_utc is None:
        return f"{t_s:.0f} s"
    text = utc_after(t_s, epoch_utc)
    return text[11:19] if text[:10] == utc_after(0.0, epoch_utc)[:10] else text


def _longest(result: xr.Dataset, which: np.ndarray | None = None) -> int:
    """Return the index of the pass with the most samples, of all or of those in `which`."""
    which = np.arange(result.sizes["pass_id"]) if which is None else which
    return int(which[np.argmax(result["samples"].values[which])])


def samples_of(result: xr.Dataset, telemetry: xr.Dataset, k: int) -> xr.Dataset:
    """Return the samples of the telemetry that pass `k` of a result uses, without repeated times."""
    times, first = np.unique(telemetry["time"].values, return_index=True)
    used = result["time"].values[result["pass_of"].values == k]
    return take_samples(telemetry, first[np.isin(times, used)])
