"""Whether the data confirm the columns, axes and signs that the vehicle file states, and what the result says if they do not.

A file may look the same as one with exchanged columns if the body is rotated or mirrored; the pass then has another motion with the
same readings (:mod:`.equivalence`). No data distinguish the two, and no pass is decided unless all such motions are listed.

If a pass does not fit, other columns are tried on it (:mod:`.column_tests`). On a file of panels alone that fits they are tried in
three cases: its samples, each by itself, fit other columns far better; or they fit other columns as well, and only the motion shows
which are right; or the data fit better with a wheel that turns the other way.

If a gyro or a magnetometer fits only with a zero offset that the file does not state, the pass is also estimated without it.

What a result then has:

- attrs["columns_unseen"]: changes that no data of the file distinguish from it; a pass stays decided;
- attrs["columns_rivals"]: changes that fit about as well, with another rate; `columns_checked` is "unchecked";
- attrs["columns_doubt"]: the sentence why no pass is decided; attrs["columns_changes"]: the changes that it names, in JSON.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
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
    BetterChanges,
    ChangeWithRate,
    ContradictingSensor,
    Estimators,
    SampleCosts,
    UnstatedZero,
    changes_of_sensor,
    denied_by_the_sun,
    rival_exchanges,
    rival_words,
    silent_inputs,
    unconfirmed_zero,
    what_fits_better,
)
from sunspin.estimate.equivalence import (
    AS_WRITTEN,
    AXES_ALIKE,
    CLEARLY,
    ColumnChange,
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
from sunspin.estimate.observe import (
    middle_sample,
    observe,
    split_passes,
    take_samples,
    wheel_models,
)
from sunspin.estimate.quick import quick_evidence
from sunspin.estimate.settings import RatesSettings
from sunspin.estimate.terms.panels import SHADOW_ZERO_SHARE
from sunspin.estimate.verdict import (
    COLUMNS_DOUBTED,
    COLUMNS_STATED,
    COLUMNS_UNCHECKED,
    alike_motions,
    join_reasons,
)
from sunspin.estimate.wheels import Reversed, momentum_of_each, name_of_wheels
from sunspin.telemetry.assess import Assessment, assess
from sunspin.telemetry.signals import signals
from sunspin.vehicle import Vehicle
from sunspin.vehicle.timeline import utc_after

SAMPLES_CONTRADICT = "the samples, each by itself, fit other columns far better"
"""Why a pass that fits is not decided, although no change of columns is named. Of some 700 right simulated files, faulty panels and
strong torques among them, none has a change that is better by more than 5 in log likelihood. Of 64 files with two columns exchanged
50 have one that is better by :data:`~sunspin.estimate.column_tests.WORTH_A_SEARCH`."""

TRY_COLUMNS = "estimate without `--no-column-tests` (`column_tests=False`); that tries these"
"""Advice if the caller asked for no column tests."""

COLUMN_SHARE = 4.0
"""Computing budget of the column tests, in budgets of a pass: of six panels a quick search takes 0.5 to 2 % of one, a whole
estimate 3 %, and up to 21 changes of a cube are tried."""

EstimateAgain = Callable[[Vehicle, xr.Dataset], xr.Dataset]
"""Function that runs `rates` without column tests on a vehicle and its telemetry."""


def check_columns(
    result: xr.Dataset,
    assessment: Assessment,
    reversed_wheels: Reversed | None,
    again: EstimateAgain | None,
    settings: RatesSettings,
    budget: Budget,
) -> xr.Dataset:
    """Return the result of `rates` with what the data say of columns, axes and signs.

    Passes may lose `decided` and `unique`; `columns_checked` says of each whether the data confirm the columns. Attributes may be
    added: `alike`, `columns_unseen`, `columns_rivals`, `columns_doubt`, `columns_changes`, `column_tests_cut`, and
    `symmetric_unlisted`. `reversed_wheels`: wheels that may turn the other way. `again`: function that estimates changed files,
    None if the caller asked for no column tests. `budget`: of one pass.
    """
    vehicle, telemetry = assessment.vehicle, assessment.telemetry
    observed = what_was_observed(vehicle, telemetry, result.attrs)
    result = _with_unseen_changes(result, observed, telemetry)
    result = _undecided_by_symmetry(result, observed, telemetry)

    # What the samples of the longest pass, each by itself, say of the columns. This is asked only of a file of panels alone that
    # fits: with another sensor, a file of wrong columns does not fit.
    fits = bool(result["fits"].values.all())
    costs = None
    if fits and observed.panels and not observed.sensors:
        costs = SampleCosts.of(vehicle, samples_of(result, telemetry, _longest(result)))
    contradicted = costs is not None and costs.contradict_the_columns()

    # Other columns are tried on a pass that does not fit, if the samples contradict the columns, or if a wheel is in doubt: a file
    # with exchanged columns may fit better with reversed wheels, and better still with the columns exchanged.
    suspected = contradicted or (costs is not None and reversed_wheels is not None)
    others_tried = again is not None and (not fits or suspected)
    tests_budget = replace(budget, most=COLUMN_SHARE * budget.most)
    doubt: ColumnDoubt | None = None
    if again is not None:
        estimators = estimators_of(result, again, settings, tests_budget)
        if others_tried:
            doubt = _other_columns(result, observed, telemetry, estimators)
        if doubt is None and costs is not None:
            least_gain = 0.0 if reversed_wheels is None else reversed_wheels.gain
            result, doubt = _with_rivals(result, observed, telemetry, costs, estimators, least_gain)
        # wrong axes of a magnetometer or a gyro may fit, as its zero offset is mostly unknown
        field_unknown = "field_B" in observed.sensors and not observed.in_orbit
        if doubt is None and field_unknown:
            doubt = _field_compared(result, observed, telemetry, estimators)
        if doubt is None and "gyro_B" in observed.sensors:
            doubt = _zero_compared(result, observed, telemetry, estimators)
    if doubt is None and contradicted:
        advice = "" if again is not None else f": {TRY_COLUMNS}"
        doubt = ColumnDoubt(SAMPLES_CONTRADICT, SAMPLES_CONTRADICT + advice)
    if doubt is not None:
        result = doubt.written(result)
    if others_tried or tests_budget.cut:
        result = result.assign_attrs(column_tests_cut=int(tests_budget.cut))
    if reversed_wheels is None:
        return result
    reason = "the sign of a wheel"
    if doubt is not None:  # its words stay
        return undecided(result, reason)
    cause = _better_with_reversed(reversed_wheels, observed, telemetry, others_tried)
    return ColumnDoubt(reason, cause).written(result)


@dataclass(frozen=True)
class ColumnDoubt:
    """Why no pass of a file is decided: the `reason`, for the table of passes, and its `cause`.

    The cause is changes that fit better than the file, or a sentence for the verdict. `checked`: `columns_checked` of all passes.
    """

    reason: str
    cause: BetterChanges | str
    checked: str = COLUMNS_DOUBTED

    def written(self, result: xr.Dataset) -> xr.Dataset:
        """Return the result with no pass decided, the sentence for the verdict, and in JSON the changes that it names."""
        result = undecided(result, self.reason, self.checked)
        if isinstance(self.cause, str):
            return result.assign_attrs(columns_doubt=self.cause)
        rows = [
            {
                "what": change.what,
                "do": change.do,
                "at_s": self.cause.at_s,
                "omega_deg_s": None if omega is None else np.degrees(omega).round(6).tolist(),
            }
            for change, omega in self.cause.changes
        ]
        words = self.cause.words(partial(clock_time, result.attrs.get("epoch_utc")))
        return result.assign_attrs(columns_doubt=words, columns_changes=json.dumps(rows))


def what_was_observed(vehicle: Vehicle, telemetry: xr.Dataset, attrs: dict) -> Observed:
    """Return which readings the telemetry has, to decide which changes of the file look the same in them.

    `attrs`: attributes of a result of `rates`: what the wheels do (`wheels`), whether the panels were used (`source`), and `orbit`
    if the directions of Sun and field in space are known.
    """
    momenta = momentum_of_each(vehicle, telemetry, name_of_wheels(attrs["wheels"]))
    observed = Observed.of(vehicle, telemetry, momenta=momenta, in_orbit="orbit" in attrs)
    return replace(observed, panels=observed.panels and attrs["source"] == "panels")


def _with_unseen_changes(
    result: xr.Dataset, observed: Observed, telemetry: xr.Dataset
) -> xr.Dataset:
    """Return the result with the changes of columns that no data of the file distinguish from the columns as they are written.

    attrs["columns_unseen"] is JSON, a row for each such change: `what` it is, and the `matrix` (3, 3) that maps body directions
    under the file to those under the change. If there is no such change, unchecked columns count as stated. Without readings of
    panels nothing is changed. attrs["alike"] says which motions panels on shared inputs cannot distinguish.
    """
    if not observed.panels:
        return result
    if words := alike_motions(observed.vehicle):
        result = result.assign_attrs(alike=words)
    along_motion = replace(observed, sun_B=result["sun_B"].values)
    unseen, checked = unseen_changes(along_motion, telemetry), result["columns_checked"].values
    if not unseen and (unseen := unseen_axes(along_motion)):
        unchecked = np.where(checked == COLUMNS_STATED, COLUMNS_UNCHECKED, checked)
        result = result.assign(columns_checked=("pass_id", unchecked))
    if not unseen:
        confirmed = np.where(checked == COLUMNS_UNCHECKED, COLUMNS_STATED, checked)
        return result.assign(columns_checked=("pass_id", confirmed))
    rows = [
        {"what": change.what, "matrix": np.round(matrix, 6).tolist()} for change, matrix in unseen
    ]
    return result.assign_attrs(columns_unseen=json.dumps(rows))


def unseen_axes(observed: Observed) -> list[tuple[ColumnChange, np.ndarray]]:
    """Return other axes of a gyro or magnetometer that are equivalent to the file, but with another motion, each with its M (3, 3).

    If the normals of the lit panels lie in a plane or on a line, such a sensor alone may show the other axes of the body. Of the
    equivalent ways to read its columns those that change the fewest are returned.
    """
    unseen = [
        (change, m, name)
        for name in sorted(observed.sensors & {"gyro_B", "field_B"})
        for change, m in equivalent_changes(
            observed, AS_WRITTEN, changes_of_sensor(observed.vehicle, name)
        )
        if np.abs(rate_under(m, np.eye(3)) - np.eye(3)).max() > AXES_ALIKE
    ]
    changed = [
        int((change.axes[name] != np.eye(3)).any(axis=1).sum()) for change, _, name in unseen
    ]
    fewest = min(changed, default=0)
    return [
        (change, m)
        for (change, m, _), count in zip(unseen, changed, strict=True)
        if count == fewest
    ]


def _undecided_by_symmetry(
    result: xr.Dataset, observed: Observed, telemetry: xr.Dataset
) -> xr.Dataset:
    """Return the result in which a pass is not unique if a symmetric motion, with the same panel readings, is no solution of it.

    There is a symmetric motion if a rotation or mirror of the body leaves all panels as they are. There is one too if the normals
    of all lit panels lie in a plane: the mirror across this plane changes no reading. Only passes that are unique and fit are
    tested. Those with such a motion lose `decided` and `unique`; attrs["symmetric_unlisted"] counts them.
    """
    # without "noise" no reading of a panel counted
    if not observed.panels or "noise" not in result.attrs:
        return result
    decided, unique = (result[name].values.copy() for name in ("decided", "unique"))
    why = result["why_not_decided"].values.astype(object)
    noise = noise_of(result, observed.vehicle)
    unlisted = 0
    for k in np.flatnonzero(unique & result["fits"].values):
        lit = Observed.of(observed.vehicle, samples_of(result, telemetry, k)).lit
        sun = result["sun_B"].values[result["pass_of"].values == k]
        # of all solutions of pass k (n_solution, 3)
        omega, sigma = (
            np.stack([result[f"{name}_{axis}"].values[k] for axis in "xyz"], axis=1)
            for name in ("omega", "sigma")
        )
        if has_unlisted_motion(replace(observed, lit=lit, sun_B=sun), omega, sigma, noise):
            decided[k] = unique[k] = False
            unlisted += 1
            why[k] = join_reasons(why[k], "several motions: a symmetric one is not listed")
    return result.assign(
        decided=("pass_id", decided),
        unique=("pass_id", unique),
        why_not_decided=("pass_id", why.astype(np.str_)),
    ).assign_attrs(symmetric_unlisted=unlisted)


def noise_of(result: xr.Dataset, vehicle: Vehicle) -> np.ndarray | float:
    """Return one sigma of the panel readings: of each input (n_input) as the vehicle file states, else the estimated one."""
    stated = vehicle.input_noise
    return result.attrs["noise"] if stated is None else stated


def has_unlisted_motion(
    observed: Observed, omega: np.ndarray, sigma: np.ndarray, noise: np.ndarray | float
) -> bool:
    """Return whether a motion has a symmetric one with the same readings that is not among the solutions.

    `omega`, `sigma` (K, 3), rad/s: rates of all solutions at one time and their errors, the motion first, NaN if there are fewer
    than K. `observed.sun_B`: the Sun directions along the motion. `noise`: as of :func:`noise_of`.
    """
    power = observed.vehicle.response_in().power
    readings = power(observed.sun_B)
    # rotations and mirrors M (3, 3) of the body under which the file looks the same as itself
    for matrix in equivalence(observed, AS_WRITTEN, AS_WRITTEN):
        difference = np.abs(rate_under(matrix, omega[0]) - omega)
        is_listed = (difference < SAME_SIGMAS * sigma).all(axis=1).any()
        # `equivalence` allows the stated errors of the file. Here the readings of this pass must stay the same.
        change = (power(observed.sun_B @ matrix.T) - readings) / noise
        if not is_listed and (change**2).sum() / 2 <= CLEARLY:
            return True
    return False


def _other_columns(
    result: xr.Dataset, observed: Observed, telemetry: xr.Dataset, estimators: Estimators
) -> ColumnDoubt | None:
    """Return the changes that make the longest unfitted pass fit, or the sensor that contradicts the others; None if there is none.

    If all passes fit the longest is tried: its samples or a wheel raise doubts of the columns.
    """
    unfitted = np.flatnonzero(~result["fits"].values)
    of_pass = samples_of(result, telemetry, _longest(result, unfitted if len(unfitted) else None))
    observed_in_pass = what_was_observed(observed.vehicle, of_pass, result.attrs)
    return _doubt_by(what_fits_better(observed_in_pass, of_pass, estimators))


def _field_compared(
    result: xr.Dataset, observed: Observed, telemetry: xr.Dataset, estimators: Estimators
) -> ColumnDoubt | None:
    """Return the magnetometer if the Sun alone shows another motion of the longest decided pass; None if no Sun was read."""
    if not (observed.panels or "sun_sensor_B" in observed.sensors):
        return None
    compared = _longest_decided_with(result, telemetry, "field_B")
    if compared is None:
        return None
    return _doubt_by(denied_by_the_sun(observed.vehicle, *compared, estimators))


def _zero_compared(
    result: xr.Dataset, observed: Observed, telemetry: xr.Dataset, estimators: Estimators
) -> ColumnDoubt | None:
    """Return what is in doubt if the gyro fits the longest decided pass only with a zero offset that the file does not state."""
    compared = _longest_decided_with(result, telemetry, "gyro_B")
    if compared is None or not (observed.panels or observed.sensors - {"gyro_B"}):
        return None
    observed_in_pass = what_was_observed(observed.vehicle, compared[0], result.attrs)
    return _doubt_by(unconfirmed_zero(observed_in_pass, *compared, estimators))


def _longest_decided_with(
    result: xr.Dataset, telemetry: xr.Dataset, name: str
) -> tuple[xr.Dataset, xr.Dataset] | None:
    """Return telemetry and motion of the decided pass with most samples, of those in which the variable `name` was read."""
    read = telemetry["time"].values[np.isfinite(telemetry[name].values).all(axis=1)]
    with_readings = result["pass_of"].values[np.isin(result["time"].values, read)]
    decided = np.flatnonzero(result["decided"].values)
    decided = decided[np.isin(decided, with_readings)]
    if not len(decided):
        return None
    k = _longest(result, decided)
    motion = result[["omega_B", "omega_cov_B"]].isel(time=result["pass_of"].values == k)
    return samples_of(result, telemetry, k), motion


def _doubt_by(
    cause: BetterChanges | ContradictingSensor | UnstatedZero | None,
) -> ColumnDoubt | None:
    """Return the doubt of all passes by what one pass shows; None if that has no cause."""
    if isinstance(cause, UnstatedZero):
        return ColumnDoubt("the zero offset of the gyro", cause.words(), COLUMNS_UNCHECKED)
    if isinstance(cause, ContradictingSensor):
        # in all passes: of a spinner whose magnetometer was read along other axes two of four passes fitted, far from the truth
        return ColumnDoubt(f"the {cause.sensor} contradicts the other readings", cause.words())
    return None if cause is None else ColumnDoubt("columns, signs or axes", cause)


def _with_rivals(
    result: xr.Dataset,
    observed: Observed,
    telemetry: xr.Dataset,
    costs: SampleCosts,
    estimators: Estimators,
    least_gain: float,
) -> tuple[xr.Dataset, ColumnDoubt | None]:
    """Return result and doubt after a test of rivals: other columns that fit the longest decided pass about as well as the file.

    Rivals have one of three consequences, the first that applies. In 2 and 3 only rivals with another rate count:

    1. A rival is clearly better: the file is wrong. The rivals are named, and no pass is decided.
    2. A rival has at least one in ten of the probability (`AS_PROBABLE`): no pass is decided.
    3. The data do not exclude a rival (`EXCLUDED`): it is listed with its rates in attrs["columns_rivals"].

    Without readings of panels or a decided pass nothing is tested. `costs`: of the samples of the longest pass, decided or not.
    `least_gain`: log evidence that rivals must gain more than reversed wheels do, if a wheel is in doubt; 0 ignores none.
    """
    decided = np.flatnonzero(result["decided"].values)
    if "noise" not in result.attrs or not len(decided):
        return result, None
    k = _longest(result, decided)
    of_pass = samples_of(result, telemetry, k)
    observed_in_pass = replace(
        what_was_observed(observed.vehicle, of_pass, result.attrs),
        sun_B=result["sun_B"].values[result["pass_of"].values == k],
    )
    if k != _longest(result):  # `costs` are of another pass
        costs = SampleCosts.of(observed.vehicle, of_pass)
    # A rival is estimated on this pass alone. The result was estimated with all passes of the file: its evidence can be compared
    # only if this pass is the whole file. Else (None) the file as written is estimated on this pass alone too.
    is_whole_file = of_pass.sizes["time"] == telemetry.sizes["time"]
    as_written = result if is_whole_file else None
    noise = noise_of(result, observed.vehicle)
    rivals = rival_exchanges(observed_in_pass, of_pass, costs, noise, estimators, as_written)
    if least_gain:
        rivals = [rival for rival in rivals if rival.gain >= least_gain]

    # 1. The file is wrong. More evidence is not enough, and the cost of the best motion must be lower too: for a slow body that was
    # searched up to 40 times its rate, exchanged dark columns had 11.7 more in log evidence and yet fitted worse. If the file fits
    # with misaligned panels, any cost will do: the misalignment may stand for exchanged columns and then makes the cost low.
    misaligned = str(result["model"].values[k]).startswith(MISALIGNED)
    most_cost = np.inf if misaligned else float(result["cost"].values[k, 0]) - CLEARLY
    accusing = [rival for rival in rivals if rival.gain > CLEARLY and rival.cost <= most_cost]
    if accusing:
        best = accusing[0]
        near_best = [rival for rival in accusing if rival.gain > best.gain - CLEARLY]
        changes = tuple(change for rival in near_best for change in rival.changes)
        return result, ColumnDoubt("columns, signs or axes", replace(best, changes=changes))

    # 2. Rivals are as probable. Only those with another rate count: if the rates are the same, the result is right with either.
    omega, sigma = (
        np.array([result[f"{name}_{axis}"].values[k, 0] for axis in "xyz"])
        for name in ("omega", "sigma")
    )
    others = [rival for rival in rivals if not _gives_the_rate(rival, omega, sigma)]
    as_probable = [rival for rival in others if rival.gain > AS_PROBABLE]
    if as_probable:
        names = [change.what for rival in as_probable for change, _ in rival.changes]
        what = " or with ".join(names[:MOST_NAMED])
        words = f"the data fit as well with {what}: find out which columns are right"
        reason = f"other columns fit as well (with {what})"
        return result, ColumnDoubt(reason, words, COLUMNS_UNCHECKED)

    # 3. The data do not exclude rivals.
    not_excluded = [rival for rival in others if rival.gain > -EXCLUDED]
    if not not_excluded:
        return result, None
    checked = np.full(result.sizes["pass_id"], COLUMNS_UNCHECKED)
    clock = partial(clock_time, result.attrs.get("epoch_utc"))
    lines = [rival_words(rival, clock) for rival in not_excluded]
    words = f"columns unchecked: the data fit about as well {'; '.join(lines)}"
    result = result.assign(columns_checked=("pass_id", checked))
    return result.assign_attrs(columns_rivals=words), None


def _gives_the_rate(rival: BetterChanges, omega: np.ndarray, sigma: np.ndarray) -> bool:
    """Return whether the rates under all changes of a rival agree with `omega` (3) within its errors `sigma` (3), in rad/s."""
    rates = [rate for _, rate in rival.changes if rate is not None]
    return all((np.abs(rate - omega) < SAME_SIGMAS * sigma).all() for rate in rates)


def estimators_of(
    result: xr.Dataset, again: EstimateAgain, settings: RatesSettings, budget: Budget
) -> Estimators:
    """Return the functions that estimate changed files as the file of a `result` was estimated: same wheels, same largest rate.

    Quick searches choose which changes are estimated in full; they leave out the orbit, its calibration and torques. If a solution
    of the result is faster than its largest rate, which then nobody stated, they go as far as its own search.
    """
    attrs = result.attrs
    source = None if attrs["source"] == "directions" else attrs["source"]
    speed = np.sqrt(sum(result[f"omega_{axis}"].values ** 2 for axis in "xyz"))
    rate_max = attrs["max_rate_rad_s"]
    if (speed > rate_max).any():
        rate_max *= settings.alternatives.beyond

    def evidence(changed: Vehicle, data: xr.Dataset) -> float:
        """Return the log evidence of the telemetry by a quick search, as one pass; -inf if it cannot be estimated."""
        try:
            assessment = assess(changed, data)
            readings = observe(assessment, source)
            (whole, *_) = split_passes(readings, np.inf, settings.passes)
        except InputError:
            return -np.inf
        noise = Noise(settings.search.noise)
        # the prior sigma of the rate is half of the largest rate
        nominal = Model(readings.obs, Body.of(changed), noise, rate_max / 2)
        momentum = wheel_models(changed, data)[name_of_wheels(attrs["wheels"])]
        nominal = nominal.with_momentum(momentum)
        silent = cost_of_silent_panels(assessment, whole.kept) if source == "panels" else 0.0
        return quick_evidence(nominal.seeing(whole.kept), settings, budget) - silent

    def estimate(changed: Vehicle, data: xr.Dataset) -> xr.Dataset | None:
        """Return the whole estimate of the telemetry; None if it cannot be estimated."""
        try:
            estimated = again(changed, data)
        except InputError:
            return None
        budget.spend(estimated.attrs["effort"] * USUAL * estimated.sizes["pass_id"])
        return estimated

    return Estimators(evidence, estimate, budget)


def cost_of_silent_panels(assessment: Assessment, samples: np.ndarray) -> float:
    """Return minus the log likelihood of the readings at `samples` (indices) of the panels that the estimate leaves out.

    These panels never show a signal: they are taken to have failed, and their readings for noise about zero. Which panels are left
    out depends on the order of the columns, so evidences are compared with this cost: without it, two exchanged columns without a
    signal were better by 125 in a right file.
    """
    quality = assessment.quality
    silent = silent_inputs(assessment)
    zeros = SHADOW_ZERO_SHARE * quality.attrs["full_sun"] * quality["gain"].values
    read = signals(assessment.telemetry)
    # noise and zero offset of each reading (n, n_input)
    sigma = np.broadcast_to(np.hypot(quality["noise"].values, zeros), read.shape)
    read, sigma = read[samples][:, silent], sigma[samples][:, silent]
    square = np.minimum(np.nan_to_num(read / sigma) ** 2, MOST_SQUARE)
    return float((np.log(sigma) + square / 2).sum())


def _better_with_reversed(
    wheels: Reversed, observed: Observed, telemetry: xr.Dataset, others_tried: bool
) -> BetterChanges | str:
    """Return reversed wheels with which the data fit better, and all changes that look the same.

    If the data do not fit with them either, and all other changes were tried (`others_tried`), that is returned in words.
    """
    change = wheel_change(observed.vehicle, wheels.wheels)
    if not wheels.fits and others_tried:
        return (
            f"with {change.what} the data fit better (log evidence better by {wheels.gain:.0f}), and still badly: no single change "
            "of columns or signs explains them"
        )
    candidates = [*column_changes(observed.vehicle, telemetry), *wheel_changes(observed.vehicle)]
    candidates = [candidate for candidate in candidates if candidate.what != change.what]
    same = equivalent_changes(replace(observed, sun_B=wheels.sun_B), change, candidates)
    # the rate at the sample nearest to the middle of the pass
    middle = middle_sample(wheels.t_s)
    omega, at_s = wheels.omega[middle], float(wheels.t_s[middle])
    changes = (
        ChangeWithRate(change, omega),
        *(ChangeWithRate(equivalent, rate_under(matrix, omega)) for equivalent, matrix in same),
    )
    return BetterChanges(changes, wheels.gain, at_s, wheels.fits)


def undecided(result: xr.Dataset, reason: str, checked: str = COLUMNS_DOUBTED) -> xr.Dataset:
    """Return the result with no pass decided, for a `reason` that holds for the whole file; `checked`: its `columns_checked`."""
    why = [join_reasons(of_pass, reason) for of_pass in result["why_not_decided"].values]
    count = result.sizes["pass_id"]
    return result.assign(
        decided=("pass_id", np.zeros(count, dtype=bool)),
        columns_checked=("pass_id", np.full(count, checked)),
        why_not_decided=("pass_id", why),
    )


def clock_time(epoch_utc: str | None, t_s: float) -> str:
    """Return a time `t_s` (s after the epoch) in words: the time of day in UTC, with the date if it is not that of the epoch.

    Without an epoch it is the number of seconds.
    """
    if epoch_utc is None:
        return f"{t_s:.0f} s"
    text = utc_after(t_s, epoch_utc)
    return text[11:19] if text[:10] == utc_after(0.0, epoch_utc)[:10] else text


def _longest(result: xr.Dataset, which: np.ndarray | None = None) -> int:
    """Return the index of the pass with the most samples, of all or of those in `which` (indices)."""
    which = np.arange(result.sizes["pass_id"]) if which is None else which
    return int(which[np.argmax(result["samples"].values[which])])


def samples_of(result: xr.Dataset, telemetry: xr.Dataset, k: int) -> xr.Dataset:
    """Return the samples of the telemetry that pass `k` of a result uses; of samples with the same time the first."""
    times, first = np.unique(telemetry["time"].values, return_index=True)
    used = result["time"].values[result["pass_of"].values == k]
    return take_samples(telemetry, first[np.isin(times, used)])
