"""Other columns, axes and signs for a pass that may not be as the vehicle file has them.

One list of changes is tried: two panels' columns exchanged, a panel or a wheel reversed, a second sensor's axes permuted or
reversed, a quaternion read the other way. A change is named only if the pass fits with it, and better by :data:`CLEARLY` in log
evidence. Mostly the file as it is written does not fit. A file of panels alone that fits is tested in three cases
(:mod:`sunspin.estimate.columns`): its samples, each by itself, fit other columns far better, or as well; or reversed wheels fit
better. Changes that look the same in the telemetry (:mod:`sunspin.estimate.equivalence`) are named together, each with its motion,
and none is recommended.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Any, NamedTuple

import numpy as np
import tomlkit
import xarray as xr

from sunspin.estimate.budget import Budget
from sunspin.estimate.equivalence import (
    AS_WRITTEN,
    CLEARLY,
    ColumnChange,
    Observed,
    column_changes,
    equivalence,
    equivalent_changes,
    rate_under,
    wheel_changes,
)
from sunspin.estimate.settings import FIELD_TURN
from sunspin.estimate.verdict import DECIDED, in_sigma, misfit
from sunspin.telemetry.assess import Assessment, assess
from sunspin.telemetry.sun import signals
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.planes import sphere
from sunspin.vehicle.sensors import VARIABLES, Attitude

MOST_SQUARE = 30.0
"""Squared distance up to which a reading of a second sensor, or a sample of panels, counts against a change: some are spikes."""

SENSORS = {"gyro_B": "gyro", "field_B": "magnetometer", "attitude_B_from_N": "quaternion"}
"""Variable of the telemetry -> what a person calls it."""

COMPONENTS = 3
"""Degrees of freedom of a reading of a rate, of a field, or of a rotation from one attitude to the next."""

TABLES = {variable: table for table, variable in VARIABLES.items()}
"""Variable of the telemetry -> the sensor's table in the vehicle file."""

DIRECTIONS, READING_ERROR = 3000, 0.06
"""Directions of the Sun in which samples are compared with the panels, 3.5 degrees apart, and the error of a reading there, as a
share of full Sun: half of that distance, and gains."""

BRIGHTEST = 1.15
"""Brightness of a sample, in full Suns, that panels may show at most. There is no lower limit, since a full battery dims samples:
with one of 0.85 four right passes of skCUBE seemed to have a reversed panel, and of simulated exchanges no more were seen."""

WORTH_A_SEARCH = 30.0
"""Log likelihood of the samples, each by itself, by which a change may be worse than the best and is still searched with: of 60
files with two columns exchanged the right change was at most 0.8 from the best."""

AS_GOOD = 3.0
"""The same for a pass that fits: of 60 files with exchanged columns the right change was at most 0.8 worse than the wrong one."""

EXCHANGED = 0.01
"""Share of files whose columns are exchanged: a supposition before the data."""

AS_PROBABLE = float(np.log((1 - DECIDED) / DECIDED * (1 - EXCHANGED) / EXCHANGED))
"""Log evidence (2.4) by which a change of columns must be better than the file to have one in ten of the probability. Then a pass
with another rate is not decided."""

EXCLUDED = float(np.log(99.0))
"""Log evidence (4.6) by which a change must be worse than the file to be excluded at 1 in 100, if both are equally probable before
the data."""

MOST_COMPARED = 60
"""Samples that are compared so, evenly chosen."""

MOST_RUNS = 3
"""Changes that are estimated in full, at most."""

MOST_NAMED = 6
"""Changes that are named, at most; of others the number is given."""


class Named(NamedTuple):
    """A change that fits, with the rate (3) in rad/s that it gives, if that is known."""

    change: ColumnChange
    omega: np.ndarray | None = None


@dataclass(frozen=True)
class Better:
    """The changes that fit better than the file as it is written, all those that the telemetry cannot distinguish.

    `gain`: by how much their log evidence is better; `at_s`: the time of their rates; `fits`: whether they fit, or only fit better;
    `cost`: of the best motion with the best of them.
    """

    named: tuple[Named, ...]
    gain: float
    at_s: float = np.nan
    fits: bool = True
    cost: float = np.nan

    def words(self, clock: Callable[[float], str] = lambda t: f"{t:.0f} s") -> str:
        """Return a sentence for the verdict; `clock`: function from a time of the telemetry (s) to its words."""
        better = f"the data fit {'' if self.fits else 'better '}with"
        gain = f"(log evidence better by {self.gain:.0f})"
        if len(self.named) == 1:
            change = self.named[0].change
            do = f"; if it is so, {change.do}" if change.do else ""
            signs = change.reversed_wheels and not change.columns
            check = "CHECK THE SIGNS" if signs else "CHECK THE COLUMNS"
            return f"{better} {change.what} {gain}: {check}{do}"
        shown = [
            f"({chr(97 + k)}) {_line(named)}" for k, named in enumerate(self.named[:MOST_NAMED])
        ]
        more = len(self.named) - len(shown)
        others = f"; and {more} other changes" if more else ""
        at = f" at {clock(self.at_s)}" if np.isfinite(self.at_s) else ""
        return (
            f"{better} each of {len(self.named)} changes, and this telemetry cannot tell which is right {gain}: {'; '.join(shown)}"
            f"{others} (rates{at}): CHECK THE COLUMNS, find out which one is right before you change the file"
        )


def _line(named: Named) -> str:
    """Return a change that is named among several in words, with the rate that it gives."""
    do = f" ({named.change.do})" if named.change.axes or named.change.reversed_wheels else ""
    if named.omega is None:
        return f"{named.change.what}{do}"
    rate = ", ".join(f"{value:z.2f}" for value in np.degrees(named.omega))
    return f"{named.change.what}{do}: omega ({rate}) deg/s"


def rival_words(rival: Better, clock: Callable[[float], str]) -> str:
    """Return a change that the data do not exclude in words, with its rate; `clock` as of :meth:`Better.words`."""
    side = "higher" if rival.gain > 0 else "lower"
    count = len(rival.named) - 1
    more = f", and with {count} more that look the same" if count else ""
    return f"with {_line(rival.named[0])} at {clock(rival.at_s)} (log evidence {side} by {abs(rival.gain):.1f}{more})"


@dataclass(frozen=True)
class Culprit:
    """The sensor without which the others agree, and that no other columns or axes of it explain."""

    sensor: str

    def words(self, clock: Callable[[float], str] | None = None) -> str:
        """Return a sentence for the verdict; no time is in it."""
        del clock
        option = "attitude" if self.sensor == "quaternion" else self.sensor
        return (
            f"without the {self.sensor} the other readings fit: look at its zero, scale, columns and clock (`--without {option}` "
            "gives the rates of the others)"
        )


@dataclass(frozen=True)
class Trials:
    """How changes are judged: `evidence` by a quick search, `run` by the whole estimate, None without a result; the `budget`."""

    evidence: Callable[[Vehicle, xr.Dataset], float]
    run: Callable[[Vehicle, xr.Dataset], xr.Dataset | None]
    budget: Budget

    def fitting(self, vehicle: Vehicle, telemetry: xr.Dataset) -> xr.Dataset | None:
        """Return the estimate, if it fits."""
        result = self.run(vehicle, telemetry)
        return result if result is not None and bool(result["fits"].values.all()) else None


@dataclass(frozen=True)
class CostsOfSamples:
    """Minus the log likelihood of the samples of a pass, each by itself, `as_written` and under each of some `changes` of columns.

    `of_changes` (m): as :func:`sample_costs` computes them.
    """

    as_written: float
    changes: list[ColumnChange]
    of_changes: np.ndarray

    @classmethod
    def of(cls, vehicle: Vehicle, telemetry: xr.Dataset) -> CostsOfSamples:
        """Return the costs of the samples of a pass under the file as it is written and all changes of its columns."""
        changes = column_changes(vehicle, telemetry)
        as_written, *of_changes = sample_costs(vehicle, telemetry, [AS_WRITTEN, *changes])
        return cls(float(as_written), changes, np.array(of_changes))

    def deny_the_columns(self) -> bool:
        """Return whether some change of columns fits the samples far better than the file as it is written."""
        return bool(self.as_written > self.of_changes.min(initial=np.inf) + WORTH_A_SEARCH)


def what_fits_better(
    observed: Observed, telemetry: xr.Dataset, trials: Trials
) -> Better | Culprit | None:
    """Return changes with which a pass fits that does not fit as written; else the sensor that contradicts the others; else None.

    If the pass fits without one of the sensors, the cause is that sensor, or what only that sensor can see: first other axes of any
    such sensor are tried, then exchanged columns. The sensor itself is named only if it contradicts the motion of the others. If
    leaving out one sensor does not help, columns of panels and wheels are tried.
    """
    first_cause: Better | Culprit | None = None
    fits_without_one = False
    for name in SENSORS:
        if name not in telemetry or not np.isfinite(telemetry[name].values).any():
            continue
        if trials.budget.exhausted():
            break
        estimate = trials.fitting(observed.vehicle, telemetry.drop_vars(name))
        if estimate is None:
            continue
        fits_without_one = True
        better = _other_axes(observed, telemetry, name, estimate, trials)
        if better is not None:
            return better
        if first_cause is None:
            first_cause = _exchanged_by_sensor(observed, telemetry, name, estimate, trials)
        if first_cause is None and _contradicts(observed.vehicle, telemetry, name, estimate):
            first_cause = Culprit(SENSORS[name])
    # where the others are too coarse to contradict a sensor, their columns are not what keeps the pass from fitting
    if fits_without_one or not observed.panels:
        return first_cause
    return _other_panels(observed, telemetry, trials)


# ------------------------------------------------------------------------------------------------------ columns of panels, wheels


def _other_panels(observed: Observed, telemetry: xr.Dataset, trials: Trials) -> Better | None:
    """Return changes of columns, panels and wheels that fit.

    The samples, each by itself, exclude most changes without a search. First those of one mistake are tried, then a mistake of the
    columns together with reversed wheels.
    """
    vehicle = observed.vehicle
    evidence_as_written = trials.evidence(vehicle, telemetry)
    if not np.isfinite(evidence_as_written):
        return None
    wheels = wheel_changes(vehicle) if len(observed.momenta) else []
    changes = [AS_WRITTEN, *column_changes(vehicle, telemetry), *wheels]
    cost = sample_costs(vehicle, telemetry, changes)
    # number 0 is the file as it is written; the others, the best first, that are not far worse than the best of them
    order = np.argsort(cost, kind="stable")
    allowed = [int(k) for k in order if k and cost[k] <= cost[1:].min() + WORTH_A_SEARCH]
    of_one_mistake = [(changes[k], float(cost[k])) for k in allowed]
    names = [wheel.name for wheel in vehicle.wheels]
    of_two_mistakes = [
        (change.with_wheels(wheel.reversed_wheels, names), cost_of_samples)
        for change, cost_of_samples in of_one_mistake
        if change.columns
        for wheel in wheels
    ]
    as_written = float(cost[0]), evidence_as_written
    for candidates in (of_one_mistake, of_two_mistakes):
        better = _best_of_distinct(observed, telemetry, candidates, as_written, trials)
        if better is not None:
            return better
    return None


def _best_of_distinct(
    observed: Observed,
    telemetry: xr.Dataset,
    candidates: Sequence[tuple[ColumnChange, float]],
    as_written: tuple[float, float],
    trials: Trials,
) -> Better | None:
    """Return the candidate that fits best, with all that look the same in the telemetry; None if none fits.

    `candidates`: changes, each with its cost by :func:`sample_costs`; `as_written`: cost and log evidence of the file as it is
    written. Of changes that look the same one is tried, and none that looks the same as the file
    (:func:`_best_of_classes` says how).
    """
    cost_as_written, evidence_as_written = as_written
    # one change of each class that looks the same, the file as it is written first
    distinct = [(AS_WRITTEN, cost_as_written)]
    for change, cost in candidates:
        # What looks the same costs about the same, as its panels show the same: changes whose costs differ by CLEARLY need not be
        # compared.
        of_same_cost = (other for other, of_other in distinct if abs(cost - of_other) < CLEARLY)
        if not any(len(equivalence(observed, other, change)) for other in of_same_cost):
            distinct.append((change, cost))
    classes = [change for change, _ in distinct[1:]]
    others = [change for change, _ in candidates]
    return _best_of_classes(observed, telemetry, classes, others, trials, evidence_as_written)


def rival_exchanges(
    observed: Observed,
    telemetry: xr.Dataset,
    costs: CostsOfSamples,
    noise: np.ndarray | float,
    trials: Trials,
    as_written: float | None,
) -> list[Better]:
    """Return changes of columns that the samples allow and that fit a pass about as well as the file, the most probable first.

    The samples, each by itself, cannot tell such columns apart, but a motion can. Both then explain all readings well, and only
    their evidence says which is right. A satellite with three lit panels was decided along a motion 74 sigma off that two exchanged
    columns made up; with the right ones the log evidence was better by 24. `observed`: with the Sun's directions of the estimated
    motion; `costs`: of the samples of the pass; `noise`: of the readings; `as_written`: the log evidence of the file as it is
    written by the whole estimate, None if it is to be estimated. Changes that are excluded (:data:`EXCLUDED`) by a quick search are
    not estimated.
    """
    dark, rivals = _changes_to_compare(observed, telemetry, costs, noise)
    if not (dark or rivals):
        return []
    # `equivalence` asks lit columns only, so it calls all exchanges of dark ones alike; hence none are named as equivalents
    candidates = [(change, []) for change in dark] + [(change, costs.changes) for change in rivals]
    vehicle = observed.vehicle
    quick_as_written = trials.evidence(vehicle, telemetry)
    if not np.isfinite(quick_as_written):
        return []
    quick = np.full(len(candidates), -np.inf)
    for k, (change, _) in enumerate(candidates):
        if trials.budget.exhausted():
            break
        quick[k] = trials.evidence(*change.applied(vehicle, telemetry)) - quick_as_written
    near = [int(k) for k in np.argsort(-quick, kind="stable") if quick[k] > -EXCLUDED]
    # A quick search holds inertia and gains. The evidence of a whole estimate tells more: of two files with exchanged columns the
    # right ones were better by 0.3 and 2.3 in a quick search, and by 2.6 and 4.6 in whole estimates.
    if not near:
        return []
    if as_written is None:
        estimate = trials.fitting(vehicle, telemetry)
        if estimate is None:
            return []
        as_written = float(estimate.attrs["log_evidence"][0])
    compared = []
    for k in near[:MOST_RUNS]:
        change, others = candidates[k]
        result = trials.fitting(*change.applied(vehicle, telemetry))
        if result is not None:
            gain = float(result.attrs["log_evidence"][0]) - as_written
            named = tuple(with_equivalents(observed, change, result, others))
            at_s, cost = rate_in_the_middle(result)[1], float(result["cost"].values[0, 0])
            compared.append(Better(named, gain, at_s, cost=cost))
    return sorted(compared, key=lambda better: -better.gain)


def _changes_to_compare(
    observed: Observed, telemetry: xr.Dataset, costs: CostsOfSamples, noise: np.ndarray | float
) -> tuple[list[ColumnChange], list[ColumnChange]]:
    """Return the changes that the samples of a pass allow and a motion may tell from the file: of dark columns, and of others.

    Arguments are those of :func:`rival_exchanges`. Exchanges of dark columns that change nothing are left out.
    """
    vehicle, changes = observed.vehicle, costs.changes
    allowed = costs.of_changes <= costs.as_written + AS_GOOD
    # a change that gives the same readings as reversed wheels was tested with the signs of the wheels
    tested = [AS_WRITTEN, *(wheel_changes(vehicle) if len(observed.momenta) else [])]
    light = vehicle.response_in().power(observed.sun_B) / noise
    read = np.nan_to_num(signals(telemetry)) / noise

    # An exchange of two dark columns counts if the estimated motion would light them differently, or if their readings differ: a
    # glint of 6 % of full Sun in the wrong column moved a rate by 5.6 sigma. Any other leaves readings and motion as they are.
    dark, rivals = [], []
    for change, is_allowed in zip(changes, allowed, strict=True):
        if not is_allowed:
            continue
        moved = np.flatnonzero(np.asarray(change.columns) != np.arange(len(change.columns)))
        if len(moved) == 2 and not observed.lit[moved].any():
            differ = max(
                (np.diff(of_samples[:, moved], axis=1) ** 2).sum() / 2
                for of_samples in (light, read)
            )
            if differ > CLEARLY:
                dark.append(change)
        elif not any(len(equivalence(observed, other, change)) for other in tested):
            rivals.append(change)
    # a panel without a signal is left out: evidences are compared only if as many panels, of the same gains, are
    silent = gains_of_silent(vehicle, telemetry, AS_WRITTEN) if dark or rivals else []
    dark, rivals = (
        [change for change in group if gains_of_silent(vehicle, telemetry, change) == silent]
        for group in (dark, rivals)
    )
    return dark, rivals


def gains_of_silent(vehicle: Vehicle, telemetry: xr.Dataset, change: ColumnChange) -> list[float]:
    """Return the sorted gains of the inputs that are left out under a change, since their panels never show a signal."""
    return sorted(
        vehicle.input_gains[silent_inputs(assess(*change.applied(vehicle, telemetry)))].tolist()
    )


def silent_inputs(assessment: Assessment) -> np.ndarray:
    """Return which inputs (n_input) count in no sample: they are dead, or never show a signal."""
    quality = assessment.quality
    return ~(quality["reading"].values & ~quality["dead"].values).any(axis=0)


def _best_of_classes(
    observed: Observed,
    telemetry: xr.Dataset,
    classes: Sequence[ColumnChange],
    others: Sequence[ColumnChange],
    trials: Trials,
    evidence_as_written: float,
) -> Better | None:
    """Return the best of some changes, one of each class, with those of the `others` that look the same; None if none fits.

    `evidence_as_written`: log evidence of the file as it is written.
    """
    gains = np.full(len(classes), -np.inf)
    for k, change in enumerate(classes):
        if trials.budget.exhausted():
            break
        changed = change.applied(observed.vehicle, telemetry)
        gains[k] = trials.evidence(*changed) - evidence_as_written
    ranked = [int(k) for k in np.argsort(-gains, kind="stable") if gains[k] > CLEARLY]

    named: list[Named] = []
    best, at_s = -np.inf, np.nan
    for k in ranked[:MOST_RUNS]:
        if gains[k] < best - CLEARLY:  # clearly worse than one that fits
            break
        result = trials.fitting(*classes[k].applied(observed.vehicle, telemetry))
        if result is not None:
            best, at_s = max(best, float(gains[k])), rate_in_the_middle(result)[1]
            named += with_equivalents(observed, classes[k], result, others)
    return Better(tuple(named), best, at_s) if named else None


def with_equivalents(
    observed: Observed, change: ColumnChange, result: xr.Dataset, others: Sequence[ColumnChange]
) -> list[Named]:
    """Return a change and those of the others that look the same, with their rates; `result`: the estimate with the change."""
    omega, _ = rate_in_the_middle(result)
    along = replace(observed, sun_B=np.nan_to_num(result["sun_B"].values))
    same = equivalent_changes(
        along, change, [other for other in others if other.what != change.what]
    )
    return [
        Named(change, omega),
        *(Named(equivalent, rate_under(m, omega)) for equivalent, m in same),
    ]


def rate_in_the_middle(result: xr.Dataset) -> tuple[np.ndarray, float]:
    """Return the rate (3) in rad/s at the sample nearest to the middle of a result, and its time in s."""
    t = result["time"].values
    at = int(np.argmin(np.abs(t - (t[0] + t[-1]) / 2)))
    return result["omega_B"].values[at], float(t[at])


def sample_costs(
    vehicle: Vehicle, telemetry: xr.Dataset, changes: Sequence[ColumnChange]
) -> np.ndarray:
    """Return what the samples cost under each change (m): minus their log likelihood, each in its own best direction of the Sun.

    The square of a sample is the least |read - brightness light|^2 over directions, in which panels get `light`, and over a
    brightness up to :data:`BRIGHTEST`. All are shares of full Sun, in units of `error`: :data:`READING_ERROR` and the noise of the
    inputs. A square counts up to :data:`MOST_SQUARE`.
    """
    sun, gains = sphere(DIRECTIONS), vehicle.input_gains
    stride = -(-max(telemetry.sizes["time"], 1) // MOST_COMPARED)
    telemetry = telemetry.isel(time=slice(None, None, stride))
    noise = 0.0 if vehicle.input_noise is None else (vehicle.input_noise / gains).max()
    error = float(np.hypot(READING_ERROR, noise))
    lit = (np.nan_to_num(signals(telemetry)) > error * gains.max()).any(axis=1)
    squares = []
    for change in changes:
        changed, data = change.applied(vehicle, telemetry.isel(time=lit))
        read = np.nan_to_num(signals(data)) / gains  # (n, p)
        light = changed.response_in().power(sun) / gains  # (d, p), of d directions
        # The square is a^2 - 2 b c + b^2 e, with a = |read|, the brightness b, c = read . light (n, d) and e = |light|^2 (d). It is
        # least at b = c / e, if that is positive.
        along, light_square = read @ light.T, np.maximum((light**2).sum(axis=1), 1e-12)
        read_square = (read**2).sum(axis=1)[:, None]
        best_brightness = np.maximum(along, 0.0) / light_square
        full = 1.0
        if vehicle.gain_unit is None and len(read):
            # gains without a unit: full Sun is a quantile of the brightness of samples in their best directions
            at_best = read_square - best_brightness * np.maximum(along, 0.0)
            direction = np.argmin(at_best, axis=1)
            full = float(np.quantile(best_brightness[np.arange(len(read)), direction], 0.9))
        brightness = np.minimum(best_brightness, BRIGHTEST * full)
        square = read_square + brightness * (brightness * light_square - 2 * along)
        squares.append(square.min(axis=1) / error**2)
    by_sample = np.array(squares)  # (m, n)
    if not by_sample.size:
        return np.zeros(len(changes))
    # The Earth's light may be more than the error. Then even under the best change most samples have a square above the number of
    # inputs: all squares are made smaller by the same factor.
    by_sample /= max(1.0, float(np.median(by_sample, axis=1).min()) / len(gains))
    return np.minimum(by_sample, MOST_SQUARE).sum(axis=1) / 2


# ------------------------------------------------------------------------------------------------------------------ other sensors


def signed_axes() -> Iterator[tuple[str, list[int], tuple[float, ...]]]:
    """Yield the 48 ways to read three columns as axes: in words, with column and sign of each axis; the stated one first."""
    for order in permutations(range(3)):
        for sign in product((1.0, -1.0), repeat=3):
            axes = ", ".join(
                f"{'-' if s < 0 else '+'}{'xyz'[k]}" for k, s in zip(order, sign, strict=True)
            )
            yield f"read as ({axes}) of its columns", list(order), sign


def axes_matrix(order: Sequence[int], sign: Sequence[float]) -> np.ndarray:
    """Return the matrix (3, 3) that reads columns in this order and with these signs."""
    return np.eye(3)[list(order)] * np.array(sign)[:, None]


def to_write(table: str, keys: Mapping[str, Any]) -> str:
    """Return what to do, in words: the keys of a table of the vehicle file that say how a sensor is read."""
    lines = " and ".join(tomlkit.dumps(keys).splitlines())
    return f"set {lines} under [{table}] of the vehicle file"


def changes_of_sensor(vehicle: Vehicle, name: str) -> list[ColumnChange]:
    """Return the 48 signed permutations of a sensor's axes, or the four readings of a quaternion; the stated one first."""
    table = TABLES[name]
    part = vehicle.sensors.with_columns[table]
    # ways to read the columns: in words, the matrix by which values are multiplied, and keys of the vehicle file
    if isinstance(part, Attitude):
        ways = list(_quaternion_conventions(part))
    else:
        ways = [
            (what, axes_matrix(order, sign), part.keys_for_axes(order, sign))
            for what, order, sign in signed_axes()
        ]
    return [
        ColumnChange(f"the {SENSORS[name]} {what}", axes={name: matrix}, do=to_write(table, keys))
        for what, matrix, keys in ways
    ]


def _quaternion_conventions(sensor: Attitude) -> Iterator[tuple[str, np.ndarray, dict[str, Any]]]:
    """Yield ways to read quaternions: in words, the matrix (4, 4) by which they are multiplied, and keys of the vehicle file.

    The quaternions are those that the vehicle file gives: scalar last, B_from_N. The way of the file comes first.
    """
    other_end, round_about = "with its scalar at the other end", "read the other way round"
    stated = sensor.interpret(np.eye(4)).values  # row k is what column k alone gives
    for what, other_scalar, other_direction in (
        ("read as the file states", False, False),
        (round_about, False, True),
        (other_end, True, False),
        (f"{other_end} and {round_about}", True, True),
    ):
        keys = sensor.keys_for_convention(other_scalar, other_direction)
        read = replace(sensor, **keys).interpret(np.eye(4)).values
        yield what, read.T @ stated, keys


def _other_axes(
    observed: Observed, telemetry: xr.Dataset, name: str, estimate: xr.Dataset, trials: Trials
) -> Better | None:
    """Return other axes of the sensor `name` with which the pass fits, and exchanged columns that look the same; else None.

    `estimate`: the motion without that sensor. The readings are compared with it under each way to read the axes.
    """
    vehicle = observed.vehicle
    changes = changes_of_sensor(vehicle, name)  # the first is what the file states
    read = telemetry[name].sel(time=estimate["time"].values).values
    costs = np.array(
        [_cost(estimate, read @ change.axes[name].T, name, vehicle) for change in changes]
    )
    best = int(np.argmin(costs))
    gain = float(costs[0] - costs[best])
    if not gain > CLEARLY:
        return None
    result = trials.fitting(*changes[best].applied(vehicle, telemetry))
    if result is None:
        return None
    # axes that fit as well, those nearest to the stated ones first: a component that stays small may have any sign
    ties = [
        int(k)
        for k in np.flatnonzero(costs < costs[best] + CLEARLY)
        if k != best and costs[0] - costs[k] > CLEARLY
    ]
    ties.sort(key=lambda k: -np.trace(changes[k].axes[name]))
    omega, at_s = rate_in_the_middle(result)
    others = [*column_changes(vehicle, telemetry), *wheel_changes(vehicle)]
    named = with_equivalents(observed, changes[best], result, others)
    return Better((*named, *(Named(changes[k], omega) for k in ties)), gain, at_s)


def _exchanged_by_sensor(
    observed: Observed, telemetry: xr.Dataset, name: str, estimate: xr.Dataset, trials: Trials
) -> Better | None:
    """Return changes of columns that only the sensor `name` can see, if it fits the motion as they show it.

    `estimate`: without that sensor, whose readings contradict it. Without the sensor such a change looks the same as the
    file as it is written, but for a rotation or mirror M of the body. So its motion is that of the file under M, and no further
    search is needed to compare the sensor with it.
    """
    # imported late: `check`, which names the ways of a sensor, does not wait for it
    from scipy.spatial.transform import Rotation

    vehicle = observed.vehicle
    sun = np.nan_to_num(estimate["sun_B"].values)
    without = replace(observed, sensors=observed.sensors - {name}, sun_B=sun)
    # the file as it is written first
    changes = [
        (AS_WRITTEN, np.eye(3)),
        *equivalent_changes(without, AS_WRITTEN, column_changes(vehicle, telemetry)),
    ]
    read = telemetry[name].sel(time=estimate["time"].values).values
    attitude = Rotation.from_quat(estimate["B_from_N"].values).as_matrix()
    costs = np.zeros(len(changes))
    for k, (_, m) in enumerate(changes):
        mapped = estimate.assign(
            omega_B=(estimate["omega_B"].dims, rate_under(m, estimate["omega_B"].values)),
            B_from_N=(
                estimate["B_from_N"].dims,
                Rotation.from_matrix(m @ attitude @ m.T).as_quat(),
            ),
        )
        costs[k] = _cost(mapped, read, name, vehicle)
    best = int(np.argmin(costs))
    gain = float(costs[0] - costs[best])
    if not gain > CLEARLY:
        return None
    change, to_best = changes[best]
    result = trials.fitting(*change.applied(vehicle, telemetry))
    if result is None:
        return None
    omega, at_s = rate_in_the_middle(result)
    near = [int(k) for k in np.argsort(costs) if k and costs[k] < costs[best] + CLEARLY]
    # the rate of the best change, mapped back to the file as it is written and on to each of the others
    named = [Named(changes[k][0], rate_under(changes[k][1] @ to_best.T, omega)) for k in near]
    return Better(tuple(named), gain, at_s)


def _contradicts(vehicle: Vehicle, telemetry: xr.Dataset, name: str, estimate: xr.Dataset) -> bool:
    """Return whether the readings of the sensor `name` exclude the motion `estimate` of the others, within the errors of both.

    A pass may fit without a right sensor only because the others do not show what the model cannot follow. With a gyro a body that
    was rotated by hand did not fit, as its rate jumped; its panels gave the rate to 3 deg/s, and all readings of the gyro agreed.
    """
    read = telemetry[name].sel(time=estimate["time"].values).values
    squares = _squares(estimate, read, name, vehicle)
    return not misfit(in_sigma(squares, COMPONENTS)).fits


def _cost(estimate: xr.Dataset, value: np.ndarray, name: str, vehicle: Vehicle) -> float:
    """Return the cost of readings (n, 3 or 4) of a sensor along a motion: half the sum of squares of `MOST_SQUARE` at most."""
    return float(np.minimum(_squares(estimate, value, name, vehicle), MOST_SQUARE).sum() / 2)


def _squares(estimate: xr.Dataset, value: np.ndarray, name: str, vehicle: Vehicle) -> np.ndarray:
    """Return squared distances, in sigmas, of a sensor's readings from a motion: one for each known reading, components summed.

    `estimate`: of `rates`, at n samples; `value` (n, 3 or 4): readings of `name` there. Those of a field and of an attitude are
    compared from one sample to the next of a pass, one number for each pair, as their frame in space is not known. The sigmas
    contain the errors of the motion: of its rate, and of its rotation from sample to sample. Empty if the vehicle states no error
    of the sensor.
    """
    from scipy.spatial.transform import Rotation

    sensors = vehicle.sensors
    known = np.asarray(np.isfinite(value).all(axis=1))
    inside = estimate["pass_of"].values[1:] == estimate["pass_of"].values[:-1]
    pairs = inside & known[1:] & known[:-1]
    rate_variance = np.einsum("nii->ni", estimate["omega_cov_B"].values)
    if name == "gyro_B" and sensors.gyro is not None:
        gyro = sensors.gyro
        zero, scale = gyro.scale_rad_s * gyro.zero_sigma, gyro.scale_sigma / gyro.scale_rad_s
        sensor_variance = gyro.noise_rad_s**2 + zero**2 + (value * scale) ** 2
        square = (value - estimate["omega_B"].values) ** 2 / (rate_variance + sensor_variance)
        return square.sum(axis=1)[known]
    attitude = Rotation.from_quat(estimate["B_from_N"].values)
    interval_s = np.diff(estimate["time"].values)
    # variance of the rotation between two samples, rad^2
    turn_variance = rate_variance[:-1].sum(axis=1) * interval_s**2
    magnetometer = sensors.magnetometer
    if name == "field_B" and magnetometer is not None and magnetometer.noise is not None:
        in_space = attitude.inv().apply(np.where(known[:, None], value, 0.0))
        strength = np.linalg.norm(in_space[:-1], axis=1)
        # the field itself turns in space along the orbit (FIELD_TURN), and the attitudes have errors
        motion_variance = ((FIELD_TURN * interval_s) ** 2 + turn_variance) * strength**2
        pair_variance = 2 * magnetometer.noise**2 + motion_variance
        return ((np.diff(in_space, axis=0) ** 2).sum(axis=1) / pair_variance)[pairs]
    if name == "attitude_B_from_N" and sensors.attitude is not None:
        read = Rotation.from_quat(np.where(known[:, None], value, [0.0, 0.0, 0.0, 1.0]))
        off = (
            (read[1:] * read[:-1].inv()).inv() * (attitude[1:] * attitude[:-1].inv())
        ).magnitude()
        return (off**2 / (2 * sensors.attitude.sigma_rad**2 + turn_variance))[pairs]
    return np.zeros(0)
